"""The tent integral for the logarithm of a wave of one sign, accurate to the last digit everywhere.

phi(x) = int (1 - |z|) F(phi(x - z)) dz/(m c^2) has only positive terms, so its relative error is
that of its input. With q = ln(phi/peak) on equidistant places, tails that fall as exp(-exp(x)) are
as accurate as the peak.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
import scipy

from .damped import damped

# The number of places of an interpolation.
STENCIL = 12
# The number of nodes on a piece of the tent.
PIECE = 12
# The ends of the pieces of either side, finer towards the side from which the wave comes.
PIECES = (0.0, 1 / 32, 1 / 16, 1 / 8, 1 / 4, 3 / 8, 1 / 2, 5 / 8, 3 / 4, 7 / 8, 1.0)
# ln of the least strain over its peak that a number can hold.
LEAST = -690.0
# The residual of Newton's method at which rounding may be reached.
ENOUGH = 1e-12
# The most iterations for a first shape.
ITERATIONS = 400
# The change, over the peak, below which it has settled.
STEADY = 1e-5
# The weights of barycentric interpolation at equidistant places.
_BARY = np.array(
    [1 / np.prod(np.delete(k - np.arange(STENCIL), k), dtype=float) for k in range(STENCIL)]
)


def rule(pieces: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return Gauss nodes and weights on (0, 1], `PIECE` on each piece between the given ends."""
    t, w = np.polynomial.legendre.leggauss(PIECE)
    ends = list(zip(pieces[:-1], pieces[1:]))
    return (
        np.concatenate([a + (b - a) * (1 + t) / 2 for a, b in ends]),
        np.concatenate([(b - a) * w / 2 for a, b in ends]),
    )


RULE = rule(PIECES)


