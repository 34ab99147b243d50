"""Dampings with a memory, as the dampings that they are for waves of a given frequency."""

from typing import Any

import equinox as eqx
import jax
from jax import Array

from ..lattice import Lattice
from ..terms import CaputoDamping, Term
from ..terms.reach import reads


class _Viscous(Term):
    """Damping of each site: force -c v."""

    coefficient: Array
    field: str | None = eqx.field(static=True)

    def force(self, t, u, v, mass):
        own = v if self.field is None else {self.field: v[self.field]}
        return jax.tree.map(lambda v: -self.coefficient * v, own)


def without_memory(lattice: Lattice) -> tuple[Lattice, list[tuple[Any, Lattice]]]:
    """Return the lattice without `CaputoDamping`, and the orders and forces of these.

    Each comes as (order, lattice whose only damping is the force -c v). For a motion
    exp(-i omega t) its force is -c (-i omega)^order u.
    """
    past = [term for term in lattice.terms if isinstance(term, CaputoDamping)]
    rest = tuple(term for term in lattice.terms if not isinstance(term, CaputoDamping))
    with_terms = lambda terms: eqx.tree_at(lambda x: x.terms, lattice, tuple(terms))
    plain = with_terms(rest)
    still = [term for term in rest if not reads(term, plain).velocity]
    return plain, [
        (term.order, with_terms([*still, _Viscous(term.coefficient, term.field)])) for term in past
    ]
