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
    # Combinations of columns that vanish, (moves, k). Each has the entry 1 for a move of its own,
    # which keeps them simple where possible.
    import scipy.linalg

    largest = np.abs(answers).max(1, keepdims=True)
    rows = answers / np.where(largest > 0, largest, 1)
    factor, order = scipy.linalg.qr(rows, mode="r", pivoting=True)
    scale = max(1.0, np.abs(factor).max())
    rank = int((np.abs(np.diag(factor)) > NOT_RESISTED * scale).sum())
    null = np.eye(len(order))[:, order[rank:]]
    null[order[:rank]] = -np.linalg.solve(factor[:rank, :rank], factor[:rank, rank:])
    return np.where(np.abs(null) < NOT_RESISTED, 0, null)
