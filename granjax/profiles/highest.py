"""Maxima of functions and of rows."""

from collections.abc import Callable

import numpy as np

# The number of refinements. Together they narrow the interval to a millionth.
CLOSER = 5
# The number of places of each refinement.
AROUND = 33


def tops(x: np.ndarray) -> np.ndarray:
    """Return the indices of the local maxima."""
    return np.flatnonzero((x[1:-1] > x[:-2]) & (x[1:-1] >= x[2:])) + 1


def highest(function: Callable, low: float, high: float) -> tuple[float, float]:
    """Return the place of the maximum between `low` and `high`, to a millionth, and its value."""
    for _ in range(CLOSER):
        near = np.linspace(low, high, AROUND)
        found = function(near)
        k = int(np.clip(np.argmax(np.where(np.isfinite(found), found, -np.inf)), 1, AROUND - 2))
        low = near[k - 1]
        high = near[k + 1]
    return float(near[k]), float(found[k])
