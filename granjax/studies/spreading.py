"""How the energy of a kick spreads along many disordered chains: exponents, and whether they have converged."""

import dataclasses
import math
from collections.abc import Callable
from typing import ClassVar, NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ..checks import described, one_of, parameter, positive, refuse, show, whole
from ..flow import simulate
from ..lattice import Lattice, State
from ..measures import energy, participation, site_energy
from ..results import Held, Result
from ..solvers import SRKN6b
from ..sweeps import sweep
from ..types import Count, Parameter, Scalar, Scene

KICKS = ("velocity", "displacement")
# draws of the bootstrap; the least number of times in half of a window
DRAWS, LEAST = 400, 4
# neighbours on either side, of which a local exponent is the slope
BESIDE = 3
# an exponent that is known to change by more per decade of time drifts, by less it has converged
STEADY = 0.075
# what the outermost cells may add to the second moment, relative to it
REACHED = 1e-4
# exponents among which that beside a constant is looked for
GRID = np.linspace(0.02, 3.0, 597)
CONVERGED, DRIFTING, UNDECIDED = "converged", "drifting", "undecided"


class Exponent(NamedTuple):
    """A power law t^value fitted in a window: standard error, change of the slope per decade of time, its error."""

    value: float
    error: float
    drift: float
    drift_error: float

    @property
    def verdict(self) -> str:
        """`"converged"`, `"drifting"`, or `"undecided"`, where samples are too few or the drift is slight."""
        if abs(self.drift) - 2 * self.drift_error > STEADY:
            return DRIFTING
        return CONVERGED if abs(self.drift) + 2 * self.drift_error <= STEADY else UNDECIDED

    def __str__(self) -> str:
        said = {
            CONVERGED: "converged",
            DRIFTING: "has NOT converged, its local slope still drifts",
            UNDECIDED: "not known to have converged, more samples or a later window tell",
        }[self.verdict]
        return f"{self.value:.3f} +- {self.error:.1g} ({said}: {self.drift:+.2g} +- {self.drift_error:.1g} per decade)"


class Spreading(Result):
    """What `spreading` returns.

    - `times` (T,) [s]. `moment` (T,): second moment of the energy about its centre [sites^2], the mean over samples;
      `participation` (T,): mean participation number. `moment_error`, `participation_error`: standard errors.
    - `exponent`, `participation_exponent`: `Exponent`s of the two in the window: `.value`, `.error` (standard error
      over the samples, by bootstrap), `.drift`: change of the slope from the first to the second half of the window,
      per decade of time, `.drift_error`, `.verdict` (`"converged"`, `"drifting"`, `"undecided"`).
    - `beside_constant`: `Exponent` gamma of A t^gamma + B, with what waves localised since long leave as the constant;
      its drift is that from the whole window to its second half.
    - `local_exponent` (T,): d log(moment)/d log t, of seven neighbouring times; `local_error`.
    - `window` (from, to) [s]. `moments`, `participations` (samples, T): of each sample. `sites`: of the chains.
    - `reached`: what the outermost cells add to the second moment at the end, relative to it, at most. `energy_error`:
      the largest relative change of a sample's energy; zero is kept to what the steps allow.
    """

    held: ClassVar[dict[str, Held]] = {
        "times": Held("time", "s", "time"), "moment": Held("time", "1"), "moment_error": Held("time", "1"),
        "participation": Held("time", "1"), "participation_error": Held("time", "1"),
        "local_exponent": Held("time", "1"), "local_error": Held("time", "1"), "window": Held(None, "s"),
        "moments": Held("sample time", "1"), "participations": Held("sample time", "1"),
    }
    times: Float[np.ndarray, " T"]
    moments: Float[np.ndarray, "S T"]
    participations: Float[np.ndarray, "S T"]
    window: tuple[float, float]
    exponent: Exponent
    participation_exponent: Exponent
    beside_constant: Exponent
    local_exponent: Float[np.ndarray, " T"]
    local_error: Float[np.ndarray, " T"]
    sites: int
    reached: float
    energy_error: float
    lost: int

    @property
    def samples(self) -> int:
        """How many chains there were."""
        return len(self.moments)

    @property
    def moment(self) -> Float[np.ndarray, " T"]:
        """Second moment of the energy, the mean over samples [sites^2]."""
        return self.moments.mean(0)

    @property
    def moment_error(self) -> Float[np.ndarray, " T"]:
        """Standard error of `moment`."""
        return _standard_error(self.moments)

    @property
    def participation(self) -> Float[np.ndarray, " T"]:
        """Participation number of the energy, the mean over samples."""
        return self.participations.mean(0)

    @property
    def participation_error(self) -> Float[np.ndarray, " T"]:
        """Standard error of `participation`."""
        return _standard_error(self.participations)

    @property
    def verdict(self) -> str:
        """That of the second moment's exponent."""
        return self.exponent.verdict

    @property
    def outcome(self) -> str:
        """The exponents, whether they have converged, from how much, and whether the chains were long enough."""
        begin, end = (self._told("window", x) for x in self.window)
        value, error = self.beside_constant[:2]
        beside = "" if self.verdict == CONVERGED else f", beside a constant t^({value:.2f} +- {error:.1g})"
        said = (f"Second moment ~ t^{self.exponent}{beside}; participation ~ t^{self.participation_exponent}; from "
                f"{self.samples} samples of {self.sites} sites, {begin} < t < {end}.")
        lost = f" {self.lost} more did not complete." if self.lost else ""
        ends = "" if self.reached <= REACHED else f" WAVES HAVE REACHED THE ENDS, {_LONGER}."
        return f"{said}{lost}{ends} Energy kept to {self.energy_error:.1g}."

    def within(self, window: Parameter) -> "Spreading":
        """The same, its exponents fitted in another window (from, to) of times [s]."""
        window = _window(window, self.times)
        return dataclasses.replace(self, window=window, **_exponents(self.times, self.moments, self.participations,
                                                                     window))


