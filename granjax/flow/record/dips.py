"""How near a quantity comes to its least value between steps, cheaply."""

from typing import Any

import jax.numpy as jnp

from ...types import Count, Number, Numbers, Scalar
from .kinds import AtEnds


class Dips(AtEnds):
    """Smallest value of a quantity, at the ends of steps and on the cubic through each step's values and rates.

    **Arguments:** `quantity`: as in `Peak`, the values and their rates stacked along the first axis.
    """

    def start(self, t: Number, q: Numbers, count: Count) -> Any:
        return q[0], q

    def follow(self, carried: Any, t0: Scalar, step: Scalar, q: Any) -> Any:
        least, (a, slope) = carried
        (end, last), b = q, step * slope
        c, d = 3 * (end - a) - 2 * b - step * last, 2 * (a - end) + b + step * last
        # the root of b + 2 c s + 3 d s^2 where the cubic is convex
        under = c * c - 3 * d * b
        below = c + jnp.sqrt(jnp.maximum(under, 0))
        s = jnp.clip(-b / jnp.where(below > 0, below, jnp.inf), 0, 1)
        dip = jnp.where(under > 0, a + s * (b + s * (c + s * d)), end)
        return jnp.minimum(least, jnp.minimum(dip, end)).astype(least.dtype), q

    def finish(self, carried: Any) -> Numbers:
        return carried[0]
