"""Analysis of a term: what its force reads, what a motion can reach, the stiffness there."""

from collections.abc import Callable
from functools import lru_cache
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jax.interpreters.partial_eval import dce_jaxpr

from ..base.arrays import trailing
from ..base.checks import traced as is_traced
from ..base.printing import told
from ..base.programs import compiled, concretely, holds
from ..base.types import Displacements, Flags, Number, Numbers, Pytree
from ..strains.maps import spectral_radius

# The number of compressions, from rest to either end of the reach, at which the stiffness is
# evaluated.
SAMPLES = 33
# Doublings of the least length, from 2^-60 to 2^40.
DOUBLED = 100
# Halvings that follow, to 2^-40 of the interval.
HALVED = 40
# A contact with an exponent below 1 is infinitely stiff where it opens. The bound uses only
# overlaps above this fraction of the overlap at rest.
CLOSED_FRACTION = 0.05


class Reach(eqx.Module):
    """What a motion can reach.

    **Fields:** `energy`: of one bond or site [J], (2,) and lanes: for extension and compression.
    `force`: the largest of a drive. `displacement` (2,): what a moving wall transfers to each bond
    in extension and compression, or `None`; `width`: the number of bonds whose energy from it may
    gather in one. `ts`: times at which changing parameters are evaluated. `u`: displacements at the
    start. `seen`: the least and largest compressions of every law in an earlier run, which replace
    the estimate, or `None`.
    """

    energy: jax.Array
    force: jax.Array
    displacement: jax.Array | None
    width: int
    ts: jax.Array
    u: object
    seen: tuple | None = None
    __repr__ = told

    def stiffest(self, law: Any, index: int) -> Numbers:
        """Return the largest |F'(x)| within reach, per bond; `index` counts the term's laws."""
        return steepest(law, *self.ends(law, index))

    def opens(self, law: Any) -> Flags:
        """Return whether some contact of the law may open."""
        overlaps = [law.overlap(x) for x in self.ends(law, 0)]
        return jnp.any(
            jnp.stack([jnp.min(s) <= 0 for s in overlaps if s is not None] or [jnp.zeros((), bool)])
        )

    def ends(self, law: Any, index: int) -> Any:
        """Return the least (<= 0) and largest (>= 0) compressions within reach."""
        if self.seen is not None:
            low, high = self.seen
            return jnp.minimum(low[index], 0), jnp.maximum(high[index], 0)
        like = jax.eval_shape(
            lambda e: law.force(e) + 0 * self.energy[0], jnp.zeros_like(self.energy[0])
        )
        sign = trailing(jnp.asarray([-1.0, 1.0], like.dtype), 1 + like.ndim)
        energy = self.energy.reshape(
            sign.shape[: sign.ndim + 1 - self.energy.ndim] + self.energy.shape[1:]
        )
        shared = None
        if self.displacement is not None:
            share = self.displacement.reshape(sign.shape)
            shared = jnp.where(share > 0, self.width * law.energy(sign * share), -1)

        def reachable(x):
            stored = law.energy(x)
            within = (stored <= energy) & (energy > 0)
            within = within if shared is None else within | (stored <= shared)
            return within | (jnp.abs(law.force(x)) <= self.force) & (self.force > 0)

        return furthest(reachable, jnp.zeros((2, *like.shape), like.dtype), sign)


def steepest(law: Any, low: Numbers, high: Numbers):
    """Return the largest |F'(x)| for low <= 0 <= high; well closed if the law softens."""
    fractions = jnp.linspace(0.0, 1.0, SAMPLES, dtype=low.dtype)

    ends = jnp.stack([low, high])
    x = trailing(fractions, 1 + ends.ndim) * ends
    k = jnp.abs(law.derivative(x))
    if law.softens:
        k = jnp.where(law.overlap(x) > CLOSED_FRACTION * law.overlap(jnp.zeros_like(ends)), k, 0)
    return jnp.max(jnp.where(jnp.isfinite(k), k, 0), axis=(0, 1))


