"""Where Newton's method may start: the envelope's bright and dark breathers, sites that oscillate alone."""

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import brentq

from ..checks import refuse
from ..flow import Flow
from ..lattice import Lattice, State
from ..laws import taylor
from ..linear import bands
from ..linear.cell import unit_cell
from ..newton import newton
from ..solvers import KahanLi8
from ..theory import nls
from ..types import Count, Scalar
from .families import checked_lattice
from .symmetry import shifts

# relative distance in omega below which a frequency is an edge's
AT_EDGE = 1e-9
NO_CELL = "None or a State (such as guesses.single_site gives) for this lattice"
# distance of an extremum's k from 0 or pi
SAME_K = 1e-6
# of an iteration that contracts by the dips' share of the chain
ROUNDS = 30
HALF_STEPS, PARTS, GROW, LARGEST = 128, 16, 1.25, 1e4


class Edge(NamedTuple):
    """An edge of a band: its place, the envelope's coefficients there, and whether its bright breathers lie at omega.

    `above`: whether the gap lies above the edge.
    """

    k: float
    branch: int
    omega: float
    above: bool
    coefficients: nls.Coefficients


def cell_of(lattice: Lattice) -> tuple | None:
    """(mass, K2, K3, K4) of the unit cell of a chain of next neighbours, (P,) each, or `None` where it is none."""
    found = lattice.terms[0].next_neighbours() if len(lattice.terms) == 1 else None
    if found is None or lattice.fields or lattice.axes != 1 or lattice.dimension:
        return None
    law, boundary = found
    try:
        (size,) = unit_cell(lattice).cell
    except ValueError:
        return None
    coefficients = taylor(law)
    if not np.all(np.asarray(coefficients.K2) > 0):
        return None
    (sites,) = lattice.sites
    left = 1 if boundary == "fixed" else 0
    mass = np.broadcast_to(np.asarray(lattice.mass), (sites,))[:size]
    parts = [np.asarray(x) if np.ndim(x) == 0 else np.asarray(x)[left : left + size] for x in coefficients]
    return mass, *(np.broadcast_to(x, (size,)) for x in parts)


def edges_beside(lattice: Lattice, omega: Scalar) -> list[Edge]:
    """The edges of the gap that holds omega, as `Edge`s; none inside a band or where there is no unit cell."""
    cell = cell_of(lattice)
    if cell is None:
        return []
    found = bands(lattice)
    lower, upper = np.asarray(found.lower), np.asarray(found.upper)
    if np.any((lower * (1 + AT_EDGE) < omega) & (omega < upper * (1 - AT_EDGE))):
        return []
    edges = [(k, b, w, True) for b, (k, w) in enumerate(zip(np.ravel(found.upper_k), upper)) if w <= omega]
    edges = edges[-1:] + [
        (k, b, w, False) for b, (k, w) in enumerate(zip(np.ravel(found.lower_k), lower)) if w >= omega > 0][:1]
    edges = [(_at_symmetry(k), b, float(w), above) for k, b, w, above in edges]
    return [Edge(k, b, w, above, nls.coefficients(*cell, k, b)) for k, b, w, above in edges]


def _at_symmetry(k):
    """0 or pi itself where an extremum, known to the root of rounding, lies there."""
    near = np.pi * round(float(k) / np.pi)
    return near if abs(k - near) < SAME_K else float(k)


def supports_bright(edge: Edge) -> bool:
    """Whether a bright breather leaves this edge into the gap: focusing, and its frequency shifts that way."""
    c = edge.coefficients
    return bool(c.focusing) and (float(c.nu3_force) > 0) == edge.above


def edge_of(lattice: Lattice, omega: Scalar, kind: str) -> Scalar:
    """Frequency of the edge from which the bright or dark breathers at omega come."""
    if kind == "dark":
        upper = np.asarray(bands(lattice).upper)
        return float(upper[np.argmin(np.abs(upper - omega))])
    found = [edge.omega for edge in edges_beside(lattice, omega) if supports_bright(edge)]
    return min(found, key=lambda edge: abs(edge - omega)) if found else omega


