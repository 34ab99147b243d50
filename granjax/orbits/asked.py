"""Checks of the inputs of orbit problems: lattice, state, period, symmetry, steps."""

import math
from collections.abc import Callable, Iterable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from diffrax import AbstractSolver, Dopri8
from jax.flatten_util import ravel_pytree
from jaxtyping import Float

from ..base.checks import concrete, described, refuse, traced, whole
from ..base.programs import compiled, in_numpy, library
from ..base.types import Count, Counts, Displacements, Numbers, Pytree, Scalar, StateLike, Times
from ..flow import Flow, frequency_bound, linear_frequency
from ..flow.arguments import facts
from ..flow.stepping import columns, matrix
from ..lattice import Lattice, State, spread_mass, uniform_moves
from ..solvers import SRKN11b, SRKN14a


class Symmetry(eqx.Module):
    r"""The map S of y(t0 + T) = S y(t0): translation, reflection and sign of a state.

    (S u)_n = sign u_{n - cells}, and with `mirror` first u_n -> -u_{N-1-n}: displacements along a
    chain change direction with it, so that compressions are reflected. Velocities are mapped alike.
    `cells` counts along the first axis of every field.

    `Translation(1)`, `Mirror()` and `Sign()` make one. `a @ b` applies b, then a.
    """

    cells: int = eqx.field(static=True, default=0)
    mirror: bool = eqx.field(static=True, default=False)
    sign: int = eqx.field(static=True, default=1)

    def __repr__(self) -> str:
        parts = {
            "Sign()": self.sign < 0,
            f"Translation({self.cells})": self.cells,
            "Mirror()": self.mirror,
        }
        return " @ ".join(name for name, there in parts.items() if there) or "the identity"

    @property
    def trivial(self) -> bool:
        """Whether it is the identity."""
        return self == Symmetry()

    def matrix(self, like: StateLike) -> Float[np.ndarray, "two_n two_n"]:
        """Return S over the raveled state, (2n, 2n); S^-1 is its transpose."""
        unit = jnp.eye(ravel_pytree(like)[0].size)
        return np.asarray(matrix(self(columns(like, unit))))

    def __matmul__(self, other: "Symmetry") -> "Symmetry":
        turned = -other.cells if self.mirror else other.cells
        return Symmetry(self.cells + turned, self.mirror != other.mirror, self.sign * other.sign)

    def __call__(self, y: Pytree) -> Pytree:
        """Apply S to displacements, or to a state."""

        def one(x):
            x = -x[::-1] if self.mirror else x
            return self.sign * (jnp.roll(x, self.cells, 0) if self.cells else x)

        return y if self.trivial else jax.tree.map(one, y)


def Translation(cells: Count = 1) -> Symmetry:
    """Return the symmetry of a wave that is `cells` further on after a period.

    **Example:**

    >>> gx.orbits.Translation(1)(jnp.array([1.0, 2.0, 3.0])).tolist()
    [3.0, 1.0, 2.0]
    """
    return Symmetry(cells=whole("cells", cells, -(2**31)))


def Mirror() -> Symmetry:
    """Return the symmetry of a motion that is its own mirror image half of its full period later.

    **Example:**

    >>> gx.orbits.Mirror()(jnp.array([1.0, 2.0, 3.0])).tolist()
    [-3.0, -2.0, -1.0]
    """
    return Symmetry(mirror=True)


def Sign() -> Symmetry:
    """Return the symmetry u -> -u half of the full period later, for lattices of odd forces."""
    return Symmetry(sign=-1)


def shifts(lattice: Lattice) -> Float[jax.Array, "n k"]:
    """Return the `uniform_moves` of a lattice, in its floating type."""
    return jnp.asarray(uniform_moves(lattice), lattice.dtype)


def masses(lattice: Lattice) -> Numbers:
    """Return the mass of each raveled displacement, (n,)."""
    return ravel_pytree(spread_mass(lattice))[0]


def force_at(lattice: Lattice, u: Numbers) -> Numbers:
    """Return the forces (n,) at raveled displacements, without velocities, at t = 0."""
    zeros = lattice.zeros()
    force = lattice.force(jnp.zeros((), u.dtype), ravel_pytree(zeros)[1](u), zeros)
    return ravel_pytree(force)[0]


