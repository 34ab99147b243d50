"""States in one normal mode of the linear lattice."""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..checks import concrete, per_lane, refuse, whole
from ..lattice import Lattice, State
from ..types import Count, Parameter
from .places import chain_only


def normal_mode(
    lattice: Lattice, index: Count = 0, amplitude: Parameter = 1.0, phase: Parameter = 0.0
) -> State:
    r"""One normal mode phi of the linearised lattice: u = a cos(phase) phi, v = -omega a sin(phase) phi.

    The largest component of phi in modulus is 1, so `amplitude` is the largest displacement; the first component of a
    tenth of it or more is positive. Linear energy: a^2 omega^2/2 sum m phi^2. With equal masses and springs between
    fixed ends phi is sin(pi k n/(N+1)), up to its largest value, which is 1 for the lowest mode where N is odd. Dense:
    N^3 operations, up to a few thousand displacements.

    **Arguments:** `index`: 0 is the lowest frequency, negative from the highest. `amplitude`: a
    [m]; `phase` [rad]; numbers, or one per lane. Where frequencies coincide the mode is one of many.
    **Raises** ValueError for an index that is not there, or a lattice without linear stiffness (a sonic vacuum).

    **Example:**

    >>> chain = gx.scenes.monomer(20, precompression=1.0)
    >>> state = gx.states.normal_mode(chain, 1, amplitude=0.1)
    >>> round(float(state.u.max()), 4), round(float(state.u.min()), 4)
    (0.1, -0.1)
    """
    size, lanes = sum(_sizes(lattice)), lattice.lanes
    if not -size <= index < size:
        refuse(
            "index",
            f"a whole number within {-size} ... {size - 1}",
            repr(index),
            "Modes are counted from 0.",
        )
    amplitude, phase = per_lane("amplitude", amplitude, lanes), per_lane("phase", phase, lanes)
    stiffness, mass = _matrices(lattice, size)
    values = concrete(stiffness)
    if values is not None and not np.any(values):
        refuse(
            "lattice",
            "a linear stiffness",
            "none (a sonic vacuum)",
            "Give its contacts a precompression.",
        )
    root = jnp.sqrt(mass)
    symmetric = stiffness / root[..., :, None] / root[..., None, :]
    squares, vectors = jnp.linalg.eigh(symmetric)
    phi = vectors[..., :, index] / root
    phi = phi / jnp.abs(phi).max(-1, keepdims=True)
    high = jnp.abs(phi) >= 0.1
    lead = jnp.take_along_axis(phi, jnp.argmax(high, -1)[..., None], -1)
    phi = jnp.moveaxis(phi * jnp.sign(lead), -1, 0).reshape((size,) + lanes)
    omega = jnp.sqrt(jnp.maximum(squares[..., index], 0)).reshape(lanes)
    u, v = amplitude * jnp.cos(phase) * phi, -omega * amplitude * jnp.sin(phase) * phi
    return State(_shaped(lattice, u), _shaped(lattice, v))


def sine_mode(lattice: Lattice, k: Count = 1, amplitude: Parameter = 1.0) -> State:
    """Sine k of a chain between fixed ends: u_n = a sin(pi k (n+1)/(N+1)), n = 0 ... N-1, v = 0.

    The normal mode of a chain of equal masses and springs; for other chains a smooth start. No eigenproblem is solved.
    The classic start of Fermi, Pasta, Ulam and Tsingou is k = 1, a = 1 in 31 moving masses (32 intervals), whose energy
    is 0.0770443732448498 for K3 = 1/4.

    **Arguments:** `k`: 1 ... N, the number of half waves; `amplitude`: a, a number or one per lane [m].
    **Raises** ValueError for a lattice that is no plain chain, or k outside 1 ... N.
    """
    size = chain_only(lattice, "sine_mode")
    if whole("k", k, 1) > size:
        refuse(
            "k", f"a whole number from 1 to {size}", repr(k), "A chain has as many modes as sites."
        )
    n = jnp.arange(1, size + 1).reshape((-1,) + (1,) * len(lattice.lanes))
    # k n taken modulo the period in whole numbers, so that high modes lose no digits
    shape = jnp.sin(jnp.pi / (size + 1) * (k * n % (2 * (size + 1))))
    u = per_lane("amplitude", amplitude, lattice.lanes) * shape
    zeros = lattice.zeros()
    return State((zeros + u).astype(zeros.dtype), zeros)


@eqx.filter_jit
def _matrices(lattice, size):
    """Stiffness (lanes..., size, size) and masses (lanes..., size), lanes as one leading axis where there are any."""
    zeros = lattice.zeros()
    time = jnp.zeros(())

    def column(unit):
        unit = unit.reshape((-1,) + (1,) * len(lattice.lanes))
        push = _shaped(lattice, jnp.broadcast_to(unit, (size,) + lattice.lanes))
        return _flat(
            lattice, jax.jvp(lambda u: lattice.force(time, u, zeros), (zeros,), (push,))[1]
        )

    stiffness = -jax.vmap(column, out_axes=1)(jnp.eye(size, dtype=jax.tree.leaves(zeros)[0].dtype))
    mass = _flat(lattice, jax.tree.map(lambda m, z: m + z, lattice.mass, zeros))
    return _lanes_first(stiffness, 2), _lanes_first(mass, 1)


def _lanes_first(x, own):
    return jnp.moveaxis(x.reshape(x.shape[:own] + (-1,)), -1, 0)


def _flat(lattice, x):
    return jnp.concatenate([leaf.reshape((-1,) + lattice.lanes) for leaf in jax.tree.leaves(x)])


def _shaped(lattice, flat):
    """Inverse of `_flat`, in the lattice's type."""
    leaves, structure = jax.tree.flatten(lattice.template())
    parts = jnp.split(flat, np.cumsum(_sizes(lattice))[:-1])
    return jax.tree.unflatten(
        structure, [p.reshape(s.shape).astype(s.dtype) for p, s in zip(parts, leaves)]
    )


def _sizes(lattice):
    """Displacements in every field of one lattice."""
    lanes = len(lattice.lanes)
    return [math.prod(s.shape[: len(s.shape) - lanes]) for s in jax.tree.leaves(lattice.template())]
