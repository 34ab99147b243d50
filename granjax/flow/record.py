"""What is kept of a quantity along a run, found between steps from the dense output: no trajectory is stored."""

import abc
import inspect
from collections.abc import Callable
from functools import reduce
from typing import Any, ClassVar, NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..checks import refuse
from ..lattice import Lattice
from ..printing import told
from ..solvers.interpolation import Bootstrapped, QuinticHermite, bootstrapped
from ..solvers.wrapped import Wrapped
from ..types import AnyArray, Count, Number, Numbers, Parameter, Pytree, Scalar, StateLike
from .bath import baths, isolated
from .control import OneSided, inside
from .within import crossing, guesses, higher, lobatto, mean, places, series, span, tops, value

# the record beside the user's own that says whether a contact opened
CLOSEST = "closest overlap"
# and the one of all compressions, from which follows how stiff the lattice has been
EXTREMES = "extreme compressions"
# tops that are looked for within a step, one for each of this number of samples
SAMPLES_PER_TOP = 8
# how far a top may be above the highest sample, over the span of the samples
HIDDEN = 0.25
FORMS = "a function (t, y, lattice) or a measure (lattice, y, t)"


class Record(eqx.Module):
    """A quantity followed along a run: `start` gives what is carried, `follow` takes it over one step.

    The quantity is a function `(t, y, lattice)`, or a measure as in `gx.measures`: a function whose first argument is
    called `lattice`, which is given `(lattice, y)`, and `t` where it takes an argument of that name. It returns a
    floating array, or a tree of them (a dict of fields), each of which is followed on its own. Keep one function for
    many runs, as each new one compiles anew.

    A `sampled` record is given the quantity at places within each step, as many as the solver's order needs, along
    the first axis; another one its value at the end alone.

    **Example:**

    >>> class Fastest(gx.Record):
    ...     quantity: object
    ...     sampled = False
    ...     def start(self, t, q, count): return q
    ...     def follow(self, carried, t0, step, q): return jnp.maximum(carried, q)
    >>> chain = gx.scenes.monomer(20)
    >>> record = {"fastest": Fastest(lambda t, y, lattice: y.v)}
    >>> run = gx.simulate(chain, gx.states.impact(chain), 5.0, step=0.05, record=record)
    >>> run.recorded["fastest"][:3].round(3)
    Array([1.   , 0.751, 0.714], dtype=float64)
    """

    quantity: eqx.AbstractVar[Callable]
    sampled: ClassVar[bool] = True
    __repr__ = told

    @abc.abstractmethod
    def start(self, t: Number, q: Numbers, count: Count) -> Any:
        """What is carried, from the quantity before the first step and the number of samples within a step."""

    @abc.abstractmethod
    def follow(self, carried: Any, t0: Scalar, step: Scalar, q: Any) -> Any:
        """What is carried after the step from t0 to t0 + step; `q`: samples (count, ...) or the value at its end."""

    def finish(self, carried: Any) -> Numbers:
        """The result."""
        return carried

    def short(self, carried: Any) -> Numbers:
        """How far the quantity has stayed below what is waited for; infinite where nothing is."""
        return jnp.asarray(jnp.inf)

    def value(self, t: Number, y: StateLike, lattice: Lattice) -> Pytree:
        """The quantity, a floating array or a tree of them."""
        q = _called(self.quantity, t, y, lattice)
        leaves = jax.tree.leaves(q)
        if not leaves or not all(
            isinstance(x, jax.Array) and jnp.issubdtype(x.dtype, jnp.floating) for x in leaves
        ):
            refuse("record", f"{FORMS} that returns floating arrays", repr(q))
        return q


def _array(x: Parameter) -> AnyArray:
    return x if isinstance(x, jax.Array) else np.asarray(x, float)


def _called(quantity, t, y, lattice):
    """The quantity at a state, in the order of arguments that it is written in."""
    try:
        names = list(inspect.signature(quantity).parameters)
    except (TypeError, ValueError):  # a function that does not say
        names = []
    if names[:1] != ["lattice"]:
        return quantity(t, y, lattice)
    return quantity(lattice, y, t=t) if "t" in names else quantity(lattice, y)


