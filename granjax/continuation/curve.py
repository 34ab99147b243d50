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

    **Example:**

    >>> curve = gx.continuation.continuation(lambda x, p, args: x**2 + p - 1, [1.0], 0.0, until=(-1.0, 2.0))
    >>> fold, = curve.special
    >>> fold.kind, round(fold.p, 4), abs(float(fold.x[0])) < 1e-6
    ('fold', 1.0, True)
    """

    kind: str
    x: Float[np.ndarray, " n"]
    p: float
    after: int
    directions: Float[np.ndarray, "branches n_and_p"]
    __repr__ = told


class Curve(Result):
    """A branch, what was found on it, and why it ended.

    **Example:**

    >>> curve = gx.continuation.continuation(lambda x, p, args: x**2 + p**2 - 1, [1.0], 0.0, arclength=0.1, points=40)
    >>> curve.x.shape, curve.folds.round(4), curve.outcome
    ((40, 1), array([1.]), 'The 40 points that were asked for.')
    """

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
