"""Energies and momentum of a state, in total and per site."""

import jax
import jax.numpy as jnp

from ..base.programs import compiled
from ..base.types import Displacements, Number, StateLike
from ..lattice import Lattice
from ..terms import energies
from ..terms.reach import per_lane, reads
from .states_of import parts


def energy(lattice: Lattice, y: StateLike, t: Number = 0.0) -> Number:
    """Return the kinetic and potential energy from equilibrium [J]; shape of the lanes.

    **Example:**

    >>> chain = gx.scenes.monomer(20)
    >>> float(gx.measures.energy(chain, gx.states.impact(chain)))
    0.5
    """
    return _energy(lattice, *parts(lattice, y, t), jnp.asarray(t))


@compiled
def _energy(lattice, u, v, t):
    return lattice.energy(t, u, v)


def potential_energy(lattice: Lattice, y: StateLike, t: Number = 0.0) -> Number:
    """Return the energy of bonds, walls and sites, from equilibrium [J]; shape of the lanes."""
    return _potential(lattice, parts(lattice, y, t)[0], jnp.asarray(t))


@compiled
def _potential(lattice, u, t):
    return lattice.potential_energy(t, u) + jnp.zeros(lattice.lanes, lattice.dtype)


def kinetic_energy(lattice: Lattice, y: StateLike, t: Number = 0.0) -> Number:
    """Return the sum of m v^2/2 [J]; shape of the lanes. `t` is ignored."""
    return lattice.kinetic_energy(parts(lattice, y, t)[1])


def momentum(lattice: Lattice, y: StateLike, t: Number = 0.0) -> Number:
    """Return the sum of m v [kg m/s]; shape of the lanes, or (d,) and lanes. `t` is ignored."""
    _, v = parts(lattice, y, t)
    axes = tuple(range(lattice.axes))
    return sum(jax.tree.leaves(jax.tree.map(lambda m, v: (m * v).sum(axes), lattice.mass, v)))


def power(lattice: Lattice, y: StateLike, t: Number = 0.0) -> Number:
    """Return the rate of change of `energy` by drives, walls, modulations and damping [W].

    It is F.v of all terms that do not conserve energy, plus the rate of what they store. Shape of
    the lanes. Its integral balances the energy exactly:

        chain = gx.Lattice(1.0, (gx.Bond(gx.Shift(1), gx.Hertz()), gx.Damping(0.1)), sites=4)
        work = gx.Integral(lambda t, y, lattice: gx.measures.power(lattice, y, t))
        run = gx.simulate(chain, gx.states.impact(chain), 3.0, tolerance=1e-10, record={"work": work})
    """
    u, v = parts(lattice, y, t)
    terms = [term for term in lattice.terms if not reads(term, lattice).conserves]
    force = lattice.sum_forces(jnp.asarray(t), u, v, terms)
    work = per_lane(jax.tree.map(jnp.multiply, force, v), len(lattice.lanes))
    total = work + jnp.zeros(lattice.lanes, lattice.dtype)
    along = (jnp.asarray(t, lattice.dtype), u), (jnp.ones(jnp.shape(t), lattice.dtype), v)
    for term in terms:
        if reads(term, lattice).energy:
            rates = jax.jvp(term.energy, *along)[1]
            total = total + per_lane(rates, len(lattice.lanes))
    return total


def site_energy(lattice: Lattice, y: StateLike, t: Number = 0.0) -> Displacements:
    """Return the energy of every site [J].

    It is m v^2/2, the on-site energy, and half of the energy of its bonds. A bond to a rigid wall
    belongs wholly to its one site, so that the sum over sites is `energy`.

    **Shapes:** (N,) or (N1, N2), then lanes; a dict of such where a cell holds several fields.
    Components of a vector are summed.

    **Example:**

    >>> chain = gx.scenes.monomer(20)
    >>> gx.measures.site_energy(chain, gx.states.impact(chain))[:3].tolist()
    [0.5, 0.0, 0.0]
    """
    return _share_out(lattice, *parts(lattice, y, t), jnp.asarray(t))


@compiled
def _share_out(lattice, u, v, t):
    # fields of a cell by name, `None` for a plain array
    table = lambda x: x if isinstance(x, dict) else {None: x}
    total = table(jax.tree.map(lambda m, v: _per_site(lattice, m * v * v / 2), lattice.mass, v))
    for term in lattice.terms:
        shared = energies.site_energy(term, lattice, t, u)
        for name, part in table({} if shared is None else shared).items():
            total[name] = total[name] + _per_site(lattice, part)
    for name, shape in table(lattice.sites).items():
        total[name] = jnp.broadcast_to(total[name], (*shape, *lattice.lanes))
    return total.get(None, total)


def _per_site(lattice, x):
    # sum over the components of a vector
    if lattice.dimension is not None and x.ndim == lattice.axes + 1 + len(lattice.lanes):
        return x.sum(lattice.axes)
    return x
