"""Fitting y'' = f(y) + g y' to measured waves: a first guess in weak form, then trajectories by least squares.

Everything is in scaled numbers: strains in half of their range about its middle, places in the mean wavelength over
2 pi. So nothing depends on the units of the data.
"""

from typing import NamedTuple

import diffrax
import numpy as np
from scipy.interpolate import CubicSpline

from ..descent import levenberg_marquardt

# points of a window of weak form, its half width in wavelengths, powers of its weight; longest step of a trajectory
FINE, WIDTH, POWER, STEP = 24, 0.5, 6, 0.25
# lengths of the pieces that are fitted first, and how many points one has at least
PIECES, LEAST = (2.0, 6.0), 6
# rms of residuals from which on another beginning is tried
POOR = 0.05
# steps of Levenberg and Marquardt; relative changes of the squares and of the unknowns at which they end
STEPS, SLOW, SETTLED = 60, 1e-8, 1e-13
_TABLEAU = diffrax.Dopri8.tableau


class Train(NamedTuple):
    """A piece of a measured wave in scaled numbers: places (P,) and strains (P,)."""

    x: np.ndarray
    y: np.ndarray


class Found(NamedTuple):
    """Coefficients of the powers of y, then that of y'; starts; residuals, their Jacobian, slopes."""

    coefficients: np.ndarray
    starts: np.ndarray
    residual: np.ndarray
    jacobian: np.ndarray
    slopes: np.ndarray
    settled: bool


def split(train: Train, count: int) -> list[Train]:
    """The pieces of a train, one after the other."""
    return [
        Train(*both) for both in zip(np.array_split(train.x, count), np.array_split(train.y, count))
    ]


def powers(y: np.ndarray, degree: int) -> np.ndarray:
    """y^k, k = 0 ... degree, along a new first axis."""
    return np.stack([y**k for k in range(degree + 1)])


def first(trains: list[Train], degree: int, drift: bool) -> np.ndarray:
    """Coefficients by int y phi'' = sum c_k int y^k phi - g int y phi', of bumps phi half a wave to either side."""
    rows, right = [], []
    for x, y in trains:
        grid = np.linspace(x[0], x[-1], FINE * max(len(x), 8))
        fine, half = CubicSpline(x, y)(grid), min(WIDTH * 2 * np.pi, (x[-1] - x[0]) / 2)
        for centre in np.linspace(
            x[0] + half, x[-1] - half, max(4, 2 * int((x[-1] - x[0]) / half) * degree)
        ):
            t = (grid - centre) / half
            inside = np.clip(1 - t**2, 0.0, None)
            phi, slope = inside**POWER, -2 * POWER * t * inside ** (POWER - 1) / half
            bend = 2 * POWER * inside ** (POWER - 2) * (2 * (POWER - 1) * t**2 - inside) / half**2
            row = powers(fine, degree) @ phi
            rows.append(np.append(row, -(fine @ slope)) if drift else row)
            right.append(fine @ bend)
    return np.linalg.lstsq(np.array(rows), np.array(right), rcond=1e-10)[0]


def growth(train: Train, c: np.ndarray, degree: int) -> float:
    """By how many powers of e two trajectories part along a train, where f' is above zero."""
    slope = np.arange(1, degree + 1) * c[1 : degree + 1] @ powers(train.y, degree - 1)
    return float(np.trapezoid(np.sqrt(np.maximum(slope, 0.0)), train.x))


