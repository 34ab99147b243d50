"""Records: quantities reduced along a run, also between steps, without storing a trajectory."""

import abc
import inspect
from collections.abc import Callable
from functools import partial, reduce
from typing import Any, ClassVar, NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..base.checks import refuse
from ..base.printing import told
from ..base.types import AnyArray, Count, Number, Numbers, Parameter, Pytree, Scalar, StateLike
from ..lattice import Lattice
from ..solvers.interpolation import Bootstrapped, QuinticHermite, bootstrapped
from ..solvers.wrapped import Wrapped
from .bath import baths, isolated
from .control import OneSided, inside, just_inside
from .within import (
    crossing,
    guesses,
    higher,
    lobatto,
    mean,
    places,
    series,
    span,
    top_place,
    tops,
    value,
)

# The internal record that says whether a contact opened.
CLOSEST = "closest overlap"
# The internal record of all compressions, which gives the largest stiffness of the lattice.
EXTREMES = "extreme compressions"
# One top is sought within a step per this number of samples.
SAMPLES_PER_TOP = 8
# A top may exceed the highest sample by this part of the span of the samples.
HIDDEN = 0.25
FORMS = "a function (t, y, lattice) or a measure (lattice, y, t)"


class Record(eqx.Module):
    """A quantity followed along a run: `start` begins what is carried, `follow` updates it.

    The quantity is a function `(t, y, lattice)`, or a measure as in `gx.measures`: a function whose
    first argument is called `lattice`. A measure is called with `(lattice, y)`, and with `t` if it
    has an argument of that name. It returns a floating array, or a tree of them (a dict of fields),
    each followed on its own. Keep one function for many runs, as each new one compiles anew.

    A `sampled` record gets the quantity at several places within each step, as many as the order of
    the solver needs, along the first axis. Other records get its value at the end.

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
        """Return what is carried at first, from the quantity and the number of samples per step."""

    @abc.abstractmethod
    def follow(self, carried: Any, t0: Scalar, step: Scalar, q: Any) -> Any:
        """Return what is carried after the step from t0 to t0 + step.

        `q`: samples (count, ...), or the value at the end of the step.
        """

    def finish(self, carried: Any) -> Numbers:
        """Return the result."""
        return carried

    def short(self, carried: Any) -> Numbers:
        """Return by how much the quantity stayed below its threshold; infinite without one."""
        return jnp.asarray(jnp.inf)

    def value(self, t: Number, y: StateLike, lattice: Lattice) -> Pytree:
        """Return the quantity, a floating array or a tree of them."""
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
    try:
        signature = inspect.signature(quantity)
        own = inspect.signature(quantity, follow_wrapped=False)
    except (TypeError, ValueError):  # The function does not tell its arguments.
        return quantity(t, y, lattice)
    names = [p.name for p in signature.parameters.values() if p.kind is p.POSITIONAL_OR_KEYWORD]
    given = (t, y, lattice)
    more = {}
    if names[:1] == ["lattice"]:
        given = (lattice, y)
        more = {"t": t} if "t" in signature.parameters else {}
    try:
        own.bind(*given, **more)
        turned = "t" in names[1:3] and not more
    except TypeError:
        turned = True
    if turned:
        remedy = "The first argument of a measure is called lattice."
        refuse("record", FORMS, f"a function ({', '.join(names)})", remedy)
    return quantity(*given, **more)


class Peak(Record):
    """The largest value of a quantity over the run, elementwise, also between steps.

    It is the maximum of the polynomial through the samples of each step, by Newton's method.

    **Arguments:** `quantity`: `(t, y, lattice)` or a measure, e.g. `gx.measures.contact_force`; see
    `Record`. **Result:** an array of the quantity's shape.

    **Example:**

    >>> chain = gx.scenes.monomer(20)
    >>> force = gx.measures.contact_force
    >>> record = {"peak": gx.Peak(force), "arrival": gx.Arrival(force, threshold=0.1)}
    >>> run = gx.simulate(chain, gx.states.impact(chain), 5.0, step=0.05, record=record)
    >>> run.recorded["peak"][1:4].round(4)
    Array([0.7584, 0.6916, 0.6655], dtype=float64)
    """

    quantity: Callable = eqx.field(static=True)

    def start(self, t, q, count):
        return q

    def follow(self, carried, t0, step, q):
        best = jnp.maximum(carried, q[1:].max(0))
        near = guesses(q, _most(q))

        def refined():
            return reduce(jnp.maximum, (top.height for top in tops(q, near)), best)

        return jax.lax.cond(jnp.any(higher(q, near, best)), refined, lambda: best)


class Lowest(Peak):
    """The smallest value of a quantity over the run, elementwise; see `Peak`."""

    def start(self, t, q, count):
        return super().start(t, -q, count)

    def follow(self, carried, t0, step, q):
        return super().follow(carried, t0, step, -q)

    def finish(self, carried):
        return -carried


class _Top(NamedTuple):
    # The height of the highest top so far and its place, and the step in which it is: its start,
    # its length and the samples.
    height: Numbers
    place: Numbers
    t0: Numbers
    step: Numbers
    q: Numbers


class PeakTime(Peak):
    """The first time at which a quantity is largest, elementwise; see `Peak`.

    Tops equal within the run's error are not told apart, which `run.error` leaves out.
    Its derivative is that of a smooth top, zero at kinks and at ends of the run.
    """

    def start(self, t, q, count):
        zero = jnp.zeros_like(q)
        none = jnp.zeros((count, *q.shape), q.dtype)
        return _Top(jax.lax.stop_gradient(q), zero - 1, zero + jnp.asarray(t, q.dtype), zero, none)

    def follow(self, carried, t0, step, q):
        still = jax.lax.stop_gradient(q)
        x = places(q).reshape(-1)
        c = series(still)
        near = guesses(q, _most(q))
        highest = still.max(0)
        for top in tops(still, near):
            # Where the top is not resolved as higher than the samples, the highest sample gives the
            # place.
            place = jnp.where(value(c, top.place) >= highest, top.place, x[jnp.argmax(still, 0)])
            new = _Top(jnp.maximum(top.height, highest), place, t0, step, q)
            above = new.height > carried.height
            carried = jax.tree.map(
                lambda a, b, above=above: jnp.where(above, a, b).astype(b.dtype), new, carried
            )
        return carried

    def finish(self, carried):
        x = top_place(carried.q, carried.place)
        return carried.t0 + (x + 1) / 2 * carried.step


class Arrival(Record):
    """The first time at which a quantity rises to a threshold, elementwise; NaN if it never does.

    It is found between steps, by the top if the quantity rises and falls within one step. Where the
    quantity is at or above the threshold at the start, it is the start time.

    **Arguments:** `quantity`: as in `Peak`; `threshold`: a number or an array that broadcasts;
    another value compiles nothing anew.

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

    def start(self, t, q, count):
        shape = np.shape(self.threshold)
        fits = (own in (1, n) for own, n in zip(shape[::-1], q.shape[::-1]))
        if len(shape) > q.ndim or not all(fits):
            wanted = f"a number, or an array that broadcasts to the quantity's shape {q.shape}"
            refuse("threshold", wanted, f"shape {shape}")
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

    def follow(self, carried, t0, step, q):
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
        # Two places within a step between which the threshold is first passed, or 0 and infinity;
        # and the height of the top.
        x = places(q)
        threshold = jax.lax.stop_gradient(self._threshold(q))
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

    def finish(self, carried):
        found, _, t0, step, low, high, q = carried
        within = found & (step > 0)
        x = crossing(series(q), self._threshold(q), low, high, within)
        return jnp.where(found, t0 + jnp.where(within, (x + 1) / 2 * step, 0), jnp.nan)

    def short(self, carried):
        return jax.lax.stop_gradient(self._threshold(carried[1]) - carried[1])


