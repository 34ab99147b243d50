"""The Brillouin zone: lattice vectors, named points, bands along a path, density of states."""

import re
from typing import Any

import jax.numpy as jnp
import numpy as np
import scipy

from ..base.checks import refuse, traced, whole
from ..base.types import Cell, Count, Numbers
from ..lattice import Lattice
from ..results import Result, array, note
from .cell import by_lanes, in_lanes, turning_cell
from .dispersion import bloch_waves
from .stiffness import mesh, offsets

# how far lengths and cosines of the lattice vectors may be from those of a square, hexagonal or other
# named lattice, lengths relative to the first
SHAPE = 1e-9
# the error of a bin is the largest of this many bins around it, or more where an interval of the
# coarser mesh holds more on either side
NEIGHBOURS = 7
# the error is this many times the change from half as many points: where bins are narrower than the
# intervals of the mesh, or hold the edge of a band, both meshes miss alike
ALIKE = 3.0
# the most bins per point, beyond which that does not cover the edge of a band
FINE = 8
# special points, k in units of pi
CHAIN = {"G": (0.0,), "X": (1.0,)}
# for axes at 60 degrees; M lies between K and K'
HEXAGON = {"G": (0, 0), "M": (0, 1), "K": (2 / 3, 4 / 3), "K'": (4 / 3, 2 / 3)}
FACES = {"G": (0, 0, 0), "X": (0, 1, 1), "L": (1, 1, 1), "W": (0.5, 1, 1.5)}
FACES |= {"K": (0.75, 0.75, 1.5), "U": (0.5, 1.25, 1.25)}
# the cosines between lattice vectors, how many of these have one length, and the special points
ZONES = (
    (np.eye(2), 2, {"G": (0, 0), "X": (1, 0), "Y": (0, 1), "M": (1, 1)}),
    (np.eye(2), 1, {"G": (0, 0), "X": (1, 0), "Y": (0, 1), "S": (1, 1)}),
    ([[1, 0.5], [0.5, 1]], 2, HEXAGON),
    ([[1, -0.5], [-0.5, 1]], 2, {name: (k[0], k[1] - k[0]) for name, k in HEXAGON.items()}),
    (np.eye(3), 3, {"G": (0, 0, 0), "X": (0, 1, 0), "M": (1, 1, 0), "R": (1, 1, 1)}),
    ((1 + np.eye(3)) / 2, 3, FACES),
    (
        [[1, 0.5, 0], [0.5, 1, 0], [0, 0, 1]],
        2,
        {pair[i]: (*HEXAGON[pair[0]], i) for pair in ("GA", "ML", "KH") for i in (0, 1)},
    ),
)


def lattice_vectors(lattice: Lattice, cell: tuple) -> np.ndarray | None:
    """Return the vectors (axes, d) between neighbouring cells, `None` without positions."""
    positions = lattice.positions
    if isinstance(positions, dict):
        positions = next(iter(positions.values()))
    if positions is None:
        return None
    at = np.asarray(positions)
    if any(n < 2 for n in at.shape[:-1]):
        refuse("lattice", "two cells or more along each axis", f"{at.shape[:-1]}")
    ways = np.eye(at.ndim - 1, dtype=int)
    return np.array([n * (at[tuple(way)] - at[tuple(0 * way)]) for n, way in zip(cell, ways)])


def named_points(vectors: np.ndarray | None, axes: int) -> dict:
    """Return the named points of the zone as phases per cell."""
    table = CHAIN if axes == 1 else {"G": (0,) * axes}
    if axes > 1 and vectors is not None:
        lengths = np.linalg.norm(vectors, axis=1)
        cosines = vectors @ vectors.T / np.outer(lengths, lengths)
        for wanted, count, points in ZONES:
            equal = len(wanted) == axes and np.ptp(lengths[:count]) < SHAPE * lengths[0]
            if equal and np.abs(cosines - wanted).max() < SHAPE:
                table = points
                break
    return {name: np.pi * np.array(k, float) for name, k in table.items()}


