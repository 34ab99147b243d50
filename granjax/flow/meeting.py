"""Where magnets met: the bond whose law is about to end, of a run that stopped."""

import jax
import jax.numpy as jnp
import numpy as np

from ..lattice import Lattice, State
from ..types import Number, StateLike

# of the distance at rest, which is none
TOUCH = 1e-6


def meeting(lattice: Lattice, y: StateLike, t: Number, within: Number) -> tuple | None:
    """(bond, number of its term, time, lane) where a law ends at a length within a time; `None` for nowhere."""
    found, time, lanes = [], jnp.asarray(t, lattice.dtype), len(lattice.lanes)

    def rooms(u):
        return [[c.room for c in term.compressions(time, u)] for term in lattice.terms]

    still = rooms(lattice.zeros())
    now, rates = jax.jvp(rooms, (State(*y).u,), (State(*y).v,))
    for number, parts in enumerate(zip(still, now, rates)):
        for rest, room, rate in zip(*parts):
            if room is None:
                continue
            rest, room, rate = np.broadcast_arrays(rest, room, rate)
            left = np.where(rate < 0, room / np.where(rate < 0, -rate, 1), np.inf)
            left = np.where(room <= TOUCH * rest, 0.0, left)
            own, at = left.shape[: left.ndim - lanes], int(np.argmin(left))
            if left.flat[at] <= within:
                bond, *lane = np.unravel_index(at, (int(np.prod(own)), *left.shape[left.ndim - lanes :]))
                found.append((float(left.flat[at]), int(bond), number, tuple(map(int, lane))))
    if not found:
        return None
    left, bond, number, lane = min(found)
    return bond, number, t + left, lane
