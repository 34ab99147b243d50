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
