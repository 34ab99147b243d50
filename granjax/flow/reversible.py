"""`Reversible`: the derivative of a run in reverse mode by integrating backwards, which keeps nothing of the way."""

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..checks import positive, refuse
from ..lattice import Lattice, split_system, vector_field
from ..printing import told
from ..solvers import AbstractSplitting
from ..types import Count, Counts, Number, Scalar, StateLike
from .integrate import integrate
from .plan import Plan
from .run import Found
from .stepping import Flow, check_moved, check_steps


class Reversible(eqx.Module):
    r"""Reverse mode with memory that does not grow with the number of steps: `simulate(..., adjoint=gx.Reversible())`.

    A splitting method is made of kicks v += b h a(u) and drifts u += a h v, and each can be undone. The derivative goes
    back from the end, undoing one after another and pulling its cotangent through, so that nothing was kept. It is the
    exact derivative of the discrete run as far as the way back is the way there. With closed contacts it is, to 1e-12
    after 1e5 steps; a chaotic scene (a sonic vacuum: contacts that open and close) does not return in floating point,
    and damping amplifies rounding by exp(gamma t) on the way back. So the start that was reached is compared with the
    start, and where they differ by more than `tolerance` the derivative is NaN rather than wrong; use
    `diffrax.RecursiveCheckpointAdjoint()` there.

    **Arguments:** `tolerance`: of the return error, max |y - y0| over the largest entry at both ends, displacements
    and velocities each for themselves. `return_error`: leave it at zero; the derivative with respect to it *is* the
    return error, the way in which a gradient reports it: `jax.grad(f, (0, 1))(x, gx.Reversible())[1].return_error`.

    Wants a splitting solver at a fixed step and no records, and refuses forward mode; gives derivatives of what is
    saved and of the end (NaN for those of `energy_error`) with respect to lattice and state, not with respect to times.
    Takes 3 to 6 times the run.
    From 1 on it trusts a way back that leads elsewhere. **Raises** ValueError for a tolerance that is not above zero.

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
    """A sentence in the place of JAX's, where an adjoint of reverse mode meets forward mode; other errors pass on.

    JAX speaks itself where the program was traced first and differentiated then: `jax.jacfwd(jax.jit(f))`.
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
    """What integrating to t1 and back to t0 misses: max |y - y0| over the largest entry at both ends, of u or of v.

    **Arguments:** `steps`: how many each way, a whole number or an array; `solver`: any with symmetric steps.
    """
    check_steps(steps)
    # arrays, whose values compile nothing anew
    t0, t1 = (jnp.asarray(t, lattice.dtype) for t in (t0, t1))
    return _return_error(lattice, state, t0, t1, jnp.asarray(steps), solver)


@eqx.filter_jit
def _return_error(lattice, state, t0, t1, steps, solver):
    flow = Flow(steps, solver)
    check_moved("state", state, flow, lattice, "the lattice")
    end = flow(state, t0, t1, lattice)
    back = flow(end, t1, t0, lattice)
    return jnp.maximum(*(_missed(*x) for x in zip(back, state, end)))


@eqx.filter_custom_vjp
def reversible(moved: tuple, span: tuple, plan: Plan) -> Found:
    """`integrate` with the derivative of `Reversible`; moved = (lattice, state, adjoint)."""
    lattice, state, _ = moved
    return integrate(lattice, state, *span, plan)


@reversible.def_fwd
def _(perturbed, moved, *rest):
    run = reversible(moved, *rest)
    return run, (run.final, run.stats["accepted"])


@reversible.def_bwd
def _(residuals, cotangents, perturbed, moved, span, plan):
    (final, count), (lattice, state, adjoint) = residuals, moved
    free = perturbed[0]
    dt, save_ts = plan.step, plan.save_ts
    way = _Way(plan.solver, *eqx.partition(lattice, free), span[0], dt)
    zero = jax.tree.map(jnp.zeros_like, final)
    pulled = _filled(cotangents.final, zero)
    if save_ts is None:  # the one frame that is saved is the end
        frame = type(zero)(
            *(
                jax.tree.map(lambda x: x[0], _filled(c, jax.tree.map(lambda z: z[None], z)))
                for c, z in zip((cotangents.us, cotangents.vs), zero)
            )
        )
        pulled = jax.tree.map(jnp.add, pulled, frame)
    carry = way.enter(final, pulled, span[0] + count * dt)
    like = (
        None
        if save_ts is None
        else jax.tree.map(lambda x: jnp.zeros((len(save_ts), *x.shape), x.dtype), zero)
    )
    if save_ts is not None and jax.tree.leaves((cotangents.us, cotangents.vs)):
        saved = type(zero)(_filled(cotangents.us, like.u), _filled(cotangents.vs, like.v))
        places = jnp.clip(
            jnp.floor((save_ts - span[0]) / dt).astype(int), 0, jnp.maximum(count - 1, 0)
        )

        def sample(i, carry):
            i, (k, carry) = len(save_ts) - 1 - i, carry
            carry = way.back(carry, k, places[i])
            pulled = jax.tree.map(lambda x: x[i], saved)
            return places[i], way.sample(carry, places[i], save_ts[i], pulled)

        count, carry = jax.lax.fori_loop(0, len(save_ts), sample, (count, carry))
    back, pulled, gradient = way.leave(way.back(carry, count, 0))
    error = jnp.maximum(*(_missed(*x) for x in zip(back, state, final)))
    good = error <= adjoint.tolerance
    if cotangents.energy_error is not None:
        good = good & jnp.all(cotangents.energy_error == 0)
    gradient, pulled = jax.tree.map(lambda x: jnp.where(good, x, jnp.nan), (gradient, pulled))
    return gradient, type(state)(*pulled), eqx.tree_at(lambda a: a.return_error, adjoint, error)