def furthest(reachable: Callable, zero: Numbers, sign: Numbers | float):
    """Return the largest reachable |x| of one sign.

    By doubling, then bisection, in one loop that is compiled once.
    """
    start = zero + jnp.asarray(2.0**-60, zero.dtype)

    def closer(i, state):
        low, high, going = state
        doubling = i <= DOUBLED
        x = jnp.where(doubling, high, (low + high) / 2)
        inside = reachable(sign * x) & (going | ~doubling)
        high = jnp.where(inside == doubling, jnp.where(doubling, 2 * x, x), high)
        return jnp.where(inside, x, low), high, inside

    low, *_ = jax.lax.fori_loop(
        0, DOUBLED + 1 + HALVED, closer, (zero, start, jnp.ones(zero.shape, bool))
    )
    return sign * jnp.where(low >= start, low, 0)


def per_lane(tree: Pytree, lanes: int) -> Number:
    """Return the sum of all arrays over their sites or bonds, for each of the last `lanes` axes."""
    return sum(x.sum(tuple(range(x.ndim - lanes))) for x in jax.tree.leaves(tree))


def largest_eigenvalue(term: Any, lattice: Any, reach: Reach) -> Any:
    """Return the largest |eigenvalue| of M^{-1/2} dF/du M^{-1/2} of one term within reach."""
    t = reach.ts[0]
    zeros = lattice.zeros()
    lanes = len(lattice.lanes)
    energy = jnp.max(reach.energy)

    def stored(u):
        return jnp.max(per_lane(term.energy(t, u), lanes))

    def along(a, direction):
        return jax.tree.map(lambda x: a * x, direction)

    def within(direction):
        size = furthest(lambda a: (stored(along(a, direction)) <= energy) & (energy > 0), zero, 1.0)
        # A displacement without energy would be infinite; it is left out.
        return along(jnp.where(stored(along(2 * size, direction)) > energy, size, 0), direction)

    def eigenvalue(u):
        _, slope = jax.linearize(lambda u: term.force(t, u, zeros, lattice.mass), u)
        found = spectral_radius(slope, lattice)
        return jnp.where(jnp.isfinite(found), found, 0)

    zero = jnp.zeros((), lattice.dtype)
    largest = jnp.maximum(eigenvalue(zeros), eigenvalue(reach.u))
    if not reads(term, lattice).energy:
        return largest

    def further():
        return jnp.max(
            jax.lax.map(lambda direction: eigenvalue(within(direction)), _directions(lattice))
        )

    return jnp.maximum(largest, jax.lax.cond(energy > 0, further, lambda: zero))


def components(lattice: Any) -> list:
    """Return the uniform displacements, one for each component of each field."""
    zeros = jax.tree.map(lambda s: np.zeros(s.shape, s.dtype), lattice.template())
    moves = []
    for i in range(lattice.dimension or 1):
        # The vector axis comes before the lanes.
        place = (..., i) + (slice(None),) * len(lattice.lanes) if lattice.dimension else ...
        for name in zeros if isinstance(zeros, dict) else (None,):
            move = jax.tree.map(np.copy, zeros)
            (move if name is None else move[name])[place] = 1
            moves.append(move)
    return moves


def _directions(lattice):
    found = []
    for move in components(lattice):
        moving = next(x for x in jax.tree.leaves(move) if x.any())
        for pattern in _patterns(moving.shape[: lattice.axes]):
            wide = trailing(pattern, moving.ndim).astype(moving.dtype)
            found += [
                jax.tree.map(lambda x: sign * wide * x if x.any() else x, move)
                for sign in (1.0, -1.0)
            ]
    return jax.tree.map(lambda *x: jnp.asarray(np.stack(x)), *found)


