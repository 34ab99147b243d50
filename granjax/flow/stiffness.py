"""A bound on the highest frequency that a scene can reach at its energy, which sets the default step.

At energy E no bond is compressed further than where its own energy is E. The largest stiffness k_b = F'(x) within
that range makes a matrix |K| = sum |B|^T k |B| with no sign left in it, and for every positive w

    omega_max^2 <= max_i (M^-1 |K| w)_i / w_i                                   (Collatz, Wielandt),

exact for chains of next neighbours once w is the leading vector; a few power steps bring it close.
"""

import math

import jax
import jax.numpy as jnp

from ..checks import concrete, refuse
from ..laws import PowerLaw, Scaled, Sum, Yielding
from ..strains import Stretch
from ..terms import Bond, Damping, Dashpot, Drag, Drive, Modulated, OnSite, ViscousContact, Wall
from .dispatch import compiled

POWER_STEPS = 40
SAMPLES = 257
DENSE_LIMIT = 4000
# a contact of exponent below 1 is infinitely stiff where it opens; the bound keeps this far from there
CLOSED_FRACTION = 0.05
_BOUNDED = (Bond, Damping, Dashpot, Drag, Drive, Modulated, OnSite, ViscousContact, Wall)


def is_bounded(lattice):
    """Whether the stiffness of every term is known."""
    return all(isinstance(term, _BOUNDED) for term in lattice.terms)


def has_bound(lattice):
    """Whether every strain map gives one: a map of the user's own does so only on a small lattice."""
    bare = [getattr(term, "term", term) for term in lattice.terms]
    maps = [term.strain_map for term in bare if isinstance(term, Bond)]
    maps = [getattr(strain_map, "pairs", strain_map) for strain_map in maps]
    size = sum(x.size for x in jax.tree.leaves(lattice.template()))
    return size <= DENSE_LIMIT or all(hasattr(strain_map, "reach") for strain_map in maps)


@compiled
def frequency_bound(lattice, state, t0, t1):
    """Upper bound on the angular frequencies that linearisation finds anywhere at the scene's energy.

    A drive adds what a quasi-static push to twice its largest value would store; a moving wall the energy of the
    heaviest site at twice its largest speed, or its displacement shared by all sites, whichever is more. A modulation
    counts with its largest value and with the energy that it gives the initial state.

    **Returns:** omega_max, one number for all lanes; zero for a lattice without any stiffness at its energy.
    **Raises** ValueError for a term of another kind, whose stiffness is not known.
    """
    for i, term in enumerate(lattice.terms):
        if not isinstance(term, _BOUNDED):
            remedy = "Its stiffness is not known, so no default step is safe: give step=."
            refuse("step", "a time step", f"None with terms[{i}] ({type(term).__name__})", remedy)
    drives = _waveforms(lattice, t0, t1)
    energy = lattice.energy(t0, state.u, state.v)
    if any(isinstance(term, Modulated) for term in lattice.terms):
        energy = jnp.max(jax.vmap(lambda t: lattice.energy(t, state.u, state.v))(drives[0]), axis=0)
    heaviest = jnp.max(jnp.stack([jnp.max(m) for m in jax.tree.leaves(lattice.mass)]))
    return _bound(lattice, energy + 2 * heaviest * drives[3] ** 2, drives)


@compiled
def linear_frequency(lattice, power_steps=POWER_STEPS):
    """The same bound for infinitesimal motion about equilibrium: zero in a sonic vacuum.

    `power_steps`: how close; none gives a bound all the same.
    """
    return _bound(lattice, jnp.zeros(lattice.lanes, lattice.dtype), None, power_steps)


def _waveforms(lattice, t0, t1):
    ts = (t0 + (t1 - t0) * jnp.linspace(0.0, 1.0, SAMPLES)).astype(lattice.dtype)
    force = displacement = speed = jnp.zeros((), lattice.dtype)
    for term in lattice.terms:
        if isinstance(term, Drive):
            force = jnp.maximum(force, jnp.max(jnp.abs(jax.vmap(term.waveform)(ts))))
        if isinstance(term, Wall) and term.motion is not None:
            w, dw = jax.vmap(lambda t, w=term.motion: jax.jvp(w, (t,), (jnp.ones_like(t),)))(ts)
            displacement, speed = jnp.maximum(displacement, jnp.abs(w).max()), jnp.maximum(speed, jnp.abs(dw).max())
    sites = sum(math.prod(shape) for shape in jax.tree.leaves(lattice.sites, is_leaf=lambda x: isinstance(x, tuple)))
    return ts, 2 * force, 4 * displacement / sites, speed


