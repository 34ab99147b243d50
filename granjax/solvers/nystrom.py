"""Runge-Kutta-Nystrom pairs as diffrax solvers: adaptive steps for u'' = a(t, u).

One step: u_i = u + c_i h v + h^2 sum_j A_ij k_j, k_i = a(t + c_i h, u_i), then
u + h v + h^2 sum b_i k_i and v + h sum bp_i k_i, with error estimates h^2 sum be_i k_i and
h sum bpe_i k_i. The last force of a step is the first of the next. Forces that read the velocity
are refused, by the vector field's own `refuse_velocity(args)` where it has one.
"""

from functools import cache, partial
from typing import ClassVar, NamedTuple

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
from jax.interpreters.partial_eval import dce_jaxpr

from ..base.checks import refuse
from . import tables
from .inner import weights
from .interpolation import Bootstrapped, correction, quintic
from .split_system import pair
from .splitting import Tabulated, offered, unwrap


class AbstractNystrom(Tabulated, diffrax.AbstractAdaptiveSolver):
    """A Nystrom pair; a subclass adds a name, a table and the degree of dense output.

    Dense output needs `inside` more forces per step. A solve that saves nothing inside its steps
    skips them.
    """

    interpolation_cls: ClassVar = Bootstrapped
    inside: ClassVar[int]

    @classmethod
    def table(cls) -> tables.Nystrom:
        """The method's coefficients, `granjax.solvers.tables.Nystrom`."""
        return tables.nystrom(cls.__name__)

    @classmethod
    def evaluations(cls) -> float:
        """Force evaluations per step; the last one is reused by the next step."""
        return len(_stages(cls).c) - 1

    def error_order(self, terms):
        # the estimate is the local error of the embedded method, one order above its global error
        return self.table().embedded_order + 1

    def init(self, terms, t0, t1, y0, args):
        system, direction = offered(terms, args)
        _refuse_velocity(unwrap(terms)[0], t0 * direction, y0, args)
        return system.start(t0 * direction, y0)

    def step(self, terms, t0, t1, y0, args, solver_state, made_jump):
        system, direction = offered(terms, args)
        stages = _stages(type(self))
        kept = solver_state
        if made_jump is not False:
            kept = jax.lax.cond(
                made_jump, lambda: system.start(t0 * direction, y0), lambda: solver_state
            )
        step = _Step(system, t0, t1, direction, y0)
        k, y1, kept = _march(stages, step, kept)
        error = pair(y0, _sum(stages.be, k, step.h, 2), _sum(stages.bpe, k, step.h, 1))
        return y1, error, _dense(type(self), step, k, kept), kept, diffrax.RESULTS.successful


class RKN86(AbstractNystrom):
    """Dormand, El-Mikkawy and Prince's RKN 8(6), the default of `simulate` with a tolerance.

    Eight forces per step; dense output of degree 8 from three more. For
    contacts that open and errors below 1e-5. Source: IMA J. Numer. Anal. 7, 423 (1987).

    **Example:**

    >>> chain = gx.Lattice(1.0, gx.Bond(gx.Shift(1, "fixed"), gx.Linear()), sites=20)
    >>> run = gx.simulate(chain, gx.states.impact(chain), 5.0, tolerance=1e-9)
    >>> run.solver, bool(run.energy_error < 1e-8)
    ('RKN86', True)
    """

    inside: ClassVar[int] = 3


class RKN1210(AbstractNystrom):
    """Dormand, El-Mikkawy and Prince's RKN 12(10), for smooth scenes and errors below 1e-8.

    17 forces per step; dense output of degree 12 from seven more. Source: IMA J. Numer. Anal. 7,
    423 (1987).
    """

    inside: ClassVar[int] = 7


# a field with `refuse_velocity` refuses in its own words
def _refuse_velocity(field, t, y, args):
    if hasattr(field, "refuse_velocity"):
        field.refuse_velocity(args)
        return
    u, v = y
    traced = jax.make_jaxpr(lambda v: field(t, pair(y, u, v), args)[1])(v).jaxpr
    _, read = dce_jaxpr(traced, [True] * len(traced.outvars))
    if any(read):
        refuse(
            "solver",
            "an acceleration that depends on positions and time alone",
            "a vector field whose acceleration reads the velocity",
            "Use solver=diffrax.Dopri8() with tolerance=....",
        )


