"""What runs with a wave far from its core: ripples, linear waves of its own phase speed, and how the core decays."""

from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq

from ...profiles.fourier import Box, Chain

# no ripple is sought beyond this wave number [rad/site], nor nearer to zero than the first
HIGHEST, STEP = 60.0, 0.01
# harmonics of a ripple that is not linear; steps for its wave number
HARMONICS, GAUSS_NEWTON = 8, 8


class Ripple(NamedTuple):
    """A linear wave Re(a q_j e^{ikx}) of speed c: `wavenumber` k [rad/site], `shape` q (P,), max |q| = 1."""

    wavenumber: float
    shape: np.ndarray


def _excess(chain: Chain, k):
    """omega_b(k)^2/c^2 - k^2 of every band, ascending, (P, K), and the vectors of the strain (P, P, K)."""
    root = np.sqrt(chain.K2)
    B = root[:, None, None] * chain.response(k) * root[None, :, None]
    squares, vectors = np.linalg.eigh(np.moveaxis(B, -1, 0))
    return squares.T - k**2, np.moveaxis(vectors, 0, -1) / root[:, None, None]


def ripples(chain: Chain) -> list[Ripple]:
    """All linear waves that keep pace with a wave of speed 1: omega_b(k) = k, by root search band by band."""
    if not np.all(chain.K2 > 0):
        return []
    k = np.arange(1, int(HIGHEST / STEP)) * STEP
    if chain.resonator is not None:
        nu, kappa = chain.resonator[0], chain.resonator[1] / chain.unit
        # a bead and its resonator that swing alone: a ripple is the nearer to that, the less the contacts feel of it
        swing = np.sqrt(kappa / nu + kappa / chain.masses)[:, None]
        k = np.unique(
            np.append(k, swing * (1 + np.outer([-1, 1], np.geomspace(1e-13, 1e-2, 56)).ravel()))
        )
        k = k[np.abs(kappa - nu * k**2) > 1e-9 * kappa]
    found = []
    excess = _excess(chain, k)[0]
    # across that swing itself the sign changes through infinity
    apart = np.diff(k) > 1e-12 * k[1:]
    for band, i in zip(*np.nonzero((excess[:, :-1] * excess[:, 1:] < 0) & apart)):
        at = lambda q, band=band: _excess(chain, np.array([q]))[0][band, 0]
        root = brentq(at, k[i], k[i + 1], xtol=1e-15, rtol=1e-14)
        # where the resonators' mass passes through infinity or a band through another the sign changes without a root
        if abs(at(root)) < np.abs(excess[band, i : i + 2]).min():
            shape = _excess(chain, np.array([root]))[1][:, band, 0]
            found.append(Ripple(root, _normal(chain, shape)))
    return sorted(found, key=lambda ripple: ripple.wavenumber)


def group(chain: Chain, k: float) -> float:
    """Group velocity over c of the linear wave with omega(k) = c k."""
    excess = _excess(chain, k + STEP * np.array([-0.1, 0.0, 0.1]))[0]
    below, _, above = excess[np.argmin(np.abs(excess[:, 1]))]
    # omega^2 = excess + k^2, and omega = k there
    return (above - below) / (0.2 * STEP) / (2 * k) + 1


def _normal(chain, shape):
    """The shape with largest entry 1 in size, and a phase such that the mirrored ripple is itself."""
    if chain.mirror is not None:
        partner = shape[(chain.mirror - 1 - np.arange(len(shape))) % len(shape)]
        largest = np.argmax(np.abs(shape))
        shape = shape * np.sqrt(np.conj(partner[largest]) / shape[largest] + 0j)
    return shape / np.abs(shape).max()


def stiffness(chain: Chain) -> float:
    """Of the cell as a whole, over M c^2: K2 of the springs in series."""
    return 1 / np.mean(1 / chain.K2) if np.all(chain.K2 > 0) else 0.0


