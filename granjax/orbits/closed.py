"""Shooting over a whole period, in one segment or several."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree

from ..flow import Flow
from ..lattice import State, spread_mass, vector_field
from .symmetry import shifts


class FullPeriod(eqx.Module):
    r"""Shooting over a whole period: y(t0 + T) = y(t0), in m segments.

    Unknowns are the states at the m segments' beginnings, (m 2n,); each segment must end where the next begins. One
    segment multiplies every error by the largest multiplier; several keep long or strongly unstable orbits within
    Newton's reach.

    An orbit of an autonomous, conservative lattice is not isolated: it may be moved along itself and, with free ends,
    as a whole. `reference` (a state, None for driven or damped orbits) then fixes its phase,
    (y - y_ref) . f(y_ref) = 0, and the mean displacement is zero; multipliers of the energy's gradient and of the
    uniform velocity, zero at the root, keep the system square. They belong to orbits at a given period.

    **Arguments:** `flow`: a `Flow` whose `steps` cover one segment. `like`: a state, for its structure. `segments`: m.
    `t0`: phase of the drive at which the orbit begins.

    The scene of `residual` and `linearise` is the pair (lattice, period).
    """

    flow: Flow
    like: object
    moves: jax.Array
    reference: object
    t0: float = 0.0
    segments: int = eqx.field(static=True, default=1)

    @classmethod
    def of(cls, lattice, flow, reference=None, t0=0.0, segments=1):
        """For a lattice; with a `reference` its free displacements are found."""
        moves = shifts(lattice)
        moves = moves[:, :0] if reference is None else moves
        like = State(lattice.zeros(), lattice.zeros()) if reference is None else reference
        return cls(flow, like, moves, reference, t0, segments)

    @property
    def size(self):
        """Numbers in one state, 2n."""
        return 2 * self.moves.shape[0]

    def guess(self, state, scene):
        """The unknowns of a state: it is run through the period for the beginnings of later segments."""
        lattice, period = scene
        starts = [state]
        for i in range(self.segments - 1):
            state = self.flow(state, *self._times(i, period), lattice)
            starts.append(state)
        multipliers = jnp.zeros(0 if self.reference is None else 1 + self.moves.shape[1], self.moves.dtype)
        return jnp.concatenate([*(ravel_pytree(y)[0] for y in starts), multipliers])

    def state(self, x):
        """The state at t0 that the unknowns describe."""
        return ravel_pytree(self.like)[1](x[: self.size])

    def residual(self, x, scene):
        """Gaps between the segments, then the conditions."""
        lattice, period = scene
        starts, _ = self._parts(x)
        unravel = ravel_pytree(self.like)[1]

        def end(start_and_index):
            start, i = start_and_index
            return ravel_pytree(self.flow(unravel(start), *self._times(i, period), lattice))[0]

        return self._conditions(x, jax.lax.map(end, (starts, self._indices())), lattice)

    def linearise(self, x, scene):
        """The residual and its derivative in the unknowns, from one pass with tangents."""
        lattice, period = scene
        starts, _ = self._parts(x)
        unravel = ravel_pytree(self.like)[1]

        def one(start_and_index):
            start, i = start_and_index
            end, derivative = self.flow.derivative(unravel(start), *self._times(i, period), lattice)
            return ravel_pytree(end)[0], derivative

        ends, blocks = jax.lax.map(one, (starts, self._indices()))
        m, size = self.segments, self.size
        # the conditions by themselves, whose derivative costs nothing beside the flow's
        jacobian = jax.jacfwd(lambda x: self._conditions(x, jax.lax.stop_gradient(ends), lattice))(x)
        for i in range(m):
            jacobian = jacobian.at[i * size : (i + 1) * size, i * size : (i + 1) * size].add(blocks[i])
        return self._conditions(x, ends, lattice), jacobian

    def _indices(self):
        return jnp.arange(self.segments, dtype=self.moves.dtype)

    def _times(self, i, period):
        length = period / self.segments
        return self.t0 + i * length, self.t0 + (i + 1) * length

    def _parts(self, x):
        count = self.segments * self.size
        return x[:count].reshape(self.segments, self.size), x[count:]

    def _conditions(self, x, ends, lattice):
        starts, multipliers = self._parts(x)
        gaps = ends - jnp.roll(starts, -1, axis=0)
        if self.reference is None:
            return gaps.ravel()
        n, (u, _) = self.size // 2, self.state(x)
        reference = ravel_pytree(self.reference)[0]
        field = ravel_pytree(vector_field(self.t0, self.reference, lattice))[0]
        rate = jnp.sqrt(jnp.sum(field**2))
        along = field / jnp.where(rate > 0, rate, 1)
        # the energy's gradient (-F, m v) is where no state can go
        mass = ravel_pytree(spread_mass(lattice))[0]
        gradient = jnp.concatenate([-mass * along[n:], mass * along[:n]])
        uniform = jnp.concatenate([jnp.zeros_like(self.moves), self.moves])
        gaps = gaps.at[-1].add(multipliers[0] * gradient + uniform @ multipliers[1:])
        phase = along @ (starts[0] - reference)
        mean = (self.moves.T * mass / mass.sum()) @ ravel_pytree(u)[0]
        return jnp.concatenate([gaps.ravel(), phase[None], mean])