class Peak(Record):
    """Largest value of a quantity over the run, elementwise, found between steps.

    The top of the polynomial through the samples of each step, by Newton's method.

    **Arguments:** `quantity`: `(t, y, lattice)` or a measure, e.g. `gx.measures.contact_force`; see `Record`.
    **Result:** an array of the quantity's shape.

    **Example:**

    >>> chain = gx.scenes.monomer(20)
    >>> force = gx.measures.contact_force
    >>> record = {"peak": gx.Peak(force), "arrival": gx.Arrival(force, threshold=0.1)}
    >>> run = gx.simulate(chain, gx.states.impact(chain), 5.0, step=0.05, record=record)
    >>> run.recorded["peak"][1:4].round(4)
    Array([0.7584, 0.6916, 0.6655], dtype=float64)
    """

    quantity: Callable = eqx.field(static=True)

    def start(self, t: Number, q: Numbers, count: Count) -> Any:
        return q

    def follow(self, carried: Any, t0: Scalar, step: Scalar, q: Any) -> Any:
        best = jnp.maximum(carried, q[1:].max(0))
        near = guesses(q, _most(q))

        def refined():
            return reduce(jnp.maximum, (top.height for top in tops(q, near)), best)

        return jax.lax.cond(jnp.any(higher(q, near, best)), refined, lambda: best)


class Lowest(Peak):
    """Smallest value of a quantity over the run, elementwise, found between steps as `Peak` finds the largest."""

    def start(self, t: Number, q: Numbers, count: Count) -> Any:
        return super().start(t, -q, count)

    def follow(self, carried: Any, t0: Scalar, step: Scalar, q: Any) -> Any:
        return super().follow(carried, t0, step, -q)

    def finish(self, carried: Any) -> Numbers:
        return -carried


class PeakTime(Peak):
    """When a quantity is the largest, elementwise, found between steps as `Peak` finds how large: the first of equals.

    **Arguments:** `quantity`: as in `Peak`.
    """

    def start(self, t: Number, q: Numbers, count: Count) -> Any:
        return q, jnp.zeros_like(q) + jnp.asarray(t, q.dtype)

    def follow(self, carried: Any, t0: Scalar, step: Scalar, q: Any) -> Any:
        x, c, near = places(q).reshape(-1), series(q), guesses(q, _most(q))
        best, when = carried
        highest = q.max(0)
        for top in tops(q, near):
            # one that is no higher than a sample by what is resolved still says where
            place = jnp.where(value(c, top.place) >= highest, top.place, x[jnp.argmax(q, 0)])
            height = jnp.maximum(top.height, highest)
            above = height > best
            best = jnp.where(above, height, best)
            when = jnp.where(above, t0 + (place + 1) / 2 * step, when).astype(when.dtype)
        return best, when

    def finish(self, carried: Any) -> Numbers:
        return carried[1]


