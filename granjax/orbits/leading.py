"""The leading Floquet multipliers of long lattices, without the monodromy matrix."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from diffrax import AbstractSolver
from jax.flatten_util import ravel_pytree
from jaxtyping import Complex, Float
from scipy.sparse.linalg import ArpackError, ArpackNoConvergence, LinearOperator, eigs

from ..checks import tolerance as checked_tolerance
from ..checks import whole
from ..flow import Flow
from ..lattice import Lattice
from ..printing import told
from ..solvers import KahanLi8
from ..types import Count, Scalar, StateLike
from .floquet import one_period, refuse_open
from .repeats import checked_period, checked_state
from .spectrum import REGULAR, ROUNDING, SAFETY, matched
from .steps import default_steps, fixed_step_solver
from .structure import structure, weights
from .symmetry import shifts

# vectors that Arnoldi's method keeps
BASIS = 60
# how often it starts anew from them
RESTARTS = 30


class Leading(NamedTuple):
    """What `leading` returns: `multipliers` (count,), the largest first, `vectors` (2n, count), `error` of each."""

    multipliers: Complex[np.ndarray, " count"]
    vectors: Complex[np.ndarray, "two_n count"]
    error: Float[np.ndarray, " count"]
    __repr__ = told


@eqx.filter_jit
def _end(flow, y, t0, period, args):
    return ravel_pytree(flow(y, t0, t0 + period, args))[0]


@eqx.filter_jit
def _push(flow, y, t0, period, args, direction):
    _, unravel = ravel_pytree(y)
    tangent = jax.tree.map(lambda x: x[..., None], unravel(direction))
    return ravel_pytree(flow.tangents(y, tangent, t0, t0 + period, args)[1])[0]


def leading(
    lattice: Lattice,
    state: StateLike,
    period: Scalar,
    count: Count = 6,
    *,
    t0: Scalar = 0.0,
    steps: Count | None = None,
    solver: AbstractSolver | None = None,
    tolerance: Scalar = 1e-9,
) -> Leading:
    """The multipliers of largest modulus by Arnoldi's method over products M x, one tangent a period each.

    For more than about 1000 beads, where the matrix itself costs n^2. Ask for no more than stand out: of many on the
    unit circle none leads, and the method then ends without them and names those that it has.

    The multipliers are those of the flow by `steps` steps along this state. Their error is four times what
    3/4 and 1/2 as many change, by the same method from the vectors that were found, and the `tolerance`.

    **Returns:** `Leading`: multipliers (count,), the largest first, their vectors (2n, count), normalised as in
    `Floquet`, and the error of each, infinite where fewer steps lead to no such multipliers.
    **Raises** ValueError in a sonic vacuum without `steps`, for a period or steps not above zero, and for a state that
    does not return, as far as these steps and half of them tell; RuntimeError where Arnoldi's method does not
    converge. Source: Lehoucq, Sorensen, Yang, ARPACK Users' Guide (SIAM, 1998).
    """
    tolerance = checked_tolerance("tolerance", tolerance)
    period, state = one_period(lattice, period), checked_state(lattice, state)
    checked_period(lattice, state, t0, period)
    steps = default_steps(lattice, period) if steps is None else whole("steps", steps, 1)
    solver = fixed_step_solver(lattice, solver, KahanLi8())
    times = jnp.asarray(float(t0)), jnp.asarray(period)
    scale = weights(structure(lattice).mass, period)
    size = len(scale)
    by = lambda n: Flow(jnp.asarray(max(n, 1)), solver)
    fine, coarse = (
        scale * np.asarray(_end(by(n), state, *times, lattice)) for n in (steps, steps // 2)
    )
    there = scale * np.asarray(ravel_pytree(state)[0])
    refuse_open(there, fine - there, fine, coarse, shifts(lattice), scale)

    def arnoldi(n, start):
        """Multipliers and vectors by n steps."""

        def product(x):
            direction = jnp.asarray(x.ravel() / scale)
            return scale * np.asarray(_push(by(n), state, *times, lattice, direction))

        return eigs(
            LinearOperator((size, size), product, dtype=float),
            k=count,
            v0=start,
            tol=tolerance,
            ncv=min(size, max(2 * count + 1, BASIS)),
            maxiter=RESTARTS,
        )

    try:
        values, vectors = arnoldi(steps, np.random.default_rng(0).normal(size=size))
    except ArpackNoConvergence as error:
        found = ", ".join(f"{rho:.6g}" for rho in error.eigenvalues) or "none"
        raise RuntimeError(
            f"Arnoldi's method found {len(error.eigenvalues)} of {count} multipliers: {found}. The others do not stand "
            f"out from those on the unit circle: ask for fewer."
        ) from None
    except ArpackError as error:
        raise RuntimeError(
            f"Arnoldi's method: {error}. Perhaps no multiplier leads: all on the circle."
        ) from None
    order = np.argsort(-np.abs(values))
    values, vectors = values[order], vectors[:, order]
    start = vectors.real.sum(1) + vectors.imag.sum(1)
    try:
        others = [arnoldi(n, start)[0] for n in (3 * steps // 4, steps // 2)]
        # of a pair that is cut in two either may come
        near, far = (np.minimum(matched(values, x), matched(values, x.conj())) for x in others)
        # as `spectrum.change`: those of a smooth flow of high order, or the larger
        change = (
            near if np.linalg.norm(far) >= REGULAR * np.linalg.norm(near) else np.maximum(near, far)
        )
    except (ArpackError, ArpackNoConvergence):
        change = np.full(count, np.inf)
    error = SAFETY * change + (2 * float(tolerance) + ROUNDING * np.finfo(float).eps) * np.abs(
        values
    )
    return Leading(values, vectors / scale[:, None], error)
