"""The one measure of error: dimensionless, the largest over everything."""

import jax
import numpy as np

from ..checks import refuse


def distance(state, reference):
    r"""Largest error of a state, each of its parts by its own scale.

        error = max over parts x of  max |x - x_ref| / max |x_ref|

    The parts of a `State` or a pair are u and v, so that this is the larger of the relative errors of displacements
    and velocities; both maxima go over all sites, fields, vector components and lanes. A longer tuple has as many
    parts as entries; anything else is one part. A part that is zero throughout the reference counts by itself.

    A part that passes through zero at the final time has a small scale and so a large error: end runs elsewhere.

    **Arguments:** two trees of arrays of equal shapes. **Returns:** a float; NaN where the state is not finite.
    **Raises** ValueError where shapes differ.
    """
    state, reference = _parts(state), _parts(reference)
    shapes = [[x.shape for x in part] for part in state], [[x.shape for x in part] for part in reference]
    if shapes[0] != shapes[1]:
        refuse("reference", f"arrays of the shapes {shapes[0]}, those of the state", f"{shapes[1]}")
    # NumPy's maximum keeps a NaN, Python's own may lose it
    return float(np.max([_relative(x, y) for x, y in zip(state, reference)]))


def _parts(tree):
    parts = tree if isinstance(tree, (tuple, list)) else (tree,)
    return [[np.asarray(x, dtype=float) for x in jax.tree.leaves(part)] for part in parts]


def _relative(part, reference):
    largest = np.max([_largest(x - y) for x, y in zip(part, reference)])
    scale = np.max([_largest(y) for y in reference])
    return largest / scale if scale > 0 else largest


def _largest(x):
    return np.max(np.abs(x), initial=0.0)
