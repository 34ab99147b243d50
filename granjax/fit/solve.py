"""Least squares by Levenberg-Marquardt (MINPACK), and the cost of gradient descent."""

from functools import lru_cache
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import scipy
from jaxtyping import Float

from ..base.programs import compiled
from ..base.types import AnyArray, Scalar
from ..flow.march import seconds_a_step
from .descent import CONVERGED, NO_START, SPENT, STALLED
from .problem import Problem, Signals, misfit

# Directions with singular values below this share of the largest are invisible to the data.
NEGLIGIBLE = 1e-6
# seconds before a fit shows its progress
PATIENCE = 5.0


class Found(NamedTuple):
    """The end of a minimiser: coordinates, half the sum of squares, iterations, code."""

    x: Float[AnyArray, " n"]
    cost: Scalar
    iterations: Scalar
    code: Scalar


@compiled
def linearised(
    problem: eqx.Module,
    x: Float[AnyArray, " n"],
) -> tuple[Float[AnyArray, " m"], Float[AnyArray, "m n"], Signals, Signals]:
    """Return (residuals, their Jacobian, signals, misfits per trace) at x."""
    value, matrix, signals = problem.linearise(x)
    return value, matrix, signals, tuple(misfit(*both) for both in zip(problem.traces, signals))


def evaluated(
    problem: eqx.Module,
    x: Float[AnyArray, " n"],
) -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, "m n"]]:
    """Return (residuals, Jacobian) at x in double precision."""
    value, jacobian, *_ = linearised(problem, jnp.asarray(x, problem.dtype))
    return np.asarray(value, float), np.asarray(jacobian, float)


def still_to_go(
    value: Float[np.ndarray, " m"], jacobian: Float[np.ndarray, "m n"]
) -> tuple[float, Float[np.ndarray, " n"]]:
    """Return the possible decrease of |value|^2 in visible directions, and its step (n,)."""
    widths = np.linalg.norm(jacobian, axis=0)
    widths = np.where(widths > 0, widths, 1.0)
    scaled = jacobian / widths
    step = np.linalg.lstsq(scaled, -value, rcond=NEGLIGIBLE)[0]
    return float(np.sum((scaled @ step) ** 2)), step / widths


def least_squares(
    problem: eqx.Module,
    x: Float[AnyArray, " n"],
    tolerance: Scalar,
    max_steps: int,
    delay: float = PATIENCE,
) -> Found:
    """Minimise by Levenberg-Marquardt (MINPACK) from x (n,).

    It has converged if the possible relative decrease of the sum of squares, or the step to it, is
    below the tolerance. It has stalled if neither holds but no step improves. Steps to a non-finite
    Jacobian are rejected. A progress bar appears after `delay` [s].
    Source: Moré, Lecture Notes in Mathematics 630, 105 (1978).
    """
    from tqdm import tqdm

    tolerance = max(float(tolerance), 4 * float(jnp.finfo(problem.dtype).eps))
    x = np.asarray(x, float)
    with tqdm(total=max_steps, desc="fit", unit="step", delay=delay, leave=False) as bar:

        @lru_cache(maxsize=1)
        def both(point):
            # One run gives both: MINPACK asks for the residuals and then for the Jacobian there.
            bar.update()
            value, jacobian = evaluated(problem, np.frombuffer(point))
            value = np.where(np.isfinite(jacobian).all(), value, np.nan)
            # MINPACK needs at least as many residuals as unknowns.
            more = (0, max(0, x.size - value.size))
            return np.pad(value, more), np.pad(jacobian, (more, (0, 0)))

        at = lambda x: both(x.tobytes())
        if not np.isfinite(at(x)[0]).all():
            return Found(x, np.inf, 0, NO_START)
        found = scipy.optimize.least_squares(
            lambda x: at(x)[0],
            x,
            lambda x: at(x)[1],
            method="lm",
            x_scale="jac",
            ftol=tolerance,
            xtol=tolerance,
            gtol=tolerance,
            max_nfev=max_steps + 1,
        )
    fall, step = still_to_go(found.fun, found.jac)
    near = np.abs(step).max() <= tolerance * (1 + np.abs(found.x).max())
    code = (
        CONVERGED
        if near or fall <= 2 * tolerance * found.cost
        else STALLED
        if found.status
        else SPENT
    )
    return Found(found.x, found.cost, found.nfev - 1, code)


def patience(problem: Problem) -> float:
    """Return the seconds before a fit shows progress; 0 if one step takes longer."""
    lattice = problem.scene(problem.coordinates.start)
    steps = (float(problem.t1) - float(problem.t0)) / float(problem.step)
    each = steps * seconds_a_step(lattice, problem.solver) * (1 + problem.coordinates.size)
    return 0.0 if each > PATIENCE else PATIENCE


class MeanSquare(eqx.Module):
    """Half the mean square of the residuals, for reverse mode through at most `most` steps."""

    problem: Problem
    adjoint: eqx.Module
    most: int | None = eqx.field(static=True)

    @property
    def samples(self) -> int:
        """The number of samples, missing ones included."""
        return sum(trace.data.size for trace in self.problem.traces)

    def __call__(self, x: Float[AnyArray, " n"]) -> Float[AnyArray, ""]:
        residuals = self.problem.residuals(x, adjoint=self.adjoint, max_steps=self.most)
        return jnp.sum(residuals**2) / (2 * self.samples)
