"""The far field of a wave: ripples (linear waves of its phase speed) and the core's decay."""

from typing import NamedTuple

import numpy as np
import scipy

from ...profiles.fourier import Box, Chain, Solved

# The largest wave number of a ripple that is searched for [rad/site].
HIGHEST = 60.0
# The step of this search [rad/site]; group velocities are differences over a fifth of it.
STEP = 0.01
# The harmonics of a nonlinear ripple.
HARMONICS = 12
# The most steps of the search for its wave number.
GAUSS_NEWTON = 8


class Ripple(NamedTuple):
    """A linear wave Re(a q_j e^{ikx}): `wavenumber` k [rad/site], `shape` q (P,), max |q| = 1."""

    wavenumber: float
    shape: np.ndarray


def _excess(chain: Chain, k):
    # Return omega_b(k)^2/c^2 - k^2 (P, K) of all bands, and their strain vectors (P, P, K).
    root = np.sqrt(chain.K2)
    B = root[:, None, None] * chain.response(k) * root[None, :, None]
    squares, vectors = np.linalg.eigh(np.moveaxis(B, -1, 0))
    return squares.T - k**2, np.moveaxis(vectors, 0, -1) / root[:, None, None]


def ripples(chain: Chain) -> list[Ripple]:
    """Find all linear waves that keep pace with a wave of speed 1: omega_b(k) = k."""
    if not chain.stiffness.any():
        return []
    k = np.arange(1, int(HIGHEST / STEP)) * STEP
    if chain.resonator is not None:
        nu = chain.resonator[0]
        kappa = chain.resonator[1] / chain.unit
        # The free swing of a bead and its resonator: the less a ripple loads the contacts, the
        # nearer its wave number is to this.
        swing = np.sqrt(kappa / nu + kappa / chain.masses)[:, None]
        k = np.unique(
            np.append(k, swing * (1 + np.outer([-1, 1], np.geomspace(1e-13, 1e-2, 56)).ravel()))
        )
        k = k[np.abs(kappa - nu * k**2) > 1e-9 * kappa]
    found = []
    excess = _excess(chain, k)[0]
    # Across the free swing itself the sign changes through infinity.
    apart = np.diff(k) > 1e-12 * k[1:]
    for band, i in zip(*np.nonzero((excess[:, :-1] * excess[:, 1:] < 0) & apart)):
        at = lambda q, band=band: _excess(chain, np.array([q]))[0][band, 0]
        root = scipy.optimize.brentq(at, k[i], k[i + 1], xtol=1e-15, rtol=1e-14)
        # The sign changes without a root where the resonators' effective mass passes through
        # infinity or two bands cross.
        if abs(at(root)) < np.abs(excess[band, i : i + 2]).min():
            shape = _excess(chain, np.array([root]))[1][:, band, 0]
            found.append(Ripple(root, _normal(chain, shape)))
    return sorted(found, key=lambda ripple: ripple.wavenumber)


def group(chain: Chain, k: float) -> float:
    """Return the group velocity over c of the linear wave with omega(k) = c k."""
    excess = _excess(chain, k + STEP * np.array([-0.1, 0.0, 0.1]))[0]
    below, _, above = excess[np.argmin(np.abs(excess[:, 1]))]
    # omega^2 = excess + k^2, and omega = k at the ripple.
    return (above - below) / (0.2 * STEP) / (2 * k) + 1


def _normal(chain, shape):
    if chain.mirror is not None:
        partner = shape[(chain.mirror - 1 - np.arange(len(shape))) % len(shape)]
        largest = np.argmax(np.abs(shape))
        shape = shape * np.sqrt(np.conj(partner[largest]) / shape[largest] + 0j)
    return shape / np.abs(shape).max()


def stiffness(chain: Chain) -> float:
    """Return K2 of the cell's springs in series, over M c^2."""
    return 1 / np.mean(1 / chain.K2) if chain.stiffness.any() else 0.0


