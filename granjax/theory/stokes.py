r"""Stokes expansion of the periodic waves of a chain: m y_n'' = F(y_{n-1}) - 2 F(y_n) + F(y_{n+1}).

F = K2 y + K3 y^2 + K4 y^3 of the strain y_n = u_n - u_{n+1}, compression positive, about a mean strain: as
`granjax.laws.taylor(law, mean)` gives them. To the third order in the amplitude a of the first harmonic, with D =
4 sin^2(k/2) and theta = k n - omega t,

    y = y0 + a cos theta + y2 cos 2 theta + y3 cos 3 theta,
    y2 = (K3 a^2/(2 K2)) (4 - D)/D,   y3 = (K3 a y2 + K4 a^3/4) (3 - D)^2/(K2 D (6 - D)),
    omega^2 = (D/m) (K2 + 2 K3 y0 + K3 y2 + 3 K4 a^2/4).

At fixed length y0 = 0; at fixed force the mean force stays what it is at rest, y0 = -K3 a^2/(2 K2). What is left out is
of the order a^4 in the frequency and the strain, and small where a K3/K2 is small against k^2: longer waves are cnoidal
(`kdv.cnoidal`), and `granjax.travelling.periodic_wave` has all of them.

    K2, K3, K4 = gx.laws.taylor(gx.Hertz(precompression=1.0))
    wave = gx.theory.stokes.wave(3.0, 0.05, K2, K3, K4)

Source: G. B. Whitham, Linear and Nonlinear Waves (Wiley, 1974), chapter 13; for chains Y. A. Kosevich, Phys. Rev. B 47,
3138 (1993).
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from ..checks import one_of, parameter, positive, within
from ..printing import told
from ..types import Numbers, Parameter

__all__ = ["StokesWave", "wave"]


class StokesWave(NamedTuple):
    """A periodic wave to the third order, of the shape of what it was asked with.

    - `omega` [rad/s]; `shift`: omega less that of a linear wave, with its digits where it is small; `speed` omega/k
      [sites/s]; `wavelength` 2 pi/k [sites].
    - `mean_strain` y0 [m] beyond the one that K2, K3, K4 are taken at; `mean_force` beyond the force there, to a^2 [N].
    - `first` a, `second`, `third`: the harmonics [m].
    - `error`: estimated relative error of `shift`, from the size of the harmonics; it falls like a^2.

    **Example:**

    >>> wave = gx.theory.stokes.wave(np.pi / 2, 0.1, 1.5, 0.375, -0.0625)
    >>> round(float(wave.wavelength), 6), round(float(wave.omega), 5)
    (4.0, 1.73205)
    """

    omega: jax.Array
    shift: jax.Array
    speed: jax.Array
    wavelength: jax.Array
    mean_strain: jax.Array
    mean_force: jax.Array
    first: jax.Array
    second: jax.Array
    third: jax.Array
    error: jax.Array
    __repr__ = told

    def strain(self, theta: Parameter) -> Numbers:
        """y at phases theta = k n - omega t, which broadcast with the wave's numbers [m]."""
        theta = jnp.asarray(theta, float)
        waves = (
            self.first * jnp.cos(theta)
            + self.second * jnp.cos(2 * theta)
            + self.third * jnp.cos(3 * theta)
        )
        return self.mean_strain + waves


def wave(
    k: Parameter,
    amplitude: Parameter,
    K2: Parameter,
    K3: Parameter,
    K4: Parameter,
    mass: Parameter = 1.0,
    *,
    constraint: str = "length",
) -> StokesWave:
    """The periodic wave of a wave number and an amplitude, to the third order.

    **Arguments:**

    - `k`: wave number in (0, pi] [rad/site]; `amplitude`: a, of the first harmonic of the strain [m].
    - `K2` > 0, `K3`, `K4`, `mass` > 0: arrays that broadcast with them.
    - `constraint`: "length" or "force", what the ends of the chain hold.

    **Returns:** `StokesWave`, differentiable in every number, under `jax.jit` and `jax.vmap` too. **Raises** ValueError
    for a k outside of (0, pi], K2 or mass not above zero. Typical: Hertz with A = d0 = m = 1, k = pi: shift/(a^2/4)
    -0.153093 at fixed length, -0.459279 at fixed force.

    **Example:**

    >>> wave = gx.theory.stokes.wave(np.pi, 0.01, 1.5, 0.375, -0.0625, constraint="force")
    >>> round(float(wave.shift / (0.01**2 / 4)), 4)
    -0.4593
    """
    length = one_of("constraint", constraint, ("length", "force")) == "length"
    k = within(
        "k",
        k,
        0.0,
        float(jnp.pi),
        open_low=True,
        remedy="Others are the same wave, or its mirror image.",
    )
    a, K2, K3, K4, m = (
        check(name, x)
        for check, name, x in (
            (parameter, "amplitude", amplitude),
            (positive, "K2", K2),
            (parameter, "K3", K3),
            (parameter, "K4", K4),
            (positive, "mass", mass),
        )
    )
    return _wave(k, a, K2, K3, K4, m, jnp.asarray(length))


@jax.jit
def _wave(k, a, K2, K3, K4, m, length):
    k, a, K2, K3, K4, m = jnp.broadcast_arrays(k, a, K2, K3, K4, m)
    D = 4 * jnp.sin(k / 2) ** 2
    whole = K3 * a**2 / (2 * K2)
    mean = jnp.where(length, 0.0, -whole)
    second = whole / jnp.tan(k / 2) ** 2
    third = (K3 * a * second + K4 * a**3 / 4) * (3 - D) ** 2 / (K2 * D * (6 - D))
    linear = jnp.sqrt(D * K2 / m)
    grown = (2 * K3 * mean + K3 * second + 0.75 * K4 * a**2) / K2
    shift = linear * jnp.expm1(jnp.log1p(grown) / 2)
    omega, size = linear + shift, jnp.where(a == 0, 1.0, a)
    error = 2 * (
        (second / size) ** 2 + jnp.abs(third / size) + (K3 * a / K2) ** 2 + jnp.abs(K4 * a**2 / K2)
    )
    return StokesWave(
        omega, shift, omega / k, 2 * jnp.pi / k, mean, K2 * (mean + whole), a, second, third, error
    )
