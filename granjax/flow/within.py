"""Maxima ("tops") and crossings of a quantity within one step.

They are those of the polynomial through samples at the Gauss-Lobatto points.
"""

from functools import cache
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..base.arrays import trailing
from ..base.types import Count, Flags, Number, Numbers, Parameter

# The steps of Newton's method from the guess of a top.
NEWTON_STEPS = 2
# The steps that close in on a crossing.
ROOT_STEPS = 60
# The first steps to a crossing, which only bisect. Newton's method follows.
HALVINGS = 6
# The polynomial does not resolve its last two coefficients times this.
UNRESOLVED = 4
# Newton's method has not converged to a top if its last move is longer than this, in half time
# steps.
ARRIVED = 1e-3
# A parabola may be below the top by this part of the span of the samples.
MARGIN = 0.1
# A sample looks for a top up to this factor beyond half of the way to its neighbours.
SLACK = 1.5


class Lobatto(NamedTuple):
    """Points x in [-1, 1], weights of a mean, and the matrix to Chebyshev coefficients."""

    x: np.ndarray
    weights: np.ndarray
    coefficients: np.ndarray


@cache
def lobatto(count: int) -> Lobatto:
    """Return the Gauss-Lobatto rule, whose mean is exact for polynomials of degree 2 count - 3."""
    basis = np.polynomial.legendre.Legendre.basis(count - 1)
    x = np.concatenate([[-1.0], np.sort(basis.deriv().roots().real), [1.0]])
    x = (x - x[::-1]) / 2
    to_values = np.polynomial.chebyshev.chebvander(x, count - 1)
    return Lobatto(x, 1 / (count * (count - 1) * basis(x) ** 2), np.linalg.inv(to_values))


def places(q: Numbers) -> Numbers:
    """Return the points in [-1, 1] of the samples, in a shape that broadcasts with them."""
    return _along(lobatto(len(q)).x, q)


def _along(x, q):
    return trailing(jnp.asarray(x, q.dtype), q.ndim)


def mean(q: Numbers) -> Numbers:
    """Return the mean over a step of samples along the first axis."""
    return _weighted(lobatto(len(q)).weights, q)


def series(q: Numbers) -> list[Numbers]:
    """Return the Chebyshev coefficients of the polynomial through samples along the first axis."""
    return [_weighted(row, q) for row in lobatto(len(q)).coefficients]


def _weighted(weights, q):
    # Written out, so that XLA makes one pass; a matrix product would be a call.
    return sum(w * x for w, x in zip(weights.tolist(), q))


def value(c: list[Numbers], x: Numbers) -> Numbers:
    """Return a Chebyshev series at x in [-1, 1], by Clenshaw's algorithm."""
    one = two = jnp.zeros_like(x)
    for later in c[:0:-1]:
        one, two = later + 2 * x * one - two, one
    return c[0] + x * one - two


def slope(c: list[Numbers]) -> list[Numbers]:
    """Return the coefficients of the derivative of a Chebyshev series."""
    out = [jnp.zeros_like(c[0])] * (len(c) + 1)
    for k in range(len(c) - 1, 0, -1):
        out[k - 1] = out[k + 1] + 2 * k * c[k]
    return [out[0] / 2, *out[1 : len(c) - 1]]


def span(q: Numbers) -> Numbers:
    """Return the largest sample minus the smallest."""
    return q.max(0) - q.min(0)


class Guess(NamedTuple):
    """The estimated place and height of a top within a step; the height is -inf without a top."""

    place: Numbers
    height: Numbers


