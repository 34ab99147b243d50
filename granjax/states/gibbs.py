"""Thermal equilibrium: states drawn from the canonical distribution."""

import jax
import jax.numpy as jnp
import numpy as np

from ..base.arrays import trailing
from ..base.checks import per_lane, positive, random_key, refuse, traced, whole
from ..base.programs import compiled, concretely
from ..base.types import Count, Parameter, Seed
from ..flow import Flow, frequency_bound
from ..flow.bath import isolated
from ..flow.lanes import apart
from ..lattice import Lattice, State
from ..lattice.split import next_neighbours
from ..solvers import SRKN11b
from ..theory.thermal import TABLE, checked_nodes, masses, potential
from .simple import thermal

# time step of hybrid Monte Carlo times the highest frequency; H changes by some 1e-3 k_B T
STEP = 2.0
# That frequency is bounded at this multiple of the temperature, because energy can concentrate.
HOTTER = 2.0


def gibbs(
    lattice: Lattice,
    temperature: Parameter,
    pressure: Parameter | None = None,
    *,
    seed: Seed = 0,
    moves: Count = 16,
    duration: Parameter | None = None,
) -> State:
    r"""Draw a state from the canonical distribution exp(-H/(k_B T)), independently in every lane.

    In a chain between free ends the bonds are independent. Each compression is drawn from
    exp(-(V(e) - P e)/(k_B T)), with u = 0 on average. All other lattices (walls, rings, on-site
    forces, the plane) use hybrid Monte Carlo: starting from rest, each of `moves` moves draws new
    velocities and makes a run of random length, accepted with the probability min(1,
    exp(-dH/(k_B T))). A move forgets about half of the slowest mode. Velocities are Gaussian, m
    <v^2> = k_B T for each component.

    **Arguments:**

    - `lattice`: with forces of positions alone; heat baths (`Langevin`) are left out.
    - `temperature`: k_B T > 0 [J], a number or one per lane; `gx.units.BOLTZMANN` times kelvins.
    - `pressure`: P, the mean total contact force [N] of a chain between free ends; `None` is the
      preload F0. Another P needs a load P - F0 on the ends. At fixed length `precompression` and
      temperature determine the mean contact force.
    - `seed`: as in `random`. `moves`: of hybrid Monte Carlo; barriers take more of them.
      `duration`: mean length of a run [s]. By default the slowest wave advances by roughly a
      quarter of its period.

    **Raises** ValueError where the distribution does not exist (a law without a lower bound, such
    as FPUT-alpha's, or an unloaded contact at P = 0), for dissipative or time-dependent forces, and
    for a pressure at fixed length. Expected averages: `gx.theory.thermal.bond_state`.

    **Example:**

    >>> chain = gx.scenes.fput(1000, alpha=0.0, beta=1.0, boundary="free")
    >>> state = gx.states.gibbs(chain, 1.0, seed=3)
    >>> force = gx.measures.contact_force(chain, state)  # zero on average, 1.5 of a mean square
    >>> bool(abs(force.mean()) < 0.2)
    True
    """
    key, again = jax.random.split(random_key(seed))
    T = per_lane("temperature", temperature, lattice.lanes, positive).astype(lattice.dtype)
    alone = isolated(lattice)
    if not alone.conserves:
        names = ", ".join(alone.unkept())
        remedy = (
            "A damped lattice has a temperature in a heat bath: gx.Langevin in place of Damping."
        )
        refuse("lattice", "forces of positions alone", names, remedy)
    found = next_neighbours(alone)
    if found is not None and found[1] == "free":
        return State(_independent(alone, found[0], T, pressure, again), thermal(alone, T, key).v)
    if pressure is not None:
        remedy = "Choose the precompression: the length is held."
        refuse("pressure", "None but for a chain between free ends", f"{pressure}", remedy)
    _refuse_unbounded(alone)
    hot = thermal(alone, HOTTER * T, key)
    omega = frequency_bound(alone, hot, 0.0, 1.0)
    if duration is None:
        sites = alone.sites.values() if isinstance(alone.sites, dict) else (alone.sites,)
        duration = max(map(max, sites)) / jnp.minimum(omega, _typical(alone, T))
    duration = per_lane("duration", duration, alone.lanes, positive)
    longest = 2 * duration.astype(lattice.dtype)
    steps = jnp.ceil(jnp.max(longest) * omega / STEP).astype(int)
    return _hybrid(alone, T, longest, steps, key, again, whole("moves", moves, 1))


