"""Normal modes of a finite lattice."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

from ..checks import refuse
from .stiffness import at_rest, stiffness_product

ROUNDING = 8


def signed_root(squared, scale, size):
    """omega = sign(omega^2) |omega^2|^{1/2}, exactly zero where omega^2 is rounding of a matrix of that scale."""
    floor = ROUNDING * size * jnp.finfo(squared.dtype).eps * jax.lax.stop_gradient(scale)
    still = jnp.abs(squared) <= floor
    root = jnp.sqrt(jnp.abs(jnp.where(still, 1, squared)))
    return jnp.where(still, 0, jnp.sign(squared) * root)


class NormalModes(eqx.Module):
    """Normal modes of a finite lattice, in the order of omega^2.

    **Fields:** `omega_squared`: (modes,) [rad^2/s^2]; negative where the lattice is unstable at u = 0. `omega`:
    (modes,) [rad/s]; sign(omega^2) |omega^2|^{1/2}, so that an unstable mode shows, as in phonon codes, a negative
    frequency: minus its growth rate. Values of omega^2 that are rounding give exactly 0. `modes`: (sites..., modes),
    with a vector axis before the modes in the plane, or a dict of such for named fields; normalised with the mass:
    sum m phi_a phi_b = 1 for a = b, else 0.
    """

    omega: jax.Array
    omega_squared: jax.Array
    modes: object


def normal_modes(chain):
    r"""Normal modes of a finite lattice about u = 0: K phi = omega^2 M phi, any boundary, any masses, any terms.

    Solved as the symmetric problem M^{-1/2} K M^{-1/2} q = omega^2 q, phi = M^{-1/2} q, with K = -d force/du traced
    from the terms. Damping and drives are left out, moving walls stand still. In a sonic vacuum K = 0, and so is
    every frequency.

    **Arguments:** `chain`: one `Lattice`. **Returns:** `NormalModes`.

    Cost: n^2 numbers and n^3 operations for n degrees of freedom; n up to a few thousand. Frequencies are
    differentiable in every parameter; modes where their frequency is simple.
    **Raises** ValueError for a batch of lattices (use `jax.vmap(normal_modes, in_axes=-1)`), stiffness modulated in
    time, and forces without an energy (K not symmetric).
    """
    chain = at_rest(chain)
    flat, unravel = ravel_pytree(chain.zeros())
    product_with = stiffness_product(chain)
    unit = jnp.eye(flat.size, dtype=flat.dtype)
    K = jax.lax.map(lambda w: ravel_pytree(product_with(unravel(w)))[0], unit, batch_size=min(256, flat.size)).T
    _check_symmetric(K)
    mass, _ = ravel_pytree(jax.tree.map(lambda m, u: jnp.broadcast_to(m, u.shape), chain.mass, chain.zeros()))
    D = K / jnp.sqrt(mass[:, None] * mass)
    squared, q = jnp.linalg.eigh(D)
    modes = jax.vmap(unravel, -1, -1)(q / jnp.sqrt(mass)[:, None])
    scale = jnp.abs(D).max()
    return NormalModes(signed_root(squared, scale, flat.size), squared, modes)


def _check_symmetric(K):
    K = jax.lax.stop_gradient(K)
    if isinstance(K, jax.core.Tracer):
        return
    K = np.asarray(K)
    if np.abs(K - K.T).max() > 1e3 * np.finfo(K.dtype).eps * np.abs(K).max():
        refuse("chain", "forces that come from an energy (symmetric stiffness)", "stiffness that is not symmetric",
               "Bonds push both ends alike; look for a term of your own that does not.")
