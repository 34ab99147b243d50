"""A contact in series with a spring: a yielding wall or support."""

from functools import partial

import jax
import jax.numpy as jnp

from ..base.checks import positive
from ..base.types import Parameter
from ..base.units import PART
from .base import Derived, Law

# The most steps of Newton's method, bisections included.
NEWTON_STEPS = 200


class Yielding(Derived):
    r"""A law in series with a linear spring of stiffness k: F(e) = F_law(x), x + F_law(x)/k = e.

    x is the compression of the contact, F/k that of the support. Energy: energy_law(x) + F^2/(2k).
    The force of the inner law must not fall with compression. The equation is solved by Newton's
    method, safeguarded by bisection; the derivative is that of the implicit function.

    **Arguments:** `law`; `support`: k > 0 [N/m]; a very large k is a rigid wall. **Raises**
    ValueError for k <= 0 or a law that is none.

    **Example:**

    >>> law = gx.Yielding(gx.Linear(2.0), support=2.0)
    >>> round(float(law.force(1.0)), 6)
    1.0
    """

    dimensions = {"law": PART, "support": (1, -1, 0)}
    law: Law
    support: jax.Array

    def __init__(self, law: Law, support: Parameter):
        self.law = law
        self.support = positive("support", support)

    def _moved(self, e):
        return _share(self.law, self.support, e)

    @property
    def preload(self):
        return self.law.preload

    def force(self, e):
        return self.law.force(self._moved(e))

    def energy(self, e):
        x = self._moved(e)
        return self.law.energy(x) + self.law.force(x) ** 2 / (2 * self.support)


@partial(jax.custom_jvp, nondiff_argnums=())
def _share(law, support, e):
    # Solve x + law.force(x)/support = e for x.

    def step(carry):
        low, high, x, _, count = carry
        residual, slope = jax.jvp(
            lambda x: x + law.force(x) / support - e, (x,), (jnp.ones_like(x),)
        )
        below = residual < 0  # NaN, where magnets met, counts as above
        low = jnp.where(below, x, low)
        high = jnp.where(below, high, x)
        better = x - residual / slope
        inside = (better >= low) & (better <= high)
        better = jnp.where(residual == 0, x, jnp.where(inside, better, (low + high) / 2))
        return (
            low,
            high,
            better,
            jnp.abs(better - x) > 2 * jnp.finfo(x.dtype).eps * jnp.abs(better),
            count + 1,
        )

    residual = e + law.force(e) / support
    e = jnp.broadcast_to(e, jnp.shape(residual)).astype(residual.dtype)
    zero = jnp.zeros_like(e)
    start = jnp.minimum(e, zero), jnp.maximum(e, zero), e, jnp.full(e.shape, True), 0
    return jax.lax.while_loop(lambda c: jnp.any(c[3]) & (c[4] < NEWTON_STEPS), step, start)[2]


@_share.defjvp
def _share_jvp(primals, tangents):
    law, support, e = primals
    x = _share(law, support, e)
    _, slope = jax.jvp(lambda x: x + law.force(x) / support, (x,), (jnp.ones_like(x),))
    _, moved = jax.jvp(
        lambda law, support: x + law.force(x) / support, (law, support), tangents[:2]
    )
    return x, (tangents[2] - moved) / slope
