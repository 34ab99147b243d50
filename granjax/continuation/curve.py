"""What continuation returns: a branch and the special points on it."""

from typing import NamedTuple

import numpy as np


class Special(NamedTuple):
    """A point found on a branch: `kind` "fold" or "branch point", `x`, `p`, and `after`, the index of the point before.

    `directions`: unit tangents (x, p) of the branches that meet at a branch point, the traced one first.
    """

    kind: str
    x: np.ndarray
    p: float
    after: int
    directions: np.ndarray


class Curve(NamedTuple):
    """A branch: `x` (P, n), `p` (P,), unit tangents (P, n + 1), what was found on it, and why it ended.

    `newton`: Jacobians taken in all. `outcome`: a sentence.
    """

    x: np.ndarray
    p: np.ndarray
    tangents: np.ndarray
    special: tuple[Special, ...]
    newton: int
    outcome: str

    @property
    def folds(self):
        """Values of the parameter at the folds."""
        return np.array([s.p for s in self.special if s.kind == "fold"])

    @property
    def branch_points(self):
        """Values of the parameter where another branch crosses."""
        return np.array([s.p for s in self.special if s.kind == "branch point"])
