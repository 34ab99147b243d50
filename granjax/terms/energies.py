"""Energies of a term: who has them, and whether its force is their slope."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..checks import refuse
from ..types import Displacements, Number, Numbers
from .base import Term, within
from .bonds import Joined
from .reach import per_lane

DENSE = 4000


def site_energy(term: Term, lattice: Any, t: Number, u: Displacements) -> Displacements | None:
    """Potential energy shared out to sites, of the structure of `u` (or of some of its fields).

    Bonds share theirs as their ends weigh in the strain; an array over the sites stays as it is. The energies of other
    terms are shared out as the squares of their derivatives weigh the sites; dense, and refused for a large lattice.
    """
    energy, inner = term.energy(t, u), within(term)
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
    lanes, own = len(lattice.lanes), energy.ndim - len(lattice.lanes)
    # lanes do not mix, so the derivatives of their sum are those of each
    slopes = jax.jacrev(lambda u: term.energy(t, u).sum(tuple(range(own, own + lanes))))(u)
    weights = jax.tree.map(lambda x: x * x + jnp.finfo(x.dtype).tiny, slopes)
    whole = sum(w.sum(tuple(range(own, w.ndim - lanes))) for w in jax.tree.leaves(weights))
    share = energy / whole
    return jax.tree.map(
        lambda w: jnp.sum(
            share.reshape(share.shape[:own] + (1,) * (w.ndim - lanes - own) + share.shape[own:])
            * w,
            tuple(range(own)),
        ),
        weights,
    )


def energy_gap(term: Term, lattice: Any, t: Number, u: Displacements) -> Numbers:
    """How far the force is from the slope of the energy, relative: |dE + F.w|/(sum of |dE| and |F w|), along one w.

    Zero, to rounding (also that of the preloads), for a force that keeps the energy; w is irregular. Shape of the
    lanes.
    """
    lanes = len(lattice.lanes)

    def along(force):
        return [force[name] * w[name] for name in force] if isinstance(force, dict) else [force * w]

    w = jax.tree.map(lambda x: _irregular(x, x.ndim - lanes), u)
    _, change = jax.jvp(lambda u: term.energy(t, u), (u,), (w,))
    # displacements are known to their rounding alone, and a motion all alike has no force beyond what that makes
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
    """Numbers between -1 and 1 without pattern over the leading axes, of the shape of an array."""
    size = int(np.prod(like.shape[:axes]))
    x = np.cos(np.arange(size) ** 2 * 0.6180339887498949 + np.arange(size)).reshape(
        like.shape[:axes]
    )
    return jnp.broadcast_to(x.reshape(x.shape + (1,) * (like.ndim - axes)), like.shape).astype(
        like.dtype
    )
