"""Sound speed: the slope of the acoustic bands for long waves."""

import jax
import jax.numpy as jnp
import numpy as np

from ..base.checks import known_value, parameter, refuse
from ..base.derivatives import eigvalsh
from ..base.programs import compiled
from ..base.types import Cell, Number, Parameter
from ..lattice import Lattice
from . import turning
from .cell import LOOSE, turning_cell
from .modes import signed_root
from .stiffness import or_one


def sound_speed(
    lattice: Lattice,
    cell: Cell = None,
    direction: Parameter | None = None,
) -> Number:
    r"""Compute the long-wave speed c = lim omega/k of the acoustic band(s), in sites per unit time.

    By second-order perturbation of D(k) about k = 0, within the translations T, c^2 = T^+ [
    D''/2 - D' D(0)^+ D' ] T, times the square of the sites per cell. A chain of equal beads has
    c = (K2/m)^{1/2} (Hertz: K2 = (3/2) A d0^{1/2}); in general
    c^2 = 1/(mean mass * mean compliance 1/K2) per site.

    Gyroscopic forces between the sites add terms that are odd in k: the speeds along a direction
    and against it then differ.

    **Arguments:** `lattice`, `cell`: as in `dispersion`. `direction`: on a grid, the phase advances
    per site along each axis for a unit wave number, (axes,), by default the first axis. With
    lattice vectors a_i (rows of `a`) and a unit vector n, `direction = a @ n` gives c in lengths
    per time.

    **Returns:** one number for scalar displacements, else (dimension,), slowest first; negative for
    an unstable long wave. Differentiable where speeds differ.
    **Raises** ValueError in a sonic vacuum (no linear stiffness), with forces that tie sites to
    their places (no acoustic band), with gyroscopic forces that turn a uniform motion (omega is
    proportional to k^2), where parts of the cell are loose, and where `dispersion` does.

    **Example:**

    >>> chain = gx.scenes.monomer(20, precompression=1.0)
    >>> round(float(gx.linear.sound_speed(chain)), 6)  # (3/2)^{1/2}
    1.224745
    """
    found = turning_cell(lattice, cell)
    axes = len(found.cell)
    if direction is None:
        direction = np.eye(axes)[0]
    direction = parameter("direction", direction).astype(found.mass.dtype).reshape(-1)
    if direction.shape != (axes,):
        refuse("direction", f"{axes} numbers, one per axis", f"shape {direction.shape}")
    _check_acoustic(found)
    speed = _speeds(found, direction * np.array(found.cell))
    return speed[0] if found.dimension is None else speed


@compiled
def _speeds(found, turn):
    R = np.array(found.shells) @ turn
    T = _translations(jnp, found.mass, found.dimension)
    D = found.coupling.sum(0)
    # D' = i first, where first is real and antisymmetric; D'' = -second
    first = jnp.einsum("r,rab->ab", R, found.coupling)
    second = jnp.einsum("r,rab->ab", R * R, found.coupling)
    scale = or_one(jax.lax.stop_gradient(found.scale))

    def through(x, y):
        # T is the null space of D: T T^T makes D invertible, and x and y are orthogonal to T
        return x.T @ jnp.linalg.solve(D / scale + T @ T.T, y) / scale

    answer = first @ T
    answer = answer - T @ (T.T @ answer)
    squares = -T.T @ second @ T / 2 - through(answer, answer)
    largest = scale * jax.lax.stop_gradient(jnp.abs(R).max()) ** 2
    if found.damping is None:
        return signed_root(eigvalsh(squares), largest, found.mass.size)
    # With G(k) = G(0) + i k odd and g = G(0) T: c^2 (1 + g^T D^+ g) = squares + c bend
    turns = found.turning
    g = turns.sum(0) @ T
    odd = T.T @ jnp.einsum("r,rab->ab", R, turns) @ T
    bend = odd + through(answer, g) + through(g, answer)
    inverse = jnp.linalg.inv(turning.factor(jnp.eye(len(odd)) + through(g, g)))
    squares, bend = (inverse @ x @ inverse.T for x in (squares, bend))
    return turning.levels(squares, 1j * bend, largest)[0][len(odd) :]


def _translations(xp, mass, dimension):
    # uniform displacements as orthonormal vectors M^{1/2} u, (P, dimension)
    d = dimension or 1
    root = xp.sqrt(mass).reshape(-1, d)
    uniform = (root[..., None] * xp.eye(d, dtype=root.dtype)).reshape(-1, d)
    return uniform / xp.linalg.norm(uniform, axis=0)


def _check_acoustic(found):
    coupling, mass = (known_value(x) for x in (found.coupling, found.mass))
    if coupling is None:
        return
    D = coupling.sum(0)
    T = _translations(np, mass, found.dimension)
    scale = np.abs(coupling).max()
    if scale == 0:
        refuse(
            "lattice",
            "linear stiffness at rest",
            "none",
            "A sonic vacuum has no linear sound speed; give precompression > 0.",
        )
    tolerance = LOOSE * np.finfo(coupling.dtype).eps * scale
    if np.abs(D @ T).max() > tolerance:
        refuse(
            "lattice",
            "forces between sites alone",
            "forces that tie sites to their rest positions",
            "Such a lattice has no acoustic band, and so no sound speed; see granjax.linear.bands.",
        )
    turns = None if found.damping is None else known_value(found.turning)
    if turns is not None and np.abs(T.T @ turns.sum(0) @ T).max() > tolerance / scale * max(
        np.abs(turns).max(), np.sqrt(scale)
    ):
        refuse(
            "lattice",
            "gyroscopic forces between sites",
            "some that turn a uniform motion",
            "The lowest band then rises as k^2 and no wave has a speed of sound; see granjax.linear.dispersion.",
        )
    if np.sum(np.abs(np.linalg.eigvalsh(D)) <= tolerance) > T.shape[1]:
        refuse(
            "lattice",
            "a cell that is held together",
            "parts that move freely at no cost",
            "Bonds lack linear stiffness (give precompression > 0), or are too few; see granjax.linear.dispersion.",
        )
