"""Simple states: rest, impact, random, thermal; steps in strain or velocity."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from ..base.checks import non_negative, parameter, per_lane, random_key, refuse, traced
from ..base.types import Parameter, Seed, Site
from ..lattice import Lattice, State
from .places import chain_only, field_of, inside, numbers, site_of, state_of


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


def strain_step(
    lattice: Lattice, left: Parameter, right: Parameter = 0.0, centre: Parameter | None = None
) -> State:
    r"""Return a strain step at rest: u_n - u_{n+1} = `left` for n < centre, else `right`; v = 0.

    The last site stays at u = 0. With right = 0 all sites from the centre on are exactly at rest.
    On the left u grows to left * centre, and the rounding of the strain is 1e-16 times that (5e-11
    of `left` for a step half a million bonds from the end).

    Meant for free ends, whose static load is only F0: they send waves inwards from t = 0 on, at the
    speed of sound. A wall at the left end would be torn away or crushed by u_0.

    **Arguments:** `left`, `right`: strains, positive in compression [m], numbers or one per lane;
    `centre`: bond of the step, from 0 to N - 1, `None` for the middle, (N-1)//2.
    **Raises** ValueError for a lattice that is no plain chain, strains not finite, or a centre
    outside the chain.
    """
    size = chain_only(lattice, "strain_step")
    left = per_lane("left", left, lattice.lanes)
    right = per_lane("right", right, lattice.lanes)
    centre = inside("centre", (size - 1) // 2 if centre is None else centre, size)
    n = numbers(lattice)
    before = jnp.maximum(centre - n, 0)
    after = size - 1 - jnp.maximum(n, centre)
    return state_of(lattice, left * before + right * after)


def velocity_step(lattice: Lattice, c: Parameter, centre: Parameter | None = None) -> State:
    r"""Return a velocity shock: u = 0, v_n = -2 c sign(n - centre), with sign(0) = 0.

    For c > 0 the halves collide at the relative velocity 4c, like a piston of velocity 2c that
    drives into a chain at rest, in the frame of the piston. In a Toda chain (a = b = m = 1),
    0 < c < 1, the strain behind the shocks is 2 ln(1 + c), about 2c. With c < 0 the halves move
    apart.

    **Arguments:** `c`: a quarter of the relative velocity [m/s], a number or one per lane;
    `centre`: site, or a half-integer, `None` for the middle, (N-1)/2; a site at the centre stays at
    rest. The ends send their own waves inwards from t = 0 on.
    **Raises** ValueError for a lattice that is no plain chain, c not finite, or a centre outside
    the chain.
    Source: S. Venakides, P. Deift, R. Oba, Comm. Pure Appl. Math. 44, 1171 (1991).

    **Example:**

    >>> state = gx.states.velocity_step(gx.scenes.toda(20), c=0.1)
    >>> state.v[8:12].tolist()
    [0.2, 0.2, -0.2, -0.2]
    """
    size = chain_only(lattice, "velocity_step")
    c = per_lane("c", c, lattice.lanes)
    centre = inside("centre", (size - 1) / 2 if centre is None else centre, size)
    return state_of(lattice, 0.0, -2 * c * jnp.sign(numbers(lattice) - centre))


def _draw(lattice, key, amplitude, distribution):
    template = lattice.template()
    leaves, structure = jax.tree.flatten(template)
    keys = jax.random.split(key, len(leaves))
    drawn = [
        distribution(k, s.shape, s.dtype) * jnp.asarray(amplitude, s.dtype)
        for k, s in zip(keys, leaves)
    ]
    return jax.tree.unflatten(structure, drawn)
