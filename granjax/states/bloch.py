"""Packets of Bloch waves, in chains with several sites per cell and in the plane."""

import jax.numpy as jnp
import numpy as np

from ..base.checks import one_of, parameter, positive, refuse, traced
from ..base.programs import compiled
from ..base.types import Amplitudes, Count, Parameter
from ..lattice import Lattice, State
from ..linear.cell import by_sites, chosen_bands, matrices, unit_cell
from ..linear.stiffness import grid, mesh, unpack
from ..linear.zone import lattice_vectors, named_points

# the difference of omega^2, over the largest omega^2, up to which bands meet
MEET = 1e-9
# the size of a negative omega^2, over the largest, up to which it is rounding
ROUNDING = 1e-12


def bloch_packet(
    lattice: Lattice,
    k: Parameter | str,
    width: Parameter,
    *,
    band: Count | tuple[Count, ...] | None = None,
    polarisation: Parameter | Amplitudes | dict[str, Parameter | Amplitudes] | None = None,
    centre: Parameter | None = None,
    amplitude: Parameter = 0.01,
) -> State:
    r"""Return a Gaussian packet of Bloch waves that runs one way, in a chain or in the plane.

    u(R) = Re a p exp(-|r_R - c|^2/(2 w^2) + i k . R), with the cell's number R and place r_R, and
    the displacements p of a cell's sites. The velocities are v = Re -i Omega u, Omega^2 = D: exact
    for the linear lattice taken as a ring, if the packet is five widths from the ends.

    At a Dirac point a p on one kind of site excites both cones equally. The packet becomes a ring
    that grows at the cone's speed, conical diffraction (`gx.measures.energy_radius`).

    **Arguments:**

    - `k`: phases per cell (axes,) [rad], a number for a chain; or the name of a point of the zone,
      "K".
    - `width`: w, well above the spacing; `centre`: c, `None` for the middle. In the unit of the
      lattice's positions [m], c of shape (d,); without positions in cells, c of shape (axes,).
    - `band`: one or several, from 0, on which the packet is projected at every wave number; `None`
      for all. By default p is the wave of the first at k.
    - `polarisation`: p, (cell..., [vector]) or a dict of such, complex or real, scaled to a largest
      component of one; not needed with `band` or one number per cell.
    - `amplitude`: a [m], before the projection.

    **Returns:** `State`; differentiable in `amplitude`, `width` and `centre`. Typical: w = 5 ... 15
    spacings.
    **Raises** ValueError for traced lattices, bands that meet at k without a polarisation, and a
    lattice that is unstable at rest, has no period or has lanes.
    Source: Peleg, Bartal, Freedman, Manela, Segev, Christodoulides, Phys. Rev. Lett. 98, 103901
    (2007).
    """
    if traced((lattice, k, polarisation)):
        refuse(
            "lattice",
            "a lattice, k and polarisation that are known",
            "traced ones",
            "Differentiate by amplitude, width or centre; bands that meet have no derivative.",
        )
    found = unit_cell(lattice)
    axes = len(found.cell)
    sites = grid(lattice)
    size = found.mass.size
    if any(n % c for n, c in zip(sites, found.cell)):
        refuse("lattice", f"whole cells of {found.cell}", f"{sites} sites")
    counts = tuple(n // c for n, c in zip(sites, found.cell))
    vectors = lattice_vectors(lattice, found.cell)
    if isinstance(k, str):
        known = named_points(vectors, axes)
        k = known[one_of("k", k, known)]
    k = np.asarray(parameter("k", k), float).reshape(axes)
    ring = mesh(*(2 * np.pi * np.fft.fftfreq(n) for n in counts))
    squared, waves = np.linalg.eigh(matrices(found.dynamical_matrix, ring.reshape(-1, axes)))
    scale = np.abs(squared).max()
    if squared.min() < -ROUNDING * scale:
        refuse(
            "lattice",
            "one that is stable at rest",
            "omega^2 below zero",
            "Its packet would grow, not run.",
        )
    bands = None if band is None else chosen_bands(band, size)
    start = _polarisation(found, k, band, polarisation, scale)
    # the place of a cell is that of its first site, or without positions its number
    place = mesh(*map(np.arange, counts)).astype(float)
    if vectors is not None:
        first = lattice.positions
        first = next(iter(first.values())) if isinstance(first, dict) else first
        place = place @ vectors + np.asarray(first)[(0,) * axes]
    middle = place.reshape(-1, place.shape[-1]).mean(0)
    c = jnp.broadcast_to(parameter("centre", middle if centre is None else centre), middle.shape)
    envelope = jnp.exp(-jnp.sum((place - c) ** 2, -1) / (2 * positive("width", width) ** 2))
    phase = np.exp(1j * mesh(*map(np.arange, counts)) @ k)
    packet = parameter("amplitude", amplitude) * envelope * phase
    waves = waves.reshape(*counts, size, size)
    u, v = _run(packet, start, squared.reshape(*counts, size), waves, bands)

    def on_sites(x):
        x = by_sites((x / jnp.sqrt(found.mass)).reshape(counts + found.cell + (-1,)), axes)
        return unpack(x.astype(lattice.dtype), found.fields, found.dimension)

    return State(on_sites(u), on_sites(v))


def _polarisation(found, k, band, given, scale):
    size = found.mass.size
    root = np.sqrt(np.asarray(found.mass))
    if given is not None:
        parts = [given[name] for name in sorted(found.fields)] if found.fields else [given]
        sites = int(np.prod(found.cell))
        p = np.concatenate([np.asarray(x).reshape(sites, -1) for x in parts], -1).ravel()
        if p.shape != (size,) or not 0 < np.abs(p).max() < np.inf:
            wanted = f"{size} displacements of a cell that are not all zero"
            refuse("polarisation", wanted, repr(given))
        return root * p / np.abs(p).max()
    if band is None and size == 1:
        return root
    if band is None:
        refuse(
            "polarisation",
            f"the displacements of a cell, or band=0 ... {size - 1}",
            "None",
            f"This lattice has {size} bands.",
        )
    squared, q = np.linalg.eigh(matrices(found.dynamical_matrix, k[None])[0])
    first = band if np.ndim(band) == 0 else band[0]
    others = np.flatnonzero(np.abs(squared - squared[first]) <= MEET * scale)
    if len(others) > 1:
        refuse(
            "polarisation",
            f"which of the waves of bands {others.tolist()}",
            "None",
            "They meet at k; give the displacements of a cell.",
        )
    p = q[:, first] / root
    return root * p / p[np.argmax(np.abs(p))]


@compiled
def _run(packet, start, squared, waves, bands):
    axes = tuple(range(packet.ndim))
    spectrum = jnp.fft.fftn(packet, axes=axes)[..., None] * start
    parts = jnp.einsum("...ab,...a->...b", waves.conj(), spectrum)
    if bands is not None:
        parts = jnp.where(np.isin(np.arange(parts.shape[-1]), bands), parts, 0)
    omega = jnp.sqrt(jnp.maximum(squared, 0))
    back = lambda x: jnp.real(jnp.fft.ifftn(jnp.einsum("...ab,...b->...a", waves, x), axes=axes))
    return back(parts), back(-1j * omega * parts)
