"""The state that a measure is given, checked against the lattice."""

import jax

from ..checks import refuse
from ..lattice import Lattice
from ..types import Displacements, StateLike


def displacements(lattice: Lattice, y: StateLike) -> Displacements:
    """u of a state."""
    return parts(lattice, y)[0]


def velocities(lattice: Lattice, y: StateLike) -> Displacements:
    """v of a state."""
    return parts(lattice, y)[1]


def parts(lattice: Lattice, y: StateLike) -> StateLike:
    """(u, v) of a `State` or a pair, of the lattice's structure and shape."""
    if not isinstance(y, tuple) or len(y) != 2:
        refuse("y", "a State(u, v)", f"{type(y).__name__}", "Write gx.State(u, v).")
    template = lattice.template()
    for name, x in zip("uv", y):
        if jax.tree.structure(x) != jax.tree.structure(template):
            refuse(f"y.{name}", _shapes(template), f"{jax.tree.structure(x)}", "Name the fields as the masses are.")
        got = [getattr(leaf, "shape", ()) for leaf in jax.tree.leaves(x)]
        if got != [leaf.shape for leaf in jax.tree.leaves(template)]:
            remedy = "For the frames of a run use measures.along(measure, lattice, run)."
            refuse(f"y.{name}", _shapes(template), f"shape {got[0] if len(got) == 1 else got}", remedy)
    return y


def _shapes(template):
    shapes = jax.tree.map(lambda s: s.shape, template)
    return f"{'fields' if isinstance(template, dict) else 'shape'} {shapes}"
