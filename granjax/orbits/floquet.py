"""Floquet theory: multipliers of an orbit, their errors, structure of the monodromy matrix."""

from functools import reduce
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from diffrax import AbstractSolver
from jax.flatten_util import ravel_pytree
from jaxtyping import Complex, Float, Inexact, Integer

from ..base.arrays import most
from ..base.checks import refuse, traced, whole, within
from ..base.checks import tolerance as checked_tolerance
from ..base.derivatives import eigenvalues
from ..base.programs import compiled, library
from ..base.tuning import one_thread
from ..base.types import Count, Numbers, Pytree, Scalar
from ..flow import Flow, linear_frequency
from ..lattice import Lattice, vector_field
from ..results import Result, array
from ..solvers import KahanLi8
from ..terms.reach import reads
from .asked import (
    Symmetry,
    a_time,
    checked_period,
    checked_state,
    default_steps,
    fixed_step_solver,
    free_moves,
    largest,
    one_lattice,
    shifts,
)
from .spectrum import change, known_spectrum, product_spectrum, size_of, uncertain


class _Structure(NamedTuple):
    # `mass`: (n,) over the raveled displacements, `None` for a flow without known masses. `rate`:
    # gamma of a uniform damping, 0 for none, `None` if the flow is not conformally symplectic.
    # `expected`: multipliers at +1. `autonomous`: nothing depends on time.

    mass: np.ndarray | None
    rate: float | None
    expected: int
    autonomous: bool


NOTHING = _Structure(None, None, 0, False)


def structure(lattice: Lattice) -> _Structure:
    """Return what a lattice's equations imply for a monodromy matrix."""
    # An orbit of an autonomous, conservative lattice has two multipliers at +1 (phase and energy),
    # and two more for every free displacement (position and momentum): four for a chain with free
    # ends or a ring, two between walls. A driven or damped lattice has none, except that each free
    # displacement keeps one (or two).
    masses = zip(jax.tree.leaves(lattice.mass), jax.tree.leaves(lattice.template()))
    mass = np.concatenate([np.broadcast_to(m, x.shape).ravel() for m, x in masses])
    damping = [term.exact_damping() for term in lattice.terms]
    damping = [found for found in damping if found is not None]
    found = [reads(term, lattice) for term in lattice.terms if term.exact_damping() is None]
    # A force without an energy is not symplectic, like one that reads velocities.
    others = [x for x in found if x.velocity or x.displacement and not x.energy]
    autonomous = not lattice.reads_time
    moves = shifts(lattice).shape[1]
    dissipates = bool(others or any(np.any(rate) for _, rate in damping))
    expected = (moves + autonomous) * (1 if dissipates else 2)
    uniform = not others and all(
        field is None and np.unique(np.ravel(rate)).size == 1 for field, rate in damping
    )
    rate = sum(float(np.ravel(rate)[0]) for _, rate in damping) if uniform else None
    return _Structure(mass, rate, expected, autonomous)


def weights(mass: Numbers, period: Scalar) -> Numbers:
    """Return D = sqrt(m/m_mean) (1, T/2 pi) over the raveled (u, v), (2n,).

    It turns displacements and velocities into lengths of one size. D M D^-1 of a tangent map M has
    no units: norms, condition numbers and errors refer to it. m_mean is the geometric mean, so that
    masses and moments of inertia can be combined.
    """
    xp = library(mass, period)
    root = xp.sqrt(mass / xp.exp(xp.mean(xp.log(mass))))
    return xp.concatenate([root, root * period / (2 * np.pi)])


