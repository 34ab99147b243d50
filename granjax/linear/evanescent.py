"""The real and complex wave numbers of waves of a given frequency."""

import equinox as eqx
import numpy as np
import scipy

from ..base.checks import described, is_site, parameter, refuse, traced
from ..base.types import Cell, ComplexNumbers, Count, Number, Numbers, Parameter
from ..lattice import Lattice
from ..results import Result, array, note
from .cell import damped_cell
from .losses import without_memory

# a root beyond this |z|, or below its inverse, may come from a singular block and be no wave: a
# double infinite root has |z| of about eps^{-1/2}, 7e7
LARGEST = 1e6
# a wave with less |Im k| travels
REAL = 1e-7


class ComplexBands(Result):
    """Complex wave numbers of given frequencies, for waves u ~ exp(i k R).

    Waves with Im k > 0 decay along the axis; those with real k travel.
    """

    omega: Numbers = array("The frequencies.", "rad/s", "frequency")
    k: ComplexNumbers = array(
        "The wave numbers per cell, sorted by |Im k|; NaN where a frequency has fewer.",
        "rad",
        "frequency wave",
    )
    residual: Numbers = array(
        "The relative residual of (D(k) - omega^2) q = 0.", "1", "frequency wave"
    )
    across: Number = array("The phase along the other axis.", "rad")
    axis: int = note("The axis along which the waves run.", static=True)
    cell: tuple[int, ...] = note("The number of sites per cell along each axis.", static=True)

    @property
    def decay(self) -> Numbers:
        """The least |Im k| [1/cell], 0 within a band; infinite where none is left."""
        decay = np.abs(np.asarray(self.k).imag)
        return np.min(decay, axis=-1, initial=np.inf, where=~np.isnan(decay))

    @property
    def outcome(self) -> str:
        """The number of frequencies at which every wave decays."""
        stopped = int((self.decay > REAL).sum())
        return f"Wave numbers of {len(self.omega)} frequencies; at {stopped} of them every wave decays."


def complex_bands(
    lattice: Lattice,
    omega: Parameter,
    *,
    axis: Count = 0,
    across: Parameter = 0.0,
    cell: Cell = None,
) -> ComplexBands:
    r"""Compute all wave numbers of given frequencies along one axis, real and complex.

    They are the roots k of det(D(k) - omega^2) = 0. With z = exp(ik) this is a polynomial
    eigenvalue problem, sum_R coupling_R z^R q = omega^2 q, of degree twice the reach. A chain of
    equal beads has one pair, cos k = 1 - m omega^2/(2 K2): above its band k = pi + i kappa. Damping
    counts: the coupling is K - i omega C + sum c (-i omega)^a, with C = -d force/dv, gyroscopic or
    not, and the c and a of each `CaputoDamping`.

    **Arguments:** `omega`: (W,) [rad/s]; `axis`: of the waves; `across`: the phase along the other
    axis of a plane; `lattice`, `cell`: as in `unit_cell`.
    **Returns:** `ComplexBands`, for `gx.plots.complex_bands`, without derivatives. Waves of
    |Im k| > 13.8 are left out.
    **Raises** ValueError for a sonic vacuum, traced numbers, and where `dispersion` does.

    **Example:**

    >>> chain = gx.scenes.monomer(20, precompression=1.0)
    >>> found = gx.linear.complex_bands(chain, [3.0])  # above the band, which ends at 6^{1/2}
    >>> print(found.k[0].round(4))
    [3.1416+1.317j 3.1416-1.317j]
    """
    if traced((lattice, omega, across)):
        remedy = (
            "It has no derivatives; d k/d omega is one over the velocity of gx.linear.dispersion."
        )
        refuse("lattice and omega", "known numbers", "traced ones", remedy)
    found, losses = _with_losses(lattice, cell)
    axes = len(found.cell)
    # roots are sorted by value, so nothing here can be traced
    w = np.atleast_1d(np.asarray(parameter("omega", omega), float))
    if not is_site((axis,), (axes,)):
        refuse("axis", f"a whole number within {-axes} ... {axes - 1}", described(axis))
    given = parameter("across", across)
    if given.ndim:
        refuse("across", "one number", f"shape {given.shape}", "Call this once for each phase.")
    given = float(given)
    coupling = np.asarray(found.coupling)
    if not np.any(coupling):
        refuse(
            "lattice", "a lattice with linear waves", "a sonic vacuum", "Give it a precompression."
        )
    R = np.array(found.shells)
    phase = np.exp(1j * np.delete(R, axis, 1) @ np.full(axes - 1, given))
    reach = int(np.abs(R[:, axis]).max())
    if reach == 0:
        refuse("axis", "an axis along which sites are bound", f"{axis}")

    def blocks(omega):
        at = np.zeros((2 * reach + 1, *coupling.shape[1:]), complex)
        lossy = sum(((-1j * omega) ** order * C for order, C in losses), coupling)
        np.add.at(at, R[:, axis] + reach, phase[:, None, None] * lossy)
        return at

    scale = np.abs(coupling).max()
    waves = [_waves(blocks(x), x * x, scale) for x in w]
    most = max(len(z) for z, _ in waves)
    z, residual = (
        np.array([np.pad(x, (0, most - len(x)), constant_values=np.nan) for x in parts])
        for parts in zip(*waves)
    )
    k = -1j * np.log(z)
    return ComplexBands(w, k, residual, given, int(axis), found.cell, **lattice.origin)


def _with_losses(lattice, cell):
    # the cell with all damping, and [(order, C_R/M)] of forces -C D^order u, where order 1 is
    # viscous
    plain, past = without_memory(lattice)
    viscous = (one.terms[-1] for _, one in past)
    # all terms together determine the period
    found = damped_cell(eqx.tree_at(lambda x: x.terms, plain, (*plain.terms, *viscous)), cell)
    losses = []
    rest = np.asarray(found.damping)
    for order, one in past:
        own = damped_cell(one, found.cell)
        C = dict(zip(own.shells, np.asarray(own.damping)))
        none = np.zeros_like(found.coupling[0])
        losses.append((float(order), np.stack([C.get(R, none) for R in found.shells])))
        rest = rest - losses[-1][1]
    return found, [(1.0, rest), *losses] if plain.reads_velocity else losses


# by the companion form; a residual is the least singular value at the root, over its size
def _waves(blocks, squared, scale):
    # z = exp(ik) of all waves, the slowest decay first, and their residuals
    count, size = blocks.shape[:2]
    degree = count - 1
    reach = count // 2
    problem = blocks.copy()
    problem[reach] -= squared * np.eye(size)
    whole = problem / scale
    A = np.eye(size * degree, k=size, dtype=complex)
    A[-size:] = -np.concatenate(whole[:-1], axis=1)
    B = np.eye(size * degree, dtype=complex)
    B[-size:, -size:] = whole[-1]
    above, below = scipy.linalg.eig(A, B, right=False, homogeneous_eigvals=True)
    there = (np.abs(below) * LARGEST > np.abs(above)) & (np.abs(above) * LARGEST > np.abs(below))
    z = above[there] / below[there]
    z = z[np.argsort(np.abs(np.log(np.abs(z))), kind="stable")]
    powers = z[:, None] ** np.arange(-reach, reach + 1)
    D = np.einsum("zr,rab->zab", powers, problem)
    least = np.linalg.svd(D, compute_uv=False)[:, -1]
    return z, least / (scale * np.abs(powers).max(1))