def _filled(cotangent, zero):
    """A cotangent with zeros where there is none."""
    return jax.tree.map(
        lambda z, c: z if c is None else c, zero, cotangent, is_leaf=lambda x: x is None
    )


def _missed(back, start, end):
    parts = [jax.tree.leaves(x) for x in (back, start, end)]
    scale = jnp.max(jnp.stack([jnp.max(jnp.abs(x)) for x in parts[1] + parts[2]]))
    error = jnp.max(jnp.stack([jnp.max(jnp.abs(x - y)) for x, y in zip(*parts[:2])]))
    return jnp.where(jnp.isnan(error), jnp.inf, error / jnp.where(scale > 0, scale, 1))


class _Way(eqx.Module):
    """The way back, in the solver's working form w: carry = (w, its cotangent, that of the free parameters)."""

    solver: AbstractSplitting
    free: object
    fixed: object
    t0: Number
    h: Number

    def _system(self, free):
        return split_system(eqx.combine(free, self.fixed))

    def enter(self, y, pulled, t):
        """The carry at a state with its cotangent."""
        system = self._system(self.free)
        w = system.enter(y, system.start(t, y))
        _, pull = jax.vjp(lambda w: tuple(system.leave(w, y)[0]), w)
        return w, pull(tuple(pulled))[0], jax.tree.map(jnp.zeros_like, self.free)

    def leave(self, carry):
        """The state, its cotangent, that of the parameters."""
        w, pulled, gradient = carry
        system = self._system(self.free)
        y = tuple(system.leave(w, (w[0], w[1]))[0])
        _, pull = jax.vjp(lambda y: system.enter(y, w[2:] and w[2])[:2], y)
        return y, pull(tuple(pulled[:2]))[0], gradient

    def back(self, carry, start, stop):
        """From the end of step `start` - 1 to the beginning of step `stop`."""
        table = self.solver.table()
        count = len(table.a) if table.b[-1] != 0 else len(table.a) - 1
        times, opening = np.cumsum(table.a)[:count][::-1], table.b[0] * self.h
        ah, bh = table.a[:count][::-1] * self.h, table.b[1 : count + 1][::-1] * self.h

        def stage(carry, x):
            ah, bh, t = x
            w, pulled, gradient = carry
            system = self._system(self.free)
            if hasattr(system, "spread"):
                # what the force leaves in its slot is a buffer, not a cotangent
                *pulled, idle = pulled
                force = lambda free, e: self._system(free).law.force(e)
                forces, pull = jax.vjp(force, self.free, system.compression(w))
                carry = system.filled(w, forces), (*pulled, jnp.zeros_like(idle)), gradient
                w, pulled, gradient = self._undone("kick", carry, bh)
                change, pulled = system.spread(pulled, pull, idle)
            else:
                w, pull = jax.vjp(lambda free, w: self._system(free).refresh(w, t), self.free, w)
                w, pulled, gradient = self._undone("kick", (w, pulled, gradient), bh)
                change, pulled = pull(pulled)
            gradient = jax.tree.map(jnp.add, gradient, change)
            return self._undone("drift", (w, pulled, gradient), ah), None

        def step(i, both):
            carry, pending = both
            t = self.t0 + (start - 1 - i) * self.h
            if count < len(table.a):
                carry = self._undone("drift", carry, table.a[-1] * self.h)
            # the kick that opened the later step reads the force that this step's last kick reads
            kicks = jnp.asarray(bh).at[0].add(pending)
            carry, _ = jax.lax.scan(stage, carry, (jnp.asarray(ah), kicks, t + times * self.h))
            return carry, jnp.asarray(opening)

        none = jnp.zeros_like(jnp.asarray(opening))
        carry, pending = jax.lax.fori_loop(0, start - stop, step, (carry, none))
        if table.b[0] == 0:
            return carry
        # an empty drift: only the pending kick and the force that it reads
        return stage(carry, (jnp.zeros_like(self.h), pending, self.t0 + stop * self.h))[0]

    def _undone(self, flow, carry, length):
        """One kick or drift undone, and the cotangents pulled through it."""
        w, pulled, gradient = carry
        move = lambda free, w: getattr(self._system(free), flow)(w, length)
        w = getattr(self._system(self.free), flow)(w, -length)
        change, pulled = jax.vjp(move, self.free, w)[1](pulled)
        return w, pulled, jax.tree.map(jnp.add, gradient, change)

    def sample(self, carry, k, t, pulled):
        """The carry at the beginning of step k, with the cotangent of the state read off at t within that step."""
        w, before, gradient = carry
        system = self._system(self.free)
        y, _ = system.leave(w, (w[0], w[1]))
        start = self.t0 + k * self.h

        def read(free, y):
            lattice = eqx.combine(free, self.fixed)
            terms = diffrax.ODETerm(vector_field)
            kept = self.solver.init(terms, start, start + self.h, y, lattice)
            _, _, dense, _, _ = self.solver.step(
                terms, start, start + self.h, y, lattice, kept, False
            )
            u, v = self.solver.interpolation_cls(t0=start, t1=start + self.h, **dense).evaluate(t)
            return u, v

        change, at_y = jax.vjp(read, self.free, tuple(y))[1](tuple(pulled))
        _, pull = jax.vjp(lambda w: tuple(system.leave(w, (w[0], w[1]))[0]), w)
        return (
            w,
            jax.tree.map(jnp.add, before, pull(at_y)[0]),
            jax.tree.map(jnp.add, gradient, change),
        )
