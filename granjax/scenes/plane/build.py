"""From a cell to a lattice: masses, bonds of every tie, walls, grounding springs."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ...checks import non_negative, one_of, plain_zero, positive, refuse, whole
from ...lattice import Lattice
from ...laws import Law, Linear, Strained
from ...strains import BOUNDARIES, Along, Pairs, Shift, Slip, Stretch
from ...terms import Bond, Grip, OnSite
from ..chains import contact, number
from .cells import Cell
from .outline import cut, positions_of

# inertia of a sphere about its centre, in m R^2
SPHERE = 0.4


def mindlin(poisson: Any) -> Any:
    """Mindlin's k_t/k_n of two bodies of one material: 2 (1 - nu)/(2 - nu)."""
    return 2 * (1 - poisson) / (2 - poisson)


class Motion(NamedTuple):
    """What a site does: components of its displacement, tangential law and inertia of one that turns.

    `rolling`: law of the difference of two turns; `pull`: a law more along the line of centres.
    """

    components: int | None
    tangential: Law | None = None
    inertia: Any = SPHERE
    rolling: Law | None = None
    pull: Law | None = None


def motion_of(
    laws: tuple, out_of_plane: bool, rotation: bool, tangential: Any, inertia: Any
) -> Motion:
    """What the sites do, with Mindlin's tangential stiffness where none is given."""
    if not rotation:
        if tangential is not None:
            refuse(
                "tangential",
                "None without rotation=True",
                repr(tangential),
                "Beads that do not turn do not slip.",
            )
        return Motion(None if out_of_plane else 2)
    if out_of_plane:
        refuse(
            "rotation",
            "False where sites move out of the plane",
            "True",
            "Beads turn in the plane.",
        )
    if isinstance(tangential, Law):
        return Motion(3, tangential, inertia)
    if tangential is None:
        tangential = mindlin(0.3) * laws[0].derivative(jnp.zeros(()))
    return Motion(
        3,
        Linear(
            positive("tangential", tangential, "Without static load contacts slide: give F0 > 0.")
        ),
        inertia,
    )


def built(
    cell: Cell,
    counts: tuple,
    laws: tuple,
    motion: Motion,
    *,
    mass: Any,
    spacing: Any,
    boundary: Any,
    outline: Any,
    on_site: dict | None,
    units: str,
) -> Lattice:
    """A lattice of cells: on a grid where it is a parallelogram of whole cells, else on a graph."""
    spacing = positive("spacing", number("spacing", spacing), "It is the length of a bond.")
    counts = tuple(whole(name, n, 1) for name, n in zip(("n", "m"), counts))
    if isinstance(outline, str) and outline == "cells":
        boundaries = _boundaries(boundary, len(counts))
        sites = {name: counts for name in cell.sites}
        pairs = [
            Shift(tie.offset, boundaries, None if cell.alone else (tie.tail, tie.head))
            for tie in cell.ties
        ]
        positions = positions_of(cell, counts)
    else:
        one_of("boundary", boundary, ("fixed", "free"))
        found = cut(cell, counts, outline)
        sites = {name: (found.count(name),) for name in cell.sites}
        pairs, positions = _graph(cell, found, boundary), found.positions
    masses = _masses(cell, mass, sites, motion)
    terms = []
    for joined, law, vector in zip(pairs, laws, cell.spans()):
        if joined is not None:
            _check_bonds(joined, law, sites, cell.alone)
            terms += _bonds(joined, law, spacing * vector, motion)
    for name, law in (on_site or {}).items():
        terms.append(OnSite(law, None if cell.alone else name))
    positions = {name: spacing * x for name, x in positions.items()}
    masses, positions = (x["a"] if cell.alone else x for x in (masses, positions))
    alike = len(set(sites.values())) == 1
    return Lattice(
        masses,
        tuple(terms),
        sites=next(iter(sites.values())) if alike else None,
        dimension=motion.components,
        positions=positions,
        units=units,
    )


def _check_bonds(pairs, law, sites, alone):
    """Refuse a stiffness over bonds that has another shape than they."""
    template = {name: jax.ShapeDtypeStruct(shape, float) for name, shape in sites.items()}
    wanted = jax.eval_shape(pairs.strain, template["a"] if alone else template).shape
    for x in jax.tree.leaves(law):
        if np.ndim(x) and np.shape(x) != wanted:
            refuse(
                "stiffness", f"one number, or one per bond, shape {wanted}", f"shape {np.shape(x)}"
            )