class PathBands(Result):
    """Bands along a path through the Brillouin zone.

    `gx.linear.dispersion(lattice, found.k)` has their vectors.
    """

    names: tuple[str, ...] = note("The names of the points of the path.", static=True)
    marks: Any = array("The indices of the points in the arrays.", axes="point")
    k: Numbers = array("The phases per cell.", "rad", "place axis")
    distance: Numbers = array(
        "The distance along the path, in rad for a lattice without positions.", "1/m", "place"
    )
    omega: Numbers = array("The frequencies.", "rad/s", "place band")
    omega_squared: Numbers = array("omega^2.", "rad^2/s^2", "place band")
    slope: Numbers = array(
        "The group velocity along the path, d omega/d distance; NaN where bands cross.",
        "m/s",
        "place band",
    )
    cell: tuple[int, ...] = note("The number of sites per cell along each axis.", static=True)

    @property
    def outcome(self) -> str:
        """The number of bands, the path, and the frequencies."""
        bands = by_lanes(self, self.omega).shape[-1]
        return (
            f"{bands} band{'s' * (bands > 1)} along {'-'.join(self.names)}{in_lanes(self)}, omega = "
            f"{self._told('omega', np.min(self.omega))} ... {self._told('omega', np.max(self.omega))}."
        )


def path(
    lattice: Lattice,
    points: str = "GXMG",
    count: Count = 120,
    cell: Cell = None,
) -> PathBands:
    """Compute bands along straight lines between points of the Brillouin zone.

    **Arguments:**

    - `lattice`: one `Lattice` on a grid; its `positions` give the shape of the zone.
    - `points`: names in order, "GKMG" (an apostrophe belongs to the letter before it: "GK'MG"). A
      chain has G, X; a square lattice G, X, M, Y; a rectangular one G, X, S, Y; axes at 60 or 120
      degrees G, K, M, K'. In space a cubic one has G, X, M, R, a face-centred one G, X, L, W, K, U,
      a hexagonal one G, M, K, A, L, H.
    - `count`: places in all, shared out by the lengths of the lines. `cell`: as in `unit_cell`.

    **Returns:** `PathBands`, for `gx.plots.bands`. Differentiable between crossings, but not in
    positions.
    **Raises** ValueError for an unknown point, fewer than two points, a point that follows itself,
    and where `dispersion` does.

    **Example:**

    >>> found = gx.linear.path(gx.scenes.triangular(6, 6, boundary="periodic"), "GKMG", count=40)
    >>> found.omega_squared[found.marks[1]].round(6)   # 4.5 K/m, twice, at K
    Array([4.5, 4.5], dtype=float64)
    """
    found = turning_cell(lattice, cell)
    axes = len(found.cell)
    vectors = lattice_vectors(lattice, found.cell)
    known = named_points(vectors, axes)
    names = tuple(re.findall("[^- ]'*", points))
    for name in names:
        if name not in known:
            remedy = "The positions of the lattice tell the shape of its zone."
            refuse("points", f"names among {sorted(known)}", repr(name), remedy)
    if len(names) < 2 or any(one == after for one, after in zip(names, names[1:])):
        refuse("points", "at least two points, none twice in a row", repr(points))
    corners = np.array([known[name] for name in names])
    # lengths in space: phases k = A q with lattice vectors A
    space = corners if vectors is None else corners @ np.linalg.pinv(vectors).T
    lengths = np.linalg.norm(np.diff(space, axis=0), axis=1)
    shares = np.maximum(1, np.round(whole("count", count, 2) * lengths / lengths.sum()).astype(int))
    marks = np.concatenate([[0], np.cumsum(shares)])
    place = np.arange(marks[-1] + 1)
    k = np.stack([np.interp(place, marks, x) for x in corners.T], -1)
    distance = np.interp(place, marks, np.append(0, np.cumsum(lengths)))
    squared, omega, _, velocity, _ = bloch_waves(found, k)
    along = np.repeat(np.diff(corners, axis=0) / lengths[:, None], shares, axis=0)
    along = np.concatenate([along, along[-1:]])
    slope = jnp.einsum("kba,ka->kb", velocity, jnp.asarray(along))
    return PathBands(names, marks, k, distance, omega, squared, slope, found.cell, **lattice.origin)


