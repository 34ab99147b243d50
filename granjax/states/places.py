"""Which field and which site a state speaks of, checked against the lattice."""

import operator
from typing import Any

from ..checks import concrete, one_of, parameter, refuse, show
from ..lattice import Lattice


def field_of(lattice: Lattice, field: str | None) -> str | None:
    """The field's name; `None` for a plain array."""
    if lattice.fields is None:
        if field is not None:
            refuse("field", "None, as the lattice has no named fields", repr(field))
        return None
    if field is None and "bead" in lattice.fields:
        return "bead"
    if field is None:
        names = ", ".join(map(repr, lattice.fields))
        refuse("field", f"one of {names}", "None", "A cell of the lattice holds several.")
    return one_of("field", field, lattice.fields)


def site_of(lattice: Lattice, site: Any, field: str | None) -> tuple[int, ...]:
    """A site's index as a tuple, in range."""
    shape = lattice.sites if field is None else lattice.sites[field]
    index = tuple(site) if isinstance(site, (tuple, list)) else (site,)
    if len(index) != len(shape) or any(not -n <= i < n for i, n in zip(index, shape)):
        ranges = ", ".join(f"{-n} ... {n - 1}" for n in shape)
        refuse(
            "site",
            f"an index for each axis, within {ranges}",
            repr(site),
            "Sites are counted from 0.",
        )
    return tuple(map(operator.index, index))


def chain_only(lattice: Lattice, what: str) -> int:
    """Refuse grids, vectors and named fields, where a state is meant for a plain chain."""
    if lattice.fields is not None or lattice.axes != 1 or lattice.dimension is not None:
        got = f"displacements of shape {lattice.shape}"
        refuse("lattice", f"a chain with one displacement per site, for {what}", got)
    return lattice.shape[0]


def inside(name: str, centre: Any, size: int) -> Any:
    """A place on a chain, from its first site to its last, also between two."""
    centre = parameter(name, centre)
    value = concrete(centre)
    if value is not None and (value.ndim or not 0 <= value <= size - 1):
        refuse(name, f"a place within 0 ... {size - 1}", show(value))
    return centre
