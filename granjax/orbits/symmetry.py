"""Symmetries of orbits, and uniform displacements that a lattice does not resist."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Float

from ..checks import whole
from ..flow.dispatch import facts
from ..lattice import Lattice
from ..types import Count, Numbers, Pytree, StateLike

NOT_RESISTED = 1e-9


class Symmetry(eqx.Module):
    r"""S of y(t0 + T) = S y(t0): displacements moved by some cells, reflected, with a sign; velocities alike.

    (S u)_n = sign u_{n - cells}, and with `mirror` first u_n -> -u_{N-1-n}: displacements along a chain turn around
    with it, so that compressions are reflected. `cells` counts places along the first axis of every field.

    `Translation(1)`, `Mirror()` and `Sign()` make one, and `a @ b` is b, then a.
    """

    cells: int = eqx.field(static=True, default=0)
    mirror: bool = eqx.field(static=True, default=False)
    sign: int = eqx.field(static=True, default=1)

    def __repr__(self) -> str:
        parts = {
            "Sign()": self.sign < 0,
            f"Translation({self.cells})": self.cells,
            "Mirror()": self.mirror,
        }
        return " @ ".join(name for name, there in parts.items() if there) or "the identity"

    @property
    def trivial(self) -> bool:
        """Whether it is the identity."""
        return self == Symmetry()

    def matrix(self, like: StateLike) -> Float[np.ndarray, "two_n two_n"]:
        """S over the raveled state, (2n, 2n); S^-1 is its transpose."""
        flat, unravel = ravel_pytree(like)
        return np.asarray(
            jax.vmap(lambda x: ravel_pytree(self(unravel(x)))[0], 1, 1)(jnp.eye(flat.size))
        )

    def __matmul__(self, other: "Symmetry") -> "Symmetry":
        turned = -other.cells if self.mirror else other.cells
        return Symmetry(self.cells + turned, self.mirror != other.mirror, self.sign * other.sign)

    def __call__(self, y: Pytree) -> Pytree:
        """S of displacements, or of a state."""

        def one(x):
            x = -x[::-1] if self.mirror else x
            return self.sign * (jnp.roll(x, self.cells, 0) if self.cells else x)

        return y if self.trivial else jax.tree.map(one, y)


def Translation(cells: Count = 1) -> Symmetry:
    """The wave reappears `cells` further on after a period: a rotating wave of a ring, or one that travels.

    **Example:**

    >>> gx.orbits.Translation(1)(jnp.array([1.0, 2.0, 3.0])).tolist()
    [3.0, 1.0, 2.0]
    """
    return Symmetry(cells=whole("cells", cells, -(2**31)))


def Mirror() -> Symmetry:
    """The motion is its own mirror image half of its full period later.

    **Example:**

    >>> gx.orbits.Mirror()(jnp.array([1.0, 2.0, 3.0])).tolist()
    [-3.0, -2.0, -1.0]
    """
    return Symmetry(mirror=True)


def Sign() -> Symmetry:
    """The motion is its own negative half of its full period later, in lattices of odd forces."""
    return Symmetry(sign=-1)


def shifts(lattice: Lattice) -> Float[jax.Array, "n k"]:
    """Uniform displacements that cost nothing, as columns (n, k) over the raveled displacements.

    k = 1 for a chain with free ends or a ring, 0 with a wall or a site potential; in the plane one a free direction.
    Fields that no term joins move each for themselves. Asked of the terms, whatever their parameters, so that a traced
    lattice has them too.
    """
    known = facts(lattice).known
    if "shifts" not in known:
        known["shifts"] = _shifts(lattice)
    return jnp.asarray(known["shifts"], lattice.dtype)


def _shifts(lattice):
    moves = _uniform(lattice)
    answers = np.concatenate(
        [np.zeros((1, len(moves)))] + [term.resists(lattice, moves) for term in lattice.terms]
    )
    columns = np.stack(
        [np.concatenate([np.ravel(x) for x in jax.tree.leaves(move)]) for move in moves], -1
    )
    return columns @ _null_space(answers)


def free_moves(lattice: Lattice, symmetry: Symmetry) -> Numbers:
    """Uniform displacements that cost nothing and that S leaves alone, as columns (n, k)."""
    moves = shifts(lattice)
    return moves if symmetry.sign * (-1 if symmetry.mirror else 1) > 0 else moves[:, :0]


def _uniform(lattice):
    """The displacement of one component of one field, for each."""
    zeros = jax.tree.map(lambda s: np.zeros(s.shape, s.dtype), lattice.template())
    moves = []
    for i in range(lattice.dimension or 1):
        # the vector axis lies before the lanes
        place = (..., i) + (slice(None),) * len(lattice.lanes) if lattice.dimension else ...
        for name in zeros if isinstance(zeros, dict) else (None,):
            move = jax.tree.map(np.copy, zeros)
            (move if name is None else move[name])[place] = 1
            moves.append(move)
    return moves


def _null_space(answers):
    """Combinations of columns that vanish, (moves, k), by elimination, so that they are plain where they can be."""
    rows = answers[np.abs(answers).max(1) > 0]
    size = answers.shape[1]
    if len(rows):
        # all rows of unlike size say the same as their triangular factor
        rows = np.linalg.qr(rows / np.abs(rows).max(1, keepdims=True), mode="r")
    rows, pivots = rows.copy(), []
    for column in range(size):
        below = np.abs(rows[len(pivots) :, column]) if len(rows) > len(pivots) else np.zeros(0)
        if not below.size or below.max() <= NOT_RESISTED * max(1.0, np.abs(rows).max()):
            continue
        best = len(pivots) + int(np.argmax(below))
        rows[[len(pivots), best]] = rows[[best, len(pivots)]]
        pivot = rows[len(pivots)] / rows[len(pivots), column]
        rows = rows - rows[:, [column]] * pivot
        rows[len(pivots)] = pivot
        pivots.append(column)
    free = [column for column in range(size) if column not in pivots]
    null = np.zeros((size, len(free)))
    for k, column in enumerate(free):
        null[column, k] = 1
        for row, pivot in enumerate(pivots):
            null[pivot, k] = -rows[row, column]
    null[np.abs(null) < NOT_RESISTED] = 0
    return null
