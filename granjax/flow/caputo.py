"""Caputo's fractional derivative in time: D^a y = f(t, y), with the whole history."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jax.scipy.special import gammaln

from ..base.checks import concrete, parameter, refuse, whole, within
from ..base.programs import compiled
from ..base.types import Count, Number, Pytree, Scalar, Times, VectorField
from ..results import Result, array
from .arguments import checked_times

# The most iterations of Newton's method at each step.
ITERATIONS = 20
# The change, relative to the solution, at which they stop.
SETTLED = 1e-13


class CaputoRun(Result):
    """The result of `caputo`."""

    ts: Times = array("The times.", "s", "time", name="time")
    ys: Pytree = array("The solution, with the structure of y and times first.", axes="time ...")
    error: Number = array(
        "The largest error over all entries and times: the error estimated from a second run with "
        "half the steps, plus the error of the start, t^a, estimated from the first step."
    )
    residual: Number = array(
        "The largest last change of Newton's method, relative to the size of the solution."
    )

    @property
    def outcome(self) -> str:
        """A sentence about how the run ended (not available while traced)."""
        if concrete(self.error) is None:
            return "Not known while traced."
        if not np.isfinite(self.error):
            return (
                "The solution is not finite: it grew beyond all bounds, or the steps are too long."
            )
        return (
            "Completed."
            if self.residual < 1e-8
            else "Newton's method did not converge everywhere: take more steps."
        )


def caputo(
    field: VectorField,
    y: Pytree,
    t1: Scalar,
    *,
    order: Scalar,
    steps: Count = 200,
    t0: Scalar = 0.0,
    args: Any = None,
    grading: Scalar | None = None,
) -> CaputoRun:
    r"""Solve D^a y = f(t, y, args), y(t0) = y0, with Caputo's derivative of order 0 < a < 1.

    D^a y(t) = 1/Gamma(1 - a) times the integral over s < t of y'(s)/(t - s)^a. In the implicit L1
    scheme y is linear within each step, Newton's method finds each new value, and stability does
    not limit the step. The whole history is kept, since memory decays as slowly as the solution.
    For T steps and n numbers it takes memory T n, time T^2 n, and T Jacobians of n x n.

    Solutions start as t^a, with infinite slope. With times t0 + (t1 - t0) (j/T)^r, r = (2 - a)/a,
    the error falls as T^{-(2 - a)} at all times; with equal steps as T^{-a}.

    **Arguments:** `field`: f(t, y, args); `y`: y0; `t1`: the end; `order`: a in (0, 1); `steps`: T,
    even, at least 4; `grading`: r >= 1, 1 for equal steps, `None` for (2 - a)/a, at most 12 (below
    a = 0.15 the error falls as T^{-12 a}).

        run = gx.caputo(lambda t, y, args: -y, 1.0, 5.0, order=0.6)     # run.ys is E_a(-t^a)

    **Returns:** `CaputoRun`. Derivatives exist in both modes; reverse mode takes memory T^2 n.

    **Raises** ValueError for a outside (0, 1), odd T, or times that are not in order.

    Source: M. Stynes, E. O'Riordan, J. L. Gracia, SIAM J. Numer. Anal. 55, 1057 (2017).

    **Example:**

    >>> run = gx.caputo(lambda t, y, args: -y, 1.0, 1.0, order=0.5)
    >>> round(float(run.ys[-1]), 3)
    0.428
    """
    t0, t1 = checked_times(t0, t1)
    remedy = "Order 1 is the plain derivative: gx.simulate, diffrax."
    order = within("order", order, 0, 1, open_low=True, open_high=True, remedy=remedy)
    steps = whole("steps", steps, 4)
    if steps % 2:
        refuse(
            "steps", "an even number, as a second run with half of them tells the error", f"{steps}"
        )
    grading = (
        jnp.minimum((2 - order) / order, 12.0) if grading is None else parameter("grading", grading)
    )
    y = jax.tree.map(lambda x: parameter("y", x), y)
    # Plain numbers become inputs of the compiled program, so that other numbers do not compile
    # anew.
    args = jax.tree.map(lambda x: jnp.asarray(x) if type(x) in (int, float, complex) else x, args)
    t0, t1 = (jnp.asarray(t, float) for t in (t0, t1))
    return _solved(field, y, t0, t1, order, grading, steps, args)


@compiled
def _solved(field, y, t0, t1, order, grading, steps, args):
    flat, unravel = ravel_pytree(y)
    ends = (jnp.arange(steps + 1) / steps) ** grading * (t1 - t0)

    def f(t, x):
        return ravel_pytree(field(t0 + t, unravel(x), args))[0]

    fine, residual = _marched(f, flat, ends, order)
    coarse, _ = _marched(f, flat, ends[::2], order)
    # Away from the start, by Richardson extrapolation. The factor 0.8 allows for an order that is
    # approached from below.
    error = jnp.max(jnp.abs(fine[::2] - coarse)) / (
        2 ** (0.8 * jnp.minimum(2 - order, grading)) - 1
    )
    # The error within the first step, which the coarse run does not see: that of the scheme for
    # t^a.
    error += jnp.max(jnp.abs(fine[1] - flat)) * (
        jnp.exp(-gammaln(1 + order) - gammaln(2 - order)) - 1
    )
    error = jnp.where(jnp.all(jnp.isfinite(fine)), error, jnp.nan)
    return CaputoRun(t0 + ends, jax.vmap(unravel)(fine), error, residual)


def _newton(residual, start):
    # The root of a step, and the last change relative to the size of the solution.
    def improve(state):
        x, _, k = state
        move = jnp.linalg.solve(jax.jacfwd(residual)(x), residual(x))
        size = jnp.max(jnp.abs(move)) / jnp.maximum(jnp.max(jnp.abs(x)), jnp.finfo(x.dtype).tiny)
        return x - move, size, k + 1

    begin = start, jnp.asarray(jnp.inf, start.dtype), 0
    x, left, _ = jax.lax.while_loop(
        lambda s: (s[1] > SETTLED) & (s[2] < ITERATIONS), improve, begin
    )
    return x, left


def _tangent(linear, y):
    return jnp.linalg.solve(jax.jacfwd(linear)(y), y)


def _marched(f, y0, ends, order):
    # The solution at the ends of steps, (T + 1, n), and the largest last change of Newton's method.
    count = len(ends) - 1
    gaps = jnp.diff(ends)
    gamma = jnp.exp(gammaln(2 - order))

    def step(carry, n):
        slopes, y, worst = carry
        t = ends[n + 1]
        # The history: the integral of (t - s)^{-a} over each past step.
        since = t - ends[1:]
        past = jnp.arange(count) < n
        since = jnp.where(past, since, 1.0)
        parts = since ** (1 - order) * jnp.expm1((1 - order) * jnp.log1p(gaps / since)) / gamma
        history = jnp.where(past, parts, 0.0) @ slopes
        own = gaps[n] ** -order / gamma
        residual = lambda x: own * (x - y) + history - f(t, x)

        x, left = jax.lax.custom_root(residual, y, _newton, _tangent, has_aux=True)
        slopes = jax.lax.dynamic_update_slice(slopes, ((x - y) / gaps[n])[None], (n, 0))
        return (slopes, x, jnp.maximum(worst, left)), x

    begin = jnp.zeros((count, y0.size), y0.dtype), y0, jnp.zeros((), y0.dtype)
    (_, _, worst), found = jax.lax.scan(step, begin, jnp.arange(count))
    return jnp.concatenate([y0[None], found]), worst