@compiled
def _typical(lattice, T):
    # The highest frequency of each lane where every bond holds the mean energy of one site.
    v = jax.tree.map(lambda m, u: jnp.sqrt(T / m) + u, lattice.mass, lattice.zeros())
    lanes, build = apart(lattice, State(lattice.zeros(), v))
    one = lambda lane: frequency_bound(*build(lane), 0.0, 1.0, 1)
    return jax.vmap(one, -1)(lanes).reshape(lattice.lanes)


def _independent(lattice, law, T, pressure, key):
    given = law.preload if pressure is None else per_lane("pressure", pressure, lattice.lanes)
    P = jnp.asarray(given, lattice.dtype)
    (sites,) = lattice.sites
    uniform = jax.random.uniform(key, (sites - 1,) + lattice.lanes, lattice.dtype)
    e = _drawn(law, T, P, checked_nodes(law, T, P, TABLE), uniform)
    u = jnp.concatenate([jnp.zeros_like(e[:1]), -jnp.cumsum(e, 0)])
    return u - jnp.mean(u, 0)


@compiled
def _drawn(law, T, P, nodes, uniform):
    weight = masses(law, T, P, nodes)[0]
    g = potential(law, T, P, nodes)

    def one(e, g, weight, at):
        reached = jnp.concatenate([jnp.zeros(1), jnp.cumsum(weight)])
        at = at * reached[-1]
        i = jnp.clip(jnp.searchsorted(reached, at, side="right") - 1, 0, len(weight) - 1)
        share = jnp.clip((at - reached[i]) / weight[i], 0, 1)
        # between two nodes the density is an exponential
        rise = g[i] - g[i + 1]
        flat = jnp.abs(rise) < 1e-6
        x = jnp.log1p(share * jnp.expm1(rise)) / jnp.where(flat, 1, rise)
        return e[i] + jnp.where(flat, share, x) * (e[i + 1] - e[i])

    # equal bonds and lanes share a table
    own = (1,) * (uniform.ndim - nodes.ndim + 1) + nodes.shape[1:]
    many = [i for i, n in enumerate(own) if n == 1]
    order = many + [i for i, n in enumerate(own) if n > 1]
    turned = jnp.transpose(uniform, order)
    tables = [x.reshape(len(x), -1) for x in (nodes, g, weight)]
    columns = tables[0].shape[1]
    drawn = jax.vmap(one, 1, 1)(*tables, turned.reshape(-1, columns))
    return jnp.transpose(drawn.reshape(turned.shape), np.argsort(order))


def _refuse_unbounded(lattice):
    far = 2.0 ** np.arange(-60, 61)
    for i, term in enumerate(lattice.terms):
        for found in term.compressions(jnp.zeros(()), lattice.zeros()):
            if traced(found.law):
                continue
            for side in (far, -far):
                e = trailing(side, 1 + found.compression.ndim)
                energy = concretely(potential, found.law, 1.0, found.law.preload, e)
                if energy[-1].min() < -1 and (np.diff(energy[-8:], axis=0) < 0).all(0).any():
                    what = f"terms[{i}] ({type(term).__name__}), whose energy has no lower bound"
                    remedy = "It has no thermal equilibrium: add a stiffening part, law + law."
                    refuse("lattice", "laws with a lowest energy", what, remedy)


def _paced(s, y, args):
    # The motion in s = t / length, as each lane has its own length: w = length v.
    lattice, length = args
    u, w = y
    return w, jax.tree.map(lambda a: length**2 * a, lattice.acceleration(0.0, u, w))


@compiled
def _hybrid(lattice, T, longest, steps, key, again, moves):
    flow = Flow(steps, SRKN11b(), _paced)

    def move(u, key):
        speeds, lengths, chances = jax.random.split(key, 3)
        length = longest * jax.random.uniform(lengths, lattice.lanes, lattice.dtype)
        begin = State(u, thermal(lattice, T, speeds).v)
        w = jax.tree.map(lambda v: length * v, begin.v)
        u, w = flow(State(u, w), 0.0, 1.0, (lattice, length))
        end = State(u, jax.tree.map(lambda w: w / length, w))
        gained = lattice.energy(0.0, *end) - lattice.energy(0.0, *begin)
        taken = jnp.log(jax.random.uniform(chances, lattice.lanes)) < -gained / T
        return jax.tree.map(lambda new, old: jnp.where(taken, new, old), end.u, begin.u), None

    u, _ = jax.lax.scan(move, lattice.zeros(), jax.random.split(again, moves))
    return State(u, thermal(lattice, T, key).v)