def trajectories(
    trains: list[Train], c: np.ndarray, starts: np.ndarray, degree: int, drift: bool
) -> np.ndarray:
    """Strains at the places of all trains, their derivatives in c and in both starts, and slopes (P, W, 2 + m).

    All trains side by side; those that end sooner stay where they end. `starts` (2, W): y and y' at their beginning.
    """
    count, longest = len(trains), max(len(train.x) for train in trains)
    gaps = np.zeros((longest - 1, count))
    for k, train in enumerate(trains):
        gaps[: len(train.x) - 1, k] = np.diff(train.x)
    state = np.zeros((2, 1 + len(c) + 2, count))
    state[:, 0], state[0, -2], state[1, -1] = starts, 1.0, 1.0
    slopes, found = np.arange(1, degree + 1), [np.append(state[0], state[1, :1], 0)]

    def field(s):
        y, p = s[0, 0], s[1, 0]
        basis = powers(y, degree)
        g = c[degree + 1] if drift else 0.0
        force = c[: degree + 1] @ basis + g * p
        slope = (slopes * c[1 : degree + 1]) @ basis[:-1]
        bend = slope * s[0, 1:] + g * s[1, 1:]
        bend[: degree + 1] += basis
        if drift:
            bend[degree + 1] += p
        return np.stack([s[1], np.concatenate([force[None], bend])])

    for gap in gaps:
        parts = max(1, int(np.ceil(gap.max() / STEP)))
        for _ in range(parts):
            state = state + _step(field, state, gap / parts)
        found.append(np.append(state[0], state[1, :1], 0))
    return np.moveaxis(np.array(found), 2, 1)


def _step(field, state, h):
    """The change over a step of Dormand and Prince's method of order eight."""
    stages = [field(state)]
    for row in _TABLEAU.a_lower:
        stages.append(field(state + h * sum(a * k for a, k in zip(row, stages) if a)))
    return h * sum(b * k for b, k in zip(_TABLEAU.b_sol, stages) if b)


def fit(trains: list[Train], degree: int, drift: bool) -> Found:
    """Least squares over the coefficients and the start of every train.

    Long trajectories lead astray before their equation is known: those of short pieces are fitted first.
    """
    found = _from(trains, first(trains, degree, drift), degree, drift)
    if np.mean(found.residual**2) > POOR**2:
        # of few points or much noise
        other = _from(trains, _oscillation(degree + 1 + drift), degree, drift)
        found = min(found, other, key=lambda one: one.residual @ one.residual)
    return found


def _from(trains, c, degree, drift):
    for piece in PIECES:
        short, heads = [], []
        for train in trains:
            count = max(
                1, min(int(np.ceil((train.x[-1] - train.x[0]) / piece)), len(train.x) // LEAST)
            )
            heads.append(len(short))
            short += split(train, count)
        found = least_squares(short, c, _starts(short), degree, drift)
        c = found.coefficients if found.settled else c
    return least_squares(trains, c, found.starts[:, heads], degree, drift)


def _starts(trains):
    return np.array([[train.y[0], CubicSpline(*train)(train.x[0], 1)] for train in trains]).T


def least_squares(
    trains: list[Train], c: np.ndarray, starts: np.ndarray, degree: int, drift: bool
) -> Found:
    """The method of Levenberg and Marquardt, of MINPACK, from some coefficients and starts."""
    shared, count = len(c), len(trains)
    ends = np.cumsum([0] + [len(train.x) for train in trains])

    def parted(unknown):
        return unknown[:shared], unknown[shared:].reshape(count, 2).T

    def evaluate(unknown):
        """Residuals, Jacobian and slopes."""
        with np.errstate(all="ignore"):
            along = trajectories(trains, *parted(unknown), degree, drift)
        rows = np.concatenate([along[: len(train.x), k] for k, train in enumerate(trains)])
        residual = rows[:, 0] - np.concatenate([train.y for train in trains])
        jacobian = np.zeros((ends[-1], unknown.size))
        jacobian[:, :shared] = rows[:, 1 : 1 + shared]
        for k in range(count):
            own, column = slice(ends[k], ends[k + 1]), shared + 2 * k
            jacobian[own, column : column + 2] = rows[own, 1 + shared : -1]
        return residual, jacobian, rows[:, -1]

    found = levenberg_marquardt(evaluate, np.append(c, starts.T), SLOW, SETTLED, STEPS)
    if found is None:
        begin = np.append(_oscillation(shared), starts.T)
        found = levenberg_marquardt(evaluate, begin, SLOW, SETTLED, STEPS)
    return Found(*parted(found.x), *evaluate(found.x), found.status > 0)


def _oscillation(shared):
    """The coefficients of a harmonic oscillation, which has the wave number 1 here."""
    return np.append([0.0, -1.0], np.zeros(shared - 2))
