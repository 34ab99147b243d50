"""Energy in normal modes."""

import jax
import jax.numpy as jnp

from ..base.arrays import trailing
from ..base.checks import non_negative, parameter, refuse
from ..base.types import Numbers, Parameter, StateLike
from ..lattice import Lattice
from .states_of import parts


def modal_amplitudes(lattice: Lattice, y: StateLike, modes: Parameter) -> tuple[Numbers, Numbers]:
    """Return the normal coordinates a_k = sum_i m_i phi_ik u_i of a state, and their rates.

    **Arguments:** `modes`: mass-orthonormal modes, sum_i m_i phi_ik phi_il = delta_kl, as columns:
    (N, M), or (N, M) + lanes. With vectors or several fields N counts all displacements, flattened
    in the order of `jax.tree.leaves` of `u`. **Returns:** (a, a_dot), each (M,) + lanes.
    **Raises** ValueError for modes whose first axis is not the number of displacements.
    """
    u, v = parts(lattice, y)
    modes = parameter("modes", modes)
    lanes = lattice.lanes
    flat = lambda m, x: (m * x).reshape((-1, *lanes))
    momenta = [
        jnp.concatenate(jax.tree.leaves(jax.tree.map(flat, lattice.mass, x))) for x in (u, v)
    ]
    size = len(momenta[0])
    if modes.ndim < 2 or modes.shape[0] != size or modes.shape[2:] not in ((), lanes):
        also = f" or ({size}, M) + {lanes}" if lanes else ""
        refuse("modes", f"shape ({size}, M){also}, one mode per column", f"shape {modes.shape}")
    modes = trailing(modes, 2 + len(lanes))
    return tuple(jnp.einsum("nm...,n...->m...", modes, p) for p in momenta)


def modal_energy(lattice: Lattice, y: StateLike, modes: Parameter, omega: Parameter) -> Numbers:
    """Return the energy of every normal mode in the linear lattice [J].

    It is E_k = (a_dot_k^2 + omega_k^2 a_k^2)/2.

    **Arguments:** `modes`: as in `modal_amplitudes`; `omega`: their frequencies (M,), or
    (M,) + lanes [rad/s].
    **Returns:** (M,) + lanes. In a linear lattice each is constant, and all sum to `energy`.
    **Raises** ValueError for modes or frequencies that do not fit.

    **Example:**

    >>> chain = gx.scenes.monomer(20, precompression=1.0)
    >>> found = gx.linear.normal_modes(chain)
    >>> shares = gx.measures.modal_energy(chain, gx.states.impact(chain), found.modes, found.omega)
    >>> shares.shape, round(float(shares.sum()), 6)
    ((20,), 0.5)
    """
    a, rate = modal_amplitudes(lattice, y, modes)
    omega = parameter("omega", omega)
    if omega.shape not in (a.shape, a.shape[:1]):
        refuse("omega", f"shape {a.shape[:1]}, one per mode", f"shape {omega.shape}")
    return (rate**2 + trailing(omega, a.ndim) ** 2 * a**2) / 2


def spectral_entropy(energies: Parameter) -> Numbers:
    """Return the entropy of energy shares, over the first axis.

    S = -sum_k e_k ln e_k with e_k = E_k/sum E, which is ln M for equal energies. In thermal
    equilibrium they fluctuate: e_k averages to 1/M, and S to 1/2 + 1/3 + ... + 1/M, about ln
    M - 0.4228. The normalised entropy of the FPUT literature is eta = (ln M - S)/(ln M - S(0)), 1
    at the start and near 0 at equipartition, whose time is when it passes some value, such as 1/2,
    for good: `run.ts[np.flatnonzero(eta > 0.5)[-1] + 1]`.

    **Arguments:** `energies`: (M,) and trailing axes, such as `modal_energy(...)`,
    `site_energy(...)`.
    **Returns:** NaN where all are zero. **Raises** ValueError for negative energies.
    Source: Livi, Pettini, Ruffo, Sparpaglione, Vulpiani, Phys. Rev. A 31, 1039 (1985).

    **Example:**

    >>> float(jnp.exp(gx.measures.spectral_entropy([0.5, 0.5, 0.0]))).__round__(6)
    2.0
    """
    energies = non_negative("energies", energies)
    share = energies / jnp.sum(energies, 0)
    there = share != 0
    return -jnp.sum(jnp.where(there, share * jnp.log(jnp.where(there, share, 1)), 0), 0)


def effective_modes(energies: Parameter) -> Numbers:
    """Return the share of modes that take part, exp(S)/M, with S the `spectral_entropy`."""
    return jnp.exp(spectral_entropy(energies)) / len(energies)
