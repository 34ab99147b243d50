"""Reductions along a run, found between steps from the dense output, so that a sweep stores no trajectory."""

import abc
from collections.abc import Callable
from typing import Any, ClassVar

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp

from ..checks import refuse
from ..lattice import Lattice
from ..types import Number, Numbers, Parameter, Scalar, StateLike

NEWTON_STEPS = 4
# the record beside the user's own that says whether a contact opened
CLOSEST = "closest overlap"
# and the one of all compressions, from which follows how stiff the lattice has been
EXTREMES = "extreme compressions"


class Record(eqx.Module):
    """A quantity followed along a run: `start` gives what is carried, `follow` takes it over one step.

    A `sampled` record sees the quantity and its rate of change in the middle and at the end of each step; another one
    its value at the end alone.
    """

    quantity: eqx.AbstractVar[Callable]
    sampled: ClassVar[bool] = True

    @abc.abstractmethod
    def start(self, t: Number, q: Numbers, dq: Numbers) -> Any:
        """What is carried, from the quantity and its rate before the first step."""

    @abc.abstractmethod
    def follow(self, carried: Any, t0: Scalar, t1: Scalar, middle: Any, end: Any) -> Any:
        """What is carried after the step [t0, t1]; `middle` and `end` are pairs (quantity, rate)."""

    def finish(self, carried: Any) -> Numbers:
        """The result."""
        return carried[0]

    def value(self, t: Number, y: StateLike, lattice: Lattice) -> Numbers:
        """The quantity, one floating array."""
        q = self.quantity(t, y, lattice)
        if not isinstance(q, jax.Array) or not jnp.issubdtype(q.dtype, jnp.floating):
            refuse("record", "a function (t, y, lattice) that returns one floating array", repr(q))
        return q


def _function(quantity):
    if not callable(quantity):
        refuse("record", "a function (t, y, lattice)", repr(quantity), "Write gx.Peak(lambda t, y, lattice: ...).")
    return quantity


class Peak(Record):
    """Largest value of a quantity over the run, elementwise, found between steps.

    On each step the quantity and its rate at the start, middle and end of the dense output give a quintic; where the
    rate changes sign from + to -, Newton's method finds its top. Error of order h^6 of the quantity's own.

    **Arguments:** `quantity(t, y, lattice)`: an array, e.g. the contact forces; keep one function for many runs, as
    each new function compiles anew. **Result:** an array of the quantity's shape.
    """

    quantity: Callable = eqx.field(static=True, converter=_function)

    def start(self, t: Number, q: Numbers, dq: Numbers) -> Any:
        return q, q, dq

    def follow(self, carried: Any, t0: Scalar, t1: Scalar, middle: Any, end: Any) -> Any:
        best, q0, dq0 = carried
        q1, dq1 = end
        h = t1 - t0
        top = _summit(_quintic(h, (q0, dq0), middle, end), dq0 * h, dq1 * h)
        inside = (dq0 > 0) & (dq1 < 0)
        return jnp.maximum(best, jnp.maximum(q1, jnp.where(inside, top, q1))), q1, dq1


class Arrival(Record):
    """First time at which a quantity reaches a threshold from below, elementwise, found between steps; NaN if never.

    **Arguments:** `quantity(t, y, lattice)`: an array; `threshold`: a number or an array that broadcasts.
    """

    quantity: Callable = eqx.field(static=True, converter=_function)
    threshold: Parameter = 0.0

    def start(self, t: Number, q: Numbers, dq: Numbers) -> Any:
        return jnp.where(q >= self.threshold, t, jnp.nan).astype(q.dtype), q, dq

    def follow(self, carried: Any, t0: Scalar, t1: Scalar, middle: Any, end: Any) -> Any:
        when, q0, dq0 = carried
        q1, dq1 = end
        h = t1 - t0
        crossed = jnp.isnan(when) & (q0 < self.threshold) & (q1 >= self.threshold)
        s = _crossing(_quintic(h, (q0, dq0), middle, end), self.threshold, crossed)
        return jnp.where(crossed, t0 + s * h, when).astype(q1.dtype), q1, dq1