def bright_guess(lattice: Lattice, omega: Scalar, centre: Scalar | None = None) -> State:
    """The envelope's bright breather of a chain at a frequency in a gap, `State` at rest.

    **Raises** ValueError where no edge of that gap has one.
    """
    if cell_of(lattice) is None:
        refuse("guess", NO_CELL, "'bright'", "The envelope equation needs a periodic chain of bonds alone.")
    found = [edge for edge in edges_beside(lattice, omega) if supports_bright(edge)]
    if not found:
        refuse_bright(lattice, omega)
    edge = min(found, key=lambda edge: abs(edge.omega - omega))
    return _state(lattice, nls.bright_profile, edge.coefficients, omega, centre)


def dark_guess(lattice: Lattice, omega: Scalar, centre: Scalar | None = None) -> State:
    """The envelope's dark breather below the highest edge of a band, `State` at rest, N bonds wide.

    Ends at constant force (free) or at fixed length (walls, a ring) as the chain has them. **Raises** ValueError where
    the edge above omega has no dark breathers, and for a lattice that is no periodic chain of next neighbours.
    """
    cell = cell_of(lattice)
    if cell is None:
        refuse("guess", NO_CELL, "'dark'", "The envelope equation needs a periodic chain of bonds alone.")
    found = bands(lattice)
    tops = [(b, float(w), float(k)) for b, (w, k) in enumerate(zip(found.upper, np.ravel(found.upper_k)))]
    branch, _, k = min(tops, key=lambda top: abs(top[1] - omega))
    k = _at_symmetry(k)
    constraint = "force" if lattice.terms[0].next_neighbours()[1] == "free" else "length"
    coefficients = nls.coefficients(*cell, k, branch, constraint)
    if constraint == "length":
        coefficients = _held(coefficients, omega, lattice.sites[0] / len(coefficients.mode))
    return _state(lattice, nls.dark_profile, coefficients, omega, centre)


def _held(c, omega, cells):
    """Coefficients of a background in a chain of fixed length that is not infinite.

    The mean of |Y|^2 over the chain, which sets its mean strain, lacks the dip and a second one, at the walls or where
    a ring closes: r = 1 - 4/(inverse width * cells) of the background's.
    """
    r, kappa = 1.0, omega - c.omega
    effective = lambda r: c.nu3_force + r * (c.nu3 - c.nu3_force)
    for _ in range(ROUNDS):
        width = jnp.sqrt(jnp.abs(c.nu3_force * kappa / (2 * c.nu2 * effective(r))))
        r = jnp.maximum(1 - 4 / (width * cells), 0.0)
    strain = c.mean_strain_force + r * (c.mean_strain - c.mean_strain_force)
    return eqx.tree_at(lambda c: (c.nu3, c.mean_strain), c, (effective(r), strain))


