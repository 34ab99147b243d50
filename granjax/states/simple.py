"""States that need no more than shapes: rest, impact, random, thermal."""

import jax
import jax.numpy as jnp
import numpy as np

from ..checks import (
    non_negative,
    parameter,
    per_lane,
    random_key,
    refuse,
    traced,
)
from ..lattice import Lattice, State
from ..types import Parameter, Seed, Site
from .places import field_of, site_of


def rest(lattice: Lattice) -> State:
    """Every site at rest in equilibrium: u = v = 0.

    **Example:**

    >>> chain = gx.scenes.monomer(20, precompression=1.0)
    >>> gx.measures.contact_force(chain, gx.states.rest(chain))[:3].tolist()
    [1.0, 1.0, 1.0]
    """
    return State(lattice.zeros(), lattice.zeros())


def impact(
    lattice: Lattice, velocity: Parameter = 1.0, site: Site = 0, field: str | None = None
) -> State:
    """One site moves, all else is at rest in equilibrium: what a striker leaves behind.

    **Arguments:**

    - `velocity`: of that site [m/s]; a number, or one per lane. In the plane a vector (d,), lanes after it.
    - `site`: index, negative from the end; a tuple on a grid.
    - `field`: name of the field where a cell holds several; `None` is the one called `"bead"`.

    **Raises** ValueError for a site or field that is not there, or a velocity that is not finite or of another shape.

    **Example:**

    >>> chain = gx.scenes.monomer(20)
    >>> state = gx.states.impact(chain, velocity=0.5, site=2)
    >>> state.v[:4].tolist()
    [0.0, 0.0, 0.5, 0.0]
    """
    index = site_of(lattice, site, field := field_of(lattice, field))
    velocity = parameter("velocity", velocity)
    # by NumPy where it can be, as for JAX each operation is a program to compile
    still = jax.tree.map(lambda x: np.zeros(x.shape, x.dtype), lattice.template())
    x = still if field is None else still[field]
    wanted = x[index].shape
    vector = () if lattice.dimension is None else (lattice.dimension,)
    if velocity.shape == vector and vector != wanted:
        velocity = velocity.reshape(vector + (1,) * len(lattice.lanes))
    elif velocity.shape not in ((), wanted) or (velocity.shape != wanted and vector):
        one = "a number" if not vector else f"a vector of shape {vector}"
        also = f", or shape {wanted} with lanes" if lattice.lanes else ""
        refuse("velocity", one + also, f"shape {velocity.shape}")
    if traced(velocity):
        x = jnp.asarray(x).at[index].set(velocity.astype(x.dtype))
    else:
        x = x.copy()
        x[index] = velocity
    v = x if field is None else {**still, field: x}
    return State(*jax.device_put((still, v)))


def random(
    lattice: Lattice, seed: Seed = 0, displacement: Parameter = 0.1, velocity: Parameter = 0.0
) -> State:
    """Displacements and velocities uniform in [-displacement, displacement) and [-velocity, velocity), seeded.

    **Arguments:** `seed`: a whole number or a `jax.random` key; the same seed gives the same state. `displacement` [m]
    and `velocity` [m/s]: amplitudes, not negative, numbers or one per lane. Every lane draws its own numbers.
    **Raises** ValueError for a seed that is neither, or amplitudes that are negative, not finite, or of another shape.

    **Example:**

    >>> chain = gx.scenes.monomer(20, precompression=1.0)
    >>> state = gx.states.random(chain, seed=1, displacement=0.1)
    >>> bool(jnp.abs(state.u).max() < 0.1), bool(jnp.any(state.v))
    (True, False)
    """
    keys = jax.random.split(random_key(seed), 2)
    given, lanes = {"displacement": displacement, "velocity": velocity}, lattice.lanes
    amplitudes = [per_lane(name, x, lanes, non_negative) for name, x in given.items()]
    return State(*(_draw(lattice, key, a, _uniform) for key, a in zip(keys, amplitudes)))


def thermal(lattice: Lattice, temperature: Parameter, seed: Seed = 0) -> State:
    """Sites in equilibrium position with Gaussian velocities: m <v^2> = k_B T for each component.

    **Arguments:** `temperature`: k_B T [J], not negative, a number or one per lane; the mean kinetic energy of each
    component of each site is half of it. All energy is kinetic at first, so a linear lattice settles at half this
    temperature. `seed`: as in `random`.
    **Raises** ValueError for a temperature that is negative, not finite or of another shape, or a seed that is none.
    """
    width = jnp.sqrt(per_lane("temperature", temperature, lattice.lanes, non_negative))
    drawn = _draw(lattice, random_key(seed), width, jax.random.normal)
    return State(lattice.zeros(), jax.tree.map(lambda m, x: x / jnp.sqrt(m), lattice.mass, drawn))


def _uniform(key, shape, dtype):
    return jax.random.uniform(key, shape, dtype, -1, 1)


def _draw(lattice, key, amplitude, distribution):
    template = lattice.template()
    leaves, structure = jax.tree.flatten(template)
    keys = jax.random.split(key, len(leaves))
    drawn = [
        distribution(k, s.shape, s.dtype) * jnp.asarray(amplitude, s.dtype)
        for k, s in zip(keys, leaves)
    ]
    return jax.tree.unflatten(structure, drawn)
