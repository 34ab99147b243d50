"""Lattices of the plane by name: square, triangular, honeycomb, kagome, Lieb; a hexagon of beads."""

from collections.abc import Callable, Sequence

from ...checks import positive, whole
from ...lattice import Lattice
from ...laws import Law, Linear
from ...types import Count, Parameter, Scalar
from ...units import SCALED
from .build import SPHERE, Motion, built, grounded, laws_of, motion_of
from .cells import HONEYCOMB, KAGOME, LIEB, QUADRUPOLE, SQUARE, TRIANGULAR


def square(
    n: Count,
    m: Count | None = None,
    *,
    mass: Parameter = 1.0,
    stiffness: Parameter | Sequence[Parameter] = 1.0,
    exponent: Parameter = 1.0,
    precompression: Parameter = 0.0,
    law: Law | Sequence[Law] | None = None,
    spacing: Scalar = 1.0,
    boundary: str | Sequence[str] = "fixed",
    outline: str | Callable = "cells",
    out_of_plane: bool = False,
    rotation: bool = False,
    tangential: Scalar | Law | None = None,
    inertia: Scalar = SPHERE,
    ground: Scalar | None = None,
    on_site: Law | None = None,
    units: str = SCALED,
) -> Lattice:
    r"""Square lattice: each site is bound to its 4 neighbours, of which bonds are distances in the plane.

    m u'' = sum over neighbours j of [F(|R| - |R + u_j - u|) times the bond's direction], as `gx.Stretch` has it. Of
    springs K with the force F0 in each at rest, f = F0/|R|, the two bands for a wave along x are
    omega^2 = 2 (K/m) (1 - cos k) and -2 (f/m) (1 - cos k): a square does not resist shear, and a force that presses
    its bonds together makes it unstable; one that pulls, or `rotation`, holds it.

    **Arguments:**

    - `n`, `m`: cells along the two axes, `None` for as many; n in all is the number of rows of beads.
    - `mass`: a number, which stays one in the lattice's `mass` (`gx.lattice.spread_mass`), or an array (n, m).
    - `stiffness`: K, `precompression`: F0 of each bond, of either sign, numbers or one for each of the cell's bonds
      (of `stiffness` each a number, or an array over all bonds of its kind).
      `exponent`: 1 for springs, which push and pull; another one for contacts A [d0 + e]_+^p, such as 3/2, whose
      `stiffness` is A. `law`: a law in their place, or one for each bond of the cell.
    - `spacing`: |R|, the length of a bond, twice the radius of a bead.
    - `boundary`: `"fixed"` (beads at rest all around), `"free"` (what presses the bonds at rest is held on the sites at
      the edge), `"periodic"`; or one for each axis: ("periodic", "free") is a strip, ("periodic", "periodic") a ring.
    - `outline`: `"cells"`, a parallelogram of n x m cells, on a grid; or a graph, u of shape (sites, 2): `"rectangle"`
      (m rows of n cells), `"hexagon"` (n rings of cells around one), a function of positions (..., 2) in bond lengths
      that says which sites of the parallelogram are there. A graph has no bands. A hole in it is empty whatever the
      `boundary`, which is that of the outer rim: what presses the bonds at rest is held on the sites around the hole.
    - `out_of_plane`: one displacement for each site, normal to the plane, u of shape (n, m); bonds then act on
      differences, e = u_i - u_j.
    - `rotation`: u of shape (n, m, 3): (u_x, u_y, R theta) with R = |R|/2, theta anticlockwise. The contacts then have
      a tangential spring `tangential`, k_t or a law of the slip (`gx.strains.Slip`), `None` for Mindlin's 0.82 K2 of
      nu = 0.3; `inertia`: that of a bead in m R^2, 2/5 for a sphere, 1/2 for a disk. A contact that opens lets go of
      it (`gx.terms.Grip`); that none slides is the user's to see (`gx.measures.slip_ratio`).
    - `ground`: an on-site spring on every component of u of every site, `None` for none; `on_site`: a law more there,
      such as `gx.Polynomial(0, 0, 1.0)`: with both a Klein-Gordon lattice.

    **Returns:** a `Lattice` with `positions`. All numbers are differentiable but n, m; a batch by `jax.vmap(...,
    out_axes=-1)`. **Raises** ValueError for a boundary, an outline or masses that do not fit, `rotation` out of plane.

    **Example:**

    >>> crystal = gx.scenes.square(6, precompression=-0.1, boundary="periodic")
    >>> gx.linear.dispersion(crystal, [np.pi, 0.0]).omega_squared.round(6)   # -4 f and 4 K
    Array([0.4, 4. ], dtype=float64)
    """
    return _plane(
        SQUARE,
        n,
        m,
        mass,
        stiffness,
        exponent,
        precompression,
        law,
        spacing,
        boundary,
        outline,
        out_of_plane,
        rotation,
        tangential,
        inertia,
        units,
        ground,
        on_site,
    )


