"""`fit`: the fit of scene parameters to measured traces."""

from collections.abc import Sequence

import diffrax
import equinox as eqx
import jax.numpy as jnp
import numpy as np
from diffrax import AbstractSolver

from ..base.checks import one_of, refuse, whole
from ..base.checks import tolerance as checked_tolerance
from ..base.printing import numbers
from ..base.tuning import one_thread
from ..base.types import Count, Parameter, Scalar, Scene
from ..flow import Reversible
from .descent import NO_GRADIENT, NO_START, NOT_FINITE, SPENT, descend
from .fitted import Fit
from .judge import judged, way_back
from .parameters import Bounds
from .problem import Start, prepared
from .solve import Found, MeanSquare, evaluated, least_squares, patience
from .traces import Traces
from .windows import cut

METHODS = ("least squares", "gradient")
# Integrating backwards is trusted if the return error is below this.
RETURNS = 1e-8
# A step longer than this times what the fitted scene needs is shortened, and the fit goes on.
TOO_LONG = 1.3
# The tolerance must be below this: with a larger one every start would count as converged.
MOST = 1e-2


@one_thread
def fit(
    scene: Scene,
    start: dict[str, Parameter],
    traces: Traces | Sequence[Traces],
    *,
    state: Start,
    bounds: Bounds = None,
    t0: Scalar = 0.0,
    step: Scalar | None = None,
    solver: AbstractSolver | None = None,
    run_tolerance: Scalar | None = None,
    windows: Count = 1,
    method: str = "least squares",
    optimiser: object = None,
    starts: Count = 1,
    spread: Scalar = 0.2,
    seed: Count = 0,
    max_steps: Count = 100,
    tolerance: Scalar = 1e-8,
    throw: bool | None = None,
) -> Fit:
    r"""Fit parameters of a scene: minimise the sum over samples of ((signal - data)/sigma)^2.

    The method is Levenberg-Marquardt (MINPACK) with forward-mode derivatives, or gradient descent
    (optax) with reverse-mode ones, through a run at one fixed step.

    **Arguments:**

    - `scene`: a function from a dict of parameters to a `Lattice`. Each new one compiles again, so
      reuse it.
    - `start`: dict from name to a number or an array, where the search begins.
    - `traces`: `Traces`, or a list of them for several kinds of sensors.
    - `state`: a `State` at t0, or a function (parameters, lattice) that returns one, as for an
      unknown impact velocity.
    - `bounds`: dict from name to (low, high), `None` for no bound: (0, None) for a stiffness. They
      are kept by a transformation.
    - `t0`: the start time of the scene. `step`, `solver`: as in `simulate`; `None` takes SRKN11b,
      or Dopri8 if a force depends on velocities, at h omega_max = 1/2.
    - `run_tolerance`: the `tolerance` of adaptive runs instead of a fixed step, for scenes that
      are stiff part of the time, such as impacts. Only for least squares in one window.
    - `method`: `"least squares"`, or `"gradient"` for more than a few hundred parameters.
    - `optimiser`: of optax, for `"gradient"`; `None` is L-BFGS. Derivatives use `Reversible` if
      integrating back returns to the start within 1e-8, else checkpoints (see `return_error` and
      `adjoint` of the result).
    - `starts`: their number. The first is `start`, the others are Gaussian around it with relative
      deviation `spread`, within bounds, from `seed`. The best fit is returned.
    - `windows`: the number of pieces with free initial states (multiple shooting), for long or
      chaotic records. Each should be shorter than the time in which neighbouring trajectories
      diverge. Needs sensors at most sites.
    - `max_steps`: of the minimiser. `tolerance`: relative change of parameters and residuals at
      convergence, < 0.01.
    - `throw`: raise an error if the fit fails; `None` does.

    **Returns:** `Fit`. 20 beads, 4 sensors and 4 parameters take well below a second.
    **Raises** ValueError for invalid input; with `throw`, RuntimeError if the start is not finite,
    the traces depend on no parameter there (as behind contacts that never close), or the minimiser
    does not converge.
    Source: Levenberg, Quart. Appl. Math. 2, 164 (1944); Marquardt, SIAM J. Appl. Math. 11, 431 (1963); Moré, Lecture
    Notes in Mathematics 630, 105 (1978).

    **Example:**

    >>> scene = lambda p: gx.Lattice(1.0, gx.Bond(gx.Shift(1, "fixed"), gx.Linear(p["stiffness"])), sites=2)
    >>> times = np.linspace(0.0, 5.0, 11)
    >>> traces = gx.Traces(times, displacement=np.cos(np.sqrt(1.2) * times), sites=0, sigma=1e-3)
    >>> found = gx.fit(scene, {"stiffness": 1.0}, traces, state=gx.State(np.ones(2), np.zeros(2)))
    >>> round(float(found.parameters["stiffness"]), 4)
    1.2
    """
    tolerance = checked_tolerance("tolerance", tolerance, MOST)
    windows = whole("windows", windows, 1)
    starts = whole("starts", starts, 1)
    max_steps = whole("max_steps", max_steps, 1)
    problem = prepared(
        scene,
        start,
        traces,
        state=state,
        bounds=bounds,
        t0=t0,
        step=step,
        solver=solver,
        run_tolerance=run_tolerance,
    )
    # A lattice that remembers has no solver and no reverse mode; windows would start without memory.
    past = problem.solver is None
    if one_of("method", method, METHODS) == METHODS[1] and (windows > 1 or run_tolerance or past):
        kinds = "windows, run_tolerance or forces that read the past"
        refuse("method", f"{METHODS[0]!r} with {kinds}", repr(method))
    if windows > 1 and (run_tolerance or past):
        refuse("windows", "1 with run_tolerance or forces that read the past", f"{windows}")
    count = problem.coordinates.size
    x0 = np.zeros((starts, count))
    x0[1:] = np.random.default_rng(whole("seed", seed)).normal(size=x0[1:].shape) * spread
    if windows > 1:
        problem = cut(problem, windows)
        x0 = np.concatenate([x0, np.zeros((starts, problem.starts.size))], axis=1)
    problem, failed = _looked_at(problem, x0[0])
    if failed is not None:
        return _ended(judged(problem, Found(x0[0], np.nan, 0, failed), (), "forward mode"), throw)
    reached = ()
    for _ in range(3):
        every, adjoint = _minimised(problem, x0, method, optimiser, tolerance, max_steps)
        costs = np.array([found.cost if np.isfinite(found.cost) else np.inf for found in every])
        # Of the starts that reach the least cost, within the tolerance, take the first.
        best = every[int(np.argmax(costs <= (1 + tolerance) * costs.min()))]
        reached = reached or tuple(2 * float(cost) for cost in costs)
        x0 = best.x[None]
        parameters = problem.coordinates.parameters(jnp.asarray(best.x[:count], problem.dtype))
        _refuse_beyond(problem, parameters)
        fixed = step is not None or run_tolerance is not None
        wanted = problem.step if fixed else problem.pace(parameters)[1]
        shorter = float(problem.step) > TOO_LONG * float(wanted)
        later = problem.times(parameters).max() > float(problem.t1) * (1 + 1e-9)
        if shorter:
            problem = problem.with_step(wanted)
        if later:
            # This never happens with windows, which refuse unknown offsets.
            problem = eqx.tree_at(lambda p: p.t1, problem, problem.end(parameters))
        if not shorter and not later:
            break
    return _ended(judged(problem, best, reached, adjoint), throw)