def guesses(q: Numbers, count: Count, until: Parameter = 1.0) -> list[Guess]:
    """Return the highest tops of the parabolas through three samples.

    **Arguments:** `q`: samples along the first axis, elementwise. `count`: the most tops. `until`:
    the last place that counts.
    """
    q = jax.lax.stop_gradient(q)
    x = lobatto(len(q)).x
    gaps = np.diff(x)
    # The outermost samples look as far as the ends.
    nearest = -SLACK * gaps[:-1] / 2
    nearest[0] = -gaps[0]
    furthest = SLACK * gaps[1:] / 2
    furthest[-1] = gaps[-1]
    left = _along(gaps[:-1], q)
    right = _along(gaps[1:], q)
    before = (q[1:-1] - q[:-2]) / left
    after = (q[2:] - q[1:-1]) / right
    bend = (after - before) * 2 / (left + right)
    rise = (before * right + after * left) / (left + right)
    move = -rise / jnp.where(bend < 0, bend, -jnp.inf)
    place = _along(x[1:-1], q) + move
    there = (bend < 0) & (move >= _along(nearest, q)) & (move <= _along(furthest, q))
    there &= place <= until
    place = jnp.where(there, place, 0)
    height = jnp.where(there, q[1:-1] + rise * move / 2, -jnp.inf)
    found = []
    none = q.dtype.type(0), q.dtype.type(-np.inf)
    for _ in range(count):
        highest = Guess(*jax.lax.reduce((place, height), none, _higher, (0,)))
        found.append(highest)
        height = jnp.where(place == highest.place, -jnp.inf, height)
    return found


def _higher(a, b):
    above = a[1] >= b[1]
    return tuple(jnp.where(above, x, y) for x, y in zip(a, b))


def higher(q: Numbers, guesses: list[Guess], than: Number) -> Flags:
    """Return whether a guessed top may be higher than a value."""
    return guesses[0].height + MARGIN * span(jax.lax.stop_gradient(q)) > than


def tops(q: Numbers, guesses: list[Guess]) -> list[Guess]:
    """Return the guessed tops on the polynomial; without a top the height is the first sample.

    The heights have the quantity's derivatives, to second order.
    """
    # Newton's method refines each guess. A top that exceeds all samples by less than the polynomial
    # resolves is a kink or a jump, and does not count.
    c = series(q)
    moving = slope(c)
    still, first = jax.lax.stop_gradient((c, moving))
    second = slope(first)
    least = jax.lax.stop_gradient(q).max(0) + UNRESOLVED * (jnp.abs(still[-1]) + jnp.abs(still[-2]))
    found = []
    for x, guessed in guesses:
        for _ in range(NEWTON_STEPS):
            bend = value(second, x)
            x = jnp.clip(x - value(first, x) / jnp.where(bend < 0, bend, -jnp.inf), -1, 1)
        rise = value(moving, x)
        height = value(c, x)
        left = rise / jnp.where(bend < 0, bend, -jnp.inf)
        there = (guessed > -jnp.inf) & (bend < 0) & (jnp.abs(left) < ARRIVED) & (height >= least)
        # The correction has zero value and slope. It brings the moving place of the top into the
        # second derivative.
        found.append(Guess(x, jnp.where(there, height - rise * left / 2, q[0])))
    return found


def top_place(q: Numbers, place: Numbers) -> Numbers:
    """Return the place of a top with the quantity's derivatives, to second order.

    Where there is no top at `place`, it is constant.
    """
    first = slope(series(q))
    second = slope(first)
    # Two steps from a fixed place carry the first and second derivatives.
    for _ in range(2):
        bend = value(second, place)
        move = value(first, place) / jnp.where(bend < 0, bend, -jnp.inf)
        place = place - jnp.where(jnp.abs(move) < ARRIVED, move, 0)
    return place


def crossing(
    c: list[Numbers], threshold: Parameter, low: Numbers, high: Numbers, there: Flags
) -> Numbers:
    """Return where a series rises through a threshold between `low` and `high`.

    It is below the threshold at `low`, and not below it at `high`.
    """
    moving = slope(c)
    still, first, low, high = jax.lax.stop_gradient((c, moving, low, high))

    def closer(i, carry):
        x, low, high = carry
        height = value(still, x) - jax.lax.stop_gradient(threshold)
        rise = value(first, x)
        low = jnp.where(height < 0, x, low)
        high = jnp.where(height < 0, high, x)
        new = x - height / jnp.where(rise > 0, rise, 1)
        good = (i >= HALVINGS) & (rise > 0) & (new >= low) & (new <= high)
        return jnp.where(good, new, (low + high) / 2), low, high

    x, _, _ = jax.lax.fori_loop(0, ROOT_STEPS, closer, ((low + high) / 2, low, high))
    # Two more steps from a fixed place carry the first and second derivatives.
    for _ in range(2):
        rise = value(moving, x)
        good = there & (rise > 0)
        x = x - jnp.where(good, (value(c, x) - threshold) / jnp.where(good, rise, 1), 0)
    return jnp.clip(x, low, high)
