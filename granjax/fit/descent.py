"""Descent along gradients, by an optimiser of optax."""

from collections.abc import Callable
from functools import cache
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ..base.programs import compiled
from ..base.types import AnyArray, Scalar

CONVERGED, STALLED, SPENT, NOT_FINITE, NO_GRADIENT, NO_START = range(6)
# the length of a step in the free coordinates if the curvature is unknown
SHORT = 0.3
# a step must bring this share of the decrease that the slope predicts
DECREASE = 1e-4
# the shortest part of a step that is tried
SHORTEST = 1e-8
# an entry of the gradient that never exceeds this share of the start's largest counts as that
SMALL = 1e-4


class Descent(NamedTuple):
    """The end of a descent.

    `x`, `least`: the best point and its value. `values`, `norms`: of the accepted points, the start
    first. `start`: the gradient there. `code`: CONVERGED, ..., NO_START.
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
    """Minimise a cost by steps of an optimiser from x (P,).

    **Arguments:** `cost(x)`: a function, or a module, which compiles nothing anew for other arrays.
    `optimiser`: of optax; `None` is L-BFGS with steps that are shortened until the cost falls.
    `tolerance`: of each entry of the gradient, relative to its largest. `mode`: of the gradient,
    "forward" or "reverse".
    """
    search = optimiser is None
    optimiser = _lbfgs() if search else optimiser
    x = np.asarray(x)
    value, gradient = (np.asarray(part) for part in value_and_gradient(cost, mode, x))
    best = (np.inf, x)
    start = gradient
    values = [float(value)]
    norms = [float(np.abs(gradient).max())]
    largest = np.maximum(np.abs(gradient), SMALL * norms[0])

    def ended(code):
        return Descent(best[1], best[0], values, norms, start, code)

    if not (np.isfinite(value) and np.isfinite(gradient).all()):
        return ended(NO_START)
    best = (float(value), x)
    if norms[0] == 0:
        return ended(NO_GRADIENT)
    state = optimiser.init(x)
    curved = False
    while len(values) <= max_steps:
        step, state = _step(optimiser, None if search else cost, gradient, state, x, value)
        if search and not (curved and np.vdot(step, gradient) < 0):
            # without positive curvature the memory of L-BFGS is useless: forget it and take a short
            # step downhill, as at the start
            step = -SHORT * gradient / np.linalg.norm(gradient)
            state = _step(optimiser, None, gradient, optimiser.init(x), x, value)[1]
        part = 1.0
        step = np.asarray(step)
        while True:
            new_x = x + part * step
            new_value, new_gradient = map(np.asarray, value_and_gradient(cost, mode, new_x))
            finite = np.isfinite(new_value) and np.isfinite(new_gradient).all()
            slope = part * float(np.vdot(step, gradient))
            if not search or finite and new_value <= value + DECREASE * slope:
                break
            # minimum of the parabola through both values and the slope, within limits
            beyond = 2 * float(new_value - value - slope)
            part *= min(max(-slope / beyond, 0.1), 0.5) if beyond > 0 else 0.1
            if part < SHORTEST:
                return ended(STALLED)
        values.append(float(new_value))
        norms.append(float(np.abs(new_gradient).max()))
        if not finite:
            return ended(NOT_FINITE)
        curved = np.vdot(new_x - x, new_gradient - gradient) > 0
        x = new_x
        value = new_value
        gradient = new_gradient
        if value < best[0]:
            best = (float(value), x)
        largest = np.maximum(largest, np.abs(gradient))
        if (np.abs(gradient) <= tolerance * np.minimum(largest, norms[0])).all():
            return ended(CONVERGED)
    return ended(SPENT)


@compiled
def value_and_gradient(
    cost: Callable, mode: str, x: Float[AnyArray, " P"]
) -> tuple[Float[AnyArray, ""], Float[AnyArray, " P"]]:
    """Return the cost at x and its gradient, "forward" (one tangent per entry) or "reverse"."""
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
    import optax

    update = optax.with_extra_args_support(optimiser).update
    return update(gradient, state, x, value=value, grad=gradient, value_fn=cost)
