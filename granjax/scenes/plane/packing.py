"""Packings of beads in the plane, in SI, from a material and a radius."""

from collections.abc import Callable, Sequence

from ...checks import one_of, plain_zero, positive, refuse
from ...lattice import Lattice
from ...laws import Hertz, Linear
from ...materials import Material, bead_mass, hertz_coefficient, named
from ...types import Count, Scalar
from ...units import SI
from .build import crystal, mindlin
from .cells import HONEYCOMB, KAGOME, SQUARE, TRIANGULAR

ARRANGEMENTS = {"hexagonal": TRIANGULAR, "square": SQUARE, "honeycomb": HONEYCOMB, "kagome": KAGOME}


def packing(
    material: str | Material,
    radius: Scalar,
    n: Count,
    m: Count | None = None,
    precompression: Scalar = 0.0,
    *,
    arrangement: str = "hexagonal",
    rotation: bool = False,
    boundary: str | Sequence[str] = "fixed",
    outline: str | Callable = "cells",
) -> Lattice:
    r"""Build a packing of equal elastic spheres in the plane, in SI.

    Masses (4/3) pi R^3 rho, Hertz contacts, A as in `gx.scenes.beads`.

    `precompression` is the force F0 in every contact. The confining load on a wall is P per bead that touches it: in a
    square packing F0 = P, in a hexagonal one F0 = P/3^{1/2} on a wall along a row of beads.

    **Arguments:** `material`: a name of the table or a `Material`; `radius` R [m]; `n`, `m`, `boundary`, `outline`:
    as in `gx.scenes.crystal`; `precompression`: F0 >= 0 [N]; `arrangement`: `"hexagonal"`, `"square"`, `"honeycomb"`,
    `"kagome"`. `rotation`: whether beads turn, u = (u_x, u_y, R theta): contacts then have Mindlin's tangential
    stiffness 2 (1 - nu)/(2 - nu) of the normal one at F0, let go of it where they open, and do not slide.

    **Returns:** a `Lattice` in SI with positions. **Raises** ValueError for a radius that is not above zero, F0 < 0,
    rotation without a load. Source: Leonard, Fraternali, Daraio, Exp. Mech. 53, 327 (2013); Tournat, Perez-Arjona,
    Merkel, Sanchez-Morcillo, Gusev, New J. Phys. 13, 073042 (2011).
    """
    cell = ARRANGEMENTS[one_of("arrangement", arrangement, list(ARRANGEMENTS))]
    body, R = named("material", material), positive("radius", radius, "A radius is in metres.")
    law = Hertz(hertz_coefficient(body, R), precompression)
    tangential = None
    if rotation:
        if plain_zero(precompression):
            remedy = "Without static load contacts slide."
            refuse("precompression", "F0 > 0 with rotation=True", "0", remedy)
        tangential = Linear(mindlin(body.poisson) * law.derivative(0.0 * R))
    return crystal(
        cell,
        n,
        m,
        mass=bead_mass(body, R),
        law=law,
        spacing=2 * R,
        rotation=rotation,
        tangential=tangential,
        boundary=boundary,
        outline=outline,
        units=SI,
    )
