"""Band edges and gaps."""

from functools import reduce
from math import prod

import jax
import jax.numpy as jnp
import numpy as np

from ..base.checks import concrete, known_value, refuse
from ..base.derivatives import changed, with_rule
from ..base.programs import compiled, joined, parted
from ..base.types import Cell, Numbers
from ..lattice import Lattice
from ..results import Result, array, note
from .cell import TIGHT, by_lanes, in_lanes, turning_cell
from .modes import UNSTABLE, signed_root
from .stiffness import each, mesh, offsets, or_one

# the factor by which the stencil around an extremum of a band shrinks in each round
SHRINK = 0.6
# the rounds; the last stencil is 4e-11 times as wide as the first
ROUNDS = 48
# the number of extrema of the mesh, of different omega^2, that are refined: the best sample may lie
# beside one that is not the best
STARTS = 4
# the rounds before the best of them is taken: omega^2 is then known to about 1e-8 of a band
FIRST = 12
# bands whose distance is below this part of the largest upper edge have no gap between them
TOUCHING = 1e-8
VACUUM = (
    "Nothing is stiff at rest (a sonic vacuum): there are no linear waves, and every frequency is zero. Give "
    "precompression > 0."
)


class Bands(Result):
    """Edges of the bands, sorted by omega.

    `gaps` lists the complete gaps as pairs (low, high); bands that touch leave none.
    """

    lower: Numbers = array("The lower edge of each band.", "rad/s", "band")
    upper: Numbers = array("The upper edge of each band.", "rad/s", "band")
    lower_k: Numbers = array(
        "The phase per cell at the lower edge, one of several equivalent ones.", "rad", "band"
    )
    upper_k: Numbers = array(
        "The phase per cell at the upper edge, one of several equivalent ones.", "rad", "band"
    )
    cell: tuple[int, ...] = note("The number of sites per cell along each axis.", static=True)

    @property
    def gaps(self) -> list[tuple[float, float]]:
        """The complete gaps, pairs (low, high) [rad/s].

        **Raises** ValueError for a batch, TypeError for traced edges.
        """
        low = np.asarray(self.upper)
        high = np.asarray(self.lower)
        if low.ndim != 1:
            refuse(
                "gaps",
                "the bands of one lattice",
                f"edges of shape {low.shape}",
                "Read .lower and .upper.",
            )
        least = TOUCHING * np.abs(low).max()
        return [(float(a), float(b)) for a, b in zip(low[:-1], high[1:]) if b - a > least]

    @property
    def outcome(self) -> str:
        """The number of bands and gaps, and the cell."""
        upper = concrete(self.upper)
        if upper is not None and not np.any(upper):
            return VACUUM
        lost = np.isnan(by_lanes(self, self.lower)).any(1)
        if lost.any():
            lanes = f"in {lost.sum()} of {lost.size} lanes " if lost.size > 1 else ""
            return f"No bands {lanes}{UNSTABLE}"
        sites = f"{' x '.join(map(str, self.cell))} site{'s' * (prod(self.cell) > 1)}"
        count = by_lanes(self, self.lower).shape[1]
        gaps = (
            f", {len(self.gaps)} gap{'s' * (len(self.gaps) != 1)}" if self.lower.ndim == 1 else ""
        )
        return f"{count} band{'s' * (count > 1)}{in_lanes(self)}{gaps}, cell of {sites}."

    def _rows(self):
        if self.lower.ndim != 1:
            yield from super()._rows()
            return
        gaps = dict(self.gaps)
        unit = self._unit(self._described["lower"])
        for a, b in zip(np.asarray(self.lower), np.asarray(self.upper)):
            if np.isnan(a):
                break
            yield "band", f"{a:.9g} ... {b:.9g} {unit}".rstrip()
            if float(b) in gaps:
                yield "gap", f"{b:.9g} ... {gaps[float(b)]:.9g} {unit}".rstrip()
        yield "outcome", self.outcome


def bands(lattice: Lattice, cell: Cell = None) -> Bands:
    r"""Compute the edges of the bands of omega(k), and the gaps between them.

    omega^2 is sampled over the zone and every extremum refined, so that edges inside it are found
    too; those at k = 0 and pi are exact.

    **Arguments:** `lattice`, `cell`: as in `dispersion`. **Returns:** `Bands`. A precompressed
    dimer with stiffness K2, masses m < M has 0 ... (2 K2/M)^{1/2} and (2 K2/m)^{1/2} ... (2 K2
    (1/m + 1/M))^{1/2}. Edges are differentiable in every parameter where one band alone reaches
    them.
    **Raises** ValueError where `dispersion` does.

    **Example:**

    >>> found = gx.linear.bands(gx.scenes.dimer(20, ratio=0.5, precompression=1.0, boundary="periodic"))
    >>> print(found.upper.round(4))  # (2 K2)^{1/2} and (6 K2)^{1/2}
    [1.7321 3.    ]
    """
    found = turning_cell(lattice, cell)
    axes = len(found.cell)
    if _neighbours_alone(found):
        return Bands(*_ends(found), found.cell, **lattice.origin)
    reach = np.abs(np.array(found.shells)).max()
    # omega(-k) = omega(k) without gyroscopic forces, so half of the zone is enough for a chain;
    # meshes of 48 and 12 points contain the corners of a hexagonal zone
    if axes == 1:
        low = 0.0 if found.damping is None else -np.pi
        line = np.linspace(low, np.pi, 96 * max(1, reach) * (1 + (low < 0)) + 1)
    else:
        count = 48 if axes == 2 else 12
        line = 2 * np.pi * np.arange(count) / count
    k = mesh(*[line] * axes)
    edges = _edges(found, jnp.asarray(k, found.mass.dtype), float(line[1] - line[0]))
    return Bands(*edges, found.cell, **lattice.origin)


