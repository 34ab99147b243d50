"""`Reversible`: reverse-mode derivatives by integrating backwards, which stores nothing."""

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp

from ..base.arrays import most
from ..base.checks import positive, refuse
from ..base.printing import told
from ..base.programs import compiled
from ..base.types import Count, Counts, Number, Scalar, StateLike
from ..lattice import Lattice, State, split_system, vector_field
from ..solvers import AbstractSplitting
from ..solvers.split_system import by_stages
from .integrate import Plan, integrate
from .run import Found
from .stepping import Flow, check_moved, check_steps


class Reversible(eqx.Module):
    r"""Reverse mode with constant memory: `simulate(..., adjoint=gx.Reversible())`.

    A splitting method consists of kicks v += b h a(u) and drifts u += a h v, and each can be
    undone. The derivative goes back from the end, undoes them one by one and pulls its cotangent
    through, so that nothing is stored. It is the exact derivative of the discrete run if the way
    back retraces the run. With closed contacts it does, to 1e-12 after 1e5 steps. A chaotic motion
    (a sonic vacuum: contacts that open and close) does not return in floating point, and damping
    amplifies rounding by exp(gamma t) on the way back. Where the start that is reached differs from
    the true one by more than `tolerance`, the derivative is NaN; use
    `diffrax.RecursiveCheckpointAdjoint()` there.

    **Arguments:** `tolerance`: of the return error max |y - y0|, relative to the largest entry at
    both ends, separately for displacements and velocities; from 1 on it accepts any way back.
    `return_error`: leave it at zero. The derivative with respect to it *is* the return error:
    `jax.grad(f, (0, 1))(x, gx.Reversible())[1].return_error`.

    It needs a splitting solver at a fixed step, and supports neither records nor forward mode. It
    differentiates saved states and the end (`energy_error` gives NaN) with respect to lattice and
    state, not to times. It takes 3 to 6 times as long.

    **Raises** ValueError for a tolerance that is not above zero.

    **Example:**

    >>> chain = gx.Lattice(1.0, gx.Bond(gx.Shift(1, "fixed"), gx.Linear()), sites=2)
    >>> def end(u):
    ...     return gx.simulate(chain, (u, 0 * u), 2.0, step=0.05, adjoint=gx.Reversible()).final.u.sum()
    >>> jax.grad(end)(jnp.ones(2)).round(4), round(float(np.cos(2.0)), 4)
    (Array([-0.4161, -0.4161], dtype=float64), -0.4161)
    """

    return_error: jax.Array
    tolerance: float = eqx.field(static=True)
    __repr__ = told

    def __init__(self, tolerance: Scalar = 1e-6):
        self.return_error = jnp.zeros(())
        self.tolerance = float(positive("tolerance", tolerance))


def checked_reversible(lattice: Lattice, plan: Plan) -> None:
    """Refuse a run that cannot be undone."""
    if lattice.breaks:
        refuse(
            "adjoint",
            "equal steps with Reversible",
            "a lattice with breaks, at which steps end",
            "Use diffrax.RecursiveCheckpointAdjoint().",
        )
    if not isinstance(plan.solver, AbstractSplitting):
        refuse(
            "adjoint",
            "a splitting solver at a fixed step, such as SRKN11b, with Reversible",
            type(plan.solver).__name__,
            "Use diffrax.RecursiveCheckpointAdjoint().",
        )
    if plan.records or plan.every:
        refuse(
            "adjoint",
            "no records and no save_at='steps' with Reversible",
            "record=" if plan.records else "'steps'",
            "Save frames and reduce them, or use diffrax.RecursiveCheckpointAdjoint().",
        )