def _state(lattice, profile, coefficients, omega, centre):
    (sites,) = lattice.sites
    cells = -(-sites // len(coefficients.mode))
    centre = (sites - 1) / 2 if centre is None else centre
    u = profile(coefficients, omega, cells, centre).displacement[:sites]
    return State(u, jnp.zeros_like(u))


def refuse_bright(lattice: Lattice, omega: Scalar) -> None:
    """Say why a chain has no bright breather at a frequency."""
    edges = edges_beside(lattice, omega)
    said = []
    for edge in edges:
        c = edge.coefficients
        name = "B" if len(c.mode) == 1 else "nu3"
        nu2, nu3 = float(c.nu2), float(c.nu3_force)
        relation = "<" if nu3 < 0 else ">"
        what = f"{name} = {nu3:.6g} {relation} 0 with nu2 = {nu2:.6g} at omega = {edge.omega:.6g}"
        said.append(f"{what}: only dark" if not c.focusing else f"{what}: bright, but on the other side of the edge")
    remedy = "; ".join(said) if said else "No gap holds this frequency."
    refuse("omega", "a frequency at which bright breathers exist", f"{omega:.6g}", remedy + ".")


def single_site(
    lattice: Lattice, omega: Scalar, sites: Count | Sequence, *, amplitudes: Sequence | None = None,
    least: Scalar = 1e-3,
) -> State:
    r"""The breather of the anticontinuous limit: the named sites oscillate at omega, all others stand still.

    For weakly coupled sites with an on-site potential, and for light beads between heavy ones (mass ratio -> 0), where
    it is the orbit itself. With S the named sites,

        m u'' = F(u) in S, u = const elsewhere;  v_S(0) = v_S(pi/omega) = 0,  mean of F over a period = 0 outside S:

    an asymmetric bond of a moving site pushes its neighbours to another place, by an amount that does not vanish with
    the mass ratio. Each site alone between neighbours at rest is the first guess; Newton's method does the rest.

    **Arguments:** `lattice`: a chain with scalar displacements. `omega`. `sites`: an index or several. `amplitudes`:
    signs +-1, one a site, for multibreathers (None: all +1, in phase). `least`: smallest amplitude tried, in the unit
    of u.

    **Returns:** a `State` at rest. **Raises** ValueError where no amplitude has that frequency (omega is on the wrong
    side of the site's linear frequency); RuntimeError where Newton's method does not converge.
    Source: MacKay, Aubry, Nonlinearity 7, 1623 (1994); Livi, Spicci, MacKay, Nonlinearity 10, 1421 (1997).
    """
    checked_lattice(lattice)
    if isinstance(lattice.shape, dict) or len(lattice.shape) != 1:
        refuse("lattice", "a chain with scalar displacements", f"shape {lattice.shape}")
    sites = np.atleast_1d(sites)
    signs = np.ones(len(sites)) if amplitudes is None else np.sign(amplitudes)
    u, moving = np.zeros(lattice.shape), np.zeros(lattice.shape)
    for site, sign in zip(sites, signs):
        u[site], moving[site] = sign * _amplitude(lattice, omega, int(site), float(sign), least), 1
    return State(_together(lattice, omega, u, moving), jnp.zeros(lattice.shape))


def _others_held(t, y, scene):
    """The motion of the sites where `moving` is 1, the others held."""
    (u, v), (lattice, moving) = y, scene
    return v, moving * lattice.acceleration(t, u, jnp.zeros_like(u))


@eqx.filter_jit
def _path(lattice, moving, u, half):
    """(u, v) from rest at u to the half period, at equal distances, the beginning left out."""
    flow, part = Flow(HALF_STEPS // PARTS, KahanLi8(), _others_held), half / PARTS

    def go(y, i):
        y = flow(y, i * part, (i + 1) * part, (lattice, moving))
        return y, y

    return jax.lax.scan(go, (u, jnp.zeros_like(u)), jnp.arange(PARTS))[1]


def _mean_forces(us, u, scene):
    """Of every site over a period, by the trapezoidal rule over half of it: exact but for high harmonics."""
    still = jnp.zeros_like(u)
    forces = jax.vmap(lambda u: scene.mass * scene.acceleration(0.0, u, still))(jnp.concatenate([u[None], us]))
    return (forces[0] / 2 + forces[1:-1].sum(0) + forces[-1] / 2) / PARTS


def _together(lattice, omega, u, moving):
    """Displacements at rest of the whole limit, from each site alone."""
    free, half = np.asarray(shifts(lattice)), np.pi / omega
    stiff = float(np.max(np.asarray(lattice.mass) * moving)) * omega**2

    def residual(x, scene):
        us, vs = _path(scene, jnp.asarray(moving), x, half)
        rest = jnp.where(moving, vs[-1] / omega, _mean_forces(us, x, scene) / stiff)
        # forces say nothing of a uniform displacement: it stays zero
        return rest + free @ (free.T @ jnp.where(moving, 0, x))

    scale = np.abs(u).max()
    return newton(residual, jnp.asarray(u), lattice, tolerance=1e-11 * scale).x


def _amplitude(lattice, omega, site, sign, least):
    half, one = np.pi / omega, np.eye(lattice.shape[0])[site]

    def velocities(a):
        """On the way, negative until the first return to rest."""
        return sign * np.asarray(_path(lattice, jnp.asarray(one), jnp.asarray(sign * a * one), half)[1])[:, site]

    gap = lambda a: velocities(a)[-1]
    low, before = least, gap(least)
    while low < LARGEST:
        high = low * GROW
        now = gap(high)
        if not np.isfinite(now):
            break
        if before * now <= 0:
            try:
                found = brentq(gap, low, high, xtol=1e-14, rtol=1e-14)
            except ValueError:  # not finite on the way
                break
            # a later return belongs to a faster motion
            if np.all(velocities(found)[:-1] < 0):
                return found
        low, before = high, now
    refuse("omega", "a frequency that the site alone can have", f"{omega:.6g}",
           "It lies on the wrong side of the site's linear frequency: amplitude shifts it the other way.")
