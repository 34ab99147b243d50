"""Time-periodic orbits as roots of a residual, y(t0 + T) = S y(t0), S a symmetry of the lattice."""

import dataclasses
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Float

from ..base.checks import described, refuse
from ..base.derivatives import with_slope
from ..base.printing import told
from ..base.programs import compiled, in_numpy, library
from ..base.types import AnyArray, Count, Counts, Number, Numbers, Scalar, StateLike
from ..continuation.arclength import Curve, Problem, System, continuation
from ..flow import Flow
from ..flow.stepping import columns, matrix
from ..lattice import Lattice, State, vector_field
from ..states import rest
from .asked import Symmetry, free_moves, known_lattice, masses, shifts


class Shooting(eqx.Module):
    r"""Shooting for y(t0 + T) = S y(t0), in m segments, in units of `scale`.

    The unknowns are the states at the beginnings of the segments over their scale, (m 2n,). Each
    segment must end where the next begins, the last one at S of the first. A single segment
    multiplies every error by the largest multiplier; several bring long or strongly unstable orbits
    within reach of Newton's method.

    An orbit of an autonomous, conservative lattice is not isolated: it can be moved along itself
    and, with free ends or on a ring, as a whole. A `reference` state (None for driven or damped
    orbits) then fixes its phase, (y - y_ref) . f(y_ref) = 0, and the mean displacement is zero.
    Multipliers of the energy's gradient and of the uniform velocity, zero at an orbit, keep the
    system square. These conditions belong to orbits of a given period. A freely moving lattice
    under forcing has its mean displacement added to the gap of the mean velocity: both are zero
    unless it drifts.

    For a `reversible` orbit (forces of positions alone, even in t) half a period between two rests
    is enough, in one segment. The unknowns are the displacements at rest, and v(T/2) = 0 replaces
    the gap.

    **Arguments:** `flow`: a `Flow` whose `steps` cover one segment. `like`: a state, for its
    structure. `scale` (2n,). `moves`: (n, k), the uniform displacements that cost no energy and are
    invariant under S. `t0`: phase of the drive at the start of the orbit.

    The scene of `residual`, `linearise` and `slopes` is the pair (lattice, period).
    """

    flow: Flow
    like: State
    scale: Float[AnyArray, " two_n"]
    moves: Float[AnyArray, "n k"]
    reference: State | None = None
    t0: Scalar = 0.0
    symmetry: Symmetry = Symmetry()
    segments: int = eqx.field(static=True, default=1)
    reversible: bool = eqx.field(static=True, default=False)
    __repr__ = told

    @classmethod
    def of(
        cls,
        lattice: Lattice,
        flow: Flow,
        reference: StateLike | None = None,
        t0: Scalar = 0.0,
        segments: Count = 1,
        *,
        scale: Numbers | None = None,
        symmetry: Symmetry = Symmetry(),
    ) -> "Shooting":
        """Pose the problem over whole periods; a `reference` fixes free displacements too."""
        moves = free_moves(lattice, symmetry)
        scale = jnp.ones(2 * len(moves), moves.dtype) if scale is None else scale
        reference = None if reference is None else State(*reference)
        return cls(flow, rest(lattice), scale, moves, reference, t0, symmetry, segments)

    @classmethod
    def half(
        cls, lattice: Lattice, flow: Flow, *, length: Scalar = 1.0, omega: Scalar = 1.0
    ) -> "Shooting":
        """Pose the problem over half a period between two rests.

        Displacements are in units of `length`, velocities of length * omega.
        """
        moves = shifts(lattice)
        xp = library(length, omega)
        length, omega = (xp.asarray(x, moves.dtype) for x in (length, omega))
        unit = xp.ones(len(moves), moves.dtype)
        scale = jax.device_put(xp.concatenate([length * unit, length * omega * unit]))
        return cls(flow, rest(lattice), scale, moves, reversible=True)

    def finer(self, by: Scalar) -> "Shooting":
        """Return the same problem with `by` times as many time steps."""
        by, steps = in_numpy((by, self.flow.steps))
        steps = jax.device_put(library(by, steps).ceil(by * steps).astype(int))
        return eqx.tree_at(lambda s: s.flow.steps, self, steps)

    def in_one(self) -> "Shooting":
        """Return the problem with one segment."""
        return dataclasses.replace(self.finer(self.segments), segments=1)

    @property
    def driven(self) -> bool:
        """Whether forcing sets the phase."""
        return self.reference is None and not self.reversible

    @property
    def whole(self) -> Flow:
        """The flow over the whole period."""
        return Flow(self.parts * self.flow.steps, self.flow.solver, self.flow.field)

    @property
    def parts(self) -> int:
        """How many segments a period has."""
        return 2 if self.reversible else self.segments

    @property
    def count(self) -> int:
        """The number of displacements, n."""
        return self.moves.shape[0]

    @property
    def size(self) -> int:
        """The number of unknowns of the first state: 2n, or n for a reversible orbit."""
        return self.count if self.reversible else 2 * self.count

    @compiled
    def guess(self, state: StateLike, scene: tuple | None = None) -> Numbers:
        """Return the unknowns of a state at t0; later segments begin where it is run to."""
        starts = [state]
        for i in range(self.segments - 1):
            state = self.flow(state, *self._times(i, scene[1]), scene[0])
            starts.append(state)
        x = jnp.concatenate([ravel_pytree(y)[0] / self.scale for y in starts])
        first = x[: self.size]
        rest = x[2 * self.count :]
        count = 0 if self.driven else self.moves.shape[1] + (self.reference is not None)
        return jnp.concatenate([first, rest, jnp.zeros(count, x.dtype)])

    @compiled
    def state(self, x: Numbers) -> State:
        """Return the state at t0 of the unknowns, or its change for a change of them."""
        return ravel_pytree(self.like)[1](self._parts(x)[0][0] * self.scale)

    def residual(self, x: Numbers, scene: tuple) -> Numbers:
        """Return the gaps between the segments, then the conditions."""
        lattice, period = scene
        starts, idle = self._parts(x)
        unravel = ravel_pytree(self.like)[1]

        def end(start_and_index):
            start, i = start_and_index
            after = self.flow(unravel(start * self.scale), *self._times(i, period), lattice)
            return ravel_pytree(after)[0] / self.scale

        return self._conditions(starts, idle, self._each(end, starts), lattice)

    def linearise(self, x: Numbers, scene: tuple) -> tuple:
        """Return the residual and its derivative in the unknowns, from one pass with tangents."""
        return self.slopes(x, scene)[:2]

    def slopes(self, x: Numbers, scene: tuple) -> tuple:
        """Return the residual and its derivatives in the unknowns and in the period.

        The latter is that of an autonomous lattice.
        """
        lattice, period = scene
        starts, _ = self._parts(x)
        unravel = ravel_pytree(self.like)[1]
        # The velocities of a reversible orbit stay zero.
        unit = columns(self.like, jnp.diag(self.scale)[:, : self.size])

        def one(start_and_index):
            start, i = start_and_index
            begin, after = self._times(i, period)
            y = unravel(start * self.scale)
            end, moved = self.flow.tangents(y, unit, begin, after, lattice)
            ends = end, vector_field(after, end, lattice)
            end, field = (ravel_pytree(y)[0] / self.scale for y in ends)
            return end, matrix(moved) / self.scale[:, None], field

        ends, maps, fields = self._each(one, starts)
        near = self.near(lattice, x, ends, maps)
        changed = lambda x, change: near(x, change * fields / self.parts)
        here = x, jnp.zeros((), x.dtype)
        return changed(*here), *jax.jacfwd(changed, (0, 1))(*here)

    def near(self, lattice: Lattice, x: Numbers, ends: Numbers, maps: Numbers) -> Callable:
        """Return the residual beside x to first order, as a function."""
        # The `ends` (m, 2n) of the segments and their derivatives `maps` belong to x. The function
        # takes unknowns, and a change of the ends.
        starts, _ = self._parts(x)

        def residual(x, change=0.0):
            there, idle = self._parts(x)
            moved = jnp.einsum("mij,mj->mi", maps, (there - starts)[:, : maps.shape[-1]])
            return self._conditions(there, idle, ends + moved + change, lattice)

        return residual

    def means(self, lattice: Lattice) -> Numbers:
        """Return the matrix from displacements to their mean along each free move, (k, n)."""
        mass = masses(lattice)
        return self.moves.T * mass / mass.sum()

    def gap(self, lattice: Lattice, x: Numbers) -> Number:
        """Return the largest gap that a root hides, by drift or multiplier, in units of `scale`."""
        starts, idle = self._parts(x)
        if self.reference is not None:
            return jnp.abs(idle[0]) * jnp.max(jnp.abs(self._directions(lattice)[1]))
        if self.reversible or not self.moves.size:
            return 0.0
        return jnp.max(jnp.abs(self.moves @ (self.means(lattice) @ starts[0, : self.count])))

    def _each(self, function, starts):
        # The values of a function of (start, index of the segment).
        return jax.lax.map(function, (starts, jnp.arange(self.segments, dtype=self.moves.dtype)))

    def _times(self, i, period):
        length = period / self.parts
        return self.t0 + i * length, self.t0 + (i + 1) * length

    def _parts(self, x):
        # The states at the beginnings of the segments over their scale, (m, 2n), and the
        # multipliers.
        n = self.count
        count = (self.segments - 1) * 2 * n + self.size
        starts = x[:count]
        idle = x[count:]
        if self.reversible:
            starts = jnp.concatenate([starts, jnp.zeros_like(starts)])
        return starts.reshape(self.segments, 2 * n), idle

    def _image(self, x):
        return ravel_pytree(self.symmetry(ravel_pytree(self.like)[1](x)))[0]

    def _conditions(self, starts, idle, ends, lattice):
        n = self.count
        mean = self.means(lattice) @ starts[0, :n]
        gaps = ends - jnp.concatenate([starts[1:], self._image(starts[0])[None]])
        if self.reversible:
            return jnp.concatenate([ends[0, n:] + self.moves @ idle, mean])
        if self.driven:
            return gaps.at[-1, n:].add(self.moves @ mean).ravel()
        along, gradient = self._directions(lattice)
        uniform = jnp.concatenate([jnp.zeros_like(self.moves), self.moves])
        gaps = gaps.at[-1].add(self._image(idle[0] * gradient + uniform @ idle[1:]))
        phase = along @ (starts[0] - ravel_pytree(self.reference)[0] / self.scale)
        return jnp.concatenate([gaps.ravel(), phase[None], mean])

    def _directions(self, lattice):
        # Unit vectors at the reference: along the orbit, and along the energy's gradient (-F, m v).
        # No state can move a little along the latter, since its energy stays. A long way may lead
        # through the surface of equal energy to its other side: a root that is no orbit.
        n = self.count
        weights = masses(lattice)
        field = ravel_pytree(vector_field(self.t0, self.reference, lattice))[0]
        gradient = jnp.concatenate([-weights * field[n:], weights * field[:n]])
        return _unit(field / self.scale), _unit(self.scale * gradient)


