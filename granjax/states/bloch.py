"""Packets of Bloch waves, on chains with several sites per cell and in the plane."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..checks import concrete, one_of, parameter, positive, refuse, show, traced, whole
from ..lattice import Lattice, State
from ..linear.cell import by_sites, unit_cell
from ..linear.stiffness import grid, unpack
from ..linear.zone import lattice_vectors, named_points
from ..types import Cell, Count, Parameter

# bands that are nearer than this share of the largest omega^2 meet, and a root of less below zero is rounding
MEET, ROUNDING = 1e-9, 1e-12


def bloch_packet(
    lattice: Lattice,
    k: Parameter | str,
    width: Parameter,
    *,
    band: Count | tuple[Count, ...] | None = None,
    polarisation: Parameter | dict[str, Parameter] | None = None,
    centre: Parameter | None = None,
    amplitude: Parameter = 0.01,
    cell: Cell | None = None,
) -> State:
    r"""A Gaussian packet of Bloch waves, which runs as the linear lattice has it: in chains of any cell, in the plane.

    u(R) = Re a p exp(-|r_R - c|^2/(2 w^2) + i k . R), with R the number of a cell, r_R its place and p what a cell's
    sites do. The velocities are those of waves exp(-i omega t) alone, v = Re -i Omega u with Omega^2 = D: of the
    linear lattice taken as a ring it is exact, as long as the packet is far from the ends (five widths).

    At a Dirac point p = one kind of site belongs to both cones alike: the packet becomes a ring whose radius grows with
    the cone's speed, conical diffraction, of which `gx.measures.energy_radius` tells the size.

    **Arguments:**

    - `k`: phases per cell (axes,) [rad], a number for a chain; or a point of the zone by its name, "K".
    - `width`: w, well above the spacing; `centre`: c. In the unit of the lattice's positions [m], c of shape (d,); in
      cells, c of shape (axes,), where it has none. `None` is the middle.
    - `band`: from 0 upwards, or several: the packet is projected on these at every wave number, and p is the wave of
      the first at k. `polarisation`: p, (cell..., [vector]) or a dict of such, complex or real; `None` where a band or
      the lattice (one number per cell) says it. With a polarisation alone all bands that it excites run.
    - `amplitude`: a [m], the largest component of p before the projection is one. `cell`: as in `gx.linear.unit_cell`.

    **Returns:** `State`; differentiable in `amplitude`, `width` and `centre`. **Raises** ValueError for traced lattices
    (bands that meet have no derivative), bands that meet at k without a polarisation, a lattice that is unstable at
    rest, and where `unit_cell` does: no period, lanes. Typical: w = 5 ... 15 spacings.
    Source: Peleg, Bartal, Freedman, Manela, Segev, Christodoulides, Phys. Rev. Lett. 98, 103901 (2007).
    """
    if traced((lattice, k, polarisation)):
        refuse(
            "lattice",
            "a lattice, k and polarisation that are known",
            "traced ones",
            "Differentiate by amplitude, width or centre; bands that meet have no derivative.",
        )
    found = unit_cell(lattice, cell)
    axes, sites = len(found.cell), grid(lattice)
    if any(n % c for n, c in zip(sites, found.cell)):
        refuse("lattice", f"whole cells of {found.cell}", f"{sites} sites")
    counts = tuple(n // c for n, c in zip(sites, found.cell))
    vectors = lattice_vectors(lattice, found.cell) if lattice.positions is not None else None
    k = _point(k, vectors, axes)
    ring = np.meshgrid(*(2 * np.pi * np.fft.fftfreq(n) for n in counts), indexing="ij")
    squared, waves = _waves(found, jnp.stack(ring, -1))
    scale = float(jnp.abs(squared).max())
    if float(squared.min()) < -ROUNDING * scale:
        refuse(
            "lattice",
            "one that is stable at rest",
            "omega^2 below zero",
            "Its packet would grow, not run.",
        )
    bands = _chosen(band, squared.shape[-1])
    start = _polarisation(found, k, bands, polarisation, scale)
    place = _cells(lattice, found.cell, counts, vectors)
    c = parameter(
        "centre", place.reshape(-1, place.shape[-1]).mean(0) if centre is None else centre
    )
    if np.ndim(c) == 0 and place.shape[-1] == 1:
        c = c.reshape(1)
    if c.shape != place.shape[-1:]:
        refuse("centre", f"a point, shape {place.shape[-1:]}", f"shape {c.shape}")
    envelope = jnp.exp(-jnp.sum((place - c) ** 2, -1) / (2 * positive("width", width) ** 2))
    phase = np.exp(1j * np.tensordot(np.moveaxis(np.indices(counts), 0, -1), k, 1))
    amplitude = parameter("amplitude", amplitude)
    u, v = _run(amplitude * envelope * phase, start, squared, waves, bands)
    sites_in_cells = counts + found.cell + (-1,)

    def on_sites(x):
        x = by_sites((x / jnp.sqrt(found.mass)).reshape(sites_in_cells), axes)
        return unpack(x.astype(lattice.dtype), found.fields, found.dimension)

    return State(on_sites(u), on_sites(v))


def _point(k, vectors, axes):
    """Phases per cell (axes,)."""
    if isinstance(k, str):
        known = named_points(vectors, axes)
        return known[one_of("k", k, known)]
    k = np.atleast_1d(np.asarray(parameter("k", k), float))
    if k.shape != (axes,):
        refuse("k", f"{axes} phases, one per axis of the lattice", f"shape {k.shape}")
    return k


@eqx.filter_jit
def _waves(found, k):
    matrices = jax.vmap(found.dynamical_matrix)(k.reshape(-1, k.shape[-1]))
    squared, vectors = jnp.linalg.eigh(matrices)
    return squared.reshape(k.shape[:-1] + squared.shape[1:]), vectors.reshape(
        k.shape[:-1] + vectors.shape[1:]
    )


def _chosen(band, size):
    """Which bands there are, or `None` for all."""
    if band is None:
        return None
    numbers = [whole("band", b, 0) for b in (band if isinstance(band, tuple) else (band,))]
    if len(set(numbers)) < len(numbers) or max(numbers) >= size:
        refuse(
            "band",
            f"whole numbers below {size}, each once",
            repr(band),
            "Bands are counted from 0.",
        )
    return tuple(numbers)


def _polarisation(found, k, bands, given, scale):
    """q = M^{1/2} p of the largest displacement 1, (P,)."""
    size, root = found.mass.size, np.sqrt(np.asarray(found.mass))
    if given is not None:
        return root * _given_polarisation(found, given)
    if bands is None and size == 1:
        return root * np.ones(1)
    if bands is None:
        refuse(
            "polarisation",
            f"the displacements of a cell, or band=0 ... {size - 1}",
            "None",
            f"This lattice has {size} bands.",
        )
    squared, q = (np.asarray(x) for x in _waves(found, jnp.asarray(k)[None]))
    first, apart = bands[0], np.abs(squared[0] - squared[0, bands[0]])
    others = [n for n in range(size) if n != first and apart[n] <= MEET * scale]
    if others:
        refuse(
            "polarisation",
            f"which of the waves of bands {sorted([first, *others])}",
            "None",
            "They meet at k; give the displacements of a cell.",
        )
    p = q[0, :, first] / root
    return root * p / p[np.argmax(np.abs(p))]


def _given_polarisation(found, given):
    names = sorted(found.fields) if found.fields else None
    vector = () if found.dimension is None else (found.dimension,)
    wanted = found.cell + vector
    parts = []
    for name, x in [(n, given[n]) for n in names] if names else [(None, given)]:
        x = np.asarray(x)
        called = "polarisation" if name is None else f"polarisation[{name!r}]"
        if x.size != int(np.prod(wanted)) or not np.all(np.isfinite(x)):
            refuse(
                called,
                f"finite numbers of shape {wanted}",
                f"shape {x.shape}" if x.size < 9 else show(x),
            )
        parts.append(x.reshape((int(np.prod(found.cell)),) + ((-1,) if vector else (1,))))
    p = np.concatenate(parts, -1).reshape(-1)
    largest = np.abs(p).max()
    if not largest > 0:
        refuse("polarisation", "displacements that are not all zero", "zeros")
    return p / largest


def _cells(lattice, cell, counts, vectors):
    """Places of the cells, (cells..., d): of their first sites, or their numbers."""
    numbers = np.moveaxis(np.indices(counts), 0, -1).astype(float)
    if vectors is None:
        return numbers
    first = (
        next(iter(lattice.positions.values()))
        if isinstance(lattice.positions, dict)
        else lattice.positions
    )
    return numbers @ vectors + np.asarray(concrete(first))[(0,) * len(counts)]


@eqx.filter_jit
def _run(packet, start, squared, waves, bands):
    """M^{1/2} u and M^{1/2} v of cells (cells..., P): the packet's waves exp(-i omega t)."""
    axes = tuple(range(packet.ndim))
    spectrum = jnp.fft.fftn(packet, axes=axes)[..., None] * start
    parts = jnp.einsum("...ab,...a->...b", waves.conj(), spectrum)
    if bands is not None:
        parts = jnp.where(np.isin(np.arange(parts.shape[-1]), bands), parts, 0)
    omega = jnp.sqrt(jnp.maximum(squared, 0))
    back = lambda x: jnp.real(jnp.fft.ifftn(jnp.einsum("...ab,...b->...a", waves, x), axes=axes))
    return back(parts), back(-1j * omega * parts)