class Arrival(Record):
    """First time at which a quantity reaches a threshold from below, elementwise, found between steps; NaN if never.

    Where it is above at the start, the time of the start. A crossing that rises and falls within one step is found by
    its top.

    **Arguments:** `quantity`: as in `Peak`; `threshold`: a number or an array that broadcasts; another one compiles
    nothing anew.

    **Example:**

    >>> chain = gx.scenes.monomer(20)
    >>> force = gx.measures.contact_force
    >>> record = {"peak": gx.Peak(force), "arrival": gx.Arrival(force, threshold=0.1)}
    >>> run = gx.simulate(chain, gx.states.impact(chain), 5.0, step=0.05, record=record)
    >>> run.recorded["arrival"][1:4].round(4), bool(jnp.isnan(run.recorded["arrival"][-1]))
    (Array([0.2165, 1.2738, 2.4235], dtype=float64), True)
    """

    quantity: Callable = eqx.field(static=True)
    threshold: Parameter = eqx.field(default=0.0, converter=_array)

    def start(self, t: Number, q: Numbers, count: Count) -> Any:
        zero = jnp.zeros_like(q)
        at_once = q >= self._threshold(q)
        return (
            at_once,
            q,
            (zero + t).astype(q.dtype),
            zero,
            zero,
            zero,
            jnp.zeros((count, *q.shape), q.dtype),
        )

    def follow(self, carried: Any, t0: Scalar, step: Scalar, q: Any) -> Any:
        found = carried[0]
        still = jax.lax.stop_gradient(q)
        never = jnp.zeros_like(still[0]), jnp.full_like(still[0], jnp.inf), still.max(0)
        close = jnp.any(~found & (still.max(0) + HIDDEN * span(still) >= self._threshold(q)))
        low, high, top = jax.lax.cond(close, lambda: self._bracket(found, still), lambda: never)
        crossed = ~found & (high < jnp.inf)
        now = t0, step, low, high, q
        kept = [
            jnp.where(crossed, new, old).astype(old.dtype) for new, old in zip(now, carried[2:])
        ]
        return found | crossed, jnp.maximum(carried[1], top), *kept

    def _threshold(self, q):
        return jnp.asarray(self.threshold, q.dtype)

    def _bracket(self, found, q):
        """Two places within a step between which the threshold is first passed, or 0 and infinity; and the top."""
        x, threshold = places(q), jax.lax.stop_gradient(self._threshold(q))
        high = jnp.where(q[1:] >= threshold, x[1:], jnp.inf).min(0)
        near = guesses(q, _most(q), high)

        def with_tops():
            found = tops(q, near)
            reached = [jnp.where(top.height >= threshold, top.place, jnp.inf) for top in found]
            return reduce(jnp.minimum, reached, high), reduce(
                jnp.maximum, (top.height for top in found), q.max(0)
            )

        hidden = jnp.any(~found & higher(q, near, threshold))
        high, top = jax.lax.cond(hidden, with_tops, lambda: (high, q.max(0)))
        return jnp.where(x < high, x, -1).max(0), high, top

    def finish(self, carried: Any) -> Numbers:
        found, _, t0, step, low, high, q = carried
        within = found & (step > 0)
        x = crossing(series(q), self._threshold(q), low, high, within)
        return jnp.where(found, t0 + jnp.where(within, (x + 1) / 2 * step, 0), jnp.nan)

    def short(self, carried: Any) -> Numbers:
        return jax.lax.stop_gradient(self._threshold(carried[1]) - carried[1])


class Integral(Record):
    """Integral of a quantity over time, elementwise, by Gauss and Lobatto's rule on the samples of each step.

    **Arguments:** `quantity`: as in `Peak`, e.g. a power or a momentum flux.

    **Example:**

    >>> chain = gx.scenes.monomer(20)
    >>> record = {"impulse": gx.Integral(gx.measures.contact_force), "lowest": gx.Lowest(gx.measures.strain)}
    >>> run = gx.simulate(chain, gx.states.impact(chain), 5.0, step=0.05, record=record)
    >>> round(float(run.recorded["impulse"][1]), 4), round(1 - float(run.final.v[0]), 4)
    (1.0711, 1.0711)
    """

    quantity: Callable = eqx.field(static=True)

    def start(self, t: Number, q: Numbers, count: Count) -> Any:
        return jnp.zeros_like(q)

    def follow(self, carried: Any, t0: Scalar, step: Scalar, q: Any) -> Any:
        return carried + (step * mean(q)).astype(carried.dtype)


class AtEnds(Record):
    """Smallest value of a quantity at the ends of steps, elementwise: cheap, and not refined between steps.

    **Arguments:** `quantity`: as in `Peak`.
    """

    sampled: ClassVar[bool] = False
    quantity: Callable = eqx.field(static=True)

    def start(self, t: Number, q: Numbers, count: Count) -> Any:
        return q

    def follow(self, carried: Any, t0: Scalar, step: Scalar, q: Any) -> Any:
        return jnp.minimum(carried, q)


