"""What of a term matters to a chain: how far it couples, its walls, its bonds to the next site."""

from typing import Any

import jax
import jax.numpy as jnp

from ..laws import Law
from ..strains import WALL, End, Pairs, Shift
from .base import Term, within
from .bonds import Bond
from .dissipation import CaputoDamping, Damping, Drag
from .long_range import LongRange
from .sites import Drive, OnSite
from .walls import Wall

SINGLE = (OnSite, Damping, Drag, CaputoDamping, Drive, Wall)


def pairs_of(term: Term) -> Any:
    """The strain map of a term that joins sites, of vectors the one that says which; `None` of other terms."""
    strain_map = getattr(within(term), "strain_map", None)
    return getattr(strain_map, "pairs", strain_map)


def span(term: Term) -> tuple[int, ...] | None:
    """Sites along each axis that the term couples; () for single sites, `None` where that is not known."""
    inner = within(term)
    if isinstance(inner, SINGLE):
        return ()
    if isinstance(inner, LongRange):
        return (inner.kernel.shape[0],)
    reaches = getattr(pairs_of(inner), "reaches", None)
    return None if reaches is None else tuple(high - low for low, high in reaches)


def walls(term: Term) -> tuple[str, ...]:
    """The ends of a chain that the term ties to a wall: of "left" and "right"."""
    inner, pairs = within(term), pairs_of(term)
    if isinstance(pairs, End):
        return (pairs.side,)
    if isinstance(inner, LongRange):
        tied = inner.boundary == "fixed"
    elif isinstance(pairs, Pairs):
        tied = WALL in pairs.tail + pairs.head
    else:
        ends = zip(getattr(pairs, "boundary", ()), getattr(pairs, "reaches", ()))
        tied = any(b == "fixed" and high > low for b, (low, high) in ends)
    return ("left", "right") if tied else ()


def boundary_of(term: Term, field: str | None = None) -> str | None:
    """The boundary of bonds or dashpots from each site of a chain, or of a field, to the next; else `None`."""
    shift = getattr(term, "strain_map", None)
    plain = isinstance(shift, Shift) and term._linear_in is not None and shift.offset == (1,)
    named = None if field is None else (field, field)
    return shift.boundary[0] if plain and shift.fields == named else None


def next_neighbours(term: Term, field: str | None = None) -> tuple[Law, str] | None:
    """(law, boundary) of bonds from each site of a chain to the next, or `None`; `field`: of a cell of several."""
    if isinstance(term, LongRange):
        single = term.kernel.shape[0] == 1 and term.field == field
        return (term.nearest(), term.boundary) if single else None
    boundary = boundary_of(term, field) if isinstance(term, Bond) else None
    return None if boundary is None else (term.law, boundary)


def without_walls(term: Term, lattice: Any, field: str | None = None) -> tuple | None:
    """(the bonds between free ends, law at the left wall, law at the right wall), or `None` where there are none."""
    found = next_neighbours(term, field) if isinstance(term, Bond) else None
    if found is None or found[1] != "fixed":
        return None
    axes = 1 + len(lattice.lanes)

    def over(choose):
        """`choose` applied to every parameter that has an axis over the bonds."""
        return jax.tree.map(lambda x: choose(x) if jnp.ndim(x) == axes else x, term.law)

    inner = over(lambda x: x if x.shape[0] == 1 else x[1:-1])
    free = Shift(1, "free", term.strain_map.fields)
    return Bond(free, inner), over(lambda x: x[0]), over(lambda x: x[-1])