class DensityOfStates(Result):
    """Density of states g(omega), the number of states per cell and rad/s."""

    omega: Numbers = array("The middles of the bins.", "rad/s", "frequency")
    density: Numbers = array(
        "The mean of g over each bin; its integral over omega is the number of bands.",
        "s/rad",
        "frequency",
    )
    error: Numbers = array(
        "The error of the density, from half as many points, the largest over nearby bins.",
        "s/rad",
        "frequency",
    )
    points: int = note("The number of points along each axis of the zone.", static=True)

    @property
    def outcome(self) -> str:
        """The number of bins, and the accuracy."""
        worst = float(np.max(self.error) / max(np.max(self.density), np.finfo(float).tiny))
        return f"Density of states in {self.omega.size} bins, each known to {worst:.1e} of the largest."


def density_of_states(
    lattice: Lattice,
    bins: Count = 100,
    points: Count | None = None,
) -> DensityOfStates:
    """Compute the density of states of an infinite lattice, by linear interpolation over the zone.

    In each piece (an interval, or a triangle of a plane) omega is taken as linear, and
    states below a frequency are counted exactly.

    **Arguments:** `bins`: of omega from 0 (or the least) to the largest; `points`: along each axis
    of the zone, even; `None` for 512 of a chain and 96 of a plane. **Returns:** `DensityOfStates`,
    for `gx.plots.density_of_states`. **Raises** ValueError for three axes, a sonic vacuum, and
    where `dispersion` does.

    **Example:**

    >>> found = gx.linear.density_of_states(gx.scenes.monomer(20, precompression=1.0, boundary="periodic"), bins=20)
    >>> int(found.density.argmax())   # the last bin, at the band's edge
    19
    """
    if traced(lattice):
        remedy = "A count of states has no derivatives; gx.linear.dispersion has."
        refuse("lattice", "a lattice of known numbers", "a traced one", remedy)
    found = turning_cell(lattice)
    axes = len(found.cell)
    if axes > 2:
        refuse("lattice", "a chain or a lattice of the plane", f"one with {axes} axes")
    points = (512 if axes == 1 else 96) if points is None else whole("points", points, 8)
    points += points % 2
    bins = whole("bins", bins, 1)
    if bins > FINE * points:
        refuse("bins", f"at most {FINE} for each of {points} points", f"{bins}", "Give points=.")
    k = 2 * np.pi * np.arange(points) / points
    omega = np.asarray(bloch_waves(found, mesh(*[k] * axes))[1])
    low = min(0.0, omega.min())
    high = omega.max()
    if not high > low:
        refuse(
            "lattice",
            "waves of more than one frequency",
            f"omega = {high:g} alone",
            "Give it a precompression.",
        )
    edges = np.linspace(low, high * (1 + 1e-12), bins + 1)
    width = np.diff(edges)
    fine = np.diff(_counted(omega, edges, axes)) / width
    half = omega[(slice(None, None, 2),) * axes]
    # a bin in which the two agree by accident takes the error of its neighbours
    around = max(NEIGHBOURS, 1 + 2 * (4 * bins // points))
    error = ALIKE * scipy.ndimage.maximum_filter1d(
        np.abs(fine - np.diff(_counted(half, edges, axes)) / width), around
    )
    return DensityOfStates((edges[1:] + edges[:-1]) / 2, fine, error, points, **lattice.origin)


def _counted(omega, edges, axes):
    # states per cell below each edge
    following = [np.roll(omega, -1, axis) for axis in range(axes)]
    pieces = np.stack([omega, *following])
    if axes == 2:
        across = np.roll(following[0], -1, 1)
        pieces = np.concatenate([pieces, np.stack([across, *following])], 1)
    pieces = np.sort(pieces.reshape(axes + 1, -1), 0)
    return np.array([_below(pieces, e).sum() for e in edges]) * omega.shape[-1] / pieces.shape[1]


def _below(pieces, e):
    # the part of each interval or triangle where a linear function, given at its corners, is below
    # e
    low = pieces[0]
    high = pieces[-1]
    span = np.where(high > low, high - low, 1)
    if len(pieces) == 2:
        return np.where(high > low, np.clip((e - low) / span, 0, 1), high <= e)
    middle = pieces[1]
    first = np.where(middle > low, middle - low, 1)
    second = np.where(high > middle, high - middle, 1)
    rising = (e - low) ** 2 / (span * first)
    falling = 1 - (high - e) ** 2 / (span * second)
    part = np.where(e < middle, rising, np.where(e < high, falling, 1))
    return np.where(e <= low, np.where(high <= e, 1.0, 0.0), part)


class ZoneMap(Result):
    """Frequencies of all bands on a rectangle around the Brillouin zone."""

    q: Numbers = array("The wave vectors.", "1/m", "first second axis")
    omega: Numbers = array("The frequencies.", "rad/s", "first second band")
    velocity: Numbers = array(
        "The group velocity, NaN where bands cross or omega = 0.", "m/s", "first second band axis"
    )
    corners: Numbers = array("The corners of the first zone.", "1/m", "corner axis")

    @property
    def outcome(self) -> str:
        """The number of bands and of wave vectors."""
        return f"{self.omega.shape[-1]} bands on {self.omega.shape[0]} x {self.omega.shape[1]} wave vectors."


def zone_map(lattice: Lattice, points: Count = 81) -> ZoneMap:
    """Compute frequencies and group velocities over the zone of a two-dimensional lattice.

    **Arguments:** `lattice`: one with `positions`; `points`: along each side.
    **Returns:** `ZoneMap`, for `gx.plots.zone`. **Raises** ValueError for a lattice without two
    axes and positions.

    **Example:**

    >>> found = gx.linear.zone_map(gx.scenes.triangular(6, 6, boundary="periodic"), 9)
    >>> found.omega.shape, len(found.corners)
    ((9, 9, 2), 6)
    """
    found = turning_cell(lattice)
    vectors = lattice_vectors(lattice, found.cell)
    if len(found.cell) != 2 or vectors is None:
        refuse(
            "lattice",
            "a lattice of the plane with positions",
            f"one of {len(found.cell)} axes, "
            f"{'with' if vectors is not None else 'without'} positions",
            "The scenes of the plane have them.",
        )
    corners = _first_zone(2 * np.pi * np.linalg.inv(vectors).T)
    half = 1.05 * np.abs(corners).max(0)
    side = whole("points", points, 8)
    q = mesh(*(np.linspace(-h, h, side) for h in half))
    _, omega, _, velocity, _ = bloch_waves(found, q @ vectors.T)
    velocity = jnp.einsum("xyba,ad->xybd", velocity, vectors)
    return ZoneMap(q, omega, velocity, corners, **lattice.origin)


def _first_zone(reciprocal):
    # corners, in order, of the points nearer to 0 than to any other point of the reciprocal lattice
    found = scipy.spatial.Voronoi(np.array(offsets((2, 2))) @ reciprocal)
    corners = found.vertices[found.regions[found.point_region[12]]]
    # start on the x axis; the shift makes up for the rounding of a corner that lies there
    angle = (np.arctan2(corners[:, 1], corners[:, 0]) + SHAPE) % (2 * np.pi)
    return corners[np.argsort(angle)]
