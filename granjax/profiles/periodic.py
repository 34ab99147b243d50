"""Periodic waves: Newton's method on the Fourier form, on half of a wavelength."""

from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from ..checks import refuse
from ..laws import Law
from .medium import values
from .shape import Shape

# points on half of a wavelength; what two numbers of them may differ by; residual and steps of Newton's method
POINTS, AGREE, CONVERGED, STEPS = (32, 64, 128, 256, 512), 1e-13, 1e-9, 30
# growth of the amplitude from one wave to the next, most of them, and the first one over its scale
GROWTH, MOST, FIRST = 1.5, 60, 1e-2


class FourierShape(Shape):
    """phi = mean + sum a_k cos(k xi), v = sum b_k cos(k (xi - 1/2)); displacements fall by the mean a bead."""

    speed: jnp.ndarray
    mean: jnp.ndarray
    wavenumbers: jnp.ndarray
    strains: jnp.ndarray
    velocities: jnp.ndarray

    def strain(self, xi):
        xi = jnp.asarray(xi, float)
        return self.mean + jnp.cos(self.wavenumbers * xi[..., None]) @ self.strains

    def velocity(self, xi):
        xi = jnp.asarray(xi, float)
        return jnp.cos(self.wavenumbers * (xi[..., None] - 0.5)) @ self.velocities

    def displacement(self, xi):
        xi = jnp.asarray(xi, float)
        moved = jnp.sin(self.wavenumbers * (xi[..., None] - 0.5)) @ (
            self.velocities / self.wavenumbers
        )
        return -moved / self.speed - self.mean * xi


class Half(NamedTuple):
    """The Fourier form on the half of a wavelength: tent * f less its mean is `matrix` @ f."""

    places: np.ndarray
    matrix: np.ndarray
    wavenumbers: np.ndarray

    @classmethod
    def of(cls, wavelength: float, points: int) -> "Half":
        """With so many points from a crest to the next trough."""
        k = 2 * np.pi / wavelength * np.arange(points + 1)
        angle = np.pi / points * np.outer(np.arange(points + 1), np.arange(points + 1))
        weights = np.full(points + 1, 2.0 / points)
        weights[[0, -1]] /= 2
        halves = np.ones(points + 1)
        halves[-1] = 0.5
        tent = halves * np.sinc(k / (2 * np.pi)) ** 2
        tent[0] = 0
        return cls(
            np.linspace(0, wavelength / 2, points + 1),
            (np.cos(angle) * tent) @ (np.cos(angle) * weights),
            k,
        )

    def coefficients(self, f: np.ndarray) -> np.ndarray:
        """Of cos(k x), those of the constant left out."""
        points = len(f) - 1
        angle = np.pi / points * np.outer(np.arange(points + 1), np.arange(points + 1))
        weights = np.full(points + 1, 2.0 / points)
        weights[[0, -1]] /= 2
        found = (np.cos(angle) * weights) @ f
        found[-1] /= 2
        return found[1:]


class Train(NamedTuple):
    """A periodic wave: strains about the mean at the points, m c^2, residual, error, the half of a wavelength."""

    strains: np.ndarray
    level: float
    residual: float
    error: float
    half: Half


def newton(
    law: Law, mean: float, half: Half, psi: np.ndarray, level: float, amplitude: float | None
) -> tuple:
    """(strains about the mean, m c^2, residual over the amplitude): at that level, or at half of crest less trough."""
    residual = np.inf
    rest = values(law, np.array([mean]))[0][0]
    for _ in range(STEPS):
        F, slope, _ = values(law, mean + psi)
        gap = psi - half.matrix @ (F - rest) / level
        size = np.abs(psi).max()
        if not np.isfinite(gap).all() or not size > 0:
            return psi, level, np.inf
        jacobian = np.eye(len(psi)) - half.matrix * slope / level
        if amplitude is not None:
            top = np.zeros(len(psi))
            top[0], top[-1] = 0.5, -0.5
            jacobian = np.block([[jacobian, (psi - gap)[:, None]], [top[None], np.zeros((1, 1))]])
            gap = np.append(gap, top @ psi - amplitude)
        before, residual = residual, np.abs(gap).max() / size
        if residual < 1e-15 or residual < 1e-12 and residual > before / 2:
            break
        try:
            step = np.linalg.solve(jacobian, -gap)
        except np.linalg.LinAlgError:
            return psi, level, np.inf
        psi = psi + step[: len(psi)]
        level = level * np.exp(np.clip(step[len(psi) :].sum(), -0.5, 0.5))
    return psi, level, residual


