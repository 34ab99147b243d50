"""Arrays of any number of axes."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from .types import Numbers, Pytree


def trailing(x: Any, ndim: int) -> Any:
    """Return an array with `ndim` axes, those behind its own of length 1."""
    return x.reshape(x.shape + (1,) * (ndim - x.ndim))


def padded(x: Any, low: int, high: int, axis: int = 0, mode: str = "constant") -> Any:
    """Return an array with more entries, zeros by default, at both ends of an axis."""
    widths = [(0, 0)] * x.ndim
    widths[axis] = low, high
    # NumPy for its arrays, such as site numbers, so that bonds are counted while JAX traces.
    return (np if isinstance(x, np.ndarray) else jnp).pad(x, widths, mode=mode)


def most(tree: Pytree) -> Numbers:
    """Return the largest number in a tree of arrays."""
    return jnp.max(jnp.stack([jnp.max(x) for x in jax.tree.leaves(tree)]))


def cubic_top(x0: Numbers, x1: Numbers, d0: Numbers, d1: Numbers) -> Numbers:
    """Return the maximum of a cubic from its values and slopes, times the step, at both ends."""
    rise = x1 - x0
    a = 3 * (d0 + d1 - 2 * rise)
    b = 3 * rise - 2 * d0 - d1
    square = b * b - a * d0
    turns = square > 0
    # The slope a x^2 + 2 b x + d0 has two zeros; the maximum is x = d0/(-b + root).
    below = jnp.sqrt(jnp.where(turns, square, 1)) - b
    place = jnp.where(turns & (below != 0), d0 / jnp.where(below != 0, below, 1), 0)
    # To first order the maximum does not depend on its position; second derivatives are lost.
    x = jax.lax.stop_gradient(jnp.clip(place, 0, 1))
    inside = x0 + x * (d0 + x * (b + x * a / 3))
    return jnp.maximum(jnp.maximum(x0, x1), inside)
