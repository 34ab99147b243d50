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
    frames = "For the frames of a run use measures.along(measure, lattice, run)."
    try:
        u, v = y
    except (TypeError, ValueError):
        remedy = frames if hasattr(y, "us") else "gx.states makes them."
        refuse("y", "a State or a pair (u, v)", f"an object of type {type(y).__name__}", remedy)
    wanted = jax.tree.map(np.shape, lattice.template())

    def floating(x):
        # Lists and xarray's arrays become NumPy's; JAX's may be traced, and stay.
        x = x if isinstance(x, jax.Array) else np.asarray(x)
        return x if jnp.issubdtype(x.dtype, jnp.inexact) else x.astype(lattice.dtype)

    def checked(name, x):
        x = jax.tree.map(floating, x, is_leaf=lambda x: not isinstance(x, dict))
        got = jax.tree.map(np.shape, x)
        if got != wanted:
            alike = jax.tree.structure(x) == jax.tree.structure(lattice.template())
            remedy = frames if alike else "Name the fields as the masses are."
            refuse(f"y.{name}", f"shape {wanted}, that of the lattice", f"shape {got}", remedy)
        return x

    return checked("u", u), checked("v", v)
