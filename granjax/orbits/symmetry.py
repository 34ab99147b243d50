"""Uniform displacements that a lattice does not resist."""

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

from ..terms import Bond, Damping, Dashpot, Drag, Drive, Modulated, ViscousContact


def shifts(lattice):
    """Uniform displacements that cost nothing, as columns (n, k) over the raveled displacements.

    k = 1 for a chain with free ends or a ring, 0 with a wall or a site potential; in the plane one a free direction.
    Read off the terms, whatever their parameters, so that a traced lattice has them too.
    """
    shapes = lattice.template()
    found = []
    with jax.ensure_compile_time_eval():
        for i in range(lattice.dimension or 1):
            one = jax.tree.map(lambda s: _uniform(s.shape, lattice, i), shapes)
            if all(_is_free(getattr(term, "term", term), one) for term in lattice.terms):
                found.append(np.asarray(ravel_pytree(one)[0]))
    size = sum(s.size for s in jax.tree.leaves(shapes))
    dtype = lattice.dtype
    return jnp.asarray(np.stack(found, -1), dtype) if found else jnp.zeros((size, 0), dtype)


def _uniform(shape, lattice, i):
    one = np.zeros(shape)
    one[(..., i) if lattice.dimension else ...] = 1
    return one


def _is_free(term, one):
    if not isinstance(term, (Bond, Dashpot, ViscousContact)):
        return isinstance(term, (Damping, Drag, Drive, Modulated))
    pairs = getattr(term.strain_map, "pairs", term.strain_map)
    return not np.any(np.asarray(jax.jit(pairs.strain)(one)))