class Integral(Record):
    """Integral of a quantity over time, elementwise, by the quintic of each step (error of order h^7 a step).

    **Arguments:** `quantity(t, y, lattice)`: an array, e.g. a power or a momentum flux.
    """

    quantity: Callable = eqx.field(static=True, converter=_function)

    def start(self, t: Number, q: Numbers, dq: Numbers) -> Any:
        return jnp.zeros_like(q), q, dq

    def follow(self, carried: Any, t0: Scalar, t1: Scalar, middle: Any, end: Any) -> Any:
        total, q0, dq0 = carried
        q1, dq1 = end
        h = t1 - t0
        step = h * (7 * (q0 + q1) + 16 * middle[0]) / 30 + h * h * (dq0 - dq1) / 60
        return total + step.astype(total.dtype), q1, dq1


class Lowest(Record):
    """Smallest value of a quantity at the ends of steps, elementwise: cheap, and not refined between steps.

    **Arguments:** `quantity(t, y, lattice)`: an array.
    """

    sampled: ClassVar[bool] = False
    quantity: Callable = eqx.field(static=True, converter=_function)

    def start(self, t: Number, q: Numbers, dq: Numbers) -> Any:
        return q

    def follow(self, carried: Any, t0: Scalar, t1: Scalar, middle: Any, end: Any) -> Any:
        return jnp.minimum(carried, end)

    def finish(self, carried: Any) -> Numbers:
        return carried


class Extremes(Record):
    """Smallest and largest values of some quantities at the ends of steps, elementwise, which carry no derivative.

    **Arguments:** `quantity(t, y, lattice)`: a tree of arrays. **Result:** a pair of such trees.
    """

    sampled: ClassVar[bool] = False
    quantity: Callable = eqx.field(static=True, converter=_function)

    def value(self, t, y, lattice):
        return jax.lax.stop_gradient(self.quantity(t, y, lattice))

    def start(self, t, q, dq):
        return q, q

    def follow(self, carried, t0, t1, middle, end):
        low, high = carried
        return jax.tree.map(jnp.minimum, low, end), jax.tree.map(jnp.maximum, high, end)

    def finish(self, carried):
        return carried


def _quintic(h, start, middle, end):
    """Coefficients in s = (t - t0)/h of the quintic through value and rate at start, middle and end."""
    (a, da), (b, db), (c, dc) = start, middle, end
    da, db, dc = da * h, db * h, dc * h
    return (
        a, da,
        -23 * a + 16 * b + 7 * c - 6 * da - 8 * db - dc,
        66 * a - 32 * b - 34 * c + 13 * da + 32 * db + 5 * dc,
        -68 * a + 16 * b + 52 * c - 12 * da - 40 * db - 8 * dc,
        24 * a - 24 * c + 4 * da + 16 * db + 4 * dc,
    )


def _value(c, s):
    value = c[-1]
    for x in c[-2::-1]:
        value = value * s + x
    return value


def _slope(c):
    return tuple(k * x for k, x in enumerate(c))[1:]


def _summit(c, slope0, slope1):
    """The quintic's value where its slope, of these values at s = 0 and 1, vanishes inside the step."""
    first = _slope(c)
    second = _slope(first)
    fall = slope0 - slope1
    s = jnp.clip(slope0 / jnp.where(fall > 0, fall, jnp.inf), 0, 1)
    for _ in range(NEWTON_STEPS):
        curvature = _value(second, s)
        curvature = jnp.where(curvature < 0, curvature, -jnp.inf)
        s = jnp.clip(s - _value(first, s) / curvature, 0, 1)
    s, curvature = jax.lax.stop_gradient((s, curvature))
    # the second term is zero in value and in slope; it brings the moving place of the top into the second derivative
    return _value(c, s) - _value(first, s) ** 2 / (2 * curvature)