def _boundaries(boundary, axes):
    given = (boundary,) * axes if isinstance(boundary, str) else tuple(boundary)
    if len(given) != axes:
        refuse("boundary", f"one word, or {axes}, one per axis", repr(boundary))
    return tuple(one_of("boundary", b, BOUNDARIES) for b in given)


def _graph(cell, found, boundary):
    """The pairs of every tie; `None` where no bond of the kind is left."""
    every = []
    for tie in cell.ties:
        tail, head = found.bonds(tie, boundary == "fixed")
        fields = None if cell.alone else (tie.tail, tie.head)
        count = (found.count(tie.tail), found.count(tie.head))
        every.append(Pairs(tail, head, sites=count, fields=fields) if len(tail) else None)
    return every


def _bonds(pairs, law, vector, motion):
    if motion.components is None:
        return [Bond(pairs, law)]
    contact = Bond(Stretch(pairs, vector), law)
    bonds = [contact]
    if motion.tangential is not None:
        bonds.append(Grip(Slip(pairs, vector), motion.tangential, contact))
    if motion.rolling is not None:
        bonds.append(Grip(Along(pairs, (0.0, 0.0, 1.0)), motion.rolling, contact))
    if motion.pull is not None:
        bonds.append(Bond(Stretch(pairs, vector), motion.pull))
    return bonds


def _masses(cell, mass, sites, motion):
    """From name to masses, one for each site, and each component where it turns."""
    given = (
        {name: mass[name] for name in cell.sites}
        if isinstance(mass, dict)
        else dict.fromkeys(cell.sites, mass)
    )
    found, alike = {}, len(set(sites.values())) == 1
    for name, m in given.items():
        m = positive("mass" if m is mass else f"mass[{name!r}]", m, "A bead needs a mass.")
        if m.ndim and m.shape != sites[name]:
            refuse("mass", f"one number, or one per site, shape {sites[name]}", f"shape {m.shape}")
        if not alike or motion.tangential is not None:
            m = jnp.broadcast_to(m, sites[name])
        if motion.tangential is not None:
            m = jnp.stack([m, m, positive("inertia", motion.inertia) * m], -1)
        found[name] = m
    return found


def laws_of(cell: Cell, law: Any, stiffness: Any, exponent: Any, precompression: Any) -> tuple:
    """One law for each tie: as given, or springs or contacts of these numbers."""
    count = len(cell.ties)
    if law is not None:
        laws = (law,) * count if isinstance(law, Law) else tuple(law)
        if len(laws) != count:
            refuse("law", f"a law, or {count}, one per bond of the cell", f"{len(laws)}")
        return laws
    numbers = [
        _each(name, x, count)
        for name, x in (
            ("stiffness", stiffness),
            ("exponent", exponent),
            ("precompression", precompression),
        )
    ]
    return tuple(_law(*x) for x in zip(*numbers))


def _each(name, x, count):
    if not isinstance(x, Sequence) and np.ndim(x) == 0:
        return (x,) * count
    if len(x) != count:
        refuse(name, f"one number, or {count}, one per bond of the cell", f"{len(x)}")
    return tuple(x)


def _law(stiffness, exponent, precompression):
    """A spring that pushes and pulls, or a contact."""
    if not (isinstance(exponent, (int, float)) and exponent == 1):
        return contact(stiffness, exponent, precompression)
    stiffness = positive("stiffness", stiffness, "A bond without stiffness is left out.")
    if plain_zero(precompression):
        return Linear(stiffness)
    return Strained(Linear(stiffness), precompression / stiffness)


def grounded(cell: Cell, laws: tuple, ground: Any, equal: bool, law: Law | None) -> dict:
    """On-site springs by name: `ground`, and more at sites that their bonds hold less, where all are to be equal."""
    held = {name: 0.0 for name in cell.sites}
    for tie, own in zip(cell.ties, laws):
        k = own.derivative(jnp.zeros(()))
        for end in (tie.tail, tie.head):
            held[end] = held[end] + k
    ground, most = (
        non_negative("ground", ground),
        jnp.max(jnp.stack(list(map(jnp.asarray, held.values())))),
    )
    springs = {name: Linear(ground + (most - k if equal else 0)) for name, k in held.items()}
    return {name: spring if law is None else spring + law for name, spring in springs.items()}
