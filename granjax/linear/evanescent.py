"""Waves of a given frequency: the wave numbers, real and complex, that a lattice carries them with."""

import equinox as eqx
import numpy as np
from scipy.linalg import eig

from ..checks import parameter, refuse
from ..lattice import Lattice
from ..results import Result, array, note
from ..types import Cell, ComplexNumbers, Count, Number, Numbers, Parameter
from .cell import damped_cell
from .losses import without_memory

# |z| of roots beyond which exp(ik) is no wave but a block that is zero; what counts as |z| = 1
LARGEST, REAL = 1e8, 1e-7


class ComplexBands(Result):
    """Complex wave numbers of given frequencies.

    u ~ exp(i k R); Im k > 0 decays along the axis, real ones travel.
    """

    omega: Numbers = array("The frequencies.", "rad/s", "frequency")
    k: ComplexNumbers = array(
        "The wave numbers per cell in the order of |Im k|, NaN where a frequency has fewer.",
        "rad",
        "frequency wave",
    )
    residual: Numbers = array(
        "What is left of (D(k) - omega^2) q, relative.", "1", "frequency wave"
    )
    across: Number = array("The phase along the other axis.", "rad")
    axis: int = note("The axis along which the waves run.", static=True)
    cell: tuple[int, ...] = note("The number of sites per cell along each axis.", static=True)

    @property
    def decay(self) -> Numbers:
        """The least |Im k| of each frequency [1/cell]: 0 within a band, the slowest decay in a gap."""
        return np.nanmin(np.abs(np.asarray(self.k).imag), axis=-1)

    @property
    def outcome(self) -> str:
        """At how many frequencies nothing travels."""
        stopped = int((self.decay > REAL).sum())
        return f"Wave numbers of {len(self.omega)} frequencies; at {stopped} of them every wave decays."


def complex_bands(
    lattice: Lattice,
    omega: Parameter,
    *,
    axis: Count = 0,
    across: Parameter = 0.0,
    cell: Cell | None = None,
) -> ComplexBands:
    r"""Wave numbers of given frequencies along one axis: all roots k of det(D(k) - omega^2) = 0, real and complex.

    With z = exp(ik) a polynomial eigenvalue problem, sum_R coupling_R z^R q = omega^2 q, of degree twice the reach.
    A chain of equal beads has one pair, cos k = 1 - m omega^2/(2 K2): above its band k = pi + i kappa. Here damping
    counts: the coupling of a frequency is K - i omega C + sum c (-i omega)^a, with C = -d force/dv, gyroscopic or not,
    and the c and a of each `CaputoDamping`. So every wave of a damped lattice decays.

    **Arguments:** `lattice`: one `Lattice`; `omega` (W,) [rad/s]; `axis`: along which; `across`: the phase along the
    other axis of a plane, one number; `cell`: as in `unit_cell`. **Returns:** `ComplexBands`, for
    `gx.plots.complex_bands`. **Raises** ValueError for
    a sonic vacuum, traced frequencies, and where `unit_cell` does. No derivative is taken; d k/d omega is one over the
    group velocity of `dispersion`.

    **Example:**

    >>> chain = gx.scenes.monomer(20, precompression=1.0)
    >>> found = gx.linear.complex_bands(chain, [3.0])  # above the band, which ends at 6^{1/2}
    >>> print(found.k[0].round(4))
    [3.1416+1.317j 3.1416-1.317j]
    """
    found, losses = _with_losses(lattice, cell)
    axes = len(found.cell)
    # roots are sorted by their values, so that nothing here is traced
    w = np.atleast_1d(np.asarray(parameter("omega", omega), float))
    given, coupling = float(parameter("across", across)), np.asarray(found.coupling)
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
    shape = len(w), max(len(z) for z, _ in waves)
    k, residual = np.full(shape, np.nan + 0j), np.full(shape, np.nan)
    for i, (z, left) in enumerate(waves):
        k[i, : len(z)] = -1j * np.log(z)
        residual[i, : len(z)] = left
    return ComplexBands(w, k, residual, given, int(axis), found.cell, **lattice.origin)


def _with_losses(lattice, cell):
    """The cell with all that damps it, and [(order, C_R)] over its masses: -C D^order u, order 1 the damping."""
    plain, past = without_memory(lattice)
    viscous = (one.terms[-1] for _, one in past)
    # the period is that of all of them together
    found = damped_cell(eqx.tree_at(lambda x: x.terms, plain, (*plain.terms, *viscous)), cell)
    losses, rest = [], np.asarray(found.damping)
    for order, one in past:
        own = damped_cell(one, found.cell)
        C = dict(zip(own.shells, np.asarray(own.damping)))
        none = np.zeros_like(found.coupling[0])
        losses.append((float(order), np.stack([C.get(R, none) for R in found.shells])))
        rest = rest - losses[-1][1]
    return found, [(1.0, rest), *losses] if plain.reads_velocity else losses


def _waves(blocks, squared, scale):
    """z = exp(ik) of all waves, by the companion form, the most slowly decaying first, and what they leave.

    That is the least singular value of the problem at a root, relative to its size.
    """
    count, size = blocks.shape[:2]
    degree, reach = count - 1, count // 2
    problem = blocks.copy()
    problem[reach] -= squared * np.eye(size)
    whole = problem / scale
    A = np.eye(size * degree, k=size, dtype=complex)
    A[-size:] = -np.concatenate(whole[:-1], axis=1)
    B = np.eye(size * degree, dtype=complex)
    B[-size:, -size:] = whole[-1]
    above, below = eig(A, B, right=False, homogeneous_eigvals=True)
    there = (np.abs(below) * LARGEST > np.abs(above)) & (np.abs(above) * LARGEST > np.abs(below))
    z = above[there] / below[there]
    z = z[np.argsort(np.abs(np.log(np.abs(z))), kind="stable")]
    powers = z[:, None] ** np.arange(-reach, reach + 1)
    D = np.einsum("zr,rab->zab", powers, problem)
    least = np.linalg.svd(D, compute_uv=False)[:, -1]
    return z, least / (scale * np.abs(powers).max(1))