def triangular(
    n: Count,
    m: Count | None = None,
    *,
    mass: Parameter = 1.0,
    stiffness: Parameter | Sequence[Parameter] = 1.0,
    exponent: Parameter = 1.0,
    precompression: Parameter = 0.0,
    law: Law | Sequence[Law] | None = None,
    spacing: Scalar = 1.0,
    boundary: str | Sequence[str] = "fixed",
    outline: str | Callable = "cells",
    out_of_plane: bool = False,
    rotation: bool = False,
    tangential: Scalar | Law | None = None,
    inertia: Scalar = SPHERE,
    ground: Scalar | None = None,
    on_site: Law | None = None,
    units: str = SCALED,
) -> Lattice:
    r"""Triangular lattice, the hexagonal packing of beads: each site is bound to 6 neighbours, axes at 60 degrees.

    Springs K with the force F0 at rest, f = F0/|R|, m = 1: at the K point omega^2 = 4.5 (K - f) twice, at M 2K - 6f and
    6K - 2f; the squares of the two speeds of long waves 9/8 and 3/8 (f = 0, in |R| (K/m)^{1/2}).

    **Arguments:** as of `square`. Bonds of the cell: along the first axis, the second, the second less the first.
    **Returns:** a `Lattice`, u of shape (n, m, 2). **Raises** ValueError as `square` does.

    **Example:**

    >>> crystal = gx.scenes.triangular(6, 6, boundary="periodic")
    >>> gx.linear.dispersion(crystal, [np.pi, 0.0]).omega_squared.round(6)   # at M
    Array([2., 6.], dtype=float64)
    """
    return _plane(
        TRIANGULAR,
        n,
        m,
        mass,
        stiffness,
        exponent,
        precompression,
        law,
        spacing,
        boundary,
        outline,
        out_of_plane,
        rotation,
        tangential,
        inertia,
        units,
        ground,
        on_site,
    )


def hexagon(
    rings: Count,
    *,
    mass: Parameter = 1.0,
    stiffness: Parameter | Sequence[Parameter] = 1.0,
    exponent: Parameter = 1.0,
    precompression: Parameter = 0.0,
    law: Law | Sequence[Law] | None = None,
    spacing: Scalar = 1.0,
    boundary: str = "fixed",
    out_of_plane: bool = False,
    rotation: bool = False,
    tangential: Scalar | Law | None = None,
    inertia: Scalar = SPHERE,
    ground: Scalar | None = None,
    on_site: Law | None = None,
    units: str = SCALED,
) -> Lattice:
    """A hexagon of the triangular lattice: 3 r (r + 1) + 1 sites, u of shape (sites, 2); `triangular` with an outline.

    **Arguments:** `rings`: r >= 1 around the bead in the middle, whose number is half of all. The others as of
    `square`; `boundary`: `"fixed"` or `"free"`. **Returns:** a `Lattice`. **Raises** ValueError as `square` does.
    """
    rings = whole("rings", rings, 1)
    return _plane(
        TRIANGULAR,
        rings,
        None,
        mass,
        stiffness,
        exponent,
        precompression,
        law,
        spacing,
        boundary,
        "hexagon",
        out_of_plane,
        rotation,
        tangential,
        inertia,
        units,
        ground,
        on_site,
    )


