"""Fitting y'' = f(y) + g y' to measured waves: trajectories by least squares, of short pieces first.

Everything is in scaled numbers: strains in half of their range about its middle, places in the mean wavelength over
2 pi. So nothing depends on the units of the data.
"""

from typing import NamedTuple

import diffrax
import numpy as np
from scipy.interpolate import CubicSpline

from ..descent import levenberg_marquardt

# longest step of a trajectory
STEP = 0.25
# lengths of the pieces that are fitted first, as long trajectories lead astray before their equation is known
PIECES = (2.0, 6.0)
# fewest points of a piece
LEAST = 6
# waves in a window, unless f' > 0 in so much of it that its trajectories part by more powers of e
WAVES, PARTS = 1.2, 4.0
# steps of Levenberg and Marquardt; relative changes of the squares and of the unknowns at which they end
STEPS, SLOW, SETTLED = 60, 1e-8, 1e-13
# a share of a number of windows that rounding makes of none
CLOSE = 1e-9
_TABLEAU = diffrax.Dopri8.tableau


class Found(NamedTuple):
    """Coefficients of the powers of y, then that of y'; starts (2, W); at the points residuals, Jacobian and slopes."""

    coefficients: np.ndarray
    starts: np.ndarray
    residual: np.ndarray
    jacobian: np.ndarray
    slopes: np.ndarray
    settled: bool


def fitted(trains: list, degree: int, drift: bool) -> tuple[list, Found]:
    """The windows, each the indices of its points among all, and what the last fit found in them.

    `trains`: pairs of places and strains. There are as many windows as the length of a wave and the growth of small
    differences ask for.
    """
    x, y = (np.concatenate(parts) for parts in zip(*trains))
    slopes = np.concatenate([CubicSpline(*train)(train[0], 1) for train in trains])
    # a harmonic oscillation, which has the wave number 1 here
    first = c = np.append([0.0, -1.0], np.zeros(degree - 1 + drift))
    start = np.stack([y, slopes])
    for length in (*PIECES, None):
        counts = []
        for places, strains in trains:
            if length is not None:
                wanted = (places[-1] - places[0]) / length
            else:
                wanted = max(
                    places[-1] / (2 * np.pi * WAVES),
                    _growth(places, strains, c[: degree + 1]) / PARTS,
                )
            counts.append(max(1, min(int(np.ceil(wanted - CLOSE)), len(places) // LEAST)))
        pieces = _pieces([len(places) for places, _ in trains], counts)
        heads = start[:, [piece[0] for piece in pieces]]
        found = _least_squares(x, y, pieces, c, heads, drift)
        found = found or _least_squares(x, y, pieces, first, heads, drift)
        c = found.coefficients if found.settled else c
        start = np.stack([y + found.residual, found.slopes])
    return pieces, found


def _pieces(sizes, counts):
    """Indices of the points of every piece, from as many of each train as wanted."""
    every = np.split(np.arange(sum(sizes)), np.cumsum(sizes)[:-1])
    return [piece for own, count in zip(every, counts) for piece in np.array_split(own, count)]


def _powers(y, degree):
    """y^k, k = 0 ... degree, along a new first axis."""
    return np.stack([y**k for k in range(degree + 1)])


def _growth(x, y, c):
    """By how many powers of e two trajectories part along a train, where f' is above zero."""
    slope = np.arange(1, len(c)) * c[1:] @ _powers(y, len(c) - 2)
    return float(np.trapezoid(np.sqrt(np.maximum(slope, 0.0)), x))


def _trajectories(x, pieces, c, starts, drift):
    """Strains at the places of all pieces, their derivatives in c and in both starts, and slopes (P, W, 2 + m).

    All pieces side by side; those that end sooner stay where they end. `starts` (2, W): y and y' at their beginning.
    """
    count, degree = len(pieces), len(c) - 1 - drift
    gaps = np.zeros((max(map(len, pieces)) - 1, count))
    for k, piece in enumerate(pieces):
        gaps[: len(piece) - 1, k] = np.diff(x[piece])
    state = np.zeros((2, 1 + len(c) + 2, count))
    state[:, 0], state[0, -2], state[1, -1] = starts, 1.0, 1.0
    f, g = c[: degree + 1], c[-1] if drift else 0.0
    found = [np.append(state[0], state[1, :1], 0)]

    def field(s):
        y, p = s[0, 0], s[1, 0]
        basis = _powers(y, degree)
        slope = (np.arange(1, degree + 1) * f[1:]) @ basis[:-1]
        bend = slope * s[0, 1:] + g * s[1, 1:]
        bend[: degree + 1] += basis
        if drift:
            bend[degree + 1] += p
        return np.stack([s[1], np.concatenate([[f @ basis + g * p], bend])])

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


def _least_squares(x, y, pieces, c, starts, drift):
    """What Levenberg and Marquardt's method finds; `None` where the first trajectories are not finite."""
    shared, count = len(c), len(pieces)

    def parted(unknown):
        return unknown[:shared], unknown[shared:].reshape(count, 2).T

    def evaluate(unknown):
        """Residuals, Jacobian and slopes."""
        with np.errstate(all="ignore"):
            along = _trajectories(x, pieces, *parted(unknown), drift)
        rows = np.concatenate([along[: len(piece), k] for k, piece in enumerate(pieces)])
        jacobian = np.zeros((len(x), unknown.size))
        jacobian[:, :shared] = rows[:, 1 : 1 + shared]
        for k, piece in enumerate(pieces):
            columns = shared + 2 * k + np.arange(2)
            jacobian[np.ix_(piece, columns)] = rows[piece, 1 + shared : -1]
        return rows[:, 0] - y, jacobian, rows[:, -1]

    found = levenberg_marquardt(evaluate, np.append(c, starts.T), SLOW, SETTLED, STEPS)
    return found and Found(*parted(found.x), *evaluate(found.x), found.status > 0)