def _refuse_beyond(problem, parameters):
    # While it was traced, the scene could not check its numbers.
    try:
        problem.at(parameters)
    except ValueError as error:
        there = ", ".join(f"{name} = {numbers(np.asarray(x))}" for name, x in parameters.items())
        refuse(
            "bounds",
            "some that keep the fit where the scene is defined",
            f"a fit that ends at {there}",
            f"There the scene says: {error} Give bounds={{name: (0, None)}} for what is never negative.",
        )


def _looked_at(problem, x):
    # Return the problem with scales for zero parameters, and a failure code or `None`.
    coordinates = problem.coordinates
    value, jacobian = evaluated(problem, x)
    jacobian = jacobian[:, : coordinates.size]
    if not (np.isfinite(value).all() and np.isfinite(jacobian).all()):
        return problem, NO_START
    if not np.any(jacobian):
        return problem, NO_GRADIENT
    if not coordinates.sizeless:
        return problem, None
    # A unit change of these then changes the signals by the size of the data, as of the others.
    sized = coordinates.sized(np.sqrt(problem.still), np.linalg.norm(jacobian, axis=0))
    return eqx.tree_at(lambda p: p.coordinates, problem, sized), None


def _minimised(problem, x0, method, optimiser, tolerance, max_steps):
    if method == METHODS[0]:
        delay = patience(problem)
        return [least_squares(problem, x, tolerance, max_steps, delay) for x in x0], "forward mode"
    cost = MeanSquare(problem, Reversible(), None)
    if problem.moving or not way_back(problem, problem.coordinates.start) < RETURNS:
        steps = int(np.ceil(float(problem.t1 - problem.t0) / float(problem.step)))
        most = 1 << steps.bit_length()
        cost = MeanSquare(problem, diffrax.RecursiveCheckpointAdjoint(), most)
    found = []
    for x in np.asarray(x0, problem.dtype):
        end = descend(cost, x, optimiser, max_steps, tolerance)
        code = SPENT if end.code == NOT_FINITE else end.code
        found.append(Found(end.x, cost.samples * end.least, len(end.values) - 1, code))
    return found, type(cost.adjoint).__name__


def _ended(result, throw):
    if not result.converged and (throw is None or throw):
        raise RuntimeError(result.outcome)
    return result
