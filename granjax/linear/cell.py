"""The unit cell of a lattice: its period, found or given, and the dynamical matrix D(k)."""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..base.checks import known_value, refuse, traced, whole
from ..base.derivatives import eigh, eigvalsh
from ..base.printing import told
from ..base.programs import compiled, concretely
from ..base.types import AnyArray, Cell, ComplexNumbers, Displacements, Number, Numbers
from ..lattice import Lattice
from ..results import Held
from ..terms.chain import span
from . import turning
from .stiffness import (
    at_rest,
    blocks,
    grid,
    offsets,
    refuse_one_way,
    stand_in,
    turning_at_rest,
    unpack_waves,
)

# Tolerances, in units of eps times the largest stiffness.
# For a sum that is zero:
ROUNDING = 16
# For blocks that are equal:
TIGHT = 1e3
# For the force that blocks of sufficient reach may miss:
LOOSE = 1e6


class UnitCell(eqx.Module):
    r"""One cell of the infinite lattice that a finite lattice belongs to.

    A wave is u_j(R) = M_j^{-1/2} q_j exp(i k . R - i omega t), with the (whole) number R of the
    cell and the phase advance k per cell, one per axis. It obeys omega^2 q = D(k) q, D(k) = sum_R
    coupling_R exp(i k . R), coupling_R = M^{-1/2} K_R M^{-1/2}. Gyroscopic forces -C v add
    -i omega G(k) q on the right, G(k) = sum_R turning_R exp(i k . R) of the antisymmetric part of
    C; the symmetric part damps, and is left out.

    **Fields:** `cell`: sites along each axis. `shells`: the R of the neighbours, R = 0 included.
    `coupling`: (shells, P, P) [1/s^2]. `mass`: (P,), P = sites of the cell times fields times
    dimension. `damping`: M^{-1/2} C_R M^{-1/2}, (shells, P, P) [1/s], `None` without gyroscopic
    forces.
    """

    coupling: jax.Array
    mass: jax.Array
    cell: tuple[int, ...] = eqx.field(static=True)
    shells: tuple[tuple[int, ...], ...] = eqx.field(static=True)
    fields: tuple[str, ...] | None = eqx.field(static=True)
    dimension: int | None = eqx.field(static=True)
    damping: jax.Array | None = None
    __repr__ = told

    @property
    def turning(self) -> Numbers | None:
        """The antisymmetric part of the damping, (shells, P, P) [1/s], or `None`."""
        if self.damping is None:
            return None
        return (self.damping - self.damping[_opposite(self.shells)].swapaxes(1, 2)) / 2

    def dynamical_matrix(self, k: Numbers) -> ComplexNumbers:
        """Return D(k), (P, P), complex and Hermitian, for one `k` of shape (axes,)."""
        return bloch(self.coupling, self.shells, k)

    @property
    def scale(self) -> Number:
        """The largest entry of the coupling."""
        return jnp.abs(self.coupling).max()

    def gyration(self, k: Numbers) -> ComplexNumbers:
        """Return G(k), (P, P), anti-Hermitian, of a lattice with gyroscopic forces."""
        return bloch(self.turning, self.shells, k)

    def squares(self, k: Numbers) -> Numbers:
        """Return omega^2 of all bands at one k, (P,), rising."""
        D = self.dynamical_matrix(k)
        if self.damping is None:
            return eigvalsh(D)
        return turning.squares(D, self.gyration(k), self.scale)

    def waves(self, k: Numbers) -> tuple:
        """Return omega^2 (P,), rising, and normalised vectors q (P, P) at one k."""
        D = self.dynamical_matrix(k)
        if self.damping is None:
            return eigh(D)
        return turning.waves(D, self.gyration(k), self.scale)

    def displacements(self, q: AnyArray) -> Displacements:
        """Return M^{-1/2} q of vectors (..., P, bands), as `unpack_waves` does."""
        x = q / jnp.sqrt(self.mass)[:, None]
        return unpack_waves(x, self.cell, self.fields, self.dimension)


def by_sites(x: AnyArray, axes: int) -> AnyArray:
    """Reorder an array (cells..., cell..., width) by sites, (sites..., width)."""
    order = [i for pair in zip(range(axes), range(axes, 2 * axes)) for i in pair] + [2 * axes]
    counts = [x.shape[i] * x.shape[axes + i] for i in range(axes)]
    return x.transpose(order).reshape(counts + [x.shape[-1]])


