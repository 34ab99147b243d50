"""Named lattices in the plane and in space."""

from collections.abc import Sequence
from typing import Any

from ...base.checks import positive, whole
from ...base.types import Count, Scalar
from ...lattice import Lattice
from ...laws import Linear
from .build import crystal
from .cells import CUBIC, FCC, HCP, HONEYCOMB, KAGOME, LIEB, QUADRUPOLE, SQUARE, TRIANGULAR


def square(n: Count, m: Count | None = None, **bonds: Any) -> Lattice:
    r"""Build a square lattice: each site is bound to its 4 neighbours in the plane.

    m u'' = sum over neighbours j of [F(|R| - |R + u_j - u|) times the bond's direction]

    See `gx.Stretch`. With springs K under the force F0 at rest and f = F0/|R|, the bands of a wave
    along x are omega^2 = 2 (K/m) (1 - cos k) and -2 (f/m) (1 - cos k). A square does not resist
    shear: bonds that push at rest make it unstable; bonds that pull, or `rotation`, stabilise it.

    **Arguments:** `n`, `m`: cells along the two axes; `bonds`: the keyword arguments of `crystal`.
    Bonds of the cell: along the first axis, the second.
    **Returns:** a `Lattice`, u of shape (n, m, 2).
    **Raises** ValueError as `crystal` does.

    **Example:**

    >>> crystal = gx.scenes.square(6, precompression=-0.1, boundary="periodic")
    >>> gx.linear.dispersion(crystal, [np.pi, 0.0]).omega_squared.round(6)   # -4 f and 4 K
    Array([0.4, 4. ], dtype=float64)
    """
    return crystal(SQUARE, n, m, **bonds)


def triangular(n: Count, m: Count | None = None, **bonds: Any) -> Lattice:
    r"""Build a triangular lattice, the hexagonal packing of beads: each site has 6 neighbours.

    The axes are at 60 degrees. For springs K under the force F0 at rest, f = F0/|R|, m = 1, omega^2
    is 4.5 (K - f) twice at K, and 2K - 6f and 6K - 2f at M. For f = 0 the squared speeds of long
    waves are 9/8 and 3/8 K |R|^2/m.

    **Arguments:** as of `crystal`. Bonds of the cell: along the first axis, the second, the second
    minus the first.
    **Returns:** a `Lattice`, u of shape (n, m, 2).
    **Raises** ValueError as `crystal` does.

    **Example:**

    >>> crystal = gx.scenes.triangular(6, 6, boundary="periodic")
    >>> gx.linear.dispersion(crystal, [np.pi, 0.0]).omega_squared.round(6)   # at M
    Array([2., 6.], dtype=float64)
    """
    return crystal(TRIANGULAR, n, m, **bonds)


def hexagon(rings: Count, **bonds: Any) -> Lattice:
    """Build a hexagon of the triangular lattice: 3 r (r + 1) + 1 sites, u of shape (sites, 2).

    **Arguments:** `rings`: r >= 1 around the middle bead, whose index is 3 r (r + 1)/2. `bonds`: as
    of `crystal`; `boundary`: `"fixed"` or `"free"`.
    **Raises** ValueError as `crystal` does.
    """
    return crystal(TRIANGULAR, whole("rings", rings, 1), outline="hexagon", **bonds)


def honeycomb(n: Count, m: Count | None = None, **bonds: Any) -> Lattice:
    r"""Build a honeycomb lattice: two sites `a`, `b` per cell, each bound to 3 of the other kind.

    The axes are at 60 degrees. Out of plane with springs K, m = 1: omega^2 = 3K (+ ground) +- K
    |1 + exp(i k1) + exp(i k2)|, with a Dirac point at K, k = (2 pi/3, 4 pi/3). Unequal masses
    {"a": ..., "b": ...} open a gap there, with two valleys.

    **Arguments:** as of `crystal`.
    **Returns:** a `Lattice` of the fields `a`, `b`.
    **Raises** ValueError as `crystal` does.

    **Example:**

    >>> crystal = gx.scenes.honeycomb(6, out_of_plane=True, boundary="periodic")
    >>> gx.linear.dispersion(crystal, [2 * np.pi / 3, 4 * np.pi / 3]).omega_squared.round(6)   # the Dirac point
    Array([3., 3.], dtype=float64)
    """
    return crystal(HONEYCOMB, n, m, **bonds)


def kagome(n: Count, m: Count | None = None, **bonds: Any) -> Lattice:
    r"""Build a kagome lattice: three sites per cell, corner-sharing triangles, 4 bonds per site.

    Out of plane omega^2 = Omega^2 - K E, Omega^2 = 4K + ground, E = -2 (flat) and 1 +- (4 (cos^2
    x1 + cos^2 x2 + cos^2 x3) - 3)^{1/2}, x1 = k1/2, x2 = k2/2, x3 = (k1 - k2)/2. For a breathing
    kagome lattice set `stiffness` to (1, 1, 1, K, K, K).

    **Arguments:** as of `crystal`. Bonds of the cell: a-b, a-c, b-c within the cell, then between
    cells.
    **Returns:** a `Lattice` of the fields `a`, `b`, `c`.
    **Raises** ValueError as `crystal` does.

    **Example:**

    >>> crystal = gx.scenes.kagome(6, out_of_plane=True, boundary="periodic")
    >>> gx.linear.flat_bands(crystal).omega_squared.round(6)   # 4 K - K E, E = -2
    array([6.])
    """
    return crystal(KAGOME, n, m, **bonds)