def margin(chain: Chain) -> float:
    """Return the speed over the sound speed; infinite in a sonic vacuum."""
    K = stiffness(chain)
    return np.sqrt(chain.total / K) if K > 0 else np.inf


def decay(chain: Chain) -> float:
    """Return the rate [1/site] at which the core falls.

    It solves K (2 sinh(q/2))^2 = m(iq) q^2 for the averaged cell.
    """
    K = stiffness(chain)

    def at(q):
        inertia = chain.inertia(np.array([1j * q])).real.mean()
        return 4 * K * np.sinh(q / 2) ** 2 - inertia * q**2

    return scipy.optimize.brentq(at, 1e-4, 40.0) if at(1e-4) < 0 else 0.0


class Fit(NamedTuple):
    """A ripple in the tail: its complex amplitude at x = half, and its measured `wavenumber`."""

    amplitude: complex
    wavenumber: float


def tail(x, table, core: float):
    """Return places y = x - half (X,) of the tail, joined at a box's ends, and a table (P, X)."""
    half = -x[0]
    y = np.where(x > 0, x - half, x + half)
    order = np.argsort(y)
    order = order[np.abs(y[order]) <= half - core]
    return y[order], table[:, order]


def periodic(y, k: float):
    """Return columns (Y, 1 + 2 HARMONICS) of a periodic function: the constant, cosines, sines."""
    turns = k * np.outer(y, np.arange(1, HARMONICS + 1))
    return np.concatenate([np.ones((len(y), 1)), np.cos(turns), np.sin(turns)], axis=1)


def fit(solved: Solved, ripple: Ripple, core: float) -> Fit:
    """Fit the ripple beyond |x| = core by a periodic function of one wave number for all bonds."""
    y, strain = tail(solved.box.x, solved.phi, core)
    k = ripple.wavenumber
    order = np.arange(1, HARMONICS + 1)
    for _ in range(GAUSS_NEWTON):
        columns = periodic(y, k)
        found = np.linalg.lstsq(columns, strain.T, rcond=None)[0]
        left = strain.T - columns @ found
        amplitude = np.vdot(ripple.shape, found[1] - 1j * found[1 + HARMONICS]) / np.vdot(
            ripple.shape, ripple.shape
        )
        if np.abs(amplitude) <= 1e-9 * solved.top:
            break
        # The derivative in k, less its projection on the columns.
        turned = np.concatenate(
            [order * found[1 + HARMONICS :].T, -order * found[1 : 1 + HARMONICS].T], 1
        ).T
        along = y[:, None] * (columns[:, 1:] @ turned)
        along -= columns @ np.linalg.lstsq(columns, along, rcond=None)[0]
        k += np.sum(along * left) / np.sum(along**2)
    return Fit(amplitude, float(k))


def nearest(x, table, k: float, core: float):
    """Fit a table (P, N) beyond |x| = core by `periodic`; return columns and largest distance."""
    y, there = tail(x, table, core)
    columns = periodic(y, k)
    found = np.linalg.lstsq(columns, there.T, rcond=None)[0]
    return found, float(np.abs(there.T - columns @ found).max())


def ripple_row(box: Box, ripple: Ripple, core: float) -> np.ndarray:
    """Return the row that maps strains (P N,) to the amplitude of a mirrored ripple."""
    y, at = tail(box.x, np.arange(box.shape[0] * box.points).reshape(box.shape), core)
    wave = ripple.shape[:, None] * np.exp(1j * ripple.wavenumber * y)
    out = np.zeros(box.shape[0] * box.points)
    out[at.ravel()] = np.linalg.pinv(np.stack([wave.real.ravel(), -wave.imag.ravel()], axis=1))[0]
    return out


def drift_row(box):
    """Return the row that maps strains (P N,) to the first bond's slope at the box's end."""
    hat = np.fft.ifft(1j * box.k * np.fft.fft(np.eye(1, box.points)[0])).real
    # The derivative at x = -half is the first row of a circulant matrix.
    out = np.zeros(box.shape[0] * box.points)
    out[: box.points] = hat[-np.arange(box.points) % box.points]
    return out
