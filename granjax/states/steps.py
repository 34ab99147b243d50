"""Steps in strain or velocity: the Riemann data of dispersive shocks."""

import jax.numpy as jnp

from ..base.checks import per_lane
from ..base.types import Parameter
from ..lattice import Lattice, State
from .places import chain_only, inside, numbers, state_of


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
