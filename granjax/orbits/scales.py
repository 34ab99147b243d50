"""The length scale of a lattice: the amplitude at which its forces become nonlinear."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike

from ..base.programs import compiled
from ..base.types import Displacements, Numbers, Scalar
from ..lattice import Lattice
from .asked import largest, uneven

# The relative change of the stiffness at the length.
SHARE = 0.5
# The binary orders of magnitude that are searched in both directions, with 64 bits.
ORDERS = 160
# The same with 32 bits.
SINGLE = 60
# Neighbouring sizes that must agree.
RUN = 4
# Rounds of refinement between two sizes.
ROUNDS = 4
# The relative amount by which the comparison shape is made uneven.
UNEVEN = 0.5


def nonlinear_length(
    lattice: Lattice, shape: Displacements | None = None, t: Scalar = 0.0
) -> float:
    r"""Return the amplitude of a shape at which the lattice's stiffness has changed by a half.

    This is the least amplitude a at which one of the following departs by half of its size at
    equilibrium:

    - the stiffness F'(e) of a law at its compressions, against the largest at equilibrium;
    - the linearised accelerations of all terms, which include those without a law: |J(a w) p - J(0)
      p| against |J(0) p|, with w the shape over its largest entry and p the same made uneven, so
      that less cancels by symmetry.

    In the unit of u; infinite for linear forces, zero in a sonic vacuum. The default shape is
    irregular.
    """
    shape = uneven(lattice) if shape is None else shape
    t = jnp.asarray(t, lattice.dtype)
    departures = lambda sizes: np.asarray(_departures(lattice, shape, t, sizes))
    return last_near(lambda sizes: departures(sizes) <= SHARE, lattice.dtype)


def last_near(near: Callable[[Numbers], np.ndarray], dtype: DTypeLike) -> float:
    """Return the largest size up to which `near` holds; infinite if always, zero if never.

    Sizes are powers of two, so that the unit of length changes no digit, then sizes between two of
    them.
    """
    orders = ORDERS if jnp.finfo(dtype).bits > 32 else SINGLE
    exponents = np.arange(-orders, orders + 1.0)
    holds = near(jnp.asarray(np.exp2(exponents), dtype))
    # At small sizes, where rounding dominates, `near` may hold by chance.
    runs = np.flatnonzero(np.convolve(holds, np.ones(RUN), "valid") == RUN)
    if not len(runs):
        return 0.0
    holds = holds[runs[0] :]
    exponents = exponents[runs[0] :]
    if holds.all():
        return np.inf
    order = 2.0 ** exponents[np.argmin(holds) - 1]
    share = np.array([0.0, 1.0])
    for _ in range(ROUNDS):
        share = np.linspace(*share, 2 * ORDERS)
        beyond = int(np.argmin(near(jnp.asarray(order * np.exp2(share), dtype))))
        share = share[beyond - 1 : beyond + 1]
    return float(order * np.exp2(share[0]))


@compiled
def _departures(lattice, shape, t, amplitudes):
    zeros = lattice.zeros()
    golden = jnp.asarray(
        0.6180339887498949 * np.arange(sum(x.size for x in jax.tree.leaves(zeros))) % 1,
        lattice.dtype,
    )
    shape = jax.tree.map(lambda w: w / largest(shape), shape)
    probe = jax.tree.map(lambda w: w * (1 - UNEVEN * jnp.resize(golden, w.shape)), shape)

    def stiffnesses(a):
        # Of the laws, and of all terms together.
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
