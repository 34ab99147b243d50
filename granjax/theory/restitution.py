"""Coefficients of restitution of two colliding bodies in closed form."""

import jax.numpy as jnp

from ..base.checks import non_negative, positive
from ..base.types import Number, Parameter

# (4/5) B(3/5, 3/2) (5/4)^{3/5} with the beta function B
FIRST = 1.1534488581


def thornton(speed: Parameter, yield_speed: Parameter) -> Number:
    r"""Return the coefficient of restitution of elastic, perfectly plastic spheres.

        e = (6 sqrt3/5)^{1/2} (1 - r^2/6)^{1/2} [r/(r + 2 sqrt(6/5 - r^2/5))]^{1/4},   r = V_y/V,

    for V > V_y, else 1. It falls as V^{-1/4}.

    **Arguments:** `speed`: relative speed V of approach [m/s]; `yield_speed`: V_y [m/s], which is
    (4 A s_y^{5/2}/(5 m))^{1/2} for `gx.Thornton(A, s_y)` and a reduced mass m.

    Source: C. Thornton, J. Appl. Mech. 64, 383 (1997).

    **Example:**

    >>> e = gx.theory.restitution.thornton(np.array([0.5, 16.0]), 1.0)
    >>> print(e.round(4))
    [1.     0.5882]
    """
    speed = non_negative("speed", speed)
    yield_speed = positive("yield_speed", yield_speed)
    r = yield_speed / jnp.maximum(speed, yield_speed)
    inner = r / (r + 2 * jnp.sqrt((6 - r * r) / 5))
    return jnp.sqrt(6 * jnp.sqrt(3.0) / 5 * (1 - r * r / 6)) * inner**0.25


def viscoelastic(
    speed: Parameter,
    stiffness: Parameter,
    dissipative_time: Parameter,
    reduced_mass: Parameter = 0.5,
) -> Number:
    r"""Return the coefficient of restitution of weakly dissipative viscoelastic spheres.

        e = 1 - 1.15344 x + 0.79826 x^2,   x = (3/2) tau (A/m)^{2/5} V^{1/5}.

    It holds for Hertz with Kuwabara and Kono's `ViscousContact(3 A tau/2)`, up to 0.6 x^3.
    `BrilliantovContact(..., A, tau)`, which does not pull, separates faster by up to 0.03 x^2.

    **Arguments:** `speed`: V [m/s]; `stiffness`: A [N/m^{3/2}]; `dissipative_time`: tau [s];
    `reduced_mass`: m [kg], half the mass of each of two equal bodies.

    Source: R. Ramirez, T. Poeschel, N. V. Brilliantov, T. Schwager, Phys. Rev. E 60, 4465 (1999).

    **Example:**

    >>> round(float(gx.theory.restitution.viscoelastic(1.0, 1.0, 0.01)), 5)
    0.97748
    """
    speed = non_negative("speed", speed)
    stiffness = positive("stiffness", stiffness)
    time = non_negative("dissipative_time", dissipative_time)
    mass = positive("reduced_mass", reduced_mass)
    x = 1.5 * time * (stiffness / mass) ** 0.4 * speed**0.2
    return 1 - FIRST * x + 0.6 * (FIRST * x) ** 2
