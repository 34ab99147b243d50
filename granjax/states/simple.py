"""Simple states: rest, impact, random, thermal."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from ..base.checks import non_negative, parameter, per_lane, random_key, refuse, traced
from ..base.types import Parameter, Seed, Site
from ..lattice import Lattice, State
from .places import field_of, site_of


def rest(lattice: Lattice) -> State:
    """Return the state of equilibrium: u = v = 0.

    **Example:**

    >>> chain = gx.scenes.monomer(20, precompression=1.0)
    >>> gx.measures.contact_force(chain, gx.states.rest(chain))[:3].tolist()
    [1.0, 1.0, 1.0]
    """
    return State(lattice.zeros(), lattice.zeros())


def impact(
    lattice: Lattice, velocity: Parameter = 1.0, site: Site = 0, field: str | None = None
) -> State:
    """Return a state in which one site moves and all others rest in equilibrium, as after a strike.

    **Arguments:**

    - `velocity`: of that site [m/s]; a number, or one per lane. In the plane a vector (d,), lanes
      after it.
    - `site`: index, negative from the end; a tuple on a grid.
    - `field`: the field of the site where a cell holds several; `None` is `"bead"`.

    **Raises** ValueError for an unknown site or field, or a velocity that is not finite or of
    another shape.

    **Example:**

    >>> chain = gx.scenes.monomer(20)
    >>> state = gx.states.impact(chain, velocity=0.5, site=2)
    >>> state.v[:4].tolist()
    [0.0, 0.0, 0.5, 0.0]
    """
    index = site_of(lattice, site, field := field_of(lattice, field))
    velocity = parameter("velocity", velocity)
    # Known numbers use NumPy, because JAX compiles a program for each operation.
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
    """Return displacements and velocities that are uniform in [-amplitude, amplitude).

    **Arguments:** `seed`: a whole number or a `jax.random` key; the same seed gives the same state.
    `displacement` [m] and `velocity` [m/s]: amplitudes >= 0, numbers or one per lane. Every lane
    draws its own numbers.
    **Raises** ValueError for an invalid seed, or amplitudes that are negative, not finite, or of
    another shape.

    **Example:**

    >>> chain = gx.scenes.monomer(20, precompression=1.0)
    >>> state = gx.states.random(chain, seed=1, displacement=0.1)
    >>> bool(jnp.abs(state.u).max() < 0.1), bool(jnp.any(state.v))
    (True, False)
    """
    keys = jax.random.split(random_key(seed), 2)
    given = {"displacement": displacement, "velocity": velocity}
    lanes = lattice.lanes
    amplitudes = [per_lane(name, x, lanes, non_negative) for name, x in given.items()]
    uniform = partial(jax.random.uniform, minval=-1, maxval=1)
    return State(*(_draw(lattice, key, a, uniform) for key, a in zip(keys, amplitudes)))


def thermal(lattice: Lattice, temperature: Parameter, seed: Seed = 0) -> State:
    """Return sites in equilibrium position with Gaussian velocities: m <v^2> = k_B T per component.

    **Arguments:** `temperature`: k_B T >= 0 [J], a number or one per lane. All energy is kinetic at
    first, so a linear lattice settles at half this temperature. `seed`: as in `random`.
    **Raises** ValueError for a temperature that is negative, not finite or of another shape, or an
    invalid seed.
    """
    width = jnp.sqrt(per_lane("temperature", temperature, lattice.lanes, non_negative))
    drawn = _draw(lattice, random_key(seed), width, jax.random.normal)
    return State(lattice.zeros(), jax.tree.map(lambda m, x: x / jnp.sqrt(m), lattice.mass, drawn))


def _draw(lattice, key, amplitude, distribution):
    template = lattice.template()
    leaves, structure = jax.tree.flatten(template)
    keys = jax.random.split(key, len(leaves))
    drawn = [
        distribution(k, s.shape, s.dtype) * jnp.asarray(amplitude, s.dtype)
        for k, s in zip(keys, leaves)
    ]
    return jax.tree.unflatten(structure, drawn)
