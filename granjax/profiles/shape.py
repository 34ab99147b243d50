"""The shape of a solitary wave as a function of place: strain, velocity and displacement at any xi = n - c t."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..checks import traced
from ..laws import Law
from ..programs import compiled, shared_size
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


@compiled
def _evaluated(shape, name, xi):
    return getattr(shape, name)(xi)


class ContactShape(Shape):
    r"""A wave whose strain is a polynomial on each of `rows.shape[1]` cells, `length` long, from a place `first` on.

    With F the force beyond that ahead, m c v(xi) = int_{xi-1}^{xi} F(phi) and m c^2 u(xi) = int min(1, y + 1 - xi)_+
    F(phi(y)) dy.
    """

    law: eqx.AbstractVar[Law]
    mass: eqx.AbstractVar[Any]
    speed: eqx.AbstractVar[Any]
    rows: eqx.AbstractVar[Any]
    first: eqx.AbstractVar[Any]
    length: eqx.AbstractVar[Any]
    # the integral of the force beyond the beginning of every cell and the end of the last one
    edges: eqx.AbstractVar[Any]

    @property
    def end(self) -> Any:
        """Where the last cell ends."""
        return self.first + self.length * self.rows.shape[1]

    def over(self, x: Any) -> Any:
        """The strain beyond that ahead."""
        raise NotImplementedError

    def strain(self, xi):
        return self.over(jnp.asarray(xi, float))

    def velocity(self, xi):
        xi = jnp.asarray(xi, float)
        return (
            self.force(xi[..., None] - 1 + RULE[0])
            @ jnp.asarray(RULE[1])
            / (self.mass * self.speed)
        )

    def displacement(self, xi):
        xi, (s, w) = jnp.asarray(xi, float), RULE
        pushed = self.force(xi[..., None] - 1 + s) @ jnp.asarray(w * s) + self.beyond(xi)
        return pushed / (self.mass * self.speed**2)

    def force(self, x: Any) -> Any:
        """The force beyond that ahead."""
        return fine_force(self.law, self.over(x))

    def with_edges(self, beyond: Any) -> "ContactShape":
        """The shape with its edges, from the integral of the force beyond the last cell."""
        count = self.rows.shape[1]
        y = self.first + self.length * (np.arange(count)[:, None] + (1 + _T) / 2)
        parts = self.length / 2 * (self.force(y) @ jnp.asarray(_W))
        edges = jnp.append(jnp.cumsum(parts[::-1])[::-1] + beyond, beyond)
        return eqx.tree_at(lambda s: s.edges, self, edges, is_leaf=lambda x: x is None)

    def cell(self, x: Any) -> tuple[Any, Any]:
        """The cell of a place, the nearest one of places beyond, and where in it from -1 to 1."""
        at = (jnp.clip(x, self.first, self.end) - self.first) / self.length
        k = jnp.clip(at.astype(int), 0, self.rows.shape[1] - 1)
        return k, 2 * (at - k) - 1

    def beyond(self, x: Any) -> Any:
        """The integral of the force from a place on, from cell to cell."""
        low = jnp.clip(x, self.first, self.end)
        k = self.cell(x)[0]
        half = (self.first + self.length * (k + 1) - low) / 2
        inner = self.force(low[..., None] + half[..., None] * (1 + _T))
        return self.edges[k + 1] + half * (inner @ jnp.asarray(_W))


class TentShape(ContactShape):
    """A wave of one sign, even in xi: ln(strain/unit) by Chebyshev's polynomials, with a straight line beyond.

    All integrals have positive terms alone.
    """

    law: Law
    mass: Any
    speed: Any
    rows: Any
    length: Any
    unit: Any
    decay: Any
    edges: Any = None

    @property
    def first(self):
        return 0.0

    def with_tail(self) -> "TentShape":
        """The shape with its edges."""
        decay = jnp.where(self.decay > 0, self.decay, 1)
        return self.with_edges(jnp.where(self.decay > 0, self.force(self.end) / decay, 0.0))

    def over(self, x):
        x = jnp.abs(x)
        k, t = self.cell(x)
        b, c = jnp.zeros_like(x), jnp.zeros_like(x)
        for row in self.rows[:0:-1]:
            b, c = row[k] + 2 * t * b - c, b
        past = jnp.maximum(x - self.end, 0.0)
        return self.unit * jnp.exp(self.rows[0][k] + t * b - c - self.decay * past)

    def velocity(self, xi):
        # even about the middle between two contacts
        return super().velocity(jnp.maximum(xi, 1 - xi))

    def displacement(self, xi):
        # odd about there
        ahead = super().displacement(jnp.maximum(xi, 1 - xi))
        return jnp.where(xi >= 0.5, ahead, 2 * self.edges[0] / (self.mass * self.speed**2) - ahead)

    def beyond(self, x):
        return super().beyond(x) * jnp.exp(-self.decay * jnp.maximum(x - self.end, 0.0))
