"""Bright and dark breathers of the envelope equation, for chains of next neighbours."""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from ...checks import one_of, refuse
from ...lattice import Lattice, State
from ...laws import taylor
from ...linear import bands
from ...linear.cell import unit_cell
from ...printing import told
from ...theory import nls
from ...types import Scalar
from .dressed import dressed

# relative distance in omega below which a frequency is an edge's
AT_EDGE = 1e-9
NEEDS = "The envelope equation needs a periodic chain of bonds alone, or of equal beads with linear resonators."
NO_CELL = "None or a State (such as guesses.single_site gives) for this lattice"
# distance of an extremum's k from 0 or pi
SAME_K = 1e-6
# of an iteration that contracts by the dips' share of the chain
ROUNDS = 30


class Edge(NamedTuple):
    """An edge of a band: its place, the envelope's coefficients there, and whether its bright breathers lie at omega.

    `above`: whether the gap lies above the edge.
    """

    k: float
    branch: int
    omega: float
    above: bool
    coefficients: nls.Coefficients
    __repr__ = told


def cell_of(lattice: Lattice) -> tuple | None:
    """(mass, K2, K3, K4) of the unit cell of a chain of next neighbours, (P,) each, or `None` where it is none."""
    found = lattice.terms[0].next_neighbours() if len(lattice.terms) == 1 else None
    if found is None or lattice.fields or lattice.axes != 1 or lattice.dimension:
        return None
    law, boundary = found
    try:
        (size,) = unit_cell(lattice).cell
    except ValueError:
        return None
    coefficients = taylor(law)
    if not np.all(np.asarray(coefficients.K2) > 0):
        return None
    (sites,) = lattice.sites
    left = 1 if boundary == "fixed" else 0
    mass = np.broadcast_to(np.asarray(lattice.mass), (sites,))[:size]
    parts = [
        np.asarray(x) if np.ndim(x) == 0 else np.asarray(x)[left : left + size]
        for x in coefficients
    ]
    return mass, *(np.broadcast_to(x, (size,)) for x in parts)


def edges_beside(lattice: Lattice, omega: Scalar) -> list[Edge]:
    """The edges of the gap that holds omega, as `Edge`s; none inside a band or where there is no unit cell."""
    cell, chain = cell_of(lattice), dressed(lattice)
    if cell is None and chain is None:
        return []
    found = bands(lattice)
    lower, upper = np.asarray(found.lower), np.asarray(found.upper)
    if np.any((lower * (1 + AT_EDGE) < omega) & (omega < upper * (1 - AT_EDGE))):
        return []
    if chain is not None:  # at k = 0, the lower edges, no bond is strained
        below = np.flatnonzero((0 < chain.tops) & (chain.tops <= omega))[-1:]
        return [
            Edge(np.pi, int(b), float(chain.tops[b]), True, chain.coefficients(int(b)))
            for b in below
        ]
    edges = [
        (k, b, w, True)
        for b, (k, w) in enumerate(zip(np.ravel(found.upper_k), upper))
        if w <= omega
    ]
    edges = (
        edges[-1:]
        + [
            (k, b, w, False)
            for b, (k, w) in enumerate(zip(np.ravel(found.lower_k), lower))
            if w >= omega > 0
        ][:1]
    )
    edges = [(_at_symmetry(k), b, float(w), above) for k, b, w, above in edges]
    return [Edge(k, b, w, above, nls.coefficients(*cell, k, b)) for k, b, w, above in edges]


def _at_symmetry(k):
    """0 or pi itself where an extremum, known to the root of rounding, lies there."""
    near = np.pi * round(float(k) / np.pi)
    return near if abs(k - near) < SAME_K else float(k)


def supports_bright(edge: Edge) -> bool:
    """Whether a bright breather leaves this edge into the gap: focusing, and its frequency shifts that way."""
    c = edge.coefficients
    return bool(c.focusing) and (float(c.nu3_force) > 0) == edge.above


def edge_of(lattice: Lattice, omega: Scalar, kind: str) -> Scalar:
    """Frequency of the edge from which the bright or dark breathers at omega come."""
    if one_of("kind", kind, ("bright", "dark")) == "dark":
        upper = np.asarray(bands(lattice).upper)
        return float(upper[np.argmin(np.abs(upper - omega))])
    found = [edge.omega for edge in edges_beside(lattice, omega) if supports_bright(edge)]
    return min(found, key=lambda edge: abs(edge - omega)) if found else omega


