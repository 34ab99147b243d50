"""Dense output of one step from its ends."""

import diffrax
import jax
import jax.numpy as jnp


class QuinticHermite(diffrax.AbstractLocalInterpolation):
    r"""Displacement between the ends of a step as the quintic through u, v, a at both; velocity as its derivative.

    With s = (t - t0)/h: error h^6 u^(6)/46080 in the middle, zero to second order at the ends.
    `y0`, `y1`: states (u, v); `a0`, `a1`: accelerations, of the structure of u.
    """

    t0: object
    t1: object
    y0: object
    y1: object
    a0: object
    a1: object

    def evaluate(self, t0, t1=None, left=True):
        if t1 is not None:
            return jax.tree.map(jnp.subtract, self.evaluate(t1), self.evaluate(t0))
        h = self.t1 - self.t0
        s = (t0 - self.t0) / jnp.where(h == 0, 1, h)
        (u0, v0), (u1, v1) = self.y0, self.y1

        def displacement(u0, v0, a0, u1, v1, a1):
            return u0 + _horner(s, _quintic(h, u0, v0, a0, u1, v1, a1)).astype(u0.dtype)

        def velocity(u0, v0, a0, u1, v1, a1):
            coefficients = _quintic(h, u0, v0, a0, u1, v1, a1)
            slope = _horner(s, [k * c for k, c in enumerate(coefficients)][1:])
            return (slope / jnp.where(h == 0, 1, h)).astype(u0.dtype)

        ends = (u0, v0, self.a0, u1, v1, self.a1)
        u, v = jax.tree.map(displacement, *ends), jax.tree.map(velocity, *ends)
        return type(self.y0)(u, v) if hasattr(self.y0, "_fields") else type(self.y0)((u, v))


def _quintic(h, u0, v0, a0, u1, v1, a1):
    """Coefficients of s, ..., s^5 of u(s) - u0, preceded by a zero."""
    rise, hv0, hv1, q0, q1 = u1 - u0, h * v0, h * v1, h * h * a0 / 2, h * h * a1 / 2
    return (
        jnp.zeros_like(u0), hv0, q0,
        10 * rise - 6 * hv0 - 4 * hv1 - 3 * q0 + q1,
        -15 * rise + 8 * hv0 + 7 * hv1 + 3 * q0 - 2 * q1,
        6 * rise - 3 * (hv0 + hv1) - q0 + q1,
    )


def _horner(s, coefficients):
    value = coefficients[-1]
    for c in reversed(coefficients[:-1]):
        value = value * s + c
    return value
