"""The largest multipliers of large lattices, without their matrix."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from scipy.sparse.linalg import ArpackError, ArpackNoConvergence, LinearOperator, eigs

from ..checks import refuse, whole
from ..flow import Flow
from ..orbits import default_steps
from ..solvers import KahanLi8

# vectors that Arnoldi's method keeps, and how often it starts anew from them
BASIS, RESTARTS = 60, 30


@eqx.filter_jit
def _push(flow, y, t0, period, args, direction):
    _, unravel = ravel_pytree(y)
    tangent = jax.tree.map(lambda x: x[..., None], unravel(direction))
    return ravel_pytree(flow.tangents(y, tangent, t0, t0 + period, args)[1])[0]


def leading(lattice, state, period, count=6, *, t0=0.0, steps=None, solver=None, tolerance=1e-9):
    """The multipliers of largest modulus by Arnoldi's method over products M x, one tangent a period each.

    For more than about 1000 beads, where the matrix itself costs n^2. Ask for no more than stand out: of many on the
    unit circle none leads, and the method then ends without them and names those that it has.

    **Returns:** multipliers (count,), the largest first, and their vectors (2n, count). **Raises** RuntimeError where
    Arnoldi's method does not converge. Source: Lehoucq, Sorensen, Yang, ARPACK Users' Guide (SIAM, 1998).
    """
    count = whole("count", count, 1)
    steps = steps or default_steps(lattice, period, 2, doubled=True)
    flow = Flow(jnp.asarray(steps), solver or KahanLi8())
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