def train(
    law: Law,
    mass: float,
    mean: float,
    wavelength: float,
    speed: float | None,
    amplitude: float | None,
) -> Train:
    """The wave of a length about a mean strain, at a speed or an amplitude, followed from small ones.

    **Raises** ValueError where the law has no stiffness at the mean, or the family does not come there.
    """
    stiffness = float(values(law, np.array([mean]))[1][0])
    if not 0 < stiffness < np.inf:
        refuse(
            "mean",
            "a strain at which the law is stiff",
            f"{mean:g}, where its stiffness is {stiffness:g}",
            "Without a precompression the mean strain has to close the contacts.",
        )
    half = Half.of(wavelength, POINTS[0])
    small = stiffness * np.sinc(1 / wavelength) ** 2
    if speed is None:
        psi, found = _to_amplitude(law, mean, half, small, amplitude)
    else:
        psi, found = _to_speed(law, mass, mean, half, small, speed)
    before, apart = None, np.inf
    for points in POINTS:
        finer = Half.of(wavelength, points)
        start = _moved(half, psi, finer)
        psi, found, residual = newton(law, mean, finer, start, found, amplitude)
        half = finer
        if before is not None:
            apart = float(np.abs(_moved(before[0], before[1], finer) - psi).max())
        if apart <= AGREE * np.abs(psi).max():
            break
        before = finer, psi
    if not residual < CONVERGED:
        refuse(
            "law",
            "one whose periodic wave is found",
            f"a residual of {residual:.1e} after Newton's method",
        )
    return Train(
        psi, float(found), float(residual), max(apart, 4e-16 * float(np.abs(psi).max())), half
    )


def _moved(half, psi, finer):
    """Strains at other points of the same half."""
    a = half.coefficients(psi)
    return np.cos(finer.places[:, None] * half.wavenumbers[1:]) @ a + (psi[0] - a.sum())


def _scale(law, mean, stiffness):
    """A strain over which the stiffness changes by much."""
    steps = 2.0 ** np.arange(-160, 161)
    slope = np.concatenate([values(law, mean + steps)[1], values(law, mean - steps)[1]]).reshape(
        2, -1
    )
    with np.errstate(invalid="ignore"):
        changed = ~(np.abs(slope / stiffness - 1) < 0.5).all(0)
    # below the rounding of the mean nothing is known
    changed &= steps > 1e-9 * abs(mean)
    if not changed.any():
        refuse(
            "law",
            "one that is not linear",
            "one whose waves have one speed",
            "gx.linear tells their frequencies.",
        )
    return float(steps[np.argmax(changed)])


def _family(law, mean, half, level) -> Callable:
    """A function (amplitude, wave before) -> wave; the first is a cosine."""
    psi = np.cos(2 * np.pi * half.places / (2 * half.places[-1]))

    def step(amplitude, before):
        shape, at = (
            (psi * amplitude, level)
            if before is None
            else (before[0] * amplitude / before[2], before[1])
        )
        found, at, residual = newton(law, mean, half, shape, at, amplitude)
        return (found, at, amplitude) if residual < 1e-6 else None

    return step


def _to_amplitude(law, mean, half, level, amplitude):
    step = _family(law, mean, half, level)
    now, wave = (
        min(amplitude, FIRST * _scale(law, mean, level / np.sinc(0.5 / half.places[-1]) ** 2)),
        None,
    )
    for _ in range(MOST):
        new = step(now, wave)
        if new is None:
            break
        wave = new
        if now == amplitude:
            return wave[0], wave[1]
        now = min(amplitude, now * GROWTH)
    reached = 0.0 if wave is None else wave[2]
    refuse(
        "amplitude",
        f"one that the family reaches, up to about {reached:.3g}",
        f"{amplitude:g}",
        "Beyond, contacts may open within the wave.",
    )


def _to_speed(law, mass, mean, half, level, speed):
    step, wanted = _family(law, mean, half, level), mass * speed**2
    now, wave = FIRST * _scale(law, mean, level / np.sinc(0.5 / half.places[-1]) ** 2), None
    low = None
    for _ in range(MOST):
        new = step(now, wave)
        if new is None:
            break
        if (new[1] - wanted) * (level - wanted) <= 0:
            return _between(step, low, new, level, wanted)
        if wave is not None and abs(new[1] - wanted) > abs(wave[1] - wanted):
            break
        low, wave, now = new, new, now * GROWTH
    small, last = np.sqrt(level / mass), np.sqrt((wave or (0, level))[1] / mass)
    refuse(
        "speed",
        f"one {'above' if last >= small else 'below'} that of small waves of this length, {small:.6g}, "
        "as far as their family goes",
        f"{speed:g}",
        "Amplitudes say which it has: amplitude=...",
    )


def _between(step, low, high, level, wanted):
    """By secants in the square of the amplitude."""
    a, b = (0.0, level) if low is None else (low[2] ** 2, low[1])
    for _ in range(60):
        square = a + (wanted - b) * (high[2] ** 2 - a) / (high[1] - b)
        new = step(np.sqrt(square), high)
        if new is None or abs(new[1] / wanted - 1) < 1e-6:
            break
        if (new[1] - wanted) * (b - wanted) > 0:
            a, b = new[2] ** 2, new[1]
        else:
            high = new
    new = high if new is None else new
    return new[0], wanted
