"""What of a term matters to a chain: how far it couples, its walls, its bonds to the next site."""

from typing import Any

import jax
import jax.numpy as jnp

from ..laws import Law
from ..strains import Shift
from .base import Term, within
from .bonds import Bond, Joined
from .long_range import LongRange


def span(term: Term) -> tuple[int, ...] | None:
    """Sites along each axis that the term couples; () for single sites, `None` where that is not known."""
    return _coupling(term).span


def walls(term: Term) -> tuple[str, ...]:
    """The ends of a chain that the term ties to a wall: of "left" and "right"."""
    return _coupling(term).walls


def _coupling(term):
    """The strain map of a term that joins sites, or else the term itself."""
    inner = within(term)
    return inner.strain_map if isinstance(inner, Joined) else inner


def boundary_of(term: Term, field: str | None = None) -> str | None:
    """The boundary of bonds or dashpots from each site of a chain, or of a field, to the next; else `None`."""
    shift = getattr(term, "strain_map", None)
    plain = term.linear_in is not None and getattr(shift, "offset", None) == (1,)
    named = None if field is None else (field, field)
    return shift.boundary[0] if plain and shift.fields == named else None


def next_neighbours(term: Term, field: str | None = None) -> tuple[Law, str] | None:
    """(law, boundary) of bonds from each site of a chain to the next, or `None`; `field`: of a cell of several."""
    if isinstance(term, LongRange):
        single = term.kernel.shape[0] == 1 and term.field == field
        return (term.nearest(), term.boundary) if single else None
    boundary = boundary_of(term, field) if term.linear_in == "law" else None
    return None if boundary is None else (term.law, boundary)


def without_walls(term: Term, lattice: Any, field: str | None = None) -> tuple | None:
    """(the bonds between free ends, law at the left wall, law at the right wall), or `None` where there are none."""
    if term.linear_in != "law" or boundary_of(term, field) != "fixed":
        return None
    axes = 1 + len(lattice.lanes)

    def over(choose):
        """`choose` applied to every parameter that has an axis over the bonds."""
        return jax.tree.map(lambda x: choose(x) if jnp.ndim(x) == axes else x, term.law)

    inner = over(lambda x: x if x.shape[0] == 1 else x[1:-1])
    free = Shift(1, "free", term.strain_map.fields)
    return Bond(free, inner), over(lambda x: x[0]), over(lambda x: x[-1])