def _unit(x):
    size = jnp.sqrt(jnp.sum(x**2))
    return x / jnp.where(size > 0, size, 1)


class Family(Problem):
    """The orbits of a lattice over one parameter, p = start + q span, as a problem F(x, q) = 0.

    `make(p)`: the lattice, or one lattice for all. `period`: T, a number or a function of p. With a
    single autonomous lattice, the derivative in q is that in the period. `left`: the residual that
    Newton's method may leave.
    """

    shooting: Shooting
    make: Callable | Lattice
    period: Callable | Scalar
    start: Scalar = 0.0
    span: Scalar = 1.0
    left: Scalar = 1e-11
    __repr__ = told

    def value(self, q: Number) -> Number:
        """Return the parameter p at q."""
        return self.start + q * self.span

    def with_steps(self, steps: Count | Counts) -> "Family":
        """Return the same with other steps per segment, an array: new values compile nothing."""
        return eqx.tree_at(lambda f: f.shooting.flow.steps, self, jnp.asarray(steps, int))

    def follow(self, x: Numbers, q: Scalar, **settings: Any) -> Curve:
        """Return the curve of orbits from (x, q), with the settings of `continuation`."""
        return continuation(self, x, q, tolerance=self.left, **settings)

    def system(self) -> System:
        """Return the system that continuation solves at every point."""
        return System(self, self.left)

    def scene(self, q: Scalar) -> tuple:
        """Return (lattice, period) at q."""
        p = self.value(q)
        return self.make if isinstance(self.make, Lattice) else self.make(p), period_at(
            self.period, p
        )

    def residual(self, x: Numbers, q: Scalar) -> Numbers:
        """Return the gaps between the segments at q."""
        return self.shooting.residual(x, self.scene(q))

    def linearise(self, x: Numbers, q: Scalar) -> tuple:
        """Return the residual, its derivative in x, and that in q where it costs nothing."""
        gaps, in_x, in_period = self.shooting.slopes(x, self.scene(q))
        if not isinstance(self.make, Lattice):
            return gaps, in_x
        return gaps, in_x, in_period * with_slope(lambda q: self.scene(q)[1], q)[1]


def period_at(period: Callable | Scalar, p: Scalar) -> Scalar:
    """Return the period, a number or a function of the parameter, at a value of it."""
    return period(p) if callable(period) else period


def made(make: Callable, period: Callable | Scalar, p: Scalar) -> tuple[Lattice, Scalar]:
    """Return the lattice and the period that user-defined functions give at a parameter value."""
    lattice = known_lattice(make(jnp.asarray(p)))
    T = period_at(period, p)
    if np.ndim(T) or not 0 < float(T) < np.inf:
        refuse("period", "a time above zero, or a function that gives one", described(T))
    return lattice, jnp.asarray(T)


def over_omega(omega: Scalar) -> Scalar:
    """Return T = 2 pi/omega."""
    return 2 * jnp.pi / omega