def bright_guess(lattice: Lattice, omega: Scalar, centre: Scalar | None = None) -> State:
    """The envelope's bright breather of a chain at a frequency in a gap, `State` at rest.

    **Raises** ValueError where no edge of that gap has one.
    """
    if cell_of(lattice) is None and dressed(lattice) is None:
        refuse("guess", NO_CELL, "'bright'", NEEDS)
    found = [edge for edge in edges_beside(lattice, omega) if supports_bright(edge)]
    if not found:
        refuse_bright(lattice, omega)
    edge = min(found, key=lambda edge: abs(edge.omega - omega))
    return _state(lattice, nls.bright_profile, edge.coefficients, omega, centre)


def dark_guess(lattice: Lattice, omega: Scalar, centre: Scalar | None = None) -> State:
    """The envelope's dark breather below the highest edge of a band, `State` at rest, N bonds wide.

    Ends at constant force (free) or at fixed length (walls, a ring) as the chain has them. **Raises** ValueError where
    the edge above omega has no dark breathers, and for a lattice that is no periodic chain of next neighbours.
    """
    cell, chain = cell_of(lattice), dressed(lattice)
    if cell is None and chain is None:
        refuse("guess", NO_CELL, "'dark'", NEEDS)
    found = bands(lattice)
    tops = [
        (b, float(w), float(k))
        for b, (w, k) in enumerate(zip(found.upper, np.ravel(found.upper_k)))
    ]
    branch, _, k = min(tops, key=lambda top: abs(top[1] - omega))
    k = _at_symmetry(k)
    boundary = lattice.terms[0].next_neighbours()[1] if chain is None else chain.boundary
    constraint = "force" if boundary == "free" else "length"
    if chain is None:
        coefficients = nls.coefficients(*cell, k, branch, constraint)
    else:
        coefficients = chain.coefficients(branch, constraint)
    if constraint == "length":
        coefficients = _held(coefficients, omega, _size(lattice) / len(coefficients.mode))
    return _state(lattice, nls.dark_profile, coefficients, omega, centre)


def _held(c, omega, cells):
    """Coefficients of a background in a chain of fixed length that is not infinite.

    The mean of |Y|^2 over the chain, which sets its mean strain, lacks the dip and a second one, at the walls or where
    a ring closes: r = 1 - 4/(inverse width * cells) of the background's.
    """
    r, kappa = 1.0, omega - c.omega
    effective = lambda r: c.nu3_force + r * (c.nu3 - c.nu3_force)
    for _ in range(ROUNDS):
        width = jnp.sqrt(jnp.abs(c.nu3_force * kappa / (2 * c.nu2 * effective(r))))
        r = jnp.maximum(1 - 4 / (width * cells), 0.0)
    strain = c.mean_strain_force + r * (c.mean_strain - c.mean_strain_force)
    return eqx.tree_at(lambda c: (c.nu3, c.mean_strain), c, (effective(r), strain))


def _state(lattice, profile, coefficients, omega, centre):
    sites, chain = _size(lattice), dressed(lattice)
    cells = -(-sites // len(coefficients.mode))
    centre = (sites - 1) / 2 if centre is None else centre
    found = profile(coefficients, omega, cells, centre)
    if chain is not None:
        return chain.state(found)
    u = found.displacement[:sites]
    return State(u, jnp.zeros_like(u))


def _size(lattice):
    """Sites of the chain."""
    return next(iter(lattice.sites.values()))[0] if lattice.fields else lattice.sites[0]


def refuse_bright(lattice: Lattice, omega: Scalar) -> None:
    """Say why a chain has no bright breather at a frequency."""
    edges = edges_beside(lattice, omega)
    said = []
    for edge in edges:
        c = edge.coefficients
        name = "B" if len(c.mode) == 1 else "nu3"
        nu2, nu3 = float(c.nu2), float(c.nu3_force)
        relation = "<" if nu3 < 0 else ">"
        what = f"{name} = {nu3:.6g} {relation} 0 with nu2 = {nu2:.6g} at omega = {edge.omega:.6g}"
        said.append(
            f"{what}: only dark"
            if not c.focusing
            else f"{what}: bright, but on the other side of the edge"
        )
    remedy = "; ".join(said) + "." if said else "No gap holds this frequency."
    refuse("omega", "a frequency at which the lattice has bright breathers", f"{omega:.6g}", remedy)
