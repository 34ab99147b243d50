"""States in one normal mode."""

import jax
import jax.numpy as jnp
import numpy as np

from ..base.checks import concrete, described, is_whole, per_lane, refuse, whole
from ..base.types import Count, Parameter
from ..lattice import Lattice, State
from ..linear import normal_modes
from ..linear.modes import UNSTABLE
from ..terms import Modulated
from .places import chain_only, column, state_of


def normal_mode(
    lattice: Lattice, index: Count = 0, amplitude: Parameter = 1.0, phase: Parameter = 0.0
) -> State:
    r"""Return a normal mode phi: u = a cos(phase) phi, v = -omega a sin(phase) phi.

    The largest |phi| is 1, so `amplitude` is the largest displacement; the first component of at
    least a tenth of it is positive. The linear energy of a real phi is a^2 omega^2/2 sum m phi^2.
    Gyroscopic forces make phi complex: u + i v/omega = a exp(-i phase) phi. With equal masses and
    springs between fixed ends phi is sin(pi k n/(N+1)) over its largest value. A stiffness that
    changes in time is taken at t = 0. Dense: N^3 operations, up to a few thousand displacements.

    **Arguments:** `index`: 0 is the lowest frequency, negative from the highest. `amplitude`: a
    [m]; `phase` [rad]; numbers, or one per lane. Where frequencies coincide the mode is one of
    many.
    **Raises** ValueError for an index out of range, a sonic vacuum, and where
    `gx.linear.normal_modes` does.

    **Example:**

    >>> chain = gx.scenes.monomer(20, precompression=1.0)
    >>> state = gx.states.normal_mode(chain, 1, amplitude=0.1)
    >>> round(float(state.u.max()), 4), round(float(state.u.min()), 4)
    (0.1, -0.1)
    """
    lanes = lattice.lanes
    amplitude = per_lane("amplitude", amplitude, lanes)
    phase = per_lane("phase", phase, lanes)
    # a stiffness that changes in time is taken at t = 0
    zero = jnp.zeros((), lattice.dtype)
    modulated = lambda x: isinstance(x, Modulated)
    begun = jax.tree.map(lambda x: x.at(zero) if modulated(x) else x, lattice, is_leaf=modulated)
    solve = normal_modes
    for _ in lanes:
        solve = jax.vmap(solve, in_axes=-1, out_axes=-1)
    found = solve(begun)
    size = len(found.omega)
    if not is_whole(index) or not -size <= index < size:
        wanted = f"a whole number within {-size} ... {size - 1}"
        refuse("index", wanted, described(index), "Modes are counted from 0.")
    omega = concrete(found.omega)
    if omega is not None and np.isnan(omega).any():
        refuse("lattice", "one with normal modes", "one without", f"No modes {UNSTABLE}")
    if omega is not None and not np.any(omega):
        remedy = "Give its contacts a precompression."
        refuse("lattice", "a linear stiffness", "none (a sonic vacuum)", remedy)
    phi = jax.tree.map(lambda x: jnp.take(x, index, axis=-1 - len(lanes)), found.modes)
    flat = jnp.concatenate([x.reshape((-1,) + lanes) for x in jax.tree.leaves(phi)])
    largest = jnp.abs(flat).max(0)
    first = jnp.argmax(jnp.abs(flat) >= 0.1 * largest, 0, keepdims=True)
    lead = jnp.take_along_axis(flat, first, 0)[0]
    # phi is complex among gyroscopic forces
    a = amplitude * (jnp.abs(lead) / lead) / largest
    rate = jnp.maximum(found.omega[index], 0)

    def along(size):
        real = lambda x, s: jnp.real(size * x).astype(s.dtype)
        return jax.tree.map(real, phi, lattice.template())

    turn = jnp.exp(-1j * phase)
    return State(along(a * turn), along(-1j * rate * a * turn))


def sine_mode(lattice: Lattice, k: Count = 1, amplitude: Parameter = 1.0) -> State:
    """Return sine k between fixed ends: u_n = a sin(pi k (n+1)/(N+1)), n = 0 ... N-1, v = 0.

    It is the normal mode of equal masses and springs, without an eigenproblem. The start of Fermi,
    Pasta, Ulam and Tsingou is k = 1, a = 1 in 31 moving masses (32 intervals), with the energy
    0.0770443732448498 for K3 = 1/4.

    **Arguments:** `k`: 1 ... N, the number of half waves; `amplitude`: a, a number or one per lane
    [m].
    **Raises** ValueError for a lattice that is no plain chain, or k outside 1 ... N.
    """
    size = chain_only(lattice, "sine_mode")
    if whole("k", k, 1) > size:
        refuse(
            "k", f"a whole number from 1 to {size}", repr(k), "A chain has as many modes as sites."
        )
    # k n is reduced modulo the period in integers, so that high modes lose no digits
    n = column(lattice, jnp.arange(1, size + 1))
    shape = jnp.sin(jnp.pi / (size + 1) * (k * n % (2 * (size + 1))))
    return state_of(lattice, per_lane("amplitude", amplitude, lattice.lanes) * shape)
