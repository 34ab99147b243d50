"""Long chains: all stages of a step on one block of sites after another, in the cache.

At stage j the window of a block has moved j sites to the left. The sites that it reads on its left
have been through as many stages, and those on its right are still untouched. So nothing is computed
twice, and the arrays are passed through once per step.
"""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.lax import dynamic_slice, dynamic_update_slice

from ..base.tuning import blocks_win
from ..base.types import StateLike
from ..laws import Law
from ..solvers.split_system import Split, by_stages, pair
from .model import Lattice
from .split import (
    ChainSplit,
    PlainSplit,
    SpringSplit,
    damped_flight,
    damping_rates,
    next_neighbours,
    split_system,
    vector_field,
)

# The sites of a block.
BLOCK = 512
# The sites of a chain from which on blocks pay off.
LONG = 100_000


class BlockSplit(Split):
    """A long chain with one bond to the next site, with walls, free ends or as a ring: w = (u, v).

    No force is kept. `stages` is the same chain by stages, which derivatives use; `boundary` is
    that of the bonds. The arrays have a margin on both sides, whose sites stay at rest. For a ring
    the margin holds the other end; errors at the end of a margin move inwards by one site per
    stage.
    """

    stages: ChainSplit | PlainSplit | SpringSplit
    law: Law
    boundary: str = eqx.field(static=True)

    def start(self, t, y):
        return ()

    def enter(self, y, cache):
        return tuple(y)

    def leave(self, w, like):
        return pair(like, *w), ()

    def acceleration(self, y, cache):
        return self.stages.acceleration(y, self.stages.start(jnp.zeros(()), y))

    def compose(self, w, table, t, h):
        numbers, rest = eqx.partition(self, eqx.is_array)
        return _composed(rest, table, numbers, w, t, h)


@partial(jax.custom_jvp, nondiff_argnums=(0, 1))
def _composed(rest, table, numbers, w, t, h):
    return _in_blocks(eqx.combine(numbers, rest), table, w, h)


@_composed.defjvp
def _composed_jvp(rest, table, primals, tangents):
    def plain(numbers, w, t, h):
        system = eqx.combine(numbers, rest).stages
        return tuple(
            system.leave(by_stages(system, system.enter(w, system.start(t, w)), table, t, h), w)[0]
        )

    return jax.jvp(plain, primals, tangents)


class _Chain(eqx.Module):
    """The arrays of a chain, with `margin` sites in front and room behind.

    A bond has the index of the site on its right.
    """

    law: Law
    inverse_mass: jax.Array
    rate: jax.Array | None
    sites: int = eqx.field(static=True)
    margin: int = eqx.field(static=True)
    open_ends: bool = eqx.field(static=True)

    def window(self, x, first):
        return dynamic_slice(x, (first,), (BLOCK,)) if jnp.ndim(x) and x.shape[0] > 1 else x

    def inside(self, first, low, high):
        at = first - self.margin + jnp.arange(BLOCK)
        return (at >= low) & (at < high)

    def mobility(self, first):
        inverse = self.window(self.inverse_mass, first)
        return (
            inverse
            if jnp.ndim(self.inverse_mass)
            else jnp.where(self.inside(first, 0, self.sites), inverse, 0)
        )

    def force(self, first, left, right):
        force = (
            jax.tree.map(lambda x: self.window(x, first), self.law)
            .force(left - right)
            .astype(left.dtype)
        )
        return jnp.where(self.inside(first, 1, self.sites), force, 0) if self.open_ends else force

    def kick(self, near, first, at, bh):
        # Kicks sites from place `at` on of the window `near`, which begins at site `first` of the
        # chain.
        u, v, f = near
        pull = dynamic_slice(f, (at,), (BLOCK,)) - dynamic_slice(f, (at + 1,), (BLOCK,))
        moved = dynamic_slice(v, (at,), (BLOCK,)) + bh * self.mobility(first + at) * pull
        return u, dynamic_update_slice(v, moved, (at,)), f

    def drift(self, near, first, at, ah):
        u, v, f = near
        rate = None if self.rate is None else self.window(self.rate, first + at)
        here = (dynamic_slice(x, (at,), (BLOCK,)) for x in (u, v))
        u, v = (
            dynamic_update_slice(x, new, (at,))
            for x, new in zip((u, v), damped_flight(*here, rate, ah))
        )
        return u, v, f

    def push(self, near, first, at):
        # The forces of the bonds on the left of the sites from place `at` on.
        u, v, f = near
        left, right = (dynamic_slice(u, (at - shift,), (BLOCK,)) for shift in (1, 0))
        return u, v, dynamic_update_slice(f, self.force(first + at, left, right), (at,))


