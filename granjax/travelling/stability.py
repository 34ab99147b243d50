"""The stability of solitary waves, as fixed points of "run for 1/c, then shift by one site"."""

from dataclasses import fields
from typing import Any

import jax.numpy as jnp
import numpy as np
import scipy

from ..base.checks import one_of, refuse
from ..base.types import Count, Scalar, StateLike
from ..base.units import SCALED
from ..flow import Flow
from ..lattice import Lattice, State
from ..laws import Strained
from ..orbits import Orbit, Translation, orbit
from ..orbits.floquet import STABLE, UNDECIDED, Floquet, decide
from ..orbits.spectrum import known_spectrum
from ..profiles.medium import values
from ..results import hidden
from ..solvers import KahanLi8
from ..strains import Shift
from ..terms import Bond, Term

# The default strain, over the peak, half-way round a ring.
CLOSED = 1e-10
# The least number of sites where none is given.
SHORTEST = 12
# The largest number of sites where none is given.
LONGEST = 200
# The number of wave numbers at which the essential spectrum is computed.
WAVES = 256
# With held ends: the growth rate of the norm per contact where there is no sound.
RATE = 1.0
# With held ends: the number of steps at first.
STEPS = 64
# With held ends: the largest number of steps.
MOST = 2048
# With held ends: the relative change of the matrix at which the steps suffice.
KNOWN = 1e-7


def free_chain(wave: Any, sites: Count, *others: Term) -> Lattice:
    """Return the wave's chain with free ends, and other terms."""
    terms = Bond(Shift(1, "free"), wave.law), *others
    return Lattice(wave.mass, terms, sites=sites, units=wave.units or SCALED)


def ring(wave: Any, sites: Count | None = None) -> tuple[Lattice, State]:
    """Return a ring in which a wave runs, and its state with the wave in the middle.

    The wave shortens the ring by its compression. At rest, every bond therefore has the mean strain
    s = compression/sites and the law F(e + s) - F(s). Displacements measured from there are
    periodic, and a shift by one site is a symmetry. The ring's own wave differs by about the strain
    of the tail half-way round.

    **Arguments:** `sites`: with `None`, the strain half-way round is 1e-10 of the peak.
    **Raises** ValueError where more than 200 sites are needed (a wave little faster than sound).
    """
    sites = _sites_of(wave) if sites is None else sites
    s = wave.compression / sites
    centre = sites // 2
    # The mean of the strains themselves equals that of the integral up to the cut tail.
    xi = np.arange(sites) - centre
    e = jnp.asarray(wave.strain(xi)) - s
    e = e - e.mean()
    u = jnp.concatenate([jnp.zeros(1), -jnp.cumsum(e)[:-1]])
    lattice = Lattice(
        wave.mass,
        Bond(Shift(1, "periodic"), Strained(wave.law, s)),
        sites=sites,
        units=wave.units or SCALED,
    )
    v = wave.velocity(xi)
    return lattice, State(u - u.mean(), v - v.mean())