_LONGER = "which adds to the second moment: take longer chains or an earlier end"


class _Sample(eqx.Module):
    """One sample: second moment and participation at some times, by its seed. Equal ones compile once."""

    scene: Callable = eqx.field(static=True)
    times: tuple[float, ...] = eqx.field(static=True)
    kick: str | Callable = eqx.field(static=True)
    amplitude: float = eqx.field(static=True)
    site: int | None = eqx.field(static=True)
    solver: diffrax.AbstractSolver = eqx.field(static=True)
    step: float | None = eqx.field(static=True)

    def __call__(self, seed):
        lattice = _chain(self.scene(seed))
        state = _kicked(lattice, self.kick, self.amplitude, self.site)
        run = simulate(lattice, state, self.times[-1], solver=self.solver, step=self.step,
                       save_at=np.asarray(self.times), throw=None)

        def measured(frame):
            y = State(*frame)
            e = sum(jax.tree.leaves(site_energy(lattice, y)))
            n = jnp.arange(e.shape[0], dtype=e.dtype)
            share = e / e.sum()
            centre = (n * share).sum()
            moment = ((n - centre) ** 2 * share).sum()
            edge = max(2, e.shape[0] // 100)
            outer = ((n - centre) ** 2 * share * ((n < edge) | (n >= e.shape[0] - edge))).sum()
            return moment, participation(e), outer / moment, energy(lattice, y)

        moment, shared, outer, total = jax.lax.map(measured, (run.us, run.vs))
        start = energy(lattice, state)
        return {"moment": moment, "participation": shared, "reached": outer[-1],
                "energy_error": jnp.abs(total / start - 1).max()}


def spreading(
    scene: Scene, t1: Scalar, *, samples: Count = 1000, seed: Count = 0, kick: str | Callable = "velocity",
    amplitude: Scalar = 1.0, site: Count | None = None, window: Parameter | None = None, frames: Count = 40,
    solver: diffrax.AbstractSolver | None = None, step: Scalar | None = None, chunk: Count | None = None,
    progress: bool = True, throw: bool = True,
) -> Spreading:
    r"""How a kick spreads along disordered chains: second moment and participation of energy, the mean of many.

    m2(t) = <sum (n - n_c)^2 e_n/sum e_n> ~ t^gamma and P(t) = <(sum e_n)^2/sum e_n^2> ~ t^eta, with n_c the centre of
    the energy. An ordered chain has gamma = 2; a linear chain of random masses 3/2 after a kick of momentum and 1/2
    after a displacement, because of the long waves that disorder does not stop; a sonic vacuum 1.7 after long times.

    `gx.studies.spreading(lambda seed: gx.scenes.disordered(3000, 0.8, seed, law=gx.Linear), 1200.0, samples=200)`, and
    `gx.plots.spreading` of what it returns.

    **Arguments:**

    - `scene`: a function of a seed (a whole number, traced) that returns a `Lattice`, a chain of any law and kind.
    - `t1`: until when. Chains must be so long that nothing reaches their ends: 2 t1 times the speed, and some.
    - `samples`: how many, of the seeds from `seed` on.
    - `kick`: `"velocity"` or `"displacement"` of one site, of size `amplitude`; or a function of the lattice that
      returns a `State`. `site`: the kicked one, by default in the middle. In a linear chain the size does not matter.
    - `window`: (from, to) of the fit; by default (t1/8, t1). `frames`: how many times, evenly spaced in log t.
    - `solver`, `step`: as in `simulate`; by default SRKN6b; its energy error is told.
    - `chunk`: samples at a time, as in `gx.sweep`, by which every core is used; memory holds frames * sites * chunk
      numbers per core. `progress`: a bar with the time left.
    - `throw`: raise where waves reached the ends.

    **Returns:** `Spreading`. The exponent is the slope of log m2 over log t in the window. A slope still drifts where
    it was fitted too early, however small its standard error: `exponent.drift` is the change between the halves of the
    window, per decade of time. Its verdict is `"drifting"` where that is known to be more than 0.075, `"converged"`
    where it is known to be less (twice its error counted), else `"undecided"`.
    A chain that floats freely keeps the energy of its mean motion, p^2/(2 M): nothing in a long chain, all in a short
    one.
    **Raises** ValueError for what is no chain, a window outside the times, fewer than two samples; RuntimeError where
    waves reached the ends, or no sample completed.
    Measured, 1000 samples of binary masses each, on two cores: kick of momentum, spread 0.7, 2300 sites, t1 = 1000:
    1.524 +- 0.003, the slope falling by 0.04 per decade to 1.514 at the end, in 2 minutes; displacement, spread 0.9,
    2740 sites, t1 = 1200: 0.684 +- 0.007, which has not converged (0.62 at the end, falling by 0.2 per decade), beside
    a constant 0.55 +- 0.02, with 300 < t 0.51 +- 0.04, in 6 minutes. Sonic vacuum, uniform masses of spread 0.5, 900
    sites, t1 = 600, kick of momentum: local exponents between 1.95 and 2.05 that have not converged, in 4 minutes; the
    same precompressed, F0 = 1, velocity 0.5, 1800 sites: 1.596 +- 0.001, 1.554 at the end and falling, in 3 minutes.
    Source: Datta, Kundu, Phys. Rev. B 51, 6287 (1995); Martinez, Kevrekidis, Porter, Phys. Rev. E 93, 022902 (2016);
    Kim et al., Nat. Commun. 9, 640 (2018).
    """
    t1 = float(positive("t1", t1, "It is the end of the runs."))
    samples, frames = whole("samples", samples, 2), whole("frames", frames, 12)
    amplitude = float(parameter("amplitude", amplitude))
    if amplitude == 0:
        refuse("amplitude", "a number that is not zero", "0", "Nothing would move.")
    if isinstance(kick, str):
        one_of("kick", kick, KICKS)
    solver = SRKN6b() if solver is None else solver
    step = None if step is None else float(positive("step", step))
    times = t1 * np.geomspace(1 / 64, 1, frames)
    window = _window((t1 / 8, t1) if window is None else window, times)
    lattice = _chain(scene(seed))
    _kicked(lattice, kick, amplitude, site)
    sites = lattice.shape[0] if lattice.fields is None else next(iter(lattice.shape.values()))[0]
    own = _Sample(scene, tuple(times.tolist()), kick, amplitude, None if site is None else int(site), solver, step)
    data = sweep(own, {"seed": np.arange(seed, seed + samples)}, chunk=chunk, progress=progress)
    moments, shared = (data[name].values for name in ("moment", "participation"))
    good = np.isfinite(moments).all(1)
    if good.sum() < 2:
        raise RuntimeError(f"No two samples completed. The first: {data['reason'].values[~good][0]}")
    reached, kept = (float(data[name].values[good].max()) for name in ("reached", "energy_error"))
    moments, shared = moments[good], shared[good]
    found = Spreading(times, moments, shared, window, **_exponents(times, moments, shared, window), sites=int(sites),
                      reached=reached, energy_error=kept, lost=int((~good).sum()), **lattice.origin)
    if throw and reached > REACHED:
        raise RuntimeError(f"Waves have reached the ends of {sites} sites, {_LONGER}, or throw=False.")
    return found


def _chain(lattice):
    if not isinstance(lattice, Lattice):
        refuse("scene", "a function of a seed that returns a Lattice", f"one that returned {described(lattice)}")
    if lattice.axes != 1:
        refuse("scene", "a chain", f"sites {lattice.sites}")
    return lattice


def _kicked(lattice, kick, amplitude, site):
    """The state that a kick makes; of a cell of several fields the first one moves."""
    if callable(kick):
        return State(*kick(lattice))
    u, v = lattice.zeros(), lattice.zeros()
    moved = u if kick == "displacement" else v
    first = moved if lattice.fields is None else moved[lattice.fields[0]]
    count = first.shape[0]
    site = count // 2 if site is None else site
    if not -count <= site < count:
        refuse("site", f"a site from 0 to {count - 1}, or negative from the end", f"{site}")
    first = first.at[site].set(amplitude)
    moved = first if lattice.fields is None else {**moved, lattice.fields[0]: first}
    return State(moved, v) if kick == "displacement" else State(u, moved)


def _window(window, times):
    begin, end = (float(x) for x in np.asarray(window, float).reshape(-1)[:2]) if np.size(window) == 2 else (1.0, 0.0)
    inside = (times >= begin * (1 - 1e-9)) & (times <= end * (1 + 1e-9))
    if inside.sum() < 2 * LEAST:
        refuse("window", f"(from, to) with {2 * LEAST} of the times from {show(times[0])} to {show(times[-1])} in it",
               f"{show(window)}", "More frames, or a wider one.")
    return begin, end


def _exponents(times, moments, shared, window):
    """The two exponents and the local one, with what the bootstrap says of them."""
    inside = (times >= window[0] * (1 - 1e-9)) & (times <= window[1] * (1 + 1e-9))
    samples = len(moments)
    weights = np.random.default_rng(0).multinomial(samples, np.full(samples, 1 / samples), DRAWS) / samples
    moments, shared = (np.concatenate([x.mean(0)[None], weights @ x]) for x in (moments, shared))
    log_t, half = np.log(times[inside]), int(inside.sum()) // 2

    def exponent(of, y, early):
        """Of the first row, with errors from the others; it drifts from the `early` part to the second half."""
        late, first = log_t[-half:], log_t[early]
        decades = (late.mean() - first.mean()) / math.log(10)
        value = of(log_t, y[:, inside])
        drift = (of(late, y[:, inside][:, -half:]) - of(first, y[:, inside][:, early])) / decades
        return Exponent(*map(float, (value[0], value[1:].std(ddof=1), drift[0], drift[1:].std(ddof=1))))

    halves = slice(0, half)
    local = _local(np.log(times), np.log(moments))
    return dict(
        exponent=exponent(_slopes, np.log(moments), halves),
        participation_exponent=exponent(_slopes, np.log(shared), halves),
        beside_constant=exponent(_beside_constant, moments, slice(None)),
        local_exponent=local[0], local_error=local[1:].std(0, ddof=1),
    )


def _slopes(x, y):
    x = x - x.mean()
    return y @ x / (x @ x)


def _beside_constant(x, y):
    """gamma of A t^gamma + B, x = log t, by least squares of relative deviations; a fit for each row of y."""
    weight = 1 / y[0]
    basis = np.stack([np.exp(GRID[:, None] * (x - x[-1])), np.ones((len(GRID), len(x)))], -1) * weight[:, None]
    basis = np.linalg.qr(basis)[0]
    seen = np.einsum("gka,dk->gda", basis, y * weight)
    left = ((y * weight) ** 2).sum(1) - (seen**2).sum(-1)
    least = np.clip(left.argmin(0), 1, len(GRID) - 2)
    before, here, after = (left[least + k, np.arange(len(y))] for k in (-1, 0, 1))
    bend = before - 2 * here + after
    return GRID[least] + (GRID[1] - GRID[0]) * np.where(bend > 0, (before - after) / np.where(bend > 0, 2 * bend, 1), 0)


def _local(x, y):
    """Slopes about each place, of it and what lies within `BESIDE` of it."""
    places = [slice(max(i - BESIDE, 0), i + BESIDE + 1) for i in range(len(x))]
    return np.stack([_slopes(x[at], y[:, at]) for at in places], 1)


def _standard_error(values):
    return values.std(0, ddof=1) / math.sqrt(len(values))
