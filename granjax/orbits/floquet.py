"""Floquet theory: the monodromy matrix of a periodic orbit, its multipliers with errors, and what follows from them."""

from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from diffrax import AbstractSolver
from jax.flatten_util import ravel_pytree
from jaxtyping import Complex, Float, Inexact, Integer
from scipy.sparse.linalg import ArpackError, ArpackNoConvergence, LinearOperator, eigs

from ..checks import refuse, whole
from ..flow import Flow, linear_frequency
from ..lattice import Lattice, vector_field
from ..results import Held, Result
from ..solvers import KahanLi8
from ..types import Count, Pytree, Scalar, StateLike
from .problems import Symmetry, checked_state, free_moves
from .spectrum import product_spectrum, spectrum
from .steps import default_steps, fixed_step_solver
from .structure import NOTHING, defect, krein, structure
from .symmetry import shifts

STABLE, UNSTABLE, UNDECIDED = "stable", "unstable", "undecided"
RESOLUTION = 1e-4
# where refinement ends
MOST_STEPS = 2**14
TOLERANCE = 1e-9
# vectors that Arnoldi's method keeps, and how often it starts anew from them
BASIS, RESTARTS = 60, 30


class Floquet(Result):
    r"""Stability of a T-periodic orbit: a perturbation obeys V(t + T) = M V(t).

    **Fields:**

    - `monodromy`: M, (2n, 2n), over the raveled (u, v). `multipliers`: its eigenvalues rho (2n,), the largest
      modulus first; `vectors`: eigenvectors in columns, of norm 1.
    - `error`: of each multiplier, from two step sizes and its condition number; it grows like a square root where
      multipliers meet, as those at +1 do. Of the flow alone: the error of the orbit is not in it.
    - `krein`: signature +1, -1, or 0 off the circle and for those of symmetry (NaN for a flow without masses).
    - `defect`: max |M^T J M - exp(-gamma T) J|, relative; it is blind to time errors. `step_error`: max |M - M_coarse|.
    - `expected`: how many multipliers symmetry puts at +1; these are left out of the verdict.
    - `verdict`: "stable", "unstable" or "undecided"; `outcome` says why.
    - `period`, `steps`, `state`, `rate` (of uniform damping: multipliers pair as rho rho' = exp(-gamma T)).
    """

    held: ClassVar[dict[str, Held]] = {
        "monodromy": Held("row column"), "multipliers": Held("multiplier", "1", "multiplier"),
        "vectors": Held("row multiplier", "", "vector"), "error": Held("multiplier", "1"),
        "krein": Held("multiplier", "1"), "period": Held(unit="s"), "rate": Held(unit="1/s"),
    }
    monodromy: Float[np.ndarray, "two_n two_n"]
    multipliers: Inexact[np.ndarray, " two_n"]
    vectors: Inexact[np.ndarray, "two_n two_n"]
    error: Float[np.ndarray, " two_n"]
    krein: Float[np.ndarray, " two_n"]
    defect: float
    step_error: float
    expected: int
    verdict: str = eqx.field(static=True)
    outcome: str = eqx.field(static=True)
    period: float
    steps: int
    rate: float | None
    state: Pytree

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
        """Indices of the multipliers that lie outside the unit circle by more than their error."""
        return np.flatnonzero(np.abs(self.multipliers) - 1 > self.error)


def decide(
    multipliers: Inexact[np.ndarray, " two_n"], error: Float[np.ndarray, " two_n"], expected: int, conserves: bool,
    resolution: Scalar = RESOLUTION,
) -> tuple[str, str]:
    """(verdict, sentence) from multipliers and their errors.

    The `expected` ones nearest to +1 are left out. Unstable: one lies outside the circle by more than its error.
    Undecided: an error above `resolution` could hide such a one. Stable: neither; in a conservative lattice every
    multiplier then lies on the circle within its error, in a damped one inside.
    """
    rest = np.delete(np.arange(len(multipliers)), np.argsort(np.abs(multipliers - 1))[:expected])
    left_out = f" {expected} multipliers at +1 are those of symmetry." if expected else ""
    if not len(rest):
        return STABLE, "Nothing but symmetries." + left_out
    excess, error = np.abs(multipliers[rest]) - 1, error[rest]
    outside = excess > error
    if outside.any():
        i = np.argmax(np.where(outside, excess, -np.inf))
        rho = multipliers[rest][i]
        kind = "real" if abs(rho.imag) <= error[i] else "complex"
        direction = " (period doubling)" if kind == "real" and rho.real < 0 else ""
        size = f"{abs(rho):.6g} +- {error[i]:.1e}"
        return UNSTABLE, f"A {kind} multiplier{direction} of modulus {size} lies outside the unit circle.{left_out}"
    doubtful = (excess + error > resolution) if conserves else (excess + error > 0)
    if doubtful.any():
        i = np.argmax(np.where(doubtful, excess + error, -np.inf))
        return UNDECIDED, (f"A multiplier of modulus {abs(multipliers[rest][i]):.6g} is known to {error[i]:.1e} only: "
                           f"smaller steps would tell.{left_out}")
    if conserves:
        return STABLE, f"Every multiplier is on the unit circle, to {error.max():.1e}.{left_out}"
    return STABLE, f"Every multiplier is inside the unit circle, by {-(excess + error).max():.1e} at least.{left_out}"