def _sites_of(wave):
    peak = abs(float(wave.amplitude))
    strains = np.abs(np.asarray(wave.strain(np.arange(LONGEST // 2 + 1.0))))
    small = strains < CLOSED * peak
    if not small[-1]:
        refuse(
            "sites",
            f"a number of sites, as the tail needs a ring of more than {LONGEST}",
            "None",
            "Give one; the matrix has twice as many rows, and the ring's wave is another one.",
        )
    return max(SHORTEST, 2 * int(np.argmax(small)))


def wave_orbit(lattice: Lattice, guess: StateLike, speed: Scalar, **keywords: Any) -> Orbit:
    r"""Find a wave of any ring by Newton's method, as a fixed point y(1/c) = S y(0).

    S is the shift by one site. The lattice may have any terms: further neighbours, on-site forces,
    user-defined terms. `orbit.floquet()` gives the stability.

    **Arguments:** `lattice`: a ring of equal cells. `guess`: a nearby state, such as that of
    `ring(wave)` or of a similar lattice. `speed`: c [sites per time], negative to the left.
    `keywords`: of `gx.orbits.orbit`.
    **Returns:** `Orbit`. **Raises** as `gx.orbits.orbit` does, and ValueError for a speed of zero.
    """
    return orbit(
        lattice, guess, 1 / abs(speed), symmetry=Translation(1 if speed > 0 else -1), **keywords
    )


class WaveStability(Floquet):
    """The `Floquet` that `stability` returns, and the ring or the chain of the computation."""

    sites: int = hidden("The number of sites of the ring or the chain.", static=True, kw_only=True)
    bound: float = hidden(
        "The bound on all multipliers but two with held ends; 0 on a ring.", kw_only=True
    )
    ring: Floquet | None = hidden(
        "The result on the ring, where held ends decided the verdict.", default=None, kw_only=True
    )
    held: Floquet | None = hidden(
        "The result with held ends, where they decided the verdict.", default=None, kw_only=True
    )
    essential: np.ndarray = hidden(
        "The essential spectrum: multipliers of small waves far from this wave on the infinite "
        "chain, in the norm that was used.",
        kw_only=True,
    )

    @property
    def point(self) -> np.ndarray:
        """The wave's own multipliers: outside the essential spectrum by more than their errors.

        Those of a ring that are absent with held ends belong to small waves that run round it.
        """
        own = self.held or self
        beyond = np.abs(own.multipliers) > np.abs(own.essential).max() + own.error
        return own.multipliers[beyond]

    @property
    def outcome(self) -> str:
        """The ring or chain that was used, and the reason for the verdict."""
        if self.bound:
            place = f"On a chain of {self.sites} sites with held ends:"
            if self.bound >= 1:
                return f"{place} {super().outcome}"
            return (
                f"{place} every perturbation that does not change the place or the speed falls behind "
                f"the wave, since all other multipliers are below {self.bound:.4g} in modulus. "
                "2 multipliers at +1 are those of symmetry."
            )
        place = f"On a ring of {self.sites} sites:"
        if self.ring is None:
            return f"{place} {super().outcome}"
        grow = "Small waves that run round the ring and meet the wave again make some grow."
        fewer = len(self.unstable) < len(self.ring.unstable)
        return f"{place} {self.ring.outcome} {f'{grow} ' if fewer else ''}{self.held.outcome}"


def stability(
    wave: Any, sites: Count | None = None, ends: str | None = None, **keywords: Any
) -> WaveStability:
    r"""Compute the Floquet multipliers of a wave: the eigenvalues of S^-1 D y(1/c), with a verdict.

    S is the shift by one site.

    - `ends="ring"`: the wave is placed on a `ring`, refined by Newton's method and judged as any
      orbit is, with Krein signatures and four multipliers at +1 (phase and energy, displacement and
      momentum). The continuous spectrum is a set of points on or near the unit circle. Small waves
      run round the ring and meet the wave again. Some of them grow by this, more slowly the longer
      the ring is. Where a multiplier lies outside the circle, held ends therefore decide, and the
      `error` includes the growth due to the ring.
    - `ends="held"`: the far states are held: at every shift a bead at rest enters ahead and one is
      dropped behind. Two multipliers are at +1 (place and speed). Those of the waves left behind
      lie inside the circle, in a norm that grows ahead of the wave (Pego and Weinstein). There are
      no signatures. Without sound, perturbations behind the wave stay or drift, and would meet it
      again on a ring.

    Where dE/dc passes zero along a family, one pair leaves +1 (Friesecke and Pego, Nonlinearity 17,
    207 (2004); Cuevas-Maraver and others, Phys. Rev. E 96, 032214 (2017)).

    **Arguments:** `wave`: of `solitary_wave`. `sites`: of ring or chain; `None`: by the tail.
    `ends`: `None` is "ring" where there is sound, "held" elsewhere. `keywords`: of
    `gx.floquet.floquet`, on a ring.
    **Returns:** `WaveStability`. **Raises** as `ring` and `wave_orbit` do.

    **Example:**

    >>> wave = gx.travelling.solitary_wave(gx.Hertz(), speed=1.0)
    >>> gx.travelling.stability(wave).verdict
    'stable'
    """
    ends = ("ring" if np.isfinite(float(wave.decay)) else "held") if ends is None else ends
    if one_of("ends", ends, ("ring", "held")) == "ring":
        lattice, state = ring(wave, sites)
        found = wave_orbit(lattice, state, float(wave.speed)).floquet(**keywords)
        return _judged(found, wave, lattice.shape[0])
    if keywords:
        refuse(
            "keywords",
            "none where the far states are held",
            ", ".join(keywords),
            'Use them with ends="ring".',
        )
    return _held(wave, _sites_of(wave) if sites is None else sites)


def _judged(found, wave, sites):
    told = {field.name: getattr(found, field.name) for field in fields(found)}
    told |= {"sites": sites, "bound": 0.0, "essential": _essential(wave, 0.0)}
    if found.verdict == STABLE:
        return WaveStability(**told)
    held = _held(wave, sites)
    rho = found.multipliers
    # The wave's own multipliers and their inverses. All others off the circle are due to the ring.
    growing = held.multipliers[held.unstable]
    waves = np.abs(rho[:, None] - np.concatenate([growing, 1 / growing])).argmin(0)
    own = np.setdiff1d(np.arange(len(rho)) if held.verdict != UNDECIDED else [], waves).astype(int)
    error = found.error.copy()
    error[own] = np.maximum(error[own], np.abs(np.abs(rho[own]) - 1))
    told |= {"error": error, "verdict": held.verdict, "ring": found, "held": held}
    return WaveStability(**told)


def _held(wave, sites):
    lattice = free_chain(wave, sites)
    state = wave.state(sites)
    period = 1 / abs(float(wave.speed))
    way = 1 if float(wave.speed) > 0 else -1
    decay = float(wave.decay)
    rate = decay / 2 if np.isfinite(decay) else RATE
    weights = np.exp(rate * (np.arange(sites) - (sites - 2) / 2) * way)
    weights = np.concatenate([weights, weights * period / (2 * np.pi)])
    back = np.kron(np.eye(2), np.eye(sites, k=way))

    def monodromy(steps):
        factor = Flow(np.int64(steps), KahanLi8()).derivative(state, 0.0, period, lattice)[1]
        return (back @ np.asarray(factor)) * weights[:, None] / weights

    steps = STEPS
    coarse = monodromy(STEPS // 2)
    fine = monodromy(STEPS)
    while np.abs(fine - coarse).max() > KNOWN * np.abs(fine).max() and steps < MOST:
        steps = 2 * steps
        coarse = fine
        fine = monodromy(steps)
    about = float(np.linalg.norm(fine - coarse)) + 1e-14 * float(np.linalg.norm(fine))
    multipliers, vectors, error = known_spectrum(fine, coarse, about, 0.0)
    radius = _radius(fine, about)
    pair = np.argsort(np.abs(multipliers - 1))[:2]
    inside = np.setdiff1d(np.arange(len(multipliers)), pair)
    verdict = decide(multipliers, error, 2, False)
    if radius < 1:
        error[inside] = np.minimum(error[inside], np.abs(multipliers[inside]) + radius)
        verdict = STABLE
    unsigned = np.full(len(multipliers), np.nan)
    return WaveStability(
        fine / weights[:, None] * weights,
        multipliers,
        vectors / weights[:, None],
        error,
        unsigned,
        np.nan,
        about,
        2,
        verdict,
        period,
        int(steps),
        None,
        state,
        sites=sites,
        bound=radius,
        essential=_essential(wave, rate),
        **lattice.origin,
    )


def _essential(wave, rate):
    # Return exp(i (k - omega(k)/c)) of both directions, at complex wave numbers k + i rate.
    k = 2 * np.pi * np.arange(WAVES) / WAVES + 1j * rate
    stiffness = values(wave.law, np.zeros(1))[1][0]
    omega = 2 * np.sqrt(stiffness / float(wave.mass)) * np.sin(k / 2)
    turns = omega / abs(float(wave.speed))
    return np.exp(1j * (k - np.stack([turns, -turns])))


def _radius(matrix, about):
    """Bound all multipliers but the two nearest +1, of every matrix within `about` of this one.

    In the norm x* P x, with R* P R + r^2 = r^2 P, the rest R shrinks by r (1 - 1/|P|)^{1/2}.
    """
    rho = np.linalg.eigvals(matrix)
    apart = np.sort(np.abs(rho - 1))[1:3].mean()
    triangle, _, count = scipy.linalg.schur(
        matrix, output="complex", sort=lambda x: abs(x - 1) < apart
    )
    rest = triangle[count:, count:]
    r = (1 + np.abs(np.diag(rest)).max(initial=0)) / 2
    if count != 2 or not r < 1:
        return np.inf
    norm = scipy.linalg.solve_discrete_lyapunov(rest.conj().T / r, np.eye(len(rest)))
    low, high = np.linalg.eigvalsh(norm)[[0, -1]]
    # The residual of the numerical solution is subtracted.
    shrinks = np.linalg.eigvalsh(norm - rest.conj().T @ norm @ rest / r**2)[0] / high
    if not (low > 0 and shrinks > 0):
        return np.inf
    # The angle between the two subspaces: their coupling over the gap of their eigenvalues.
    tilt = 1 + np.linalg.norm(triangle[:count, count:]) / apart
    return float(r * np.sqrt(1 - shrinks) + np.sqrt(high / low) * tilt * about)
