"""Newton's method with steps that are halved until they reduce the residual."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

# The most steps of Newton's method.
STEPS = 40
# The number of fractions 1, 1/2, 1/4, ... of a step that are tried.
HALVINGS = 6
# The residual below which no further step is taken.
SETTLED = 1e-15


class Left(NamedTuple):
    """The residual at x: its root mean square, itself, and its Jacobian."""

    size: float
    x: np.ndarray
    gap: np.ndarray
    matrix: Any

    @property
    def residual(self) -> float:
        """The largest absolute residual."""
        return float(np.abs(self.gap).max())


def damped(equations: Callable, solve: Callable, x: np.ndarray, enough: float = 0.0) -> Left:
    """Return the x of least residual that Newton's method reaches from a guess.

    `equations(x)`: the residual and its matrix; `solve(matrix, gap)`: the step. It stops where no
    step reduces the residual, or where this is below `enough` and a step gains less than a half.
    """

    def at(x):
        with np.errstate(all="ignore"):
            gap, matrix = equations(x)
            size = np.sqrt(np.mean(gap**2))
        return Left(size if np.isfinite(size) else np.inf, x, gap, matrix)

    best = at(x)
    for _ in range(STEPS):
        if best.size == np.inf or best.residual < SETTLED:
            break
        try:
            step = solve(best.matrix, best.gap)
        except (np.linalg.LinAlgError, ValueError):
            break
        trials = (at(best.x - step / 2**k) for k in range(HALVINGS))
        new = next((trial for trial in trials if trial.size < best.size), None)
        if new is None:
            break
        before = best.size
        best = new
        if before / 2 < best.size < enough:
            break
    return best
