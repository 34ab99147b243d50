"""Fields, sites and centres of states, checked against the lattice."""

import operator
from typing import Any

import jax
import jax.numpy as jnp

from ..base.arrays import trailing
from ..base.checks import is_site, one_of, parameter, per_lane, refuse, require, within
from ..base.types import Parameter
from ..lattice import Lattice, State


def field_of(lattice: Lattice, field: str | None) -> str | None:
    """Return the field's name, `None` for a plain array."""
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
    """Return the checked index of a site as a tuple."""
    shape = lattice.sites if field is None else lattice.sites[field]
    index = tuple(site) if isinstance(site, (tuple, list)) else (site,)
    if not is_site(index, shape):
        ranges = ", ".join(f"{-n} ... {n - 1}" for n in shape)
        refuse(
            "site",
            f"an index for each axis, within {ranges}",
            repr(site),
            "Sites are counted from 0.",
        )
    return tuple(map(operator.index, index))


def chain_only(lattice: Lattice, what: str) -> int:
    """Return the number of sites; refuse a lattice that is no plain chain."""
    if lattice.fields is not None or lattice.axes != 1 or lattice.dimension is not None:
        got = f"displacements of shape {lattice.shape}"
        refuse("lattice", f"a chain with one displacement per site, for {what}", got)
    return lattice.shape[0]


def numbers(lattice: Lattice) -> jax.Array:
    """Return the site numbers of a chain as a column beside the lanes."""
    return column(lattice, jnp.arange(lattice.shape[0], dtype=float))


def column(lattice: Lattice, x: jax.Array) -> jax.Array:
    """Reshape an array along a chain to a column beside the lanes."""
    return trailing(x, 1 + len(lattice.lanes))


def state_of(lattice: Lattice, u: Parameter, v: Parameter = 0.0) -> State:
    """Return the state (u, v) in the lattice's shape and type."""
    zeros = lattice.zeros()
    return State((zeros + u).astype(zeros.dtype), (zeros + v).astype(zeros.dtype))


def crest(lattice: Lattice, centre: Parameter | None, direction: str) -> jax.Array:
    """Return the centre of a wave, by default a quarter of the chain from where it starts."""
    size = lattice.shape[0]
    one_of("direction", direction, ("right", "left"))
    if centre is None:
        centre = (size if direction == "right" else 3 * size) / 4
    on_chain = lambda name, x: within(name, x, 0, size - 1)
    return per_lane("centre", centre, lattice.lanes, on_chain)


def inside(name: str, centre: Any, size: int) -> Any:
    """Return a checked place on a chain, which may lie between two sites."""
    fits = lambda value: value.ndim == 0 and 0 <= value <= size - 1
    return require(name, parameter(name, centre), fits, f"a place within 0 ... {size - 1}")
