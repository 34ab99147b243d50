"""Where a function of one maximum is highest."""

from collections.abc import Callable

import numpy as np

# how often the maximum is looked at closer, and places each time: a millionth of the interval
CLOSER, AROUND = 5, 33


def highest(function: Callable, low: float, high: float) -> tuple[float, float]:
    """The place between `low` and `high` where a function is highest, to a millionth, and its value there."""
    for _ in range(CLOSER):
        near = np.linspace(low, high, AROUND)
        found = function(near)
        k = int(np.clip(np.argmax(np.where(np.isfinite(found), found, -np.inf)), 1, AROUND - 2))
        low, high = near[k - 1], near[k + 1]
    return float(near[k]), float(found[k])