def honeycomb(
    n: Count,
    m: Count | None = None,
    *,
    mass: Parameter | dict[str, Parameter] = 1.0,
    stiffness: Parameter | Sequence[Parameter] = 1.0,
    exponent: Parameter = 1.0,
    precompression: Parameter = 0.0,
    law: Law | Sequence[Law] | None = None,
    spacing: Scalar = 1.0,
    boundary: str | Sequence[str] = "fixed",
    outline: str | Callable = "cells",
    out_of_plane: bool = False,
    rotation: bool = False,
    tangential: Scalar | Law | None = None,
    inertia: Scalar = SPHERE,
    ground: Scalar | None = None,
    on_site: Law | None = None,
    units: str = SCALED,
) -> Lattice:
    r"""Honeycomb lattice: two sites `a`, `b` in a cell, each bound to 3 of the other kind, axes at 60 degrees.

    Out of plane with springs K, m = 1: omega^2 = 3K (+ ground) +- K |1 + exp(i k1) + exp(i k2)|, a Dirac point at K,
    k = (2 pi/3, 4 pi/3). Unlike masses {"a": ..., "b": ...} open it: the two valleys.

    **Arguments:** as of `square`, and: `mass`: a number, or a dict of one for each of `a` and `b`.
    **Returns:** a `Lattice` of the fields `a`, `b`. **Raises** ValueError as `square` does.

    **Example:**

    >>> crystal = gx.scenes.honeycomb(6, out_of_plane=True, boundary="periodic")
    >>> gx.linear.dispersion(crystal, [2 * np.pi / 3, 4 * np.pi / 3]).omega_squared.round(6)   # the Dirac point
    Array([3., 3.], dtype=float64)
    """
    return _plane(
        HONEYCOMB,
        n,
        m,
        mass,
        stiffness,
        exponent,
        precompression,
        law,
        spacing,
        boundary,
        outline,
        out_of_plane,
        rotation,
        tangential,
        inertia,
        units,
        ground,
        on_site,
    )


def kagome(
    n: Count,
    m: Count | None = None,
    *,
    mass: Parameter | dict[str, Parameter] = 1.0,
    stiffness: Parameter | Sequence[Parameter] = 1.0,
    exponent: Parameter = 1.0,
    precompression: Parameter = 0.0,
    law: Law | Sequence[Law] | None = None,
    spacing: Scalar = 1.0,
    boundary: str | Sequence[str] = "fixed",
    outline: str | Callable = "cells",
    out_of_plane: bool = False,
    rotation: bool = False,
    tangential: Scalar | Law | None = None,
    inertia: Scalar = SPHERE,
    ground: Scalar | None = None,
    on_site: Law | None = None,
    units: str = SCALED,
) -> Lattice:
    r"""Kagome lattice: three sites in a cell, triangles that share corners, 4 bonds at each site.

    Out of plane omega^2 = Omega^2 - K E, Omega^2 = 4K + ground, E = -2 (flat) and
    1 +- (4 (cos^2 x1 + cos^2 x2 + cos^2 x3) - 3)^{1/2}, x1 = k1/2, x2 = k2/2, x3 = (k1 - k2)/2. A breathing kagome has
    the `stiffness` (1, 1, 1, K, K, K): within the cell first, then between cells.

    **Arguments:** as of `square` and `honeycomb`. Bonds of the cell: a-b, a-c, b-c within, then between cells.
    **Returns:** a `Lattice` of the fields `a`, `b`, `c`. **Raises** ValueError as `square` does.

    **Example:**

    >>> crystal = gx.scenes.kagome(6, out_of_plane=True, boundary="periodic")
    >>> gx.linear.flat_bands(crystal).omega_squared.round(6)   # 4 K - K E, E = -2
    array([6.])
    """
    return _plane(
        KAGOME,
        n,
        m,
        mass,
        stiffness,
        exponent,
        precompression,
        law,
        spacing,
        boundary,
        outline,
        out_of_plane,
        rotation,
        tangential,
        inertia,
        units,
        ground,
        on_site,
    )


