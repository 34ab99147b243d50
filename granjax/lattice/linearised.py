"""The lattice linearised about a state: the equation of its tangents, many at once in a trailing axis."""

import equinox as eqx
import jax
import jax.numpy as jnp

from ..types import Displacements, Number
from .model import Lattice, check_shape, refuse_memory


def linearised(
    lattice: Lattice, t: Number, u: Displacements, v: Displacements | None = None
) -> Lattice:
    r"""The lattice of small perturbations U about u(t): m U'' = (dF/du) U + (dF/dv) U'.

    A `Lattice` with the same sites and one more lane: its displacements have a trailing axis for the tangents, so
    that one evaluation serves all of them. Bonds, walls and sites become linear springs of the present stiffness
    F'(e); drives are gone; any other term is differentiated by `jax.jvp`.

    **Arguments:** `lattice`, time `t` and displacements `u`; `v`: velocities, where a force reads them other than
    linearly (zero by default).
    """
    refuse_memory(lattice)
    v = jax.tree.map(jnp.zeros_like, u) if v is None else v
    check_shape(lattice, "u", u)
    check_shape(lattice, "v", v)
    terms = [term.linearised(lattice, t, u, v) for term in lattice.terms]
    terms = tuple(term for term in terms if term is not None)
    # a mass has the lane even where it is one number, so that the lattice says how wide it is
    mass = jax.tree.map(lambda m: m[..., None], lattice.mass)
    return eqx.tree_at(lambda x: (x.mass, x.terms), lattice, (mass, terms))
