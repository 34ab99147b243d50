"""What continuation returns: a branch and the special points on it."""

from typing import NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Float

from ..printing import told
from ..results import Result, array


class Special(NamedTuple):
    """A point found on a branch: `kind` "fold" or "branch point", `x`, `p`, and `after`, the index of the point before.

    `directions`: unit tangents (x, p) of the branches that meet at a branch point, the traced one first.
    """

    kind: str
    x: Float[np.ndarray, " n"]
    p: float
    after: int
    directions: Float[np.ndarray, "branches n_and_p"]
    __repr__ = told


class Curve(Result):
    """A branch, what was found on it, and why it ended."""

    x: Float[np.ndarray, "point unknown"] = array("The unknowns of every point.")
    p: Float[np.ndarray, " point"] = array("The parameter of every point.")
    tangents: Float[np.ndarray, "point tangent"] = array("Unit tangents.")
    special: tuple[Special, ...] = array("The special points, in the order of the branch.")
    newton: int = array("The number of Jacobians that were taken.")
    outcome: str = eqx.field(static=True)

    @property
    def folds(self) -> Float[np.ndarray, " F"]:
        """Values of the parameter at the folds."""
        return np.array([s.p for s in self.special if s.kind == "fold"])

    @property
    def branch_points(self) -> Float[np.ndarray, " B"]:
        """Values of the parameter where another branch crosses."""
        return np.array([s.p for s in self.special if s.kind == "branch point"])