class Places(NamedTuple):
    """Equidistant places from 0 on of an even function, whose slope beyond the last one is -decay.

    In between it is the polynomial through the nearest places, one-sided at the end.
    """

    count: int
    apart: float
    decay: float

    @property
    def end(self) -> float:
        """The last place."""
        return (self.count - 1) * self.apart

    @property
    def nodes(self) -> np.ndarray:
        """The places (I,)."""
        return self.apart * np.arange(self.count)

    @property
    def weights(self) -> Any:
        """The weights (I,) of an integral over an even function from 0 to the end."""
        return self.apart * np.append(0.5, np.ones(self.count - 1))

    def _rows(self, inside):
        first = np.minimum(inside.astype(int), self.count - 2) - (STENCIL // 2 - 1)
        nodes = np.minimum(first, self.count - STENCIL)[:, None] + np.arange(STENCIL)
        gaps = inside[:, None] - nodes
        exact = gaps == 0
        rows = _BARY / np.where(exact, 1.0, gaps)
        rows = np.where(exact.any(1)[:, None], exact, rows)
        return rows / rows.sum(1, keepdims=True), nodes

    def interpolation(self, y: np.ndarray) -> "tuple[scipy.sparse.csr_matrix, np.ndarray]":
        """Return the matrix, and the term of the tail, that map q at the nodes to q at y >= 0."""
        rows, nodes = self._rows(np.minimum(y, self.end) / self.apart)
        starts = np.arange(len(y) + 1) * STENCIL
        matrix = scipy.sparse.csr_matrix(
            (rows.ravel(), np.abs(nodes).ravel(), starts), (len(y), self.count)
        )
        return matrix, -self.decay * np.maximum(y - self.end, 0.0)

    def interpolated(self, q: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Return q at places y >= 0."""
        matrix, shift = self.interpolation(y)
        return matrix @ q + shift

    def coefficients(self, q: Any) -> Any:
        """Return the Chebyshev coefficients of every cell (STENCIL, I - 1)."""
        at = np.cos(np.pi * (np.arange(STENCIL) + 0.5) / STENCIL)
        rows, nodes = self._rows(np.add.outer((1 + at) / 2, np.arange(self.count - 1)).ravel())
        found = (jnp.asarray(rows) * q[np.abs(nodes)]).sum(1).reshape(STENCIL, -1)
        return (
            jnp.asarray(np.linalg.inv(np.polynomial.chebyshev.chebvander(at, STENCIL - 1))) @ found
        )


class Tent(NamedTuple):
    """The tent integral at the nodes: weights (I, Q), and the map from q to its points."""

    places: Places
    weights: np.ndarray
    matrix: "scipy.sparse.csr_matrix"
    shift: np.ndarray

    @classmethod
    def of(cls, places: Places, pieces: Any, at: np.ndarray | None = None) -> "Tent":
        """Build it from pieces between given ends, for the places themselves or `at` others."""
        s, w = rule(pieces)
        x = (places.nodes if at is None else at)[:, None]
        y = np.concatenate([x - 1 + s, x + s], 1)
        matrix, shift = places.interpolation(np.abs(y).ravel())
        weights = np.broadcast_to(np.concatenate([w * s, w * (1 - s)]), y.shape)
        return cls(places, weights, matrix, shift)

    def strain(self, q: np.ndarray) -> np.ndarray:
        """Return the strain over its peak at the integration points (I, Q)."""
        return np.exp(self.matrix @ q + self.shift).reshape(self.weights.shape)

    def integral(self, force: np.ndarray) -> np.ndarray:
        """Return the integral at the nodes of a force (I, Q)."""
        return (self.weights * force).sum(1)

    def slopes(self, grows: np.ndarray) -> np.ndarray:
        """Return the integral's derivative in q (I, I), from e F'(e)."""
        count, size = grows.shape
        starts = np.arange(count + 1) * size
        rows = scipy.sparse.csr_matrix(
            ((self.weights * grows).ravel(), np.arange(count * size), starts)
        )
        return (rows @ self.matrix).toarray()


class Found(NamedTuple):
    """q at the nodes, ln of the level, the residual, and the bordered Jacobian."""

    q: np.ndarray
    level: float
    residual: float
    jacobian: np.ndarray


def iterated(tent: Tent, force: Callable, q: np.ndarray, sweeps: int) -> tuple[np.ndarray, float]:
    """Iterate psi <- tent * f(psi)/peak, `sweeps` times or more; return q and ln of the level.

    It ends when the shape settles. The peak of q is 0. The level is infinite where the shape is
    lost.
    """
    for n in range(ITERATIONS):
        with np.errstate(all="ignore"):
            new = np.log(tent.integral(force(tent.strain(q))[0]))
        level = new[0]
        before = q
        if not np.isfinite(level):
            return q, np.inf
        q = np.maximum(new - level, LEAST)
        if n >= sweeps and np.abs(np.exp(q) - np.exp(before)).max() < STEADY:
            break
    return q, level


def left_between(tent: Tent, pieces: Any, force: Callable, found: Found) -> np.ndarray:
    """Return the residual of ln(strain) midway between the places, by pieces half as long.

    Of both neighbours' residuals each place has the larger. It shows errors of the integral and of
    the polynomials where the force is not smooth, which the solution itself does not show.
    """
    places = tent.places
    ends = np.asarray(pieces)
    middle = places.nodes[:-1] + places.apart / 2
    finer = Tent.of(places, np.sort(np.append(ends, (ends[1:] + ends[:-1]) / 2)), middle)
    with np.errstate(all="ignore"):
        integral = finer.integral(force(finer.strain(found.q))[0])
        left = np.abs(np.log(integral) - found.level - places.interpolated(found.q, middle))
    return np.maximum(np.append(left, 0.0), np.append(0.0, left))


def solve(tent: Tent, force: Callable, q: np.ndarray, level: float, held: Callable) -> Found:
    """Solve q = ln(tent * f(e^q)) - level with one more condition by Newton's method.

    `force(e)`: f and its slope at strains over the unit. `held(q, level)`: the residual of the
    condition and its derivatives.
    """

    def equations(x):
        q = x[:-1]
        level = x[-1]
        e = tent.strain(q)
        f, slope = force(e)
        integral = tent.integral(f)
        (value, *row) = held(q, level)
        jacobian = tent.slopes(e * slope) / integral[:, None] - np.eye(len(q))
        matrix = np.block([[jacobian, -np.ones((len(q), 1))], [np.hstack(row)[None]]])
        return np.append(np.log(integral) - level - q, value), matrix

    found = damped(equations, np.linalg.solve, np.append(q, level), ENOUGH)
    return Found(found.x[:-1], float(found.x[-1]), found.residual, found.matrix)
