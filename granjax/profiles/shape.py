"""The shape of a wave as functions of xi = n - c t: strain, velocity and displacement."""

from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..base.checks import traced
from ..base.programs import compiled, shared_size
from ..base.types import Numbers
from ..laws import Law
from .medium import fine_force, in_chunks
from .tent import RULE

# The number of places that one program evaluates.
PLACES = 4096
_T, _W = np.polynomial.legendre.leggauss(12)


class Shape(eqx.Module):
    """A wave as traceable elementwise functions of xi = n - c t.

    A subclass defines `strain(xi)`, the compression [m] of contact n, between the beads n and n +
    1; and `velocity(xi)` [m/s] and `displacement(xi)` [m] of bead n, which is at rest far ahead (xi
    -> infinity).
    """

    def at(self, name: str, xi: Any) -> Numbers:
        """Evaluate one of the functions at many places, with compiled programs of few sizes."""
        if traced((self, xi)):
            return _evaluated((self, name), jnp.asarray(xi, float))[0]
        xi = np.asarray(xi, float)
        size = min(shared_size(max(xi.size, 1)), PLACES)
        return jax.device_put(in_chunks(_evaluated, (self, name), xi, size)[0])


@compiled
def _evaluated(given, xi):
    shape, name = given
    return (getattr(shape, name)(xi),)


class ContactShape(Shape):
    r"""A wave whose strain is a polynomial on each of `rows.shape[1]` cells, from `first` on.

    With F the force less that ahead, m c v(xi) = int_{xi-1}^{xi} F(phi) and m c^2 u(xi) = int
    min(1, y + 1 - xi)_+ F(phi(y)) dy.
    """

    law: Law
    mass: Any
    speed: Any
    rows: Any
    length: Any
    # The integral of the force from the start of every cell on, and from the end of the last one
    # on.
    edges: Any = eqx.field(default=None, kw_only=True)

    @property
    def end(self) -> Any:
        """The end of the last cell."""
        return self.first + self.length * self.rows.shape[1]

    def over(self, x: Any) -> Any:
        """Return the strain less that ahead."""
        raise NotImplementedError

    def strain(self, xi):
        return self.over(jnp.asarray(xi, float))

    def velocity(self, xi):
        s, w = RULE
        return self.force(xi[..., None] - 1 + s) @ jnp.asarray(w) / (self.mass * self.speed)

    def displacement(self, xi):
        s, w = RULE
        pushed = self.force(xi[..., None] - 1 + s) @ jnp.asarray(w * s) + self.beyond(xi)
        return pushed / (self.mass * self.speed**2)

    def force(self, x: Any) -> Any:
        """Return the force less that ahead."""
        return fine_force(self.law, self.over(x))

    def with_edges(self, beyond: Any) -> "ContactShape":
        """Return the shape with its edges, from the integral of the force beyond the last cell."""
        count = self.rows.shape[1]
        y = self.first + self.length * (np.arange(count)[:, None] + (1 + _T) / 2)
        parts = self.length / 2 * (self.force(y) @ jnp.asarray(_W))
        edges = jnp.append(jnp.cumsum(parts[::-1])[::-1] + beyond, beyond)
        return eqx.tree_at(lambda s: s.edges, self, edges, is_leaf=lambda x: x is None)

    def cell(self, x: Any) -> tuple[Any, Any]:
        """Return the cell of a place, or the nearest one, and the position in it from -1 to 1."""
        at = (jnp.clip(x, self.first, self.end) - self.first) / self.length
        k = jnp.clip(at.astype(int), 0, self.rows.shape[1] - 1)
        return k, 2 * (at - k) - 1

    def beyond(self, x: Any) -> Any:
        """Return the integral of the force from a place on."""
        low = jnp.clip(x, self.first, self.end)
        k = self.cell(x)[0]
        half = (self.first + self.length * (k + 1) - low) / 2
        inner = self.force(low[..., None] + half[..., None] * (1 + _T))
        return self.edges[k + 1] + half * (inner @ jnp.asarray(_W))


class TentShape(ContactShape):
    """An even wave of one sign: ln(strain/unit) in Chebyshev polynomials, with a linear tail.

    All integrals have only positive terms.
    """

    unit: Any
    decay: Any
    first: ClassVar = 0.0

    def with_tail(self) -> "TentShape":
        """Return the shape with its edges."""
        decay = jnp.where(self.decay > 0, self.decay, 1)
        return self.with_edges(jnp.where(self.decay > 0, self.force(self.end) / decay, 0.0))

    def over(self, x):
        x = jnp.abs(x)
        k, t = self.cell(x)
        b = jnp.zeros_like(x)
        c = jnp.zeros_like(x)
        for row in self.rows[:0:-1]:
            b, c = row[k] + 2 * t * b - c, b
        past = jnp.maximum(x - self.end, 0.0)
        return self.unit * jnp.exp(self.rows[0][k] + t * b - c - self.decay * past)

    def velocity(self, xi):
        # The velocity is even about the middle between two contacts.
        return super().velocity(jnp.maximum(xi, 1 - xi))

    def displacement(self, xi):
        # The displacement is odd about there, up to a constant.
        ahead = super().displacement(jnp.maximum(xi, 1 - xi))
        return jnp.where(xi >= 0.5, ahead, 2 * self.edges[0] / (self.mass * self.speed**2) - ahead)

    def beyond(self, x):
        return super().beyond(x) * jnp.exp(-self.decay * jnp.maximum(x - self.end, 0.0))