def refuse_forward_mode(adjoint: eqx.Module, error: TypeError) -> None:
    """Replace JAX's error where an adjoint of reverse mode meets forward mode; pass others on.

    JAX raises its own error where the program is traced first and differentiated then:
    `jax.jacfwd(jax.jit(f))`.
    """
    if "forward-mode" not in str(error):
        raise error
    name = type(adjoint).__name__
    refuse(
        "adjoint",
        f"reverse mode with {name} (jax.grad, jax.vjp, jax.jacrev)",
        "forward mode (jax.jvp, jax.jacfwd)",
        "Leave adjoint= out, which serves both, or give diffrax.ForwardMode().",
    )


def return_error(
    lattice: Lattice,
    state: StateLike,
    t0: Scalar,
    t1: Scalar,
    steps: Count | Counts,
    solver: diffrax.AbstractSolver,
) -> Number:
    """Return max |y - y0| after integrating to t1 and back, relative to the largest entry.

    The largest entry is that at both ends; the result is the larger one of u and v.

    **Arguments:** `steps`: the number each way, a whole number or an array; `solver`: any with
    symmetric steps.
    """
    check_steps(steps)
    # As arrays, so that other values compile nothing.
    t0, t1 = (jnp.asarray(t, lattice.dtype) for t in (t0, t1))
    return _return_error(lattice, state, t0, t1, jnp.asarray(steps), solver)


@compiled
def _return_error(lattice, state, t0, t1, steps, solver):
    flow = Flow(steps, solver)
    check_moved("state", state, flow, lattice)
    end = flow(state, t0, t1, lattice)
    back = flow(end, t1, t0, lattice)
    return jnp.maximum(*(_missed(*x) for x in zip(back, state, end)))


class _Backwards(eqx.Module):
    """A split system that undoes kicks and drifts.

    Its working form is w = (that of the lattice, time, cotangent, gradient).
    """

    free: object
    fixed: object

    def _system(self, free):
        return split_system(eqx.combine(free, self.fixed))

    def refresh(self, w, t):
        return self._system(self.free).refresh(w[0], t), t, *w[2:]

    def kick(self, w, bh):
        own, t, *rest = w
        system = self._system(self.free)
        if hasattr(system, "spread"):
            own, (*pulled, idle), gradient = system.kick(own, bh), *rest
            move = lambda system, w: system.kick(w, -bh)
            zero = jnp.zeros_like(idle)
            own, t, pulled, gradient = self._pulled(move, own, t, (*pulled, zero), gradient)
            force = lambda free, e: self._system(free).law.force(e)
            _, pull = jax.vjp(force, self.free, system.compression(own))
            # The slot of the force holds a buffer, not a cotangent.
            change, pulled = system.spread(pulled, pull, idle)
            return own, t, pulled, jax.tree.map(jnp.add, gradient, change)
        move = lambda system, w: system.kick(system.refresh(w, t), -bh)
        return self._pulled(move, self._system(self.free).kick(own, bh), t, *rest)

    def drift(self, w, ah):
        own, *rest = w
        move = lambda system, w: system.drift(w, -ah)
        return self._pulled(move, self._system(self.free).drift(own, ah), *rest)

    def _pulled(self, move, own, t, cotangent, gradient):
        moved = lambda free, w: move(self._system(free), w)
        change, cotangent = jax.vjp(moved, self.free, own)[1](cotangent)
        return own, t, cotangent, jax.tree.map(jnp.add, gradient, change)


@eqx.filter_custom_vjp
def reversible(moved: tuple) -> Found:
    """Integrate as `integrate` does, with the derivative of `Reversible`.

    moved = (lattice, state, adjoint, (span, plan)).
    """
    lattice, state, _, (span, plan) = moved
    return integrate(lattice, state, *span, plan)


@reversible.def_fwd
def _(perturbed, moved):
    if any(jax.tree.leaves(perturbed[3])):
        refuse(
            "adjoint",
            "derivatives by the lattice and the state with Reversible",
            "one by times",
            "Leave adjoint= out.",
        )
    run = reversible(moved)
    return run, (run.final, run.stats["accepted"])