def _crossing(c, threshold, crossed):
    """Where the quintic crosses a threshold between s = 0 and 1, by bisection and then Newton."""
    low, high = jnp.zeros_like(c[0]), jnp.ones_like(c[0])
    for _ in range(6):
        middle = (low + high) / 2
        below = _value(c, middle) < threshold
        low, high = jnp.where(below, middle, low), jnp.where(below, high, middle)
    first = _slope(c)
    s = (low + high) / 2
    for _ in range(NEWTON_STEPS + 1):
        s = jax.lax.stop_gradient(s)  # of the last step alone: the implicit function's derivative
        slope = _value(first, s)
        s = jnp.clip(s - (_value(c, s) - threshold) / jnp.where(crossed & (slope > 0), slope, jnp.inf), low, high)
    return s


class Recorded(diffrax.AbstractWrappedSolver):
    """A solver that carries records beside its own state; a rejected step leaves them untouched."""

    solver: diffrax.AbstractSolver
    records: dict[str, Record]

    @property
    def term_structure(self):
        return self.solver.term_structure

    @property
    def interpolation_cls(self):
        return self.solver.interpolation_cls

    @property
    def term_compatible_contr_kwargs(self):
        return self.solver.term_compatible_contr_kwargs

    @property
    def scan_kind(self):
        return getattr(self.solver, "scan_kind", None)

    @property
    def root_finder(self):
        return self.solver.root_finder

    @property
    def root_find_max_steps(self):
        return self.solver.root_find_max_steps

    def order(self, terms):
        return self.solver.order(terms)

    def error_order(self, terms):
        return self.solver.error_order(terms)

    def init(self, terms, t0, t1, y0, args):
        values = self._rates(t0, y0, terms.vf(t0, y0, args), args)
        carried = {name: record.start(t0, *values[name]) for name, record in self.records.items()}
        return self.solver.init(terms, t0, t1, y0, args), carried

    def step(self, terms, t0, t1, y0, args, solver_state, made_jump):
        own, carried = solver_state
        y1, error, dense, own, result = self.solver.step(terms, t0, t1, y0, args, own, made_jump)
        middle, end = self._samples(self.solver.interpolation_cls(t0=t0, t1=t1, **dense), t0, t1, y1, args)
        carried = {name: self.records[name].follow(c, t0, t1, middle[name], end[name]) for name, c in carried.items()}
        return y1, error, dense, (own, carried), result

    def _rates(self, t, y, rate, lattice):
        t = jnp.asarray(t)
        moving = (jnp.ones_like(t), rate)
        return {
            name: jax.jvp(lambda t, y, record=record: record.value(t, y, lattice), (t, y), moving)
            for name, record in self.records.items()
        }

    def _samples(self, path, t0, t1, y1, lattice):
        """Value and rate of every record in the middle and at the end of a step."""
        sampled = {name: record for name, record in self.records.items() if record.sampled}
        middle = dict.fromkeys(self.records)
        end = {name: r.value(t1, y1, lattice) for name, r in self.records.items() if not r.sampled}
        if sampled:

            def along(t):
                values = {name: lambda t, r=r: r.value(t, path.evaluate(t), lattice) for name, r in sampled.items()}
                return {name: jax.jvp(value, (t,), (jnp.ones_like(t),)) for name, value in values.items()}

            # a loop, because XLA would fuse the dense output's coefficients into each of their many readers
            both = jax.lax.map(along, jnp.stack([t0 + (t1 - t0) / 2, t1]))
            middle |= jax.tree.map(lambda x: x[0], both)
            end |= jax.tree.map(lambda x: x[1], both)
        return middle, end

    def func(self, terms, t0, y0, args):
        return self.solver.func(terms, t0, y0, args)
