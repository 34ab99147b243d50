"""The error of an orbit: what a second step size makes of it, and steps that are doubled until the two agree."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike

from ..checks import refuse
from ..checks import tolerance as checked_tolerance
from ..lattice import Lattice, State
from ..newton import CONVERGED, SPENT, STALLED, Root, newton
from ..results import Result, array, part
from ..types import Count, Number, Numbers, Pytree, Scalar

# the tolerance of an orbit, and of the orbits of a branch, relative to their size
TOLERANCE = 1e-8
BRANCH = 1e-7
# of that, what Newton's method may leave, and its floor
LEFT = 1e-3
LEFT_ON_BRANCH = 1e-4
FLOOR = 1e-12
# what a floating type resolves, in units of its last place
RESOLVED = 50
# most doublings of the steps, of those that Newton's method alone may want
DOUBLINGS = 10
TRIALS = 4
# relative change of a residual that more steps have not changed
SAME = 1e-3
# of a change that other steps make, where they are not half as many
SAFETY = 2
# finer steps that are looked at: where contacts open the change between two is small by accident
FINER = (1.25, 1.5, 2.0)
# of a residual, in units of its last place
ROUNDING = 16
# of the largest error, below which no unknown is known
SHARED = 0.1


class OrbitError(Result):
    """Estimated distance of an orbit from the true one at the same frequency (or energy), from two step sizes.

    Zero where a number was asked for, NaN where Newton's method did not converge.
    """

    state: State = part("The error of every entry of the state.", "site")
    energy: Number = array("The error of the energy.", "J")
    omega: Number = array("The error of the frequency.", "rad/s")
    period: Number = array("The error of the period.", "s")

    @property
    def outcome(self) -> str:
        """To what displacements and energy are known, a sentence."""
        if isinstance(self.energy, jax.core.Tracer) or np.ndim(self.energy):
            return "By what other steps change."
        return (
            f"Displacements to {size_of(self.state.u):.1e}, the energy to {float(self.energy):.1e}."
        )


def size_of(x: Pytree) -> float:
    """The largest modulus in a tree of known arrays, NaN where one is."""
    return float(np.max([np.abs(leaf).max() for leaf in jax.tree.leaves(x)]))


def newtons(tolerance: Scalar, dtype: DTypeLike, share: float = LEFT) -> Scalar:
    """What Newton's method may leave of the residual for an orbit of this tolerance, which is refused where none is."""
    tolerance, least = (
        checked_tolerance("tolerance", tolerance),
        RESOLVED * float(jnp.finfo(dtype).eps),
    )
    if not isinstance(tolerance, jax.core.Tracer) and tolerance < least:
        refuse(
            "tolerance",
            f"at least {least:.1e}, what {jnp.dtype(dtype).name} can hold",
            repr(float(tolerance)),
        )
    return jnp.maximum(share * jnp.asarray(tolerance), jnp.minimum(tolerance, max(FLOOR, least)))


def corrected(problem: Any, root: Root, scene: Pytree) -> Numbers:
    """The change of the unknowns that finer steps would make, by Newton's step with the derivative that is there."""
    return jnp.where(root.converged, _corrected(problem, root.x, root.jacobian, scene), jnp.nan)


def covering(changes: Numbers, rounding: Scalar) -> Numbers:
    """The error of unknowns (n,) that other steps, and rounding, change by `changes` (k, n)."""
    change = SAFETY * jnp.max(jnp.abs(changes), 0)
    return jnp.maximum(change, SHARED * jnp.max(change)) + rounding


def rounding(inverse: Numbers, size: Scalar = 1.0) -> Numbers:
    """What rounding of a residual of this size makes of the unknowns, by the inverse of its derivative."""
    return ROUNDING * jnp.finfo(inverse.dtype).eps * size * jnp.max(jnp.sum(jnp.abs(inverse), 1))


