"""Lattices of the plane: the network of forces, angular momentum, what slips, how far waves have come."""

from typing import ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..checks import parameter, positive, refuse, traced
from ..entry import checked
from ..lattice import Lattice
from ..printing import told
from ..results import Held, Result
from ..types import Cell, Count, Number, Numbers, Parameter, Scalar, StateLike
from .states_of import parts


class ForceNetwork(NamedTuple):
    """The bonds of a lattice at a state: `segments` (bonds, 2, d), where they are [m]; `force` (bonds,) in each [N]."""

    segments: jax.Array
    force: jax.Array
    __repr__ = told


def _places(lattice, what):
    if lattice.positions is None:
        refuse("lattice", f"a lattice with positions, for {what}", "one without",
               "The scenes of the plane have them; gx.Lattice(..., positions=...).")
    if lattice.lanes:
        refuse("lattice", "one lattice", f"a batch with lanes {lattice.lanes}", "Take one lane.")
    return lattice.positions


@checked
def force_network(lattice: Lattice, y: StateLike, t: Number = 0.0) -> ForceNetwork:
    """Where the bonds are and what force each carries, total and positive in compression: for `gx.plots.beads`.

    Bonds around a ring, of which only one end is where the bond is, are drawn from their tail; of scalar displacements
    they are left out. **Raises** ValueError for a lattice without positions, or a batch.
    """
    places = _places(lattice, "a picture of its bonds")
    u, _ = parts(lattice, y, t)
    if traced((u, t, places)):
        refuse("y", "a state that is known", "a traced one", "Pictures are made of numbers: leave jit and vmap.")
    segments, forces = [], []
    for term in lattice.terms:
        for ends, contact in zip(term.ends(places, u), term.compressions(t, u)):
            if ends is not None:
                d = ends[0].shape[-1]
                segments.append(jnp.stack(ends, -2).reshape(-1, 2, d))
                forces.append(jnp.broadcast_to(contact.force, ends[0].shape[:-1]).reshape(-1))
    if not segments:
        refuse("lattice", "bonds whose ends are known", "none")
    lines, force = jnp.concatenate(segments), jnp.concatenate(forces)
    length = jnp.linalg.norm(lines[:, 1] - lines[:, 0], axis=-1)
    # a bond between numbers, not vectors, that goes around a ring
    short = length < 2.5 * jnp.nanmin(length)
    return ForceNetwork(lines[short], force[short])


@checked
def angular_momentum(
    lattice: Lattice, y: StateLike, t: Number = 0.0, *, centre: Parameter = (0.0, 0.0), radius: Scalar | None = None,
) -> Number:
    r"""Angular momentum about a point of the plane: sum m (r - c) x v, and m_theta R s' of beads that turn.

    r = position + u; of a bead with the displacement s = R theta its own part is (I/R^2) R s'.

    **Arguments:** `centre`: c (2,) [m]; `radius`: R [m] of beads that turn. **Returns:** a number [kg m^2/s]; it stays
    in a lattice with free ends, whose bonds push along themselves and slip nowhere under a rotation. **Raises**
    ValueError for a lattice without positions or of scalar displacements, beads that turn without a radius.
    """
    places = _places(lattice, "an angular momentum")
    u, v = parts(lattice, y, t)
    if lattice.dimension not in (2, 3):
        refuse("lattice", "displacements in the plane", f"{lattice.dimension or 1} components")
    R = None if radius is None else positive("radius", radius)
    if lattice.dimension == 3 and R is None:
        refuse("radius", "the radius of the beads, which turn", "None", "Half of the spacing.")
    c = parameter("centre", centre)
    if c.shape != (2,):
        refuse("centre", "a point of the plane, two numbers", f"shape {c.shape}")
    total = 0.0
    for place, w, speed, mass in zip(*(jax.tree.leaves(x) for x in (places, u, v, lattice.mass))):
        r = place + w[..., :2] - c
        m = jnp.broadcast_to(mass, speed.shape)
        total = total + (r[..., 0] * m[..., 1] * speed[..., 1] - r[..., 1] * m[..., 0] * speed[..., 0]).sum()
        if lattice.dimension == 3:
            total = total + (m[..., 2] * R * speed[..., 2]).sum()
    return total


@checked
def slip_ratio(lattice: Lattice, y: StateLike, t: Number = 0.0) -> Numbers:
    r"""The largest ratio of tangential to normal force |T|/N of any contact: above the friction coefficient it slides.

    Of beads that turn (`rotation=True`): each `gx.strains.Slip` bond over the normal one that comes before it, with the
    same ends. Infinite where a contact is open and T is not zero. Typical friction coefficients: 0.1 ... 0.8.
    **Returns:** a number, shape of the lanes. **Raises** ValueError for a lattice without such pairs.
    """
    u, _ = parts(lattice, y, t)
    forces = [(term, c.force) for term in lattice.terms for c in term.compressions(t, u) if c.place == "bond"]
    lanes, worst = len(lattice.lanes), []
    for (_, normal), (term, tangential) in zip(forces, forces[1:]):
        if not getattr(getattr(term, "strain_map", None), "tangential", False):
            continue
        T, N = jnp.abs(tangential), jnp.broadcast_to(normal, tangential.shape)
        closed = N > 0
        ratio = jnp.where(closed, T / jnp.where(closed, N, 1), jnp.where(T > 0, jnp.inf, 0.0))
        worst.append(ratio.max(tuple(range(ratio.ndim - lanes))))
    if not worst:
        refuse("lattice", "contacts with a tangential force", "none", "Build it with rotation=True.")
    return jnp.max(jnp.stack(worst), 0)


