"""Time-reversible orbits: half a period between two rests."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree

from ..flow import Flow
from ..lattice import State, spread_mass
from .symmetry import shifts


class HalfPeriod(eqx.Module):
    r"""Shooting over half a period for an orbit that is at rest twice: v(0) = 0, v(T/2) = 0.

    Holds for forces that depend on u alone (autonomous, even in t): the orbit then retraces its path. Unknowns are
    the n displacements at rest, with n equations v(T/2) = 0. Where the lattice as a whole may be displaced (free ends,
    a ring) the momentum makes one equation idle: the mean displacement, weighted by mass, is set to zero instead, and
    a multiplier of the uniform velocity, zero at the root, keeps the system square.

    **Arguments:** `flow`: a `Flow` whose `steps` cover half a period. `like`: displacements, for their structure.
    `moves`: (n, k), the uniform displacements that cost no energy.

    The scene of `residual` and `linearise` is the pair (lattice, period).
    """

    flow: Flow
    like: object
    moves: jax.Array

    @classmethod
    def of(cls, lattice, flow):
        """For a lattice, its free displacements found."""
        return cls(flow, lattice.zeros(), shifts(lattice))

    @property
    def size(self):
        """Number of displacements."""
        return self.moves.shape[0]

    def guess(self, state):
        """The unknowns of a state; its velocities are dropped."""
        return jnp.concatenate([ravel_pytree(state.u)[0], jnp.zeros(self.moves.shape[1], self.moves.dtype)])

    def state(self, x):
        """The state at rest that the unknowns describe."""
        u = ravel_pytree(self.like)[1](x[: self.size])
        return State(u, jax.tree.map(jnp.zeros_like, u))

    def residual(self, x, scene):
        """v(T/2) and the mean displacement, (n + k,)."""
        lattice, period = scene
        end = self.flow(self.state(x), 0.0, period / 2, lattice)
        return self._conditions(x, ravel_pytree(end.v)[0], lattice)

    def linearise(self, x, scene):
        """The residual and its derivative in the unknowns, from one pass with tangents."""
        return self.slopes(x, scene)[:2]

    def slopes(self, x, scene):
        """The residual, its derivative in the unknowns, and that in the period, which is half the end's acceleration.
        """
        lattice, period = scene
        unravel = ravel_pytree(self.like)[1]
        unit = jax.vmap(unravel, out_axes=-1)(jnp.eye(self.size, dtype=x.dtype))
        tangents = State(unit, jax.tree.map(jnp.zeros_like, unit))
        end, moved = self.flow.tangents(self.state(x), tangents, 0.0, period / 2, lattice)
        rows = jnp.concatenate([leaf.reshape(-1, self.size) for leaf in jax.tree.leaves(moved.v)])
        jacobian = jnp.block([[rows, self.moves], [self._mean(lattice), jnp.zeros((self.moves.shape[1],) * 2)]])
        acceleration = ravel_pytree(lattice.acceleration(period / 2, *end))[0]
        in_period = jnp.append(acceleration / 2, jnp.zeros(self.moves.shape[1]))
        return self._conditions(x, ravel_pytree(end.v)[0], lattice), jacobian, in_period

    def _mean(self, lattice):
        weights = ravel_pytree(spread_mass(lattice))[0]
        return self.moves.T * weights / weights.sum()

    def _conditions(self, x, velocity, lattice):
        u, multipliers = x[: self.size], x[self.size :]
        return jnp.concatenate([velocity + self.moves @ multipliers, self._mean(lattice) @ u])
