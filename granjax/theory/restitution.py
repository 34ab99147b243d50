"""Coefficients of restitution of two bodies that collide, in closed form."""

import jax.numpy as jnp

from ..checks import non_negative, positive
from ..entry import checked
from ..types import Number, Parameter


@checked
def walton_braun(loading: Parameter, unloading: Parameter) -> Number:
    """e = sqrt(k1/k2), at every speed. Source: O. R. Walton, R. L. Braun, J. Rheol. 30, 949 (1986)."""
    return jnp.sqrt(positive("loading", loading) / positive("unloading", unloading))


@checked
def thornton(speed: Parameter, yield_speed: Parameter) -> Number:
    r"""Of elastic, perfectly plastic spheres, with r = V_y/V.

        e = (6 sqrt3/5)^{1/2} (1 - r^2/6)^{1/2} [r/(r + 2 sqrt(6/5 - r^2/5))]^{1/4}   for V > V_y, else 1.

    **Arguments:** `speed`: relative speed V of approach [m/s]; `yield_speed`: V_y [m/s], (4 A s_y^{5/2}/(5 m))^{1/2}
    of `gx.Thornton(A, s_y)` and a reduced mass m. Falls as V^{-1/4}. Source: C. Thornton, J. Appl. Mech. 64, 383
    (1997).
    """
    speed, yield_speed = non_negative("speed", speed), positive("yield_speed", yield_speed)
    r = yield_speed / jnp.maximum(speed, yield_speed)
    inner = r / (r + 2 * jnp.sqrt((6 - r * r) / 5))
    return jnp.sqrt(6 * jnp.sqrt(3.0) / 5 * (1 - r * r / 6)) * inner**0.25
