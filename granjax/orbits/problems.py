"""Time-periodic orbits as roots of one residual, y(t0 + T) = S y(t0), with a symmetry S of the lattice."""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Float

from ..checks import refuse, whole
from ..flow import Flow
from ..lattice import Lattice, State, spread_mass, vector_field
from ..outside import Outside
from ..terms.tracing import reads
from ..types import AnyArray, Count, Numbers, Pytree, Scalar, StateLike
from .symmetry import shifts

# where in a period forces are compared: at no simple fraction, where waveforms have their zeros and jumps
PHASES, MORE = ((0.1 + 0.618034 * np.arange(count)) % 1 for count in (4, 32))
# displacements at which a modulation is looked for where the state has none
SIZES = (1e-9, 1e-6, 1e-3, 1.0)


class Symmetry(eqx.Module):
    r"""S of y(t0 + T) = S y(t0): displacements moved by some cells, reflected, with a sign; velocities alike.

    (S u)_n = sign u_{n - cells}, and with `mirror` first u_n -> -u_{N-1-n}: displacements along a chain turn around
    with it, so that compressions are reflected. `cells` counts places along the first axis of every field.

    `Translation(1)`, `Mirror()` and `Sign()` make one, and `a @ b` is b, then a.
    """

    cells: int = eqx.field(static=True, default=0)
    mirror: bool = eqx.field(static=True, default=False)
    sign: int = eqx.field(static=True, default=1)

    def __repr__(self) -> str:
        parts = {"Sign()": self.sign < 0, f"Translation({self.cells})": self.cells, "Mirror()": self.mirror}
        return " @ ".join(name for name, there in parts.items() if there) or "the identity"

    @property
    def trivial(self) -> bool:
        """Whether it is the identity."""
        return self == Symmetry()

    def matrix(self, like: StateLike) -> Float[np.ndarray, "two_n two_n"]:
        """S over the raveled state, (2n, 2n); S^-1 is its transpose."""
        flat, unravel = ravel_pytree(like)
        return np.asarray(jax.vmap(lambda x: ravel_pytree(self(unravel(x)))[0], 1, 1)(jnp.eye(flat.size)))

    def __matmul__(self, other: "Symmetry") -> "Symmetry":
        turned = -other.cells if self.mirror else other.cells
        return Symmetry(self.cells + turned, self.mirror != other.mirror, self.sign * other.sign)

    def __call__(self, y: Pytree) -> Pytree:
        """S of displacements, or of a state."""
        def one(x):
            x = -x[::-1] if self.mirror else x
            return self.sign * (jnp.roll(x, self.cells, 0) if self.cells else x)

        return y if self.trivial else jax.tree.map(one, y)


def Translation(cells: Count = 1) -> Symmetry:
    """The wave reappears `cells` further on after a period: a rotating wave of a ring, or one that travels."""
    return Symmetry(cells=whole("cells", cells, -(2**31)))


def Mirror() -> Symmetry:
    """The motion is its own mirror image half of its full period later."""
    return Symmetry(mirror=True)


def Sign() -> Symmetry:
    """The motion is its own negative half of its full period later, in lattices of odd forces."""
    return Symmetry(sign=-1)


def checked_state(lattice: Lattice, state: StateLike, argument: str = "state") -> State:
    """A pair as a `State` of the lattice's shape and type."""
    if not isinstance(state, (tuple, list)) or len(state) != 2:
        refuse(argument, "a State", f"a {type(state).__name__}")
    wanted = [x.shape for x in jax.tree.leaves(lattice.template())]
    for name, part in zip("uv", state):
        got = [np.shape(x) for x in jax.tree.leaves(part)]
        if got != wanted:
            refuse(f"{argument}.{name}", f"shape {lattice.shape}", f"{got}", "One orbit of one lattice at a time.")
    return jax.tree.map(lambda x: jnp.asarray(x, lattice.dtype), State(*state))