class FrontDecay(Result):
    """How the amplitude of a front falls with the distance from where it began: amplitude ~ distance^exponent.

    **Fields:** `distance` (n,) [m], `amplitude` (n,): as given, and its root mean square over sites at one distance.
    `exponent`, `error`: of the straight line through their logarithms, with its standard error; `drift`: the exponent
    of the further half less that of the nearer one, zero for a power law.
    """

    held: ClassVar[dict[str, Held]] = {
        "distance": Held("distance", "m"), "amplitude": Held("distance"), "exponent": Held(unit="1"),
        "error": Held(unit="1"), "drift": Held(unit="1"),
    }
    distance: Numbers
    amplitude: Numbers
    exponent: Number
    error: Number
    drift: Number

    @property
    def outcome(self) -> str:
        """The power, and whether it is one."""
        told = f"Amplitude ~ distance^({float(self.exponent):.3g} +- {float(self.error):.1g})"
        if abs(float(self.drift)) <= 4 * float(self.error):
            return f"{told}."
        return f"{told}; no power law: the exponent changes by {float(self.drift):+.2g} on the way."


@checked
def front_decay(
    lattice: Lattice, amplitude: Parameter, site: Count | Cell, *, direction: Parameter | None = None,
    between: tuple[Scalar, Scalar] | None = None,
) -> FrontDecay:
    r"""How the amplitude of a front falls with the distance from a site, as a power with its standard error.

    **Arguments:**

    - `lattice`: one with `positions`, of one field.
    - `amplitude`: the largest value at each site, shape of the sites, such as `run.recorded["peak"]` of
      `gx.Peak(lambda t, y, lattice: jnp.linalg.norm(y.v, axis=-1))`.
    - `site`: where the front began. `direction`: a vector of the plane, along which sites are taken (within a tenth of
      a spacing of its ray); `None` takes all around, as the root mean square over each ring one spacing wide.
    - `between`: the least and the largest distance [m]; `None`: from one spacing on, as far as the amplitude is above
      zero.

    In a plane that keeps the energy of a linear front of fixed width the exponent is -1/2 all around. A solitary wave
    would have 0: in two dimensions there is none.

    **Returns:** `FrontDecay`; exponents are differentiable in the amplitudes. **Raises** ValueError for a lattice
    without positions, a shape that does not fit, and fewer than four distances. Source: Leonard, Fraternali, Daraio,
    Exp. Mech. 53, 327 (2013); Awasthi, Smith, Geubelle, Lambros, Mech. Mater. 54, 100 (2012).
    """
    places = _places(lattice, "distances")
    if isinstance(places, dict):
        refuse("lattice", "one field", f"the fields {sorted(places)}", "Take the distances of one of them.")
    sites = places.shape[:-1]
    q = parameter("amplitude", amplitude)
    if q.shape != sites:
        refuse("amplitude", f"one number per site, shape {sites}", f"shape {q.shape}")
    at = (site,) if np.ndim(site) == 0 else tuple(site)
    if len(at) != len(sites) or any(not -n <= i < n for i, n in zip(at, sites)):
        refuse("site", f"a site of {sites}", f"{site}")
    away = np.asarray(places - places[at]).reshape(-1, places.shape[-1])
    distance, q = np.linalg.norm(away, axis=-1), q.ravel()
    spacing = distance[distance > 0].min()
    near, far = (0.99 * spacing, np.inf) if between is None else (float(x) for x in between)
    kept = (distance >= near) & (distance <= far)
    if not traced(q):
        kept &= np.asarray(q) > 0
    if direction is None:
        ring = np.round(distance / spacing).astype(int)
    else:
        along = np.asarray(parameter("direction", direction), float)
        if along.shape != places.shape[-1:] or not np.any(along):
            refuse("direction", f"a vector of {places.shape[-1]} numbers, not zero", f"{direction}")
        ahead = away @ (along / np.linalg.norm(along))
        kept &= (ahead > 0) & (np.sqrt(np.maximum(distance**2 - ahead**2, 0)) < 0.1 * spacing)
        ring = np.round(distance / (1e-6 * spacing)).astype(int)
    rings, which = np.unique(ring[kept], return_inverse=True)
    if len(rings) < 4:
        refuse("amplitude", "at least four distances with an amplitude above zero", f"{len(rings)}",
               "Run longer, or take a larger crystal or wider `between`.")
    count = np.bincount(which)
    mean = np.bincount(which, distance[kept]) / count
    rms = jnp.sqrt(jnp.zeros(len(rings)).at[which].add(q[np.flatnonzero(kept)] ** 2) / count)
    x, y = jnp.log(mean / spacing), jnp.log(rms)
    slope, error = _line(x, y)
    half = len(rings) // 2
    drift = _line(x[half:], y[half:])[0] - _line(x[:half], y[:half])[0]
    return FrontDecay(mean, rms, slope, error, drift, **lattice.origin)


def _line(x, y):
    """Slope of the line through points, and its standard error."""
    x, y = x - x.mean(), y - y.mean()
    slope = jnp.vdot(x, y) / jnp.vdot(x, x)
    left = jnp.sum((y - slope * x) ** 2) / max(len(x) - 2, 1)
    return slope, jnp.sqrt(left / jnp.vdot(x, x))
