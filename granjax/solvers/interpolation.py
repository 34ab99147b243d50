"""Dense output of one step: a polynomial displacement, and the velocity as its derivative."""

import abc
from collections.abc import Callable
from functools import cache, partial
from typing import NamedTuple, TypeAlias

import diffrax
import jax
import jax.numpy as jnp
import numpy as np

from ..base.types import AnyArray, Count, Number, Pytree
from .split_system import pair

# real or complex
Entry: TypeAlias = AnyArray | np.inexact


class Path(diffrax.AbstractLocalInterpolation):
    """Dense output whose increments are differences of states."""

    @abc.abstractmethod
    def at(self, t: Number) -> Pytree:
        """Return the state at a time of the step."""

    def evaluate(self, t0, t1=None, left=True):
        if t1 is not None:
            return jax.tree.map(jnp.subtract, self.at(t1), self.at(t0))
        return self.at(t0)


class QuinticHermite(Path):
    r"""Dense output as the quintic through u, v, a at both ends of a step.

    With s = (t - t0)/h the error is h^6 u^(6)/46080 in the middle, and zero to second order at the
    ends. `y0`, `y1`: states (u, v); `a0`, `a1`: accelerations, of the structure of u; `direction`:
    -1 if diffrax's time runs backwards.
    """

    t0: object
    t1: object
    y0: object
    y1: object
    a0: object
    a1: object
    direction: object = 1

    def at(self, t):
        low = self.coefficients()
        return Bootstrapped(self.t0, self.t1, self.y0, low, (), self.direction).at(t)

    def coefficients(self) -> tuple:
        """Return the coefficients of s^2 ... s^5."""
        h = jnp.asarray(self.t1 - self.t0) * self.direction

        def ends(u0, v0, u1, v1, a0, a1):
            k = h.astype(u0.dtype)
            return quintic(u1 - u0 - k * v0, k * (v1 - v0), k * k * a0, k * k * a1)

        return _several(ends, *self.y0, *self.y1, self.a0, self.a1)


class Bootstrapped(Path):
    r"""Dense output as the quintic plus s^3 (1 - s)^3 q(s), so that u'' = a holds inside too.

    The quintic goes through u, v, a at both ends. q, of degree m - 1, follows from the
    accelerations at m interior places (`correction`). u has degree m + 5 in s = (t - t0)/h and an
    error of order h^(m+6), if those accelerations are accurate to order m + 4.

    `y0`: the state at t0. `quintic`: the coefficients of s^2 ... s^5, each of the structure of u.
    `inside`: the m coefficients of q in the Legendre polynomials of 2s - 1. `direction`: -1 if
    diffrax's time runs backwards.
    """

    t0: object
    t1: object
    y0: object
    quintic: object
    inside: object
    direction: object = 1

    def at(self, t):
        length = jnp.asarray(self.t1 - self.t0)
        s = (t - self.t0) / jnp.where(length == 0, 1, length)
        h = length * self.direction

        def both(u0, v0, *coefficients):
            return _evaluate(s, h.astype(u0.dtype), u0, v0, coefficients[:4], coefficients[4:])

        return pair(self.y0, *_several(both, *self.y0, *self.quintic, *self.inside))


def bootstrapped(path: QuinticHermite, acceleration: Callable, rounds: Count) -> Bootstrapped:
    """Refine the quintic of any step by 2 + 4 + ... + 2 `rounds` accelerations.

    Each round evaluates `acceleration(t, y)` along the output of the round before, at two more
    places, and gains two orders: degree 5 + 2 rounds, an error of order h^(6 + 2 rounds).
    """
    ends = path.t0, path.t1, path.y0, path.coefficients()
    h = path.t1 - path.t0

    def inside(fit, a, *low):
        k = h.astype(a.dtype)
        return [
            k * k * sum(x * y for x, y in zip(take, a)) - sum(x * y for x, y in zip(less, low))
            for take, less in zip(fit.take.tolist(), fit.less.tolist())
        ]

    found = Bootstrapped(*ends, ())
    for m in range(2, 2 * rounds + 1, 2):
        fit = correction(m)
        times = jnp.minimum(path.t0 + fit.nodes * h, path.t1)
        inner = jax.lax.map(lambda t, found=found: acceleration(t, found.at(t)), times)
        found = Bootstrapped(*ends, _several(partial(inside, fit), inner, *ends[-1]))
    return found


