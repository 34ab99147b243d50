"""Descent along gradients by an optax optimiser: one compiled loop that evaluates once a round."""

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Float

from .types import AnyArray, Scalar

CONVERGED, STALLED, SPENT, NOT_FINITE, NO_GRADIENT, NO_START = range(6)
# length of a step in the free coordinates where no curvature is known
SHORT = 0.3
# of the fall that the slope promises, what a step must bring; part of a step below which none is tried
DECREASE, SHORTEST = 1e-4, 1e-8


class Descent(NamedTuple):
    """Where a descent ended.

    The best point `x` and its value `least`; `values` and `norms` (max_steps + 1,) of the points that were accepted,
    NaN after the last one; `start`: the gradient at the start; `iterations`; `code`: 0 converged, 1 stalled, 2 steps
    spent, 3 not finite on the way, 4 gradient zero at the start, 5 not finite at the start.
    """

    x: Float[AnyArray, " P"]
    least: Float[AnyArray, ""]
    values: Float[AnyArray, " points"]
    norms: Float[AnyArray, " points"]
    start: Float[AnyArray, " P"]
    iterations: AnyArray
    code: AnyArray


class _Place(eqx.Module):
    """A point that was accepted, and the step that leads on from it."""

    x: Float[AnyArray, " P"]
    value: Scalar
    gradient: Float[AnyArray, " P"]
    step: Float[AnyArray, " P"]
    state: object


def descend(
    cost: Callable,
    both: Callable,
    size: int,
    optimiser: object,
    max_steps: int,
    tolerance: Scalar,
) -> Descent:
    """Steps of an optimiser from x = 0 (size,) until one of the reasons to end.

    One evaluation a round, of the start, of a step, or of a part of a step that went too far: an objective that takes
    long to compile is compiled once.

    **Arguments:** `cost(x)`; `both(x)`: cost and gradient. `optimiser`: of optax; `None` is L-BFGS with steps that are
    shortened until the cost falls. `tolerance`: of the gradient's largest entry, relative to the start's.
    """
    import optax

    search = optimiser is None
    optimiser = optax.with_extra_args_support(optax.lbfgs(linesearch=None) if search else optimiser)
    zero = jnp.zeros(size)

    def leave(old, x, value, gradient):
        """The place at x, with the optimiser's step from there."""
        extra = {} if search else {"value": value, "grad": gradient, "value_fn": cost}
        step, state = optimiser.update(gradient, old.state, x, **extra)
        if search:
            # memory is of no use where the curvature is not positive: there, as at the start, a short step downhill
            uphill = (jnp.vdot(x - old.x, gradient - old.gradient) <= 0) | (
                jnp.vdot(step, gradient) >= 0
            )
            down = (
                -SHORT * gradient / jnp.maximum(jnp.linalg.norm(gradient), jnp.finfo(x.dtype).tiny)
            )
            again = optimiser.update(gradient, optimiser.init(x), x)[1]
            step, state = jax.tree.map(
                lambda new, old: jnp.where(uphill, new, old), (down, again), (step, state)
            )
        return _Place(x, value, gradient, step, state)

    def visit(carry):
        place, part, tried, i, best, largest, start, code, values, norms = carry
        first = tried == 0
        x = place.x + part * place.step
        value, gradient = both(x)
        norm, finite = jnp.abs(gradient).max(), jnp.isfinite(value) & jnp.isfinite(gradient).all()
        slope = part * jnp.vdot(place.step, place.gradient)
        accepted = first | (finite & (value <= place.value + DECREASE * slope) if search else True)
        values = values.at[i].set(jnp.where(accepted, value, values[i]))
        norms = norms.at[i].set(jnp.where(accepted, norm, norms[i]))
        largest, start = jnp.where(first, norm, largest), jnp.where(first, gradient, start)
        better = accepted & finite & ((value < best[0]) | first)
        best = jax.tree.map(lambda new, old: jnp.where(better, new, old), (value, x), best)
        # the parabola through both values and the slope, within limits
        shorter = part * jnp.clip(
            jnp.nan_to_num(-slope / (2 * (value - place.value - slope))), 0.1, 0.5
        )
        part = jnp.where(accepted, 1.0, shorter)
        code = jnp.select(
            [
                first & ~finite,
                first & (norm == 0),
                accepted & ~finite,
                accepted & (norm <= tolerance * largest) & ~first,
                part < SHORTEST,
                accepted & (i >= max_steps),
            ],
            [NO_START, NO_GRADIENT, NOT_FINITE, CONVERGED, STALLED, SPENT],
            -1,
        )
        onward = leave(place, x, value, gradient)
        place = jax.tree.map(lambda new, old: jnp.where(accepted, new, old), onward, place)
        return place, part, tried + 1, i + accepted, best, largest, start, code, values, norms

    none = jnp.full(max_steps + 1, jnp.nan)
    place = _Place(zero, jnp.inf, zero, zero, optimiser.init(zero))
    carry = (place, 1.0, 0, 0, (jnp.inf, zero), 0.0, zero, -1, none, none)
    carry = jax.tree.map(jnp.asarray, carry)
    _, _, _, i, (least, x), _, start, code, values, norms = jax.lax.while_loop(
        lambda c: c[7] < 0, visit, carry
    )
    return Descent(x, least, values, norms, start, i - 1, code)