def _in_blocks(system, table, w, h):
    u, v = w
    ah, bh = ((x * h).astype(v.dtype) for x in (table.a, table.b))
    stages = len(table.a)
    ring = system.boundary == "periodic"
    margin = stages + 1
    around = (lambda x: jnp.concatenate([x[-margin:], x, x[:margin]])) if ring else lambda x: x
    sites = u.shape[0] + 2 * margin * ring
    count = -(-(sites + stages) // BLOCK)
    behind = count * BLOCK + 1 - sites
    chain = _prepared(system, u, around, sites, margin, behind)
    u, v = (jnp.pad(around(x), (margin, behind)) for x in w)

    def block(k, carry):
        u, v, near = carry
        first = k * BLOCK
        near = through(_entered(chain, near, u, v, first), first)
        u, v = (
            dynamic_update_slice(x, dynamic_slice(own, (1,), (BLOCK,)), (first + 1,))
            for x, own in zip((u, v), near)
        )
        return u, v, tuple(dynamic_update_slice(x, x[BLOCK:], (0,)) for x in near)

    def through(near, first):
        # All stages on a window that begins at site `first` of the chain.
        def stage(j, near):
            near = chain.push(chain.drift(near, first, margin - j, ah[j]), first, margin - j)
            return chain.kick(near, first, margin - j - 1, bh[j + 1])

        if table.b[0] != 0:
            near = chain.kick(near, first, margin, bh[0])
        near = chain.drift(jax.lax.fori_loop(0, stages - 1, stage, near), first, 2, ah[-1])
        return (
            chain.kick(chain.push(near, first, 2), first, 1, bh[-1]) if table.b[-1] != 0 else near
        )

    wall = chain.force(margin, u[margin - 1 : margin - 1 + BLOCK], u[margin : margin + BLOCK])
    f = dynamic_update_slice(jnp.zeros(margin + BLOCK + 1, u.dtype), wall, (margin,))
    near = jnp.zeros(margin + BLOCK, u.dtype), jnp.zeros(margin + BLOCK, v.dtype), f
    u, v, _ = jax.lax.fori_loop(0, count, block, (u, v, near))
    begin = margin + margin * ring
    return tuple(x[begin : begin + len(own)] for x, own in zip((u, v), w))


def _entered(chain, near, u, v, first):
    # Adds the next block of the chain behind the window, with the forces at the start of the step.
    at = chain.margin
    fresh = dynamic_slice(u, (first + at,), (BLOCK + 1,))
    force = chain.force(first + at + 1, fresh[:-1], fresh[1:])
    new = fresh[:-1], dynamic_slice(v, (first + at,), (BLOCK,)), force
    return tuple(
        dynamic_update_slice(x, part, (place,))
        for x, part, place in zip(near, new, (at, at, at + 1))
    )


def _prepared(system, u, around, sites, margin, behind):
    lattice = system.stages.lattice
    first = 0 if system.boundary == "fixed" else 1
    bonds = _bonds(u.shape[0], system.boundary)

    def along(x):
        if jnp.ndim(x) == 0 or x.shape[0] != bonds:
            return x
        x = around(x)
        return jnp.pad(x, (margin + first, sites + behind + 1 - first - x.shape[0]), mode="edge")

    own = lambda x: (
        jnp.pad(around(x), (margin, behind))
        if jnp.ndim(x) and x.shape[0] == u.shape[0]
        else jnp.squeeze(x)
    )
    ((_, rate),) = damping_rates(lattice, u)
    inverse = own(jnp.asarray(1 / lattice.mass, u.dtype))
    return _Chain(
        jax.tree.map(along, system.law),
        inverse,
        None if rate is None else own(jnp.asarray(rate)),
        sites,
        margin,
        system.boundary != "fixed",
    )


def in_blocks(lattice: Lattice, y: StateLike) -> BlockSplit | None:
    """Return the split system of a long chain with one bond to the next site; else `None`."""
    shape = () if lattice.fields else np.shape(y[0])
    if lattice.lanes or len(shape) != 1 or shape[0] < LONG or not blocks_win():
        return None
    found = next_neighbours(lattice)
    if found is None:
        return None
    law, boundary = found
    # A window takes the parameters of its bonds; a table of the law belongs to all bonds.
    shapes = {np.shape(x) for x in jax.tree.leaves(law) if eqx.is_array(x)}
    own = shapes - {(), (1,), (_bonds(shape[0], boundary),)}
    return None if own else BlockSplit(split_system(lattice), law, boundary)


def _bonds(sites, boundary):
    return sites + {"fixed": 1, "free": -1, "periodic": 0}[boundary]


vector_field.in_blocks = in_blocks