class Integral(Record):
    """The integral of a quantity over time, elementwise, by Gauss-Lobatto quadrature in each step.

    **Arguments:** `quantity`: as in `Peak`, e.g. a power or a momentum flux.

    **Example:**

    >>> chain = gx.scenes.monomer(20)
    >>> record = {"impulse": gx.Integral(gx.measures.contact_force), "lowest": gx.Lowest(gx.measures.strain)}
    >>> run = gx.simulate(chain, gx.states.impact(chain), 5.0, step=0.05, record=record)
    >>> round(float(run.recorded["impulse"][1]), 4), round(1 - float(run.final.v[0]), 4)
    (1.0711, 1.0711)
    """

    quantity: Callable = eqx.field(static=True)

    def start(self, t, q, count):
        return jnp.zeros_like(q)

    def follow(self, carried, t0, step, q):
        return carried + (step * mean(q)).astype(carried.dtype)


class AtEnds(Record):
    """The smallest value of a quantity at the ends of steps, elementwise: cheap, but not refined.

    **Arguments:** `quantity`: as in `Peak`.
    """

    sampled: ClassVar[bool] = False
    quantity: Callable = eqx.field(static=True)

    def start(self, t, q, count):
        return q

    def follow(self, carried, t0, step, q):
        return jnp.minimum(carried, q)