def bloch(coupling: Numbers, shells: tuple, k: Numbers) -> ComplexNumbers:
    """Return sum_R coupling_R exp(i k . R), (P, P), for one `k` (axes,)."""
    uniform = coupling.sum(0)
    # exp(ix) - 1 = 2i sin(x/2) exp(ix/2), and a sum at k = 0 without rounding, keep long waves
    # accurate
    fixed = jax.lax.stop_gradient(uniform)
    rounding = (
        ROUNDING * jnp.finfo(fixed.dtype).eps * jnp.abs(jax.lax.stop_gradient(coupling)).max()
    )
    uniform = uniform - jnp.where(jnp.abs(fixed) <= rounding, fixed, 0)
    half = (np.array(shells) @ k) / 2
    turn = 2j * jnp.sin(half) * jnp.exp(1j * half)
    return uniform + jnp.einsum("r,rab->ab", turn, coupling)


def slopes(coupling: Numbers, shells: tuple, k: Numbers) -> tuple:
    """Return the first and second derivatives of `bloch`."""
    R = np.array(shells)
    phase = jnp.exp(1j * (R @ k))
    first = jnp.einsum("r,rj,rab->jab", 1j * phase, R, coupling)
    return first, -jnp.einsum("r,rj,rl,rab->jlab", phase, R, R, coupling)


@compiled
def matrices(matrix: Callable, points: Numbers) -> ComplexNumbers:
    """Evaluate a matrix at points (n, axes): (n, P, P)."""
    return jax.vmap(matrix)(points)


def chosen_bands(bands: Any, size: int) -> list[int]:
    """Return the requested bands as a sorted list."""
    given = [bands] if np.ndim(bands) == 0 else list(bands)
    given = [whole("band", b, -size) for b in given]
    numbers = sorted({b % size for b in given if b < size})
    if len(numbers) != len(given):
        wanted = f"whole numbers below {size}, each once"
        refuse("band", wanted, repr(bands), "Bands are counted from the lowest, 0.")
    return numbers


def phases(k: Numbers, axes: int) -> Numbers:
    """Return wave numbers as points (..., axes), of a chain from any shape; refuse others."""
    if axes == 1:
        return k[..., None]
    if k.ndim == 0 or k.shape[-1] != axes:
        refuse(
            "k",
            f"a last axis of length {axes}, one phase per axis of the lattice",
            f"shape {k.shape}",
        )
    return k


def unit_cell(lattice: Lattice, cell: Cell = None) -> UnitCell:
    """Return the unit cell of a lattice, a `UnitCell` with its dynamical matrix.

    The blocks of K = -d force/du at u = 0 are compared along each axis, around a whole ring. With
    walls or free ends, sites within reach of an end are ignored: the cell is that of the infinite
    lattice to which the interior belongs. Damping is left out.

    **Arguments:** `lattice`: one `Lattice`. `cell`: sites per unit cell, one number or one per
    axis; `None` finds the smallest period. Give it where `jit` or `vmap` traces masses or laws
    (not for `jax.grad` alone).

    **Raises** ValueError for a batch, modulated stiffness, gyroscopic forces, a lattice without a
    period (disorder, a defect, a taper), a `cell` that is no period, a lattice too short to tell,
    forces without an energy (K not symmetric).
    """
    return _one_cell(at_rest(lattice), cell)


def turning_cell(lattice: Lattice, cell: Cell = None) -> UnitCell:
    """As `unit_cell`, with gyroscopic forces."""
    still, turns = turning_at_rest(lattice)
    return _one_cell(still, cell, turns)


def damped_cell(lattice: Lattice, cell: Cell = None) -> UnitCell:
    """As `unit_cell`, with all forces that read velocities."""
    return _one_cell(turning_at_rest(lattice)[0], cell, damped=True)


def _one_cell(lattice, cell, damped=False):
    found = blocks_of(lattice, damped=damped)
    one = cut_out(lattice, found, given_cell(cell, grid(lattice)), found.rings)
    coupling = known_value(one.coupling)
    if coupling is not None and one_way(coupling, one.shells):
        refuse_one_way()
    return one


class Blocks(NamedTuple):
    """The `blocks` of a lattice, and its properties.

    `plain`: their lattice; `known`: whether it is the given one, or a `stand_in`; `reach` of the
    bonds along each axis; `rings`: whether they go around its ends; `size`: the largest entry of
    each map.
    """

    plain: Lattice
    known: bool
    reach: tuple[int, ...]
    found: AnyArray
    size: AnyArray
    mass: AnyArray
    rings: list[bool]
    __repr__ = told


