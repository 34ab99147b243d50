"""Packings of beads in the plane, in SI, from materials and a radius."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ...base.checks import described, one_of, plain_zero, positive, refuse, traced, whole
from ...base.types import Count, Parameter, Scalar
from ...base.units import SI
from ...continuation.equilibria import equilibrium
from ...lattice import Lattice
from ...laws import Hertz, Linear, Strained
from ...materials import Material, bead_mass, hertz_coefficient, named
from .build import crystal, mindlin
from .cells import HONEYCOMB, KAGOME, SQUARE, TRIANGULAR
from .outline import cut

ARRANGEMENTS = {"hexagonal": TRIANGULAR, "square": SQUARE, "honeycomb": HONEYCOMB, "kagome": KAGOME}


def packing(
    material: str | Material | Sequence[str | Material],
    radius: Parameter | dict[str, Parameter],
    n: Count,
    m: Count | None = None,
    precompression: Scalar = 0.0,
    *,
    pattern: Any = None,
    arrangement: str = "hexagonal",
    rotation: bool = False,
    boundary: str | Sequence[str] = "fixed",
    outline: str | Callable = "cells",
) -> Lattice:
    r"""Build a packing of elastic spheres in the plane, in SI, of one radius or of many.

    Masses are (4/3) pi R^3 rho, and the contacts are Hertz's with A as in `gx.scenes.beads`.
    `precompression` is the force F0 in every contact. If the confining load on a wall is P per
    touching bead, F0 = P in a square packing, and F0 = P/3^{1/2} in a hexagonal one for a wall
    along a row of beads.

    Beads of many radii keep the neighbours and the walls of the regular packing of beads of the
    mean radius. At the places of that packing the beads i and j overlap by
    (F0/A)^{2/3} + R_i + R_j - 2 mean(R), or have a gap where this is negative. The packing is then
    brought to rest, and displacements are measured from there. Steel beads of 5 mm under 20 N
    overlap by 2 um, 4e-4 of R. Where R_i + R_j varies by as much, the forces
    (`gx.measures.contact_force`) are far from F0, and some contacts open.

    **Arguments:**

    - `material`: a name of the table or a `Material`; or several of them with a `pattern`: an array
      (n, m) of whole numbers, the material of each bead (a dict of such where a cell has several
      beads). `np.random.default_rng(0).integers(2, size=(n, m))` is random. Each bead at a wall
      touches a wall like itself. For vacancies use a function as `outline`, and an array of radii:
      else the edge of the hole holds F0.
    - `radius`: R > 0 [m], a number, or an array as `pattern`; `precompression`: F0 >= 0 [N]; `n`,
      `m`, `boundary`, `outline`: as in `gx.scenes.crystal`, without free boundaries for many radii.
    - `arrangement`: `"hexagonal"`, `"square"`, `"honeycomb"`, `"kagome"`.
    - `rotation`: whether the beads, all alike, turn, u = (u_x, u_y, R theta). The contacts then
      have Mindlin's tangential stiffness, 2 (1 - nu)/(2 - nu) of the normal one at F0, lose it when
      they open, and do not slide.

    **Returns:** a `Lattice` in SI with positions.
    **Raises** ValueError for arguments outside these ranges, rotation without a load or with beads
    that differ, and an invalid pattern; RuntimeError where no stable state of rest is found, as
    with beads that too few others touch (in `jit` and `vmap` all numbers are then NaN).
    Source: Leonard, Fraternali, Daraio, Exp. Mech. 53, 327 (2013); Tournat, Perez-Arjona, Merkel,
    Sanchez-Morcillo, Gusev, New J. Phys. 13, 073042 (2011).

    **Example:**

    >>> radii = 5e-3 + 1e-6 * np.random.default_rng(0).uniform(-1, 1, (4, 5))
    >>> beads = gx.scenes.packing("steel 316", radii, 4, 5, precompression=20.0)
    >>> beads.shape, beads.mass.shape
    ((4, 5, 2), (4, 5, 1))
    """
    cell = ARRANGEMENTS[one_of("arrangement", arrangement, ARRANGEMENTS)]
    alone = isinstance(material, (str, Material))
    bodies = [named("material", one) for one in ([material] if alone else material)]
    R = jax.tree.map(lambda x: positive("radius", x, "A radius is in metres."), radius)
    if callable(outline):
        counts = tuple(whole("n, m", x, 1) for x in (n, n if m is None else m))
        R, pattern = (_within(cell, counts, outline, x) for x in (R, pattern))
    uneven = isinstance(R, dict) or np.ndim(R) > 0
    mean = _mean(R) if uneven else R
    if len(bodies) == 1 and pattern is not None:
        refuse("pattern", "None with one material", described(pattern))
    mass = bead_mass(bodies[0], mean)
    law = Hertz(hertz_coefficient(bodies[0], mean), precompression)
    tangential = None
    if rotation:
        if len(bodies) > 1 or uneven:
            refuse("material, radius", "one of each with rotation=True", "several")
        if plain_zero(precompression):
            remedy = "Without static load contacts slide."
            refuse("precompression", "F0 > 0 with rotation=True", "0", remedy)
        tangential = Linear(mindlin(bodies[0].poisson) * law.derivative(0.0 * R))
    if len(bodies) > 1 or uneven:
        same = jax.tree.map(lambda x: np.zeros(np.shape(x), int), R)
        given = pattern if len(bodies) > 1 else same
        if given is None:
            refuse("pattern", "an array that says which bead is of which material", "None")
        which = jax.tree.map(lambda x: _pattern(x, len(bodies)), given)
        R = R if uneven else jax.tree.map(lambda x: jnp.full(x.shape, mean), which)
        mass = jax.tree.map(lambda x, i: _chosen([bead_mass(b, x) for b in bodies], i), R, which)
        law = partial(_between, bodies, R, precompression, which, uneven)
    if uneven and (boundary == "free" or "free" in boundary):
        refuse("boundary", "'fixed' or 'periodic' with many radii", repr(boundary))
    found = crystal(
        cell,
        n,
        m,
        mass=mass,
        law=law,
        spacing=2 * mean,
        rotation=rotation,
        tangential=tangential,
        boundary=boundary,
        outline=outline,
        units=SI,
    )
    return _at_rest(found) if uneven else found


def _within(cell, counts, outline, values):
    # Return those of the values (n, m) that lie within the outline.
    number = cut(cell, counts, outline).number
    one = lambda name, x: x[number[name][1:-1, 1:-1] >= 0] if np.shape(x) == counts else x
    if isinstance(values, dict):
        return {name: one(name, x) for name, x in values.items()}
    return one("a", values)


def _pattern(x, count):
    x = np.asarray(x)
    if x.dtype.kind not in "iu" or x.min() < 0 or x.max() >= count:
        wanted = f"an array of whole numbers from 0 to {count - 1}, one for each bead"
        refuse("pattern", wanted, described(x))
    return x


def _chosen(values, which):
    return jnp.select([which == i for i in range(len(values))], values)


def _mean(radius):
    return jnp.mean(jnp.concatenate([jnp.ravel(x) for x in jax.tree.leaves(radius)]))


def _between(bodies, radius, precompression, which, uneven, pairs):
    tail, head = pairs.joins(which)
    tail, head = np.where(tail < 0, head, tail), np.where(head < 0, tail, head)
    mean = _mean(radius)
    left, right = pairs.ends(radius)
    left, right = jnp.where(left > 0, left, right), jnp.where(right > 0, right, left)
    # a bond between two walls, which never moves
    left, right = (jnp.where(x > 0, x, mean) for x in (left, right))
    rows = [[hertz_coefficient(a, left, b, right) for b in bodies] for a in bodies]
    A = _chosen([_chosen(row, np.maximum(head, 0)) for row in rows], np.maximum(tail, 0))
    if not uneven:
        return Hertz(A, precompression)
    return Strained(Hertz(A), (precompression / A) ** (2 / 3) + left + right - 2 * mean)


def _at_rest(lattice):
    # Return the packing measured from its state of rest.
    found = equilibrium(lattice, hold="nothing", throw=False)
    if traced(found):
        rests = found.found
        if found.stiffness is not None:
            rests = rests & (found.stiffness > found.error)
        kept = lambda x: jnp.where(rests, x, jnp.nan) if eqx.is_inexact_array(x) else x
        # Not the mark of SI, which a lost lane has too.
        parts = lambda packing: (packing.mass, packing.terms, packing.positions)
        return eqx.tree_at(parts, found.lattice, jax.tree.map(kept, parts(found.lattice)))
    if not (found.found and found.verdict == "stable"):
        overlaps = [float(jnp.min(bond.law.strain)) for bond in lattice.terms]
        raise RuntimeError(
            "The beads have no stable state of rest near their places, where overlaps begin at "
            f"{min(overlaps):.3g} m: some are left without neighbours that hold them. Give a larger "
            f"precompression, or radii that differ less. {found.outcome}"
        )
    return found.lattice
