"""Breathers of k-gaps: waves that grow, saturate and return, localised in time."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import scipy
from diffrax import AbstractSolver

from ..base.arrays import trailing
from ..base.checks import positive, refuse
from ..base.programs import bar, compiled
from ..base.tuning import one_thread
from ..base.types import Count, Displacements, Numbers, Scalar
from ..flow import Flow
from ..lattice import Lattice, State
from ..linear import floquet_bands
from ..results import Result, array
from ..solvers import KahanLi8
from .asked import default_steps, fixed_step_solver, known_lattice, largest, largest_of_each
from .floquet import raveled
from .scales import last_near

# The peak over the first amplitude.
BEGIN = 50.0
# The factor by which a default start may be off.
WIDE = 4.0
# Periods beyond those that growth alone takes.
MORE = 24
# The most periods.
MOST = 20_000
# Periods per call of the program.
PIECE = 16
# Searches for the start.
SEARCHES = 12
# Doublings of the steps.
DOUBLINGS = 4
# The relative accuracy of the amplitude at which a search ends.
RETURNED = 1e-11
# The relative error of the energy that a breather may have. A wave with a larger one breaks up.
RETURNS = 1e-3


class GapBreather(Result):
    """A wave of a k-gap that grows, saturates by nonlinearity, and returns.

    It is periodic in space and localised in time.
    """

    ts: Numbers = array("The times, once a period.", "s", "time")
    us: Displacements = array("The displacements at these times.", "m", "time site ...")
    vs: Displacements = array("The velocities at these times.", "m/s", "time site ...")
    energy: Numbers = array("The energy at these times.", "J", "time")
    amplitude: Numbers = array("The largest displacement at these times.", "m", "time")
    k: float = array("The wave number.", "rad")
    growth: float = array("The growth rate log|rho|/T of the linear wave.", "1/s")
    returned: float = array("The energy at the end over that at the start, minus 1.", "1")
    error: float = array("The error of `returned`, from two step sizes.", "1")
    stray: float = array(
        "The share of the state at the end that is not the decaying linear wave (norm over norm).",
        "1",
    )
    period: float = array("The period of the modulation.", "s")
    steps: int = array("The number of steps of a period.")

    @property
    def outcome(self) -> str:
        """How far it grew, and how much of it returned."""
        off = abs(self.returned)
        # A motion that is not finite does not return either.
        breaks_up = not max(off, self.error) <= RETURNS
        return (
            f"The energy grew {self.energy.max() / self.energy[0]:.4g} times and returned within {off:.1e} +- "
            f"{self.error:.1e} of itself after {len(self.ts) - 1} periods; {self.stray:.1e} of what returned is other "
            f"waves.{' It breaks up: other waves took part.' * breaks_up}"
        )

    @property
    def peak(self) -> float:
        """The largest displacement, taken once a period [m]."""
        return float(np.max(self.amplitude))

    @property
    def state(self) -> State:
        """The first state."""
        return State(*jax.tree.map(lambda x: jnp.asarray(x[0]), (self.us, self.vs)))


@one_thread
def k_gap_breather(
    lattice: Lattice,
    period: Scalar,
    k: Scalar | None = None,
    *,
    amplitude: Scalar | None = None,
    t0: Scalar = 0.0,
    steps: Count | None = None,
    solver: AbstractSolver | None = None,
    tolerance: Scalar = 1e-5,
    progress: bool = True,
) -> GapBreather:
    r"""Find a wavenumber-gap breather of a modulated ring.

    It grows out of a k-gap as exp(growth t), saturates and returns. It begins on the growing linear
    wave, u = a Re(w exp(i k n)). At larger amplitude the wave becomes stiffer or softer and leaves
    the resonance, and it returns along the decaying wave. Among the amplitudes of one period's
    growth, the one is taken whose energy, once a period, returns to its first value.

    **Arguments:**

    - `lattice`: a ring with modulated stiffness and a nonlinear force, without losses. `period`: T
      of the modulation.
    - `k`: phase per cell [rad], one that the ring allows; `None`: the one that grows fastest.
    - `amplitude`: a, approximately [m]; `None`: about 1/50 of the peak. The time each way is
      proportional to log(peak/a).
    - `t0`: the phase of the period at which it begins. `steps`: per period; `None` doubles them
      until `returned` is known to `tolerance`. `solver`: KahanLi8 by default (Dopri8 where a force
      reads velocities). `progress`: show a bar for each run of the search, with the time left,
      after two seconds.

    **Returns:** `GapBreather`; radiation into other waves shows in `stray`.
    **Raises** ValueError for a k outside every k-gap, a lattice that is not a ring or is linear, a
    batch, and a motion that never returns (damped, or with contacts that open for good).
    Source: Chong, Kim, Wallace, Daraio, Phys. Rev. Res. 6, 023045 (2024).

    **Example:**

    >>> ring = gx.scenes.modulated(6, 0.3, 2.0, law=gx.Polynomial(1.0, 0.0, 1.0))
    >>> found = gx.breathers.k_gap_breather(ring, np.pi, np.pi / 3, amplitude=0.1, steps=64, tolerance=1e-2)
    >>> bool(abs(found.returned) < 1e-2), len(found.ts)
    (True, 19)
    """
    known_lattice(lattice)
    period = float(positive("period", period))
    t0 = float(t0)
    solver = fixed_step_solver(lattice, solver, KahanLi8())
    ring = _ring(lattice, k, period, t0, solver, progress)
    count = 2 * int(default_steps(lattice, period, doubled=True)) if steps is None else steps
    size = ring.size()
    ring.check(1e-4 * size, count)
    found = ring.returning(size if amplitude is None else float(amplitude), count)
    for _ in range(SEARCHES if amplitude is None else 0):
        begin = found.peak / BEGIN
        near = 1 / WIDE <= begin / found.begin <= WIDE
        found = ring.returning(begin, count)
        if near:
            break
    for i in range(DOUBLINGS):
        found = ring.sought(found, count)
        finer = ring.run(found.begin, 2 * count, found.periods)
        error = abs(finer.returned - found.returned)
        if error <= tolerance or steps is not None or i == DOUBLINGS - 1:
            break
        count *= 2
        found = ring.returning(found.begin, count)
    return GapBreather(
        t0 + period * np.arange(found.periods + 1),
        *found.states,
        found.energy,
        largest_of_each(found.states.u),
        ring.k,
        ring.growth,
        found.returned,
        float(error),
        ring.stray(jax.tree.map(lambda x: x[-1], found.states)),
        period,
        int(count),
        **lattice.origin,
    )


class _Motion(NamedTuple):
    # States and energies once a period, and the largest displacement.

    begin: float
    states: State
    energy: np.ndarray
    peak: float

    @property
    def periods(self):
        return len(self.energy) - 1

    @property
    def returned(self):
        return float(self.energy[-1] / self.energy[0] - 1)


class _Ring(NamedTuple):
    # A ring and its waves of one wave number: `up` grows by `rho` a period, `down` decays.

    lattice: Lattice
    period: float
    t0: float
    solver: AbstractSolver
    progress: bool
    k: float
    growth: float
    rho: complex
    up: State
    down: State

    def state(self, amplitude, factor=1.0):
        part = lambda x: jnp.asarray((amplitude * factor * x).real, self.lattice.dtype)
        return jax.tree.map(part, self.up)

    def run(self, begin, steps, periods):
        flow = Flow(jnp.asarray(steps), self.solver)
        parts = []
        state = self.state(begin)
        times = jnp.asarray(self.t0), jnp.asarray(self.period)
        with bar(periods, "period", "k-gap breather", self.progress) as shown:
            for _ in range(periods // PIECE + 1):
                state, part = _strobed(flow, self.lattice, state, *times)
                parts.append(jax.tree.map(np.asarray, part))
                shown.update(PIECE)
        states, energy = jax.tree.map(lambda *x: np.concatenate(x)[: periods + 1], *parts)
        return _Motion(begin, states, energy, largest(states.u))

    def check(self, tiny, steps):
        # A lattice with ends does not multiply the wave by rho.
        us = self.run(tiny, steps, 1).states.u
        want = self.state(tiny, self.rho).u
        begin = self.state(tiny).u
        pairs = zip(*(jax.tree.leaves(x) for x in (us, want, begin)))
        off = max(np.abs(x[1] - w).max() / np.abs(b).max() for x, w, b in pairs)
        # The share of a wave by which a period of the ring may miss its multiplier.
        if not off <= 1e-6 + 1e-2 * abs(abs(self.rho) - 1):
            refuse(
                "lattice",
                "a ring, on which a wave of the k-gap grows as its multiplier says",
                f"one on which it misses that by {off:.1e}",
                'Build it with boundary="periodic".',
            )

    def size(self):
        # About 1/50 of the amplitude at which the force is nonlinear enough for the wave to leave
        # the gap.
        u = self.state(1.0).u
        wanted = min(0.5, 2 * self.growth * self.period / np.pi)
        share = lambda sizes: np.asarray(_departure(self.lattice, u, jnp.asarray(self.t0), sizes))
        size = last_near(lambda sizes: share(sizes) < wanted, self.lattice.dtype)
        if not 0 < size < np.inf:
            refuse(
                "lattice",
                "a force that is nonlinear for this wave, by which growth saturates",
                "a linear one",
                "Waves of its k-gaps grow without bound: gx.linear.floquet_bands has their rates.",
            )
        return size / BEGIN

    def returning(self, begin, steps):
        # Runs until the energy, once a period, is nearest to that of the start.
        periods = int(2 * np.log(WIDE * BEGIN) / (self.growth * self.period)) + MORE
        while True:
            found = self.run(begin, steps, periods)
            energy = found.energy
            if not np.isfinite(energy).all():
                refuse(
                    "amplitude",
                    "a wave that saturates",
                    f"one that overflows from {begin:.3g}",
                    "Where the force softens, or contacts open, there is no breather of this k-gap; "
                    "where other waves took part, begin with a larger amplitude.",
                )
            # Where it first halves, before other waves may grow further.
            high = int(np.argmax(energy < 0.5 * np.maximum.accumulate(energy)))
            low = np.flatnonzero(energy[high:] <= energy[0]) + high
            grew = energy.max() > 4 * energy[0]
            if grew and high and len(low):
                here, before = (abs(np.log(energy[low[0] - i] / energy[0])) for i in (0, 1))
                end = int(low[0] - (before < here)) + 1
                states = jax.tree.map(lambda x: x[:end], found.states)
                return found._replace(states=states, energy=energy[:end])
            if periods >= MOST or grew and periods > 8 * high + MORE:
                least = energy[high:].min() / energy[0] if high else np.nan
                refuse(
                    "lattice",
                    "a motion that returns to the energy that it began with",
                    f"one that stays above {least:.3g} of it",
                    "Losses or other waves took part: take losses away, or begin with a larger amplitude.",
                )
            periods *= 2

    def sought(self, found, steps):
        # Varies the amplitude at a fixed number of periods until the energy returns to its first
        # value.
        tried = [found]

        def miss(logarithm):
            tried.append(self.run(np.exp(logarithm), steps, found.periods))
            return np.log1p(tried[-1].returned)

        # A larger start is ahead: the energy at the start is more, and that at the same time of its
        # return is less.
        begin = np.log(found.begin)
        step = np.clip(np.log1p(found.returned) / 4, -0.7, 0.7)
        scipy.optimize.root_scalar(
            miss, method="secant", x0=begin, x1=begin + step, xtol=RETURNED, maxiter=SEARCHES
        )
        return min(tried, key=lambda motion: abs(motion.returned))

    def stray(self, end):
        # The state minus the decaying wave times the complex number that fits best.
        scale = self.period / (2 * np.pi)
        flat = lambda y: raveled((y[0], jax.tree.map(lambda v: scale * v, y[1])))
        wave = flat(self.down)
        y = flat(end)
        basis = np.stack([wave.real, wave.imag], -1)
        rest = y - basis @ np.linalg.lstsq(basis, y, rcond=None)[0]
        return float(np.linalg.norm(rest) / np.linalg.norm(y))


def _ring(lattice, k, period, t0, solver, progress):
    # At the given wave number, or where the waves grow fastest.
    cell = floquet_bands(lattice, 0.0, period, t0=t0, steps=16).cell[0]
    sites = np.arange(jax.tree.leaves(lattice.template())[0].shape[0])
    cells = len(sites) // cell
    all_k = 2 * np.pi * np.arange(cells // 2 + 1) / cells
    if k is not None:
        turns = float(k) * cells / (2 * np.pi)
        near = 2 * np.pi * round(turns) / cells
        if abs(turns - round(turns)) > 1e-6 * max(1, abs(turns)):
            wanted = f"a multiple of 2 pi/{cells}, which the ring holds"
            refuse("k", wanted, repr(float(k)), f"The nearest is {near:.10g}.")
        all_k = np.array([near, 0.0])
    bands = floquet_bands(lattice, all_k, period, t0=t0)
    rate = np.where(bands.grows, np.asarray(bands.growth), 0.0).max(-1)
    wave = 0 if k is not None else int(np.argmax(rate))
    if not rate[wave] > 0:
        gaps = floquet_bands(lattice, np.linspace(0, np.pi, 5), period, t0=t0).gaps
        there = ", ".join(f"{a:.6g} ... {b:.6g}" for a, b in gaps)
        refuse(
            "k",
            "a wave number in a k-gap",
            "none of the ring that grows" if k is None else f"{float(k):.6g}",
            f"Waves grow for k = {there}." if gaps else "This modulation has no k-gap.",
        )
    k = float(np.asarray(bands.k)[wave])
    rho = np.asarray(bands.multipliers)[wave]

    def spread(multiplier):
        # A complex wave over the sites, with a largest displacement of 1.

        def over_sites(x):
            x = np.asarray(x)[wave][..., multiplier]
            turn = trailing(np.exp(1j * k * (sites // cell)), x.ndim)
            return turn * x[sites % cell]

        y = jax.tree.map(over_sites, State(bands.displacements, bands.velocities))
        top = max(np.abs(x.real).max() for x in jax.tree.leaves(y.u))
        return jax.tree.map(lambda x: x / top, y)

    # Among the decaying waves, the partner of the growing one.
    down = spread(int(np.argmin(np.abs(rho - 1 / np.conj(rho[0])))))
    growth = float(np.asarray(bands.growth)[wave, 0])
    return _Ring(lattice, period, t0, solver, progress, k, growth, rho[0], spread(0), down)


@compiled
def _strobed(flow, lattice, state, t0, period):
    # Every period begins at the same phase.

    def one(y, _):
        return flow(y, t0, t0 + period, lattice), (y, lattice.energy(t0, *y))

    return jax.lax.scan(one, state, length=PIECE)


@compiled
def _departure(lattice, u, t, sizes):
    # The departure of the force from its linear part, relative to that part, at multiples of u.
    zeros = lattice.zeros()
    _, linear = jax.jvp(lambda u: lattice.force(t, u, zeros), (zeros,), (u,))
    rest = lattice.force(t, zeros, zeros)

    def at(size):
        force = lattice.force(t, jax.tree.map(lambda x: size * x, u), zeros)
        off = jax.tree.map(lambda f, r, k: f - r - size * k, force, rest, linear)
        return largest(off) / (size * largest(linear))

    return jax.lax.map(at, sizes)
