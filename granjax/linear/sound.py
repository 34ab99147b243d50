"""Sound speed: the slope of the acoustic bands at long waves."""

import jax
import jax.numpy as jnp
import numpy as np

from ..checks import parameter, refuse
from .cell import LOOSE, unit_cell


def sound_speed(chain, cell=None, direction=None):
    r"""Long-wave speed c = lim omega/k of the acoustic band(s), in sites per unit time.

    Second-order perturbation of D(k) about k = 0, within the translations T:
    c^2 = T^+ [ D''/2 - D' D(0)^+ D' ] T, times the square of the sites per cell. A chain of equal beads has
    c = (K2/m)^{1/2} (Hertz: K2 = (3/2) A d0^{1/2}); in general c^2 = 1/(mean mass * mean compliance 1/K2) per site.

    **Arguments:** `chain`, `cell`: as in `dispersion`. `direction`: on a grid, the phase advances per site along each
    axis for a unit of wave number, (axes,), by default the first axis. With lattice vectors a_i (rows of `a`) and a
    unit vector n in the plane `direction = a @ n` gives c in lengths per time.

    **Returns:** one number for scalar displacements, else (dimension,), slowest first. Differentiable in every
    parameter. A negative value is an unstable long wave, as in `dispersion`.
    **Raises** ValueError in a sonic vacuum (no linear stiffness), with forces that tie sites to their rest positions
    (no acoustic band), where parts of the cell hang loose, and where `dispersion` does.
    """
    found = unit_cell(chain, cell)
    axes = len(found.cell)
    if direction is None:
        direction = np.eye(axes)[0]
    direction = parameter("direction", direction).astype(found.mass.dtype).reshape(-1)
    if direction.shape != (axes,):
        refuse("direction", f"{axes} numbers, one per axis", f"shape {direction.shape}")
    T, D = found.translations(), jnp.real(found.dynamical_matrix(jnp.zeros(axes, found.mass.dtype)))
    _check_acoustic(found, jax.lax.stop_gradient(D), jax.lax.stop_gradient(T))
    turn = direction * np.array(found.cell)
    R = np.array(found.shells) @ turn
    # D' = i first, with a real and antisymmetric first; D'' = -second
    first = jnp.einsum("r,rab->ab", R, found.coupling)
    second = jnp.einsum("r,rab->ab", R * R, found.coupling)
    scale = jnp.maximum(jax.lax.stop_gradient(jnp.abs(D).max()), jnp.finfo(D.dtype).tiny)
    answer = first @ T
    # T is the null space of D: filling it makes D invertible, and answer has no part in it
    answer = answer - T @ (T.T @ answer)
    inner = answer.T @ jnp.linalg.solve(D / scale + T @ T.T, answer) / scale
    square = jnp.linalg.eigvalsh(-T.T @ second @ T / 2 - inner)
    zero = square == 0
    speed = jnp.where(zero, 0, jnp.sign(square) * jnp.sqrt(jnp.abs(jnp.where(zero, 1, square))))
    return speed[0] if found.dimension is None else speed


def _check_acoustic(found, D, T):
    if isinstance(D, jax.core.Tracer):
        return
    coupling, T = np.asarray(jax.lax.stop_gradient(found.coupling)), np.asarray(T)
    scale = np.abs(coupling).max()
    if scale == 0:
        refuse("chain", "linear stiffness at rest", "none", "A sonic vacuum has no linear sound speed; give "
               "precompression > 0.")
    tolerance = LOOSE * np.finfo(coupling.dtype).eps * scale
    if np.abs(D @ T).max() > tolerance:
        refuse("chain", "forces between sites alone", "forces that tie sites to their rest positions",
               "Such a lattice has no acoustic band, and so no sound speed; see granjax.linear.bands.")
    if np.sum(np.abs(np.linalg.eigvalsh(np.asarray(D))) <= tolerance) > T.shape[1] and D.shape[0] > T.shape[1]:
        refuse("chain", "a cell that is held together", "parts that move freely at no cost",
               "Some bonds have no linear stiffness; give precompression > 0, or look at granjax.linear.dispersion.")
