r"""Topology of bands: Zak phases, winding and Chern numbers, Berry curvature, quadrupoles.

All numbers come from products of overlaps of Bloch vectors on a mesh, in which the arbitrary phases
of the vectors cancel: no gauge is chosen. The mesh is refined where bands come near each other. A
gap of omega^2 below 1e-9 of its largest value (single precision: 8e-6), anywhere in the zone,
counts as closed, and there is no number: functions that return a record or a real number give NaN,
and the record's `outcome` says where; those that return a whole number raise ValueError.

The vectors q obey D(k) q = omega^2 q with the phases of cells, D(k + 2 pi) = D(k). A Zak phase
depends on which sites form one cell, here that of `gx.linear.unit_cell`; to choose another, pass
`unit_cell(lattice, cell).dynamical_matrix` as the lattice.
"""

from collections.abc import Callable, Sequence
from functools import reduce
from itertools import product
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import scipy

from ..base.checks import one_of, parameter, refuse, whole
from ..base.types import AnyArray, Count, Number, Numbers, Parameter
from ..lattice import Lattice
from ..results import Result, array, note
from . import unit_cell
from .cell import chosen_bands, matrices, turning_cell
from .stiffness import in_groups, mesh
from .zone import lattice_vectors, named_points

# a gap below this part of the largest omega^2 is closed
CLOSED = 1e-9
# between the middle of a piece of the mesh and its rim a band may move or turn by this part of its
# gap
TURN = 0.5
# waves of a gyroscopic lattice below this part of the largest omega are treated as having this
# omega: they are far from the bands above
SLOW = 1e-3
# the most halvings of a piece: 2 pi 2^-45 is 2e-13
HALVINGS = 45
# the most pieces that are halved at a time
MOST = 2**14
# of more pieces, only this many with the least gaps are followed
NEAREST = 64
# the most complex numbers (16 bytes each) of matrices held at a time
TOGETHER = 2**21
# the same of vectors, on all points of a mesh; a mesh that needs more is given up
LARGEST = 2**21
# points at which D(k) is evaluated at a time, so that one compiled program serves all
POINTS = 2**12
# a point is added between neighbouring Wannier vectors that overlap less than this
ALONG = 0.7


