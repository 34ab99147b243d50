"""Thermal equilibrium: states drawn from the canonical distribution."""

import math

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
# amplitudes at which the energy of a displacement is looked at, in the lattice's unit of length
FAR = 2.0 ** np.arange(-40, 31)
# the last of them, over which an energy that holds the lattice rises
TAIL = 12
# A squared frequency below this part of the highest counts as zero: a run would be too long.
FAINT = 1e-10


def gibbs(
    lattice: Lattice,
    temperature: Parameter,
    pressure: Parameter | None = None,
    *,
    seed: Seed = 0,
    moves: Count = 16,
    duration: Parameter | None = None,
) -> State:
    r"""Draw a state from the canonical distribution exp(-H/(k_B T)), independently per lane.

    In a chain between free ends the bonds are independent. Each compression is drawn from
    exp(-(V(e) - P e)/(k_B T)), with u = 0 on average. All others (walls, rings, on-site forces, the
    plane) use hybrid Monte Carlo: from rest, each of `moves` moves draws new velocities and makes a
    run of random length, accepted with probability min(1, exp(-dH/(k_B T))). A move forgets about
    half of the slowest mode. Velocities are Gaussian, m <v^2> = k_B T for each component.

    **Arguments:**

    - `lattice`: with forces of positions alone; heat baths (`Langevin`) are left out.
    - `temperature`: k_B T > 0 [J], a number or one per lane; `gx.units.BOLTZMANN` times kelvins.
    - `pressure`: P, the mean total contact force [N] of a chain between free ends; `None` is the
      preload F0. Another P needs a load P - F0 on the ends. At fixed length `precompression` and
      temperature determine the mean contact force.
    - `seed`: as in `random`. `moves`: of hybrid Monte Carlo; barriers take more of them.
      `duration`: mean length of a run [s]. By default the longest run lasts at least a quarter
      period of the slowest uniform motion or stretching; weak links need longer runs.

    **Raises** ValueError where the distribution does not exist (laws without a lower bound, such as
    FPUT-alpha's, or contacts that nothing holds), for dissipative or time-dependent forces, and for
    a pressure at fixed length. Expected averages: `gx.theory.thermal.bond_state`.

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
        u = _independent(alone, found[0], T, pressure, again).astype(alone.dtype)
        return State(u, thermal(alone, T, key).v)
    if pressure is not None:
        remedy = "Choose the precompression: the length is held."
        refuse("pressure", "None but for a chain between free ends", f"{pressure}", remedy)
    _refuse_unbounded(alone)
    climbs, inertia = _climbs(alone) if traced(alone) else concretely(_climbs, alone)
    if not traced((climbs, T)):
        _refuse_loose(np.asarray(climbs), np.asarray(T))
    hot = thermal(alone, HOTTER * T, key)
    omega = frequency_bound(alone, hot, 0.0, 1.0)
    if duration is None:
        typical = jnp.minimum(omega, _typical(alone, T))
        shapes = [shape for _, shape, _ in alone._cell]
        duration = max(map(max, shapes)) / typical
        # with the heat of one mode, as where forces harden, and of all, as where they soften
        for energy in (T / 2, sum(map(math.prod, shapes)) * T / 2):
            slowest = _slowest(climbs, inertia, energy, FAINT * typical**2)
            duration = jnp.maximum(duration, jnp.pi / 4 / slowest)
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


@compiled
def _climbs(lattice):
    # the energies of u = +-a w beyond that of u = 0, (w, sign, a, lanes), and sum m w^2/2
    energy = lambda u: lattice.potential_energy(0.0, u)
    moved = lambda w, a: energy(jax.tree.map(lambda x: a.astype(x.dtype) * x, w))
    climb = lambda w: jax.lax.map(lambda a: moved(w, a), jnp.stack([FAR, -FAR]).ravel())
    ways = jax.tree.map(lambda *x: jnp.stack(x), *_ways(lattice))
    rises = jax.lax.map(climb, ways) - energy(lattice.zeros())
    rises = rises.reshape(len(rises), 2, len(FAR), *lattice.lanes)
    # a law is not defined beyond its singularity
    return jnp.where(jnp.isnan(rises), jnp.inf, rises), jax.lax.map(lattice.kinetic_energy, ways)


def _ways(lattice):
    # displacements of the whole, of one field, and in proportion to the distance from an end
    leaves, structure = jax.tree.flatten(lattice.template())
    count = lambda axis: [jax.lax.broadcasted_iota(x.dtype, x.shape, axis) for x in leaves]
    whole = [jnp.ones(x.shape, x.dtype) for x in leaves]
    ways = [whole]
    if len(leaves) > 1:
        ways += [[x * (i == j) for j, x in enumerate(whole)] for i in range(len(leaves))]
    for axis in range(lattice.axes):
        ways += [count(axis), [n - jnp.max(n) for n in count(axis)]]
    if lattice.dimension is not None:
        part = count(lattice.axes)
        each = range(lattice.dimension)
        ways = [[x * (c == i) for x, c in zip(way, part)] for way in ways for i in each]
    return [structure.unflatten(way) for way in ways]


def _refuse_loose(climbs, T):
    # Along a way that changes nothing, as around a ring, no place is preferred.
    still = (climbs == 0).all((1, 2), keepdims=True)
    held = still | (climbs.max(2, keepdims=True) > T)
    tail = climbs[:, :, -TAIL:]
    rises = (tail[:, :, 1:] > tail[:, :, :-1]).any(2, keepdims=True)
    if not (held | rises).all():
        what = "one that moves or opens without bound at no cost"
        remedy = "It has no thermal equilibrium: add walls, preload or on-site forces."
        refuse("lattice", "a lattice that its forces hold", what, remedy)


@compiled
def _slowest(climbs, inertia, energy, faint):
    # the lowest frequency of motion along a way whose potential energy reaches this
    above = climbs > energy
    first = jnp.argmax(above, 2, keepdims=True)
    climb, before = (jnp.take_along_axis(climbs, i, 2) for i in (first, jnp.maximum(first - 1, 0)))
    # The climb is a power of the amplitude between two that are looked at: a free way, before which
    # it is zero, is as long as the second.
    known = (before > 0) & (before < climb) & (climb < jnp.inf)
    ratio = jnp.where(known, climb / jnp.where(known, before, 1), 2)
    part = jnp.where(known, jnp.log(energy / jnp.where(known, climb, 1)) / jnp.log(ratio), 0)
    # A fall, whose climb is in proportion to the amplitude, takes as long as from the second.
    squared = jnp.minimum(climb, energy / 4**part) / jnp.asarray(FAR)[first] ** 2
    squared = squared / inertia[:, None, None]
    real = above.any(2, keepdims=True) & (squared > faint)
    return jnp.sqrt(jnp.min(jnp.where(real, squared, jnp.inf), (0, 1, 2)))


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
