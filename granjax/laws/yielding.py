"""A contact in series with a spring: a yielding wall or support."""

from functools import partial

import jax
import jax.numpy as jnp

from ..base.checks import positive
from ..base.derivatives import changed, with_rule, with_slope
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
    # The laws share one support, so their forces do not add.
    parts = Law.parts

    def __init__(self, law: Law, support: Parameter):
        self.law = law
        self.support = positive("support", support)

    def _moved(self, e):
        return _share(self.law, self.support, e)

    def force(self, e):
        return self.law.force(self._moved(e))

    def energy(self, e):
        x = self._moved(e)
        return self.law.energy(x) + self.law.force(x) ** 2 / (2 * self.support)


def _share(law, support, e):
    # Solve x + law.force(x)/support = e for x.
    numbers, tree = jax.tree.flatten((law, support, e))

    def residual(x, numbers):
        law, support, e = jax.tree.unflatten(tree, numbers)
        return x + law.force(x) / support - e

    def rule(numbers, changes):
        x = find(*numbers)
        _, slope = with_slope(lambda x: residual(x, numbers), x)
        _, moved = changed(lambda *numbers: residual(x, numbers), numbers, changes)
        return x, -moved / slope

    # One function, which is traced once however often the rule calls it.
    root = lambda *numbers: _root(residual, numbers)
    find = partial(with_rule, root, rule)
    return find(*numbers)


def _root(residual, numbers):
    # Newton's method within a bracket; `numbers` end with e.
    def step(carry):
        low, high, x, _, count = carry
        value, slope = with_slope(lambda x: residual(x, numbers), x)
        below = value < 0  # NaN, where magnets met, counts as above
        low = jnp.where(below, x, low)
        high = jnp.where(below, high, x)
        better = x - value / slope
        inside = (better >= low) & (better <= high)
        better = jnp.where(value == 0, x, jnp.where(inside, better, (low + high) / 2))
        return (
            low,
            high,
            better,
            jnp.abs(better - x) > 2 * jnp.finfo(x.dtype).eps * jnp.abs(better),
            count + 1,
        )

    e = numbers[-1]
    like = residual(e, numbers)
    e = jnp.broadcast_to(e, jnp.shape(like)).astype(like.dtype)
    zero = jnp.zeros_like(e)
    start = jnp.minimum(e, zero), jnp.maximum(e, zero), e, jnp.full(e.shape, True), 0
    return jax.lax.while_loop(lambda c: jnp.any(c[3]) & (c[4] < NEWTON_STEPS), step, start)[2]