class _Waves(NamedTuple):
    """The source of D(k): the unit cell of a lattice, or a user-defined function.

    With gyroscopic forces the matrix is the pair D(k), G(k), and levels are omega of both signs;
    `first` is the index of the first positive one. `closed`: the largest gap that counts as closed;
    `origin`: what results keep of the lattice.
    """

    matrix: Callable
    axes: int
    size: int
    closed: float
    origin: dict
    first: int = 0

    def numbers(self, bands):
        """Return the levels of the requested bands."""
        return [self.first + n for n in chosen_bands(bands, self.size - self.first)]

    def told(self, numbers):
        """Return the bands of some levels in words."""
        return _told([n - self.first for n in numbers if n >= self.first] or [0])

    def matrices(self, k):
        """Return D, or D and G, at points (n, axes): (n, P, P) or (n, 2, P, P)."""
        return in_groups(lambda k: matrices(self.matrix, k), k, POINTS)

    def vectors(self, lines, bands=slice(None)):
        """Return vectors (..., P, bands) on a mesh, from an array of phases per axis."""
        points = mesh(*lines).reshape(-1, self.axes)
        parts = np.array_split(points, -(-len(points) // POINTS))
        q = [self.solved(self.matrices(part))[1][..., bands] for part in parts]
        return np.concatenate(q).reshape(*map(len, lines), *q[0].shape[1:])

    def solved(self, matrices):
        """Return levels, rising, and vectors; for D and G those over (D^{1/2} q, q')."""
        if not self.first:
            return np.linalg.eigh(matrices)
        D, G = np.moveaxis(matrices, -3, 0)
        squared, q = np.linalg.eigh(D)
        root = (q * np.sqrt(np.maximum(squared, 0))[..., None, :]) @ q.conj().mT
        upper = np.concatenate([0 * D, 1j * root], -1)
        return np.linalg.eigh(
            np.concatenate([upper, np.concatenate([-1j * root, -1j * G], -1)], -2)
        )

    def changes(self, matrices, levels, vectors):
        """Return the change of matrices (n, rim, ...) from the first of each n, in its vectors."""
        change = matrices[:, 1:] - matrices[:, :1]
        between = vectors[:, None]
        if not self.first:
            return between.conj().mT @ change @ between
        # (omega^2 + i omega G - D) q = 0, with q = i v/omega and q^+ (2 omega + i G) q = 1
        omega = np.maximum(np.abs(levels), SLOW * np.abs(levels).max())
        between = between[..., self.size // 2 :, :] / np.sqrt(omega)[:, None, None]
        D, G = (between.conj().mT @ x @ between for x in np.moveaxis(change, -3, 0))
        return D - 1j * levels[:, None, None] * G


def _waves_of(lattice, axes=None, follow=turning_cell):
    first = 0
    if isinstance(lattice, Lattice):
        found = follow(lattice)
        if axes is not None and len(found.cell) != axes:
            kinds = {1: "a chain", 2: "a lattice of the plane"}
            refuse("lattice", kinds[axes], f"one with {len(found.cell)} axes")
        matrix = found.dynamical_matrix
        axes = len(found.cell)
        origin = lattice.origin
        size = found.mass.size
        dtype = found.mass.dtype
        if found.damping is not None:
            matrix = jax.tree_util.Partial(_both, found)
            first = size
            size = 2 * size
    else:
        matrix = lattice
        axes = axes or 1
        origin = {}
        shape = jax.eval_shape(lattice, jnp.zeros(axes))
        size = shape.shape[0]
        dtype = shape.dtype
    closed = max(CLOSED, 64 * float(jnp.finfo(dtype).eps))
    return _Waves(matrix, axes, size, closed, origin, first)


def _both(found, k):
    return jnp.stack([found.dynamical_matrix(k), found.gyration(k)])


class _Mesh(NamedTuple):
    """The lines of a mesh, its least gap over the largest omega^2, the k of it, and any `fault`."""

    lines: list
    gap: float
    nearest: AnyArray
    fault: str


# A piece of the zone is halved while, between its middle and its rim, a chosen band and another may
# move towards each other, or turn into each other, by more than TURN of their distance. With E the
# change of D in the vectors of the middle, a level moves by E_nn and, to second order, by sum_m
# |E_nm|^2/(distance of n and m), or by |E_nm| where that is less. A gap that closes, at whatever k,
# is halved until it is below CLOSED.
def _cut(waves, count, numbers):
    # Return a mesh of at least `count` lines per axis on which bands are apart from all others.
    axes = waves.axes
    unit = 2 * np.pi / count
    plain = np.arange(count)
    others = np.setdiff1d(np.arange(waves.size), numbers)
    gap = np.inf
    nearest = np.full(axes, np.nan)
    lost = False
    cuts = []
    largest = None
    rim, corners = (np.array(list(product(way, repeat=axes))) for way in ((0, -1, 1), (-1, 1)))
    # in units of the mesh, so that repeated halving is exact
    half = 0.5
    middle = mesh(*[plain + 0.5] * axes).reshape(-1, axes)
    for _ in range(HALVINGS if len(others) else 0):
        parts = np.array_split(middle, -(-len(middle) * len(rim) * waves.size**2 // TOGETHER))
        found = [_judged(waves, unit * (x[:, None] + half * rim), numbers, others) for x in parts]
        least, place, rough, top = map(np.concatenate, zip(*found))
        largest = max(top.max(), np.finfo(float).tiny) if largest is None else largest
        best = least.argmin()
        if least[best] < gap * largest:
            gap = least[best] / largest
            nearest = place[best] % (2 * np.pi)
        if gap <= waves.closed or not rough.any():
            break
        lost = lost or rough.sum() > MOST
        middle = middle[rough][np.argsort(least[rough])[: NEAREST if lost else None]]
        cuts.append(middle)
        half /= 2
        middle = (middle[:, None] + half * corners).reshape(-1, axes)
    else:
        lost = len(others) > 0
    lines = [
        unit * np.unique(np.concatenate([plain, *(x[:, axis] for x in cuts)]))
        for axis in range(axes)
    ]
    lost = lost or np.prod([len(x) for x in lines]) * waves.size * len(numbers) > LARGEST
    where = f"at k = {', '.join(f'{x:.6g}' for x in nearest)}"
    fault = ""
    if gap <= waves.closed:
        fault = f"{waves.told(numbers)} touch{'es' * (len(numbers) == 1)} others {where}."
    elif lost:
        fault = (
            f"{waves.told(numbers)} and others are too close over too much of the zone for a mesh to follow: "
            f"the least gap that was met, {where}, is {gap:.1e} of the largest omega{'' if waves.first else '^2'}."
        )
    return _Mesh(lines, gap, nearest, fault)


def _told(numbers):
    return f"Bands {', '.join(map(str, numbers))}" if len(numbers) > 1 else f"Band {numbers[0]}"


# The middle of a piece comes first. The gap is taken there and at one corner: the corners of all
# pieces are the points of the mesh.
def _judged(waves, points, numbers, others):
    # the least gap of each piece (n, rim, axes), its k, whether to halve it, and the largest
    # |omega^2|
    D = waves.matrices(points.reshape(-1, points.shape[-1]))
    D = D.reshape(*points.shape[:2], *D.shape[1:])
    squared, q = waves.solved(D[:, 0])
    corner = points.shape[1] // 2
    gaps = np.stack(
        [
            np.abs(x[:, numbers][:, :, None] - x[:, others][:, None, :]).min((1, 2))
            for x in (squared, waves.solved(D[:, corner])[0])
        ]
    )
    place = np.where((gaps[0] <= gaps[1])[:, None], points[:, 0], points[:, corner])
    E = waves.changes(D, squared, q)
    own = np.einsum("nrpp->nrp", E).real
    turn = np.abs(E).max(1) * (1 - np.eye(E.shape[-1]))
    apart = np.abs(squared[:, :, None] - squared[:, None, :])
    moved = (turn**2 / np.maximum(np.maximum(apart, turn), np.finfo(float).tiny)).sum(-1)
    need = np.abs(own[:, :, numbers, None] - own[:, :, None, others]).max(1)
    need += moved[:, numbers, None] + moved[:, None, others]
    rough = (need > TURN * apart[:, numbers][:, :, others]).any((1, 2))
    return gaps.min(0), place, rough, np.abs(squared).max(-1)


def _turns(q, axis=0):
    # phase factors of the determinants of overlaps of neighbours, around the zone
    link = np.linalg.det(q.conj().mT @ np.roll(q, -1, axis))
    return link / np.abs(link)


class Zak(Result):
    """Zak phases of the bands of a chain, or of a plane along one axis."""

    phase: Numbers = array(
        "The Berry phase of each band over the zone, in (-pi, pi], NaN for a band that "
        "touches others.",
        "rad",
        "band ...",
    )
    below: Numbers = array(
        "The phase of all bands below each gap together, NaN where bands touch. If the "
        "cell is its own mirror image, this over pi counts the states at an end.",
        "rad",
        "gap ...",
    )
    error: Number = array("The difference from a mesh of half as many points.", "rad")
    k: Numbers | None = array(
        "The wave number along the other axis, `None` for a chain.", "rad", "wave"
    )
    faults: tuple[str, ...] = note("A sentence for each gap without a number.", static=True)

    @property
    def outcome(self) -> str:
        """The phases in units of pi, and where bands touch."""
        if np.ndim(self.phase) > 1:
            told = f"of {len(self.phase)} bands at {self.phase.shape[1]} wave numbers"
        else:
            told = ", ".join("none" if np.isnan(x) else f"{x / np.pi:+.6g} pi" for x in self.phase)
        # a phase is printed with six digits
        known = f", +- {self.error:.1g} rad" if self.error > 1e-6 else ""
        return " ".join([f"Zak phases {told}{known}.", *self.faults])


def zak(
    lattice: Any,
    *,
    points: Count = 64,
    k: Parameter | None = None,
) -> Zak:
    r"""Compute Zak phases gamma = -Im log prod_j <q(k_j)|q(k_{j+1})> over the zone.

    The product is closed by D(k + 2 pi) = D(k). A cell that is its own mirror image has 0 or pi:
    that of `gx.scenes.ssh` has pi where the bonds between cells are stiffer, and a cut between
    cells leaves a state at the end.

    **Arguments:** `lattice`: one `Lattice`, or a function from k (axes,) to a Hermitian D(k) of
    period 2 pi. `points`: of the mesh, at least. `k`: wave numbers along the second axis of a
    plane; the phase is that along the first.
    **Returns:** `Zak`. **Raises** ValueError for three axes, a plane without `k`, and where
    `dispersion` does. Source: Zak, Phys. Rev. Lett. 62, 2747 (1989); Resta, Rev. Mod. Phys. 66,
    899.

    **Example:**

    >>> found = gx.topology.zak(gx.scenes.ssh(8, 1.0, 2.0, boundary="periodic"))
    >>> found.outcome
    'Zak phases +1 pi, +1 pi.'
    """
    waves = _waves_of(lattice, None if isinstance(lattice, Lattice) or k is None else 2)
    if waves.axes != 1 + (k is not None):
        refuse(
            "k",
            "None of a chain; of a plane the wave numbers along the second axis",
            f"{k} with {waves.axes} axes",
        )
    n = whole("points", points, 4)
    if k is None:
        phase, below, error, faults = _phases(waves, n)
        return Zak(phase, below, error, None, tuple(faults), **waves.origin)
    other = np.atleast_1d(np.asarray(parameter("k", k), float))
    line = jax.tree_util.Partial
    rows = [waves._replace(matrix=line(_on_line, waves.matrix, x), axes=1) for x in other]
    phase, below, error, faults = zip(*(_phases(row, n) for row in rows))
    told = [
        f"At k = {x:.6g} along the other axis: {said}"
        for x, some in zip(other, faults)
        for said in some
    ]
    below = np.stack(below, -1)
    return Zak(np.stack(phase, -1), below, max(error), other, tuple(told), **waves.origin)


def _on_line(matrix, other, k):
    return matrix(jnp.stack([k[0], other]))


def _between(k):
    return (k + np.append(k[1:], 2 * np.pi)) / 2


def _turned(angle):
    return np.angle(np.exp(1j * np.asarray(angle)))


def _phases(waves, count):
    # phases of each band, of all bands below each gap, their change with half of the mesh, and the
    # faults
    first = waves.first
    size = waves.size
    # gaps below the first band, where there are levels, and above each band but the last
    cuts = [_cut(waves, count, range(n)) for n in range(max(first, 1), size)]
    is_open = np.array([True] * (first == 0) + [not x.fault for x in cuts] + [True])
    lines = [x.lines[0] for x in cuts if not x.fault] or [2 * np.pi * np.arange(count) / count]
    q = waves.vectors([np.unique(np.concatenate(lines))])

    def loop(q, bands):
        # a product of numbers of modulus one, so that no logarithms are summed
        angle = -np.angle(np.prod(_turns(q[..., bands])))
        return np.pi if np.isclose(angle, -np.pi, atol=1e-12) else angle

    bands = size - first
    wanted = [([first + n], is_open[n] and is_open[n + 1]) for n in range(bands)]
    wanted += [(list(range(first, first + n)), is_open[0] and is_open[n]) for n in range(1, bands)]
    fine, coarse = (
        np.array([loop(x, bands) if there else np.nan for bands, there in wanted])
        for x in (q, q[::2])
    )
    error = np.nanmax(np.abs(_turned(fine - coarse)), initial=0.0)
    return fine[:bands], fine[bands:], error, [x.fault for x in cuts if x.fault]


def winding(lattice: Any, *, points: Count = 256) -> int:
    r"""Compute the winding number of a chain with two kinds of sites.

    Sites are bound only to the other kind: D(k) - Omega^2 = [[0, h^+], [h, 0]], with one Omega^2
    for all sites and the kind of the cell's first site first. nu counts the anticlockwise turns of
    det h from k = -pi to pi; |nu| states lie at an end that cuts between cells.

    **Arguments:** as in `zak`. **Returns:** nu. For `gx.scenes.ssh`: 0 for k1 > k2, else 1.
    **Raises** ValueError for sites whose own stiffness over mass differs, bonds within one kind,
    kinds of different number, a closed gap (det h = 0).

    **Example:**

    >>> gx.topology.winding(gx.scenes.ssh(8, 1.0, 2.0, boundary="periodic"))
    1
    """
    waves = _waves_of(lattice, 1, unit_cell)
    D = waves.matrices(2 * np.pi * np.arange(whole("points", points, 8))[:, None] / points)
    own = np.einsum("kaa->ka", D)
    scale = np.abs(D).max()
    if np.ptp(own.real) > CLOSED * scale:
        refuse(
            "lattice",
            "one stiffness over mass at all sites",
            f"{own.real.min():.6g} ... {own.real.max():.6g}",
            "Walls and grounding springs count: ground= of the scenes makes them equal.",
        )
    bound = np.abs(D - own[..., None] * np.eye(D.shape[-1])).max(0) > CLOSED * scale
    # the kind of a site is the parity of its distance from the first site that it is joined to
    distance = scipy.sparse.csgraph.shortest_path(bound, unweighted=True)
    kinds = distance[np.isfinite(distance).argmax(1), np.arange(len(bound))] % 2
    if (bound & (kinds[:, None] == kinds)).any():
        refuse(
            "lattice",
            "sites of two kinds, each bound to the other alone",
            "a ring of odd length",
            "Bands without that symmetry have a Zak phase: gx.topology.zak.",
        )
    first, second = (np.flatnonzero(kinds == kind) for kind in (0, 1))
    if len(first) != len(second):
        refuse(
            "lattice",
            "as many sites of one kind as of the other",
            f"{len(first)} and {len(second)}",
            "Such a cell has flat bands instead: gx.linear.flat_bands.",
        )
    cut = _cut(waves, points, range(len(first)))
    if cut.fault:
        refuse(
            "lattice", "a gap around the middle of the bands", "det h(k) = 0 somewhere", cut.fault
        )
    h = np.linalg.det(waves.matrices(cut.lines[0][:, None])[:, second][:, :, first])
    turns = np.angle(np.roll(h, -1) / h)
    if np.abs(turns).max() > 0.9 * np.pi:
        refuse(
            "points",
            "a mesh on which det h(k) turns smoothly",
            f"{points}",
            f"Give points={8 * points}.",
        )
    return int(np.round(turns.sum() / (2 * np.pi)))


class BerryCurvature(Result):
    """Berry curvature of bands of a two-dimensional lattice, on plaquettes of a mesh over the zone.

    The flux sums to 2 pi times the Chern number, `chern`, a whole number to rounding.
    """

    k: Numbers = array(
        "The corners of the plaquettes, phases per cell.", "rad", "first second axis"
    )
    flux: Numbers = array(
        "The flux through each plaquette, summed over the finer ones within it; NaN where"
        " bands touch.",
        "rad",
        "first second",
    )
    band: tuple[int, ...] = note("The bands.", static=True)
    gap: Number = array(
        "The least gap found, over the largest omega^2 (omega with gyroscopic forces).",
        "1",
    )
    nearest: Numbers = array("The k of the least gap.", "rad", "axis")
    fault: str = note("Why there is no number.", static=True)

    @property
    def curvature(self) -> Numbers:
        """The flux over area, (n, n), with k in phases per cell."""
        return self.flux * (len(self.flux) / (2 * np.pi)) ** 2

    @property
    def chern(self) -> float:
        """The Chern number as it was summed."""
        return float(self.flux.sum() / (2 * np.pi))

    @property
    def outcome(self) -> str:
        """The Chern number and the largest flux, or why there is none."""
        if self.fault:
            return f"No Chern number. {self.fault}"
        told = f"{_told(self.band)}: Chern number {round(self.chern)}"
        most = np.abs(self.flux).max()
        return f"{told}, at most {most:.3g} rad through a plaquette of {len(self.flux)} x {len(self.flux)}."


def berry_curvature(
    lattice: Any,
    band: Count | Sequence[Count] = 0,
    *,
    points: Count = 24,
) -> BerryCurvature:
    r"""Compute the Berry curvature of one or several bands of a two-dimensional lattice.

    The flux through a plaquette is the phase of the product of overlaps around it, so no smooth
    gauge is needed. At small gaps plaquettes are divided until the bands turn little around each:
    the whole number is right for gaps down to 1e-9 of the largest omega^2.

    **Arguments:** `lattice`: as in `zak`, with k (2,). `band`: counted from the lowest. `points`:
    along each axis of the zone.
    **Returns:** `BerryCurvature`. Masses and springs, for which D(-k) is the conjugate of D(k),
    have Chern numbers zero, and with a centre of inversion flux zero; gyroscopic forces
    (gyroscopes, Coriolis' force) give others. Where bands touch others, at any k, the flux is NaN
    and `outcome` says where. **Raises** ValueError where `dispersion` does.
    Source: Fukui, Hatsugai, Suzuki, J. Phys. Soc. Jpn. 74, 1674 (2005).

    **Example:**

    >>> def haldane(k):
    ...     f = 1 + jnp.exp(-1j * k[0]) + jnp.exp(-1j * k[1])
    ...     s = 0.2 + 0.2 * (jnp.sin(k[0]) - jnp.sin(k[1]) + jnp.sin(k[1] - k[0]))
    ...     return jnp.array([[s, f], [jnp.conj(f), -s]])
    >>> round(abs(gx.topology.berry_curvature(haldane).chern), 6)
    1.0
    """
    waves = _waves_of(lattice, 2)
    n = whole("points", points, 4)
    numbers = waves.numbers(band)
    cut, fine = _fluxes(waves, n, numbers)
    plain = 2 * np.pi / n * np.arange(n)
    first, second = (np.searchsorted(x, plain) for x in cut.lines)
    flux = np.add.reduceat(np.add.reduceat(fine, first, 0), second, 1)
    k = mesh(plain, plain)
    bands = tuple(n - waves.first for n in numbers)
    return BerryCurvature(k, flux, bands, cut.gap, cut.nearest, cut.fault, **waves.origin)


def _fluxes(waves, count, numbers):
    cut = _cut(waves, count, numbers)
    if cut.fault:
        return cut, np.full([len(x) for x in cut.lines], np.nan)
    q = waves.vectors(cut.lines, numbers)
    # the Berry phase around each plaquette of the closed mesh
    first, second = (_turns(q, axis) for axis in (0, 1))
    return cut, -np.angle(first * np.roll(second, -1, 0) / (np.roll(first, -1, 1) * second))


def chern(
    lattice: Any,
    band: Count | Sequence[Count] = 0,
    *,
    points: Count = 24,
) -> int:
    """Compute the Chern number of one or several bands: the flux of `berry_curvature` over 2 pi.

    **Arguments:** as there. **Returns:** a whole number, zero for masses and springs alone.
    **Raises** ValueError as there, and for bands that touch others.

    **Example:**

    >>> crystal = gx.scenes.honeycomb(6, mass={"a": 1.0, "b": 1.2}, out_of_plane=True, boundary="periodic")
    >>> gx.topology.chern(crystal, points=12)
    0
    """
    found = berry_curvature(lattice, band, points=points)
    if found.fault:
        refuse(
            "band",
            "bands apart from all others",
            _told(found.band),
            f"{found.fault} Take the bands that touch together, as band=(0, 1), or open the gap.",
        )
    return round(found.chern)


def valley_chern(
    lattice: Any,
    band: Count | Sequence[Count] = 0,
    *,
    valley: str | Parameter = "K",
    points: Count = 96,
) -> float:
    r"""Compute the valley Chern number, the Berry flux over 2 pi around one valley.

    The flux is that of the half of the zone nearer to the valley. Where two bands almost touch at K
    and K' = -K it tends to +-1/2 as their gap closes; it is no whole number and depends on the gap.
    Between phases of opposite sign one mode per valley runs along the wall.

    **Arguments:** `valley`: a named point, "K" or "K'", or phases per cell (2,); its partner is
    minus it. The others as in `berry_curvature`. **Returns:** the number, NaN where bands touch, as
    `berry_curvature(...).outcome` says. **Raises** ValueError as there, and for a point equal to
    its own minus.
    """
    waves = _waves_of(lattice, 2)
    cut, flux = _fluxes(waves, whole("points", points, 4), waves.numbers(band))
    hexagonal = vectors = np.array([[1.0, 0], [0.5, 0.75**0.5]])
    if isinstance(lattice, Lattice):
        vectors = lattice_vectors(lattice, turning_cell(lattice).cell)
    if isinstance(valley, str):
        known = named_points(vectors, 2)
        valley = known[one_of("valley", valley, known)]
    place = np.asarray(parameter("valley", valley), float)
    if np.allclose(_turned(2 * place), 0):
        refuse("valley", "a point k not equivalent to -k", f"{place}")
    middle = mesh(*map(_between, cut.lines))
    vectors = hexagonal if vectors is None else vectors
    near, far = (_distance(middle - sign * place, vectors) for sign in (1, -1))
    # plaquettes as far from both count half, whatever the rounding
    share = (1 + np.sign(np.round(far - near, 9))) / 2
    return float((flux * share).sum() / (2 * np.pi))


def _distance(k, vectors):
    # squared distances of wave vectors, given by their phases, from the nearest point of the
    # reciprocal lattice, times the square of the first vector; of phases in -pi ... pi the nearest
    # point is at most `far` cells away
    products = vectors @ vectors.T
    metric = products[0, 0] * np.linalg.inv(products)
    far = int(np.linalg.cond(vectors)) + 1
    images = product(2 * np.pi * np.arange(-far, far + 1), repeat=2)
    k = _turned(k)
    return reduce(np.minimum, (np.vecdot((k - x) @ metric, k - x) for x in images))


def _loops(q):
    # Wilson loops along the first axis, (second, bands, bands)
    # the unitary part of the overlap matrices of neighbouring points
    left, _, right = np.linalg.svd(q.conj().mT @ np.roll(q, -1, 0))
    return reduce(np.matmul, left @ right)


def quadrupole(
    lattice: Any,
    bands: Sequence[Count] | None = None,
    *,
    points: Count = 24,
) -> tuple[float, float]:
    r"""Compute nested Zak phases of the lower bands, over 2 pi.

    (1/2, 1/2) is a quadrupole, with corner states. The Wilson loop along one axis gives Wannier
    bands; their lower half has a Zak phase along the other.

    **Arguments:** `bands`: the occupied ones, `None` for the lower half. The others as in
    `berry_curvature`.
    **Returns:** (p_y of the Wannier bands along x, p_x of those along y), in [0, 1), where x is the
    first axis; 0 or 1/2 with both mirrors. `gx.scenes.quadrupole`: (1/2, 1/2) where bonds between
    cells are stiffer. NaN where the bands touch others, as
    `berry_curvature(lattice, bands).outcome` says. **Raises** ValueError for Wannier bands that
    touch.
    Source: Benalcazar, Bernevig, Hughes, Science 357, 61 (2017).
    """
    waves = _waves_of(lattice, 2)
    n = whole("points", points, 4)
    numbers = waves.numbers(range((waves.size - waves.first) // 2) if bands is None else bands)
    if len(numbers) % 2:
        refuse("bands", "an even number, whose Wannier bands come in pairs", f"{numbers}")
    cut = _cut(waves, n, numbers)
    if cut.fault:
        return np.nan, np.nan
    return tuple(_nested(waves, cut.lines, numbers, axis) for axis in (1, 0))


# a line is added where neighbouring Wannier vectors hardly overlap
def _nested(waves, lines, numbers, axis):
    # Zak phase over 2 pi, along one axis, of the lower half of the Wannier bands along the other
    half = len(numbers) // 2
    lines = list(lines)
    for _ in range(HALVINGS):
        q = waves.vectors(lines, numbers)
        q = q if axis == 1 else q.swapaxes(0, 1)
        angle, vectors = map(np.array, zip(*(_sorted_loop(w) for w in _loops(q))))
        if np.min(angle[:, half] - angle[:, half - 1]) < 1e-6:
            break
        # the loops begin at the first point of the mesh, so their vectors combine the q there
        w = np.einsum("kpb,kbm->kpm", q[0], vectors[..., :half])
        link = np.linalg.det(w.conj().mT @ np.roll(w, -1, 0))
        weak = np.abs(link) < ALONG**half
        if not weak.any():
            turn = -np.angle(np.prod(link / np.abs(link))) / (2 * np.pi)
            return float(np.round(turn % 1.0, 12) % 1.0)
        k = lines[axis]
        lines[axis] = np.sort(np.concatenate([k, _between(k)[weak]]))
    refuse("lattice", "Wannier bands with a gap", "ones that touch", "It has no quadrupole then.")


def _sorted_loop(w):
    triangle, vectors = scipy.linalg.schur(w, output="complex")
    angle = np.angle(np.diag(triangle))
    # -pi and pi are one angle, so that bands at 1/2 stay together
    angle = np.where(angle > np.pi - 1e-9, angle - 2 * np.pi, angle)
    order = np.argsort(angle)
    return angle[order], vectors[:, order]