@compiled
def stiffness_at(lattice: Lattice, u: Numbers) -> Numbers:
    """Return the stiffness (n, n) at raveled displacements."""
    return -jax.jacfwd(lambda u: force_at(lattice, u))(u)


def uneven(lattice: Lattice) -> Displacements:
    """Return an irregular shape."""
    rng = np.random.default_rng(0)
    return jax.tree.map(lambda x: rng.uniform(-1, 1, x.shape).astype(x.dtype), lattice.template())


def free_moves(lattice: Lattice, symmetry: Symmetry) -> Numbers:
    """Return the uniform displacements that cost no energy and are invariant under S, (n, k)."""
    moves = shifts(lattice)
    return moves if symmetry.sign * (-1 if symmetry.mirror else 1) > 0 else moves[:, :0]


# h omega of a step of an orbit, with omega the highest linear frequency.
FINE = 0.3
# The same for runs that settle, and for Lyapunov exponents.
COARSE = 0.4
# The fewest steps per period.
LEAST_STEPS = 16


def fixed_step_solver(
    lattice: Lattice, solver: AbstractSolver | None, otherwise: AbstractSolver
) -> AbstractSolver:
    """Return `solver`, or by default `otherwise` where the lattice splits and Dopri8 elsewhere."""
    if solver is not None:
        return solver
    return otherwise if facts(lattice).splits else Dopri8()


