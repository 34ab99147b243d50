"""Windows into a shock: short stretches of the chain, run on for a moment, so that waves are seen in time as well."""

from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

from ..flow import simulate
from ..lattice import Lattice, State
from ..profiles.medium import Medium
from ..programs import shared_size
from ..strains import Shift
from ..terms import Bond

# frames in time, of which one in three counts where waves are fitted; sites beyond what the ends of a window can reach
FRAMES, THIRD, BEYOND = 97, 3, 8
# bonds on each side of the middle that count; harmonics of a wave
BESIDE, HARMONICS = 3, 6
SAMPLES = 256


class Windows(NamedTuple):
    """Strains (frames, bonds, windows) of windows about the middle bonds `places`, at `times` (frames,) from now on."""

    places: np.ndarray
    times: np.ndarray
    strains: np.ndarray

    @property
    def half(self) -> int:
        """Bonds on each side of the middle one."""
        return self.strains.shape[1] // 2

    def near(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Offsets of the bonds that count, times about the middle, and their strains, in a third of the frames."""
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
    """The part of the strains (N - 1,) and velocities (N,) that holds the windows, run on for a time by equal steps.

    Its ends are free: what they send inwards at the `fastest` speed stays some bonds from the middle of each window.
    """
    half = int(np.ceil(fastest * span)) + BEYOND + BESIDE
    first, count = places.min() - half, shared_size(int(np.ptp(places)) + 2 * half + 1)
    # beyond the chain all is at rest as at its ends
    bonds = np.clip(first + np.arange(count), 0, len(strain) - 1)
    sites = np.clip(first + np.arange(count + 1), 0, len(velocity) - 1)
    u = np.append(0.0, -np.cumsum(strain[bonds]))
    lattice = Lattice(medium.mass, Bond(Shift(1, "free"), medium.law), sites=count + 1)
    state = State(u - u.mean(), velocity[sites] - velocity[sites].mean())
    run = simulate(lattice, state, span, step=step, save_at=FRAMES)
    strains = -np.diff(np.asarray(run.us), axis=1)
    window = places - first + np.arange(-half, half + 1)[:, None]
    return Windows(places, np.asarray(run.ts), strains[:, window])


class LocalWave(NamedTuple):
    """A periodic wave about one place: `crest` is where one is in the middle of the time.

    `misfit`: what it leaves of the strains, over its amplitude.
    """

    mean: float
    amplitude: float
    wavenumber: float
    omega: float
    crest: float
    misfit: float


NONE = LocalWave(*[np.nan] * 6)


def local_wave(xi: np.ndarray, tau: np.ndarray, strains: np.ndarray) -> LocalWave:
    """The wave sum a_j cos j(k xi - omega tau + phase), with a mean that drifts, nearest to strains (frames, bonds)."""
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
    found = least_squares(
        lambda p: fitted(p)[1] / scale, start, x_scale=np.abs(start) + 1e-3, xtol=1e-10, max_nfev=60
    )
    a, rest = fitted(found.x)
    angle = 2 * np.pi / SAMPLES * np.outer(np.arange(SAMPLES), np.arange(1, HARMONICS + 1))
    wave = np.cos(angle) @ a[3 : 3 + HARMONICS] + np.sin(angle) @ a[3 + HARMONICS :]
    amplitude = float(np.ptp(wave))
    k, omega = (float(x) for x in found.x)
    crest = 2 * np.pi / SAMPLES * np.argmax(wave) / k
    return LocalWave(float(a[0]), amplitude, k, omega, crest, float(np.abs(rest).max() / amplitude))


def _guess(tau, strains):
    """Wave number and frequency from crests in time of the middle bond and the next; `None` for fewer than two."""
    middle = strains.shape[1] // 2
    first, later = (_crests(tau, strains[:, middle + j]) for j in (0, 1))
    if len(first) < 2 or not len(later):
        return None
    period = np.diff(first).mean()
    delay = later[0] - first[np.argmin(np.abs(first - later[0]))]
    # a wave to the right: the next bond is later, by less than a period
    return np.array([2 * np.pi / period * (delay % period), 2 * np.pi / period])


def _crests(tau, x):
    top = tops(x)
    top = top[x[top] > (x.max() + x.min()) / 2]
    bend = x[top - 1] - 2 * x[top] + x[top + 1]
    return tau[top] + (tau[1] - tau[0]) * (x[top - 1] - x[top + 1]) / (2 * bend)


def tops(x: np.ndarray) -> np.ndarray:
    """Indices of what is higher than its neighbours."""
    return np.flatnonzero((x[1:-1] > x[:-2]) & (x[1:-1] >= x[2:])) + 1