def one_lattice(lattice: Lattice) -> Lattice:
    """Refuse a batch of lattices."""
    if not isinstance(lattice, Lattice) or lattice.lanes:
        got = f"a batch with lanes {lattice.lanes}" if isinstance(lattice, Lattice) else f"a {type(lattice).__name__}"
        refuse("lattice", "one Lattice", got, "Ask for one lane at a time.")
    return lattice


def checked_symmetry(lattice: Lattice, symmetry: Symmetry, state: State, t0: Scalar, period: Scalar) -> Symmetry:
    """Refuse what is no symmetry of the lattice, as its forces at a state and at its image a period later say.

    Of the identity: a period after which the forces do not repeat.
    """
    if not isinstance(symmetry, Symmetry):
        refuse("symmetry", "a Symmetry, such as Translation(1)", f"a {type(symmetry).__name__}")
    if symmetry.trivial:
        checked_period(lattice, state, t0, period)
        return symmetry
    if any(isinstance(x, jax.core.Tracer) for x in jax.tree.leaves((lattice, state, t0, period))):
        return symmetry
    if symmetry.mirror and lattice.dimension is not None:
        refuse("symmetry", "translations and signs in the plane", repr(symmetry))
    ts, omega = phases(t0, period), 2 * np.pi / float(period)

    def accelerations(ts, u, v):
        return jax.vmap(lambda t: lattice.acceleration(t, u, v))(ts)

    zeros, rng = lattice.zeros(), np.random.default_rng(0)
    size = float(largest(state.u)) or float(largest(accelerations(ts, zeros, zeros))) / omega**2 or 1.0
    u, v = (jax.tree.map(lambda x: jnp.asarray(size * scale * rng.uniform(-1, 1, x.shape), x.dtype), state.u)
            for scale in (1.0, omega))
    there = jax.vmap(symmetry)(accelerations(ts, u, v))
    here = accelerations(ts + period, symmetry(u), symmetry(v))
    off = float(largest(jax.tree.map(jnp.subtract, there, here)))
    # of what time changes, the rounding is that of the static force beside it
    change, eps = float(largest(jax.tree.map(lambda a: a - a[0], there))), float(jnp.finfo(lattice.dtype).eps)
    if off <= 1e3 * eps * max(float(largest(there)), size * omega**2) + 100 * eps**0.5 * change:
        return symmetry
    refuse("symmetry", "a symmetry of the lattice", repr(symmetry), "Its image has other accelerations.")


def checked_period(lattice: Lattice, state: StateLike, t0: Scalar, period: Scalar) -> None:
    """Refuse a period after which the forces do not repeat, as the terms that read time say.

    At rest, where drives and walls show however little they do, and at displacements of the state's size, where
    modulations do; of a state at rest at those of several sizes.
    """
    traced = any(isinstance(x, jax.core.Tracer) for x in jax.tree.leaves((lattice, state, t0, period)))
    if traced or not lattice.reads_time:
        return
    eps, rng, own = float(jnp.finfo(lattice.dtype).eps), np.random.default_rng(0), float(largest(state[0]))
    shape = [rng.uniform(-1, 1, x.shape) for x in jax.tree.leaves(lattice.template())]
    shape = jax.tree.unflatten(jax.tree.structure(lattice.template()), shape)
    for size in (0.0, own) if own > 0 else (0.0, *SIZES):
        u, v = (jax.tree.map(lambda x: jnp.asarray(size * scale * x, lattice.dtype), shape)
                for scale in (1.0, 2 * np.pi / float(period)))
        found = _repeated(lattice, u, v, jnp.asarray(t0, float), jnp.asarray(period, float))
        off, change, there = map(float, found)
        # more than by the rounding of times and of the static force beside; a size may be beyond a law's range
        if np.isfinite(there) and off > 100 * (eps**0.5 * change + eps * there):
            refuse("period", "one after which the forces repeat", repr(float(period)),
                   "Give the drive's, or a multiple.")


