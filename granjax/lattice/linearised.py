"""The lattice linearised about a state, for many tangents in a trailing axis."""

import equinox as eqx
import jax
import jax.numpy as jnp

from ..base.types import Displacements, Number
from .model import Lattice, check_shape, refuse_memory


def linearised(
    lattice: Lattice, t: Number, u: Displacements, v: Displacements | None = None
) -> Lattice:
    r"""Return the lattice of small perturbations U about u(t): m U'' = (dF/du) U + (dF/dv) U'.

    It is a `Lattice` with the same sites and one more lane: its displacements have a trailing axis
    for the tangents, so that one evaluation serves all. Bonds, walls and on-site terms become
    linear springs of the present stiffness F'(e); drives vanish; `jax.jvp` differentiates other
    terms.

    **Arguments:** `lattice`, time `t` and displacements `u`; `v`: velocities, where a force depends
    on them nonlinearly (zero by default).
    """
    refuse_memory(lattice)
    v = jax.tree.map(jnp.zeros_like, u) if v is None else v
    check_shape(lattice, "u", u)
    check_shape(lattice, "v", v)
    terms = [term.linearised(lattice, t, u, v) for term in lattice.terms]
    terms = tuple(term for term in terms if term is not None)
    # Even a single mass has the lane, so that the lattice knows the number of lanes.
    mass = jax.tree.map(lambda m: m[..., None], lattice.mass)
    return eqx.tree_at(lambda x: (x.mass, x.terms), lattice, (mass, terms))