def _patterns(shape):
    n = shape[0]
    size = int(np.prod(shape))
    for place in sorted({0, size // 4, size // 2, size - 1}):
        single = np.zeros(shape)
        single.flat[place] = 1
        yield single
        yield single - np.roll(single, 1, 0)
    along = trailing(np.arange(n), len(shape)) * np.ones(shape)
    yield from (np.where(along < n // 2, 1.0, 0.0), (-1.0) ** along, np.ones(shape))


# The sizes of the displacements about which the derivative of a force is evaluated.
SCALES = 10.0 ** np.arange(-12, 4)
# The answer to a displacement, relative to that to a random one, up to which it counts as zero.
RESISTS = 1e-9


class Dependence(NamedTuple):
    """What a force reads: `time`, `displacement`, `velocity`; whether the term stores `energy`.

    `transforms`: it uses an FFT, which XLA compiles for the CPU only in some memory layouts: no
    `vmap`.
    """

    time: bool = False
    displacement: bool = False
    velocity: bool = False
    energy: bool = False
    transforms: bool = False

    @property
    def conserves(self):
        """Whether the term conserves energy."""
        return self.energy and not self.time and not self.velocity


def traced(term: Any, lattice: Any):
    """Return (shapes of the force, `Dependence`) of a term on a lattice, cached by structure."""
    arguments = term, time_of(lattice), lattice.template(), lattice.mass
    leaves, structure = jax.tree.flatten(arguments)
    key = tuple(_abstract(x) for x in leaves)
    try:
        return _traced_force(structure, key)
    except TypeError as error:
        if "unhashable" not in str(error):
            raise
        return _traced_force.__wrapped__(structure, key)


def reads(term: Any, lattice: Any) -> Dependence:
    """Return what the force of a term reads."""
    return traced(term, lattice)[1]


def time_of(lattice: Any):
    """Return the shape and type of a time on the lattice."""
    return jax.ShapeDtypeStruct((), lattice.dtype)


@lru_cache(maxsize=1024)
def _traced_force(structure, leaves):
    term, t, u, mass = jax.tree.unflatten(structure, leaves)

    def force(term, t, u, v, mass):
        return term.force(t, u, v, mass)

    shapes, transforms, time, displacement, velocity = used(force, (term, t, u, u, mass), (1, 2, 3))
    stores = eqx.filter_eval_shape(lambda term, t, u: term.energy(t, u), term, t, u) is not None
    return shapes, Dependence(time, displacement, velocity, stores, transforms)


def used(function: Callable, arguments: tuple, places: tuple = (1,)):
    """Return (shapes of the result, whether it uses an FFT, whether it reads each argument)."""
    arguments = jax.tree.map(_abstract, arguments)
    closed, shapes, _ = eqx.filter_make_jaxpr(function)(*arguments)
    _, used = dce_jaxpr(closed.jaxpr, [True] * len(closed.out_avals))
    shaped = eqx.filter(arguments, lambda x: isinstance(x, jax.ShapeDtypeStruct))
    used = jax.tree.unflatten(jax.tree.structure(shaped), used)
    return (
        shapes,
        holds(closed.jaxpr, "fft"),
        *(any(jax.tree.leaves(used[place])) for place in places),
    )


def _abstract(x):
    if isinstance(x, (jax.Array, np.ndarray, np.generic, jax.ShapeDtypeStruct)):
        return jax.ShapeDtypeStruct(x.shape, x.dtype)
    return x


def stand_in(x: Number, random: np.random.Generator | None = None) -> Number:
    """Return the value; where it is traced, ones, or random numbers between 1 and 2."""
    x = jax.lax.stop_gradient(x) if is_traced(x) else x
    if not is_traced(x):
        return x
    found = np.ones(x.shape) if random is None else random.uniform(1, 2, x.shape)
    return found.astype(x.dtype)


def answers_to(moves: list, term: Any, mass: Displacements | Number, template: Pytree):
    """Return dF/du along some displacements (scales, n, moves), relative to a random one."""
    random = np.random.default_rng(0)
    where, other = (
        jax.tree.map(lambda s: random.normal(size=s.shape).astype(s.dtype), template)
        for _ in range(2)
    )
    fixed = moves, term, mass, where, other
    return np.stack([concretely(_answers, *fixed, np.asarray(scale)) for scale in SCALES])


@compiled
def _answers(moves, term, mass, where, other, scale):
    zeros = jax.tree.map(jnp.zeros_like, where)

    def push(u):
        return _raveled(term.force(jnp.zeros(()), u, zeros, mass), zeros)

    slope = jax.linearize(push, jax.tree.map(lambda x: scale.astype(x.dtype) * x, where))[1]
    size = jnp.max(jnp.abs(slope(other)))
    columns = jnp.stack([slope(move) for move in moves], -1) / jnp.where(size > 0, size, 1)
    good = jnp.isfinite(size) & jnp.all(jnp.isfinite(columns))
    least = max(RESISTS, 1e3 * float(jnp.finfo(columns.dtype).eps))
    return jnp.where(good & (jnp.abs(columns) > least), columns, 0)


def _raveled(force, zeros):
    if isinstance(zeros, dict):
        force = {name: force.get(name, zero) for name, zero in zeros.items()}
    return ravel_pytree(jax.tree.map(lambda f, u: jnp.broadcast_to(f, u.shape), force, zeros))[0]
