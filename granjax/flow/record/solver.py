"""The solver that carries records beside its own state."""

from collections.abc import Callable
from typing import Any, NamedTuple

import diffrax
import jax
import jax.numpy as jnp

from ...solvers.interpolation import Bootstrapped, QuinticHermite, bootstrapped
from ...solvers.wrapped import Wrapped
from ...types import Pytree
from ..breaks import OneSided, inside
from .kinds import Record
from .within import lobatto

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
        # behind a jump in time a step starts with another value than the one before has ended with
        first = 0 if args.breaks else 1
        if sampled:
            lattice = inside(args, t0, t1) if args.breaks else args
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
            a0, a1 = own.a0, own.a1
        else:
            a0, a1 = acceleration(t0, y0), acceleration(t1, y1)
        return bootstrapped(
            t0, t1, y0, y1, a0, a1, acceleration, max(0, (self.solver.order(terms) - 4) // 2)
        )
