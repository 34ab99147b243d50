"""Force networks and slip of two-dimensional lattices."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..base.checks import refuse
from ..base.printing import told
from ..base.programs import compiled
from ..base.types import Displacements, Number, Numbers, StateLike
from ..lattice import Lattice
from ..strains import Shift
from ..strains.maps import TwoEnds
from ..terms.base import within
from .states_of import parts


class ForceNetwork(NamedTuple):
    """The bonds at a state: their places `segments` (bonds, 2, d) [m] and `force` (bonds,) [N]."""

    segments: jax.Array
    force: jax.Array
    __repr__ = told


def placed(lattice: Lattice, what: str) -> Displacements:
    """Return the positions of one lattice that has them."""
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
    """Return the place and total force of bonds with two ends, for `gx.plots.beads`.

    The force is positive in compression. Bonds around a ring are drawn from their tail; with scalar
    displacements, long ones are left out. **Raises** ValueError for no positions, no such bonds, or
    a batch.

    **Example:**

    >>> crystal = gx.scenes.square(5)
    >>> state = gx.State(crystal.zeros().at[2, 2, 0].set(0.1), crystal.zeros())
    >>> network = gx.measures.force_network(crystal, state)
    >>> network.force.shape, round(float(network.force.max()), 6)
    ((60,), 0.1)
    """
    places = placed(lattice, "a picture of its bonds")
    lines, force, shown = _network(lattice, places, *parts(lattice, y, t), jax.device_put(t))
    return ForceNetwork(lines[shown], force[shown])


@compiled
def _network(lattice, places, u, v, t):
    segments = []
    forces = []
    for term in lattice.terms:
        strain_map = getattr(within(term), "strain_map", None)
        ends = None if strain_map is None else _ends(strain_map, places, u)
        for contact in term.moving(u, v).compressions(t, u):
            if ends is not None:
                d = ends[0].shape[-1]
                segments.append(jnp.stack(ends, -2).reshape(-1, 2, d))
                forces.append(jnp.broadcast_to(contact.force, ends[0].shape[:-1]).reshape(-1))
    if not segments:
        refuse(
            "lattice",
            "bonds of gx.Shift, gx.Stretch or gx.Pairs, which have two ends",
            "none",
            "Draw bonds of your own strain map yourself.",
        )
    lines = jnp.concatenate(segments)
    force = jnp.concatenate(forces)
    return lines, force, ~jnp.isnan(lines).any((1, 2))


def _ends(strain_map, places, u):
    # present places (bonds, d) of tails and heads; NaN for bonds that are not drawn, `None` for
    # other maps
    pairs = getattr(strain_map, "pairs", strain_map)
    if not isinstance(pairs, TwoEnds) or strain_map.tangential:
        return None
    tail, head = pairs.ends(places)
    there = pairs.ends(jax.tree.map(jnp.ones_like, places))
    vector = getattr(strain_map, "vector", None)
    if vector is None:
        shown = jnp.minimum(*there) > 0
        if isinstance(pairs, Shift):
            # leave out bonds that go around a ring, unless the sites stand in a circle; the one
            # around three sites in a line is twice as long as the others
            numbers = lambda x: np.moveaxis(np.indices(x.shape[:-1]), 0, -1)
            begin, end = pairs.ends(jax.tree.map(numbers, places))
            around = (end - begin != pairs.offset).any(-1, keepdims=True)
            length = jnp.linalg.norm(head - tail, axis=-1, keepdims=True)
            shortest = jnp.min(length, where=shown, initial=jnp.inf)
            shown &= ~around | (length < 1.5 * shortest)
        return jnp.where(shown, tail, jnp.nan), jnp.where(shown, head, jnp.nan)
    axis = pairs.axes
    count = strain_map.components
    moved, pushed = (jax.lax.slice_in_dim(x, 0, count, axis=axis) for x in pairs.ends(u))
    if vector.ndim == 1:
        vector = vector.reshape((count,) + (1,) * (moved.ndim - axis - 1))
    length = vector - (moved - pushed)
    # a bond around a ring ends where its vector leads; a bond from a wall starts where its vector
    # comes from
    tail = jnp.where(there[0] > 0, tail + moved, head + pushed - length)
    # a grid between walls also has bonds from wall to wall, at its corners
    tail = jnp.where(jnp.maximum(*there) > 0, tail, jnp.nan)
    return tail, tail + length


def slip_ratio(lattice: Lattice, y: StateLike, t: Number = 0.0) -> Numbers:
    r"""Return the largest ratio |T|/N of tangential to normal force of all contacts.

    A contact slides above the friction coefficient, typically 0.1 to 0.8. For beads that turn
    (`rotation=True`): each `gx.strains.Slip` bond over the normal one of the same ends before it.
    Where a contact opens, `gx.terms.Grip` lets go: T and the ratio are zero; a `Bond` of a slip
    that pulls there makes it infinite.
    **Returns:** a number, shape of the lanes. **Raises** ValueError for a lattice without such
    pairs.
    """
    return _slip_ratio(lattice, *parts(lattice, y, t), jnp.asarray(t))


@compiled
def _slip_ratio(lattice, u, v, t):
    forces = [
        (term, c.force)
        for term in lattice.terms
        for c in term.moving(u, v).compressions(t, u)
        if c.place == "bond"
    ]
    lanes = len(lattice.lanes)
    worst = []
    for (_, normal), (term, tangential) in zip(forces, forces[1:]):
        if not getattr(getattr(term, "strain_map", None), "tangential", False):
            continue
        T = jnp.abs(tangential)
        N = jnp.broadcast_to(normal, tangential.shape)
        closed = N > 0
        ratio = jnp.where(closed, T / jnp.where(closed, N, 1), jnp.where(T > 0, jnp.inf, 0.0))
        worst.append(ratio.max(tuple(range(ratio.ndim - lanes))))
    if not worst:
        refuse(
            "lattice", "contacts with a tangential force", "none", "Build it with rotation=True."
        )
    return jnp.max(jnp.stack(worst), 0)
