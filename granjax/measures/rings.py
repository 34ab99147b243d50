"""Waves that spread from a point of the plane: energy radius and decay of the front."""

import jax
import jax.numpy as jnp
import numpy as np

from ..base.checks import described, is_site, known_value, parameter, refuse
from ..base.types import Cell, Count, Number, Numbers, Parameter, Scalar, StateLike
from ..lattice import Lattice
from ..results import Result, array
from .energies import site_energy
from .fronts import line
from .networks import placed

# a change of the exponent below this is rounding
EXACT = 1e-8


def energy_radius(
    lattice: Lattice, y: StateLike, t: Number = 0.0, *, centre: Parameter | None = None
) -> Number:
    r"""Return the root mean square distance of the energy from a point [m].

    It is (sum e_n |r_n - c|^2 / sum e_n)^{1/2}. A packet of a cone of speed c
    (`gx.states.bloch_packet` at a Dirac point) has the radius (w^2 + b t + c^2 t^2)^{1/2} once its
    two sites share their energy, with w that at t = 0 and b about c w: half of the second
    derivative of the squared radius is c^2.

    **Arguments:** `centre`: c (d,) [m]; `None` is the mean place of the energy. **Returns:** a
    number; NaN at rest.
    **Raises** ValueError for a lattice without positions, or a batch.
    """
    places = placed(lattice, "a radius")
    parts = [*zip(*map(jax.tree.leaves, (places, site_energy(lattice, y, t))))]
    total = sum(x.sum() for _, x in parts)
    if centre is None:
        c = sum((x[..., None] * at).sum(tuple(range(x.ndim))) for at, x in parts) / total
    else:
        c = parameter("centre", centre)
        components = parts[0][0].shape[-1]
        if c.shape != (components,):
            refuse("centre", f"a place of {components} numbers", f"shape {c.shape}")
    return jnp.sqrt(sum((x * ((at - c) ** 2).sum(-1)).sum() for at, x in parts) / total)


class FrontDecay(Result):
    """The decay of the amplitude of a front with distance, amplitude ~ distance^exponent."""

    distance: Numbers = array("The distances.", "m", "distance")
    amplitude: Numbers = array(
        "The root mean square of the amplitude over sites at one distance.", axes="distance"
    )
    exponent: Number = array("The slope of the straight line through the logarithms.", "1")
    error: Number = array("The standard error of the exponent.", "1")
    drift: Number = array(
        "The exponent of the far half less that of the near half, zero for a power law.", "1"
    )

    @property
    def outcome(self) -> str:
        """The exponent, and whether the decay is a power law."""
        told = f"Amplitude ~ distance^({float(self.exponent):.3g} +- {float(self.error):.1g})"
        if abs(float(self.drift)) <= max(4 * float(self.error), EXACT):
            return f"{told}."
        return f"{told}; no power law: the exponent changes by {float(self.drift):+.2g} on the way."


def front_decay(
    lattice: Lattice,
    amplitude: Parameter,
    site: Count | Cell,
    *,
    direction: Parameter | None = None,
    between: tuple[Scalar, Scalar] | None = None,
) -> FrontDecay:
    r"""Fit the amplitude of a front by a power of the distance from a site, with a standard error.

    **Arguments:**

    - `lattice`: one with `positions`, of one field.
    - `amplitude`: the largest value at each site, shape of the sites, such as
      `run.recorded["peak"]` of `gx.Peak(lambda t, y, lattice: jnp.linalg.norm(y.v, axis=-1))`.
    - `site`: where the front began. `direction`: a vector of the plane, to take sites within a
      tenth of a spacing of its ray; `None` takes the root mean square over rings one spacing wide.
    - `between`: the least and largest distance [m]; `None`: from one spacing on, where the
      amplitude is positive.

    In a plane a linear front of fixed width that keeps its energy has the exponent -1/2. A solitary
    wave would have 0: in two dimensions there is none.

    **Returns:** `FrontDecay`; exponents are differentiable in the amplitudes. **Raises** ValueError
    for a lattice without positions, a shape that does not fit, and fewer than four distances.
    Source: Leonard, Fraternali, Daraio, Exp. Mech. 53, 327 (2013); Awasthi, Smith, Geubelle,
    Lambros, Mech. Mater. 54, 100 (2012).
    """
    places = placed(lattice, "distances")
    if isinstance(places, dict):
        refuse(
            "lattice",
            "one field",
            f"the fields {sorted(places)}",
            "Take the distances of one of them.",
        )
    sites = places.shape[:-1]
    q = parameter("amplitude", amplitude)
    if q.shape != sites:
        refuse("amplitude", f"one number per site, shape {sites}", f"shape {q.shape}")
    at = (site,) if np.ndim(site) == 0 else tuple(site)
    if not is_site(at, sites):
        refuse("site", f"a site of {sites}", f"{site}")
    places = np.asarray(places)
    away = (places - places[at]).reshape(-1, places.shape[-1])
    distance = np.linalg.norm(away, axis=-1)
    q = q.ravel()
    spacing = distance[distance > 0].min()
    near, far = (0.99 * spacing, np.inf) if between is None else (float(x) for x in between)
    kept = (distance >= near) & (distance <= far)
    known = known_value(q)
    if known is not None:
        kept &= known > 0
    if direction is None:
        ring = np.round(distance / spacing).astype(int)
    else:
        along = np.asarray(parameter("direction", direction), float)
        if along.shape != places.shape[-1:] or not along.any():
            wanted = f"a vector of {places.shape[-1]} numbers, not all zero"
            refuse("direction", wanted, described(direction))
        ahead = away @ (along / np.linalg.norm(along))
        kept &= (ahead > 0) & (np.sqrt(np.maximum(distance**2 - ahead**2, 0)) < 0.1 * spacing)
        ring = np.round(distance / (1e-6 * spacing)).astype(int)
    rings, which = np.unique(ring[kept], return_inverse=True)
    if len(rings) < 4:
        refuse(
            "amplitude",
            "at least four distances with an amplitude above zero",
            f"{len(rings)}",
            "Run longer, or take a larger crystal or wider `between`.",
        )
    # Amplitudes within jax.jit are not known: those that are not positive have no weight.
    q = q[np.flatnonzero(kept)]
    shared = lambda x: jnp.zeros(len(rings)).at[which].add(jnp.where(q > 0, x, 0))
    count = shared(1.0)
    moved = count > 0
    some = jnp.where(moved, count, 1)
    mean = shared(distance[kept]) / some
    square = shared(q**2) / some
    x = jnp.log(jnp.where(moved, mean / spacing, 1))
    y = jnp.log(jnp.where(moved, square, 1)) / 2
    slope, error = line(x, y, moved)
    near = jnp.cumsum(moved) <= moved.sum() // 2
    drift = line(x, y, moved & ~near)[0] - line(x, y, moved & near)[0]
    mean = jnp.where(moved, mean, jnp.nan)
    rms = jnp.where(moved, jnp.exp(y), jnp.nan)
    return FrontDecay(mean, rms, slope, error, drift, **lattice.origin)
