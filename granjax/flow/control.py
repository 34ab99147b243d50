"""Step control: steps that end where forces jump in time, and adaptive steps."""

import math
from collections.abc import Callable

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp

from ..base.types import Number, Pytree
from ..lattice import Lattice
from ..solvers.wrapped import Wrapped
from ..terms.base import Clipped
from ..terms.waveforms import ULPS, count_breaks, next_break

# A step that would end within this relative distance before its goal ends at the goal.
NEARLY = 1e-9


class OneSided(Wrapped):
    """A solver whose steps start with a new force and see the lattice inside of them."""

    def init(self, terms, t0, t1, y0, args):
        return None

    def step(self, terms, t0, t1, y0, args, solver_state, made_jump):
        args = inside(args, t0, t1)
        own = self.solver.init(terms, t0, t1, y0, args)
        y1, error, dense, _, result = self.solver.step(terms, t0, t1, y0, args, own, made_jump)
        return y1, error, dense, None, result


def just_inside(t0: Number, t1: Number) -> tuple[Number, Number]:
    """Return the first and last time inside of a step."""
    slack = (
        2 * ULPS * jnp.finfo(jnp.result_type(t0, t1)).eps * jnp.maximum(jnp.abs(t0), jnp.abs(t1))
    )
    return jnp.minimum(t0, t1) + slack, jnp.maximum(t0, t1) - slack


def inside(lattice: Lattice, t0: Number, t1: Number) -> Lattice:
    """Return the lattice as it is inside of a step, also at its ends."""
    low, high = just_inside(t0, t1)
    held = tuple(Clipped(term, low, high) if term.jumps() else term for term in lattice.terms)
    return eqx.tree_at(lambda x: x.terms, lattice, held)


def one_sided(solver: diffrax.AbstractSolver, lattice: Lattice) -> diffrax.AbstractSolver:
    """Return the solver with one-sided steps, or unchanged where the lattice has no breaks."""
    return OneSided(solver) if lattice.breaks else solver


def shared_out(breaks: tuple, t: Number, left: Number, end: Number, sign: Number) -> Number:
    """Return the end of a step from t, where `left` steps lead through all breaks to `end`.

    Each stretch between breaks gets its share of the steps.
    """
    goal = jnp.minimum(next_break(breaks, t, sign), end)
    beyond = jnp.where(goal < end, 1 + count_breaks(breaks, goal, end, sign), 0)
    share = jnp.round(left * (goal - t) / jnp.where(end > t, end - t, 1))
    count = jnp.clip(share, 1, jnp.maximum(left - beyond, 1))
    return jnp.where(left == 1, end, jnp.where(count == 1, goal, t + (goal - t) / count))


class Landing(diffrax.AbstractStepSizeController):
    """Equal steps of at most `step` to the next break or `end`."""

    breaks: tuple
    step: Number
    end: Number

    def wrap(self, direction):
        return self

    def init(self, terms, t0, t1, y0, dt0, args, func, error_order):
        return self._after(t0), None

    def adapt_step_size(
        self, t0, t1, y0, y1_candidate, args, y_error, error_order, controller_state
    ):
        return True, t1, self._after(t1), False, None, diffrax.RESULTS.successful

    def _after(self, t):
        goal = jnp.minimum(next_break(self.breaks, t), self.end)
        count = jnp.maximum(jnp.ceil((goal - t) / self.step * (1 - NEARLY)), 1)
        return jnp.where(count == 1, goal, t + (goal - t) / count)


def both_modes(solver: diffrax.AbstractSolver) -> diffrax.AbstractSolver:
    """Return the solver with diffrax's loop over stages that has both derivative modes."""
    if getattr(solver, "scan_kind", "own") is not None:
        return solver
    return eqx.tree_at(lambda s: s.scan_kind, solver, "bounded", is_leaf=lambda x: x is None)


def cut(breaks: tuple, t: Number, step: Number) -> tuple:
    """Return the end of a step from t, and its full length if a break cut it short, else zero."""
    goal = next_break(breaks, t)
    short = t + step * (1 + NEARLY) > goal
    return jnp.where(short, goal, t + step), jnp.where(short, step, 0).astype(jnp.result_type(step))


