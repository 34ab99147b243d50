"""Uniform displacements that a lattice does not resist."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ..lattice import Lattice

NOT_RESISTED = 1e-9


def shifts(lattice: Lattice) -> Float[jax.Array, "n k"]:
    """Uniform displacements that cost nothing, as columns (n, k) over the raveled displacements.

    k = 1 for a chain with free ends or a ring, 0 with a wall or a site potential; in the plane one a free direction.
    Fields that no term joins move each for themselves. Asked of the terms, whatever their parameters, so that a traced
    lattice has them too.
    """
    moves = _uniform(lattice)
    answers = np.concatenate([np.zeros((1, len(moves)))] + [term.resists(lattice, moves) for term in lattice.terms])
    columns = np.stack([np.concatenate([np.ravel(x) for x in jax.tree.leaves(move)]) for move in moves], -1)
    return jnp.asarray(columns @ _null_space(answers), lattice.dtype)


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
