"""Response curves: the attractor followed up and down a parameter, with its jumps and its hysteresis."""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from diffrax import AbstractSolver
from jaxtyping import Float, Integer

from ..checks import refuse, whole
from ..checks import tolerance as checked_tolerance
from ..flow import Flow
from ..lattice import State
from ..measures import rms_velocity
from ..printing import told
from ..programs import shared_size
from ..results import Result, array, note, part
from ..solvers import SRKN11b
from ..types import Count, Displacements, Numbers, Parameter, Scalar, StateLike
from .attractors import Followed, errors_of, follow, otherwise, still_settles
from .branch import Bifurcation
from .problems import made, period_at
from .repeats import checked_period, checked_state, one_lattice
from .steps import COARSE, answered, default_steps, fixed_step_solver, history

# periods over which a response is taken: a multiple of those after which a motion may repeat
WATCHED = 12
# of the largest response: a change below it is no jump
SMALLEST = 1e-6
# budgets, the second for what does not repeat, the third where it settles still
BUDGETS = (1, 1, 8)
# the least tolerance, and the share of it to which a jump settles
LEAST = 1e-12
TIGHT = 1e-2
# halvings beyond the accuracy for which a jump must last
NARROW = 10
# rounds of halving and settling
AGAIN = 6


class Jump(NamedTuple):
    """A jump of the response at `value`: `before` and `after` it, in the direction of the sweep."""

    value: float
    before: float
    after: float
    __repr__ = told


class Way(Result):
    """One way along a response curve, in the order of `ResponseCurve.values` whichever way it went.

    Errors are estimated distances from the true motion, as of `settle`; NaN where nothing repeats, or half the steps
    settle to nothing.
    """

    response: Float[np.ndarray, " value"] = array("The chosen number at each value.")
    velocity: Displacements = array(
        "The root mean square velocity of each site.", "m/s", "value site"
    )
    energy: Float[np.ndarray, " value"] = array("The mean energy.", "J")
    response_error: Float[np.ndarray, " value"] = array("The error of the response.")
    velocity_error: Displacements = array("The error of the velocity.", "m/s", "value site")
    energy_error: Float[np.ndarray, " value"] = array("The error of the energy.", "J")
    multiple: Integer[np.ndarray, " value"] = array(
        "The periods after which the motion repeats, 0 where it does not."
    )
    periods: Integer[np.ndarray, " value"] = array("The number of periods that were run.")
    states: State = part("The states at phase 0.", "value site", name="state")
    jumps: tuple[Jump, ...] = array("The jumps, as they were met.", axes="jump")
    bifurcations: tuple[Bifurcation, ...] = array(
        "The bifurcations, as they were met.", axes="bifurcation"
    )

    @property
    def outcome(self) -> str:
        """What was met on the way."""
        repeats = np.count_nonzero(self.multiple)
        return (
            f"{len(self.jumps)} jumps, {len(self.bifurcations)} changes of the repetition; the motion repeats at "
            f"{repeats} of {len(self.multiple)} values."
        )


class ResponseCurve(Result):
    """What `response` returns: the two ways, and where they differ."""

    values: Float[np.ndarray, " value"] = array(
        "The values of the parameter, ascending.", name="value"
    )
    up: Way = array("The way up.")
    down: Way | None = array("The way down, `None` where it was not run.")
    hysteresis: list = note(
        "Intervals (low, high) of the parameter in which the two ways have settled "
        "differently; their ends are jumps where there is one beside, else values that were "
        "asked for."
    )

    @property
    def outcome(self) -> str:
        """What was met, and where the ways differ."""
        if self.down is None:
            return f"Up: {self.up.outcome}"
        where = ", ".join(f"{low:.6g} ... {high:.6g}" for low, high in self.hysteresis) or "nowhere"
        return f"Up: {self.up.outcome} Down: {self.down.outcome} They differ {where}."