def default_steps(
    lattice: Lattice,
    period: Scalar,
    multiple: Count = 1,
    *,
    fineness: Scalar = FINE,
    doubled: bool = False,
    guess: StateLike | None = None,
) -> Scalar:
    """Return steps per period with h omega_max <= fineness, at least 16, a multiple of `multiple`.

    omega_max is the highest linear frequency; in a sonic vacuum, where that is zero, the bound at
    the energy of a `guess`. **Raises** ValueError there without a guess, unless the caller doubles
    the steps (`doubled`). The result is a number, or an array where the lattice or the period is
    traced.
    """
    turned = in_numpy(period) * in_numpy(linear_frequency(lattice))
    known = concrete(turned)
    least = -(-LEAST_STEPS // multiple)
    if known is None:
        return multiple * jnp.maximum(jnp.ceil(turned / fineness / multiple).astype(int), least)
    if not known > 0 and guess is not None:
        known = np.asarray(period * frequency_bound(lattice, guess, 0.0, period))
    elif not (doubled or known > 0):
        refuse(
            "steps",
            "steps per period",
            "None",
            "Nothing is stiff at rest (a sonic vacuum): give steps=.",
        )
    return multiple * max(math.ceil(float(known) / fineness / multiple), least)


def flow_over(
    lattice: Lattice,
    period: Scalar,
    steps: Count | Counts | None,
    solver: AbstractSolver | None,
    multiple: Count,
    guess: StateLike,
) -> Flow:
    """Return the flow over a period, whose steps `multiple` segments must divide.

    Given steps are static; default ones are an array. The default solver is SRKN14a.
    """
    solver = fixed_step_solver(lattice, solver, SRKN14a())
    if steps is None:
        return Flow(jnp.asarray(default_steps(lattice, period, multiple, guess=guess)), solver)
    if traced(steps):
        return Flow(steps, solver)
    if whole("steps", steps, multiple) % multiple:
        refuse("steps", f"a multiple of the {multiple} segments", repr(steps))
    return Flow(int(steps), solver)


def answered(response: Callable, lattice: Lattice, ys: State, ts: Times) -> Numbers:
    """Return the number that a response function gives for a history."""
    found = response(lattice, ys.u, ys.v, ts)
    if np.ndim(found):
        refuse(
            "response",
            "a function (lattice, u, v, t) that gives one number",
            f"one that gives {described(found)}",
        )
    return jnp.asarray(found)


def history(
    flow: Flow,
    lattice: Lattice,
    state: StateLike,
    t0: Scalar,
    period: Scalar,
    frames: Count,
) -> tuple[State, Times, State]:
    """Run one period from t0 in `frames` equal parts: (state at the end, times, states).

    Times and states exclude the end. `flow` has the steps of the whole period.
    """
    between = Flow(-(-flow.steps // frames), flow.solver)
    length = period / frames
    ts = t0 + length * jnp.arange(frames)

    def one(y, t):
        return between(y, t, t + length, lattice), y

    end, states = jax.lax.scan(one, State(*state), ts)
    return end, ts, states


# The phases of a period at which forces are compared. They avoid simple fractions, where waveforms
# have their zeros and jumps.
MORE = (0.1 + 0.618034 * np.arange(32)) % 1
# The first four of these, the default of `phases`.
PHASES = MORE[:4]
# Displacements at which a modulation is looked for if the state has none. They cover every unit of
# length.
SIZES = 2.0 ** np.arange(-120, 121, 8)


def checked_state(lattice: Lattice, state: StateLike, argument: str = "state") -> State:
    """Return a pair as a `State` of the lattice's shape and type."""
    template = lattice.template()
    wanted = [x.shape for x in jax.tree.leaves(template)]
    for name, part in zip("uv", state):
        got = [np.shape(x) for x in jax.tree.leaves(part)]
        if got != wanted or jax.tree.structure(part) != jax.tree.structure(template):
            shapes = jax.tree.map(np.shape, part)
            refuse(
                f"{argument}.{name}",
                f"shape {lattice.shape}, that of the lattice",
                f"{shapes}",
                "One orbit of one lattice at a time.",
            )
        if not traced(part) and not all(
            np.isfinite(np.asarray(x)).all() for x in jax.tree.leaves(part)
        ):
            refuse(
                f"{argument}.{name}",
                "finite numbers",
                "NaN or infinity among them",
                "The run that made them has diverged.",
            )
    return jax.tree.map(lambda x: jnp.asarray(x, lattice.dtype), State(*state))


def one_lattice(lattice: Lattice) -> Lattice:
    """Refuse a batch of lattices."""
    if lattice.lanes:
        refuse(
            "lattice",
            "one Lattice",
            f"a batch with lanes {lattice.lanes}",
            "Ask for one lane at a time; orbit and forced_orbit also run in jax.vmap(..., in_axes=-1).",
        )
    return lattice


def known_lattice(lattice: Lattice) -> Lattice:
    """Refuse a batch, and a traced lattice."""
    if traced(one_lattice(lattice)):
        remedy = "Of the orbits, those of orbit, forced_orbit and breather have derivatives."
        refuse("lattice", "a lattice of known numbers", "a traced one", remedy)
    return lattice


def checked_lattice(lattice: Lattice) -> Lattice:
    """Refuse a batch, and a lattice that is not conservative and autonomous."""
    if not one_lattice(lattice).conserves:
        names = ", ".join(lattice.unkept())
        remedy = (
            "Orbits of damped, driven or modulated chains: gx.forced.forced_orbit. Breathers in a gap in the "
            "wave number, which come and go: gx.breathers.k_gap_breather."
        )
        refuse("lattice", "forces that depend on positions alone", names, remedy)
    return lattice


def checked_symmetry(
    lattice: Lattice, symmetry: Symmetry, state: StateLike, t0: Scalar, period: Scalar
) -> Symmetry:
    """Refuse a symmetry that the lattice does not have: S a(t, y) and a(t + T, S y) differ.

    For the identity: refuse a period after which the forces do not repeat. Accelerations a are
    compared at rest, where even weak drives and walls show, and at displacements of the state's
    size, where modulations show; of many sizes for a state at rest.
    """
    if traced((lattice, state, t0, period)) or symmetry.trivial and not lattice.reads_time:
        return symmetry
    if symmetry.mirror and lattice.dimension is not None:
        refuse("symmetry", "translations and signs in the plane", repr(symmetry))
    own = float(largest(state[0]))
    sizes = jnp.asarray([0.0, own] if own > 0 else [0.0, *SIZES])
    times = jnp.asarray(t0, float), jnp.asarray(period, float)
    found = _compared(lattice, symmetry, uneven(lattice), sizes, *times)
    off, change, rounding, there = (np.asarray(x, float) for x in found)
    eps, tiny = (float(getattr(jnp.finfo(lattice.dtype), name)) for name in ("eps", "tiny"))
    # The differences must exceed the rounding of times and displacements and of the static force
    # beside them.
    same = off <= 100 * (eps**0.5 * change + eps * there + rounding) + tiny / eps
    # A size may lie outside the range of a law.
    known = np.isfinite(there)
    if known.any() and same[known].all():
        return symmetry
    if symmetry.trivial:
        wanted = "one after which the forces repeat"
        refuse(
            "period",
            wanted,
            repr(float(period)),
            "Give the period of the drive, or a multiple of it.",
        )
    refuse(
        "symmetry",
        "a symmetry of the lattice",
        repr(symmetry),
        "The image of a state has other accelerations than the state.",
    )


def checked_period(lattice: Lattice, state: StateLike, t0: Scalar, period: Scalar) -> None:
    """Refuse a period after which the forces do not repeat."""
    checked_symmetry(lattice, Symmetry(), state, t0, period)


@compiled
def _compared(lattice, symmetry, shape, sizes, t0, period):
    # Returns, for displacements of each size: the difference of the image's accelerations a period
    # later, their change over a period, the effect of rounding, and their size.
    ts = phases(t0, period, MORE)
    nearby = 1 + 8 * jnp.finfo(lattice.dtype).eps
    lightest = jnp.min(jnp.stack([jnp.min(m) for m in jax.tree.leaves(lattice.mass)]))

    def state(size):
        sizes = size, size * (2 * jnp.pi / period)
        scaled = lambda a: jax.tree.map(lambda x: jnp.asarray(a * x, lattice.dtype), shape)
        return State(*map(scaled, sizes))

    def accelerated(t, y):
        """Return the accelerations and their size, including that of each contact alone."""
        found = lattice.acceleration(t, *y)
        contacts = [c.force for term in lattice.terms for c in term.compressions(t, y.u)]
        there = [largest(found), *(largest(force) / lightest for force in contacts)]
        return found, jnp.max(jnp.stack(there))

    def compared(size):
        y = state(size)
        ys = jax.tree.map(lambda *x: jnp.stack(x), y, symmetry(y), state(nearby * size))
        times = jnp.stack([ts, ts + period, ts])
        during = lambda x: jax.lax.map(lambda t: accelerated(t, x[1]), x[0])
        found, there = jax.lax.map(during, (times, ys))
        now, later, moved = (jax.tree.map(lambda a: a[i], found) for i in range(3))
        now = jax.vmap(symmetry)(now)
        moved = jax.vmap(symmetry)(moved)
        others = later, jax.tree.map(lambda a: a[0], now), moved
        apart = [largest(jax.tree.map(jnp.subtract, now, other)) for other in others]
        return *apart, jnp.max(there[:2])

    return jax.lax.map(compared, sizes)


def a_time(period: Scalar) -> float:
    """Return a period as a float above zero."""
    if not 0 < period < np.inf:
        refuse("period", "a time above zero", repr(period))
    return float(period)


def asked(
    lattice: Lattice,
    state: StateLike,
    period: Scalar,
    steps: Count | None,
    solver: AbstractSolver | None,
) -> tuple[State, float, Flow]:
    """Return a state of one lattice, a period after which its forces repeat, and the flow over it.

    The steps are an array, so that another value compiles nothing new.
    """
    state = checked_state(known_lattice(lattice), state)
    period = a_time(period)
    if steps is None:
        steps = default_steps(lattice, period, fineness=COARSE)
    steps = jnp.asarray(whole("steps", steps, 1))
    checked_period(lattice, state, 0.0, period)
    return state, period, Flow(steps, fixed_step_solver(lattice, solver, SRKN11b()))


def stacked(trees: Iterable) -> Pytree:
    """Return trees of known arrays as one, whose first axis counts them."""
    return jax.tree.map(lambda *x: np.stack(x), *trees)


def phases(t0: Scalar, period: Scalar, shares: Float[np.ndarray, " m"] = PHASES) -> Numbers:
    """Return times within a period, by default four."""
    return t0 + period * jnp.asarray(shares)


def largest(x: Pytree) -> Scalar:
    """Return the largest modulus in a tree of arrays, NaN if an entry is NaN."""
    xp = library(x)
    x = in_numpy(x)
    return xp.max(xp.stack([xp.max(abs(leaf)) for leaf in jax.tree.leaves(x)]))


def largest_of_each(x: Pytree) -> Float[np.ndarray, " m"]:
    """Return the largest modulus in a tree of known arrays for each first index, (m,)."""
    return np.max(
        [np.abs(leaf).reshape(len(leaf), -1).max(1) for leaf in jax.tree.leaves(x)], axis=0
    )