def margin(chain: Chain) -> float:
    """Speed over the sound speed; infinite in a sonic vacuum."""
    K = stiffness(chain)
    return np.sqrt(chain.total / K) if K > 0 else np.inf


def decay(chain: Chain) -> float:
    """Rate [1/site] at which the core falls: K (2 sinh(q/2))^2 = m(iq) q^2 of the chain that the cell is on average."""
    K = stiffness(chain)

    def at(q):
        inertia = chain.inertia(np.array([1j * q])).real.mean()
        return 4 * K * np.sinh(q / 2) ** 2 - inertia * q**2

    return brentq(at, 1e-4, 40.0) if at(1e-4) < 0 else 0.0


class Fit(NamedTuple):
    """A ripple in the tail of a wave: complex amplitude a, measured from x = half; `wavenumber` as measured.

    `rest` is what a periodic function of that wave number leaves of the tail.
    """

    amplitude: complex
    wavenumber: float
    rest: float


def tail(box: Box, phi, core: float):
    """Places y = x - half of the tail, which the box joins at its ends, (X,) and strains there (P, X)."""
    y = np.where(box.x > 0, box.x - box.half, box.x + box.half)
    order = np.argsort(y)
    order = order[np.abs(y[order]) <= box.half - core]
    return y[order], phi[:, order]


def periodic(y, k: float):
    """Columns (Y, 1 + 2 HARMONICS) of a periodic function at places y: the constant, then cosines and sines."""
    turns = k * np.outer(y, np.arange(1, HARMONICS + 1))
    return np.concatenate([np.ones((len(y), 1)), np.cos(turns), np.sin(turns)], axis=1)


def fit(box: Box, phi, ripple: Ripple, core: float) -> Fit:
    """The ripple beyond |x| = core, by a periodic function of one wave number for the bonds of the cell."""
    y, strain = tail(box, phi, core)
    k, order = ripple.wavenumber, np.arange(1, HARMONICS + 1)
    for _ in range(GAUSS_NEWTON):
        columns = periodic(y, k)
        found = np.linalg.lstsq(columns, strain.T, rcond=None)[0]
        left = strain.T - columns @ found
        amplitude = np.vdot(ripple.shape, found[1] - 1j * found[1 + HARMONICS]) / np.vdot(
            ripple.shape, ripple.shape
        )
        if np.abs(amplitude) <= 1e-9 * np.abs(phi).max():
            break
        # what the columns themselves cannot take up of the change with k
        turned = np.concatenate(
            [order * found[1 + HARMONICS :].T, -order * found[1 : 1 + HARMONICS].T], 1
        ).T
        along = y[:, None] * (columns[:, 1:] @ turned)
        along -= columns @ np.linalg.lstsq(columns, along, rcond=None)[0]
        k += np.sum(along * left) / np.sum(along**2)
    return Fit(complex(amplitude), float(k), float(np.abs(left).max()))


def ripple_row(box: Box, ripple: Ripple, core: float) -> np.ndarray:
    """The row that takes strains (P N,) to the real amplitude of a ripple that its mirror makes itself."""
    y, at = tail(box, np.arange(box.shape[0] * box.points).reshape(box.shape), core)
    wave = ripple.shape[:, None] * np.exp(1j * ripple.wavenumber * y)
    out = np.zeros(box.shape[0] * box.points)
    out[at.ravel()] = np.linalg.pinv(np.stack([wave.real.ravel(), -wave.imag.ravel()], axis=1))[0]
    return out


def drift_row(box):
    """The row that takes strains (P N,) to the slope of the first bond's at the box's end: beads that drift apart."""
    hat = np.fft.ifft(1j * box.k * np.fft.fft(np.eye(1, box.points)[0])).real
    # derivative at x = -half: circulant, so its first row
    out = np.zeros(box.shape[0] * box.points)
    out[: box.points] = hat[-np.arange(box.points) % box.points]
    return out
