"""The minimisers: Levenberg and Marquardt's method, and descent along gradients."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx

from .. import descent

CONVERGED, SPENT, NOT_FINITE, BLIND = range(4)
# the codes of a descent: converged, stalled, spent, not finite on the way, no gradient, no start
_AS_HERE = np.array([CONVERGED, SPENT, SPENT, SPENT, BLIND, NOT_FINITE])


class Found(NamedTuple):
    """Where a minimiser ended: free coordinates, half the sum of squares, steps, code."""

    x: jax.Array
    cost: jax.Array
    steps: jax.Array
    code: jax.Array


@eqx.filter_jit
def least_squares(problem, x0, tolerance, max_steps):
    """Levenberg and Marquardt from every row of x0 (starts, n), with derivatives in forward mode."""
    solver = optx.LevenbergMarquardt(rtol=tolerance, atol=tolerance)
    residuals = with_jacobian(problem)

    def one(x0):
        solution = optx.least_squares(lambda x, _: residuals(x), solver, x0, max_steps=max_steps, throw=False)
        cost = half_square(solution.state.f_info.residual)
        code = jnp.where(solution.result == optx.RESULTS.successful, CONVERGED, SPENT)
        code = jnp.where(jnp.isfinite(cost), code, NOT_FINITE)
        return Found(solution.value, cost, solution.stats["num_steps"], code)

    return jax.vmap(one)(x0) if len(x0) > 1 else jax.tree.map(lambda x: x[None], one(x0[0]))


def with_jacobian(problem):
    """The residuals, whose derivative is one matrix: a linear solver asks for its columns, and they cost one run."""
    @jax.custom_jvp
    def residuals(x):
        return problem.residuals(x)

    @residuals.defjvp
    def _(primals, tangents):
        value, matrix, _ = problem.linearise(*primals)
        return value, matrix @ tangents[0]

    return residuals


@eqx.filter_jit
def gradient_descent(problem, x0, optimiser, tolerance, max_steps, adjoint, steps):
    """Descent on half of the mean square from every row of x0 (starts, n), with derivatives in reverse mode."""
    samples = sum(trace.data.size for trace in problem.traces)

    def one(x0):
        cost = lambda z: half_square(problem.residuals(x0 + z, adjoint=adjoint, steps=steps)) / samples
        found = descent.descend(cost, jax.value_and_grad(cost), x0.size, optimiser, max_steps, tolerance)
        return Found(x0 + found.x, samples * found.least, found.steps, jnp.asarray(_AS_HERE)[found.code])

    return jax.lax.map(one, x0)


def half_square(residuals):
    """Half of the sum of squares."""
    return 0.5 * jnp.sum(residuals**2)