def lieb(
    n: Count,
    m: Count | None = None,
    *,
    out_of_plane: bool = True,
    ground: Scalar | None = 0.0,
    equal: bool = True,
    **bonds: Any,
) -> Lattice:
    r"""Build a Lieb lattice: a square lattice of sites `a` with sites `b`, `c` on its edges.

    Corners have 4 bonds, edges 2. Out of plane with on-site springs that make all sites equal,
    omega^2 = Omega^2 - K E, Omega^2 = 4K + ground: E = 0 (flat) and +-2
    (cos^2(k1/2) + cos^2(k2/2))^{1/2}.

    **Arguments:** as of `crystal`, but out of plane by default. `equal`: whether edge sites get
    these on-site springs (out of plane only).
    **Returns:** a `Lattice` of the fields `a`, `b`, `c`.
    **Raises** ValueError as `crystal` does.
    """
    equal = equal and out_of_plane
    return crystal(LIEB, n, m, out_of_plane=out_of_plane, ground=ground, equal=equal, **bonds)


def quadrupole(
    n: Count,
    m: Count | None = None,
    k1: Scalar = 1.0,
    k2: Scalar = 2.0,
    *,
    ground: Scalar = 0.0,
    **bonds: Any,
) -> Lattice:
    r"""Build the quadrupole lattice of Benalcazar, Bernevig and Hughes.

    Squares of four sites move out of plane, with springs k1 within and k2 between cells. In each
    square of bonds one, such as b-d, is negative, and on-site springs make all sites equal:
    omega^2 = Omega^2 - E, E = +-(k1^2 + k2^2 + 2 k1 k2 cos k_i, summed over i = 1, 2)^{1/2}, each
    twice; Omega^2 = 2 (k1 + k2) + ground. With k1 < k2 and fixed ends each corner holds a state at
    omega^2 = Omega^2.

    **Arguments:** `n`, `m`: cells; `k1`, `k2` > 0; `bonds`: `mass`, `boundary`, `on_site`, `units`
    as in `crystal`.
    **Returns:** a `Lattice` of the fields `a`, `b`, `c`, `d`.
    **Raises** ValueError as `crystal` does.
    Source: Benalcazar, Bernevig, Hughes, Science 357, 61 (2017); Serra-Garcia et al., Nature 555,
    342 (2018).
    """
    inner = positive("k1", k1)
    outer = positive("k2", k2)
    laws = [Linear(k) for k in (inner, inner, inner, -inner, outer, outer, outer, -outer)]
    return crystal(
        QUADRUPOLE, n, m, law=laws, out_of_plane=True, ground=ground, equal=True, **bonds
    )


def cubic(n: Count | Sequence[Count], **bonds: Any) -> Lattice:
    """Build a simple cubic packing in space: each site is bound to its 6 neighbours.

    With springs K it resists no shear.

    **Arguments:** `n`: cells per axis, one number or three; `bonds`: as of `crystal`.
    **Returns:** a `Lattice`, u of shape (n, n, n, 3).
    **Raises** ValueError as `crystal` does.
    """
    return crystal(CUBIC, n, **bonds)


def fcc(n: Count | Sequence[Count], **bonds: Any) -> Lattice:
    r"""Build a face-centred cubic close packing in space: each site is bound to 12 neighbours.

    The axes are those of the primitive cell, (0, 1, 1), (1, 0, 1), (1, 1, 0) over 2^{1/2}. With
    springs K and m = |R| = 1 long waves along a cube's edge have the squared speeds 1, 1/2, 1/2 (K
    |R|^2/m), and omega^2 is 8, 4, 4 K/m at X and 8, 2, 2 at L.

    **Arguments:** as of `cubic`.
    **Returns:** a `Lattice`, u of shape (n, n, n, 3).
    **Raises** ValueError as `crystal` does.

    **Example:**

    >>> packing = gx.scenes.fcc(4, boundary="periodic")
    >>> found = gx.linear.path(packing, "GXWLGK", count=50)
    >>> found.omega_squared[found.marks[1]].round(6)   # at X
    Array([4., 4., 8.], dtype=float64)
    """
    return crystal(FCC, n, **bonds)


def hcp(n: Count | Sequence[Count], **bonds: Any) -> Lattice:
    r"""Build a hexagonal close packing in space: two sites `a`, `b` per cell, 12 neighbours each.

    The first two axes are at 60 degrees, the third is normal to them, (8/3)^{1/2} long. With
    springs K and m = |R| = 1 long waves along the third axis have the squared speeds 4/3, 1/3, 1/3
    (K |R|^2/m).

    **Arguments:** as of `cubic`.
    **Returns:** a `Lattice` of the fields `a`, `b`.
    **Raises** ValueError as `crystal` does.
    """
    return crystal(HCP, n, **bonds)