def blocks_of(lattice: Lattice, ts: Any = (0.0,), damped: bool = False) -> Blocks:
    """Return the blocks of a lattice, or of its `stand_in`.

    The reach is what the terms say, doubled while the blocks miss part of the force.
    """
    plain, known = stand_in(lattice)
    sites = grid(plain)
    reach = _said(plain)
    ts = np.asarray(ts, plain.dtype)
    while True:
        found, size, missed, mass = concretely(blocks, plain, tuple(reach), ts, damped)
        if missed <= LOOSE * np.finfo(plain.dtype).eps:
            break
        further = [min(2 * r, (n - 1) // 2) for n, r in zip(sites, reach)]
        if further == reach:
            refuse(
                "lattice",
                "bonds that reach less than half of the lattice",
                "bonds across the whole lattice",
                "Use granjax.linear.normal_modes.",
            )
        reach = further
    reach = tuple(reach)
    there = np.abs(found).max((-1, -2))
    rings = [_is_ring(there, axis, reach) for axis in range(len(sites))]
    return Blocks(plain, known, reach, found, size, mass, rings)


def cut_out(lattice: Lattice, found: Blocks, given: tuple, rings: list[bool]) -> UnitCell:
    """Return the cell of `given` sites along each axis, the fewest for `None`."""
    cell, chosen = periods(found, rings, given)
    reach = found.reach
    mass = found.mass
    damped = len(found.size) > 1
    if traced(lattice):
        shells, maps, mass = assembled(lattice, cell, chosen, reach, damped=damped)
    else:
        shells, maps, mass = assemble(np, found.found, mass, cell, chosen, reach)
    coupling, *damping = (jnp.asarray(maps[..., i, 0]) for i in range(maps.shape[-2]))
    space = lattice.fields, lattice.dimension
    return UnitCell(coupling, jnp.asarray(mass), cell, shells, *space, *damping)


def given_cell(cell: Cell, sites: tuple) -> tuple:
    """Return the requested sites per cell along each axis."""
    if cell is None:
        return (None,) * len(sites)
    numbers = tuple(cell) if np.ndim(cell) else (cell,) * len(sites)
    if len(numbers) != len(sites):
        refuse("cell", f"{len(sites)} numbers, one per axis", repr(cell))
    return tuple(whole("cell", n, 1, "It is the number of sites per unit cell.") for n in numbers)


def _said(lattice):
    # the reach of bonds along each axis, as the terms say
    sites = grid(lattice)
    reach = [0 if all(span(term) == () for term in lattice.terms) else 1] * len(sites)
    for term in lattice.terms:
        for axis, further in enumerate(span(term) or ()):
            reach[axis] = max(reach[axis], further)
    # bonds may reach half way around a ring, where the block is shared by both directions; with
    # four sites or fewer a ring cannot be told from an open chain
    short = [axis for axis, (n, r) in enumerate(zip(sites, reach)) if n < 2 * r + (r < 3)]
    if short:
        n = sites[short[0]]
        r = reach[short[0]]
        refuse(
            "lattice",
            f"at least {2 * r + 1} sites along axis {short[0]}, where bonds reach {r}",
            f"{n}",
            "Build it longer: a wave to the left and one to the right are the same bond there.",
        )
    return reach


def _is_ring(found, axis, reach):
    # whether bonds go around the ends of one axis
    rows = np.moveaxis(found, axis, 0)[: reach[axis]]
    near = np.array(offsets(reach))[:, axis]
    return any(np.any(rows[n][..., near < -n, :, :] != 0) for n in range(len(rows)))


def periods(blocks: Blocks, rings: list, given: tuple) -> tuple:
    """Return the sites per cell along each axis, and those that represent the cell."""
    known = blocks.known
    mass = blocks.mass
    interior = [
        np.arange(n) if ring else np.arange(r, n - r)
        for n, r, ring in zip(mass.shape, blocks.reach, rings)
    ]
    parts = blocks.found / blocks.size[:, None], mass / mass.max()
    features = np.concatenate([x.reshape(x.shape[: mass.ndim - 1] + (-1,)) for x in parts], -1)
    features = features[np.ix_(*interior)]
    tolerance = TIGHT * np.finfo(mass.dtype).eps
    found = []
    chosen = []
    for axis, ring in enumerate(rings):
        rows = np.moveaxis(features, axis, 0).reshape(len(interior[axis]), -1)
        period = _repeats_after(rows, ring, tolerance, given[axis], known, axis)
        start = interior[axis][0]
        found.append(period)
        chosen.append(tuple(int(start + (j - start) % period) for j in range(period)))
    return tuple(found), tuple(chosen)


def _repeats_after(rows, ring, tolerance, given, known, axis):
    # after how many rows, one per place along an axis, the rows repeat
    size = len(rows)

    def repeats(p):
        after = np.roll(rows, -p, 0) if ring else rows[p:]
        return not np.any(np.abs(after - rows[: len(after)]) > tolerance)

    if given is not None:
        if given > size or (ring and size % given):
            kind = (
                f"a divisor of {size}, the ring's sites"
                if ring
                else f"at most {size}, the sites off the ends,"
            )
            refuse("cell", f"{kind} along axis {axis}", f"{given}")
        if known and not repeats(given):
            refuse(
                "cell",
                f"a period of the lattice along axis {axis}",
                f"{given}, after which it does not repeat",
                "Leave `cell` out to have the period found; a lattice with none has granjax.linear.normal_modes.",
            )
        return given
    if not known:
        refuse(
            "cell",
            "the number of sites per unit cell, as masses or laws are traced",
            "None",
            "Write cell=1 for a chain of equal beads, cell=2 for a dimer.",
        )
    for p in range(1, size // 2 + 1):
        if (
            (not ring or size % p == 0)
            and not np.any(np.abs(rows[p] - rows[0]) > tolerance)
            and repeats(p)
        ):
            return p
    refuse(
        "lattice",
        f"a lattice that repeats along axis {axis}",
        "one without a period (disorder, a defect, a taper, or fewer than two cells off the ends)",
        "Use granjax.linear.normal_modes, build it longer, or give cell=... to repeat it as one large cell.",
    )


@eqx.filter_jit
def assembled(
    lattice: Lattice,
    cell: tuple,
    chosen: tuple,
    reach: tuple,
    t: Number = 0.0,
    damped: bool = False,
) -> tuple:
    """As `assemble`, at one time, of a lattice that may be traced."""
    own, _, _, mass = blocks(lattice, reach, jnp.asarray(t, lattice.dtype)[None], damped)
    return assemble(jnp, own, mass, cell, chosen, reach)


def assemble(
    xp: Any, own: AnyArray, mass: AnyArray, cell: tuple, chosen: tuple, reach: tuple
) -> tuple:
    """Turn blocks between sites into blocks between cells over the masses.

    Returns the R of the neighbours, the coupling (shells, P, P, maps, times), and the masses.
    """
    at = np.ix_(*chosen)
    width = mass.shape[-1]
    rest = own.shape[-2:]
    home = np.indices(cell).reshape(len(cell), -1).T
    near = np.array(offsets(reach))
    target = home[:, None] + near
    shells, number = np.unique((target // cell).reshape(-1, len(cell)), axis=0, return_inverse=True)
    there = np.ravel_multi_index(np.moveaxis(target % cell, -1, 0), cell)
    rows = own[at].reshape(-1, width, width, *rest)
    # one block for every pair of sites in two cells: the last one, zero, where there is no bond
    source = np.full((len(shells), len(home), len(home)), len(rows))
    number = number.reshape(there.shape)
    source[number, np.arange(len(home))[:, None], there] = np.arange(len(rows)).reshape(there.shape)
    every = xp.concatenate([rows, xp.zeros((1, *rows.shape[1:]), rows.dtype)])[source]
    size = len(home) * width
    mass = mass[at].reshape(size)
    over = xp.sqrt(mass[:, None] * mass)[..., None, None]
    coupling = xp.swapaxes(every, 2, 3).reshape(len(shells), size, size, *rest) / over
    return tuple(tuple(int(n) for n in R) for R in shells), coupling, mass


def _opposite(shells):
    # the indices of -R
    return np.array([shells.index(tuple(-n for n in R)) for R in shells])


def one_way(coupling: AnyArray, shells: tuple) -> bool:
    """Whether forces have no energy: K_R is not the transpose of K_{-R}."""
    uneven = np.abs(coupling - coupling[_opposite(shells)].swapaxes(1, 2)).max()
    return bool(uneven > TIGHT * np.finfo(coupling.dtype).eps * np.abs(coupling).max())


def by_lanes(result: Any, x: AnyArray) -> AnyArray:
    """Return a field with its lanes as one leading axis, of length 1 for one lattice."""
    sites, components = result._space
    x = np.asarray(x)
    mark = np.shape(result._mark)
    own = sites + (components > 0)
    count = len(mark) - own
    if mark[count:] != (1,) * own or x.shape[:count] != mark[:count]:
        x = np.moveaxis(x, range(x.ndim - count, x.ndim), range(count))
    return x.reshape(-1, *x.shape[count:])


def in_lanes(result: Any) -> str:
    """Return the number of lanes in words, empty for one."""
    lanes = np.size(result._mark)
    return f" in each of {lanes} lanes" if lanes > 1 else ""


def along_waves(result: Any, held: Held) -> Held:
    """Give a field of bands as many wave axes as `k` has."""
    count = by_lanes(result, result.omega).ndim - 2
    wave = " ".join(["wave", *(f"wave_{i}" for i in range(1, count))][:count])
    return held._replace(axes=held.axes and held.axes.replace("wave", wave))