def lieb(
    n: Count,
    m: Count | None = None,
    *,
    mass: Parameter | dict[str, Parameter] = 1.0,
    stiffness: Parameter | Sequence[Parameter] = 1.0,
    exponent: Parameter = 1.0,
    precompression: Parameter = 0.0,
    law: Law | Sequence[Law] | None = None,
    spacing: Scalar = 1.0,
    boundary: str | Sequence[str] = "fixed",
    outline: str | Callable = "cells",
    out_of_plane: bool = True,
    rotation: bool = False,
    tangential: Scalar | Law | None = None,
    inertia: Scalar = SPHERE,
    ground: Scalar | None = 0.0,
    on_site: Law | None = None,
    equal: bool = True,
    units: str = SCALED,
) -> Lattice:
    r"""Lieb lattice: a square lattice with a site on each edge; corner `a` has 4 bonds, edges `b` and `c` have 2.

    Out of plane with on-site springs that make all sites equal, omega^2 = Omega^2 - K E, Omega^2 = 4K + ground:
    E = 0 (flat) and +-2 (cos^2(k1/2) + cos^2(k2/2))^{1/2}.

    **Arguments:** as of `square` and `honeycomb`. `equal`: whether edges get the on-site springs that corners need not
    (out of plane alone). **Returns:** a `Lattice` of the fields `a`, `b`, `c`. **Raises** ValueError as `square` does.
    """
    return _plane(
        LIEB,
        n,
        m,
        mass,
        stiffness,
        exponent,
        precompression,
        law,
        spacing,
        boundary,
        outline,
        out_of_plane,
        rotation,
        tangential,
        inertia,
        units,
        ground,
        on_site,
        equal and out_of_plane,
    )


def quadrupole(
    n: Count,
    m: Count | None = None,
    k1: Scalar = 1.0,
    k2: Scalar = 2.0,
    *,
    mass: Parameter | dict[str, Parameter] = 1.0,
    boundary: str | Sequence[str] = "fixed",
    ground: Scalar = 0.0,
    on_site: Law | None = None,
    units: str = SCALED,
) -> Lattice:
    r"""Quadrupole lattice of Benalcazar, Bernevig and Hughes: squares of four sites, k1 within and k2 between cells.

    Displacements out of the plane; of each square of bonds one is negative, b-d and its like, and on-site springs make
    all sites equal: omega^2 = Omega^2 - E, E = +-(k1^2 + k2^2 + 2 k1 k2 cos k_i, summed over i = 1, 2)^{1/2}, each
    twice; Omega^2 = 2 (k1 + k2) + ground. With k1 < k2 and fixed ends each corner holds a state at omega^2 = Omega^2.

    **Arguments:** `n`, `m`: cells; `k1`, `k2` > 0; the others as in `honeycomb`. **Returns:** a `Lattice` of the fields
    `a`, `b`, `c`, `d`. **Raises** ValueError as `square` does. Source: Benalcazar, Bernevig, Hughes, Science 357, 61
    (2017); Serra-Garcia et al., Nature 555, 342 (2018).
    """
    inner, outer = positive("k1", k1), positive("k2", k2)
    laws = tuple(Linear(k) for k in (inner, inner, inner, -inner, outer, outer, outer, -outer))
    springs = grounded(QUADRUPOLE, laws, ground, True, on_site)
    return built(
        QUADRUPOLE,
        (n, n if m is None else m),
        laws,
        Motion(None),
        mass=mass,
        spacing=1.0,
        boundary=boundary,
        outline="cells",
        on_site=springs,
        units=units,
    )


def _plane(
    cell,
    n,
    m,
    mass,
    stiffness,
    exponent,
    precompression,
    law,
    spacing,
    boundary,
    outline,
    out_of_plane,
    rotation,
    tangential,
    inertia,
    units,
    ground=None,
    on_site=None,
    equal=False,
):
    laws = laws_of(cell, law, stiffness, exponent, precompression)
    motion = motion_of(laws, out_of_plane, rotation, tangential, inertia)
    springs = None
    if ground is not None or on_site is not None:
        springs = grounded(cell, laws, 0.0 if ground is None else ground, equal, on_site)
    return built(
        cell,
        (n, n if m is None else m),
        laws,
        motion,
        mass=mass,
        spacing=spacing,
        boundary=boundary,
        outline=outline,
        on_site=springs,
        units=units,
    )
