"""`judged`: build a `Fit`, with errors and an analysis of residuals."""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ..base.programs import compiled
from ..base.types import Numbers
from ..flow import return_error
from ..solvers import AbstractSplitting
from .descent import CONVERGED, NO_GRADIENT, NO_START, SPENT, STALLED
from .determined import LOOSE, covariance, directions, quantities, sentences
from .fitted import NOTICEABLE, Fit
from .problem import Problem
from .solve import Found, linearised, still_to_go
from .windows import MEETING, Windows

# A minimiser that stalled or used all its steps still counts as converged if chi^2 could fall by
# less than this, which is a hundredth of a standard deviation.
ARRIVED = 1e-4
# Smaller numbers count as zero.
EXACT = 1e-30
# The correlation of neighbours is significant above this many standard deviations of white noise.
STRUCTURED = 4.0


def neighbours(residuals: Sequence[Float[np.ndarray, "..."]]) -> tuple:
    """Return all residuals but those at the first times, and those one time earlier, as vectors."""
    both = slice(1, None), slice(-1)
    return tuple(np.concatenate([x[times].ravel() for x in residuals]) for times in both)


def structure(
    one: Float[np.ndarray, " n"], after: Float[np.ndarray, " n"], rms: float, least: float
) -> float:
    """Return the share of rms common to neighbouring residuals (n,), or 0.

    It counts if it is significant and above `least`. For independent errors, the sum of products
    has mean zero and deviation sqrt(sum of their squares). A slow part adds its square to each.
    """
    common = np.sum(one * after)
    squares = np.sum(one**2 + after**2) / 2
    deviation = np.sqrt(np.sum((one * after) ** 2))
    share = np.sqrt(max(common, 0.0) / max(squares, EXACT))
    surely = common / max(deviation, EXACT) > STRUCTURED
    return float(share) if surely and share * rms > least else 0.0


def judged(
    problem: Problem,
    found: Found,
    starts: tuple[float, ...],
    adjoint: str,
) -> Fit:
    """Build the `Fit` from the point that a minimiser found."""
    coordinates = problem.coordinates
    own, rest = np.split(np.asarray(found.x), [coordinates.size])
    x = jnp.asarray(np.append(coordinates.resolved(own), rest), problem.dtype)
    own = x[: coordinates.size]
    names = tuple(coordinates.names)
    parameters = coordinates.parameters(own)
    flat, start = (np.asarray(coordinates.flat(p)) for p in (parameters, coordinates.start))
    slopes = np.asarray(coordinates.slopes(own))
    value, jacobian, signals, residuals = jax.tree.map(np.asarray, linearised(problem, x))
    jacobian = _own(jacobian, flat.size)
    samples = int(sum(np.isfinite(trace.data).sum() for trace in problem.traces))
    known = all(trace.sigma is not None for trace in problem.traces)
    squares = sum(np.sum(np.square(r)) for r in residuals)
    free = max(samples - flat.size, 1)
    # Without sigma, the residuals are in units of the rms of the data.
    noise = 1.0 if known else float(np.sqrt(max(squares, EXACT) / free))
    residuals = tuple(r / noise for r in residuals)
    code = int(found.code)
    known_directions = ()
    undetermined = ()
    sides = coordinates.sides(parameters)
    if code in (SPENT, STALLED) and _left(value, jacobian, sides) < ARRIVED * noise**2:
        code = CONVERGED
    matrix = np.full((flat.size, flat.size), np.nan)
    step_error = np.nan
    residue = 0.0
    if code not in (NO_START, NO_GRADIENT):
        by_parameter = jacobian / slopes
        # A logarithm is meaningless for a parameter that is zero within its error.
        known_to = noise / np.maximum(np.linalg.norm(by_parameter, axis=0), EXACT)
        reference = np.where(start != 0, start, coordinates.slopes(jnp.zeros_like(own)))
        vanishing = (np.abs(flat) < LOOSE * np.abs(reference)) & (LOOSE * np.abs(flat) < known_to)
        # Directions are in log theta, so that their components are the exponents of a product.
        sizes = np.where(vanishing, reference, flat)
        known_directions = tuple(directions(by_parameter, sizes, noise))
        matrix = covariance(known_directions, sizes)
        stiffnesses = quantities(problem, parameters, flat, sizes)
        undetermined = sentences(known_directions, names, stiffnesses)
        finer = linearised(problem.finer(), x)[0]
        step_error = float(np.max(np.abs(np.asarray(finer) - value))) / noise
        rms = np.sqrt(squares / samples) / noise
        residue = structure(*neighbours(residuals), rms, max(NOTICEABLE, step_error))
    windows = 1
    meeting = None
    if isinstance(problem, Windows):
        windows = len(problem.edges) - 1
        meeting = float(MEETING * np.abs(value[-problem.starts.size :]).max())
    return Fit(
        parameters=parameters,
        covariance=matrix,
        names=names,
        signals=signals,
        residuals=residuals,
        samples=samples,
        noise=noise if known else noise * float(problem.traces[0].size),
        directions=known_directions,
        undetermined=undetermined,
        explained=1 - float(squares) / max(problem.still, EXACT),
        residue=residue,
        at_bounds=tuple(name for name, x in coordinates.unflat(sides).items() if np.any(x)),
        meeting=meeting,
        windows=windows,
        silent=_silent(problem, parameters) if code == NO_GRADIENT else (),
        iterations=int(found.iterations),
        code=code,
        step=float(problem.step),
        run_tolerance=None if problem.run_tolerance is None else float(problem.run_tolerance),
        step_error=step_error,
        return_error=way_back(problem, parameters),
        adjoint=adjoint,
        starts=tuple(cost / noise**2 for cost in starts),
        traces=problem.traces,
        problem=problem,
        **problem.scene(parameters).origin,
    )