# one step from t0 to t1 in diffrax's time, which always increases
class _Step(NamedTuple):
    system: object
    t0: object
    t1: object
    direction: object
    y0: object

    @property
    def h(self):
        return (self.t1 - self.t0) * self.direction

    # never beyond t1, where a jump may lie
    def times(self, c):
        return jnp.minimum(self.t0 + c * (self.t1 - self.t0), self.t1) * self.direction

    def force(self, kept, t, u):
        at = pair(self.y0, u, self.y0[1])
        _, kept = self.system.leave(self.system.refresh(self.system.enter(at, kept), t), at)
        return kept, self.system.acceleration(at, kept)

    # The function (i, k) -> u0 + c_i h v0 + h^2 sum_j weights_ij k_j.
    # One branch per row: the code after it is traced once, and each sum has only the weights of its
    # own row, as constants.
    def places(self, c, weights):
        return lambda i, k: jax.lax.switch(
            i, [partial(self._place, *row) for row in zip(c, weights)], k
        )

    def _place(self, c, weights, k):
        moved = jax.tree.map(lambda u, v: u + self.h.astype(u.dtype) * float(c) * v, *self.y0)
        return jax.tree.map(jnp.add, moved, _sum(weights, k, self.h, 2))


# the table with u1 as last stage, whose force is the first of the next step
@cache
def _stages(cls):
    table = cls.table()
    if np.abs(table.A[-1] - table.b).max() < 1e-14:
        return table
    A = np.pad(np.vstack([table.A, table.b]), ((0, 0), (0, 1)))
    longer = {name: np.append(getattr(table, name), 0.0) for name in ("b", "bp", "be", "bpe")}
    return table._replace(A=A, c=np.append(table.c, 1.0), **longer)


def _march(stages, step, kept):
    u0, v0 = step.y0
    count = len(stages.c)
    k = jax.tree.map(lambda u: jnp.zeros((count,) + u.shape, u.dtype), u0)
    k = _write(k, step.system.acceleration(step.y0, kept), 0)
    place = step.places(stages.c[1:], stages.A[1:])

    def stage(w, x):
        k, _, kept = w
        i, time = x
        u = place(i - 1, k)
        kept, a = step.force(kept, time, u)
        return (_write(k, a, i), u, kept), None

    (k, u1, kept), _ = jax.lax.scan(
        stage, (k, u0, kept), (np.arange(1, count), step.times(stages.c)[1:])
    )
    return k, pair(step.y0, u1, jax.tree.map(jnp.add, v0, _sum(stages.bp, k, step.h, 1))), kept


def _write(k, a, i):
    return jax.tree.map(
        lambda k, a: jax.lax.dynamic_update_index_in_dim(k, a.astype(k.dtype), i, 0), k, a
    )


def _sum(weights, k, h, power):
    return jax.tree.map(lambda k: _weighted(weights, k, h, power), k)


# a sum over a sequence of arrays; zero weights are left out of the program
def _weighted(weights, k, h, power):
    used = np.flatnonzero(weights)
    return h.astype(k[0].dtype) ** power * sum(float(weights[j]) * k[j] for j in used)


def _dense(cls, step, k, kept):
    fit = correction(cls.inside)
    place = step.places(fit.nodes, inner_weights(cls))

    def inner_force(kept, x):
        i, time = x
        return step.force(kept, time, place(i, k))

    _, inner = jax.lax.scan(inner_force, kept, (np.arange(cls.inside), step.times(fit.nodes)))
    coefficients = tuple(
        jax.tree.map(lambda k, a: _weighted(row, [*k, *a.astype(k.dtype)], step.h, 2), k, inner)
        for row in _polynomial(cls)
    )
    direction = jnp.asarray(step.direction, step.h.dtype)
    return dict(y0=step.y0, quintic=coefficients[:4], inside=coefficients[4:], direction=direction)


# weights over the forces of a step, one row per coefficient of `Bootstrapped`
@cache
def _polynomial(cls):
    stages = _stages(cls)
    fit = correction(cls.inside)
    ends = np.eye(len(stages.c))[[0, -1]]
    low = np.stack(quintic(stages.b, stages.bp, *ends))
    return np.block([[low, np.zeros((4, cls.inside))], [-fit.less @ low, fit.take]])


@cache
def inner_weights(cls) -> np.ndarray:
    """Return the weights over the stages of each position where dense output needs a force."""
    stages = _stages(cls)
    return weights(stages.A, stages.c, correction(cls.inside).nodes)