@eqx.filter_jit
def _repeated(lattice, u, v, t0, period):
    """By how much the forces that read time differ a period later, by how much they change, how large they are."""
    terms = [term for term in lattice.terms if reads(term, lattice).time]

    def force(t):
        found = lattice.sum_forces(t, u, v, terms)
        contact = [largest(contact.force) for term in terms for contact in term.compressions(t, u)]
        return found, jnp.max(jnp.stack([largest(found), *contact]))

    ts = phases(t0, period, MORE)
    (now, size), (later, _) = (jax.lax.map(force, x) for x in (ts, ts + period))
    change = jax.tree.map(lambda a: a - a[0], now)
    return largest(jax.tree.map(jnp.subtract, now, later)), largest(change), jnp.max(size)


def phases(t0: Scalar, period: Scalar, shares: Float[np.ndarray, " m"] = PHASES) -> Numbers:
    """Times within a period, by default four."""
    return t0 + period * jnp.asarray(shares)


def largest(x: Pytree) -> Numbers:
    """The largest modulus in a tree of arrays, NaN where one is."""
    return jnp.max(jnp.stack([jnp.max(jnp.abs(leaf)) for leaf in jax.tree.leaves(x)]))


def free_moves(lattice: Lattice, symmetry: Symmetry) -> Numbers:
    """Uniform displacements that cost nothing and that S leaves alone, as columns (n, k)."""
    moves = shifts(lattice)
    return moves if symmetry.sign * (-1 if symmetry.mirror else 1) > 0 else moves[:, :0]


