"""Runge-Kutta-Nystrom pairs as diffrax solvers: adaptive steps for u'' = a(t, u).

One step: u_i = u + c_i h v + h^2 sum_j A_ij k_j, k_i = a(t + c_i h, u_i), then u + h v + h^2 sum b_i k_i and
v + h sum bp_i k_i, with error estimates h^2 sum be_i k_i and h sum bpe_i k_i. The force that ends a step opens the
next. Only the acceleration is asked for: from the vector field's own `acceleration_only(args)`, which refuses forces
that read the velocity, or from any f(t, (u, v), args) = (v, a(t, u)).
"""

from functools import cache
from typing import ClassVar, NamedTuple

import diffrax
import jax
import jax.numpy as jnp
import numpy as np

from . import tables
from .interpolation import Bootstrapped, correction, quintic
from .splitting import _pair, unwrap


class AbstractNystrom(diffrax.AbstractAdaptiveSolver):
    """A Nystrom pair; a subclass is a name, a table, the number of forces inside a step for dense output, and prose."""

    term_structure: ClassVar = diffrax.AbstractTerm
    interpolation_cls: ClassVar = Bootstrapped
    inside: ClassVar[int]

    @classmethod
    def table(cls):
        """The method's coefficients, `granjax.solvers.tables.Nystrom`."""
        return tables.nystrom(cls.__name__)

    @classmethod
    def evaluations(cls):
        """Force evaluations per step, with the last one kept for the next step's first."""
        return len(_stages(cls).c) - 1

    def order(self, terms):
        return self.table().order

    def error_order(self, terms):
        # the estimate is the local error of the embedded method
        return self.table().embedded_order + 1

    def init(self, terms, t0, t1, y0, args):
        acceleration, direction = _acceleration(terms, args, y0)
        return acceleration(t0 * direction, y0[0])

    def step(self, terms, t0, t1, y0, args, solver_state, made_jump):
        acceleration, direction = _acceleration(terms, args, y0)
        stages = _stages(type(self))
        u0, v0 = y0
        h = (t1 - t0) * direction
        # never past t1, where a jump may lie
        times = jnp.minimum(t0 + stages.c * (t1 - t0), t1) * direction
        first = solver_state
        if made_jump is not False:
            first = jax.lax.cond(made_jump, lambda: acceleration(times[0], u0), lambda: solver_state)
        k = jax.tree.map(lambda a: jnp.zeros((len(stages.c),) + a.shape, a.dtype).at[0].set(a), first)

        def place(k, c, weights):
            """u0 + c h v0 + h^2 sum weights_j k_j."""
            def leaf(u, v, k):
                s = h.astype(u.dtype)
                return u + s * (c.astype(u.dtype) * v + s * _combine(weights, k))

            return jax.tree.map(leaf, u0, v0, k)

        def stage(w, x):
            k, u = w
            i, time, c, weights = x
            a = acceleration(time, u)
            k = jax.tree.map(lambda k, a: jax.lax.dynamic_update_index_in_dim(k, a.astype(k.dtype), i, 0), k, a)
            return (k, place(k, c, weights)), None

        last = len(stages.c) - 1
        u1 = place(k, stages.c[1], stages.A[1])
        following = (np.arange(1, last), times[1:last], stages.c[2:], stages.A[2:])
        (k, u1), _ = jax.lax.scan(stage, (k, u1), following)
        a1 = acceleration(times[last], u1)
        return self._finish(y0, h, k, u1, a1)


@cache
def _nothing():
    return None
