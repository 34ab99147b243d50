"""Waves and modes of q'' = -D q - G q', G^+ = -G (gyroscopes, rotating frames, Lorentz forces)."""

import jax
import jax.numpy as jnp
import numpy as np

from ..base.derivatives import eigh, eigvalsh
from ..base.types import AnyArray, ComplexNumbers, Number, Numbers
from .stiffness import or_one

# the rounding of omega^2, in units of eps times the size of the matrix times the largest stiffness
ROUNDING = 4


# With D = L L^+ and z = (L^+ q, q') the motion is z' = -i H z. H is NaN where D is not positive, as
# motion may grow there. Rounding on the `scale` of the stiffness is added to D, which uniform
# motion would make singular.
def _hamiltonian(D, G, scale):
    # H, (2P, 2P), Hermitian, whose P largest eigenvalues are the frequencies
    L = factor(D + _rounding(D, scale) * jnp.eye(len(D)))
    return jnp.block([[jnp.zeros_like(L), 1j * L.conj().T], [-1j * L, -1j * G]])


def factor(D: AnyArray) -> AnyArray:
    """Return Cholesky's factor L of D = L L^+, NaN where there is none.

    Not by LAPACK: XLA calls it for many matrices from threads that wait for others, and may
    deadlock.
    """
    place = jnp.arange(len(D))

    def column(L, j):
        left = D[:, j] - L @ L[j].conj()
        return L.at[:, j].set(jnp.where(place >= j, left / jnp.sqrt(left[j].real), 0)), None

    return jax.lax.scan(column, jnp.zeros_like(D), np.arange(len(D)))[0]


def squares(D: AnyArray, G: AnyArray, scale: Number) -> Numbers:
    """Return omega^2, (P,), rising; zero where it is rounding."""
    return _squared(eigvalsh(_hamiltonian(D, G, scale))[len(D) :], D, scale)


def waves(D: AnyArray, G: AnyArray, scale: Number) -> tuple[Numbers, ComplexNumbers]:
    """Return omega^2 (P,), as `squares`, and normalised vectors q (P, P)."""
    return upper(*levels(D, G, scale), scale)


def upper(omega: Numbers, v: ComplexNumbers, scale: Number) -> tuple[Numbers, ComplexNumbers]:
    """Return the result of `waves` from that of `levels`."""
    q = 1j * v[:, len(v) :]
    return _squared(omega[len(v) :], v, scale), q / jnp.linalg.norm(q, axis=0)


def levels(D: AnyArray, G: AnyArray, scale: Number) -> tuple[Numbers, ComplexNumbers]:
    """Return omega of both signs, rising, and velocities v (P, 2P) of energy 1/2: q = i v/omega."""
    omega, z = eigh(_hamiltonian(D, G, scale))
    return omega, z[len(D) :]


def _squared(omega, D, scale):
    squared = omega**2
    return jnp.where(squared <= 2 * _rounding(D, scale), 0, squared)


def _rounding(D, scale):
    scale = jax.lax.stop_gradient(scale)
    return ROUNDING * len(D) * jnp.finfo(D.dtype).eps * or_one(scale)
