"""The shape of a solitary wave as a function of place: strain, velocity and displacement at any xi = n - c t."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..checks import traced
from ..laws import Law
from ..programs import shared_size
from ..types import Numbers
from .medium import fine_force
from .tent import RULE

# places evaluated in one program
PLACES = 4096
_T, _W = np.polynomial.legendre.leggauss(12)


class Shape(eqx.Module):
    """What a wave knows of itself at any place: functions of xi = n - c t, elementwise, that JAX may trace.

    A shape writes `strain(xi)`, the compression [m] of contact n, between the beads n and n + 1; `velocity(xi)` [m/s]
    and `displacement(xi)` [m] of bead n, which is at rest far ahead of the wave (xi -> infinity).
    """

    def at(self, name: str, xi: Any) -> Numbers:
        """One of them at many places: by a program of few sizes, or within the one that traces it."""
        if traced((self, xi)):
            return _evaluated(self, name, jnp.asarray(xi, float))
        xi = np.asarray(xi, float)
        flat, parts = xi.ravel(), []
        for begin in range(0, max(flat.size, 1), PLACES):
            part = flat[begin : begin + PLACES]
            padded = np.zeros(shared_size(max(part.size, 1)))
            padded[: part.size] = part
            parts.append(np.asarray(_evaluated(self, name, jax.device_put(padded)))[: part.size])
        return jax.device_put(np.concatenate(parts).reshape(xi.shape))


@eqx.filter_jit
def _evaluated(shape, name, xi):
    return getattr(shape, name)(xi)


class TentShape(Shape):
    r"""A wave of one sign, even in xi: ln(strain/unit) by a polynomial on each cell, with a straight line beyond.

    m c v(xi) = int_{xi-1}^{xi} F(phi),  m c^2 u(xi) = int min(1, y + 1 - xi)_+ F(phi(y)) dy: positive terms alone.
    """

    law: Law
    mass: Any
    speed: Any
    unit: Any
    coefficients: Any
    length: Any
    decay: Any
    edges: Any

    @classmethod
    def of(
        cls, law: Law, mass: Any, speed: Any, unit: Any, coefficients: Any, length: Any, decay: Any
    ) -> "TentShape":
        """With the integral of the force beyond every cell's beginning."""
        count = coefficients.shape[0]
        plain = cls(law, mass, speed, unit, coefficients, length, decay, None)
        y = length * (np.arange(count)[:, None] + (1 + _T) / 2)
        parts = length / 2 * (plain._force(y) @ jnp.asarray(_W))
        beyond = jnp.where(
            decay > 0,
            plain._force(jnp.asarray(length * count)) / jnp.where(decay > 0, decay, 1),
            0.0,
        )
        edges = jnp.append(jnp.cumsum(parts[::-1])[::-1] + beyond, beyond)
        return eqx.tree_at(lambda s: s.edges, plain, edges, is_leaf=lambda x: x is None)

    @property
    def end(self) -> Numbers:
        """Where the last cell ends."""
        return self.length * self.coefficients.shape[0]

    def strain(self, xi):
        x = jnp.abs(jnp.asarray(xi, float))
        k, t, beyond = self._cell(x)
        rows = self.coefficients[k]
        b, c = jnp.zeros_like(x), jnp.zeros_like(x)
        for j in range(rows.shape[-1] - 1, 0, -1):
            b, c = rows[..., j] + 2 * t * b - c, b
        return self.unit * jnp.exp(rows[..., 0] + t * b - c - self.decay * beyond)

    def velocity(self, xi):
        xi = jnp.asarray(xi, float)
        # even about the middle between two contacts
        x = jnp.maximum(xi, 1 - xi)
        s, w = RULE
        return self._force(x[..., None] - 1 + s) @ jnp.asarray(w) / (self.mass * self.speed)

    def displacement(self, xi):
        xi = jnp.asarray(xi, float)
        s, w = RULE
        ahead = jnp.maximum(xi, 1 - xi)
        ramp = self._force(ahead[..., None] - 1 + s)
        # of the interval before xi, from its far end or, behind the wave, from its near one
        ramp = jnp.where(xi >= 0.5, ramp @ jnp.asarray(w * s), ramp @ jnp.asarray(w * (1 - s)))
        beyond = self._beyond(jnp.abs(xi))
        return (ramp + jnp.where(xi >= 0, beyond, 2 * self.edges[0] - beyond)) / (
            self.mass * self.speed**2
        )

    def _cell(self, x):
        inside = jnp.minimum(x, self.end)
        k = jnp.clip((inside / self.length).astype(int), 0, self.coefficients.shape[0] - 1)
        return k, 2 * (inside / self.length - k) - 1, jnp.maximum(x - self.end, 0.0)

    def _force(self, y):
        return fine_force(self.law, self.strain(y))

    def _beyond(self, x):
        """int_x^infinity F(phi), x >= 0."""
        k, _, past = self._cell(x)
        low = jnp.minimum(x, self.end)
        half = (self.length * (k + 1) - low) / 2
        part = half * (self._force(low[..., None] + half[..., None] * (1 + _T)) @ jnp.asarray(_W))
        return (self.edges[k + 1] + part) * jnp.exp(-self.decay * past)
