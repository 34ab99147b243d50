"""The minimisers: Levenberg and Marquardt's method, and descent along gradients."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from .. import descent
from ..flow.march import seconds_a_step
from ..types import AnyArray, Scalar
from .problem import Problem, Signals, misfit

CONVERGED, SPENT, NOT_FINITE, BLIND, STALLED = range(5)
# the codes of a descent: converged, stalled, spent, not finite on the way, no gradient, no start
_AS_HERE = np.array([CONVERGED, STALLED, SPENT, SPENT, BLIND, NOT_FINITE])
# of the damping: relative to the squares of the Jacobian's columns at the start, and at least
DAMPING, LEAST_DAMPING = 1e-3, 1e-12
# singular values below this share of the largest are of directions that the data do not see
NEGLIGIBLE = 1e-6
# seconds before a fit says how far it is
PATIENCE = 5.0


class Found(NamedTuple):
    """Where a minimiser ended: free coordinates, half the sum of squares, iterations, code."""

    x: Float[AnyArray, " n"]
    cost: Scalar
    iterations: Scalar
    code: Scalar


@eqx.filter_jit
def linearised(
    problem: Problem | eqx.Module,
    x: Float[AnyArray, " n"],
) -> tuple[Float[AnyArray, " m"], Float[AnyArray, "m n"], Signals, Signals]:
    """(residuals, their Jacobian, signals, misfits per trace) at x: the one program of a fit by least squares."""
    value, matrix, signals = problem.linearise(x)
    return value, matrix, signals, tuple(misfit(*both) for both in zip(problem.traces, signals))


def evaluated(
    problem: Problem | eqx.Module,
    x: Float[AnyArray, " n"],
) -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, "m n"]]:
    """(residuals, Jacobian) at x in double precision."""
    value, jacobian, *_ = linearised(problem, jnp.asarray(x, problem.dtype))
    return np.asarray(value, float), np.asarray(jacobian, float)


def directions_left(value: Float[np.ndarray, " m"], jacobian: Float[np.ndarray, "m n"]) -> tuple:
    """(s, V^T, b, kept) of a Jacobian U S V^T: b = U^T value, kept: which directions the data see.

    Along those |value|^2 could still fall by the sum of b^2.
    """
    n = jacobian.shape[1]
    triangle = np.linalg.qr(np.column_stack([jacobian, value]), mode="r")[:n]
    u, s, vh = np.linalg.svd(triangle[:, :n], full_matrices=False)
    b = u.T @ triangle[:, n]
    return s, vh, b, s > NEGLIGIBLE * s[0]


@np.errstate(over="ignore", invalid="ignore")
def least_squares(
    problem: Problem | eqx.Module,
    x: Float[AnyArray, " n"],
    tolerance: Scalar,
    max_steps: int,
    delay: float = PATIENCE,
) -> Found:
    """Levenberg and Marquardt from x (n,), damped as by Nielsen: IMM-REP-1999-05, Technical University of Denmark.

    A bar shows the steps that are left at most after a `delay` [s].

    It has converged where the undamped step, or what that could gain, is relatively below the tolerance, and has
    stalled where no step above it is better.
    """
    value, jacobian = evaluated(problem, x)
    x, square, scale = np.asarray(x, float), value @ value, np.zeros(len(x))
    damping, growth = DAMPING, 2.0
    tolerance = max(float(tolerance), 4 * float(jnp.finfo(problem.dtype).eps))
    for iterations in _followed(range(1, max_steps + 1), delay):
        scale = np.maximum(scale, np.linalg.norm(jacobian, axis=0))
        unit = np.where(scale > 0, scale, 1.0)
        s, vh, b, kept = directions_left(value, jacobian / unit)
        step = -(b * s / (s**2 + damping)) @ vh / unit
        undamped = -(b[kept] / s[kept]) @ vh[kept] / unit
        least = tolerance * (1 + np.abs(x).max())
        arrived = np.abs(undamped).max() <= least or np.sum(b[kept] ** 2) <= tolerance * square
        after = evaluated(problem, x + step)
        fall = np.sum(b**2 * (1 - (damping / (s**2 + damping)) ** 2))
        gain = (square - after[0] @ after[0]) / max(fall, np.finfo(float).tiny)
        # the last step lowers the sum by less than its rounding
        better = gain > 0 or arrived and after[0] @ after[0] <= (1 + tolerance) * square
        if better and np.isfinite(after[1]).all():
            x, (value, jacobian) = x + step, after
            square = value @ value
            damping, growth = max(damping * max(1 / 3, 1 - (2 * gain - 1) ** 3), LEAST_DAMPING), 2.0
        else:
            damping, growth = damping * growth, 2 * growth
            if np.abs(step).max() <= least and not arrived:
                return Found(x, square / 2, iterations, STALLED)
        if arrived:
            return Found(x, square / 2, iterations, CONVERGED)
    return Found(x, square / 2, max_steps, SPENT)


def _followed(steps, delay):
    """Steps with a bar of those that are left at most, beyond some seconds."""
    from tqdm import tqdm

    return tqdm(steps, desc="fit", unit="step", delay=delay, leave=False)


def patience(problem: Problem) -> float:
    """Seconds before a fit says how far it is: none where one step of it takes longer."""
    lattice = problem.lattice(problem.coordinates.start)
    steps = float(problem.t1 - problem.t0) / float(problem.step)
    each = steps * seconds_a_step(lattice, problem.solver) * (1 + problem.coordinates.size)
    return 0.0 if each > PATIENCE else PATIENCE


@eqx.filter_jit
def gradient_descent(
    problem: Problem,
    x: Float[AnyArray, " n"],
    optimiser: object,
    tolerance: Scalar,
    max_steps: int,
    adjoint: eqx.Module,
    most: int | None,
) -> Found:
    """Descent on half of the mean square from x (n,), with derivatives in reverse mode through at most `most` steps."""
    samples = sum(trace.data.size for trace in problem.traces)
    cost = lambda z: (
        jnp.sum(problem.residuals(x + z, adjoint=adjoint, max_steps=most) ** 2) / (2 * samples)
    )
    found = descent.descend(cost, jax.value_and_grad(cost), x.size, optimiser, max_steps, tolerance)
    return Found(
        x + found.x, samples * found.least, found.iterations, jnp.asarray(_AS_HERE)[found.code]
    )
