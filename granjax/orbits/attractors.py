"""Periodically forced chains, period by period, until what is seen once a period repeats."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from diffrax import AbstractSolver
from jax.flatten_util import ravel_pytree
from jaxtyping import Float

from ..checks import tolerance as checked_tolerance
from ..checks import traced
from ..flow import Flow
from ..lattice import Lattice, State
from ..measures import contacts
from ..results import Result, array, hidden, part
from ..solvers import SRKN11b
from ..types import Count, Counts, Displacements, Flags, Numbers, Pytree, Scalar, StateLike, Times
from .orbit import forced_orbit
from .repeats import asked
from .steps import COARSE

# periods after which a stroboscopic state may repeat: one to four
MOST = 4
# a repetition after m periods counts where that after a divisor of m is this many times worse
APART = 1e3
# repetitions over which changes are compared with those of as many before
STRETCH = 8
# steps of a settled motion that one call of its program makes
AT_ONCE = 64
# of what half the steps change: where contacts open that may be small by accident
SAFETY = 4
NAMES = {2: "period-doubled", 3: "period-tripled", 4: "doubled twice"}


class Attractor(Result):
    """Where a forced chain has settled; what `settle` returns.

    Errors are estimated distances from the true motion, by what settles from there with half as many steps, and by what
    either still changes; NaN where nothing repeats, or half the steps settle to nothing.
    """

    state: State = part("The state at phase 0, that is t = 0 modulo the period.", "site")
    period: float = array("The period T of the forcing.", "s")
    periods: int = array("The number of periods that were run.")
    multiple: int = array(
        "The number of periods after which the motion repeats, 1 to 4; 0 where it did not "
        "within the budget."
    )
    change: float = array(
        "The last relative change over `multiple` periods (over one where that is 0)."
    )
    changes: Float[np.ndarray, " run"] = array(
        "The relative change over each period of the run.", "1"
    )
    ts: Times = array(
        "The times of every step of one repetition, from phase 0 on; of sixteen periods "
        "where nothing repeats.",
        "s",
        "time",
        name="time",
    )
    us: Displacements = array("The displacements at these times.", "m", "time site", name="u")
    vs: Displacements = array("The velocities at these times.", "m/s", "time site", name="v")
    amplitude: Displacements = array("The largest speed of each site.", "m/s", "site")
    peak_force: Numbers = array(
        "The largest contact force F0 + F(e) of all bonds in the order of the terms, then "
        "of walls.",
        "N",
        "contact",
    )
    energy: Numbers = array("The mean energy.", "J")
    state_error: State = part("The error of the state.", "site")
    amplitude_error: Displacements = array("The error of the amplitude.", "m/s", "site")
    peak_force_error: Numbers = array("The error of the peak force.", "N", "contact")
    energy_error: Numbers = array("The error of the energy.", "J")
    near: str = hidden("Of what does not repeat, which stable orbit is near.", static=True)

    @property
    def settled(self) -> bool:
        """Whether the motion repeats."""
        return self.multiple > 0

    @property
    def outcome(self) -> str:
        """Whether it repeats, and after how many periods."""
        used, change = f"after {self.periods} periods", f"{self.change:.1e}"
        if not np.isfinite(self.change):
            return f"The state ceased to be finite {used}: take more steps per period."
        if self.multiple == 1:
            return f"Settled: it repeats every period to {change}, {used}."
        if self.multiple:
            return (
                f"Settled, {NAMES[self.multiple]}: it repeats every {self.multiple} periods to "
                f"{change}, {used}."
            )
        if still_settles(self.changes, self.periods):
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
    r"""Run a periodically forced lattice until it repeats once a period, or after 2, 3 or 4 periods.

    Two states are compared in displacements times 2 pi/T and velocities, by the largest difference over the largest
    value. With damping gamma alone a change shrinks as exp(-gamma T/2) a period, so that the distance from the
    attractor is about 2/(gamma T) times the last change. A repetition after m periods counts as one where that after
    a divisor of m is a thousand times worse. What repeats is then disturbed, its velocities by a hundred times the
    tolerance, and must come to repeat again: a start that an unstable orbit, or a symmetry, holds fast is not settled.

    **Arguments:**

    - `lattice`: one forced with period T, `driven_chain(...)` or one of your own. `state`: at t = 0, where it starts.
    - `period`: T > 0. `periods`: the budget, at least 8. `tolerance`: of the relative change.
    - `steps`: per period; `None` takes h omega_max <= 0.4, with omega_max the highest linear frequency (a fixed mesh:
      what repeats is the orbit of the discrete map). `solver`: any at a fixed step.

    **Returns:** `Attractor`. **Raises** ValueError for a T after which the forces do not repeat, a batch of lattices,
    T, a tolerance or numbers that are not above zero, or a lattice without a linear frequency (a sonic vacuum) where
    `steps` is not given.
    Typical: 200 to 2000 periods near a band edge with gamma T = 0.03.

    **Example:**

    >>> chain = gx.driven.driven_chain(gx.scenes.monomer(3, precompression=1.0), 0.01, 0.5, damping=0.5)
    >>> found = gx.driven.settle(chain, gx.states.rest(chain), 2 * np.pi / 0.5, steps=64)
    >>> found.multiple, found.outcome.split(":")[0]
    (1, 'Settled')
    """
    state, period, flow = asked(lattice, state, period, 0.0, steps, solver, SRKN11b(), COARSE)
    tolerance = jnp.asarray(float(checked_tolerance("tolerance", tolerance)), lattice.dtype)
    # an array, whose value compiles nothing anew
    T = jnp.asarray(period, lattice.dtype)
    found = _follow(flow, lattice, state, T, periods, tolerance)
    used, multiple = int(found.used), int(found.multiple)
    # of a motion that does not repeat sixteen periods are kept
    (ts, us, vs), *seen, sampling = _watch(flow, lattice, found.state, T, multiple or 16)
    seen = found.state, *seen
    errors = jax.tree.map(lambda x: np.full_like(x, np.nan), seen)
    if multiple:
        other, left = _otherwise(flow, lattice, found, T, periods, tolerance)
        _, *others, _ = _watch(flow, lattice, other, T, multiple)
        errors = _apart(seen, (other, *others), left, sampling)
    changes = np.asarray(found.changes)[:used]
    near = ""
    if not multiple and np.isfinite(changes[-1, 0]) and not still_settles(changes[:, 0], used):
        near = slowly(flow, lattice, found.state, period)
    return Attractor(
        found.state,
        period,
        used,
        multiple,
        float(changes[-1, max(multiple, 1) - 1]),
        changes[:, 0],
        ts,
        us,
        vs,
        *seen[1:],
        *errors,
        near,
        **lattice.origin,
    )


def still_settles(changes: Numbers, used: Count) -> Flags:
    """Whether the changes of the last periods of a run are below half of those in its middle."""
    part, half = max(1, used // 8), used // 2
    return np.median(changes[-part:]) < np.median(changes[half - part : half]) / 2


class Followed(NamedTuple):
    """What `follow` returns: the state, the periods that were run, after how many it repeats (or 0).

    `changes` (periods, 4) over one to four periods; `once`: whether it has repeated before it was disturbed; `rate`: by
    which a change becomes less from one repetition to the next, after the disturbance.
    """

    state: State
    used: Counts
    multiple: Counts
    changes: Numbers
    once: Flags
    rate: Numbers


def _until(multiple_at, flow, lattice, y, period, used, changes, most):
    """Run period by period until a state repeats: (periods used, state, after how many or 0, changes).

    `multiple_at(i, change, changes)`: what the changes of period i, over one to four of them, say.
    """
    kept, weight = len(changes), _weight(y, period)

    def going(carry):
        i, _, _, multiple, changes = carry
        last = changes[jnp.maximum(i - 1, 0) % kept, 0]
        return (i < most) & (multiple == 0) & jnp.isfinite(last)

    def one(carry):
        i, y, before, _, changes = carry
        y = flow(y, 0.0, period, lattice)
        x = weight * ravel_pytree(y)[0]
        size = jnp.max(jnp.abs(x))
        change = jnp.max(jnp.abs(x - before), 1) / jnp.where(size > 0, size, 1)
        multiple = multiple_at(i, change, changes)
        before = jnp.concatenate([x[None], before[:-1]])
        return i + 1, y, before, multiple, changes.at[i % kept].set(change)

    x = weight * ravel_pytree(y)[0]
    start = used, y, jnp.broadcast_to(x, (MOST, x.size)), jnp.zeros((), int), changes
    used, y, _, multiple, changes = jax.lax.while_loop(going, one, start)
    return used, y, multiple, changes


def _weight(y, period):
    """Displacements count times 2 pi/T."""
    flat, _ = ravel_pytree(y)
    weight = jnp.where(jnp.arange(flat.size) < flat.size // 2, 2 * jnp.pi / period, 1)
    return weight.astype(flat.dtype)


def follow(
    flow: Flow,
    lattice: Lattice,
    state: StateLike,
    period: Scalar,
    periods: Count,
    tolerance: Scalar,
    most: Counts | None = None,
) -> Followed:
    """From phase 0 on until a state repeats, twice, the second time after a disturbance.

    For use inside of `jax.jit`; `periods` is a Python integer, how many changes are kept, and unless there is `most`,
    which may be traced, also the most that are run.
    """
    most = periods if most is None else most
    multiples = np.arange(1, MOST + 1)
    divides = (multiples[:, None] % multiples == 0) & (multiples[:, None] > multiples)
    lag = np.minimum(STRETCH * multiples, periods - 1)

    def repeats_from(begin):
        def multiple_at(i, change, changes):
            # what comes slowly to an orbit of fewer periods changes by little in several: what is left of its way is
            # the sum of a geometric series
            early = changes[(i - lag) % periods, multiples - 1]
            rate = jnp.where(early > 0, change / jnp.where(early > 0, early, 1), 0)
            rate = rate ** (multiples / lag)
            left = jnp.where(rate < 1, change / jnp.where(rate < 1, 1 - rate, 1), jnp.inf)
            least = jnp.maximum(APART * tolerance, SAFETY * left)
            alone = ~divides.any(1) | (i >= lag)
            alone &= jnp.all(~divides | (change > least[:, None]), 1)
            repeats = (change <= tolerance) & alone & (i >= begin + MOST)
            return jnp.where(repeats.any(), jnp.argmax(repeats) + 1, 0)

        return multiple_at

    state, begin = State(*state), jnp.zeros((), int)
    flat, unravel = ravel_pytree(state)
    changes = jnp.zeros((periods, MOST), flat.dtype)
    used, y, before, changes = _until(
        repeats_from(begin), flow, lattice, state, period, begin, changes, most
    )
    # a disturbance that the motion must forget, too small to be taken for a doubled period
    x, half = ravel_pytree(y)[0], flat.size // 2
    noise = np.append(np.zeros(half), np.random.default_rng(0).uniform(-1, 1, half))
    y = unravel(x + 1e2 * tolerance * jnp.max(jnp.abs(_weight(y, period) * x)) * noise)
    begin = used
    used, y, multiple, changes = _until(
        repeats_from(begin), flow, lattice, y, period, begin, changes, most
    )
    rate = _rate(changes, used, used - begin, multiple)
    return Followed(y, used, multiple, changes, before > 0, rate)


def _rate(changes, used, count, multiple):
    """The rate of the last `count` periods' changes, from the largest of two stretches one after the other."""
    column = jnp.maximum(multiple, 1) - 1
    age = (used - 1 - jnp.arange(len(changes))) % len(changes)
    stretch = jnp.clip(count // 2, 1, STRETCH * jnp.maximum(multiple, 1))
    late, early = (
        jnp.max(jnp.where((age >= k * stretch) & (age < (k + 1) * stretch), changes[:, column], 0))
        for k in (0, 1)
    )
    return jnp.where(early > 0, late / jnp.where(early > 0, early, 1), 0) ** (multiple / stretch)


def forces(lattice: Lattice, y: StateLike, t: Scalar) -> Numbers:
    """Contact forces F0 + F(e) of all bonds in the order of the terms, then of all walls."""
    each = [contact.force.ravel() for contact in contacts(lattice, y, t)]
    return jnp.concatenate(each) if each else jnp.zeros(0, lattice.dtype)


def largest(x: Numbers) -> Numbers:
    """Largest value over the first axis, equal steps of whole periods: top of the parabola through its neighbours."""
    # NumPy compiles nothing for another number of steps
    xp = jnp if traced(x) else np
    x = xp.asarray(x)
    i = xp.argmax(x, 0)[None]
    a, b, c = (xp.take_along_axis(x, (i + k) % len(x), 0)[0] for k in (-1, 0, 1))
    curve = 2 * b - a - c
    return b + (a - c) ** 2 / (8 * xp.where(curve > 0, curve, 1))


_follow = eqx.filter_jit(follow)


def otherwise(
    flow: Flow,
    lattice: Lattice,
    found: Followed,
    period: Scalar,
    periods: Count,
    tolerance: Scalar,
) -> tuple[State, Scalar]:
    """Where half the steps settle from there on, and the share of its size by which either may still be off.

    What changes by c a repetition and by a factor r less at each, that of `found` at the least, is c r/(1 - r) from its
    end. For use inside of `jax.jit`; NaN where it does not settle within `periods`.
    """
    coarse, multiple = Flow(jnp.maximum(flow.steps // 2, 1), flow.solver), found.multiple
    column = multiple - 1

    def multiple_at(i, change, _):
        return jnp.where((i + 1) % multiple == 0, change[column] <= tolerance, False).astype(int)

    changes = jnp.zeros((periods, MOST), found.changes.dtype)
    begin, most = jnp.zeros((), int), -(-periods // multiple) * multiple
    used, y, _, changes = _until(
        multiple_at, coarse, lattice, found.state, period, begin, changes, most
    )
    first, last = changes[column, column], changes[(used - 1) % periods, column]
    between = used // multiple - 1
    own = jnp.where((between > 0) & (first > 0), (last / first) ** (1 / jnp.maximum(between, 1)), 0)
    rate = jnp.maximum(own, found.rate)
    left = jnp.maximum(last, tolerance) / jnp.maximum(1 - rate, jnp.finfo(changes.dtype).eps)
    return y, jnp.where(last <= tolerance, left, jnp.nan)


_otherwise = eqx.filter_jit(otherwise)


def errors_of(found: Pytree, other: Pytree, left: Scalar) -> Pytree:
    """The errors of what is seen of an attractor, from what `otherwise` leads to."""
    return jax.tree.map(
        lambda x, y: SAFETY * jnp.abs(x - y) + left * jnp.max(jnp.abs(x), initial=0), found, other
    )


@jax.jit
def _apart(found, other, left, sampling):
    state, *tops, energy = errors_of(found, other, left)
    return state, *jax.tree.map(jnp.add, tuple(tops), sampling), energy


@eqx.filter_jit
def _stretch(flow, lattice, state, period, first):
    """Some steps from the one of number `first` on: (the state after them, times, states, forces, energies)."""
    one, h = Flow(1, flow.solver), period / flow.steps

    def step(y, i):
        t = h * (i % flow.steps)  # every period at the same phase
        return one(y, t, t + h, lattice), (h * i, y, forces(lattice, y, t), lattice.energy(t, *y))

    return jax.lax.scan(step, state, first + jnp.arange(AT_ONCE))


def _watch(flow, lattice, state, period, count):
    """(times, displacements, velocities) of so many periods, the tops in them, the mean energy, the tops' errors.

    By stretches of one length, so that another number of steps compiles nothing.
    """
    total, parts = count * int(flow.steps), []
    for first in range(0, total, AT_ONCE):
        state, part = _stretch(flow, lattice, state, period, jnp.asarray(first))
        parts.append(jax.tree.map(np.asarray, part))
    ts, ys, pushes, energy = jax.tree.map(lambda *x: np.concatenate(x)[:total], *parts)
    speeds = jax.tree.map(np.abs, ys.v)
    tops, others = (
        jax.tree.map(lambda x: largest(x[::every]), (speeds, pushes)) for every in (1, 2)
    )
    # of the parabola through the samples
    sampling = jax.tree.map(lambda a, b: np.abs(a - b), tops, others)
    return (ts, ys.u, ys.v), *tops, np.asarray(np.mean(energy)), sampling


def slowly(flow: Flow, lattice: Lattice, state: StateLike, period: Scalar) -> str:
    """A sentence on a stable orbit of one or two periods near a state, to which it may settle slowly; empty without."""
    # by Newton's method, with a matrix of as many rows
    for multiple in (1, 2) if ravel_pytree(state)[0].size <= 512 else ():
        after = state
        for _ in range(multiple):
            after = flow(after, 0.0, period, lattice)
        steps = 2 * multiple * int(flow.steps)
        # between two states on either side of the orbit
        guess = State(*jax.tree.map(lambda a, b: (a + b) / 2, state, after))
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
