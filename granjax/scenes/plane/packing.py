"""Packings of beads in the plane, in SI, from a material and a radius."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ...checks import described, one_of, plain_zero, positive, refuse
from ...lattice import Lattice
from ...laws import Hertz, Linear
from ...materials import Material, bead_mass, hertz_coefficient, named
from ...types import Count, Scalar
from ...units import SI
from .build import crystal, mindlin
from .cells import HONEYCOMB, KAGOME, SQUARE, TRIANGULAR

ARRANGEMENTS = {"hexagonal": TRIANGULAR, "square": SQUARE, "honeycomb": HONEYCOMB, "kagome": KAGOME}


def packing(
    material: str | Material | Sequence[str | Material],
    radius: Scalar,
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
    r"""Build a packing of elastic spheres of one radius in the plane, in SI, of one material or of several.

    Masses (4/3) pi R^3 rho, Hertz contacts, A as in `gx.scenes.beads`.

    `precompression` is the force F0 in every contact. The confining load on a wall is P per bead that touches it: in a
    square packing F0 = P, in a hexagonal one F0 = P/3^{1/2} on a wall along a row of beads.

    **Arguments:**

    - `material`: a name of the table or a `Material`; or several of them, with a `pattern`: an array (n, m) of whole
      numbers that says which bead is of which (a dict of such where a cell has several beads). An ordered one makes a
      crystal of two materials, `np.random.default_rng(0).integers(2, size=(n, m))` a random packing. What is next to a
      wall touches one of its own material. Vacancies: `outline`, a function of the places.
    - `radius` R [m]; `precompression`: F0 >= 0 [N]; `n`, `m`, `boundary`, `outline`: as in `gx.scenes.crystal`.
    - `arrangement`: `"hexagonal"`, `"square"`, `"honeycomb"`, `"kagome"`.
    - `rotation`: whether beads, of one material, turn, u = (u_x, u_y, R theta): contacts then have Mindlin's tangential
      stiffness 2 (1 - nu)/(2 - nu) of the normal one at F0, let go of it where they open, and do not slide.

    **Returns:** a `Lattice` in SI with positions. **Raises** ValueError for a radius that is not above zero, F0 < 0,
    rotation without a load or with several materials, and a pattern that is not of whole numbers of materials.
    Source: Leonard, Fraternali, Daraio, Exp. Mech. 53, 327 (2013); Tournat, Perez-Arjona, Merkel, Sanchez-Morcillo,
    Gusev, New J. Phys. 13, 073042 (2011).
    """
    cell = ARRANGEMENTS[one_of("arrangement", arrangement, list(ARRANGEMENTS))]
    alone = isinstance(material, (str, Material))
    bodies = [named("material", one) for one in ([material] if alone else material)]
    body, R = bodies[0], positive("radius", radius, "A radius is in metres.")
    mass, law = bead_mass(body, R), Hertz(hertz_coefficient(body, R), precompression)
    if len(bodies) == 1 and pattern is not None:
        refuse("pattern", "None with one material", described(pattern))
    if len(bodies) > 1:
        given = np.asarray(-1) if pattern is None else pattern
        which = jax.tree.map(lambda x: _pattern(x, len(bodies)), given)
        mass = jax.tree.map(lambda x: jnp.stack([bead_mass(b, R) for b in bodies])[x], which)
        law = partial(_between, bodies, R, precompression, which)
    tangential = None
    if rotation:
        if len(bodies) > 1:
            refuse("material", "one with rotation=True", f"{len(bodies)}")
        if plain_zero(precompression):
            remedy = "Without static load contacts slide."
            refuse("precompression", "F0 > 0 with rotation=True", "0", remedy)
        tangential = Linear(mindlin(body.poisson) * law.derivative(0.0 * R))
    return crystal(
        cell,
        n,
        m,
        mass=mass,
        law=law,
        spacing=2 * R,
        rotation=rotation,
        tangential=tangential,
        boundary=boundary,
        outline=outline,
        units=SI,
    )


def _pattern(x, count):
    """Which bead is of which material, checked."""
    x = np.asarray(x)
    if x.dtype.kind not in "iu" or x.min() < 0 or x.max() >= count:
        wanted = f"an array of whole numbers from 0 to {count - 1}, one for each bead"
        refuse("pattern", wanted, described(x))
    return x


def _between(bodies, radius, precompression, which, pairs):
    """The contacts of the beads that pairs join; what touches a wall touches one of its own material."""
    tail, head = pairs.joins(which)
    tail, head = np.where(tail < 0, head, tail), np.where(head < 0, tail, head)
    coefficients = [[hertz_coefficient(a, radius, b, radius) for b in bodies] for a in bodies]
    return Hertz(jnp.asarray(coefficients)[tail, head], precompression)
