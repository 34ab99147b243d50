"""Uniform displacements without a restoring force."""

import jax
import numpy as np

from ..base.programs import once
from ..terms.reach import components
from .model import Lattice

# A response below this part of the largest counts as none, and an entry of a combination of moves
# below this as zero.
NOT_RESISTED = 1e-9


@once
def uniform_moves(lattice: Lattice) -> np.ndarray:
    """Return the uniform displacements without cost, columns (n, k) over the raveled displacements.

    k = 1 for a chain with free ends or a ring, 0 with a wall or a site potential; in the plane one
    per free direction. Fields that no term couples move independently. The terms decide this
    without their parameters, so it also works for a traced lattice. They are kept while it lives.
    """
    moves = components(lattice)
    answers = [term.resists(lattice, moves) for term in lattice.terms]
    columns = [np.concatenate([x.ravel() for x in jax.tree.leaves(move)]) for move in moves]
    return np.stack(columns, -1) @ _null_space(
        np.concatenate([np.zeros((1, len(moves))), *answers])
    )


def _null_space(answers):
    # Combinations of columns that vanish, (moves, k). Elimination keeps them simple where possible.
    rows = answers[np.abs(answers).max(1) > 0]
    size = answers.shape[1]
    # The triangular factor of all rows has the same null space.
    rows = rows / np.abs(rows).max(1, keepdims=True)
    rows = np.linalg.qr(np.concatenate([rows, np.zeros((size, size))]), mode="r")
    scale = max(1.0, np.abs(rows).max())
    pivots = []
    for column in range(size):
        done = len(pivots)
        best = done + int(np.argmax(np.abs(rows[done:, column])))
        if abs(rows[best, column]) <= NOT_RESISTED * scale:
            continue
        rows[[done, best]] = rows[[best, done]]
        rows[done] = rows[done] / rows[done, column]
        others = np.arange(size) != done
        rows[others] -= rows[others][:, [column]] * rows[done]
        pivots.append(column)
    free = [column for column in range(size) if column not in pivots]
    null = np.eye(size)[:, free]
    null[pivots] = -rows[: len(pivots)][:, free]
    return np.where(np.abs(null) < NOT_RESISTED, 0, null)