def _bound(lattice, energy, waveforms, power_steps=POWER_STEPS):
    bonds, on_sites, walls = [], [], []
    for term in lattice.terms:
        factor = 1.0
        if isinstance(term, Modulated):
            ts = jnp.zeros(1, lattice.dtype) if waveforms is None else waveforms[0]
            factor, term = jnp.max(jnp.abs(jax.vmap(term.modulation)(ts)), axis=0), term.term
        if isinstance(term, Bond):
            bonds.append((term.strain_map, factor * _stiffest(term.law, energy, waveforms) + _turning(term)))
        elif isinstance(term, OnSite):
            on_sites.append((term.field, factor * _stiffest(term.law, energy, waveforms)))
        elif isinstance(term, Wall):
            walls.append((term, factor * _stiffest(term.law, energy, waveforms)))

    mass = lattice.mass
    if lattice.dimension is not None:
        mass = jnp.squeeze(mass, lattice.axes) if mass.ndim > lattice.axes else mass
    site = lattice.zeros()
    if lattice.dimension is not None:
        site = site[(slice(None),) * lattice.axes + (0,)]
    ones = jax.tree.map(jnp.ones_like, site)

    def apply(w):
        total = jax.tree.map(jnp.zeros_like, w)
        for strain_map, k in bonds:
            total = _add(total, _both_ways(strain_map, k, w, lattice))
        for field, k in on_sites:
            total = _add(total, k * w if field is None and not isinstance(w, dict) else {field: k * w[field]})
        for wall, k in walls:
            end = 0 if wall.side == "left" else -1
            x = w if wall.field is None else w[wall.field]
            share = jnp.zeros_like(x).at[end].set(k * x[end])
            total = _add(total, share if wall.field is None else {wall.field: share})
        return jax.tree.map(jnp.divide, total, mass)

    def power(_, w):
        grown = jax.tree.map(lambda a, b: a + 1e-9 * b, apply(w), w)
        size = jnp.max(jnp.stack([jnp.max(x) for x in jax.tree.leaves(grown)]))
        return jax.tree.map(lambda x: jnp.maximum(x / jnp.where(size > 0, size, 1), 1e-12), grown)

    w = jax.lax.fori_loop(0, power_steps, power, ones)
    ratios = jax.tree.map(lambda a, b: jnp.max(a / b), apply(w), w)
    return jnp.sqrt(jnp.max(jnp.stack(jax.tree.leaves(ratios))))


def _add(total, part):
    if isinstance(total, dict):
        return {name: total[name] + part[name] if name in part else total[name] for name in total}
    return total + part


def _both_ways(strain_map, k, w, lattice):
    pairs = strain_map.pairs if isinstance(strain_map, Stretch) else strain_map
    if hasattr(pairs, "reach"):
        return pairs.reach_back(k * pairs.reach(w))
    size = sum(x.size for x in jax.tree.leaves(w))
    if size > DENSE_LIMIT:
        remedy = f"{type(strain_map).__name__} gives no bound for {size} sites; give step=."
        refuse("step", "a time step", "None", remedy)
    B = jax.tree.map(jnp.abs, jax.jacobian(strain_map.strain)(lattice.zeros()))
    _, transpose = jax.vjp(lambda w: _contract(B, w), w)
    return transpose(k * _contract(B, w))[0]


def _contract(B, w):
    return sum(jnp.tensordot(b, x, axes=x.ndim) for b, x in zip(jax.tree.leaves(B), jax.tree.leaves(w)))


def _turning(term):
    """Transverse stiffness |F0|/L of a bond that turns."""
    if not isinstance(term.strain_map, Stretch):
        return 0.0
    return jnp.max(jnp.abs(term.law.preload)) / jnp.min(jnp.linalg.norm(term.strain_map.vector, axis=-1))


def _stiffest(law, energy, waveforms):
    """Largest F'(x) over the compressions x that the energy (and the drive) can reach, per bond."""
    like = jax.eval_shape(lambda e: law.force(e) + 0 * energy, jnp.zeros_like(energy))
    zero = jnp.zeros(like.shape, like.dtype)
    force, displacement = (jnp.zeros((), like.dtype),) * 2 if waveforms is None else waveforms[1:3]

    def reachable(x):
        within = (law.energy(x) <= energy) & (energy > 0)
        return within | (jnp.abs(law.force(x)) <= force) & (force > 0) | (jnp.abs(x) <= displacement)

    ends = [_furthest(reachable, zero, sign) for sign in (1.0, -1.0)]
    fractions = jnp.linspace(0.0, 1.0, 33, dtype=like.dtype)

    def slope(x):
        return jax.jvp(law.force, (x,), (jnp.ones_like(x),))[1]

    def largest(end):
        x = fractions.reshape((-1,) + (1,) * zero.ndim) * end
        k = jnp.abs(slope(x))
        if _softens(law):
            k = jnp.where(law.overlap(x) > CLOSED_FRACTION * law.overlap(zero), k, 0)
        return jnp.max(jnp.where(jnp.isfinite(k), k, 0), axis=0)

    return jnp.maximum(largest(ends[0]), largest(ends[1]))


def _furthest(reachable, zero, sign):
    """Largest |x| of one sign within reach: doubling, then bisection."""
    def double(_, state):
        x, going = state
        going = going & reachable(sign * 2 * x)
        return jnp.where(going, 2 * x, x), going

    start = zero + jnp.asarray(2.0**-60, zero.dtype)
    x, _ = jax.lax.fori_loop(0, 100, double, (start, reachable(sign * start)))

    def bisect(_, interval):
        low, high = interval
        middle = (low + high) / 2
        inside = reachable(sign * middle)
        return jnp.where(inside, middle, low), jnp.where(inside, high, middle)

    low, _ = jax.lax.fori_loop(0, 40, bisect, (x, 2 * x))
    return sign * jnp.where(reachable(sign * start), low, 0)


def _softens(law):
    """Whether a contact in the law has an exponent below 1, infinitely stiff where it re-opens."""
    if isinstance(law, Sum):
        return any(_softens(part) for part in law.parts)
    if isinstance(law, (Scaled, Yielding)):
        return _softens(law.law)
    exponent = concrete(law.exponent) if isinstance(law, PowerLaw) else None
    return exponent is not None and bool(((exponent > 0) & (exponent < 1)).any())


def softens(lattice):
    """Whether a re-opening contact of the lattice is infinitely stiff, so that no step bound exists there."""
    bare = [getattr(term, "term", term) for term in lattice.terms]
    return any(_softens(term.law) for term in bare if hasattr(term, "law"))
