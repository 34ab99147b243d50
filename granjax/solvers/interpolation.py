"""Dense output of one step: a polynomial displacement, and the velocity as its derivative."""

import abc
from collections.abc import Callable
from functools import cache
from typing import NamedTuple, TypeAlias

import diffrax
import jax
import jax.numpy as jnp
import numpy as np

from ..base.types import AnyArray, Count, Number, Pytree, Scalar, StateLike
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
        s, h = _place(self, t)
        u0, v0 = self.y0
        u1, v1 = self.y1

        def both(u0, v0, a0, u1, v1, a1):
            k = h.astype(u0.dtype)
            rise = u1 - u0 - k * v0
            gain = k * (v1 - v0)
            return _evaluate(s, k, u0, v0, quintic(rise, gain, k * k * a0, k * k * a1), ())

        return _state(self.y0, both, u0, v0, self.a0, u1, v1, self.a1)


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
        s, h = _place(self, t)
        u0, v0 = self.y0

        def both(u0, v0, *coefficients):
            return _evaluate(s, h.astype(u0.dtype), u0, v0, coefficients[:4], coefficients[4:])

        return _state(self.y0, both, u0, v0, *self.quintic, *self.inside)


def bootstrapped(
    t0: Scalar,
    t1: Scalar,
    y0: StateLike,
    y1: StateLike,
    a0: Pytree,
    a1: Pytree,
    acceleration: Callable,
    rounds: Count,
) -> Bootstrapped:
    """Construct dense output from the ends of any step and 2 + 4 + ... + 2 `rounds` accelerations.

    Each round evaluates `acceleration(t, y)` along the output of the round before, at two more
    places, and gains two orders: degree 5 + 2 rounds, an error of order h^(6 + 2 rounds).
    """
    h = t1 - t0
    structure = jax.tree.structure(a0)

    def ends(u0, v0, u1, v1, a0, a1):
        k = h.astype(u0.dtype)
        return quintic(u1 - u0 - k * v0, k * (v1 - v0), k * k * a0, k * k * a1)

    leaves = [ends(*x) for x in zip(*map(jax.tree.leaves, (*y0, *y1, a0, a1)))]
    low = tuple(structure.unflatten(x) for x in zip(*leaves))
    path = Bootstrapped(t0, t1, y0, low, ())
    for m in range(2, 2 * rounds + 1, 2):
        fit = correction(m)
        times = jnp.minimum(t0 + fit.nodes * h, t1)
        inner = jax.lax.map(lambda t, path=path: acceleration(t, path.evaluate(t)), times)

        def inside(take, less, a, *low):
            k = h.astype(a.dtype)
            return k * k * sum(x * y for x, y in zip(take, a)) - sum(
                x * y for x, y in zip(less, low)
            )

        rows = zip(fit.take.tolist(), fit.less.tolist())
        path = Bootstrapped(
            t0,
            t1,
            y0,
            low,
            tuple(
                jax.tree.map(lambda *x, take=take, less=less: inside(take, less, *x), inner, *low)
                for take, less in rows
            ),
        )
    return path


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


# the fraction of the step at t, and its length in the direction of the state's time
def _place(step, t):
    length = jnp.asarray(step.t1 - step.t0)
    return (t - step.t0) / jnp.where(length == 0, 1, length), length * step.direction


# a state like `like`, from `both`, which gives (u, v) for the leaves of `trees`
def _state(like, both, *trees):
    structure = jax.tree.structure(trees[0])
    values = [both(*leaves) for leaves in zip(*map(jax.tree.leaves, trees))]
    u, v = (structure.unflatten([value[i] for value in values]) for i in (0, 1))
    return pair(like, u, v)
