"""The error of an orbit: what a second step size makes of it, and steps that are doubled until the two agree."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..checks import tolerance as checked_tolerance
from ..lattice import Lattice, State
from ..newton import Root, newton
from ..types import Count, Number, Numbers, Pytree, Scalar

# of an orbit and of the orbits of a branch, relative to their size
TOLERANCE, BRANCH = 1e-8, 1e-7
# of that, what Newton's method may leave, and between which bounds
LEFT, FLOOR, MOST_LEFT = 1e-3, 1e-12, 1e-11
# most doublings of the steps, of those that Newton's method alone may want
DOUBLINGS, TRIALS = 10, 4
# of the change between two step sizes: for steps that are not halved, and against one that is small by accident
SAFETY, ACCIDENT = 2, 32
ROUNDING = 16


class OrbitError(eqx.Module):
    """Estimated distance of an orbit from the true one at the same frequency (or energy), from two step sizes.

    **Fields:** `state`: of every entry, a `State` [units of u and v]. `energy` [J], `omega` [rad/s], `period` [s]: zero
    where they were asked for. NaN where Newton's method did not converge.
    """

    state: State
    energy: Number
    omega: Number
    period: Number


def newtons(tolerance: Scalar) -> Scalar:
    """What Newton's method may leave of the residual for an orbit of this tolerance, which is refused where none is."""
    tolerance = checked_tolerance("tolerance", tolerance)
    return jnp.clip(LEFT * jnp.asarray(tolerance), jnp.minimum(tolerance, FLOOR), MOST_LEFT)


def correction(problem: Any, root: Root, scene: Pytree) -> Numbers:
    """The change of the unknowns that twice the steps would make: one Newton step with the derivative that is there."""
    problem, root, scene = jax.lax.stop_gradient((problem, root, scene))
    inverse = jnp.linalg.inv(root.jacobian)
    size = jnp.max(jnp.sum(jnp.abs(inverse), 1))
    change = jnp.abs(inverse @ problem.doubled().residual(root.x, scene))
    rounding = ROUNDING * jnp.finfo(change.dtype).eps * size
    return jnp.where(root.converged, SAFETY * change + rounding, jnp.nan)


_correction = eqx.filter_jit(correction)


def confirmed(
    problem: Any, x: Numbers, scene: Pytree, *, tolerance: Scalar, max_steps: Count, throw: bool | None,
    refine: bool = True,
) -> tuple[Any, Root, Numbers]:
    """(problem, root, error of the unknowns): solved, and solved again with twice the steps until nothing changes.

    `problem` has `residual`, `linearise` and `doubled()`. Without `refine` its steps stay, and the error alone is
    estimated. Where Newton's method fails with the first steps it is tried with more.
    """
    def solve(problem, x, throw=False):
        return newton(problem.residual, x, scene, tolerance=newtons(tolerance), max_steps=max_steps,
                      linearise=problem.linearise, throw=throw)

    root = solve(problem, x, False if refine else throw)
    # a function may hide tracers, which the root then shows
    if not refine or isinstance(root.code, jax.core.Tracer):
        return problem, root, _correction(problem, root, scene)
    for _ in range(TRIALS):
        if root.converged:
            break
        finer = problem.doubled()
        found = solve(finer, x)
        if found.converged or found.residual < root.residual:
            problem, root = finer, found
    if not root.converged:
        if throw is None or throw:
            raise RuntimeError(root.outcome)
        return problem, root, jnp.full_like(root.x, jnp.nan)
    first, iterations, before = root.first, root.iterations, 0.0
    for _ in range(DOUBLINGS):
        finer = problem.doubled()
        found = solve(finer, root.x)
        if not found.converged:
            return problem, root, _correction(problem, root, scene)
        iterations = iterations + found.iterations
        found = eqx.tree_at(lambda r: (r.first, r.iterations), found, (first, iterations))
        change = np.abs(np.asarray(found.x - root.x))
        problem, root, size = finer, found, change.max()
        error = np.maximum(size, before / ACCIDENT)
        if error <= tolerance:
            break
        before = size
    return problem, root, jnp.asarray(np.maximum(change, 0.1 * error))


@eqx.filter_jit
def error_of(lattice: Lattice, t0: Scalar, state: State, apart: State, omega: Scalar, in_omega: Scalar) -> OrbitError:
    """The `OrbitError` of a state that is known up to `apart`, at a frequency that is known up to `in_omega`."""
    apart = jax.tree.map(jnp.abs, apart)
    slope = jax.grad(lambda y: jnp.sum(lattice.energy(t0, y.u, y.v)))(state)
    energy = sum(jnp.sum(jnp.abs(g) * e) for g, e in zip(jax.tree.leaves(slope), jax.tree.leaves(apart)))
    return OrbitError(apart, energy, in_omega, 2 * jnp.pi / omega**2 * in_omega)
