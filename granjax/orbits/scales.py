"""The lattice's own length: how far a shape may grow before its forces are no longer linear ones."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..lattice import Lattice
from ..types import Displacements
from .repeats import largest

# change of the stiffness at the length, as a share of it
SHARE = 0.5
# binary orders of magnitude that are looked through either way, neighbours that must agree, rounds between two of them
ORDERS, SINGLE, RUN, ROUNDS = 160, 60, 4, 4
UNEVEN = 0.5


def nonlinear_length(lattice: Lattice, shape: Displacements) -> float:
    r"""The amplitude a of a shape at which the lattice's stiffness has changed by a half of its size at equilibrium.

    Of every law's stiffness F'(e) at its compression, against the largest at equilibrium, and, for what has no law, of
    the linearised accelerations |J(a w) p - J(0) p| against |J(0) p|, with w the shape over its largest entry and p the
    same made uneven, so that less cancels by symmetry; the least such a. Infinite for linear forces, zero in a sonic
    vacuum. In the unit of u.
    """
    orders = ORDERS if jnp.finfo(lattice.dtype).bits > 32 else SINGLE
    exponents = np.arange(-orders, orders + 1.0)
    near = _near(lattice, shape, np.exp2(exponents))
    # below, where rounding is larger than what is looked for, some may be near by chance
    runs = np.flatnonzero(np.convolve(near, np.ones(RUN), "valid") == RUN)
    if not len(runs):
        return 0.0
    if near[runs[0] :].all():
        return np.inf
    # a power of two apart, so that the unit of length changes no digit
    order, share = (
        2.0 ** exponents[int(np.argmin(near[runs[0] :])) + runs[0] - 1],
        np.array([0.0, 1.0]),
    )
    for _ in range(ROUNDS):
        share = np.linspace(*share, len(exponents))
        beyond = int(np.argmin(_near(lattice, shape, order * np.exp2(share))))
        share = share[beyond - 1 : beyond + 1]
    return float(order * np.exp2(share[0]))


def _near(lattice, shape, amplitudes):
    return np.asarray(_departures(lattice, shape, jnp.asarray(amplitudes, lattice.dtype))) <= SHARE


@eqx.filter_jit
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