def _most(q):
    return -(-len(q) // SAMPLES_PER_TOP)


# Samples per step: two more than the order of the solver, but at least this many.
FEWEST = 6


class _Carried(NamedTuple):
    """For one array of a quantity: its last value, if steps are sampled, and what is carried."""

    last: Any
    kept: Any


def leaf_by_leaf(function: Callable, carried: Pytree) -> Pytree:
    """Apply a function to what a record carries for each array of its quantity."""
    return jax.tree.map(
        lambda c: function(c.kept), carried, is_leaf=lambda x: isinstance(x, _Carried)
    )


class Recorded(Wrapped):
    """A solver that carries records beside its own state; a rejected step leaves them unchanged.

    `carried`: what the records carry at the start; `None` where they begin there.
    """

    records: dict[str, Record]
    carried: Any = None

    def init(self, terms, t0, t1, y0, args):
        if self.carried is not None:
            return self.solver.init(terms, t0, t1, y0, args), self.carried
        count = self._count(terms)

        def begun(record):
            carry = lambda q: _Carried(q if record.sampled else None, record.start(t0, q, count))
            return jax.tree.map(carry, record.value(jnp.asarray(t0), y0, args))

        carried = {name: begun(record) for name, record in self.records.items()}
        return self.solver.init(terms, t0, t1, y0, args), carried

    # Loops of diffrax ask for the step three times; it is traced once.
    @partial(eqx.filter_jit, inline=True)
    def step(self, terms, t0, t1, y0, args, solver_state, made_jump):
        own, carried = solver_state
        y1, error, dense, own, result = self.solver.step(terms, t0, t1, y0, args, own, made_jump)

        def values(sampled, t, y, lattice):
            own = {name: x for name, x in self.records.items() if x.sampled == sampled}
            return {name: record.value(t, y, lattice) for name, record in own.items()}

        found = values(False, t1, y1, args)
        # After a jump in time, or a heat bath, a step starts with another value than the previous
        # one ended with.
        first = 0 if args.breaks or baths(args) else 1
        if len(found) < len(self.records):
            lattice = isolated(inside(args, t0, t1) if args.breaks else args)
            path = self._path(terms, t0, t1, y0, y1, dense, lattice)
            times = jnp.minimum(
                t0 + (lobatto(self._count(terms)).x[first:] + 1) / 2 * (t1 - t0), t1
            )

            def sampled(t):
                # A quantity may itself be a function of time that jumps.
                seen = jnp.clip(t, *just_inside(t0, t1)) if args.breaks else t
                return values(True, seen, path.evaluate(t), lattice)

            # A loop, because XLA would fuse the coefficients of the dense output into each of their
            # many readers.
            found |= jax.lax.map(sampled, times)

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
        # Dense output as accurate as the solver: its own, or built from the ends and forces in the
        # step.
        own = self.solver.interpolation_cls(t0=t0, t1=t1, **dense)
        # The ends of a stiff step say little about the times between them.
        solver = self.solver.solver if isinstance(self.solver, OneSided) else self.solver
        if isinstance(own, Bootstrapped) or isinstance(solver, diffrax.AbstractImplicitSolver):
            return own

        def acceleration(t, y):
            return terms.vf(t, y, lattice)[1]

        if not isinstance(own, QuinticHermite):
            own = QuinticHermite(t0, t1, y0, y1, acceleration(t0, y0), acceleration(t1, y1))
        return bootstrapped(own, acceleration, (self.solver.order(terms) - 4) // 2)