def _left(value, jacobian, sides):
    # Return the possible decrease of |value|^2 within bounds. A number at its bound that is drawn
    # beyond it only gains what is left to the bound, about its derivative in the free coordinate.
    gradient = value @ jacobian
    drawn = sides * gradient < 0
    free, _ = still_to_go(value, np.where(drawn, 0, jacobian))
    return free + 2 * np.abs(gradient[drawn]).sum()


def _own(jacobian, count):
    # Project the free states of windows out of the columns of the parameters.
    own = jacobian[:, :count]
    others = jacobian[:, count:]
    if others.shape[1] == 0 or not np.isfinite(jacobian).all():
        return own
    basis = np.linalg.qr(others)[0]
    return own - basis @ (basis.T @ own)


def way_back(problem: Problem, parameters: dict[str, Numbers]) -> float:
    """Return the return error of a run; infinite for solvers that are not splitting methods."""
    if not isinstance(problem.solver, AbstractSplitting):
        return np.inf
    return float(_way_back(problem, parameters))


@compiled
def _way_back(problem, parameters):
    lattice, state = problem.at(parameters)
    steps = jnp.ceil((problem.t1 - problem.t0) / problem.step).astype(int)
    return return_error(lattice, state, problem.t0, problem.t1, steps, problem.solver)


def _silent(problem, parameters):
    # Return (index of the term, contacts that never close).
    lattice = problem.scene(parameters)
    times = jnp.linspace(problem.t0, problem.t1, 129)
    run = problem.run(parameters, times)
    overlaps = jax.vmap(
        lambda t, u: [[c.overlap for c in term.compressions(t, u)] for term in lattice.terms]
    )
    never = [
        (i, tuple(np.flatnonzero(~np.any(np.asarray(gaps) > 0, axis=0)).tolist()))
        for i, contacts in enumerate(overlaps(run.ts, run.us))
        for gaps in contacts
        if gaps is not None
    ]
    return tuple(one for one in never if one[1])
