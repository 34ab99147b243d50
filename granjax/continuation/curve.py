"""What continuation returns: a branch and the special points on it."""

from typing import ClassVar, NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Float

from ..printing import told
from ..results import Held, Result


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
    """A branch: `x` (P, n), `p` (P,), unit tangents (P, n + 1), what was found on it, and why it ended.

    `newton`: Jacobians taken in all. `outcome`: a sentence.

    **Example:**

    >>> curve = gx.continuation.continuation(lambda x, p, args: x**2 + p**2 - 1, [1.0], 0.0, arclength=0.1, points=40)
    >>> curve.x.shape, curve.folds.round(4), curve.outcome
    ((40, 1), array([1.]), 'The 40 points that were asked for.')
    """

    held: ClassVar[dict[str, Held]] = {
        "x": Held("point unknown"),
        "p": Held("point"),
        "tangents": Held("point tangent"),
    }
    x: Float[np.ndarray, "P n"]
    p: Float[np.ndarray, " P"]
    tangents: Float[np.ndarray, "P n_and_p"]
    special: tuple[Special, ...]
    newton: int
    outcome: str = eqx.field(static=True)

    @property
    def folds(self) -> Float[np.ndarray, " F"]:
        """Values of the parameter at the folds."""
        return np.array([s.p for s in self.special if s.kind == "fold"])

    @property
    def branch_points(self) -> Float[np.ndarray, " B"]:
        """Values of the parameter where another branch crosses."""
        return np.array([s.p for s in self.special if s.kind == "branch point"])
