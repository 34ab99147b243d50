"""Periodically forced chains, period by period, until what is seen once a period repeats."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from diffrax import AbstractSolver
from jax.flatten_util import ravel_pytree
from jaxtyping import Float

from ..checks import positive, traced, whole
from ..checks import tolerance as checked_tolerance
from ..flow import Flow
from ..lattice import Lattice, State
from ..measures import contacts
from ..results import Result, array, part
from ..solvers import SRKN11b
from ..types import Count, Counts, Displacements, Numbers, Pytree, Scalar, StateLike, Times
from .orbit import forced_orbit
from .repeats import checked_period, checked_state, one_lattice
from .steps import default_steps, fixed_step_solver

# h omega of the default step, with omega the highest linear frequency
STEP_FRACTION = 0.4
# periods after which a stroboscopic state may repeat
MULTIPLES = (1, 2, 3, 4)
# a repetition after m periods counts where that after a divisor of m is this many times worse
APART = 1e3
# the disturbance that the motion must forget, over the tolerance: too small to be taken for a doubled period
DISTURBANCE = 1e2
# periods that are kept of a motion that does not repeat
KEPT = 16
# repetitions over which changes are compared with those of as many before
STRETCH = 8
# steps of a settled motion that one call of its program makes
AT_ONCE = 64
# numbers of a state, up to which its orbit is looked for by Newton's method: a matrix of as many rows
POLISHED = 512
# of what half the steps change: where contacts open that may be small by accident
SAFETY = 4


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
    outcome: str = eqx.field(static=True)

    @property
    def settled(self) -> bool:
        """Whether the motion repeats."""
        return self.multiple > 0


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
    state, period = checked_state(one_lattice(lattice), state), float(positive("period", period))
    tolerance = float(checked_tolerance("tolerance", tolerance))
    steps = steps_per_period(lattice, period) if steps is None else whole("steps", steps, 1)
    checked_period(lattice, state, 0.0, period)
    solver = fixed_step_solver(lattice, solver, SRKN11b())
    # arrays, whose values compile nothing anew
    flow, T = Flow(jnp.asarray(steps), solver), jnp.asarray(period, lattice.dtype)
    tight = jnp.asarray(tolerance, lattice.dtype)
    end, used, multiple, changes, _, rate = _follow(flow, lattice, state, T, periods, tight)
    used, multiple = int(used), int(multiple)
    (ts, us, vs), seen, sampling = _watch(solver, lattice, end, T, multiple or KEPT, steps)
    found = end, *seen
    errors = jax.tree.map(lambda x: np.full_like(x, np.nan), found)
    if multiple:
        other, left = _otherwise(
            flow, lattice, end, T, jnp.asarray(multiple), jnp.asarray(periods), tight, rate
        )
        errors = _apart(
            found, (other, *_watch(solver, lattice, other, T, multiple, steps)[1]), left, sampling
        )
    changes = np.asarray(changes)[:used]
    change = float(changes[-1, MULTIPLES.index(multiple)] if multiple else changes[-1, 0])
    outcome = _sentence(used, multiple, change, changes[:, 0])
    if outcome is None:
        slow, changing = slowly(flow, lattice, end, period), f"it changes by {change:.1e} a period."
        outcome = (
            f"Undecided after {used} periods: {changing} {slow}"
            if slow
            else f"Not periodic within {used} periods: quasi-periodic or chaotic, {changing}"
        )
    return Attractor(
        end,
        period,
        used,
        multiple,
        change,
        changes[:, 0],
        ts,
        us,
        vs,
        *seen,
        *errors,
        outcome,
        **lattice.origin,
    )


def steps_per_period(lattice: Lattice, period: Scalar) -> Scalar:
    """Steps in a period such that h omega_max <= 0.4, with omega_max the highest linear frequency."""
    return default_steps(lattice, period, fineness=STEP_FRACTION)


def follow(
    flow: Flow,
    lattice: Lattice,
    state: StateLike,
    period: Scalar,
    periods: Count,
    tolerance: Scalar,
    most: Counts | None = None,
) -> tuple:
    """From phase 0 on until a state repeats, twice: (state, periods used, multiple or 0, changes, once, rate).

    `changes` (periods, 4); `once`: whether it has repeated before it was disturbed; `rate`: by which a change becomes
    less from one repetition to the next, after the disturbance. For use inside of `jax.jit`; `periods` is a Python
    integer, how many changes are kept, and unless there is `most`, which may be traced, also the most that are run.
    """
    most = periods if most is None else most
    flat, unravel = ravel_pytree(State(*state))
    half = flat.size // 2
    weight = jnp.concatenate([jnp.full(half, 2 * jnp.pi / period), jnp.ones(half)])
    noise = np.concatenate([np.zeros(half), np.random.default_rng(0).uniform(-1, 1, half)])

    def repeats(change, changes, now):
        found = 0
        for i, m in reversed(list(enumerate(MULTIPLES))):
            own = change[i] <= tolerance
            divisors = jnp.array([change[j] for j, d in enumerate(MULTIPLES[:i]) if m % d == 0])
            if divisors.size:
                # what comes slowly to an orbit of fewer periods changes by little in several: what is left of its way
                # is the sum of a geometric series
                lag = min(STRETCH * m, periods - 1)
                early = changes[(now - lag) % periods, i]
                rate = jnp.where(early > 0, change[i] / jnp.where(early > 0, early, 1), 0) ** (
                    m / lag
                )
                left = jnp.where(rate < 1, change[i] / jnp.where(rate < 1, 1 - rate, 1), jnp.inf)
                own &= (now >= lag) & jnp.all(
                    divisors > jnp.maximum(APART * tolerance, SAFETY * left)
                )
            found = jnp.where(own, m, found)
        return found

    def going(carry):
        i, _, _, multiple, changes = carry
        return (
            (i < most) & (multiple == 0) & jnp.isfinite(changes[jnp.maximum(i - 1, 0) % periods, 0])
        )

    def run(y, begin, changes):
        def one(carry):
            i, y, last, _, changes = carry
            y = flow(y, 0.0, period, lattice)
            x = weight * ravel_pytree(y)[0]
            size = jnp.max(jnp.abs(x))
            change = jnp.max(jnp.abs(x - last), 1) / jnp.where(size > 0, size, 1)
            multiple = jnp.where(i >= begin + max(MULTIPLES), repeats(change, changes, i), 0)
            return (
                i + 1,
                y,
                jnp.concatenate([x[None], last[:-1]]),
                multiple,
                changes.at[i % periods].set(change),
            )

        x = weight * ravel_pytree(y)[0]
        start = begin, y, jnp.broadcast_to(x, (max(MULTIPLES), x.size)), 0, changes
        return jax.lax.while_loop(going, one, start)

    begin = jnp.zeros((), int)
    used, y, _, before, changes = run(
        State(*state), begin, jnp.zeros((periods, len(MULTIPLES)), flat.dtype)
    )
    x = ravel_pytree(y)[0]
    y = unravel(x + DISTURBANCE * tolerance * jnp.max(jnp.abs(weight * x)) * noise)
    begin = used
    used, y, _, multiple, changes = run(y, begin, changes)
    return y, used, multiple, changes, before > 0, _rate(changes, used, used - begin, multiple)


def _rate(changes, used, count, multiple):
    """The rate of the last `count` periods' changes, from the largest of two stretches one after the other."""
    column = jnp.searchsorted(jnp.array(MULTIPLES), jnp.maximum(multiple, 1))
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
    state: StateLike,
    period: Scalar,
    multiple: Counts,
    most: Counts,
    tolerance: Scalar,
    rate: Scalar,
) -> tuple[State, Scalar]:
    """Where half the steps settle from a state on, and the share of its size by which either may still be off.

    What changes by c a repetition and by a factor r less at each, `rate` at the least, is c r/(1 - r) from its end. For
    use inside of `jax.jit`; NaN where it does not settle within `most` periods.
    """
    coarse = Flow(jnp.maximum(flow.steps // 2, 1), flow.solver)
    flat, _ = ravel_pytree(state)
    weight = jnp.where(jnp.arange(flat.size) < flat.size // 2, 2 * jnp.pi / period, 1).astype(
        flat.dtype
    )

    def going(carry):
        i, _, _, change = carry
        return (i * multiple < most) & (change > tolerance)

    def one(carry):
        i, y, first, _ = carry
        after = jax.lax.fori_loop(
            0, multiple, lambda _, y: coarse(y, jnp.zeros_like(period), period, lattice), y
        )
        x, before = (weight * ravel_pytree(s)[0] for s in (after, y))
        size = jnp.max(jnp.abs(x))
        change = jnp.max(jnp.abs(x - before)) / jnp.where(size > 0, size, 1)
        return i + 1, after, jnp.where(i == 0, change, first), change

    infinite = jnp.full((), jnp.inf, flat.dtype)
    count, y, first, last = jax.lax.while_loop(
        going, one, (jnp.zeros((), int), state, infinite, infinite)
    )
    own = jnp.where((count > 1) & (first > 0), (last / first) ** (1 / jnp.maximum(count - 1, 1)), 0)
    rate = jnp.maximum(own, rate)
    left = jnp.maximum(last, tolerance) / jnp.maximum(1 - rate, jnp.finfo(flat.dtype).eps)
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
def _stretch(solver, lattice, state, period, steps, first):
    """Some steps from the one of number `first` on: (the state after them, times, states, forces, energies)."""
    one, h = Flow(1, solver), period / steps

    def step(y, i):
        t = h * (i % steps)  # every period at the same phase
        return one(y, t, t + h, lattice), (h * i, y, forces(lattice, y, t), lattice.energy(t, *y))

    return jax.lax.scan(step, state, first + jnp.arange(AT_ONCE))


def _watch(solver, lattice, state, period, count, steps):
    """(times, displacements, velocities) of so many periods, what is seen in them, and the error of its sampling.

    By stretches of one length, so that another number of steps compiles nothing.
    """
    total, parts = count * steps, []
    for first in range(0, total, AT_ONCE):
        state, part = _stretch(
            solver, lattice, state, period, jnp.asarray(steps), jnp.asarray(first)
        )
        parts.append(jax.tree.map(np.asarray, part))
    ts, ys, pushes, energy = jax.tree.map(lambda *x: np.concatenate(x)[:total], *parts)
    speeds = jax.tree.map(np.abs, ys.v)
    tops, others = (
        jax.tree.map(lambda x: largest(x[::every]), (speeds, pushes)) for every in (1, 2)
    )
    # of the parabola through the samples
    sampling = jax.tree.map(lambda a, b: np.abs(a - b), tops, others)
    return (ts, ys.u, ys.v), (*tops, np.asarray(np.mean(energy))), sampling


def slowly(flow: Flow, lattice: Lattice, state: StateLike, period: Scalar) -> str:
    """A sentence on a stable orbit of one or two periods near a state, to which it may settle slowly; empty without."""
    size = ravel_pytree(state)[0].size
    for multiple in (1, 2) if size <= POLISHED else ():
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
        name, forgets = (
            "one period" if multiple == 1 else "two periods",
            -multiple / np.log(np.abs(rho)),
        )
        return (
            f"An orbit of {name} near it is stable. Its largest multiplier is {size}: a disturbance takes "
            f"{forgets:.2g} periods to fall to 1/e, and the motion may settle to it slowly. Give more periods, or "
            "begin at the orbit that gx.forced.forced_orbit finds."
        )
    return ""


def _sentence(used, multiple, change, changes):
    if not np.isfinite(change):
        return f"The state ceased to be finite after {used} periods: take more steps per period."
    if multiple == 1:
        return f"Settled: it repeats every period to {change:.1e}, after {used} periods."
    if multiple:
        name = {2: "period-doubled", 3: "period-tripled", 4: "doubled twice"}[multiple]
        return f"Settled, {name}: it repeats every {multiple} periods to {change:.1e}, after {used} periods."
    part = max(1, used // 8)
    early, late = np.median(changes[used // 2 - part : used // 2]), np.median(changes[-part:])
    if late < early / 2:
        return f"Still settling after {used} periods: the change a period is {change:.1e} and falls; give more periods."
    return None
