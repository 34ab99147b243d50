"""The lattice's own length: how far a shape may grow before its forces are no longer linear ones."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike

from ..lattice import Lattice
from ..programs import compiled
from ..types import Displacements, Numbers
from .asked import largest

# change of the stiffness at the length, as a share of it
SHARE = 0.5
# binary orders of magnitude that are looked through either way, with 64 bits and with 32
ORDERS = 160
SINGLE = 60
# neighbouring sizes that must agree
RUN = 4
# rounds between two of them
ROUNDS = 4
# of a shape, by which what it is compared with is not even
UNEVEN = 0.5


def nonlinear_length(lattice: Lattice, shape: Displacements) -> float:
    r"""The amplitude a of a shape at which the lattice's stiffness has changed by a half of its size at equilibrium.

    Of every law's stiffness F'(e) at its compression, against the largest at equilibrium, and, for a term without a
    law, of the linearised accelerations |J(a w) p - J(0) p| against |J(0) p|, with w the shape over its largest entry
    and p the same made uneven, so that less cancels by symmetry; the least such a. Infinite for linear forces, zero in
    a sonic vacuum. In the unit of u.
    """
    departures = lambda sizes: np.asarray(_departures(lattice, shape, sizes))
    return last_near(lambda sizes: departures(sizes) <= SHARE, lattice.dtype)


def last_near(near: Callable[[Numbers], np.ndarray], dtype: DTypeLike) -> float:
    """The largest size up to which `near` of many sizes holds; infinite where it always does, zero where it never does.

    By powers of two, which change no digit with the unit of length, and then between two of them.
    """
    orders = ORDERS if jnp.finfo(dtype).bits > 32 else SINGLE
    exponents = np.arange(-orders, orders + 1.0)
    holds = near(jnp.asarray(np.exp2(exponents), dtype))
    # below, where rounding is larger than what is looked for, some may be near by chance
    runs = np.flatnonzero(np.convolve(holds, np.ones(RUN), "valid") == RUN)
    if not len(runs):
        return 0.0
    holds, exponents = holds[runs[0] :], exponents[runs[0] :]
    if holds.all():
        return np.inf
    order, share = 2.0 ** exponents[np.argmin(holds) - 1], np.array([0.0, 1.0])
    for _ in range(ROUNDS):
        share = np.linspace(*share, 2 * ORDERS)
        beyond = int(np.argmin(near(jnp.asarray(order * np.exp2(share), dtype))))
        share = share[beyond - 1 : beyond + 1]
    return float(order * np.exp2(share[0]))


@compiled
def _departures(lattice, shape, amplitudes):
    zeros, t = lattice.zeros(), jnp.zeros((), lattice.dtype)
    golden = jnp.asarray(
        0.6180339887498949 * np.arange(sum(x.size for x in jax.tree.leaves(zeros))) % 1,
        lattice.dtype,
    )
    shape = jax.tree.map(lambda w: w / largest(shape), shape)
    probe = jax.tree.map(lambda w: w * (1 - UNEVEN * jnp.resize(golden, w.shape)), shape)

    def stiffnesses(a):
        """Of the laws, and of all together."""
        u = jax.tree.map(lambda w: a * w, shape)
        laws = [
            c.law.derivative(c.compression)
            for term in lattice.terms
            for c in term.compressions(t, u)
        ]
        return laws, jax.jvp(lambda u: lattice.acceleration(t, u, zeros), (u,), (probe,))[1]

    still = stiffnesses(jnp.zeros((), lattice.dtype))

    def departure(a):
        sizes = [
            largest(jax.tree.map(jnp.subtract, now, before)) / largest(before)
            for now, before in zip(stiffnesses(a), still)
            if jax.tree.leaves(before)
        ]
        return jnp.max(jnp.stack(sizes))

    return jax.lax.map(departure, amplitudes)
