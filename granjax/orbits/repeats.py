"""What an orbit is asked for with: one lattice, a state of it, a period and a symmetry with which its forces repeat."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from diffrax import AbstractSolver
from jaxtyping import Float

from ..checks import positive, refuse, traced, whole
from ..flow import Flow
from ..lattice import Lattice, State
from ..types import Count, Numbers, Pytree, Scalar, StateLike
from .steps import FINE, default_steps, fixed_step_solver
from .symmetry import Symmetry

# where in a period forces are compared: at no simple fraction, where waveforms have their zeros and jumps
MORE = (0.1 + 0.618034 * np.arange(32)) % 1
PHASES = MORE[:4]
# displacements at which a modulation is looked for where the state has none, whatever the unit of length
SIZES = 2.0 ** np.arange(-120, 121, 8)


def checked_state(lattice: Lattice, state: StateLike, argument: str = "state") -> State:
    """A pair as a `State` of the lattice's shape and type."""
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
                "A run that has diverged leads nowhere.",
            )
    return jax.tree.map(lambda x: jnp.asarray(x, lattice.dtype), State(*state))


def one_lattice(lattice: Lattice) -> Lattice:
    """Refuse a batch of lattices."""
    if lattice.lanes:
        refuse(
            "lattice",
            "one Lattice",
            f"a batch with lanes {lattice.lanes}",
            "Ask for one lane at a time, or use jax.vmap(..., in_axes=-1).",
        )
    return lattice


def checked_lattice(lattice: Lattice) -> Lattice:
    """A lattice that has time-reversible, isolated families: single, conservative, autonomous."""
    if lattice.lanes:
        remedy = (
            "Use jax.vmap(function, in_axes=-1)(lattice) for gx.breathers.breather with a guess."
        )
        refuse("lattice", "one lattice", f"a batch with lanes {lattice.lanes}", remedy)
    if not lattice.conserves:
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
    """Refuse what is no symmetry of the lattice: where S a(t, y) and a(t + T, S y) differ, with a its accelerations.

    Of the identity: a period after which the forces do not repeat. At rest, where drives and walls show however little
    they do, and at displacements of the state's size, where modulations do; of a state at rest at those of many sizes.
    """
    if traced((lattice, state, t0, period)) or symmetry.trivial and not lattice.reads_time:
        return symmetry
    if symmetry.mirror and lattice.dimension is not None:
        refuse("symmetry", "translations and signs in the plane", repr(symmetry))
    rng, own = np.random.default_rng(0), float(largest(state[0]))
    shape = jax.tree.map(lambda x: rng.uniform(-1, 1, x.shape), lattice.template())
    sizes = jnp.asarray([0.0, own] if own > 0 else [0.0, *SIZES])
    times = jnp.asarray(t0, float), jnp.asarray(period, float)
    found = _compared(lattice, symmetry, shape, sizes, *times)
    off, change, rounding, there = (np.asarray(x, float) for x in found)
    eps, tiny = (float(getattr(jnp.finfo(lattice.dtype), name)) for name in ("eps", "tiny"))
    # more than by the rounding of times and displacements and of the static force beside
    same = off <= 100 * (eps**0.5 * change + eps * there + rounding) + tiny / eps
    # a size may be beyond a law's range
    known = np.isfinite(there)
    if known.any() and same[known].all():
        return symmetry
    if symmetry.trivial:
        wanted = "one after which the forces repeat"
        refuse("period", wanted, repr(float(period)), "Give the drive's, or a multiple.")
    refuse(
        "symmetry",
        "a symmetry of the lattice",
        repr(symmetry),
        "Its image has other accelerations.",
    )


def checked_period(lattice: Lattice, state: StateLike, t0: Scalar, period: Scalar) -> None:
    """Refuse a period after which the forces do not repeat."""
    checked_symmetry(lattice, Symmetry(), state, t0, period)


@eqx.filter_jit
def _compared(lattice, symmetry, shape, sizes, t0, period):
    """By how much the image's accelerations differ a period later, by how much they change, how large they are.

    At displacements of each size, (sizes,) each; third what rounding of these displacements makes.
    """
    ts, count = phases(t0, period, MORE), len(MORE)
    nearby = 1 + 8 * jnp.finfo(lattice.dtype).eps
    lightest = jnp.min(jnp.stack([jnp.min(m) for m in jax.tree.leaves(lattice.mass)]))

    def accelerated(t, size, image):
        """S a(t, y), or a(t, S y) of the image, and how large accelerations are, of contacts by themselves too."""
        y = State(
            *(
                jax.tree.map(lambda x: jnp.asarray(scale * x, lattice.dtype), shape)
                for scale in (size, size * (2 * jnp.pi / period))
            )
        )
        y = jax.tree.map(lambda a, b: jnp.where(image, a, b), symmetry(y), y)
        found = lattice.acceleration(t, *y)
        contacts = [c.force for term in lattice.terms for c in term.compressions(t, y.u)]
        there = [largest(found), *(largest(force) / lightest for force in contacts)]
        found = jax.tree.map(lambda a, b: jnp.where(image, a, b), found, symmetry(found))
        return found, jnp.max(jnp.stack(there))

    def compared(size):
        times = jnp.concatenate([ts, ts + period, ts])
        scales = jnp.repeat(jnp.stack([size, size, nearby * size]), count)
        images = jnp.repeat(jnp.array([False, True, False]), count)
        found, there = jax.lax.map(lambda x: accelerated(*x), (times, scales, images))
        now, later, moved = (
            jax.tree.map(lambda a: a[i : i + count], found) for i in (0, count, 2 * count)
        )
        others = later, jax.tree.map(lambda a: a[0], now), moved
        off, change, rounding = (
            largest(jax.tree.map(jnp.subtract, now, other)) for other in others
        )
        return off, change, rounding, jnp.max(there[: 2 * count])

    return jax.lax.map(compared, sizes)


def asked(
    lattice: Lattice,
    state: StateLike,
    period: Scalar,
    t0: Scalar,
    steps: Count | None,
    solver: AbstractSolver | None,
    otherwise: AbstractSolver,
    fineness: Scalar = FINE,
) -> tuple[State, float, Flow]:
    """A state of one lattice, a period after which its forces repeat, and the flow over it.

    The steps are an array, whose value compiles nothing anew.
    """
    state, period = checked_state(one_lattice(lattice), state), float(positive("period", period))
    if steps is None:
        steps = default_steps(lattice, period, fineness=fineness)
    steps = jnp.asarray(whole("steps", steps, 1))
    checked_period(lattice, state, t0, period)
    return state, period, Flow(steps, fixed_step_solver(lattice, solver, otherwise))


def phases(t0: Scalar, period: Scalar, shares: Float[np.ndarray, " m"] = PHASES) -> Numbers:
    """Times within a period, by default four."""
    return t0 + period * jnp.asarray(shares)


def largest(x: Pytree) -> Numbers:
    """The largest modulus in a tree of arrays, NaN where one is."""
    return jnp.max(jnp.stack([jnp.max(jnp.abs(leaf)) for leaf in jax.tree.leaves(x)]))
