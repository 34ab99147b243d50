"""The solitary wave of the Hertz chain without precompression."""

import numpy as np
from jaxtyping import Float

from ..checks import held_in_memory, whole
from ..entry import checked
from ..types import Count

HALF = 16
ITERATIONS = 100


@checked
def hertz_wave(points: Count = 32) -> tuple[Float[np.ndarray, " X"], Float[np.ndarray, " X"], Float[np.ndarray, " X"]]:
    r"""Strain of the Hertz chain's solitary wave of speed 1 (A = m = 1) on a grid of so many points per contact.

    phi = Lambda * phi^{3/2}, Lambda(x) = [1 - |x|]_+. The product sinc^2(k/2) in place of the convolution is exact to
    rounding, as phi is smooth. The plain iteration diverges (its eigenvalue along the amplitude is 3/2);
    Petviashvili's factor S^3, S = <phi, phi>/<phi, g>, makes it converge.

    **Returns:** places (X,), strain (X,), and velocity (X,): v(x) = int_{x-1}^x phi^{3/2}, that of bead n at x = n - t
    where contact n lies between the beads n and n + 1.
    Source: English, Pego, Proc. AMS 133, 1763 (2005); Petviashvili, Sov. J. Plasma Phys. 2, 257 (1976).
    """
    points = whole("points", points, 2)
    held_in_memory("points", points, 2 * HALF * 64, "points per contact")
    size = 2 * HALF * points
    x = (np.arange(size) - size // 2) / points
    k = 2 * np.pi * np.fft.rfftfreq(size, 1 / points)
    box = np.sinc(k / (2 * np.pi))
    phi = np.where(np.abs(x) < 2.5, 25 / 16 * np.cos(np.clip(np.sqrt(0.4) * x, -np.pi / 2, np.pi / 2)) ** 4, 0.0)
    for _ in range(ITERATIONS):
        g = np.maximum(np.fft.irfft(box**2 * np.fft.rfft(phi**1.5), size), 0.0)
        phi = (phi @ phi / (phi @ g)) ** 3 * g
    # e^{-ik/2} sinc(k/2): the mean over the unit interval before x
    velocity = np.fft.irfft(box * np.exp(-0.5j * k) * np.fft.rfft(phi**1.5), size)
    return x, phi, velocity