class Shooting(eqx.Module):
    r"""Shooting for y(t0 + T) = S y(t0), in m segments, in units of `scale`.

    Unknowns are the states at the segments' beginnings over their scale, (m 2n,); each segment must end where the next
    begins, the last one at S of the first. One segment multiplies every error by the largest multiplier; several keep
    long or strongly unstable orbits within Newton's reach.

    An orbit of an autonomous, conservative lattice is not isolated: it may be moved along itself and, with free ends or
    on a ring, as a whole. `reference` (a state; None for driven or damped orbits) then fixes its phase,
    (y - y_ref) . f(y_ref) = 0, and the mean displacement is zero; multipliers of the energy's gradient and of the
    uniform velocity, zero at the root, keep the system square. They belong to orbits at a given period.

    Of a `reversible` orbit (forces of positions alone, even in t) half a period between two rests is enough: unknowns
    are the displacements at rest, and v(T/2) = 0 in place of the last gap.

    **Arguments:** `flow`: a `Flow` whose `steps` cover one segment. `like`: a state, for its structure. `scale` (2n,).
    `moves`: (n, k), the uniform displacements that cost no energy and that S leaves alone. `t0`: phase of the drive at
    which the orbit begins.

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

    @classmethod
    def of(cls, lattice: Lattice, flow: Flow, reference: StateLike | None = None, t0: Scalar = 0.0,
           segments: Count = 1, *, scale: Numbers | None = None, symmetry: Symmetry = Symmetry()) -> "Shooting":
        """Over whole periods; with a `reference` the free displacements are found."""
        like, moves = State(lattice.zeros(), lattice.zeros()), free_moves(lattice, symmetry)
        moves = moves[:, :0] if reference is None else moves
        scale = jnp.ones(2 * len(moves), moves.dtype) if scale is None else scale
        reference = None if reference is None else State(*reference)
        return cls(flow, like, scale, moves, reference, t0, symmetry, segments)

    @classmethod
    def half(
        cls, lattice: Lattice, flow: Flow, segments: Count = 1, *, length: Scalar = 1.0, omega: Scalar = 1.0,
    ) -> "Shooting":
        """Over half a period between two rests, displacements counted in `length` and velocities in length * omega."""
        moves = shifts(lattice)
        like, unit = State(lattice.zeros(), lattice.zeros()), jnp.ones(len(moves), moves.dtype)
        scale = jnp.concatenate([length * unit, length * omega * unit])
        return cls(flow, like, scale, moves, segments=segments, reversible=True)

    def finer(self, by: Scalar) -> "Shooting":
        """The same with so many times the time steps."""
        steps = jnp.ceil(by * self.flow.steps).astype(int)
        return eqx.tree_at(lambda s: s.flow, self, Flow(steps, self.flow.solver, self.flow.field))

    def apart(self, change: Numbers) -> State:
        """The state that a change of the unknowns makes, in the lattice's own units."""
        return State(*ravel_pytree(self.like)[1](self._parts(change)[0][0] * self.scale))

    @property
    def count(self) -> int:
        """Number of displacements, n."""
        return self.moves.shape[0]

    @property
    def size(self) -> int:
        """Unknowns of the first state: 2n, or n of a reversible orbit."""
        return self.count if self.reversible else 2 * self.count

    @property
    def unknowns(self) -> int:
        """Length of the vector of unknowns."""
        conditions = self.moves.shape[1] + (self.reference is not None)
        return (self.segments - 1) * 2 * self.count + self.size + conditions

    def guess(self, state: StateLike, scene: tuple | None = None) -> Numbers:
        """The unknowns of a state at t0: it is run through the period for the beginnings of later segments."""
        starts = [state]
        for i in range(self.segments - 1):
            state = self.flow(state, *self._times(i, scene[1]), scene[0])
            starts.append(state)
        x = jnp.concatenate([ravel_pytree(State(*y))[0] / self.scale for y in starts])
        first, rest = x[: self.size], x[2 * self.count :]
        idle = jnp.zeros(self.moves.shape[1] + (self.reference is not None), x.dtype)
        return jnp.concatenate([first, rest, idle])

    def state(self, x: Numbers) -> State:
        """The state at t0 that the unknowns describe."""
        return State(*ravel_pytree(self.like)[1](self._parts(x)[0][0] * self.scale))

    def residual(self, x: Numbers, scene: tuple) -> Numbers:
        """Gaps between the segments, then the conditions."""
        lattice, period = scene
        starts, idle = self._parts(x)
        unravel = ravel_pytree(self.like)[1]

        def end(start_and_index):
            start, i = start_and_index
            after = self.flow(unravel(start * self.scale), *self._times(i, period), lattice)
            return ravel_pytree(after)[0] / self.scale

        return self._conditions(starts, idle, jax.lax.map(end, (starts, self._indices())), lattice)

    def linearise(self, x: Numbers, scene: tuple) -> tuple:
        """The residual and its derivative in the unknowns, from one pass with tangents."""
        return self.slopes(x, scene)[:2]

    def slopes(self, x: Numbers, scene: tuple) -> tuple:
        """The residual, its derivative in the unknowns, and that in the period of an autonomous lattice."""
        lattice, period = scene
        starts, _ = self._parts(x)
        unravel, n, m = ravel_pytree(self.like)[1], self.count, self.segments
        # of the only segment of a reversible orbit the velocities stay zero
        columns = n if self.reversible and m == 1 else 2 * n
        unit = jax.vmap(unravel, in_axes=-1, out_axes=-1)(jnp.diag(self.scale)[:, :columns])

        def one(start_and_index):
            start, i = start_and_index
            begin, after = self._times(i, period)
            end, moved = self.flow.tangents(unravel(start * self.scale), State(*unit), begin, after, lattice)
            rows = jnp.concatenate([leaf.reshape(-1, columns) for leaf in jax.tree.leaves(moved)])
            field = ravel_pytree(vector_field(after, end, lattice))[0]
            return ravel_pytree(end)[0] / self.scale, rows / self.scale[:, None], field / self.scale

        ends, blocks, fields = jax.lax.map(one, (starts, self._indices()))
        block = jax.scipy.linalg.block_diag(*blocks)
        fields = fields.ravel() / (2 * m if self.reversible else m)
        if self.reversible:  # at rest at either end
            block, fields = jnp.delete(block, slice((2 * m - 2) * n, (2 * m - 1) * n), 0), fields
            fields = jnp.delete(fields, slice((2 * m - 2) * n, (2 * m - 1) * n))
            block = block if m == 1 else jnp.delete(block, slice(n, 2 * n), 1)
        # the conditions by themselves, whose derivative costs nothing beside the flow's
        known = jax.lax.stop_gradient(ends)
        jacobian = jax.jacfwd(lambda x: self._conditions(*self._parts(x), known, lattice))(x)
        jacobian = jacobian.at[: len(block), : len(block)].add(block)
        in_period = jnp.concatenate([fields, jnp.zeros(x.size - fields.size, x.dtype)])
        return self._conditions(starts, self._parts(x)[1], ends, lattice), jacobian, in_period

    def _indices(self):
        return jnp.arange(self.segments, dtype=self.moves.dtype)

    def _times(self, i, period):
        length = (period / 2 if self.reversible else period) / self.segments
        return self.t0 + i * length, self.t0 + (i + 1) * length

    def _parts(self, x):
        """The states at the segments' beginnings over their scale, (m, 2n), and the multipliers."""
        n, count = self.count, (self.segments - 1) * 2 * self.count + self.size
        starts = jnp.concatenate([x[:n], jnp.zeros_like(x[:n]), x[n:count]]) if self.reversible else x[:count]
        return starts.reshape(self.segments, 2 * n), x[count:]

    def _image(self, x):
        """S of a raveled state."""
        return ravel_pytree(self.symmetry(ravel_pytree(self.like)[1](x)))[0]

    def _conditions(self, starts, idle, ends, lattice):
        n, weights = self.count, ravel_pytree(spread_mass(lattice))[0]
        mean = (self.moves.T * weights / weights.sum()) @ starts[0, :n]
        gaps = ends - jnp.concatenate([starts[1:], self._image(starts[0])[None]])
        if self.reversible:
            velocity = ends[-1, n:] + self.moves @ idle
            return jnp.concatenate([gaps[:-1].ravel(), velocity, mean])
        if self.reference is None:
            return gaps.ravel()
        field = ravel_pytree(vector_field(self.t0, self.reference, lattice))[0]
        along = _unit(field / self.scale)
        # the energy's gradient (-F, m v) and a uniform velocity are where no state can go
        gradient = _unit(self.scale * jnp.concatenate([-weights * field[n:], weights * field[:n]]))
        uniform = jnp.concatenate([jnp.zeros_like(self.moves), self.moves])
        gaps = gaps.at[-1].add(self._image(idle[0] * gradient + uniform @ idle[1:]))
        phase = along @ (starts[0] - ravel_pytree(self.reference)[0] / self.scale)
        return jnp.concatenate([gaps.ravel(), phase[None], mean])


