"""A contact in series with a spring: a wall or a support that gives way."""

from functools import partial

import jax
import jax.numpy as jnp

from ..checks import positive, refuse
from .base import Law

NEWTON_STEPS = 12


class Yielding(Law):
    r"""A law in series with a linear spring of stiffness k: F(e) = F_law(x), where x + F_law(x)/k = e.

    The compression e is shared between the contact (x) and what it leans on (F/k). Energy: energy_law(x) + F^2/(2k).
    The inner law must have a force that does not fall with compression. The equation is solved by Newton's method,
    12 steps, which converges from one side for a convex law; the derivative is that of the implicit function.

    **Arguments:** `law`; `support`: k > 0 [N/m]; k much above the contact's stiffness is a rigid wall.
    **Raises** ValueError for k <= 0 or a law that is none.
    """

    law: Law
    support: jax.Array

    def __init__(self, law, support):
        if not isinstance(law, Law):
            refuse("law", "a law, such as Hertz()", repr(law))
        self.law, self.support = law, positive("support", support)

    def _inner(self, e):
        return _share(self.law, self.support, e)

    @property
    def preload(self):
        return self.law.preload

    def force(self, e):
        return self.support * (e - self._inner(e))

    def energy(self, e):
        x = self._inner(e)
        return self.law.energy(x) + self.support / 2 * (e - x) ** 2

    def overlap(self, e):
        return self.law.overlap(self._inner(e))


@partial(jax.custom_jvp, nondiff_argnums=())
def _share(law, support, e):
    """Solve x + law.force(x)/support = e for x."""

    def newton(_, x):
        residual, slope = jax.jvp(lambda x: x + law.force(x) / support - e, (x,), (jnp.ones_like(x),))
        return x - residual / slope

    x = jnp.broadcast_to(e, jnp.shape(e + law.force(e) / support))
    return jax.lax.fori_loop(0, NEWTON_STEPS, newton, x)


@_share.defjvp
def _share_jvp(primals, tangents):
    law, support, e = primals
    x = _share(law, support, e)
    _, slope = jax.jvp(lambda x: x + law.force(x) / support, (x,), (jnp.ones_like(x),))
    _, moved = jax.jvp(lambda law, support: x + law.force(x) / support, (law, support), tangents[:2])
    return x, (tangents[2] - moved) / slope
