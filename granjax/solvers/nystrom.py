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
from .seeds import weights
from .splitting import _pair, unwrap


class AbstractNystrom(diffrax.AbstractAdaptiveSolver):
    """A Nystrom pair; a subclass is a name, a table, a degree of dense output and prose.

    Dense output asks for `inside` more forces a step. A solve that saves nothing between its steps does not pay them:
    what nobody reads is not compiled.
    """

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
        h = (t1 - t0) * direction
        # never past t1, where a jump may lie
        times = jnp.minimum(t0 + stages.c * (t1 - t0), t1) * direction
        first = solver_state
        if made_jump is not False:
            first = jax.lax.cond(made_jump, lambda: acceleration(times[0], y0[0]), lambda: solver_state)
        k, y1, a1 = _march(stages, acceleration, times, h, y0, first)
        error = _pair(y0, _sum(stages.be, k, h, 2), _sum(stages.bpe, k, h, 1))
        dense = _dense(type(self), acceleration, t0, t1, direction, y0, k)
        return y1, error, dense, a1, diffrax.RESULTS.successful

    def func(self, terms, t0, y0, args):
        return terms.vf(t0, y0, args)


class RKN86(AbstractNystrom):
    """Dormand, El-Mikkawy and Prince's RKN 8(6), eight forces a step: the default of `simulate` for a tolerance.

    Dense output of degree 8 from three more forces. Contact loss below 1e-5; source: IMA J. Numer. Anal. 7, 423 (1987).
    """

    inside: ClassVar[int] = 3


class RKN1210(AbstractNystrom):
    """Dormand, El-Mikkawy and Prince's RKN 12(10), 17 forces a step, for smooth scenes below 1e-8.

    Dense output of degree 12 from seven more forces. Source: IMA J. Numer. Anal. 7, 423 (1987).
    """

    inside: ClassVar[int] = 7


def _acceleration(terms, args, y):
    """The function a(t, u), in the types of the state, and the direction of time."""
    field, direction = unwrap(terms)
    offer = getattr(field, "acceleration_only", None)

    def plain(t, u):
        return field(t, _pair(y, u, jax.tree.map(jnp.zeros_like, y[1])), args)[1]

    a = plain if offer is None else offer(args)
    return lambda t, u: jax.tree.map(lambda a, u: jnp.asarray(a, u.dtype), a(t, u), u), direction


class _Stages(NamedTuple):
    """The table with u1 as its last stage, whose force opens the next step."""

    A: np.ndarray
    c: np.ndarray
    b: np.ndarray
    bp: np.ndarray
    be: np.ndarray
    bpe: np.ndarray


@cache
def _stages(cls):
    table = cls.table()
    if np.abs(table.A[-1] - table.b).max() < 1e-14:
        return _Stages(table.A, table.c, table.b, table.bp, table.be, table.bpe)
    A = np.pad(np.vstack([table.A, table.b]), ((0, 0), (0, 1)))
    return _Stages(A, np.append(table.c, 1.0), *(np.append(w, 0.0) for w in (table.b, table.bp, table.be, table.bpe)))


def _march(stages, acceleration, times, h, y0, first):
    """All accelerations k, the new state, and the acceleration there."""
    u0, v0 = y0
    last = len(stages.c) - 1
    k = jax.tree.map(lambda a: jnp.zeros((last + 1,) + a.shape, a.dtype).at[0].set(a), first)

    def stage(w, x):
        k, u = w
        i, time, c, weights = x
        k = _write(k, acceleration(time, u), i)
        return (k, _place(u0, v0, k, h, c, weights)), None

    # positions are carried, or XLA would work the sum over stages out again for every reader
    u = _place(u0, v0, k, h, jnp.asarray(stages.c[1]), jnp.asarray(stages.A[1]))
    following = (np.arange(1, last), times[1:last], stages.c[2:], stages.A[2:])
    (k, u1), _ = jax.lax.scan(stage, (k, u), following)
    a1 = acceleration(times[last], u1)
    k = _write(k, a1, last)
    v1 = jax.tree.map(jnp.add, v0, _sum(stages.bp, k, h, 1))
    return k, _pair(y0, u1, v1), a1


def _write(k, a, i):
    return jax.tree.map(lambda k, a: jax.lax.dynamic_update_index_in_dim(k, a, i, 0), k, a)


def _place(u0, v0, k, h, c, weights):
    """u0 + c h v0 + h^2 sum weights_j k_j."""

    def leaf(u, v, k):
        s, w = h.astype(u.dtype), weights.astype(u.dtype)
        return u + s * (c.astype(u.dtype) * v + s * sum(w[j] * k[j] for j in range(k.shape[0])))

    return jax.tree.map(leaf, u0, v0, k)


def _sum(weights, k, h, power):
    """h^power sum weights_j k_j, of those weights that are not zero."""
    used = np.flatnonzero(weights)
    return jax.tree.map(lambda k: h.astype(k.dtype) ** power * sum(float(weights[j]) * k[j] for j in used), k)


def _dense(cls, acceleration, t0, t1, direction, y0, k):
    """What `Bootstrapped` is made from: the quintic of the ends and the accelerations inside, from seeds."""
    stages, fit = _stages(cls), correction(cls.inside)
    h = (t1 - t0) * direction
    u0, v0 = y0

    def force(_, x):
        time, c, w = x
        return None, acceleration(time, _place(u0, v0, k, h, c, w))

    times = jnp.minimum(t0 + fit.nodes * (t1 - t0), t1) * direction
    _, inner = jax.lax.scan(force, None, (times, fit.nodes, seeds(cls)))

    def leaf(k, inner):
        s = h.astype(k.dtype) ** 2
        rise = s * sum(float(w) * x for w, x in zip(stages.b, k) if w)
        gain = s * sum(float(w) * x for w, x in zip(stages.bp, k) if w)
        low = quintic(rise, gain, s * k[0], s * k[-1])
        high = tuple(
            sum(float(w) * s * a for w, a in zip(take, inner)) - sum(float(w) * c for w, c in zip(less, low))
            for take, less in zip(fit.take, fit.less)
        )
        return low + high

    structure = jax.tree.structure(u0)
    leaves = [leaf(*x) for x in zip(jax.tree.leaves(k), jax.tree.leaves(inner))]
    coefficients = tuple(structure.unflatten(list(x)) for x in zip(*leaves))
    return dict(y0=y0, quintic=coefficients[:4], inside=coefficients[4:], direction=jnp.asarray(direction))


@cache
def seeds(cls):
    """Weights over the stages of the positions where dense output asks for forces, one row per node."""
    stages = _stages(cls)
    return weights(stages.A, stages.c, correction(cls.inside).nodes)[0]
