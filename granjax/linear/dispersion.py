"""Dispersion relation, Bloch vectors, group velocity and curvature of a periodic lattice."""

import jax.numpy as jnp
import numpy as np

from ..base.checks import parameter
from ..base.derivatives import eigh
from ..base.programs import compiled
from ..base.types import Cell, ComplexNumbers, Numbers, Parameter
from ..lattice import Lattice
from ..results import Result, array, note
from . import turning
from .cell import UnitCell, along_waves, by_lanes, in_lanes, phases, slopes, turning_cell
from .modes import UNSTABLE, signed_root
from .stiffness import each

# levels of omega^2 (with gyroscopic forces, of omega) closer than this are degenerate, in units of
# eps times the largest
DEGENERATE = 4096


class Dispersion(Result):
    """omega(k) of every band, sorted by omega at each k.

    `k` has the shape (k...,) for a chain and (k..., d) for d axes; derivatives then have last axes
    (d,) and (d, d). The wave in cell R is u_j(R) = vectors_j exp(i (k . R - omega t)). Derivatives
    are exact (perturbation theory), NaN where they do not exist: at omega = 0, where an
    acoustic band has a corner (see `sound_speed`), and where bands cross. Bands that stay
    degenerate keep theirs.
    """

    k: Numbers = array("The phase advance per unit cell.", "rad", "wave")
    omega: Numbers = array(
        "sign(omega^2) |omega^2|^{1/2}, negative where the lattice is unstable.",
        "rad/s",
        "wave band",
    )
    omega_squared: Numbers = array("omega^2.", "rad^2/s^2", "wave band")
    vectors: ComplexNumbers | dict[str, ComplexNumbers] = array(
        "Bloch vectors, normalised with the mass over the cell.", axes="wave site ... band"
    )
    group_velocity: Numbers = array("d omega/dk, in cells per time.", "1/s", "wave band")
    curvature: Numbers = array("d^2 omega/dk^2, in cells^2 per time.", "1/s", "wave band")
    cell: tuple[int, ...] = note(
        "The number of sites per cell along each axis, which converts cells to sites.",
        static=True,
    )

    def _held(self, name):
        return along_waves(self, super()._held(name))

    @property
    def outcome(self) -> str:
        """The number of bands and wave numbers, and the frequencies."""
        omega = by_lanes(self, self.omega)
        bands = omega.shape[-1]
        if np.isnan(omega).any():
            some = "" if np.isnan(omega).all() else "at some wave numbers "
            return f"No bands {some}{UNSTABLE}"
        return (
            f"{bands} band{'s' * (bands > 1)} at {omega[0, ..., 0].size} wave numbers{in_lanes(self)}, "
            f"omega = {omega.min():.6g} ... {self._told('omega', omega.max())}."
        )


def dispersion(
    lattice: Lattice,
    k: Parameter,
    cell: Cell = None,
) -> Dispersion:
    r"""Compute the dispersion relation D(k) q = omega^2 q of an infinite lattice, without damping.

    With gyroscopic forces, for which -d force/dv has an antisymmetric part C, the equation is
    (D(k) - i omega G(k)) q = omega^2 q, where C gives G(k) as the stiffness gives D(k). Then
    omega > 0, and waves of -k differ from those of k; omega is NaN where D is not positive: such
    waves may grow, and `floquet_bands` follows them.

    **Arguments:**

    - `lattice`: one `Lattice`, of any boundary: sites within reach of an end are ignored.
    - `k`: phase advance per unit cell [rad], any shape; on a grid of d axes the last axis has
      length d. A wave vector q in space has k_i = q . a_i, with lattice vectors a_i (triangular
      lattice, axes at 60 degrees: (2 pi/3, 4 pi/3) is the K point, (pi, 0) an M point).
    - `cell`: as in `unit_cell`.

    **Returns:** `Dispersion`. A chain of equal beads has omega = 2 (K2/m)^{1/2} |sin(k/2)|, a dimer
    two bands over -pi < k <= pi per cell of two beads. In a sonic vacuum all frequencies are zero.
    Differentiable in `k` and every parameter where bands do not cross. omega^2 is accurate to about
    1e-16 of its largest value; with several sites per cell the error of omega is up to 1e-8 of the
    cutoff as omega tends to zero.
    **Raises** ValueError for `k` of another shape, and where `unit_cell` does, except for
    gyroscopic forces constant in time.

    **Example:**

    >>> relation = gx.linear.dispersion(gx.scenes.monomer(20, precompression=1.0), [np.pi / 2, np.pi])
    >>> print(relation.omega[:, 0].round(4))  # 2 (3/2)^{1/2} sin(k/2)
    [1.7321 2.4495]
    """
    found = turning_cell(lattice, cell)
    k = parameter("k", k).astype(found.mass.dtype)
    axes = len(found.cell)
    squared, omega, vectors, velocity, curvature = bloch_waves(found, phases(k, axes), axes == 1)
    return Dispersion(k, omega, squared, vectors, velocity, curvature, found.cell, **lattice.origin)


