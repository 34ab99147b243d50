"""A first shape of a wave of one peak, by iteration of the Fourier form."""

from collections.abc import Callable

import numpy as np

# points of the grid, decays in half of the box, most iterations, change at which one ends
POINTS, DECAYS, ITERATIONS, SETTLED = 1024, 40.0, 400, 1e-5


def decay_rate(ratio: float) -> float:
    """kappa > 0 of a tail exp(-kappa |xi|): sinh^2(kappa/2) = ratio (kappa/2)^2, ratio = m c^2/K2 > 1."""
    root = np.sqrt(ratio)
    x = np.sqrt(6 * (ratio - 1)) if ratio < 3 else min(np.log(4 * ratio), 600.0)
    for _ in range(100):
        with np.errstate(over="ignore"):
            # ln sinh(x)/x = ln root, by Newton in ln x
            value = (
                np.log(np.sinh(x) / x) - np.log(root)
                if x > 1e-3
                else x * x / 6 - np.log1p(ratio - 1) / 2
            )
            slope = 1 / np.tanh(x) - 1 / x if x > 1e-3 else x / 3
        step = value / slope
        x = max(x - step, x / 4)
        if abs(step) <= 1e-15 * x:
            break
    return 2 * x


@np.errstate(all="ignore")
def normalised(
    force: Callable, half: float, guess: Callable
) -> tuple[np.ndarray, np.ndarray, float, float]:
    """The shape whose peak is 1, its last change and its level: psi <- tent * f(psi), scaled to the peak."""
    x = (np.arange(POINTS) - POINTS // 2) * (2 * half / POINTS)
    box = np.sinc(np.fft.rfftfreq(POINTS, 2 * half / POINTS)) ** 2
    psi, change, level = guess(x), np.inf, np.nan
    for _ in range(ITERATIONS):
        new = np.maximum(np.fft.irfft(box * np.fft.rfft(force(psi)[0]), POINTS), 0.0)
        level = new.max()
        if not np.isfinite(level) or not level > 0:
            return x, psi, np.inf, np.nan
        change, psi = np.abs(new / level - psi).max(), new / level
        if change < SETTLED:
            break
    return x, psi, change, level
