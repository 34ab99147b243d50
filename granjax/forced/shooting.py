"""Shooting for forced orbits in numbers of order one, whatever the units of the lattice."""

import math
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree

from ..checks import concrete, refuse, whole
from ..flow import Flow, linear_frequency
from ..lattice import State
from ..orbits import FullPeriod

# h omega of the default step, with omega the highest linear frequency
STEP_FRACTION = 0.3
LEAST_STEPS = 16


class Shooting(eqx.Module):
    """`FullPeriod` in units of an orbit's size: its unknowns have the norm of the relative amplitude.

    The scene of `residual` and `linearise` is the pair (lattice, period).
    """

    whole: FullPeriod
    scale: jax.Array

    @classmethod
    def of(cls, lattice, period, seed, flow, t0, segments):
        """For orbits of about the size of `seed`, or of where it is a period later, if that is more."""
        whole_period = FullPeriod.of(lattice, _part(flow, segments), None, t0, segments)
        end = flow(seed, t0, t0 + period, lattice)
        n, omega = whole_period.size // 2, 2 * jnp.pi / period
        x = jnp.stack([ravel_pytree(y)[0] for y in (seed, end)])
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


def flow_over(lattice, period, steps, segments, solver):
    """The flow over a period; a given number of steps is static, the default one an array."""
    if steps is not None:
        if whole("steps", steps, segments) % segments:
            refuse("steps", f"a multiple of the {segments} segments", repr(steps))
        return Flow(int(steps), solver)
    omega = linear_frequency(lattice)
    value = concrete(omega)
    if value is not None and not value > 0:
        refuse("steps", "steps per period", "None", "Nothing is stiff at rest (a sonic vacuum): give steps=.")
    count = jnp.ceil(period * omega / STEP_FRACTION / segments).astype(int)
    return Flow(segments * jnp.maximum(count, -(-LEAST_STEPS // segments)), solver)


def history(flow, lattice, state, t0, period, frames):
    """`frames` equal parts of a period from t0 on, without its end: (times, states with a leading axis)."""
    between = Flow(-(-flow.steps // frames), flow.solver)
    length = period / frames
    ts = t0 + length * jnp.arange(frames)

    def one(y, t):
        return between(y, t, t + length, lattice), y

    return ts, jax.lax.scan(one, State(*state), ts)[1]


def _part(flow, segments):
    return Flow(flow.steps // segments, flow.solver)