def defect(monodromy: np.ndarray, rate: float | None, period: Scalar) -> float:
    """Return max |M^T J M - exp(-gamma T) J| of a map D M D^-1.

    For a (conformally) symplectic map it is rounding, whatever the map's error.
    """
    if rate is None:
        return float("nan")
    one = np.eye(len(monodromy) // 2)
    J = np.block([[0 * one, one], [-one, 0 * one]])
    return float(np.abs(monodromy.T @ J @ monodromy - np.exp(-rate * period) * J).max())


def krein(
    multipliers: np.ndarray,
    vectors: np.ndarray,
    mass: np.ndarray | None,
    tolerance: np.ndarray,
) -> np.ndarray:
    """Return the Krein signature of each multiplier: the sign of Im sum m conj(u) v, or 0.

    It is 0 off the unit circle and where it is mixed; +1 belongs to a motion exp(i omega t) of
    positive energy, whose conjugate has -1. Multipliers of one sign pass through each other; those
    of opposite signs may leave the circle (M. G. Krein; Aubry, Physica D 216, 1 (2006)).
    """
    if mass is None:
        return np.full(len(multipliers), np.nan)
    n = len(mass)
    u = vectors[:n]
    v = vectors[n:]
    value = np.imag(np.sum(mass[:, None] * np.conj(u) * v, axis=0))
    size = np.sum(mass[:, None] * np.abs(u) * np.abs(v), axis=0)
    definite = (np.abs(np.abs(multipliers) - 1) <= tolerance) & (np.abs(value) > 1e-6 * size)
    return np.where(definite, np.sign(value), 0.0)


STABLE = "stable"
UNSTABLE = "unstable"
UNDECIDED = "undecided"
# The largest instability that may stay undetected in a conservative lattice, by default. An error
# above it leaves the verdict open.
RESOLUTION = 1e-4
# The number of steps at which refinement ends.
MOST_STEPS = 2**14
# The change of the monodromy, relative to its largest entry, at which refinement ends by default.
TOLERANCE = 1e-9


class Floquet(Result):
    r"""Stability of a T-periodic orbit: a perturbation obeys V(t + T) = M V(t).

    The monodromy M acts on the raveled (u, v). Eigenvectors (du, dv) are columns of norm 1 with du
    times sqrt(m/m_mean) and dv times sqrt(m/m_mean) T/2 pi (m_mean is the geometric mean; for a
    flow without masses dv times T/2 pi if the state is a pair). Errors, conditions and defects
    refer to M in these weights, where it has no units. Multipliers pair as
    `rho rho' = exp(-gamma T)`, with gamma the `rate`.
    """

    monodromy: Float[np.ndarray, "row column"] = array("The monodromy M.")
    multipliers: Inexact[np.ndarray, " multiplier"] = array(
        "The eigenvalues rho of M, the largest modulus first.", "1", name="multiplier"
    )
    vectors: Inexact[np.ndarray, "row multiplier"] = array("The eigenvectors.", name="vector")
    error: Float[np.ndarray, " multiplier"] = array(
        "The error of each multiplier, from three step sizes, the distance of the exact orbit "
        "from the state, and the condition number. It grows like a square root where multipliers "
        "meet, as those at +1 do.",
        "1",
    )
    krein: Float[np.ndarray, " multiplier"] = array(
        "The Krein signature +1 or -1; 0 off the circle and for multipliers of symmetry (NaN for "
        "a flow without masses).",
        "1",
    )
    defect: float = array(
        "max |M^T J M - exp(-gamma T) J|, which does not see time-stepping errors."
    )
    step_error: float = array("The error of M in norm, from the step sizes.")
    expected: int = array(
        "The number of multipliers that symmetry puts at +1. They do not enter the verdict."
    )
    verdict: str = array('"stable", "unstable" or "undecided".', static=True)
    period: float = array("The period T.", "s")
    steps: int = array("The number of steps of a period.")
    rate: float | None = array("The rate of uniform damping.", "1/s")
    state: Pytree = array("The state of the orbit.")

    @property
    def outcome(self) -> str:
        """What led to the verdict."""
        conserves = self.rate == 0
        return sentence(self.verdict, self.multipliers, self.error, self.expected, conserves)

    @property
    def exponents(self) -> Complex[np.ndarray, " two_n"]:
        """log(rho)/T; a positive real part is a growth rate."""
        return np.log(self.multipliers.astype(complex)) / self.period

    @property
    def displacements(self) -> Inexact[np.ndarray, "n two_n"]:
        """u-parts of the eigenvectors, (n, 2n)."""
        return self.vectors[: len(self.vectors) // 2]

    @property
    def velocities(self) -> Inexact[np.ndarray, "n two_n"]:
        """v-parts of the eigenvectors, (n, 2n)."""
        return self.vectors[len(self.vectors) // 2 :]

    @property
    def unstable(self) -> Integer[np.ndarray, " U"]:
        """Indices of the multipliers outside the unit circle by more than their error."""
        return np.flatnonzero(np.abs(self.multipliers) - 1 > self.error)


def of_symmetry(multipliers: np.ndarray, expected: int) -> np.ndarray:
    """Return the indices of the `expected` multipliers nearest to +1."""
    return np.argsort(np.abs(multipliers - 1))[:expected]


def _excess(multipliers, error, expected):
    # Of the multipliers that symmetry does not put at +1: their indices, how far outside the circle
    # they are, and their errors.
    rest = np.delete(np.arange(len(multipliers)), of_symmetry(multipliers, expected))
    return rest, np.abs(multipliers[rest]) - 1, error[rest]


def decide(
    multipliers: Inexact[np.ndarray, " two_n"],
    error: Float[np.ndarray, " two_n"],
    expected: int,
    conserves: bool,
    resolution: Scalar = RESOLUTION,
) -> str:
    """Return the verdict from multipliers and their errors.

    The `expected` ones nearest to +1 are left out. Unstable: one lies outside the circle by more
    than its error. Undecided: an error above `resolution` could hide such a one. Stable: neither;
    every multiplier then lies on the circle within its error in a conservative lattice, and inside
    it in a damped one.
    """
    resolution = float(within("resolution", resolution, 0, 1, open_high=True))
    _, excess, error = _excess(multipliers, error, expected)
    if (excess > error).any():
        return UNSTABLE
    doubtful = excess + error > (resolution if conserves else 0)
    return UNDECIDED if doubtful.any() else STABLE


def sentence(
    verdict: str,
    multipliers: Inexact[np.ndarray, " two_n"],
    error: Float[np.ndarray, " two_n"],
    expected: int,
    conserves: bool,
) -> str:
    """Return what led to the verdict of `decide`, as a sentence."""
    rest, excess, error = _excess(multipliers, error, expected)
    left_out = f" {expected} multipliers at +1 are those of symmetry." if expected else ""
    if not len(rest):
        return f"Nothing but symmetries.{left_out}"
    top = excess + error
    if verdict == UNSTABLE:
        i = np.argmax(np.where(excess > error, excess, -np.inf))
        rho = multipliers[rest][i]
        kind = "real" if abs(rho.imag) <= error[i] else "complex"
        direction = " (period doubling)" if kind == "real" and rho.real < 0 else ""
        size = f"{abs(rho):.6g} +- {error[i]:.1e}"
        said = f"A {kind} multiplier{direction} of modulus {size} lies outside the unit circle."
    elif verdict == UNDECIDED:
        i = np.argmax(top)
        size = f"{abs(multipliers[rest][i]):.6g} is known to {error[i]:.1e}"
        said = f"A multiplier of modulus {size} only: smaller steps would tell."
    elif conserves:
        said = f"Every multiplier is on the unit circle, to {error.max():.1e}."
    else:
        said = f"Every multiplier is inside the unit circle, by {-top.max():.1e} at least."
    return said + left_out


@compiled
def _derivative(flow, like, x, t0, t1, args):
    end, factor = flow.derivative(ravel_pytree(like)[1](x), t0, t1, args)
    return ravel_pytree(end)[0], factor


@one_thread
def floquet(
    lattice: Lattice | Flow,
    state: Pytree,
    period: Scalar,
    *,
    t0: Scalar = 0.0,
    steps: Count | None = None,
    solver: AbstractSolver | None = None,
    segments: Count = 1,
    tolerance: Scalar = TOLERANCE,
    args: Any = None,
    symmetry: Symmetry = Symmetry(),
    expected: Count | None = None,
    resolution: Scalar = RESOLUTION,
) -> Floquet:
    r"""Compute the monodromy matrix, multipliers and stability of a periodic orbit.

    Tangents through a fixed-step flow give M = d y(t0 + T)/d y(t0); three step sizes give
    its error.

    **Arguments:**

    - `lattice`: a `Lattice`, or a `Flow` of any vector field together with its `args` (masses and
      symmetries are then unknown).
    - `state`: the orbit at t0. `period`: T > 0. `t0`: phase of a drive.
    - `steps`: steps of the finer flow per period; `None` doubles them until the matrix is known to
      `tolerance` (relative to its largest entry, without units) or 16384 steps are reached, as may
      happen where contacts open.
    - `solver`: `None` is KahanLi8 (Dopri8 where a force reads velocities other than by `Damping`),
      or the flow's own.
    - `segments`: the number of factors of M; several resolve multipliers far below the rounding of
      the largest.
    - `symmetry`: S of an orbit with y(t0 + T) = S y(t0); M is then S^-1 times that derivative.
    - `expected`: the number of multipliers that symmetry puts at +1; `None` takes it from the terms
      of a lattice, and 0 for a `Flow`: give 1 for a limit cycle of an autonomous one.
    - `resolution`: the largest undetected instability; an error above it leaves the verdict open.

    **Returns:** `Floquet`, without derivatives (see `multipliers`). **Raises** ValueError for a
    period that is not positive or after which the forces do not repeat, a batch, traced numbers, a
    state of another shape or one that does not return, segments that do not divide the steps, and
    too few steps for a finite motion.

    **Example:**

    >>> chain = gx.scenes.monomer(3, precompression=1.0)
    >>> found = gx.floquet.floquet(chain, gx.states.rest(chain), period=1.0)
    >>> found.outcome
    'Every multiplier is on the unit circle, to 1.4e-10.'
    >>> np.sort(np.abs(np.angle(found.multipliers)))[::2].round(6).tolist()
    [0.937379, 1.732051, 2.263033]
    >>> np.array(gx.linear.normal_modes(chain).omega).round(6).tolist()
    [0.937379, 1.732051, 2.263033]
    """
    if traced((lattice, state, period, t0, args)):
        remedy = "gx.floquet.multipliers has derivatives."
        refuse("lattice, state, period", "known numbers", "traced ones", remedy)
    period = a_time(period)
    tolerance = checked_tolerance("tolerance", tolerance)
    known = NOTHING
    rests = False
    if isinstance(lattice, Lattice):
        state = checked_state(one_lattice(lattice), state)
        known = structure(lattice)
        args = lattice
        if symmetry.trivial:
            checked_period(lattice, state, t0, period)
        rests = known.autonomous and bool(_rests(lattice, state, np.float64(t0)))
        # A state of rest has neither phase nor energy, and displacements that S reverses are not
        # free.
        turned = shifts(lattice).shape[1] - free_moves(lattice, symmetry).shape[1]
        pairs = (rests + turned) * (2 if known.rate == 0 else 1)
        known = known._replace(expected=known.expected - pairs)
        solver = fixed_step_solver(lattice, solver, KahanLi8())
        field = {}
        start = steps or default_steps(lattice, period, 2 * segments, doubled=True)
    else:
        solver = solver or lattice.solver
        field = {"field": lattice.field}
        start = steps or lattice.steps
    if expected is not None:
        known = known._replace(expected=expected)
    if whole("steps", start, 1) % (2 * segments):
        refuse("steps", f"a multiple of {2 * segments}, twice the segments", repr(start))
    scale = _weights(known, state, period)
    there = raveled(state)
    length = period / segments

    def run(count, x=there):
        # Returns the factors of S^-1 M, their product, and S^-1 y after the period, all without
        # units.
        flow = Flow(np.int64(max(count // segments, 1)), solver, **field)
        found = []
        for i in range(segments):
            times = np.float64(t0 + i * length), np.float64(t0 + (i + 1) * length)
            x, factor = _derivative(flow, state, x, *times, args)
            found.append(np.asarray(factor))
        end = np.asarray(x)
        if not symmetry.trivial:
            back = symmetry.matrix(state).T
            found[-1] = back @ found[-1]
            end = back @ end
        found = [factor * scale[:, None] / scale for factor in found]
        return found, reduce(lambda total, factor: factor @ total, found), end * scale

    count = start
    coarser = run(start // 2)
    fine = run(start)
    while steps is None and 2 * count <= MOST_STEPS:
        size = max(np.abs(x).max() for x in [*fine[0], fine[1]])
        if np.abs(fine[1] - coarser[1]).max() <= tolerance * size:
            break
        count = 2 * count
        coarser = fine
        fine = run(count)
    coarse = run(3 * count // 4)
    factors, products, ends = zip(fine, coarse, coarser)
    if not all(np.isfinite(x).all() for found in factors for x in found):
        remedy = "Give more steps=, or look at the state."
        refuse("steps", "enough steps for the motion to stay finite", repr(count), remedy)
    begin = there * scale
    monodromy = products[0]
    away = _displacement(known, monodromy, ends[0] - begin, change(*ends))
    if not rests:
        free = shifts(lattice) if isinstance(lattice, Lattice) else None
        _refuse_open(begin, away, ends[0], ends[2], free, scale)
    # With the fewest steps, at the orbit that the state may miss. Twice, since that is known to
    # first order.
    moved = ((begin + away) / scale).astype(there.dtype)
    other = run(count // 2, moved)[0] if away.any() else factors[2]
    about = uncertain(*products)
    off = 2 * np.linalg.norm([size_of(a - b) for a, b in zip(other, factors[2])])
    if segments == 1:
        multipliers, vectors, error = known_spectrum(monodromy, products[1], about, off)
    else:
        multipliers, vectors, error = product_spectrum(*factors, moved=off)
    vectors = vectors / scale[:, None]
    verdict = decide(multipliers, error, known.expected, known.rate == 0, resolution)
    signature = krein(multipliers, vectors, known.mass, np.maximum(error, 1e-12))
    # Multipliers of symmetry have no signature.
    signature[of_symmetry(multipliers, known.expected)] *= 0.0
    origin = getattr(lattice, "origin", {"_mark": np.nan})
    return Floquet(
        monodromy * scale / scale[:, None],
        multipliers,
        vectors,
        error,
        signature,
        defect(monodromy, known.rate, period),
        about,
        known.expected,
        verdict,
        period,
        int(count),
        known.rate,
        state,
        **origin,
    )


def _displacement(known, monodromy, gap, unknown):
    # How far the orbit of the exact flow may lie from the state: Newton's step from the gap and
    # from its error. The error `unknown` may have either sign, so the sizes are added. Steps along
    # the orbit and along free displacements (singular directions of M - 1) lead to no other orbit.
    left, size, right = np.linalg.svd(monodromy - np.eye(len(monodromy)))
    idle = known.expected // 2 if known.rate == 0 else known.expected
    size[len(size) - idle :] = np.inf
    size[size <= 1e-10 * size[0]] = np.inf
    step, doubt = (-right.T @ (left.T @ x / size) for x in (gap, unknown))
    away = step + doubt
    total = np.linalg.norm(step) + np.linalg.norm(doubt)
    return away * total / max(np.linalg.norm(away), np.finfo(float).tiny)


def _refuse_open(start, away, fine, coarse, free, scale):
    # Refuses a state that misses its start by more than the error of the flow and of the orbit. All
    # quantities are without units, by the weights `scale`. Uniform displacements that cost nothing,
    # `free`, count in no size.
    gap = np.linalg.norm(fine - start)
    known = np.linalg.norm(fine - coarse)
    known += 1e3 * np.finfo(float).eps * np.linalg.norm(start)
    if free is not None and free.size:
        columns, _ = np.linalg.qr(scale[: len(free), None] * np.asarray(free))
        columns = np.concatenate([columns, np.zeros_like(columns)])
        start, fine = (x - columns @ (columns.T @ x) for x in (start, fine))
    size = max(np.linalg.norm(start), np.linalg.norm(fine))
    if not min(gap, np.linalg.norm(away)) <= 1e-2 * size + known:
        refuse(
            "state",
            "one that returns after the period",
            f"a gap of {gap / size:.1e} of its size",
            "gx.orbits.orbit and gx.forced.forced_orbit find the orbit near it.",
        )


def _weights(known, state, period):
    if known.mass is not None:
        return weights(known.mass, period)
    sizes = [raveled(part).size for part in state] if isinstance(state, tuple) else []
    if len(sizes) == 2 and sizes[0] == sizes[1]:
        return weights(np.ones(sizes[0]), period)
    return np.ones(raveled(state).size)


def raveled(tree: Pytree) -> np.ndarray:
    """Return a tree of known arrays as one NumPy array, in the order of `ravel_pytree`."""
    leaves = [np.ravel(x) for x in jax.tree.leaves(tree)]
    return np.concatenate(leaves, dtype=np.result_type(*leaves))


@compiled
def _rests(lattice, state, t0):
    # Whether the state is an equilibrium to rounding, including that of contact forces which
    # balance each other.
    v, a = vector_field(t0, state, lattice)
    omega = linear_frequency(lattice)
    held = [jnp.abs(c.force) for term in lattice.terms for c in term.compressions(t0, state[0])]
    lightest = jnp.min(jnp.stack([jnp.min(m) for m in jax.tree.leaves(lattice.mass)]))
    # The rounding of forces at an equilibrium, in units of their last place.
    top = most([jnp.zeros(()), *held])
    rounding = 16 * jnp.finfo(lattice.dtype).eps * top / lightest
    return (
        jnp.maximum(largest(v) * omega, largest(a))
        <= 1e-12 * omega**2 * largest(state[0]) + rounding
    )


def multipliers(
    flow: Flow, state: Pytree, t0: Scalar, period: Scalar, args: Any
) -> Complex[jax.Array, " two_n"]:
    """Compute the Floquet multipliers alone, (2n,) complex.

    This is a pure function for `jax.jacfwd`, `vmap` and `jit`.

    **Arguments:** `flow`: a `Flow` over one period; `state`: the orbit at `t0`; `args`: of its
    field, such as the lattice. The order is that of LAPACK. Differentiate a simple multiplier,
    `multipliers(...)[i]`.

    The derivative is that of the flow's own steps. Where a contact opens it converges slowly and
    erratically (11 % off at 96 steps a period, 5 % at 384, for a contact that opens by 1 % of its
    compression). Take it there by `gx.derivative`, whose error covers the true value:
    `gx.derivative(lambda p, step: ..., p, period / 48)` with
    `steps = 2 * jnp.round(period / step / 2).astype(int)` for the `Flow` and for the orbit.
    """
    _, monodromy = flow.derivative(state, t0, t0 + period, args)
    return eigenvalues(monodromy)
