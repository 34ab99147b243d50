"""Laws that never open: polynomial (FPUT), Toda, linear, sine."""

import jax
import jax.numpy as jnp

from ..base.checks import parameter, plain_zero, positive, refuse
from ..base.types import Parameter
from .base import Law


def _optional(name, x):
    return None if plain_zero(x) else parameter(name, x)


class Polynomial(Law):
    r"""Fermi-Pasta-Ulam-Tsingou law: F(e) = K2 e + K3 e^2 + K4 e^3.

    Energy K2 e^2/2 + K3 e^3/3 + K4 e^4/4. **Arguments:** `K2`, `K3`, `K4`: scalars or one per bond;
    a plain 0 omits the term. Compression is positive, so K3 > 0 stiffens under compression, as
    Hertz does.

    Typical: alpha chain K2 = 1, K3 = 1/4; beta chain K2 = 1, K4 = 1. **Raises** ValueError for
    values not finite. Source: Fermi, Pasta, Ulam (with Tsingou), Los Alamos report LA-1940 (1955).

    **Example:**

    >>> law = gx.Polynomial(K2=1.0, K3=0.25)
    >>> law.force(jnp.array([-1.0, 1.0]))
    Array([-0.75,  1.25], dtype=float64)
    """

    opens = False
    dimensions = {"K2": (1, -1, 0), "K3": (1, -2, 0), "K4": (1, -3, 0)}
    K2: jax.Array | None
    K3: jax.Array | None
    K4: jax.Array | None

    def __init__(self, K2: Parameter = 1.0, K3: Parameter = 0.0, K4: Parameter = 0.0):
        self.K2 = _optional("K2", K2)
        self.K3 = _optional("K3", K3)
        self.K4 = _optional("K4", K4)
        if self.K2 is None and self.K3 is None and self.K4 is None:
            refuse(
                "K2, K3, K4",
                "at least one coefficient that is not zero",
                "0, 0, 0",
                "Leave the bond out instead.",
            )

    def _horner(self, e, divisors):
        value = None
        for K, divisor in zip((self.K4, self.K3, self.K2), divisors):
            value = None if value is None else value * e
            if K is not None:
                K = K if divisor == 1 else K / divisor
                value = K if value is None else value + K
        return value

    @property
    def powers(self):
        return {k: K for k, K in enumerate((self.K2, self.K3, self.K4), 1) if K is not None}

    def force(self, e):
        return self._horner(e, (1, 1, 1)) * e

    def energy(self, e):
        return self._horner(e, (4, 3, 2)) * e * e


class Toda(Law):
    r"""Toda lattice: F(e) = a (exp(b e) - 1), preload a; energy a ((exp(b e) - 1)/b - e).

    **Arguments:** `strength`: a > 0; `rate`: b > 0. With a = b = 1 and unit masses
    u_n'' = exp(u_{n-1} - u_n) - exp(u_n - u_{n+1}). **Raises** ValueError for a, b not positive.
    Source: M. Toda, J. Phys. Soc. Jpn. 22, 431 (1967).

    **Example:**

    >>> gx.laws.taylor(gx.Toda(strength=1.0, rate=1.0))
    Taylor(K2=1, K3=0.5, K4=0.166667)
    """

    opens = False
    dimensions = {"strength": (1, 0, 0), "rate": (0, -1, 0)}
    strength: jax.Array
    rate: jax.Array

    def __init__(self, strength: Parameter = 1.0, rate: Parameter = 1.0):
        self.strength = positive("strength", strength)
        self.rate = positive("rate", rate)

    @property
    def preload(self):
        return self.strength

    def force(self, e):
        return self.strength * jnp.expm1(self.rate * e)

    def energy(self, e):
        x = self.rate * e
        series = (
            x * x * (1 / 2 + x * (1 / 6 + x * (1 / 24 + x * (1 / 120 + x * (1 / 720 + x / 5040)))))
        )
        return self.strength / self.rate * jnp.where(jnp.abs(x) < 0.02, series, jnp.expm1(x) - x)


class Linear(Law):
    """Linear spring: F(e) = K e, energy K e^2/2.

    **Arguments:** `stiffness`: K [N/m]; a negative K is allowed, as an inverted site potential.
    **Raises** ValueError for values not finite.

    **Example:**

    >>> chain = gx.Lattice(1.0, gx.Bond(gx.Shift(1, "periodic"), gx.Linear(4.0)), sites=20)
    >>> round(float(gx.linear.sound_speed(chain)), 4)
    2.0
    """

    opens = False
    dimensions = {"stiffness": (1, -1, 0)}
    is_linear = True
    stiffness: jax.Array

    def __init__(self, stiffness: Parameter = 1.0):
        self.stiffness = parameter("stiffness", stiffness)

    @property
    def powers(self):
        return {1: self.stiffness}

    def force(self, e):
        return self.stiffness * e

    def energy(self, e):
        return self.stiffness / 2 * e * e


class Sine(Law):
    """Sine law, usually on-site (sine-Gordon, Frenkel-Kontorova, pendula): F(u) = (K/q) sin(q u).

    Energy (2K/q^2) sin^2(q u/2). **Arguments:** `stiffness`: K, the linear stiffness; `wavenumber`:
    q > 0; the potential has period 2 pi/q. Typical: K = q = 1. **Raises** ValueError for values not
    finite, q <= 0.

    **Example:**

    >>> law = gx.Sine(stiffness=1.0, wavenumber=1.0)
    >>> round(float(law.force(jnp.pi / 2)), 4), round(float(law.energy(jnp.pi)), 4)
    (1.0, 2.0)
    """

    opens = False
    dimensions = {"stiffness": (1, -1, 0), "wavenumber": (0, -1, 0)}
    stiffness: jax.Array
    wavenumber: jax.Array

    def __init__(self, stiffness: Parameter = 1.0, wavenumber: Parameter = 1.0):
        self.stiffness = parameter("stiffness", stiffness)
        self.wavenumber = positive("wavenumber", wavenumber)

    def force(self, e):
        return self.stiffness / self.wavenumber * jnp.sin(self.wavenumber * e)

    def energy(self, e):
        half = jnp.sin(self.wavenumber * e / 2) / self.wavenumber
        return 2 * self.stiffness * half * half