# The next step, relative to the one whose estimated error would equal the tolerance.
SAFETY = 0.8
# The least factor from one step to the next.
SHRINK = 0.2
# The largest factor from one step to the next.
GROW = 3.0
# A run ends at a failed, tiny step once the rounding of its motion is this many times the tolerance:
# the next steps would be shorter still.
OUTGROWN = 1e5
# A step is tiny below this part of the lattice's own time.
TINY = 1e-9
# The halvings of an array before XLA's maximum is taken.
HALVINGS = 3
# The factor of the step is rounded to this part of an octave. Rounding errors in the error estimate
# would otherwise grow from step to step when steps close in on an opening contact.
PARTS = 8


class Scales(eqx.Module):
    """The largest entry of displacements and velocities, each relative to its scale."""

    displacement: Number
    velocity: Number

    def __call__(self, y: Pytree) -> Number:
        u, v, *_ = y
        return jnp.maximum(largest(u) / self.displacement, largest(v) / self.velocity)


def largest(tree: Pytree) -> Number:
    """Return the largest absolute value in a tree; infinite if one is not a number."""
    sizes = [_maximum(jnp.abs(x).reshape(-1)) for x in jax.tree.leaves(tree)]
    return jnp.max(jnp.stack(sizes)) if len(sizes) > 1 else sizes[0]


def _maximum(x):
    # XLA's maximum over a long array may lose a NaN.
    x = jnp.where(x < jnp.inf, x, jnp.inf)
    # It does not vectorise either. So the array is halved three times, by the elementwise maximum
    # of both halves, which overlap where the size is odd.
    for _ in range(HALVINGS):
        half = (x.size + 1) // 2
        x = jnp.maximum(x[:half], x[x.size - half :])
    return jnp.max(x)


class StepControl(diffrax.AbstractAdaptiveStepSizeController):
    r"""Steps with local error below a tolerance: h <- h min(3, max(1/5, 0.8 (tol/error)^(1/q))).

    q is the order of the error estimate; the factor is rounded to eighths of an octave. A failed
    step is repeated shorter. The next successful step does not grow, since it meets the opened
    contact again. The first step, `first` tolerance^(1/q), needs no force evaluation.

    **Arguments:** `atol`: the dimensionless tolerance. `norm`: of a state, in the scales of the
    lattice. `first`: a time. `longest`: the longest step, or `None`. `breaks`: times at which steps
    end; the next step is as long as was planned before the break.
    """

    atol: jax.Array
    norm: Callable
    first: jax.Array
    longest: jax.Array | None = None
    breaks: tuple = ()
    rtol: float = 0.0

    def wrap(self, direction):
        return self

    def init(self, terms, t0, t1, y0, dt0, args, func, error_order):
        step = self._bounded(self.first * self.atol ** (1 / error_order))
        if self.breaks:
            end, meant = cut(self.breaks, t0, step)
            return end, (jnp.asarray(False), meant)
        return t0 + step, jnp.asarray(False)

    def adapt_step_size(
        self, t0, t1, y0, y1_candidate, args, y_error, error_order, controller_state
    ):
        error, length = jax.lax.stop_gradient((self.norm(y_error) / self.atol, t1 - t0))
        keep = error < 1
        failed, meant = controller_state if self.breaks else (controller_state, 0)
        most = jnp.where(failed | ~keep, 1.0, GROW)
        factor = jnp.exp2(
            jnp.round(PARTS * (math.log2(SAFETY) - jnp.log2(error) / error_order)) / PARTS
        )
        factor = jnp.clip(factor, SHRINK, most)
        step = self._bounded(length * factor.astype(t1.dtype))
        start = jnp.where(keep, t1, t0)
        # Beyond this size the rounding of velocities alone asks for ever shorter steps.
        size = OUTGROWN * self.atol / jnp.finfo(t1.dtype).eps
        y0 = jax.lax.stop_gradient(y0)
        tiny = ~keep & (length < TINY * self.first)
        outgrown = jax.lax.cond(tiny, lambda: self.norm(y0) > size, lambda: False)
        end = start + step
        # A failed step that is rounded up to the same end would be taken for ever.
        stuck = ~(end > start) | ~keep & (end >= t1) | outgrown
        result = diffrax.RESULTS.where(
            stuck, diffrax.RESULTS.dt_min_reached, diffrax.RESULTS.successful
        )
        if self.breaks:
            end, meant = cut(self.breaks, start, jnp.where(keep, jnp.maximum(step, meant), step))
            return keep, start, end, False, (~keep, meant), result
        return keep, start, end, False, ~keep, result

    def _bounded(self, step):
        return step if self.longest is None else jnp.minimum(step, self.longest)
