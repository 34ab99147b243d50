"""Bead chains in SI, from materials and radii."""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np

from ..base.checks import one_of, positive, refuse, whole
from ..base.types import Count, Parameter, Scalar
from ..base.units import SI
from ..lattice import Lattice
from ..laws import Hertz
from ..materials import Material, bead_mass, hertz_coefficient, named, stack
from ..strains import BOUNDARIES
from ..terms import Wall
from .chains import chain, stacked


def beads(
    materials: str | Material | Sequence[str | Material],
    radii: Parameter,
    precompression: Parameter = 0.0,
    *,
    cells: Count | None = None,
    wall: str | Material | Sequence[str | Material] | None = None,
    boundary: str = "fixed",
    damping_time: Scalar | None = None,
) -> Lattice:
    r"""Build a chain of elastic spheres in SI: masses (4/3) pi R^3 rho and Hertz contacts.

    m_n u_n'' = F_n - F_{n+1} - m_n u_n'/tau,   F_n = A_n [d0_n + u_{n-1} - u_n]_+^{3/2},
    d0_n = (F0/A_n)^{2/3}, A_n as in `granjax.materials.hertz_coefficient`.

    **Arguments:**

    - `materials`: a name of the table or a `Material`, one or one per bead.
    - `radii` > 0 [m]: one or one per bead; may be traced.
    - `precompression`: static force F0 >= 0 [N], a number, or one per contact, such as under the
      weight of a vertical chain.
    - `cells`: how often the beads above are repeated:
      `beads(["aluminium 6061-T6", "steel 316"], 9.53e-3, 20.0, cells=40)` is a dimer of 80 beads.
    - `boundary`: `"fixed"` (walls at rest), `"free"` (F0 held at the ends) or `"periodic"`.
    - `wall`: material of the walls (elastic half-spaces), `"rigid"`, or a pair (left, right); by
      default that of the end bead.
    - `damping_time`: tau > 0 [s], `None` for no damping. Typical: 0.2 ... 5 ms.

    **Returns:** a `Lattice` in SI: u [m], v [m/s], t [s]. Its `mass` is one number for equal beads.
    `scaled(...)` gives it numbers of order one.
    **Raises** ValueError for arguments outside these ranges, fewer than two beads, unequal lengths,
    or a `wall` without fixed ends.
    Source: Nesterenko, Dynamics of Heterogeneous Materials (2001); Boechler et al., Phys. Rev.
    Lett. 104, 244302 (2010).

    **Example:**

    >>> chain = gx.scenes.beads("steel 316", 9.53e-3, precompression=10.0, cells=20)
    >>> round(1e3 * float(chain.mass), 3)  # g
    29.004
    """
    one_of("boundary", boundary, BOUNDARIES)
    if wall is not None and boundary != "fixed":
        refuse("wall", f"None with boundary={boundary!r}", repr(wall), "Walls stand at fixed ends.")
    bodies, R, cells = _cell(materials, radii, cells)
    sites = R.size * cells
    if sites < 2:
        refuse(
            "cells",
            "at least two beads in all",
            repr(sites),
            "Give cells=N, or one material or radius per bead.",
        )
    mass = bead_mass(bodies, R)
    if R.ndim:
        bodies, R, mass = jax.tree.map(lambda x: jnp.tile(x, cells), (bodies, R, mass))
    law = Hertz(_coefficients(bodies, R, sites, boundary, wall), precompression)
    damping = None
    if damping_time is not None:
        damping = 1 / positive(
            "damping_time", damping_time, "It is in seconds; None is no damping."
        )
    return chain(sites, mass, law, boundary=boundary, damping=damping, units=SI)


def struck(
    materials: str | Material | Sequence[str | Material],
    radii: Parameter,
    striker: tuple[str | Material, Scalar],
    *,
    cells: Count | None = None,
    wall: str | Material | None = None,
    damping_time: Scalar | None = None,
) -> Lattice:
    r"""Build a chain of beads before a wall, in SI, with the striker that hits it as site 0.

    No contact is precompressed, and nothing holds the striker, which may rebound.
    `gx.states.impact(chain, velocity)` starts it at the contact with bead 1.

    **Arguments:** `materials`, `radii` [m], `cells`, `damping_time` [s]: of the chain, as in
    `beads`. `striker`: its material and radius [m]. `wall`: material of the wall behind the last
    bead, as in `beads`; by default that of this bead.

    **Returns:** a `Lattice` in SI of the striker and the beads. **Raises** ValueError as `beads`
    does.
    Source: Daraio, Nesterenko, Herbold, Jin, Phys. Rev. E 72, 016603 (2005).

    **Example:**

    >>> chain = gx.scenes.struck("PTFE", 2.38e-3, ("steel 316", 2.38e-3), cells=20)
    >>> state = gx.states.impact(chain, velocity=0.5)
    >>> chain.sites, state.v[:2].tolist()
    ((21,), [0.5, 0.0])
    """
    material, radius = striker
    _, R, cells = _cell(materials, radii, cells)
    kinds = [materials] * R.size if isinstance(materials, (str, Material)) else [*materials]
    own = positive("striker", radius, "Its radius is in metres, above zero.")
    R = jnp.concatenate([jnp.ravel(own), jnp.tile(jnp.ravel(R), cells)])
    chain = beads([material, *kinds * cells], R, boundary="free", damping_time=damping_time)
    behind = hertz_coefficient(
        kinds[-1], R[-1], kinds[-1] if wall is None else named("wall", wall), jnp.inf
    )
    return Lattice(
        chain.mass, (*chain.terms, Wall(Hertz(behind), "right")), sites=chain.sites, units=SI
    )


def _cell(materials, radii, cells):
    if cells is not None:
        whole("cells", cells, 1, "It is how often the beads are repeated.")
    R = positive("radii", stacked("radii", radii), "A radius is in metres, above zero.")
    if isinstance(materials, (str, Material)):
        bodies = named("materials", materials)
    else:
        bodies = stack(tuple(materials))
    shapes = {x.shape for x in (R, bodies.young, bodies.poisson, bodies.density)} - {()}
    if len(shapes) > 1 or any(len(shape) > 1 or not shape[0] for shape in shapes):
        got = f"{bodies.young.shape[:1] or 'one'} and {R.shape[:1] or 'one'}"
        refuse(
            "radii",
            "as many radii as materials, or one of either",
            got,
            "Repeat a cell with cells=N.",
        )
    shape = shapes.pop() if shapes else ()
    return *jax.tree.map(lambda x: jnp.broadcast_to(x, shape), (bodies, R)), cells or 1


def _coefficients(bodies, R, sites, boundary, wall):
    def beads(n):
        return jax.tree.map(lambda x: x[n] if x.ndim else x, (bodies, R))

    n = np.arange(sites if boundary == "periodic" else sites - 1)
    pairs = hertz_coefficient(*beads(n), *beads((n + 1) % sites))
    if boundary != "fixed":
        return pairs
    walls = (wall, wall) if wall is None or isinstance(wall, (str, Material)) else wall
    left, right = (
        hertz_coefficient(*beads(end), None if w is None else named("wall", w), jnp.inf)
        for end, w in zip((0, -1), walls)
    )
    return jnp.concatenate([left[None], jnp.broadcast_to(pairs, (sites - 1,)), right[None]])
