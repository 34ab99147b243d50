"""Properties of a term on a chain: coupling range, walls, bonds to the next site."""

from typing import Any

import jax
import jax.numpy as jnp

from ..laws import Law
from ..strains import Shift
from .base import Term, within
from .bonds import Bond, Joined
from .long_range import LongRange


def span(term: Term) -> tuple[int, ...] | None:
    """Return the coupling range along each axis: () for single sites, `None` if unknown."""
    return _coupling(term).span


def walls(term: Term) -> tuple[str, ...]:
    """Return the ends of a chain that the term ties to a wall: "left", "right"."""
    return _coupling(term).walls


def _coupling(term):
    inner = within(term)
    return inner.strain_map if isinstance(inner, Joined) else inner


def boundary_of(term: Term, field: str | None = None) -> str | None:
    """Return the boundary of bonds or dashpots to the next site of a chain or field, or `None`."""
    if isinstance(term, LongRange):
        return term.boundary if term.kernel.shape[0] == 1 and term.field == field else None
    shift = getattr(term, "strain_map", None)
    plain = getattr(shift, "offset", None) == (1,)
    named = None if field is None else (field, field)
    return shift.boundary[0] if plain and shift.fields == named else None


def next_neighbours(term: Term, field: str | None = None) -> tuple[Law, str] | None:
    """Return (law, boundary) of bonds to the next site of a chain or field, or `None`."""
    boundary = boundary_of(term, field)
    if boundary is None:
        return None
    if isinstance(term, LongRange):
        return term.nearest(), boundary
    return (term.law, boundary) if term.linear_in == "law" else None


def without_walls(term: Term, lattice: Any, field: str | None = None) -> tuple | None:
    """Return (bonds between free ends, law at the left wall, law at the right wall), or `None`."""
    if term.linear_in != "law" or boundary_of(term, field) != "fixed":
        return None
    axes = 1 + len(lattice.lanes)

    def over(choose):
        return jax.tree.map(lambda x: choose(x) if jnp.ndim(x) == axes else x, term.law)

    inner = over(lambda x: x if x.shape[0] == 1 else x[1:-1])
    free = Shift(1, "free", term.strain_map.fields)
    return Bond(free, inner), over(lambda x: x[0]), over(lambda x: x[-1])
