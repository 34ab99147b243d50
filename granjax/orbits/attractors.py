"""Attractors of driven lattices: settling, response curves; a chain with moving walls."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from diffrax import AbstractSolver
from jax.flatten_util import ravel_pytree

from ..base.checks import one_of, per_lane, refuse, whole
from ..base.checks import tolerance as checked_tolerance
from ..base.printing import told
from ..base.programs import compiled, shared_size
from ..base.types import (
    Count,
    Counts,
    Displacements,
    Flags,
    Numbers,
    Parameter,
    Response,
    Scalar,
    Scene,
    StateLike,
    Times,
)
from ..flow import Flow
from ..lattice import Lattice, State
from ..measures import contacts, rms_velocity
from ..results import Result, array, hidden, note, part
from ..solvers import SRKN11b
from ..states import rest
from ..terms import Damping, Harmonic, Wall
from ..terms.chain import walls, without_walls
from .asked import (
    COARSE,
    answered,
    asked,
    checked_period,
    checked_state,
    default_steps,
    fixed_step_solver,
    stacked,
)
from .branch import Bifurcation
from .orbit import forced_orbit
from .problems import made, period_at

SIDES = ("left", "right")


def driven_chain(
    lattice: Lattice,
    amplitude: Parameter,
    omega: Parameter,
    *,
    ends: str | Sequence[str] = SIDES,
    damping: Parameter | None = None,
    phase: Parameter | tuple = 0.0,
    field: str | None = None,
) -> Lattice:
    r"""Return a chain whose end walls move: w(t) = a cos(omega t + phase).

    The left wall is u_0 = w, the right wall u_{N+1} = w, and

    m_n u_n'' = F_n(u_{n-1} - u_n) - F_{n+1}(u_n - u_{n+1}) - gamma m_n u_n'.

    The end bonds keep their law and become `Wall` terms; the bonds between become
    `Shift(1, "free")`. An end that is not driven keeps a wall at rest.

    **Arguments:**

    - `lattice`: a chain with fixed walls, such as `gx.scenes.monomer(21, precompression=1.0)`.
    - `amplitude`: a [m]; `omega`: angular frequency [rad/s]. Numbers, traced or swept.
    - `ends`: which walls move, `"left"`, `"right"` or both.
    - `damping`: gamma >= 0 [1/s] of every site, added to the damping of the lattice; `None` for
      none.
    - `phase` [rad]: one number, or one for each of `ends`. With equal phases both walls move in the
      same direction; (0, pi) makes them mirror images, which squeeze the chain.
    - `field`: the field that the walls touch, where a cell holds several.

    **Returns:** a `Lattice`. Its bond keeps its place among the terms; the walls follow after all
    others, left then right.
    **Raises** ValueError for a lattice that is not a chain with one bond to fixed walls, another
    term that reaches a wall, an unknown end, or a wrong number of phases.
    Typical: a = 0.05 ... 0.5 d0, omega near a band edge, gamma = 0.01 ... 0.1 in scaled units
    (200/s for steel beads).

    **Example:**

    >>> chain = gx.driven.driven_chain(gx.scenes.monomer(20, precompression=1.0), 0.1, 1.0, ends="left")
    >>> gx.measures.strain(chain, gx.states.rest(chain), bond=1).tolist()
    [0.1]
    """
    ends = tuple(one_of("ends", end, SIDES) for end in ((ends,) if isinstance(ends, str) else ends))
    phases = phase if isinstance(phase, (tuple, list)) else (phase,) * len(ends)
    if len(phases) != len(ends):
        refuse("phase", f"a number, or {len(ends)}, one for each of {ends}", repr(phase))
    if lattice.axes != 1 or lattice.dimension is not None:
        refuse(
            "lattice", "a chain with scalar displacements", f"a lattice of shape {lattice.shape}"
        )
    amplitude = per_lane("amplitude", amplitude, lattice.lanes)
    omega = per_lane("omega", omega, lattice.lanes)
    phases = {end: per_lane("phase", x, lattice.lanes) for end, x in zip(ends, phases)}
    if field is not None:
        one_of("field", field, lattice.fields or (None,))
    terms = []
    laws = None
    for i, term in enumerate(lattice.terms):
        parted = without_walls(term, lattice, field) if laws is None else None
        if parted is not None:
            term, *laws = parted
        elif walls(term):
            refuse(
                "lattice",
                "one Bond(Shift(1, 'fixed'), law) to the walls and no other term that reaches them",
                f"terms[{i}] ({type(term).__name__})",
                "Build such a scene from Wall terms.",
            )
        terms.append(term)
    if laws is None:
        refuse(
            "lattice",
            "a Bond(Shift(1, 'fixed'), law), which leads to walls",
            "none",
            "Use boundary='fixed'.",
        )
    if damping is not None:
        terms.append(Damping(damping))
    for side, law in zip(SIDES, laws):
        motion = Harmonic(amplitude, omega, phases[side]) if side in phases else None
        terms.append(Wall(law, side, motion, field=field))
    driven = eqx.tree_at(lambda c: c.terms, lattice, tuple(terms))
    driven.check_terms()
    return driven


# The most periods after which a stroboscopic state may repeat.
MOST = 4
# A repetition after m periods counts if that after each divisor of m is this many times worse.
APART = 1e3
# The number of repetitions whose changes are compared with those of as many before.
STRETCH = 8
# Steps of a settled motion per call of its program.
AT_ONCE = 64
# Safety factor for the change that half the steps make: where contacts open, it may be small by
# accident.
SAFETY = 4
NAMES = {2: "period-doubled", 3: "period-tripled", 4: "doubled twice"}


class Attractor(Result):
    """The attractor of a forced chain: what `settle` returns.

    Errors are estimated distances from the true motion. They combine the difference from the motion
    that settles from there with half as many steps, and the change that is left in either. They are
    NaN where nothing repeats, half the steps do not settle, or no change shrinks.
    """

    state: State = part("The state at phase 0, that is t = 0 modulo the period.", "site")
    period: float = array("The period T of the forcing.", "s")
    periods: int = array("The number of periods that were run.")
    multiple: int = array(
        "The number of periods after which the motion repeats, 1 to 4; 0 if it does not repeat "
        "within the budget."
    )
    change: float = array(
        "The last relative change over `multiple` periods (over one if that is 0)."
    )
    changes: Numbers = array("The relative change over each period of the run.", "1", "run")
    ts: Times = array(
        "The times of every step of one repetition, from phase 0 on; of sixteen periods if "
        "nothing repeats.",
        "s",
        "time",
        name="time",
    )
    us: Displacements = array("The displacements at these times.", "m", "time site", name="u")
    vs: Displacements = array("The velocities at these times.", "m/s", "time site", name="v")
    amplitude: Displacements = array("The largest speed of each site.", "m/s", "site")
    peak_force: Numbers = array(
        "The largest contact force F0 + F(e) of all bonds in the order of the terms, then of the "
        "walls.",
        "N",
        "contact",
    )
    energy: Numbers = array("The mean energy.", "J")
    state_error: State = part("The error of the state.", "site")
    amplitude_error: Displacements = array("The error of the amplitude.", "m/s", "site")
    peak_force_error: Numbers = array("The error of the peak force.", "N", "contact")
    energy_error: Numbers = array("The error of the energy.", "J")
    near: str = hidden(
        "The sentence on decay to rest, or on a stable orbit near a motion that does not repeat.",
        static=True,
    )

    @property
    def settled(self) -> bool:
        """Whether the motion repeats."""
        return self.multiple > 0

    @property
    def outcome(self) -> str:
        """Whether the motion repeats, and after how many periods."""
        used = f"after {self.periods} periods"
        change = f"{self.change:.1e}"
        if not np.isfinite(self.change):
            return f"The state ceased to be finite {used}: take more steps per period."
        if self.multiple == 1:
            return f"Settled: it repeats every period to {change}, {used}. {self.near}".strip()
        if self.multiple:
            return (
                f"Settled, {NAMES[self.multiple]}: it repeats every {self.multiple} periods to "
                f"{change}, {used}."
            )
        if _still_settles(self.changes, self.periods):
            return (
                f"Still settling {used}: the change a period is {change} and falls; "
                "give more periods."
            )
        if self.near:
            return f"Undecided {used}: it changes by {change} a period. {self.near}"
        return (
            f"Not periodic within {self.periods} periods: quasi-periodic or chaotic, it changes by "
            f"{change} a period."
        )


def settle(
    lattice: Lattice,
    state: StateLike,
    period: Scalar,
    *,
    periods: Count = 4000,
    tolerance: Scalar = 1e-8,
    steps: Count | None = None,
    solver: AbstractSolver | None = None,
) -> Attractor:
    r"""Run a periodically forced lattice until its state repeats after 1, 2, 3 or 4 periods.

    Two states are compared in displacements times 2 pi/T and velocities: the largest difference
    over the largest value, at least eps times that of the run. With damping gamma alone a change
    shrinks as exp(-gamma T/2) per period, so the distance from the attractor is about 2/(gamma T)
    times the last change. A repetition after m periods counts if that after each divisor of m is a
    thousand times worse. The velocities are then disturbed by a hundred times the tolerance, and
    the motion must repeat again. So a start on an unstable orbit, or one that a symmetry holds,
    does not count as settled.

    **Arguments:**

    - `lattice`: forced with period T, such as `driven_chain(...)`. `state`: the state at t = 0.
    - `period`: T > 0. `periods`: the budget, at least 8. `tolerance`: of the relative change.
    - `steps`: per period; `None` takes h omega_max <= 0.4, with omega_max the highest linear
      frequency. The mesh is fixed: what repeats is the orbit of the discrete map. `solver`: any
      with a fixed step.

    **Returns:** `Attractor`. **Raises** ValueError for a T after which the forces do not repeat, a
    batch of lattices, a T, tolerance or number that is not above zero, or a lattice without a
    linear frequency (a sonic vacuum) if `steps` is not given.
    Typical: 200 to 2000 periods near a band edge with gamma T = 0.03.

    **Example:**

    >>> chain = gx.driven.driven_chain(gx.scenes.monomer(3, precompression=1.0), 0.01, 0.5, damping=0.5)
    >>> found = gx.driven.settle(chain, gx.states.rest(chain), 2 * np.pi / 0.5, steps=64)
    >>> found.multiple, found.outcome.split(":")[0]
    (1, 'Settled')
    """
    state, period, flow = asked(lattice, state, period, steps, solver)
    # As arrays, so that other values compile nothing new.
    tolerance, T = (
        jnp.asarray(x, lattice.dtype) for x in (checked_tolerance("tolerance", tolerance), period)
    )
    settling = _Settling(_itself, flow, whole("periods", periods, 8))
    scene = (lattice, T)
    found = settling.follow(scene, state, tolerance, jnp.asarray(periods))
    used = int(found.used)
    multiple = int(found.multiple)
    # Sixteen periods are kept of a motion that does not repeat.
    watched = settling.watch(scene, found.state, multiple or 16)
    seen = _extremes(found.state, *watched)
    errors = jax.tree.map(lambda x: np.full_like(x, np.nan), seen)
    if multiple:
        other, left = settling.otherwise(scene, found, tolerance)
        others = _extremes(other, *settling.watch(scene, other, multiple))
        # The error of the parabola through the samples.
        sparse = _extremes(found.state, *watched, every=2)
        errors = jax.tree.map(
            lambda error, x, y: np.asarray(error + np.abs(np.subtract(x, y))),
            _errors(seen, others, left),
            seen,
            sparse,
        )
    changes = np.asarray(found.changes)[:used]
    near = ""
    # A motion that does not repeat yet may decay to rest, if half of its digits are gone.
    share = float(found.share)
    if share <= float(jnp.finfo(lattice.dtype).eps) ** (1 if multiple else 0.5):
        decays = "decays" if multiple else "probably decays"
        near = f"It {decays} to rest: its size is {share:.1e} of the largest."
    elif not multiple and np.isfinite(changes[-1, 0]) and not _still_settles(changes[:, 0], used):
        near = slowly(lattice, flow, found.state, period)
    return Attractor(
        found.state,
        period,
        used,
        multiple,
        float(changes[-1, max(multiple, 1) - 1]),
        changes[:, 0],
        watched[0],
        *watched[1],
        *seen[1:],
        *errors,
        near,
        **lattice.origin,
    )


def _still_settles(changes, used):
    # Whether the last changes of a run are below half of those in its middle.
    part = max(1, used // 8)
    half = used // 2
    return np.median(changes[-part:]) < np.median(changes[half - part : half]) / 2


class _Followed(NamedTuple):
    """The end of a run that was followed until it repeats.

    `state`; `used`: the periods that were run; `multiple`: after how many it repeats (or 0);
    `changes` (periods, 4) over one to four periods; `once`: whether it had repeated before the
    disturbance; `rate`: the factor by which a change shrinks from one repetition to the next, after
    the disturbance.
    """

    state: State
    used: Counts
    multiple: Counts
    changes: Numbers
    once: Flags
    rate: Numbers
    largest: Numbers  # The largest size of the run.
    share: Numbers  # The last size over it.


def _until(multiple_at, flow, lattice, y, period, used, changes, most, largest=0.0):
    # Returns (periods used, state, after how many periods it repeats or 0, changes, the largest
    # size of the run, which was `largest` before). `multiple_at(i, change, changes)` decides it
    # from the changes at period i over one to four periods.
    kept = len(changes)
    weight = _weight(y, period)

    def going(carry):
        i, _, _, multiple, changes, _ = carry
        last = changes[jnp.maximum(i - 1, 0) % kept, 0]
        return (i < most) & (multiple == 0) & jnp.isfinite(last)

    def one(carry):
        i, y, before, _, changes, largest = carry
        y = flow(y, 0.0, period, lattice)
        x = weight * ravel_pytree(y)[0]
        largest = jnp.maximum(largest, jnp.max(jnp.abs(x)))
        # A motion that decays to rest changes by a share of itself that does not fall.
        size = _size(x, largest)
        change = jnp.max(jnp.abs(x - before), 1) / jnp.where(size > 0, size, 1)
        multiple = multiple_at(i, change, changes)
        before = jnp.concatenate([x[None], before[:-1]])
        return i + 1, y, before, multiple, changes.at[i % kept].set(change), largest

    x = weight * ravel_pytree(y)[0]
    before = jnp.broadcast_to(x, (MOST, x.size))
    largest = jnp.maximum(largest, jnp.max(jnp.abs(x)))
    start = used, y, before, jnp.zeros((), int), changes, largest
    used, y, _, *found = jax.lax.while_loop(going, one, start)
    return used, y, *found


def _size(x, largest):
    # Of a weighted state, and at least the accuracy of numbers times the largest one of the run.
    return jnp.maximum(jnp.max(jnp.abs(x)), jnp.finfo(x.dtype).eps * largest)


def _weight(y, period):
    flat, _ = ravel_pytree(y)
    weight = jnp.where(jnp.arange(flat.size) < flat.size // 2, 2 * jnp.pi / period, 1)
    return weight.astype(flat.dtype)


def _rate(changes, used, count, multiple):
    # The rate at which changes shrink over the last `count` periods, from the largest of the second
    # and of the last third. Shorter stretches see the beats of several multipliers, and the first
    # third what decays faster.
    column = jnp.maximum(multiple, 1) - 1
    age = (used - 1 - jnp.arange(len(changes))) % len(changes)
    stretch = jnp.maximum(jnp.minimum(count, len(changes)) // 3, 1)
    late, early = (
        jnp.max(jnp.where((age >= k * stretch) & (age < (k + 1) * stretch), changes[:, column], 0))
        for k in (0, 1)
    )
    return jnp.where(early > 0, late / early, 0) ** (multiple / stretch)


def _top(x):
    # The largest value along the first axis: the top of the parabola through three samples. The
    # samples are equal steps of whole periods.
    i = np.argmax(x, 0)[None]
    a, b, c = (np.take_along_axis(x, (i + k) % len(x), 0)[0] for k in (-1, 0, 1))
    curve = 2 * b - a - c
    return b + (a - c) ** 2 / (8 * np.where(curve > 0, curve, 1))


def _extremes(state, _, ys, pushes, energy, every=1):
    # Returns the state, the largest speeds and forces (by every so many samples), and the mean
    # energy of a motion that was watched.
    speeds = jax.tree.map(np.abs, ys.v)
    tops = jax.tree.map(lambda x: _top(x[::every]), (speeds, pushes))
    return state, *tops, np.asarray(np.mean(energy))


def _errors(found, other, left):
    # The errors of numbers of an attractor, from those with half of the steps.
    found, other, left = jax.tree.map(np.asarray, (found, other, left))
    return jax.tree.map(
        lambda x, y: np.asarray(SAFETY * np.abs(x - y) + left * np.max(np.abs(x), initial=0)),
        found,
        other,
    )


def _itself(scene):
    return scene


def _over(make, period, value):
    return make(value), jnp.asarray(period_at(period, value))


class _Settling(eqx.Module):
    # Runs of `at(value)`, a lattice and its period; one program for all values.

    at: Callable
    flow: Flow
    periods: int = eqx.field(static=True)

    @compiled
    def follow(self, value, state, tolerance, most):
        # Run until the state repeats, and again after a disturbance.
        lattice, period = self.at(value)
        multiples = np.arange(1, MOST + 1)
        divides = (multiples[:, None] % multiples == 0) & (multiples[:, None] > multiples)
        lag = np.minimum(STRETCH * multiples, self.periods - 1)

        def repeats_from(begin):
            def multiple_at(i, change, changes):
                # A motion that slowly approaches an orbit of fewer periods changes little over
                # several of them. What is left of its way is the sum of a geometric series.
                early = changes[(i - lag) % self.periods, multiples - 1]
                rate = jnp.where(early > 0, change / early, 0)
                rate = rate ** (multiples / lag)
                left = jnp.where(rate < 1, change / (1 - rate), jnp.inf)
                least = jnp.maximum(APART * tolerance, SAFETY * left)
                alone = ~divides.any(1) | (i >= lag)
                alone &= jnp.all(~divides | (change > least[:, None]), 1)
                repeats = (change <= tolerance) & alone & (i >= begin + MOST)
                return jnp.where(repeats.any(), jnp.argmax(repeats) + 1, 0)

            return multiple_at

        begin = jnp.zeros((), int)
        flat, unravel = ravel_pytree(state)
        changes = jnp.zeros((self.periods, MOST), flat.dtype)
        until = lambda y, begin, changes, *largest: _until(
            repeats_from(begin), self.flow, lattice, y, period, begin, changes, most, *largest
        )
        used, y, before, changes, largest = until(state, begin, changes)
        # A disturbance that the motion must forget. It is too small to be taken for a doubled
        # period.
        x = ravel_pytree(y)[0]
        half = flat.size // 2
        noise = np.append(np.zeros(half), np.random.default_rng(0).uniform(-1, 1, half))
        weight = _weight(y, period)
        y = unravel(x + 1e2 * tolerance * _size(weight * x, largest) * noise)
        begin = used
        used, y, multiple, changes, largest = until(y, begin, changes, largest)
        rate = _rate(changes, used, used - begin, multiple)
        size = jnp.max(jnp.abs(weight * ravel_pytree(y)[0]))
        share = jnp.where(largest > 0, size / largest, 1)
        return _Followed(y, used, multiple, changes, before > 0, rate, largest, share)

    @compiled
    def otherwise(self, value, found, tolerance):
        # The state to which half the steps settle, and its relative uncertainty: NaN where it does
        # not settle, or nothing has repeated.
        # A change c per repetition that shrinks by a factor r (at least that of `found`) is c
        # r/(1 - r) from its limit.
        lattice, period = self.at(value)
        coarse = Flow(jnp.maximum(self.flow.steps // 2, 1), self.flow.solver)
        multiple = jnp.maximum(found.multiple, 1)
        column = multiple - 1

        def multiple_at(i, change, _):
            return (((i + 1) % multiple == 0) & (change[column] <= tolerance)).astype(int)

        changes = jnp.zeros((self.periods, MOST), found.changes.dtype)
        begin = jnp.zeros((), int)
        most = -(-self.periods // multiple) * multiple
        used, y, _, changes, _ = _until(
            multiple_at, coarse, lattice, found.state, period, begin, changes, most, found.largest
        )
        first = changes[column, column]
        last = changes[(used - 1) % self.periods, column]
        between = used // multiple - 1
        own = (last / first) ** (1 / jnp.maximum(between, 1))
        rate = jnp.maximum(jnp.where((between > 0) & (first > 0), own, 0), found.rate)
        known = (last <= tolerance) & (found.multiple > 0) & (rate < 1)
        left = jnp.where(known, jnp.maximum(last, tolerance) / (1 - rate), jnp.nan)
        # What decays to rest ends there.
        rest = found.share <= jnp.finfo(changes.dtype).eps
        return jax.tree.map(lambda x: jnp.where(rest, 0, x), y), left

    @compiled
    def _stretch(self, value, state, first):
        # Run some steps from step `first`: (state after them, times, states, forces, energies).
        lattice, period = self.at(value)
        one = Flow(1, self.flow.solver)
        h = period / self.flow.steps

        def step(y, i):
            t = h * (i % self.flow.steps)  # Every period begins at the same phase.
            forces, _ = ravel_pytree([contact.force for contact in contacts(lattice, y, t)])
            return one(y, t, t + h, lattice), (h * i, y, forces, lattice.energy(t, *y))

        return jax.lax.scan(step, state, first + jnp.arange(AT_ONCE))

    def watch(self, value, state, count):
        # (times, states, contact forces, energies) at every step of `count` periods.
        # Stretches of one length are run, so that another number of steps compiles nothing.
        total = count * int(self.flow.steps)
        parts = []
        for first in range(0, total, AT_ONCE):
            state, part = self._stretch(value, state, jnp.asarray(first))
            parts.append(jax.tree.map(np.asarray, part))
        return jax.tree.map(lambda *x: np.concatenate(x)[:total], *parts)


@compiled
def _answer(at, response, value, ys, ts):
    return answered(response, at(value)[0], ys, ts)


def slowly(lattice: Lattice, flow: Flow, state: State, period: Scalar) -> str:
    """Return a sentence on a stable orbit of one or two periods near a state, or "".

    The motion may settle to that orbit slowly.
    """
    # Newton's method uses a dense matrix, so the size is limited.
    for multiple in (1, 2) if ravel_pytree(state)[0].size <= 512 else ():
        after = state
        for _ in range(multiple):
            after = flow(after, 0.0, period, lattice)
        steps = 2 * multiple * int(flow.steps)
        # The guess lies between two states on either side of the orbit.
        guess = jax.tree.map(lambda a, b: (a + b) / 2, state, after)
        try:
            found = forced_orbit(
                lattice, multiple * period, guess, steps=steps, solver=flow.solver, throw=False
            )
            known = found.floquet(steps=steps, solver=flow.solver) if found.converged else None
        except ValueError:
            continue
        if known is None or not (np.abs(known.multipliers) + known.error < 1).all():
            continue
        rho = known.multipliers[0]
        size = f"{rho if rho.imag else rho.real:.6g} +- {known.error[0]:.1e}"
        name = "one period" if multiple == 1 else "two periods"
        forgets = -multiple / np.log(np.abs(rho))
        return (
            f"An orbit of {name} near it is stable. Its largest multiplier is {size}: a disturbance takes "
            f"{forgets:.2g} periods to fall to 1/e, and the motion may settle to it slowly. Give more periods, or "
            "begin at the orbit that gx.forced.forced_orbit finds."
        )
    return ""


# A change below this share of the largest response is not a jump.
SMALLEST = 1e-6
# Budgets in units of `periods`: the second for a motion that does not repeat, the third for one
# that still settles.
BUDGETS = (1, 1, 8)
# The least tolerance to which a motion settles.
LEAST = 1e-12
# The share of the tolerance to which both sides of a jump settle.
TIGHT = 1e-2
# Halvings beyond the accuracy through which a jump must persist.
NARROW = 10
# The share of a change that must persist there. A steep flank keeps a thousandth, and a branch that
# ends at a fold rises steeply before it.
PERSISTS = 0.1
# Rounds of halving and settling.
AGAIN = 6


class Jump(NamedTuple):
    """A jump of the response at `value`: the responses `before` and `after` it along the sweep."""

    value: float
    before: float
    after: float
    __repr__ = told


class Way(Result):
    """One sweep along a response curve, up or down, in the order of `ResponseCurve.values`.

    Errors are estimated, or NaN, as by `settle`.
    """

    response: Numbers = array("The response at each value.", axes="value")
    velocity: Displacements = array(
        "The root mean square velocity of each site.", "m/s", "value site"
    )
    energy: Numbers = array("The mean energy.", "J", "value")
    response_error: Numbers = array("The error of the response.", axes="value")
    velocity_error: Displacements = array("The error of the velocity.", "m/s", "value site")
    energy_error: Numbers = array("The error of the energy.", "J", "value")
    multiple: Counts = array(
        "The number of periods after which the motion repeats, 0 if it does not.", axes="value"
    )
    periods: Counts = array("The number of periods that were run.", axes="value")
    states: State = part("The states at phase 0.", "value site", name="state")
    jumps: tuple[Jump, ...] = array("The jumps in the order of the sweep.", axes="jump")
    bifurcations: tuple[Bifurcation, ...] = array(
        "The bifurcations in the order of the sweep.", axes="bifurcation"
    )

    @property
    def outcome(self) -> str:
        """What was met during the sweep."""
        repeats = np.count_nonzero(self.multiple)
        return (
            f"{len(self.jumps)} jumps, {len(self.bifurcations)} changes of the repetition; the motion repeats at "
            f"{repeats} of {len(self.multiple)} values."
        )


class ResponseCurve(Result):
    """What `response` returns: the sweeps up and down, and where they differ."""

    values: Numbers = array("The values of the parameter, ascending.", axes="value", name="value")
    up: Way = array("The sweep up.")
    down: Way | None = array("The sweep down, `None` if it was not run.")
    hysteresis: list = note(
        "Intervals (low, high) of the parameter in which the two sweeps have settled differently. "
        "Their ends are jumps where there is one next to them, else values of the sweep."
    )

    @property
    def outcome(self) -> str:
        """What was met, and where the sweeps differ."""
        if self.down is None:
            return f"Up: {self.up.outcome}"
        where = ", ".join(f"{low:.6g} ... {high:.6g}" for low, high in self.hysteresis) or "nowhere"
        return f"Up: {self.up.outcome} Down: {self.down.outcome} They differ {where}."


def response(
    make: Scene,
    values: Parameter,
    period: Callable[[Any], Any] | Scalar,
    *,
    state: StateLike | None = None,
    response: Response = rms_velocity,
    jump: Scalar = 0.2,
    accuracy: Scalar = 1e-3,
    periods: Count = 2000,
    tolerance: Scalar = 1e-6,
    watch: Count = 12,
    steps: Count | None = None,
    solver: AbstractSolver | None = None,
    down: bool = True,
) -> ResponseCurve:
    r"""Follow the attractor of a forced lattice while a parameter sweeps up, then down again.

    Each value starts from the state of the previous one at phase 0, and runs until it repeats
    (`settle`). If its budget is spent it gets another one, and up to eight more while it still
    settles, before it counts as not repeating. The response is then taken over `watch` more
    periods.

    An interval over which the response changes by more than `jump`, relative to the larger one, is
    halved, each time from the state before it, down to `accuracy`. What is left is a jump if it
    exceeds `jump` when both sides have settled to a hundredth of `tolerance`, and still does when it
    is located a thousand times better, where a steep flank keeps less than a tenth. A change that
    shorter steps avoid is none: the sweep follows them. Changes between motions that do not repeat,
    or below 1e-6 of the largest response, do not count. A change of the repetition is located the
    same way.
    Near a bifurcation the motion settles slowly, so a small budget places it where settling takes
    longer.

    **Arguments:**

    - `make(value)`: the lattice at a value of the parameter (a frequency, an amplitude, a preload).
      It is traced once, so all values share one compiled program. `period`: T, a number or a
      function of the value: `lambda w: 2 * jnp.pi / w`.
    - `values` (P,): ascending, P >= 2, and close enough for the attractor to be followed. `state`:
      the first state, at rest by default. `down`: whether to sweep back too, from the end of the
      sweep up.
    - `response(lattice, u, v, t)`: a number from one history u, v (S, N) over those periods, t (S,)
      from phase 0 on; by default the root mean square of all velocities.
    - `jump`, `accuracy`: see above; both relative. `watch`: the periods over which the response is
      taken.
    - `periods`, `tolerance`, `steps`, `solver`: as in `settle`. The first or last value sets the
      steps, which are rounded up by at most an eighth, so that curves of similar scenes share one
      program.

    **Returns:** `ResponseCurve`; without `down` its `down` is `None`, and it has no hysteresis.
    **Raises** ValueError for fewer than two values, values that do not ascend, a batch of lattices,
    or a period after which the forces do not repeat.

    **Example:**

    >>> chain = gx.scenes.monomer(3, precompression=1.0)
    >>> make = lambda a: gx.driven.driven_chain(chain, a, 0.5, damping=0.5)
    >>> found = gx.driven.response(make, [0.01, 0.02, 0.03], 2 * np.pi / 0.5, steps=64, down=False)
    >>> (found.up.response / found.up.response[0]).round(2).tolist()
    [1.0, 2.0, 3.0]
    """
    values = np.asarray(values, float)
    if values.ndim != 1 or len(values) < 2 or not (np.diff(values) > 0).all():
        refuse(
            "values",
            "at least two, ascending",
            f"shape {values.shape}",
            "The way down is followed without being asked for.",
        )
    # No response changes by more than twice the larger one.
    jump = float(checked_tolerance("jump", jump, 2, 0.2))
    accuracy = float(checked_tolerance("accuracy", accuracy, 1, 1e-3))
    tolerance = float(checked_tolerance("tolerance", tolerance))
    scenes = [made(make, period, w) for w in values[[0, -1]]]
    first = scenes[0][0]
    if steps is None:
        steps = shared_size(max(default_steps(*scene, fineness=COARSE) for scene in scenes))
    flow = Flow(whole("steps", steps, 1), fixed_step_solver(first, solver, SRKN11b()))
    state = rest(first) if state is None else checked_state(first, state)
    for lattice, T in scenes:
        checked_period(lattice, state, 0.0, T)
    period = period if callable(period) else jnp.asarray(float(period))
    settling = _Settling(eqx.Partial(_over, make, period), flow, periods)
    watch = whole("watch", watch, 1)

    def seen(value, y):
        ts, ys, _, energy = settling.watch(value, y, watch)
        velocity = jax.tree.map(lambda v: np.sqrt(np.mean(v * v, 0)), ys.v)
        number = _answer(settling.at, response, value, ys, ts)
        return number, velocity, np.mean(energy)

    def attractor(value, y, share=1.0):
        # Settle to a share of the tolerance, with more than the budget if needed.
        used = 0
        tight = jnp.asarray(max(share * tolerance, LEAST))
        for budget in BUDGETS:
            motion = settling.follow(value, y, tight, jnp.asarray(budget * periods))
            y = motion.state
            used = used + motion.used
            settles = motion.once or _still_settles(motion.changes[:, 0], periods)
            finite = np.isfinite(motion.changes).all()
            if motion.multiple or not finite or used > periods and not settles:
                break
        return _Found(value, motion._replace(used=used), *seen(value, y))

    def errors(found):
        other, left = settling.otherwise(found.value, found.motion, jnp.asarray(tolerance))
        return _errors(tuple(found[2:]), seen(found.value, other), left)

    def sweep(order, y):
        # Settle at each value from the state of the one before.
        found = []
        for value in order:
            found.append(attractor(value, y))
            y = found[-1].motion.state
        return found

    def way(y, direction):
        order = values[::direction]
        found = sweep(order, y)
        floor = SMALLEST * max(abs(float(x.response)) for x in found)
        jumps = []
        for i in range(len(order) - 1):
            place, followed = _jump(attractor, *found[i : i + 2], accuracy, jump, floor)
            jumps.append(place)
            if followed is not None:
                # The whole step had left an attractor that goes on.
                rest = sweep(order[i + 2 :], followed.motion.state)
                found[i + 1 :] = [followed, *rest]
        changes = [
            _bifurcation(attractor, *step, accuracy, i, first.origin)
            for i, step in enumerate(zip(found, found[1:]))
        ]
        about = stacked([errors(x) for x in found[::direction]])
        found = stacked(found[::direction])
        return Way(
            *found[2:],
            *about,
            found.motion.multiple,
            found.motion.used,
            found.motion.state,
            tuple(filter(None, jumps)),
            tuple(filter(None, changes)),
            **first.origin,
        )

    up = way(state, 1)
    if not down:
        return ResponseCurve(values, up, None, [], **first.origin)
    back = way(jax.tree.map(lambda x: x[-1], up.states), -1)
    return ResponseCurve(
        values, up, back, _hysteresis(values, up, back, jump, accuracy), **first.origin
    )


class _Found(NamedTuple):
    # The attractor at a value of the parameter.

    value: float
    motion: _Followed
    response: Numbers
    velocity: Displacements
    energy: Numbers

    @property
    def multiple(self):
        return int(self.motion.multiple)


def _halved(attractor, a, b, accuracy, belongs, share=1.0):
    # Halve the step between two attractors to an accuracy; a middle that belongs to the start
    # becomes the start.
    while abs(b.value - a.value) > accuracy * max(abs(a.value), abs(b.value)):
        middle = (a.value + b.value) / 2
        if middle in (a.value, b.value):
            break
        c = attractor(middle, a.motion.state, share)
        if belongs(a, c, b):
            a = c
        else:
            b = c
    return a, b


def _jump(attractor, begin, end, accuracy, share, floor):
    # Returns (the jump or None, an attractor or None). The attractor is the one at the end of the
    # step where short steps reach the end without a jump, though the whole step had left it.
    def apart(a, b):
        return abs(float(a.response) - float(b.response))

    def left(a, b, least=floor):
        larger = max(abs(float(a.response)), abs(float(b.response)))
        return apart(a, b) > max(share * larger, least)

    def nearer(a, c, b):
        return apart(a, c) < apart(c, b)

    if not left(begin, end) or begin.multiple == end.multiple == 0:
        return None, None
    a = begin
    b = end
    share_of_tolerance = 1.0
    for _ in range(AGAIN):
        a, b = _halved(attractor, a, b, accuracy, nearer, share_of_tolerance)
        if not left(a, b):
            return None, None
        a = attractor(a.value, a.motion.state, TIGHT)
        # From the state just before it: a longer step may have fallen into another basin.
        b = attractor(b.value, a.motion.state, TIGHT)
        share_of_tolerance = TIGHT
        if left(a, b):
            break
        if nearer(end, a, begin):
            # The lower side had not left the branch that ends before it.
            b = a
            a = begin
        elif b.value == end.value:
            return None, b
        else:
            # The branch goes on beyond the upper side.
            a = b
            b = end
    if a.multiple == b.multiple == 0:
        return None, None
    least = max(floor, PERSISTS * apart(a, b))
    for halvings in range(NARROW + 1):
        a, b = _halved(attractor, a, b, accuracy / 2**halvings, nearer, TIGHT)
        if not left(a, b, least):
            return None, None
    return Jump(float((a.value + b.value) / 2), float(a.response), float(b.response)), None


def _bifurcation(attractor, a, b, accuracy, i, origin):
    if a.multiple == b.multiple:
        return None
    low, high = _halved(attractor, a, b, accuracy, lambda a, c, _: a.multiple == c.multiple)
    place = float((low.value + high.value) / 2)
    return Bifurcation("repetition", place, i, None, None, a.multiple, b.multiple, **origin)


def _hysteresis(values, up, down, share, accuracy):
    larger = np.maximum(np.abs(up.response), np.abs(down.response))
    # A response that is not finite does not hide the others.
    floor = SMALLEST * np.fmax.reduce(larger)
    apart = np.abs(up.response - down.response) > np.maximum(share * larger, floor)
    places = sorted(jump.value for way in (up, down) for jump in way.jumps)
    wide = np.pad(values, 1, "edge")
    intervals = []
    for first, end in np.flatnonzero(np.diff(np.pad(apart, 1))).reshape(-1, 2):
        low = values[first]
        high = values[end - 1]
        below = [p for p in places if wide[first] <= p <= low]
        above = [p for p in places if high <= p <= wide[end + 1]]
        intervals.append((float([*below, low][0]), float([high, *above][-1])))
    # Between two values at which both ways agree.
    for low in [jump.value for jump in down.jumps]:
        i = np.searchsorted(values, low)
        above = [jump.value for jump in up.jumps if jump.value > low + accuracy * abs(low)]
        high = min(above, default=np.inf)
        if high < values[i] and not apart[i - 1 : i + 1].any():
            intervals.append((low, high))
    return sorted(intervals)