def _most(q):
    return -(-len(q) // SAMPLES_PER_TOP)


class Dips(AtEnds):
    """Smallest value of a quantity, at the ends of steps and on the cubic through each step's values and rates.

    **Arguments:** `quantity`: as in `Peak`, the values and their rates stacked along the first axis.
    """

    def start(self, t: Number, q: Numbers, count: Count) -> Any:
        return q[0], q

    def follow(self, carried: Any, t0: Scalar, step: Scalar, q: Any) -> Any:
        least, (a, slope) = carried
        (end, last), b = q, step * slope
        c, d = 3 * (end - a) - 2 * b - step * last, 2 * (a - end) + b + step * last
        # the root of b + 2 c s + 3 d s^2 where the cubic is convex
        under = c * c - 3 * d * b
        below = c + jnp.sqrt(jnp.maximum(under, 0))
        s = jnp.clip(-b / jnp.where(below > 0, below, jnp.inf), 0, 1)
        dip = jnp.where(under > 0, a + s * (b + s * (c + s * d)), end)
        return jnp.minimum(least, jnp.minimum(dip, end)).astype(least.dtype), q

    def finish(self, carried: Any) -> Numbers:
        return carried[0]


# samples within a step: two more than the order, and no fewer than these
FEWEST = 6


class _Carried(NamedTuple):
    """Of one array of a quantity: its value at the end of the last step where steps are sampled, and what is kept."""

    last: Any
    kept: Any


def leaf_by_leaf(function: Callable, carried: Pytree) -> Pytree:
    """A function of what a record carries, over the arrays of its quantity."""
    return jax.tree.map(
        lambda c: function(c.kept), carried, is_leaf=lambda x: isinstance(x, _Carried)
    )


class Recorded(Wrapped):
    """A solver that carries records beside its own state; a rejected step leaves them untouched.

    `carried`: by the same records, until the run starts; `None` where they start with it.
    """

    records: dict[str, Record]
    carried: Any = None

    def init(self, terms, t0, t1, y0, args):
        if self.carried is not None:
            return self.solver.init(terms, t0, t1, y0, args), self.carried
        count = self._count(terms)
        carried = {}
        for name, record in self.records.items():
            q = record.value(jnp.asarray(t0), y0, args)
            carried[name] = jax.tree.map(
                lambda q, record=record: _Carried(
                    q if record.sampled else None, record.start(t0, q, count)
                ),
                q,
            )
        return self.solver.init(terms, t0, t1, y0, args), carried

    def step(self, terms, t0, t1, y0, args, solver_state, made_jump):
        own, carried = solver_state
        y1, error, dense, own, result = self.solver.step(terms, t0, t1, y0, args, own, made_jump)
        sampled = {name: record for name, record in self.records.items() if record.sampled}
        found = {
            name: record.value(t1, y1, args)
            for name, record in self.records.items()
            if not record.sampled
        }
        # behind a jump in time, or a heat bath, a step starts with another value than the one before has ended with
        first = 0 if args.breaks or baths(args) else 1
        if sampled:
            lattice = isolated(inside(args, t0, t1) if args.breaks else args)
            path = self._path(terms, t0, t1, y0, y1, dense, lattice)
            times = jnp.minimum(
                t0 + (lobatto(self._count(terms)).x[first:] + 1) / 2 * (t1 - t0), t1
            )

            def values(t):
                return {
                    name: record.value(t, path.evaluate(t), lattice)
                    for name, record in sampled.items()
                }

            # a loop, because XLA would fuse the dense output's coefficients into each of their many readers
            found |= jax.lax.map(values, times)

        def follow(record, q, old):
            if not record.sampled:
                return _Carried(None, record.follow(old.kept, t0, t1 - t0, q))
            whole = jnp.concatenate([old.last[None], q]) if first else q
            return _Carried(q[-1], record.follow(old.kept, t0, t1 - t0, whole))

        carried = {
            name: jax.tree.map(
                lambda q, old, record=record: follow(record, q, old), found[name], carried[name]
            )
            for name, record in self.records.items()
        }
        return y1, error, dense, (own, carried), result

    def _count(self, terms):
        return max(FEWEST, self.solver.order(terms) + 2)

    def _path(self, terms, t0, t1, y0, y1, dense, lattice):
        """A dense output as good as the solver: its own, or one from its ends and forces within the step."""
        own = self.solver.interpolation_cls(t0=t0, t1=t1, **dense)
        # the ends of a stiff step say little of what lies between
        solver = self.solver.solver if isinstance(self.solver, OneSided) else self.solver
        if isinstance(own, Bootstrapped) or isinstance(solver, diffrax.AbstractImplicitSolver):
            return own

        def acceleration(t, y):
            return terms.vf(t, y, lattice)[1]

        if isinstance(own, QuinticHermite):
            y0, y1, a0, a1 = own.y0, own.y1, own.a0, own.a1
        else:
            a0, a1 = acceleration(t0, y0), acceleration(t1, y1)
        return bootstrapped(
            t0, t1, y0, y1, a0, a1, acceleration, max(0, (self.solver.order(terms) - 4) // 2)
        )
