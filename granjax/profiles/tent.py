"""The tent integral: a wave of one sign by the logarithm of its strain, right to its last digit everywhere.

phi(x) = int (1 - |z|) F(phi(x - z)) dz/(m c^2) has positive terms alone, so that what it gives is as right as what goes
in. In q = ln(phi/peak) on places alike far apart, tails that fall as exp(-exp(x)) have digits like the top.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
import scipy.sparse as sparse

from .damped import damped

# places that one value is interpolated from; nodes of a piece of the tent, pieces of either of its sides, finer towards
# where the wave comes from
STENCIL, PIECE = 12, 12
PIECES = (0.0, 1 / 32, 1 / 16, 1 / 8, 1 / 4, 3 / 8, 1 / 2, 5 / 8, 3 / 4, 7 / 8, 1.0)
# ln of the least strain over its peak that numbers hold
LEAST = -690.0
# what is left of Newton's equations where rounding may be met
ENOUGH = 1e-12
# most iterations for a first shape, and the change at which it is steady
ITERATIONS, STEADY = 400, 1e-5
_BARY = np.array(
    [1 / np.prod(np.delete(k - np.arange(STENCIL), k), dtype=float) for k in range(STENCIL)]
)


def rule(pieces: Any = PIECES) -> tuple[np.ndarray, np.ndarray]:
    """Nodes and weights on (0, 1), that many on each piece between some ends."""
    t, w = np.polynomial.legendre.leggauss(PIECE)
    ends = list(zip(pieces[:-1], pieces[1:]))
    return (
        np.concatenate([a + (b - a) * (1 + t) / 2 for a, b in ends]),
        np.concatenate([(b - a) * w / 2 for a, b in ends]),
    )


RULE = rule()


class Places(NamedTuple):
    """Places from 0 on, so far apart, of a function that is even; beyond the last one its slope is -decay.

    Between them it is the polynomial through the nearest ones, which those at the end take from one side.
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
    def weights(self) -> np.ndarray:
        """Of an integral from 0 on over something even that is gone at the end (I,)."""
        weights = np.full(self.count, self.apart)
        weights[0] /= 2
        return weights

    def _rows(self, inside):
        """Weights (Y, STENCIL) of the nodes that stand for places, counted in cells; the nodes, also below zero."""
        first = np.minimum(inside.astype(int), self.count - 2) - (STENCIL // 2 - 1)
        nodes = np.minimum(first, self.count - STENCIL)[:, None] + np.arange(STENCIL)
        gaps = inside[:, None] - nodes
        exact = gaps == 0
        rows = _BARY / np.where(exact, 1.0, gaps)
        rows = np.where(exact.any(1)[:, None], exact, rows)
        return rows / rows.sum(1, keepdims=True), nodes

    def interpolation(self, y: np.ndarray) -> tuple[sparse.csr_matrix, np.ndarray]:
        """q at places y >= 0 from q at the nodes: a matrix, and what the slope beyond the end adds."""
        rows, nodes = self._rows(np.minimum(y, self.end) / self.apart)
        starts = np.arange(len(y) + 1) * STENCIL
        matrix = sparse.csr_matrix(
            (rows.ravel(), np.abs(nodes).ravel(), starts), (len(y), self.count)
        )
        return matrix, -self.decay * np.maximum(y - self.end, 0.0)

    def interpolated(self, q: np.ndarray, y: np.ndarray) -> np.ndarray:
        """q at places y >= 0."""
        matrix, shift = self.interpolation(y)
        return matrix @ q + shift

    def coefficients(self, q: Any) -> Any:
        """Those of Chebyshev's polynomials on every cell (STENCIL, I - 1)."""
        at = np.cos(np.pi * (np.arange(STENCIL) + 0.5) / STENCIL)
        rows, nodes = self._rows(np.add.outer((1 + at) / 2, np.arange(self.count - 1)).ravel())
        found = (jnp.asarray(rows) * q[np.abs(nodes)]).sum(1).reshape(STENCIL, -1)
        return (
            jnp.asarray(np.linalg.inv(np.polynomial.chebyshev.chebvander(at, STENCIL - 1))) @ found
        )


class Tent(NamedTuple):
    """The tent integral at the nodes of some places: places, weights (I, Q), and q there from q at the nodes."""

    places: Places
    weights: np.ndarray
    matrix: sparse.csr_matrix
    shift: np.ndarray

    @classmethod
    def of(cls, places: Places, pieces: Any = PIECES, at: np.ndarray | None = None) -> "Tent":
        """The same for given places, by pieces between given ends, at the places themselves or `at` others."""
        s, w = rule(pieces)
        x = (places.nodes if at is None else at)[:, None]
        y = np.concatenate([x - 1 + s, x + s], 1)
        matrix, shift = places.interpolation(np.abs(y).ravel())
        weights = np.broadcast_to(np.concatenate([w * s, w * (1 - s)]), y.shape)
        return cls(places, weights, matrix, shift)

    def strain(self, q: np.ndarray) -> np.ndarray:
        """The strain over its peak where the tent reads it, (I, Q)."""
        return np.exp(self.matrix @ q + self.shift).reshape(self.weights.shape)

    def integral(self, force: np.ndarray) -> np.ndarray:
        """The integral at the nodes of a force (I, Q)."""
        return (self.weights * force).sum(1)

    def slopes(self, grows: np.ndarray) -> np.ndarray:
        """Its derivative in q at the nodes (I, I), from e F'(e)."""
        count, size = grows.shape
        starts = np.arange(count + 1) * size
        rows = sparse.csr_matrix(((self.weights * grows).ravel(), np.arange(count * size), starts))
        return (rows @ self.matrix).toarray()


class Found(NamedTuple):
    """q at the nodes, ln of the level, the residual that was left, and the Jacobian with its border, the level's."""

    q: np.ndarray
    level: float
    residual: float
    jacobian: np.ndarray


def iterated(tent: Tent, force: Callable, q: np.ndarray, sweeps: int) -> tuple[np.ndarray, float]:
    """q with the peak 0 and ln of the level, of psi <- tent * f(psi) over its peak, until the shape settles.

    It takes `sweeps` iterations at least. The level is infinite where the shape is lost.
    """
    for n in range(ITERATIONS):
        with np.errstate(all="ignore"):
            new = np.log(tent.integral(force(tent.strain(q))[0]))
        level, before = new[0], q
        if not np.isfinite(level):
            return q, np.inf
        q = np.maximum(new - level, LEAST)
        if n >= sweeps and np.abs(np.exp(q) - np.exp(before)).max() < STEADY:
            break
    return q, level


def left_between(tent: Tent, pieces: Any, force: Callable, found: Found) -> np.ndarray:
    """What the equation leaves of ln(strain) midway between the places, by pieces half as long: at each place the more.

    It sees what the solution itself does not: an integral or a polynomial across a place where the force is not smooth.
    """
    places, ends = tent.places, np.asarray(pieces)
    middle = places.nodes[:-1] + places.apart / 2
    finer = Tent.of(places, np.sort(np.append(ends, (ends[1:] + ends[:-1]) / 2)), middle)
    with np.errstate(all="ignore"):
        integral = finer.integral(force(finer.strain(found.q))[0])
        left = np.abs(np.log(integral) - found.level - places.interpolated(found.q, middle))
    return np.maximum(np.append(left, 0.0), np.append(0.0, left))


def solve(tent: Tent, force: Callable, q: np.ndarray, level: float, held: Callable) -> Found:
    """Newton's method for q = ln(tent * f(e^q)) - level, and one condition more.

    `force(e)`: f and its slope at strains over the peak's unit. `held(q, level)`: what is zero besides, and its
    derivatives. It ends where the residual falls no more.
    """

    def equations(x):
        q, level = x[:-1], x[-1]
        e = tent.strain(q)
        f, slope = force(e)
        integral, (value, *row) = tent.integral(f), held(q, level)
        jacobian = tent.slopes(e * slope) / integral[:, None] - np.eye(len(q))
        matrix = np.block([[jacobian, -np.ones((len(q), 1))], [np.hstack(row)[None]]])
        return np.append(np.log(integral) - level - q, value), matrix

    found = damped(equations, np.linalg.solve, np.append(q, level), ENOUGH)
    return Found(found.x[:-1], float(found.x[-1]), found.residual, found.matrix)
