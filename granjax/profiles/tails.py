r"""The tails of a front in a chain with dashpots: roots of its characteristic equation.

With lengths in contacts, kappa = K/(m s^2) of one side and zeta = eta/(m s), a small e^{lambda x}
obeys

    kappa - zeta lambda = g(lambda),  g = (lambda/2)^2/sinh(lambda/2)^2,

which is m s^2 lambda^2 = 4 sinh(lambda/2)^2 (K - eta s lambda). Behind the front kappa > 1 and Re
lambda > 0; ahead of it kappa < 1 and Re lambda < 0.
"""

from typing import NamedTuple

import numpy as np
import scipy

# The coefficients of 1 - (x/sinh x)^2 in powers of x^2.
_SERIES = (
    0.0,
    1 / 3,
    -1 / 15,
    2 / 189,
    -1 / 675,
    2 / 10395,
    -1382 / 58046625,
    4 / 1403325,
    -3617 / 10854718875,
)
# The |x| below which this series is used.
NEAR = 0.3
# The largest real parts up to which roots are searched, one after the other.
REACHES = (1.5, 3.0, 6.0)
# The number of starts across each range of real parts.
ACROSS = 12
# The largest distance of starts along the imaginary axis.
APART = 0.3
# The number of steps of Newton's method.
STEPS = 30
# The largest residual of a root, over the size of the terms of its equation.
CONVERGED = 1e-10
# Roots whose imaginary part is below this share of their modulus count as real.
REAL = 1e-7
# lambda at which g'' = 0
TOP = 2.34694130416726903


class Critical(NamedTuple):
    """The critical zeta, its derivative in kappa, and whether two real roots meet there."""

    zeta: float
    slope: float
    double: bool


def lack(root):
    """Return 1 - g at real or complex numbers."""
    x = np.asarray(root) / 2
    near = np.abs(x) < NEAR
    with np.errstate(all="ignore"):
        far = np.where(near, 1.0, x)
        return np.where(near, np.polyval(_SERIES[::-1], x * x), 1 - (far / np.sinh(far)) ** 2)


def lack_slope(root):
    """Return d(1 - g)/d lambda."""
    x = np.asarray(root) / 2
    near = np.abs(x) < NEAR
    with np.errstate(all="ignore"):
        far = np.where(near, 1.0, x)
        g = (far / np.sinh(far)) ** 2
        return np.where(
            near, x * np.polyval(np.polyder(_SERIES[::-1]), x * x), g * (1 / np.tanh(far) - 1 / far)
        )


def ahead(short: float, zeta: float) -> float:
    """Return the decay rate ahead of the front; `short` = 1 - kappa > 0."""
    return scipy.optimize.brentq(
        lambda rate: lack(rate) - short + zeta * rate,
        0.0,
        short / zeta,
        xtol=1e-300,
        rtol=1e-15,
    )


def behind(excess: float, zeta: float) -> complex:
    """Return the slowest root behind the front, rate + i wave number; `excess` = kappa - 1."""
    real = _real(excess, zeta)
    pair = _pair(excess, zeta)
    return complex(real) if pair is None or pair.real >= real else pair


def _real(excess, zeta):
    end = (1 + excess) / zeta
    places = np.append(0.0, np.geomspace(1e-8, 1.0 + 1e-9, 600) * end)
    below = excess + lack(places) - zeta * places <= 0
    k = int(np.argmax(below))
    return scipy.optimize.brentq(
        lambda x: excess + lack(x) - zeta * x,
        places[k - 1],
        places[k],
        xtol=1e-300,
        rtol=1e-15,
    )


def _pair(excess, zeta):
    real = _real(excess, zeta)
    for reach in REACHES:
        found = _complex(excess, zeta, min(reach, real))
        found = found[found.real < min(reach, real)]
        if len(found):
            return complex(found[np.argmin(found.real)])
        if real < reach:
            break
    return None


def _complex(excess, zeta, reach):
    square = np.cosh(reach / 2) ** 2
    # |lambda|^2 = 4 |sinh^2| |kappa - zeta lambda| bounds the roots. Roots near 2 pi i k, k > 1,
    # decay faster than that of k = 1.
    bound = 2 * square * zeta + 2 * np.sqrt(square**2 * zeta**2 + square * (1 + excess)) + APART
    width = min(APART, bound / ACROSS, 10 * np.sqrt(excess) / ACROSS)
    highest = min(bound, 2 * np.sqrt(1 + excess) + 4 * np.pi)
    heights = np.append(
        np.arange(width, 10 * np.sqrt(excess), width), np.arange(APART, highest, APART)
    )
    near = 2j * np.pi * np.arange(1, 5)
    z = np.append(
        near + np.sqrt(near**2 / (1 + excess - zeta * near)),
        reach * np.geomspace(1e-3, 0.95, ACROSS)[:, None] + 1j * heights,
    )
    with np.errstate(all="ignore"):
        for _ in range(STEPS):
            z = z - (excess + lack(z) - zeta * z) / (lack_slope(z) - zeta)
        left = np.abs(excess + lack(z) - zeta * z)
    size = excess + zeta * np.abs(z)
    return z[
        np.isfinite(z) & (left < CONVERGED * size) & (z.imag > REAL * np.abs(z)) & (z.real > 0)
    ]


def critical(excess: float) -> Critical:
    """Return the damping at which the approach behind turns from oscillatory to monotone.

    For weak fronts two real roots meet, where zeta = (kappa - g)/lambda has its minimum. For kappa
    above 1.18772 none meet, and the oscillatory pair decays as fast as the dominant real root.
    """

    def over(root):
        # This is zero at the extrema of (kappa - g)/lambda.
        return excess + lack(root) - root * lack_slope(root)

    # At these extrema kappa is largest where g'' = 0.
    if over(TOP) < 0:
        root = scipy.optimize.brentq(over, 0.0, TOP, xtol=1e-300, rtol=1e-15)
        return Critical((excess + lack(root)) / root, 1 / root, True)
    low = high = 0.3
    while _pair(excess, high) is not None:
        low = high
        high = 2 * high
    while _pair(excess, low) is None:
        high = low
        low = low / 2
    gone = lambda zeta: 1.0 if _pair(excess, zeta) is None else -1.0
    zeta = scipy.optimize.bisect(gone, low, high, xtol=1e-300, rtol=4 * np.finfo(float).eps)
    # Both rates stay equal as kappa grows, with r' = (1 - zeta' r)/(zeta - (1 - g)'(r)) of each
    # root. The last zeta of the bisection may be on either side.
    real = _real(excess, zeta)
    pair = _pair(excess, zeta * (1 - 1e-12))
    p = 1 / (zeta - complex(lack_slope(pair)))
    q = 1 / (zeta - lack_slope(real))
    return Critical(zeta, (p.real - q) / ((p * pair).real - q * real), False)
