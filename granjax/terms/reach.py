"""What a motion may reach at its energy, and the stiffness there."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..printing import told
from ..strains.maps import spectral_radius
from ..types import Flags, Numbers
from .tracing import reads

SAMPLES = 33
# of the least length, 2^-60, up to 2^40; then of the interval, to 2^-40 of it
DOUBLED, HALVED = 100, 40
# a contact of exponent below 1 is infinitely stiff where it opens; the bound keeps this far from there
CLOSED_FRACTION = 0.05


class Reach(eqx.Module):
    """What a motion may reach.

    **Fields:** `energy`: of one bond or site [J], (2,) and lanes: what may extend it, and what may press it together.
    `force`: what a drive pushes with. `displacement` (2,): what a wall that moves leaves to each bond, to extend it and
    to press it together, `None` where nothing moves, and `width`: the bonds whose energy of that may gather in one.
    `ts`: times at which changing parameters are looked at. `u`: displacements at the start.
    """

    energy: jax.Array
    force: jax.Array
    displacement: jax.Array | None
    width: int
    ts: jax.Array
    u: object
    __repr__ = told

    def stiffest(self, law: Any, index: int) -> Numbers:
        """Largest |F'(x)| over the compressions x within reach, per bond; `index` counts the term's compressions."""
        return steepest(law, *self._ends(law))

    def opens(self, law: Any) -> Flags:
        """Whether some contact of the law may open."""
        overlaps = [law.overlap(x) for x in self._ends(law)]
        return jnp.any(
            jnp.stack([jnp.min(s) <= 0 for s in overlaps if s is not None] or [jnp.zeros((), bool)])
        )

    def _ends(self, law):
        like = jax.eval_shape(
            lambda e: law.force(e) + 0 * self.energy[0], jnp.zeros_like(self.energy[0])
        )
        sign = jnp.asarray([-1.0, 1.0], like.dtype).reshape((2,) + (1,) * len(like.shape))
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


class Reached(eqx.Module):
    """The least and the largest compressions, `low` and `high`, of every law of a term that a run has seen."""

    low: tuple
    high: tuple
    ts: jax.Array
    u: object
    energy: jax.Array
    __repr__ = told

    def stiffest(self, law: Any, index: int) -> Numbers:
        """Largest |F'(x)| over the compressions that were reached, per bond."""
        return steepest(law, jnp.minimum(self.low[index], 0), jnp.maximum(self.high[index], 0))


def steepest(law: Any, low: Numbers, high: Numbers):
    """Largest |F'(x)| for low <= 0 <= high, elementwise; for a law that softens, where it is well closed."""
    fractions = jnp.linspace(0.0, 1.0, SAMPLES, dtype=low.dtype)

    ends = jnp.stack([low, high])
    x = fractions.reshape((-1,) + (1,) * ends.ndim) * ends
    k = jnp.abs(law.derivative(x))
    if law.softens:
        k = jnp.where(law.overlap(x) > CLOSED_FRACTION * law.overlap(jnp.zeros_like(ends)), k, 0)
    return jnp.max(jnp.where(jnp.isfinite(k), k, 0), axis=(0, 1))


def furthest(reachable: Callable, zero: Numbers, sign: Numbers | float):
    """Largest |x| of one sign within reach: doubling, then bisection, in one loop, which is compiled once."""
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


def largest_eigenvalue(term: Any, lattice: Any, reach: Reach | Reached) -> Any:
    """Largest |eigenvalue| of M^{-1/2} dF/du M^{-1/2} of one term over displacements of the energy within reach."""
    t, zeros, lanes = reach.ts[0], lattice.zeros(), len(lattice.lanes)
    energy = jnp.max(reach.energy)

    def stored(u):
        parts = [e.sum(tuple(range(e.ndim - lanes))) for e in jax.tree.leaves(term.energy(t, u))]
        return jnp.max(sum(parts))

    def along(a, direction):
        return jax.tree.map(lambda x: a * x, direction)

    def within(direction):
        size = furthest(lambda a: (stored(along(a, direction)) <= energy) & (energy > 0), zero, 1.0)
        # a displacement that costs nothing is not sampled at infinity
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


def _directions(lattice):
    """Single displacements, neighbours in antiphase, a step and all together, of both signs; every lane alike."""
    template = lattice.template()
    found = []
    for name in template if isinstance(template, dict) else (None,):
        for component in range(lattice.dimension or 1):
            shape = (template if name is None else template[name]).shape[: lattice.axes]
            for pattern in _patterns(shape):
                for sign in (1.0, -1.0):
                    zeros = jax.tree.map(lambda s: np.zeros(s.shape, s.dtype), template)
                    x = zeros if name is None else zeros[name]
                    x = x[(slice(None),) * lattice.axes + (component,)] if lattice.dimension else x
                    x += sign * pattern.reshape(pattern.shape + (1,) * (x.ndim - pattern.ndim))
                    found.append(zeros)
    return jax.tree.map(lambda *x: jnp.asarray(np.stack(x)), *found)


def _patterns(shape):
    n, size = shape[0], int(np.prod(shape))
    for place in sorted({0, size // 4, size // 2, size - 1}):
        single = np.zeros(size)
        single[place] = 1
        yield single.reshape(shape)
        yield single.reshape(shape) - np.roll(single.reshape(shape), 1, 0)
    along = np.arange(n).reshape((n,) + (1,) * (len(shape) - 1)) * np.ones(shape)
    yield from (np.where(along < n // 2, 1.0, 0.0), (-1.0) ** along, np.ones(shape))
