"""Shooting for forced orbits in numbers of order one, whatever the units of the lattice."""

import math
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree

from ..flow import Flow
from ..lattice import State
from ..orbits import FullPeriod


class Shooting(eqx.Module):
    """`FullPeriod` in units of an orbit's size: its unknowns have the norm of the relative amplitude.

    The scene of `residual` and `linearise` is the pair (lattice, period).
    """

    whole: FullPeriod
    scale: jax.Array

    @classmethod
    def of(cls, lattice, period, guess, flow, t0, segments):
        """For orbits of about the size of `guess`, or of where it is a period later, if that is more."""
        whole_period = FullPeriod.of(lattice, _part(flow, segments), None, t0, segments)
        end = flow(guess, t0, t0 + period, lattice)
        n, omega = whole_period.size // 2, 2 * jnp.pi / period
        x = jnp.stack([ravel_pytree(y)[0] for y in (guess, end)])
        size = jnp.maximum(jnp.max(jnp.abs(x[:, :n])), jnp.max(jnp.abs(x[:, n:])) / omega)
        size = jnp.where((size > 0) & jnp.isfinite(size), size, 1) * math.sqrt(2 * n * segments)
        one = jnp.concatenate([jnp.full(n, size), jnp.full(n, size * omega)])
        return cls(whole_period, jax.lax.stop_gradient(jnp.tile(one, segments)))

    def guess(self, state, scene):
        """The unknowns of a state at t0."""
        return self.whole.guess(state, scene) / self.scale

    def state(self, x):
        """The state at t0 that the unknowns describe."""
        return State(*self.whole.state(self.scale * x))

    def residual(self, x, scene):
        """Gaps between the segments."""
        return self.whole.residual(self.scale * x, scene) / self.scale

    def linearise(self, x, scene):
        """The residual and its derivative in the unknowns."""
        f, jacobian = self.whole.linearise(self.scale * x, scene)
        return f / self.scale, jacobian * self.scale / self.scale[:, None]


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


def _part(flow, segments):
    return Flow(flow.steps // segments, flow.solver)
