"""Descent along gradients, by an optimiser of optax."""

from collections.abc import Callable
from functools import cache
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from .programs import compiled
from .types import AnyArray, Scalar

CONVERGED, STALLED, SPENT, NOT_FINITE, NO_GRADIENT, NO_START = range(6)
# length of a step in the free coordinates where no curvature is known
SHORT = 0.3
# of the fall that the slope promises, what a step must bring
DECREASE = 1e-4
# part of a step below which none is tried
SHORTEST = 1e-8


class Descent(NamedTuple):
    """Where a descent ended.

    The best point `x` and its value `least`; `values` and `norms` of the points that were accepted, the start first;
    `start`: the gradient at the start; `code`: 0 converged, 1 stalled, 2 steps spent, 3 not finite on the way,
    4 gradient zero at the start, 5 not finite at the start.
    """

    x: Float[np.ndarray, " P"]
    least: float
    values: list[float]
    norms: list[float]
    start: Float[np.ndarray, " P"]
    code: int


def descend(
    cost: Callable,
    x: Float[AnyArray, " P"],
    optimiser: object,
    max_steps: int,
    tolerance: Scalar,
    mode: str = "reverse",
) -> Descent:
    """Steps of an optimiser from x (P,) until one of the reasons to end.

    **Arguments:** `cost(x)`: a function, or a module with arrays, those of another start compile nothing anew.
    `optimiser`: of optax; `None` is L-BFGS with steps that are shortened until the cost falls. `tolerance`: of the
    gradient's largest entry, relative to the start's. `mode`: of the gradient, "forward" or "reverse".
    """
    search = optimiser is None
    optimiser = _lbfgs() if search else optimiser
    x = old_x = np.asarray(x)
    value, gradient = (np.asarray(part) for part in value_and_gradient(cost, mode, x))
    best, start, old_gradient = (np.inf, x), gradient, gradient
    values, norms = [float(value)], [float(np.abs(gradient).max())]

    def ended(code):
        return Descent(best[1], best[0], values, norms, start, code)

    if not (np.isfinite(value) and np.isfinite(gradient).all()):
        return ended(NO_START)
    best = (float(value), x)
    if norms[0] == 0:
        return ended(NO_GRADIENT)
    state = optimiser.init(x)
    while len(values) <= max_steps:
        step, state = _step(optimiser, None if search else cost, gradient, state, x, value)
        curved = np.vdot(x - old_x, gradient - old_gradient) > 0
        if search and not (curved and np.vdot(step, gradient) < 0):
            # memory is of no use where the curvature is not positive: there, as at the start, a short step downhill
            step = -SHORT * gradient / np.linalg.norm(gradient)
            state = _step(optimiser, None, gradient, optimiser.init(x), x, value)[1]
        part, step = 1.0, np.asarray(step)
        while True:
            new_x = x + part * step
            new_value, new_gradient = map(np.asarray, value_and_gradient(cost, mode, new_x))
            finite = np.isfinite(new_value) and np.isfinite(new_gradient).all()
            slope = part * float(np.vdot(step, gradient))
            if not search or finite and new_value <= value + DECREASE * slope:
                break
            # the parabola through both values and the slope, within limits
            beyond = 2 * float(new_value - value - slope)
            part *= min(max(-slope / beyond, 0.1), 0.5) if beyond > 0 else 0.1
            if part < SHORTEST:
                return ended(STALLED)
        old_x, old_gradient, x, value, gradient = x, gradient, new_x, new_value, new_gradient
        values.append(float(value))
        norms.append(float(np.abs(gradient).max()))
        if not finite:
            return ended(NOT_FINITE)
        if value < best[0]:
            best = (float(value), x)
        if norms[-1] <= tolerance * norms[0]:
            return ended(CONVERGED)
    return ended(SPENT)


@compiled
def value_and_gradient(
    cost: Callable, mode: str, x: Float[AnyArray, " P"]
) -> tuple[Float[AnyArray, ""], Float[AnyArray, " P"]]:
    """The cost at x and its gradient, "forward" by one tangent for each entry, or in "reverse"."""
    if mode == "reverse":
        return jax.value_and_grad(cost)(x)
    unit = jnp.eye(x.size, dtype=x.dtype)
    return jax.vmap(lambda w: jax.jvp(cost, (x,), (w,)), out_axes=(None, 0))(unit)


@cache
def _lbfgs():
    import optax

    return optax.lbfgs(linesearch=None)


@compiled
def _step(optimiser, cost, gradient, state, x, value):
    """The optimiser's step from x, and its state after it."""
    import optax

    update = optax.with_extra_args_support(optimiser).update
    return update(gradient, state, x, value=value, grad=gradient, value_fn=cost)