@eqx.filter_jit
def _corrected(problem, x, jacobian, scene):
    problem, x, jacobian, scene = jax.lax.stop_gradient((problem, x, jacobian, scene))
    inverse = jnp.linalg.inv(jacobian)
    changes = jax.lax.map(
        lambda by: inverse @ problem.finer(by).residual(x, scene), jnp.asarray(FINER)
    )
    return covering(changes, rounding(inverse))


def confirmed(
    problem: Any,
    x: Numbers,
    scene: Pytree,
    *,
    tolerance: Scalar,
    max_steps: Count,
    throw: bool | None,
    refine: bool = True,
    spread: float = 1.0,
) -> tuple[Any, Root, Numbers]:
    """(problem, root, error of the unknowns): solved, and solved again with twice the steps until nothing changes.

    `problem` has `residual`, `linearise` and `finer(by)`. Without `refine` its steps stay, and the error alone is
    estimated. Where Newton's method fails with the first steps it is tried with more. The orbit's size in the unknowns
    is 1/`spread`.
    """

    def solve(problem, x):
        root = newton(
            problem.residual,
            x,
            scene,
            tolerance=newtons(tolerance, x.dtype),
            max_steps=max_steps,
            linearise=problem.linearise,
            throw=False,
        )
        # what rounding leaves, or a derivative that is almost singular, is in the error
        enough = ((root.code == STALLED) | (root.code == SPENT)) & (root.residual <= tolerance)
        return eqx.tree_at(lambda r: r.code, root, jnp.where(enough, CONVERGED, root.code))

    # plain numbers are inputs of what is compiled, not a part of it
    scene = jax.tree.map(lambda leaf: jnp.asarray(leaf) if isinstance(leaf, float) else leaf, scene)
    problem = problem.finer(1) if refine else problem
    root = solve(problem, x)
    # a function may hide tracers, which the root then shows
    if isinstance(root.code, jax.core.Tracer):
        return problem, root, corrected(problem, root, scene)
    finer = problem
    for _ in range(TRIALS if refine else 0):
        if root.converged:
            break
        finer = finer.finer(2)
        found = solve(finer, x)
        same = abs(found.residual - root.residual) <= SAME * root.residual
        if found.converged or found.residual < root.residual:
            problem, root = finer, found
        if same:  # it is not the steps
            break
    if not root.converged and (throw is None or throw):
        raise RuntimeError(root.outcome)
    if not root.converged or not refine:
        return problem, root, corrected(problem, root, scene)
    first, iterations = root.first, root.iterations
    for _ in range(DOUBLINGS):
        finer = problem.finer(2)
        found = solve(finer, root.x)
        if not found.converged:
            return problem, root, corrected(problem, root, scene)
        change, iterations = np.abs(np.asarray(found.x - root.x)), iterations + found.iterations
        problem, root = (
            finer,
            eqx.tree_at(lambda r: (r.first, r.iterations), found, (first, iterations)),
        )
        if spread * change.max() <= tolerance:
            change = np.maximum(change, corrected(problem, root, scene))
            if spread * change.max() <= tolerance:
                break
    return problem, root, jnp.asarray(np.maximum(change, SHARED * change.max()))


@eqx.filter_jit
def error_of(
    lattice: Lattice, t0: Scalar, state: State, apart: State, omega: Scalar, in_omega: Scalar
) -> OrbitError:
    """The `OrbitError` of a state that is known up to `apart`, at a frequency that is known up to `in_omega`."""
    apart = jax.tree.map(jnp.abs, apart)
    slope = jax.grad(lambda y: jnp.sum(lattice.energy(t0, y.u, y.v)))(state)
    energy = sum(
        jnp.sum(jnp.abs(g) * e) for g, e in zip(jax.tree.leaves(slope), jax.tree.leaves(apart))
    )
    return OrbitError(apart, energy, in_omega, 2 * jnp.pi / omega**2 * in_omega, **lattice.origin)


def neighbours(x: np.ndarray) -> np.ndarray:
    """The largest of each entry and its neighbours along the first axis."""
    wide = np.concatenate([x[:1], x, x[-1:]])
    return np.max([wide[:-2], wide[1:-1], wide[2:]], axis=0)
