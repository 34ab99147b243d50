"""A first shape of a wave, by iteration of the Fourier form: of one peak, or of one level by Petviashvili's factor."""

from collections.abc import Callable

import numpy as np

# points of the grid, decays in half of the box, most iterations, change at which one ends
POINTS, DECAYS, ITERATIONS, SETTLED = 1024, 40.0, 400, 1e-5
# change at which Petviashvili's iteration has gone astray
ASTRAY = 1e-2
# the least exponent that a factor is computed for
LEAST = 1.02


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
def petviashvili(
    force: Callable,
    linear: float,
    half: float,
    guess: Callable,
    points: int = POINTS,
    inertia: Callable | None = None,
) -> tuple[np.ndarray, np.ndarray, float]:
    """The shape of a wave whose level is 1: psi = tent * f(psi), by the Fourier form.

    (1 - linear sinc^2) psi = sinc^2 N(psi), N = f - linear psi, iterated with the factor S^gamma, gamma = p/(p - 1), p
    the exponent by which N grows at present. `force(psi)`: f and its slope. `half`: half the length of the box.
    `inertia(k)`: mass that a site has at each wave number, which divides sinc^2; `None` is 1.
    """
    x = (np.arange(points) - points // 2) * (2 * half / points)
    turns = np.fft.rfftfreq(points, 2 * half / points)
    box = np.sinc(turns) ** 2
    if inertia is not None:
        # where the inertia vanishes, so does sinc^2, and faster
        box = np.nan_to_num(box / inertia(2 * np.pi * turns), posinf=0.0)
    psi, change = guess(x), np.inf
    for _ in range(ITERATIONS):
        f, slope = force(psi)
        N, grows = f - linear * psi, (slope - linear) * psi
        hat = np.fft.rfft(np.stack([psi, N, grows]), axis=1)
        pull = np.fft.irfft(box * hat[1], points)
        exponent = max((psi @ np.fft.irfft(box * hat[2], points)) / (psi @ pull), LEAST)
        size = psi @ np.fft.irfft((1 - linear * box) * hat[0], points) / (psi @ pull)
        new = size ** (exponent / (exponent - 1)) * np.fft.irfft(
            box * hat[1] / (1 - linear * box), points
        )
        new = np.maximum(new, 0.0)
        if not np.isfinite(new).all() or not new.any():
            return x, psi, np.inf
        change, psi = np.abs(new - psi).max() / np.abs(new).max(), new
        if change < SETTLED:
            break
    return x, psi, change


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