def response(
    make: Callable[[Any], Any],
    values: Parameter,
    period: Callable[[Any], Any] | Scalar,
    *,
    state: StateLike | None = None,
    response: Callable[[Any, Any, Any, Any], Any] = rms_velocity,
    jump: Scalar = 0.2,
    accuracy: Scalar = 1e-3,
    periods: Count = 2000,
    tolerance: Scalar = 1e-6,
    steps: Count | None = None,
    solver: AbstractSolver | None = None,
    down: bool = True,
) -> ResponseCurve:
    r"""Follow the attractor of a forced lattice while one parameter goes up its values, and then down again.

    Each value starts from the state that the one before left at phase 0, and runs until it repeats (`settle`); what has
    spent its budget runs on for another one, and for up to eight more where it settles still, before it counts as not
    repeating. The response is then taken over twelve periods more. A change of the response between two values by more
    than `jump`, relative to the larger, is halved, each time from the state before it, until it is known to `accuracy`.
    It is a jump if more than half of it is left when both sides have settled to a hundredth of `tolerance`, and still
    is when it is known a thousand times better: a steep flank is none. Changes between two motions that do not repeat
    are none, nor those below 1e-6 of the largest response. A change of the repetition is halved in the same way; beside
    a bifurcation the motion settles slowly, so that a small budget places it where settling first takes longer.

    **Arguments:**

    - `make(value)`: the lattice at a value of the parameter (a frequency, an amplitude, a preload); traced once, so
      that all values share one compiled program. `period`: T, a number or a function of it: `lambda w: 2 * jnp.pi / w`.
    - `values` (P,): ascending, P >= 2, as close as the attractor is to be followed. `state`: the first, at rest by
      default. `down`: the way back too, from where the way up ended.
    - `response(lattice, u, v, t)`: a number from one history u, v (S, N) over those periods, t (S,) from phase 0 on;
      by default the root mean square of all velocities.
    - `jump`, `accuracy`: above; both relative.
    - `periods`, `tolerance`, `steps`, `solver`: as in `settle`; the first or last value sets the steps, which are
      rounded up by an eighth at most, so that curves of near-by scenes are one program.

    **Returns:** `ResponseCurve`; without `down` its `down` is `None`, and no hysteresis. **Raises** ValueError
    for fewer than two values, values that do not ascend, a batch of lattices, or a period after which the forces do
    not repeat.

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
            "The way down comes by itself.",
        )
    # no response jumps by more than twice the larger
    jump = float(checked_tolerance("jump", jump, 2, 0.2))
    accuracy = float(checked_tolerance("accuracy", accuracy, 1, 1e-3))
    tolerance = float(checked_tolerance("tolerance", tolerance))
    scenes = [(scene, float(T)) for scene, T in (made(make, period, w) for w in values[[0, -1]])]
    first = one_lattice(scenes[0][0])
    if steps is None:
        steps = shared_size(max(default_steps(*scene, fineness=COARSE) for scene in scenes))
    flow = Flow(whole("steps", steps, 1), fixed_step_solver(first, solver, SRKN11b()))
    state = State(first.zeros(), first.zeros()) if state is None else checked_state(first, state)
    for lattice, T in scenes:
        checked_period(lattice, state, 0.0, T)
    period = period if callable(period) else jnp.asarray(float(period))
    watched = _Watched(make, period, response, flow, periods)

    def attractor(value, y, share=1.0):
        """What is settled to a share of the tolerance, run longer than the budget if need be."""
        tight, used = jnp.asarray(max(share * tolerance, LEAST)), 0
        for budget in BUDGETS:
            found = watched.run(jnp.asarray(value), y, tight, jnp.asarray(budget * periods))
            y, used = found.motion.state, used + found.motion.used
            found = found._replace(motion=found.motion._replace(used=used))
            settles = found.motion.once or still_settles(found.motion.changes[:, 0], periods)
            ends = found.multiple or not np.isfinite(found.response)
            if ends or used > periods and not settles:
                break
        return found

    def way(y, direction):
        """The way up or down from a state on."""
        order, found = values[::direction], []
        for value in order:
            found.append(attractor(value, y))
            y = found[-1].motion.state
        floor = SMALLEST * max(abs(float(x.response)) for x in found)
        steps = list(zip(order, found, order[1:], found[1:]))
        jumps = [_jump(attractor, step, accuracy, jump, floor) for step in steps]
        changes = [
            _bifurcation(attractor, step, accuracy, i, first.origin) for i, step in enumerate(steps)
        ]
        errors = [
            watched.errors(jnp.asarray(value), x, jnp.asarray(tolerance))
            for value, x in zip(order, found)
        ]
        stack = lambda items: jax.tree.map(lambda *x: np.stack(x), *items[::direction])
        found, errors = stack(found), stack(errors)
        return Way(
            *found[1:],
            *errors,
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
    return ResponseCurve(values, up, back, _hysteresis(values, up, back, jump), **first.origin)


class _Found(NamedTuple):
    """What is found at a value of the parameter: the motion, and what is seen of it."""

    motion: Followed
    response: Numbers
    velocity: Displacements
    energy: Numbers

    @property
    def multiple(self):
        return int(self.motion.multiple)


class _Watched(eqx.Module):
    """What is run at each value of the parameter, and what is looked at."""

    make: Callable
    period: Callable | Scalar
    response: Callable
    flow: Flow
    periods: int

    @eqx.filter_jit
    def run(self, value, y, tolerance, most):
        """What is found at a value."""
        lattice, T = self.make(value), period_at(self.period, value)
        found = follow(self.flow, lattice, y, T, self.periods, tolerance, most)
        end, *seen = self._seen(self.flow, lattice, found.state, T)
        return _Found(found._replace(state=end), *seen)

    @eqx.filter_jit
    def errors(self, value, found, tolerance):
        """The errors of what is seen at a value."""
        lattice, T = self.make(value), jnp.asarray(period_at(self.period, value))
        repeats = found.motion.multiple > 0
        motion = found.motion._replace(multiple=jnp.maximum(found.motion.multiple, 1))
        y, left = otherwise(self.flow, lattice, motion, T, self.periods, tolerance)
        coarse = Flow(max(self.flow.steps // 2, 1), self.flow.solver)
        _, *other = self._seen(coarse, lattice, y, T)
        return errors_of([*found[1:]], other, jnp.where(repeats, left, jnp.nan))

    def _seen(self, flow, lattice, y, period):
        end, ts, ys = history(flow, lattice, y, 0.0, period, flow.steps, WATCHED)
        velocity = jax.tree.map(lambda v: jnp.sqrt(jnp.mean(v * v, 0)), ys.v)
        energy = jnp.mean(jax.vmap(lambda t, y: lattice.energy(t, *y))(ts, ys))
        return end, answered(self.response, lattice, ys, ts), velocity, energy


def _halved(attractor, step, accuracy, belongs, share=1.0):
    """A step between two values, halved to an accuracy: a middle that belongs to the start becomes the start."""
    low, a, high, b = step
    while abs(high - low) > accuracy * max(abs(low), abs(high)):
        middle = (low + high) / 2
        if middle in (low, high):
            break
        c = attractor(middle, a.motion.state, share)
        if belongs(a, c, b):
            low, a = middle, c
        else:
            high, b = middle, c
    return low, a, high, b


def _jump(attractor, step, accuracy, share, floor):
    def apart(a, b):
        return abs(float(a.response) - float(b.response))

    def left(step):
        _, a, _, b = step
        larger = max(abs(float(a.response)), abs(float(b.response)))
        return apart(a, b) > max(share * larger, floor) and apart(a, b) >= first / 2

    def nearer(a, c, b):
        return apart(a, c) < apart(c, b)

    begin, a, end, b = step
    first = apart(a, b)
    if not left(step) or a.multiple == b.multiple == 0:
        return None
    share_of_tolerance = 1.0
    for _ in range(AGAIN):
        low, c, high, d = step = _halved(attractor, step, accuracy, nearer, share_of_tolerance)
        if not left(step):
            return None
        c, d = attractor(low, c.motion.state, TIGHT), attractor(high, d.motion.state, TIGHT)
        step, share_of_tolerance = (low, c, high, d), TIGHT
        if left(step):
            break
        # one of them had not left the branch that ends before it: the jump, if any, lies on its other side
        step = (begin, a, low, c) if nearer(b, c, a) else (high, d, end, b)
    for halvings in range(NARROW + 1):
        if not left(step):
            return None
        low, a, high, b = step = _halved(attractor, step, accuracy / 2**halvings, nearer, TIGHT)
    if not left(step):
        return None
    return Jump(float((low + high) / 2), float(a.response), float(b.response))


def _bifurcation(attractor, step, accuracy, i, origin):
    _, a, _, b = step
    if a.multiple == b.multiple:
        return None
    same = lambda a, c, b: a.multiple == c.multiple
    low, _, high, _ = _halved(attractor, step, accuracy, same)
    place = float((low + high) / 2)
    return Bifurcation("repetition", place, i, None, None, a.multiple, b.multiple, **origin)


def _hysteresis(values, up, down, share):
    larger = np.maximum(np.abs(up.response), np.abs(down.response))
    apart = np.abs(up.response - down.response) > share * larger
    places = sorted(jump.value for way in (up, down) for jump in way.jumps)
    intervals = []
    for run in np.split(np.arange(len(values)), np.flatnonzero(np.diff(apart)) + 1):
        if apart[run[0]]:
            low, high = values[run[0]], values[run[-1]]
            before, behind = values[max(run[0] - 1, 0)], values[min(run[-1] + 1, len(values) - 1)]
            below = [p for p in places if before <= p <= low]
            above = [p for p in places if high <= p <= behind]
            intervals.append((float([*below, low][0]), float([high, *above][-1])))
    return intervals
