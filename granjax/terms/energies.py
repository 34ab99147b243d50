"""The energy of a term per site, and whether its force is the energy's gradient."""

from functools import reduce
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..base.arrays import trailing
from ..base.checks import refuse
from ..base.types import Displacements, Number, Numbers
from .base import Term, within
from .bonds import Joined
from .reach import per_lane

# The most displacements for which an energy is shared out by a dense computation.
DENSE = 4000


def site_energy(term: Term, lattice: Any, t: Number, u: Displacements) -> Displacements | None:
    """Return the potential energy per site, with the structure of `u` (or some of its fields).

    Bonds share theirs by the weights of their ends in the strain; an array over the sites stays as
    it is. Other energies are shared by their squared derivatives, a dense computation that is
    refused for large lattices.
    """
    energy = term.energy(t, u)
    inner = within(term)
    if energy is None or isinstance(energy, dict):
        return energy
    if isinstance(inner, Joined):
        return inner.strain_map.split(energy, u)
    if not isinstance(u, dict) and energy.shape == u.shape:
        return energy
    size = sum(x.size for x in jax.tree.leaves(u))
    if size > DENSE:
        refuse(
            "lattice",
            f"at most {DENSE} displacements where {type(term).__name__} shares out its energy",
            f"{size}",
            "Give its energy as an array over the sites, or write it as a Bond.",
        )
    lanes = len(lattice.lanes)
    own = energy.ndim - lanes
    # The lanes are independent, so the derivatives of their sum are the derivatives of each.
    slopes = jax.jacrev(lambda u: term.energy(t, u).sum(tuple(range(own, own + lanes))))(u)
    sites = lambda x: tuple(range(own, x.ndim - lanes))
    largest = reduce(jnp.maximum, (jnp.max(jnp.abs(x), sites(x)) for x in jax.tree.leaves(slopes)))
    # An energy that is flat there has no derivatives to be shared by: all sites get the same.
    flat = largest <= jnp.sqrt(jnp.finfo(largest.dtype).tiny)
    scale = jax.lax.stop_gradient(jnp.where(flat, 1, largest))

    def beside(x, like):
        # One number for each energy and lane, in a shape that broadcasts with those of the sites.
        return x.reshape(x.shape[:own] + (1,) * (like.ndim - lanes - own) + x.shape[own:])

    weights = jax.tree.map(
        lambda x: jnp.where(beside(flat, x), 1, (x / beside(scale, x)) ** 2), slopes
    )
    share = energy / sum(w.sum(sites(w)) for w in jax.tree.leaves(weights))
    return jax.tree.map(lambda w: jnp.sum(beside(share, w) * w, tuple(range(own))), weights)


def energy_gap(term: Term, lattice: Any, t: Number, u: Displacements) -> Numbers:
    """Return the mismatch |dE + F.w|/(sum of |dE| and |F w|) along one irregular displacement w.

    Zero, up to rounding (also of the preloads), for a force that conserves energy. Shape of the
    lanes.
    """
    lanes = len(lattice.lanes)

    def along(force):
        return [force[name] * w[name] for name in force] if isinstance(force, dict) else [force * w]

    w = jax.tree.map(lambda x: _irregular(x, x.ndim - lanes), u)
    _, change = jax.jvp(lambda u: term.energy(t, u), (u,), (w,))
    # Displacements are known only up to rounding, and the force of a uniform motion is nothing but
    # the effect of that rounding.
    far = jnp.max(
        jnp.stack([jnp.max(jnp.abs(x), tuple(range(x.ndim - lanes))) for x in jax.tree.leaves(u)]),
        0,
    )
    still = jax.tree.map(jnp.zeros_like, u)
    force, uncertain = jax.jvp(
        lambda u: term.force(t, u, still, lattice.mass),
        (u,),
        (jax.tree.map(lambda x: far * x, w),),
    )
    parts = jax.tree.leaves(change) + along(force)
    size = sum(per_lane(jnp.abs(x), lanes) for x in parts)
    held = [jnp.broadcast_to(c.law.preload, c.compression.shape) for c in term.compressions(t, u)]
    rounded = sum(per_lane(jnp.abs(x), lanes) for x in held + along(uncertain))
    rounding = 16 * jnp.finfo(size.dtype).eps * rounded
    missed = jnp.maximum(jnp.abs(per_lane(parts, lanes)) - rounding, 0)
    return missed / jnp.where(size > 0, size, 1)


def _irregular(like, axes):
    own = like.shape[:axes]
    i = np.arange(int(np.prod(own)))
    x = np.cos(i**2 * 0.6180339887498949 + i).reshape(own)
    return jnp.broadcast_to(trailing(x, like.ndim), like.shape).astype(like.dtype)