@eqx.filter_jit
def _derivative(flow, y, t0, t1, args):
    return flow.derivative(y, t0, t1, args)


def floquet(
    lattice: Lattice | Flow, state: Pytree, period: Scalar, *, t0: Scalar = 0.0, steps: Count | None = None,
    solver: AbstractSolver | None = None, segments: Count = 1, tolerance: Scalar = TOLERANCE, args: Pytree = None,
    symmetry: Symmetry = Symmetry(), expected: Count | None = None, resolution: Scalar = RESOLUTION,
) -> Floquet:
    r"""Monodromy matrix, multipliers and stability of a periodic orbit.

    M = d y(t0 + T)/d y(t0) by tangents through a fixed-step flow, with two step sizes whose difference is the error.

    **Arguments:**

    - `lattice`: a `Lattice`, or a `Flow` of any vector field together with `args` (of which neither masses nor
      symmetries are known).
    - `state`: the orbit at t0. `period`: T > 0. `t0`: phase of a drive.
    - `steps`: steps of the finer flow over the period; `None` doubles them until the matrix is known to `tolerance`
      (relative to its largest entry) or 16384 steps are reached, as may happen where contacts open.
    - `solver`: `None` is KahanLi8 (Dopri8 where a force reads velocities other than by `Damping`), or the flow's own.
    - `segments`: factors of which M is the product; several keep multipliers far below the largest one's rounding.
    - `symmetry`: S of an orbit with y(t0 + T) = S y(t0); M is then S^-1 times that derivative.
    - `expected`: multipliers that symmetry puts at +1; `None` is what the terms of a lattice say, and none for a
      `Flow`: give 1 for a limit cycle of an autonomous one.
    - `resolution`: what an undetected instability may be; an error above it leaves the verdict open.

    **Returns:** `Floquet`. **Raises** ValueError for a period that is not positive, a state of another shape, and
    segments that do not divide the steps.
    """
    if not period > 0:
        refuse("period", "a time above zero", repr(period))
    segments = whole("segments", segments, 1)
    known = NOTHING
    if isinstance(lattice, Lattice):
        state, known, args = checked_state(lattice, state), structure(lattice), lattice
        if known.autonomous and _rests(lattice, state, t0):  # has neither phase nor energy
            known = known._replace(expected=known.expected - (2 if known.rate == 0 else 1))
        turned = shifts(lattice).shape[1] - free_moves(lattice, symmetry).shape[1]
        known = known._replace(expected=known.expected - turned * (2 if known.rate == 0 else 1))
        solver, field = fixed_step_solver(lattice, solver, KahanLi8()), {}
        start = steps or default_steps(lattice, period, 2 * segments, doubled=True)
    else:
        solver, field = solver or lattice.solver, {"field": lattice.field}
        start = steps or lattice.steps
    if expected is not None:
        known = known._replace(expected=whole("expected", expected, 0))
    if start % (2 * segments):
        refuse("steps", f"a multiple of {2 * segments}, twice the segments", repr(start))

    def factors(count):
        flow = Flow(jnp.asarray(count // segments), solver, **field)
        found = _factors(flow, state, t0, period, segments, args)
        return found if symmetry.trivial else [*found[:-1], symmetry.matrix(state).T @ found[-1]]

    count, coarse, fine = start, factors(start // 2), factors(start)
    while steps is None and 2 * count <= MOST_STEPS:
        size = max(np.abs(f).max() for f in fine)
        if np.abs(_product(fine) - _product(coarse)).max() <= tolerance * max(size, np.abs(_product(fine)).max()):
            break
        count, coarse, fine = 2 * count, fine, factors(2 * count)
    return _record(known, fine, coarse, state, period, count, resolution)


def _record(known, fine, coarse, state, period, steps, resolution):
    monodromy, rough = _product(fine), _product(coarse)
    multipliers, vectors, error = spectrum(monodromy, rough) if len(fine) == 1 else product_spectrum(fine, coarse)
    conserves = known.rate == 0
    verdict, outcome = decide(multipliers, error, known.expected, conserves, resolution)
    signature = krein(multipliers, vectors, known.mass, np.maximum(error, 1e-12))
    signature[np.argsort(np.abs(multipliers - 1))[: known.expected]] *= 0.0  # those of symmetry have none
    return Floquet(
        monodromy, multipliers, vectors, error, signature,
        defect(monodromy, known.mass, known.rate, float(period)), float(np.abs(monodromy - rough).max()),
        known.expected, verdict, outcome, float(period), int(steps), known.rate, state,
    )


def _rests(lattice, state, t0):
    """Whether the state is an equilibrium, to rounding."""
    (v, a), omega = vector_field(t0, state, lattice), linear_frequency(lattice)
    u, v, a = (np.abs(ravel_pytree(x)[0]).max() for x in (state[0], v, a))
    return bool(max(v * omega, a) <= 1e-12 * omega**2 * u)


def _factors(flow, state, t0, period, segments, args):
    found, length = [], period / segments
    for i in range(segments):
        times = jnp.asarray(t0 + i * length), jnp.asarray(t0 + (i + 1) * length)
        state, factor = _derivative(flow, state, *times, args)
        found.append(np.asarray(factor))
    return found


def _product(factors):
    total = factors[0]
    for factor in factors[1:]:
        total = factor @ total
    return total


def multipliers(flow: Flow, state: Pytree, t0: Scalar, period: Scalar, args: Pytree) -> Complex[jax.Array, " two_n"]:
    """Floquet multipliers alone, a pure function: (2n,) complex, for `jax.jacfwd`, `vmap` and `jit`.

    **Arguments:** `flow`: a `Flow` over one period; `state`: the orbit at `t0`; `args`: of its field, such as the
    lattice. In the order that LAPACK gives. Differentiate a simple one, `multipliers(...)[i]`.
    """
    _, monodromy = flow.derivative(state, t0, t0 + period, args)
    return jnp.linalg.eigvals(monodromy)


@eqx.filter_jit
def _push(flow, y, t0, period, args, direction):
    _, unravel = ravel_pytree(y)
    tangent = jax.tree.map(lambda x: x[..., None], unravel(direction))
    return ravel_pytree(flow.tangents(y, tangent, t0, t0 + period, args)[1])[0]


def leading(
    lattice: Lattice, state: StateLike, period: Scalar, count: Count = 6, *, t0: Scalar = 0.0,
    steps: Count | None = None, solver: AbstractSolver | None = None, tolerance: Scalar = 1e-9,
) -> tuple[Complex[np.ndarray, " count"], Complex[np.ndarray, "two_n count"]]:
    """The multipliers of largest modulus by Arnoldi's method over products M x, one tangent a period each.

    For more than about 1000 beads, where the matrix itself costs n^2. Ask for no more than stand out: of many on the
    unit circle none leads, and the method then ends without them and names those that it has.

    **Returns:** multipliers (count,), the largest first, and their vectors (2n, count). **Raises** ValueError in a
    sonic vacuum without `steps`; RuntimeError where Arnoldi's method does not converge. Source: Lehoucq, Sorensen,
    Yang, ARPACK Users' Guide (SIAM, 1998).
    """
    count, state = whole("count", count, 1), checked_state(lattice, state)
    steps = steps or default_steps(lattice, period)
    flow = Flow(jnp.asarray(steps), fixed_step_solver(lattice, solver, KahanLi8()))
    times = jnp.asarray(float(t0)), jnp.asarray(float(period))
    size = ravel_pytree(state)[0].size
    if count > size - 2:
        refuse("count", f"at most {size - 2}, two below the size", repr(count), "gx.floquet.floquet gives them all.")

    def product(x):
        return np.asarray(_push(flow, state, *times, lattice, jnp.asarray(x.ravel())))

    start = np.random.default_rng(0).normal(size=size)
    try:
        values, vectors = eigs(
            LinearOperator((size, size), product, dtype=float), k=count, v0=start, tol=tolerance,
            ncv=min(size, max(2 * count + 1, BASIS)), maxiter=RESTARTS)
    except ArpackNoConvergence as error:
        found = ", ".join(f"{rho:.6g}" for rho in error.eigenvalues) or "none"
        raise RuntimeError(
            f"Arnoldi's method found {len(error.eigenvalues)} of {count} multipliers: {found}. The others do not stand "
            f"out from those on the unit circle: ask for fewer.") from None
    except ArpackError as error:
        raise RuntimeError(f"Arnoldi's method: {error}. Perhaps no multiplier leads: all on the circle.") from None
    order = np.argsort(-np.abs(values))
    return values[order], vectors[:, order]