@compiled
def bloch_waves(found: UnitCell, k: Numbers, chain: bool = False) -> tuple:
    """Return omega^2, omega, displacements, d omega/dk and d^2 omega/dk^2 at k (k..., axes).

    Derivatives are (k..., bands, axes) and (k..., bands, axes, axes); for a `chain` (k..., bands).
    """
    axes = k.shape[-1]
    points = k.astype(found.mass.dtype).reshape(-1, axes)
    at_once = max(1, 2**22 // (found.mass.size * axes) ** 2)
    parts = each(lambda k: _wave(found, k), points, at_once)
    squared, omega, q, velocity, curvature = (x.reshape(k.shape[:-1] + x.shape[1:]) for x in parts)
    if chain:
        velocity = velocity[..., 0]
        curvature = curvature[..., 0, 0]
    return squared, omega, found.displacements(q), velocity, curvature


def _wave(found, k):
    # at one k: omega^2, omega, vectors (P, bands), derivatives (bands, axes), (bands, axes, axes)
    D = found.dynamical_matrix(k)
    matrices = slopes(found.coupling, found.shells, k)
    if found.damping is None:
        squared, q = eigh(D)
        omega = signed_root(squared, jnp.abs(D).max(), squared.size)
        slope, bend, smooth, flat = _perturbed(squared, q, jnp.ones_like(squared), matrices)
        divisor = jnp.where(omega != 0, omega, 1)
        velocity = slope / (2 * divisor)
        curve = (bend / 2 - velocity[:, None] * velocity) / divisor
    else:
        # D q = omega (omega + iG) q, whose vectors are normalised to q^+ (2 omega + iG) q = +-1
        levels, v = turning.levels(D, found.gyration(k), found.scale)
        # only one eigenproblem per program: XLA's threads may deadlock where two run side by side
        squared, q = turning.upper(levels, v, found.scale)
        omega = signed_root(squared, jnp.abs(D).max(), squared.size)
        sign = jnp.sign(levels)
        turns = slopes(found.turning, found.shells, k)
        all_q = sign * v / jnp.sqrt(jnp.abs(levels))
        velocity, curve, smooth, flat = _perturbed(levels, all_q, sign, matrices, turns)
    still = jnp.all(found.coupling == 0) & (found.damping is None)
    there = (omega != 0) & smooth | still
    velocity = jnp.where(there, velocity, jnp.nan)
    curve = jnp.where(there & (flat | still), curve, jnp.nan)
    return squared, omega, q, velocity.T, jnp.moveaxis(curve, -1, 0)


def _perturbed(levels, vectors, sign, matrices, turns=(None, None)):
    # derivatives (axes, bands) and (axes, axes, bands) of the highest levels of D, or of D q =
    # level (level + iG) q, from those of D and G; and of which bands they exist
    size = len(vectors)
    own = levels[-size:]
    q = vectors[:, -size:]
    gap = own - levels[:, None]
    same = jnp.abs(gap) <= DEGENERATE * jnp.finfo(gap.dtype).eps * jnp.abs(levels).max()

    def between(x, of):
        return jnp.einsum("am,...ab,bn->...mn", of.conj(), x, q)

    def changed(D, G, of):
        return between(D, of) if G is None else between(D, of) - own * between(1j * G, of)

    first, second = zip(matrices, turns)
    within = changed(*first, vectors)
    weight = jnp.where(same, 0, sign[:, None] / jnp.where(same, 1, gap))
    # sum over the other bands m of <n|D_j|m><m|D_l|n'>/(level_n - level_m), both orders of j and l
    through = jnp.einsum("jmn,mn,lmp->jlnp", within.conj(), weight, within)
    same = same[-size:]
    slope, smooth = _diagonal(within[:, -size:], same)
    if turns[0] is not None:
        through -= slope[:, None, :, None] * between(1j * turns[0], q)
    bend, flat = _diagonal(changed(*second, q) + through + through.swapaxes(0, 1), same)
    return slope, bend, smooth, flat


def _diagonal(matrices, same):
    # diagonals (..., bands), and whether all matrices are multiples of 1 within each degenerate
    # group
    diagonal = jnp.real(jnp.diagonal(matrices, axis1=-2, axis2=-1))
    tolerance = np.sqrt(jnp.finfo(diagonal.dtype).eps) * jnp.abs(matrices).max()
    others = same & ~np.eye(len(same), dtype=bool)
    uneven = jnp.abs(diagonal[..., :, None] - diagonal[..., None, :])
    off = jnp.where(others, jnp.maximum(jnp.abs(matrices), uneven), 0)
    return diagonal, jnp.all(off <= tolerance, axis=tuple(range(off.ndim - 2)) + (off.ndim - 1,))