def _unit(x):
    size = jnp.sqrt(jnp.sum(x**2))
    return x / jnp.where(size > 0, size, 1)


class Family(eqx.Module):
    """The orbits of a lattice over one parameter, p = start + q span, as a problem F(x, q) = 0.

    `make(p)`: the lattice, or one lattice for all. `period`: T, a number or a function of p. With one lattice that no
    time drives, the derivative in q is that in the period.
    """

    shooting: Shooting
    make: Callable | Lattice
    period: Callable | Scalar
    start: Scalar = 0.0
    span: Scalar = 1.0
    outside: Outside = Outside()

    def scene(self, q: Scalar) -> tuple:
        """(lattice, period) at q."""
        p = self.start + q * self.span
        return self.make if isinstance(self.make, Lattice) else self.make(p), period_at(self.period, p)

    def residual(self, x: Numbers, q: Scalar, args: None = None) -> Numbers:
        """Gaps between the segments at q."""
        return self.shooting.residual(x, self.scene(q))

    def linearise(self, x: Numbers, q: Scalar, args: None = None) -> tuple:
        """The residual, its derivative in x, and where it costs nothing that in q."""
        gaps, in_x, in_period = self.shooting.slopes(x, self.scene(q))
        if not isinstance(self.make, Lattice):
            return gaps, in_x
        return gaps, in_x, in_period * jax.jvp(lambda q: self.scene(q)[1], (q,), (jnp.ones_like(q),))[1]


def period_at(period: Callable | Scalar, p: Scalar) -> Scalar:
    """The period at a value of the parameter: a number, or a function of it."""
    return period(p) if callable(period) else period


def over_omega(omega: Scalar) -> Scalar:
    """T = 2 pi/omega."""
    return 2 * jnp.pi / omega
