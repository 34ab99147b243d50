"""Check the state that a measure is given against the lattice."""

import jax
import jax.numpy as jnp
import numpy as np

from ..base.checks import per_lane, refuse
from ..base.types import Number, StateLike
from ..lattice import Lattice


def parts(lattice: Lattice, y: StateLike, t: Number = 0.0) -> StateLike:
    """Return (u, v) of a `State` or a pair, checked for the lattice's structure and shape."""
    if np.shape(t) not in ((), lattice.lanes):
        per_lane("t", t, lattice.lanes)
    template = lattice.template()
    frames = "For the frames of a run use measures.along(measure, lattice, run)."
    try:
        u, v = y
    except (TypeError, ValueError):
        remedy = frames if hasattr(y, "us") else "gx.states makes them."
        refuse("y", "a State or a pair (u, v)", f"an object of type {type(y).__name__}", remedy)

    def floating(x):
        # Lists and xarray's arrays become NumPy's; JAX's may be traced, and stay.
        x = x if isinstance(x, jax.Array) else np.asarray(x)
        return x if jnp.issubdtype(x.dtype, jnp.inexact) else x.astype(lattice.dtype)

    leaf = lambda x: not isinstance(x, dict)
    u, v = (jax.tree.map(floating, part, is_leaf=leaf) for part in (u, v))
    for name, x in (("u", u), ("v", v)):
        if jax.tree.structure(x) != jax.tree.structure(template):
            got = f"fields {sorted(x)}" if isinstance(x, dict) else "an array"
            refuse(f"y.{name}", _shapes(template), got, "Name the fields as the masses are.")
        got = [leaf.shape for leaf in jax.tree.leaves(x)]
        if got != [leaf.shape for leaf in jax.tree.leaves(template)]:
            refuse(
                f"y.{name}", _shapes(template), f"shape {got[0] if len(got) == 1 else got}", frames
            )
    return u, v


def _shapes(template):
    shapes = jax.tree.map(lambda s: s.shape, template)
    return f"{'fields' if isinstance(template, dict) else 'shape'} {shapes}, as of the lattice"