def quintic(rise: Entry, gain: Entry, p0: Entry, p1: Entry) -> tuple:
    """Return the coefficients of s^2 ... s^5 of u(s) - u0 - s h v0.

    `rise` = u1 - u0 - h v0, `gain` = h (v1 - v0), `p0`, `p1` = h^2 a at the ends. All have the size
    of h^2 a, so large displacements or velocities cause no cancellation.
    """
    q0 = p0 / 2
    q1 = p1 / 2
    return (
        q0,
        10 * rise - 4 * gain - 3 * q0 + q1,
        -15 * rise + 7 * gain + 3 * q0 - 2 * q1,
        6 * rise - 3 * gain - q0 + q1,
    )


class Correction(NamedTuple):
    """`Bootstrapped`'s q = `take` @ (h^2 a at `nodes`) - `less` @ (coefficients of s^2 ... s^5)."""

    nodes: np.ndarray
    take: np.ndarray
    less: np.ndarray


@cache
def correction(m: int) -> Correction:
    r"""Return the nodes and matrices for m interior accelerations.

    The error polynomial E has degree m + 6, triple zeros at the ends, and E'' = 0 at the nodes. The
    nodes are zeros of the second derivative of the Gegenbauer one,
    d^2E/ds^2 ~ s(1 - s) P_{m+2}^{(1,1)}(2s - 1), the interior Gauss-Lobatto nodes. Of these m + 2
    nodes the pair is left out whose absence gives the best-conditioned system.
    """
    inner = np.polynomial.legendre.Legendre.basis(m + 3).deriv().roots().real
    inner = (np.sort(inner) + 1) / 2
    pairs = [(i, j) for i in range(m + 2) for j in range(i + 1, m + 2)]
    choices = [np.delete(inner, pair) for pair in pairs]
    nodes = min(
        choices, key=lambda c: (round(np.abs(np.linalg.inv(_second(c))).sum(1).max(), 9), c.sum())
    )
    powers = np.stack([(k + 2) * (k + 1) * nodes**k for k in range(4)], 1)
    take = np.linalg.inv(_second(nodes))
    return Correction(nodes, take, take @ powers)


# second derivatives of w(s) P_j(2s - 1) at the nodes, one column per j
def _second(nodes):
    columns = []
    for j in range(len(nodes)):
        p = np.polynomial.legendre.Legendre.basis(j)
        x = 2 * nodes - 1
        w, dw, ddw = _weight(nodes)
        columns.append(ddw * p(x) + 4 * dw * p.deriv()(x) + 4 * w * p.deriv(2)(x))
    return np.stack(columns, 1)


def _weight(s):
    p = s * (1 - s)
    dp = 1 - 2 * s
    return p**3, 3 * p * p * dp, 6 * p * dp * dp - 6 * p * p


def _evaluate(s, h, u0, v0, low, inside):
    s = s.astype(u0.dtype)
    c2, c3, c4, c5 = low
    u = s * (h * v0 + s * (c2 + s * (c3 + s * (c4 + s * c5))))
    slope = s * (2 * c2 + s * (3 * c3 + s * (4 * c4 + s * 5 * c5)))
    if inside:
        w, dw, _ = _weight(s)
        for q, (p, dp) in zip(inside, _legendre(2 * s - 1, len(inside))):
            u = u + (w * p) * q
            slope = slope + (dw * p + 2 * w * dp) * q
    return u0 + u, v0 + slope / jnp.where(h == 0, 1, h)


def _legendre(x, count):
    one = jnp.ones_like(x)
    values = [one, x]
    slopes = [jnp.zeros_like(x), one]
    for n in range(1, count - 1):
        values.append(((2 * n + 1) * x * values[n] - n * values[n - 1]) / (n + 1))
        slopes.append((2 * n + 1) * values[n] + slopes[n - 1])
    return list(zip(values, slopes))[:count]


# several trees, from a function that gives several values for the leaves of `trees`
def _several(function, *trees):
    found = jax.tree.map(function, *trees)
    return jax.tree.transpose(jax.tree.structure(trees[0]), None, found)
