"""Contacts: compression, overlap and total force of bonds and walls."""

import jax.numpy as jnp

from ..base.arrays import padded
from ..base.checks import refuse, whole
from ..base.programs import compiled
from ..base.types import Count, Number, Numbers, StateLike
from ..lattice import Lattice
from ..terms.base import within
from ..terms.chain import boundary_of
from .states_of import parts


def contacts(lattice: Lattice, y: StateLike, t: Number = 0.0) -> list:
    """Return the `Compression`s at a state: bonds, then walls, in the order of the terms.

    Each has its `law`, `compression` [m], total `force` [N] and `overlap` [m].
    """
    u, v = parts(lattice, y, t)
    found = [c for term in lattice.terms for c in term.moving(u, v).compressions(t, u)]
    return [c for c in found if c.place == "bond"] + [c for c in found if c.place == "wall"]


def _contact(lattice, y, t, bond, what):
    return _part(lattice, parts(lattice, y, t), jnp.asarray(t), whole("bond", bond), what)


@compiled
def _part(lattice, y, t, bond, what):
    found = contacts(lattice, y, t)
    if bond >= len(found):
        names = (
            ", ".join(f"{i}: {type(c.law).__name__} ({c.place})" for i, c in enumerate(found))
            or "none"
        )
        refuse(
            "bond",
            f"an index below {len(found)}",
            f"{bond}",
            f"The lattice's bonds and then walls are {names}.",
        )
    value = getattr(found[bond], what)
    if value is None:
        refuse(
            "bond",
            "a law whose contact can open",
            f"{type(found[bond].law).__name__}",
            "Ask for strain instead.",
        )
    return value


def strain(lattice: Lattice, y: StateLike, t: Number = 0.0, *, bond: Count = 0) -> Numbers:
    """Return the compression of every bond from equilibrium [m], positive in compression.

    For a chain it is e_n = u_n - u_{n+1}.

    **Arguments:** `y`: a `State`; `t`: time, which only driven walls read; `bond`: index in the
    order of the terms, walls after all bonds.
    **Shapes:** (bonds,), then lanes; a grid's bonds on as many axes; (1,) for a wall.
    **Raises** ValueError for a bond that is not there.

    **Example:**

    >>> chain = gx.scenes.monomer(20, precompression=1.0)
    >>> state = gx.State(jnp.zeros(20).at[0].set(0.44), jnp.zeros(20))
    >>> gx.measures.strain(chain, state)[:3].tolist()
    [-0.44, 0.44, 0.0]
    """
    return _contact(lattice, y, t, bond, "compression")


def contact_force(lattice: Lattice, y: StateLike, t: Number = 0.0, *, bond: Count = 0) -> Numbers:
    """Return the total contact force of every bond, F0 + F(e), positive in compression [N].

    At rest it is the preload F0; an open contact carries zero. A modulation multiplies
    it; separate dampers do not count.

    **Arguments, shapes and errors:** as in `strain`.

    **Example:**

    >>> chain = gx.scenes.monomer(20, precompression=1.0)
    >>> state = gx.State(jnp.zeros(20).at[0].set(0.44), jnp.zeros(20))
    >>> np.array(gx.measures.contact_force(chain, state)[:3]).round(6).tolist()
    [0.419066, 1.728, 1.0]
    """
    return _contact(lattice, y, t, bond, "force")


def sensor_force(
    lattice: Lattice, y: StateLike, t: Number = 0.0, *, field: str | None = None
) -> Numbers:
    """Return the force that a sensor in every bead reads, (F_{n-1,n} + F_{n,n+1})/2 [N].

    A bead at a free end has one contact, and reads half of it. Several bonds add up; separate walls
    and dampers do not count.
    **Arguments:** as in `strain`; `field`: of the beads, where a cell holds several. **Shapes:**
    (N,), then lanes.
    **Raises** ValueError for a lattice without bonds between next neighbours of a chain.
    Source: Daraio, Nesterenko, Herbold, Jin, Phys. Rev. E 73, 026610 (2006).

    **Example:**

    >>> chain = gx.scenes.monomer(20, precompression=1.0)
    >>> state = gx.State(jnp.zeros(20).at[0].set(0.44), jnp.zeros(20))
    >>> np.array(gx.measures.sensor_force(chain, state)[:3]).round(6).tolist()
    [1.073533, 1.364, 1.0]
    """
    return _sensed(lattice, *parts(lattice, y, t), jnp.asarray(t), field)


@compiled
def _sensed(lattice, u, v, t, field):
    read = []
    for term in lattice.terms:
        boundary = boundary_of(within(term), field)
        for contact in term.moving(u, v).compressions(t, u) if boundary else ():
            force = contact.force
            if boundary == "periodic":
                force = jnp.concatenate([force[-1:], force])
            elif boundary == "free":
                force = padded(force, 1, 1)
            read.append((force[:-1] + force[1:]) / 2)
    if not read:
        refuse(
            "lattice",
            "a chain with bonds between next neighbours",
            "none of that field",
            "For other lattices average gx.measures.contact_force yourself.",
        )
    return sum(read)


def overlap(lattice: Lattice, y: StateLike, t: Number = 0.0, *, bond: Count = 0) -> Number | None:
    """Return the overlap of every contact [m], zero or less where it is open.

    It is d0 + e for a power law. **Arguments and shapes:** as in `strain`. **Raises** ValueError
    also for a law that cannot open.
    """
    return _contact(lattice, y, t, bond, "overlap")
