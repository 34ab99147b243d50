"""Lattices of the plane: the network of forces, angular momentum, what slips."""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from ..checks import refuse
from ..lattice import Lattice
from ..printing import told
from ..strains.maps import TwoEnds
from ..terms.base import within
from ..types import Displacements, Number, Numbers, StateLike
from .states_of import parts


class ForceNetwork(NamedTuple):
    """The bonds of a lattice at a state: `segments` (bonds, 2, d), where they are [m]; `force` (bonds,) in each [N]."""

    segments: jax.Array
    force: jax.Array
    __repr__ = told


def placed(lattice: Lattice, what: str) -> Displacements:
    """The positions of one lattice that has them."""
    if lattice.positions is None:
        refuse(
            "lattice",
            f"a lattice with positions, for {what}",
            "one without",
            "The scenes of the plane have them; gx.Lattice(..., positions=...).",
        )
    if lattice.lanes:
        refuse("lattice", "one lattice", f"a batch with lanes {lattice.lanes}", "Take one lane.")
    return lattice.positions


def force_network(lattice: Lattice, y: StateLike, t: Number = 0.0) -> ForceNetwork:
    """Where the bonds are and what force each carries, total and positive in compression: for `gx.plots.beads`.

    Bonds around a ring, of which only one end is where the bond is, are drawn from their tail; of scalar displacements
    they are left out. **Raises** ValueError for a lattice without positions, or a batch.

    **Example:**

    >>> crystal = gx.scenes.square(5)
    >>> state = gx.State(crystal.zeros().at[2, 2, 0].set(0.1), crystal.zeros())
    >>> network = gx.measures.force_network(crystal, state)
    >>> network.force.shape, round(float(network.force.max()), 6)
    ((60,), 0.1)
    """
    places = placed(lattice, "a picture of its bonds")
    u, _ = parts(lattice, y, t)
    segments, forces = [], []
    for term in lattice.terms:
        strain_map = getattr(within(term), "strain_map", None)
        ends = None if strain_map is None else _ends(strain_map, places, u)
        for contact in term.compressions(t, u):
            if ends is not None:
                d = ends[0].shape[-1]
                segments.append(jnp.stack(ends, -2).reshape(-1, 2, d))
                forces.append(jnp.broadcast_to(contact.force, ends[0].shape[:-1]).reshape(-1))
    lines, force = jnp.concatenate(segments), jnp.concatenate(forces)
    length = jnp.linalg.norm(lines[:, 1] - lines[:, 0], axis=-1)
    # a bond between numbers, not vectors, that goes around a ring
    short = length < 2.5 * jnp.nanmin(length)
    return ForceNetwork(lines[short], force[short])


def _ends(strain_map, places, u):
    """Present places (bonds, d) of tails and heads, from those at rest; NaN where no site is, `None` of other maps."""
    pairs = getattr(strain_map, "pairs", strain_map)
    if not isinstance(pairs, TwoEnds) or strain_map.tangential:
        return None
    tail, head = pairs.ends(places)
    there = pairs.ends(jax.tree.map(jnp.ones_like, places))
    vector = getattr(strain_map, "vector", None)
    if vector is None:
        both = jnp.minimum(*there) > 0
        return jnp.where(both, tail, jnp.nan), jnp.where(both, head, jnp.nan)
    axis, count = pairs.axes, strain_map.components
    moved, pushed = (jax.lax.slice_in_dim(x, 0, count, axis=axis) for x in pairs.ends(u))
    if vector.ndim == 1:
        vector = vector.reshape((count,) + (1,) * (moved.ndim - axis - 1))
    length = vector - (moved - pushed)
    # of a bond around a ring the head is where the bond leads, of a wall at the tail where it comes from
    tail = jnp.where(there[0] > 0, tail + moved, head + pushed - length)
    return tail, tail + length


def slip_ratio(lattice: Lattice, y: StateLike, t: Number = 0.0) -> Numbers:
    r"""The largest ratio of tangential to normal force |T|/N of any contact: above the friction coefficient it slides.

    Of beads that turn (`rotation=True`): each `gx.strains.Slip` bond over the normal one that comes before it, with the
    same ends. Their `gx.terms.Grip` lets go where its contact opens: T is then zero, and so is the ratio. It is
    infinite where a `Bond` of a slip pulls at an open contact. Typical friction coefficients: 0.1 ... 0.8.
    **Returns:** a number, shape of the lanes. **Raises** ValueError for a lattice without such pairs.
    """
    u, _ = parts(lattice, y, t)
    forces = [
        (term, c.force)
        for term in lattice.terms
        for c in term.compressions(t, u)
        if c.place == "bond"
    ]
    lanes, worst = len(lattice.lanes), []
    for (_, normal), (term, tangential) in zip(forces, forces[1:]):
        if not getattr(getattr(term, "strain_map", None), "tangential", False):
            continue
        T, N = jnp.abs(tangential), jnp.broadcast_to(normal, tangential.shape)
        closed = N > 0
        ratio = jnp.where(closed, T / jnp.where(closed, N, 1), jnp.where(T > 0, jnp.inf, 0.0))
        worst.append(ratio.max(tuple(range(ratio.ndim - lanes))))
    if not worst:
        refuse(
            "lattice", "contacts with a tangential force", "none", "Build it with rotation=True."
        )
    return jnp.max(jnp.stack(worst), 0)
