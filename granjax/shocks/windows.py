"""Windows of a shock: short stretches of the chain, run on briefly to show waves in time."""

from typing import NamedTuple

import numpy as np
import scipy

from ..base.programs import shared_size
from ..flow import simulate
from ..lattice import Lattice, State
from ..profiles.highest import tops
from ..profiles.medium import Medium
from ..strains import Shift
from ..terms import Bond

# The frames of a window.
FRAMES = 97
# One in three frames is used for fits.
THIRD = 3
# The extra sites beyond the reach of a window's ends.
BEYOND = 8
# The bonds on each side of the middle that are fitted.
BESIDE = 3
# The harmonics of a fitted wave.
HARMONICS = 6
# The places on a period at which a fitted wave's crest and amplitude are read off.
SAMPLES = 256


class Windows(NamedTuple):
    """Strains (frames, bonds, windows) about the windows' bonds, at `times` (frames,)."""

    times: np.ndarray
    strains: np.ndarray

    @property
    def half(self) -> int:
        """The number of bonds on each side of the middle one."""
        return self.strains.shape[1] // 2

    def near(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the data to fit: bond offsets, centred times, strains of a third of the frames."""
        part = slice(self.half - BESIDE, self.half + BESIDE + 1)
        times = self.times[::THIRD]
        return np.arange(-BESIDE, BESIDE + 1), times - times[-1] / 2, self.strains[::THIRD, part]


def windows(
    medium: Medium,
    strain: np.ndarray,
    velocity: np.ndarray,
    places: np.ndarray,
    span: float,
    fastest: float,
    step: float,
) -> Windows:
    """Run on the part of strains (N - 1,) and velocities (N,) that holds the windows.

    Its ends are free. What they send inwards at the `fastest` speed does not reach the bonds to
    fit.
    """
    half = int(np.ceil(fastest * span)) + BEYOND + BESIDE
    first = places.min() - half
    count = shared_size(int(np.ptp(places)) + 2 * half + 1)
    # Beyond the chain the state is that at its ends.
    bonds = np.clip(first + np.arange(count), 0, len(strain) - 1)
    sites = np.clip(first + np.arange(count + 1), 0, len(velocity) - 1)
    u = np.append(0.0, -np.cumsum(strain[bonds]))
    lattice = Lattice(medium.mass, Bond(Shift(1, "free"), medium.law), sites=count + 1)
    state = State(u - u.mean(), velocity[sites] - velocity[sites].mean())
    run = simulate(lattice, state, span, step=step, save_at=FRAMES)
    strains = -np.diff(np.asarray(run.us), axis=1)
    window = places - first + np.arange(-half, half + 1)[:, None]
    return Windows(np.asarray(run.ts), strains[:, window])


class LocalWave(NamedTuple):
    """A periodic wave about one place; it has a crest at `crest` in the middle of the time.

    `misfit`: the largest residual of the strains over the amplitude.
    """

    mean: float
    amplitude: float
    wavenumber: float
    omega: float
    crest: float
    misfit: float


NONE = LocalWave(*[np.nan] * 6)


def local_wave(xi: np.ndarray, tau: np.ndarray, strains: np.ndarray) -> LocalWave:
    """Fit the wave sum a_j cos j(k xi - omega tau + phase) to strains (frames, bonds).

    The mean may drift linearly.
    """
    start = _guess(tau, strains)
    if start is None:
        return NONE
    drift = np.stack(
        [
            np.ones_like(strains),
            np.broadcast_to(xi, strains.shape),
            np.broadcast_to(tau[:, None], strains.shape),
        ],
        -1,
    ).reshape(-1, 3)
    drift = drift / np.abs(drift).max(0)
    flat = strains.ravel()

    def fitted(p):
        phase = (p[0] * xi - p[1] * tau[:, None]).ravel()[:, None] * np.arange(1, HARMONICS + 1)
        basis = np.concatenate([drift, np.cos(phase), np.sin(phase)], 1)
        a = np.linalg.lstsq(basis, flat, rcond=None)[0]
        return a, basis @ a - flat

    scale = np.ptp(strains)
    found = scipy.optimize.least_squares(
        lambda p: fitted(p)[1] / scale, start, x_scale=np.abs(start) + 1e-3, xtol=1e-10, max_nfev=60
    )
    a, rest = fitted(found.x)
    angle = 2 * np.pi / SAMPLES * np.outer(np.arange(SAMPLES), np.arange(1, HARMONICS + 1))
    wave = np.cos(angle) @ a[3 : 3 + HARMONICS] + np.sin(angle) @ a[3 + HARMONICS :]
    amplitude = np.ptp(wave)
    k, omega = found.x
    crest = 2 * np.pi / SAMPLES * np.argmax(wave) / k
    return LocalWave(a[0], amplitude, k, omega, crest, np.abs(rest).max() / amplitude)


def _guess(tau, strains):
    middle = strains.shape[1] // 2
    first, later = (_crests(tau, strains[:, middle + j]) for j in (0, 1))
    if len(first) < 2 or not len(later):
        return None
    period = np.diff(first).mean()
    delay = later[0] - first[np.argmin(np.abs(first - later[0]))]
    # A wave to the right reaches the next bond later, by less than a period.
    return np.array([2 * np.pi / period * (delay % period), 2 * np.pi / period])


def _crests(tau, x):
    top = tops(x)
    top = top[x[top] > (x.max() + x.min()) / 2]
    bend = x[top - 1] - 2 * x[top] + x[top + 1]
    return tau[top] + (tau[1] - tau[0]) * (x[top - 1] - x[top + 1]) / (2 * bend)