def _neighbours_alone(found):
    # Whether each site of a chain is coupled to its two neighbours alone. D(k) is then a periodic
    # Jacobi matrix: k appears as cos k in its characteristic polynomial, so every band is monotonic
    # between k = 0 and pi, however long the cell is.
    coupling = known_value(found.coupling)
    size = found.mass.size
    if coupling is None or found.damping is not None or found.cell != (size,):
        return False
    site = np.arange(size)
    apart = np.array(found.shells)[..., None] * size + site - site[:, None]
    return not np.any(coupling[np.abs(apart) > 1])


@compiled
def _ends(found):
    k = jnp.asarray([[0.0], [np.pi]], found.mass.dtype)
    squares = jax.vmap(found.squares)(k)
    scale = jnp.abs(jax.vmap(found.dynamical_matrix)(k)).max((1, 2))
    omega = signed_root(squares, scale[:, None], found.mass.size)
    rising = jnp.argsort(squares, 0)
    return *jnp.take_along_axis(omega, rising, 0), *k[rising, 0]


@compiled
def _edges(found, k, spacing):
    places = _extrema(jax.lax.stop_gradient(found), k, spacing)

    def edge(place, n):
        k = _following(found, place, n)
        scale = jnp.abs(found.dynamical_matrix(k)).max()
        return signed_root(found.squares(k)[n], scale, found.mass.size), k

    every = jax.vmap(jax.vmap(edge), (0, None))
    (lower, upper), places = every(places, jnp.arange(found.mass.size))
    return lower, upper, *(places[..., 0] if k.shape[-1] == 1 else places)


def _following(found, place, n):
    # the place of an extremum of band n, with its derivatives: the slope g stays zero there, so
    # that dk = -H^{-1} dg. The place is constant where the band is flat or meets another
    static, arrays = parted(found)
    same = lambda place, *_: place

    def rule(arrays, changes):
        k = with_rule(same, rule, *arrays)
        _, n, *own = arrays
        squares = lambda k, *own: joined(static, own).squares(k)
        slope = jax.jacfwd(lambda *at: squares(*at)[n])
        levels, scale = jax.lax.stop_gradient((squares(k, *own), joined(static, own).scale))
        least = jnp.sqrt(jnp.finfo(k.dtype).eps) * scale
        alone = jnp.sum(jnp.abs(levels - levels[n]) <= least) == 1
        # Where bands meet the numbers have no meaning, and are taken elsewhere to be finite.
        safe = jnp.where(alone, k, 0.3 + 0.2 * jnp.arange(len(k)))
        _, moved = changed(lambda *own: slope(safe, *own), tuple(own), changes[2:])
        bend = jax.jacfwd(slope)(safe, *own)
        bends, ways = jnp.linalg.eigh(jax.lax.stop_gradient(bend))
        free = (ways * (alone & (jnp.abs(bends) > least))) @ ways.T
        held = or_one(scale) * (jnp.eye(len(k)) - free)
        return k, -jnp.linalg.solve(free @ bend @ free + held, free @ moved)

    return with_rule(same, rule, place, n, *arrays)


# by samples, which a shrinking stencil refines
def _extrema(found, k, spacing):
    # k of the least and the greatest omega^2 of every band, (2, bands, axes), from a mesh
    size = found.mass.size
    *shape, axes = k.shape
    k = k.reshape(-1, axes)
    sign = jnp.array([1.0, -1.0], k.dtype)
    at_once = max(1, 2**22 // size**2)
    sampled = sign[:, None, None] * each(found.squares, k, at_once).T
    # no frequency at all comes first
    sampled = jnp.where(jnp.isnan(sampled), -jnp.inf, sampled)
    grid = sampled.reshape(2, size, *shape)
    # beyond the end of half a zone this is not the next sample, but both ends are extrema there
    around = [jnp.roll(grid, way, range(2, 2 + axes)) for way in offsets([1] * axes)]
    valleys = jnp.where(grid <= reduce(jnp.minimum, around), grid, jnp.inf).reshape(sampled.shape)
    order = jnp.argsort(valleys)
    valleys = jnp.take_along_axis(valleys, order, -1)
    # equivalent ones
    alike = TIGHT * jnp.finfo(k.dtype).eps * found.scale
    alike = jnp.diff(valleys, prepend=-jnp.inf) <= alike
    chosen = jnp.argsort(jnp.where(alike, jnp.inf, valleys))[..., :STARTS]
    starts = jnp.moveaxis(k[jnp.take_along_axis(order, chosen, -1)], 2, 0)
    moves = [np.array([0.0, -1.0, -0.5, 0.5, 1.0])] * axes
    stencil = jnp.asarray(mesh(*moves).reshape(-1, axes), k.dtype)

    def at_all(function, k):
        # of (k, sign, band) at (2, bands, axes)
        every = jax.vmap(jax.vmap(function, (0, None, 0)), (0, 0, None))
        return every(k, sign, jnp.arange(size))

    def close_in(i, best):
        def improve(best, s, n):
            tried = best + spacing * SHRINK**i * stencil
            return tried[jnp.argmin(s * jax.vmap(found.squares)(tried)[:, n])]

        return at_all(improve, best)

    def begin(k):
        k = jax.lax.fori_loop(0, FIRST, close_in, k)
        return k, at_all(lambda k, s, n: s * found.squares(k)[n], k)

    starts, values = jax.lax.map(begin, starts)
    best = jnp.argmin(values, 0)[None, ..., None]
    best = jnp.take_along_axis(starts, best, 0)[0]
    return jax.lax.fori_loop(FIRST, ROUNDS, close_in, best)
