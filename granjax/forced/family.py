"""Forced orbits over a parameter, as one problem."""

from collections.abc import Callable

import equinox as eqx
import jax

from ..orbits import Shooting


class Family(eqx.Module):
    """The orbits of a lattice that depends on one parameter, p = start + q span, as a problem F(x, q) = 0."""

    shooting: Shooting
    make: Callable
    period: Callable | jax.Array
    start: jax.Array
    span: jax.Array

    def scene(self, q):
        """(lattice, period) at q."""
        p = self.start + q * self.span
        return self.make(p), period_at(self.period, p)

    def residual(self, x, q, args):
        """Gaps between the segments at q."""
        return self.shooting.residual(x, self.scene(q))

    def linearise(self, x, q, args):
        """The residual and its derivative in x."""
        return self.shooting.linearise(x, self.scene(q))


def period_at(period, p):
    """The period at a value of the parameter: a number, or a function of it."""
    return period(p) if callable(period) else period