@reversible.def_bwd
def _(residuals, cotangents, perturbed, moved):
    final, count = residuals
    lattice, state, adjoint, (span, plan) = moved
    free, fixed = eqx.partition(lattice, perturbed[0])
    # Older versions of JAX give literals, which lack methods of arrays.
    solver = plan.solver
    save_ts = plan.save_ts
    h = jnp.asarray(plan.step)
    time = lambda k: span[0] + k * h

    def seen(free, y, k, t):
        # The state at t, within step k, which begins with y.
        args = diffrax.ODETerm(vector_field), time(k), time(k + 1), y, eqx.combine(free, fixed)
        _, _, dense, _, _ = solver.step(*args, solver.init(*args), False)
        return solver.interpolation_cls(t0=time(k), t1=time(k + 1), **dense).evaluate(t)

    def undone(i, carry):
        # The state before a step, its cotangent, and the gradient of the parameters.
        k, y, pulled, gradient = carry
        way = _Backwards(free, fixed)
        system = split_system(lattice)
        own = system.enter(y, system.start(time(k), y))
        _, pull = jax.vjp(lambda w: system.leave(w, y)[0], own)
        w = own, time(k), *pull(pulled), gradient
        w, _, pulled, gradient = by_stages(way, w, solver.table(), time(k), -h)
        y, _ = system.leave(w, y)
        _, pull = jax.vjp(lambda y: system.enter(y, w[2:] and w[2])[:2], y)
        return k - 1, y, *pull(pulled[:2]), gradient

    def to_step(k, carry):
        return jax.lax.fori_loop(0, carry[0] - k, undone, carry)

    zero = jax.tree.map(jnp.zeros_like, final)
    ends = _filled(cotangents.final, zero)
    if save_ts is None:  # The only saved frame is the end.
        frames = _filled(State(cotangents.us, cotangents.vs), jax.tree.map(lambda x: x[None], zero))
        ends = jax.tree.map(lambda x, frame: x + frame[0], ends, frames)
    carry = count, final, ends, jax.tree.map(jnp.zeros_like, free)
    if save_ts is not None and jax.tree.leaves((cotangents.us, cotangents.vs)):
        like = jax.tree.map(lambda x: jnp.zeros((len(save_ts), *x.shape), x.dtype), zero)
        frames = _filled(State(cotangents.us, cotangents.vs), like)
        places = jnp.clip(
            jnp.floor((save_ts - span[0]) / h).astype(int), 0, jnp.maximum(count - 1, 0)
        )

        def sample(i, carry):
            i = len(save_ts) - 1 - i
            k, y, pulled, gradient = to_step(places[i], carry)
            frame = jax.tree.map(lambda x: x[i], frames)
            change, more = jax.vjp(lambda *x: seen(*x, k, save_ts[i]), free, y)[1](frame)
            return k, y, *jax.tree.map(jnp.add, (pulled, gradient), (more, change))

        carry = jax.lax.fori_loop(0, len(save_ts), sample, carry)
    _, back, pulled, gradient = to_step(0, carry)
    error = jnp.maximum(*(_missed(*x) for x in zip(back, state, final)))
    good = error <= adjoint.tolerance
    if cotangents.energy_error is not None:
        good = good & jnp.all(cotangents.energy_error == 0)
    gradient, pulled = jax.tree.map(lambda x: jnp.where(good, x, jnp.nan), (gradient, pulled))
    adjoint = eqx.tree_at(lambda a: a.return_error, adjoint, error)
    return gradient, type(state)(*pulled), adjoint, eqx.filter(moved[3], False)


def _filled(cotangent, zero):
    # Zeros replace missing cotangents.
    return jax.tree.map(
        lambda z, c: z if c is None else c, zero, cotangent, is_leaf=lambda x: x is None
    )


def _missed(back, start, end):
    scale = most(jax.tree.map(jnp.abs, (start, end)))
    error = most(jax.tree.map(lambda x, y: jnp.abs(x - y), back, start))
    return jnp.where(jnp.isnan(error), jnp.inf, error / jnp.where(scale > 0, scale, 1))
