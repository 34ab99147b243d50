"""`fit`: parameters of a scene from measured traces."""

from collections.abc import Sequence

import diffrax
import equinox as eqx
import jax.numpy as jnp
import numpy as np
from diffrax import AbstractSolver

from ..checks import one_of, refuse
from ..checks import tolerance as checked_tolerance
from ..descent import NO_GRADIENT, NO_START
from ..flow import Reversible
from ..parameters import Bounds
from ..tuning import one_thread
from ..types import Count, Parameter, Scalar, Scene
from .fitted import Fit
from .judge import judged, way_back
from .problem import Problem, Start, prepared
from .solve import Found, MeanSquare, evaluated, gradient_descent, least_squares, patience
from .traces import Traces
from .windows import cut

METHODS = ("least squares", "gradient")
# a return error below which integrating backwards is trusted
RETURNS = 1e-8
# a step that is this much longer than the fitted scene would choose is shortened, and the fit goes on
TOO_LONG = 1.3
# a relative change from which on every start would count as an end
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
    r"""Parameters of a scene that minimise the sum over samples of ((signal - data)/sigma)^2.

    Levenberg and Marquardt's method (MINPACK's) with derivatives in forward mode, or descent along gradients (optax) in
    reverse mode, through a run at one fixed step.

    **Arguments:**

    - `scene`: a function of a dict of parameters that returns a `Lattice`; keep one function for many fits, since
      another compiles anew. `start`: dict from name to a number or an array, where the search begins.
    - `traces`: `Traces`, or a list of them where several kinds were measured.
    - `state`: at t0, a `State`, or a function (parameters, lattice) that returns one (an unknown velocity of impact).
    - `bounds`: dict from name to (low, high), `None` for no bound, kept by a transformation: (0, None) for a stiffness.
    - `t0`: when the scene starts. `step`, `solver`: as in `simulate`; `None` takes SRKN11b, or Dopri8 where a force
      reads velocities, at h omega_max = 1/2.
    - `run_tolerance`: that of adaptive runs (`tolerance` of `simulate`) in place of a fixed step, by least squares in
      one window: for scenes that are stiff for a part of the time, such as impacts.
    - `method`: `"least squares"`, or `"gradient"` for more than some hundred parameters: descent by `optimiser` (of
      optax; `None` is L-BFGS). Its derivatives are taken by `Reversible` where integrating back returns to the start
      to 1e-8, else from checkpoints; `return_error` and `adjoint` of the result say which.
    - `starts`: how many, the first at `start`, the others Gaussian around it with deviation `spread` (relative, within
      bounds), from `seed`; they run one after another in one program, and the best is returned.
    - `windows`: pieces of the record, each with a free state at its start (multiple shooting), for chaotic or long
      records: as many as make each short beside the time in which neighbouring runs part. Wants sensors at most sites.
    - `max_steps`: of the minimiser. `tolerance`: relative change of parameters and residuals at which it ends, < 0.01.
    - `throw`: raise where it does not converge; `None` does.

    **Returns:** `Fit`. **Raises** ValueError for input that cannot be meant; RuntimeError where `throw` and the fit
    fails: not finite at the start, traces that do not depend on any parameter there (contacts that never close on the
    way to the sensors have no gradient), steps spent. Typical: 20 beads, 4 sensors, 4 parameters: well below a second.
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
    options = dict(state=state, bounds=bounds, t0=t0, step=step, solver=solver)
    problem = prepared(scene, start, traces, **options, run_tolerance=run_tolerance)
    if one_of("method", method, METHODS) == METHODS[1] and (windows > 1 or run_tolerance):
        refuse("method", f"{METHODS[0]!r} with windows or run_tolerance", repr(method))
    if windows > 1 and run_tolerance:
        refuse("windows", "1 with run_tolerance", f"{windows}")
    count = problem.coordinates.size
    x0 = np.zeros((starts, count))
    x0[1:] = np.random.default_rng(seed).normal(size=x0[1:].shape) * spread
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
        # of those that reach one minimum, as far as the tolerance tells, the first
        best = every[int(np.argmax(costs <= (1 + tolerance) * costs.min()))]
        reached = reached or tuple(2 * float(cost) for cost in costs)
        x0 = best.x[None]
        parameters = problem.coordinates.parameters(jnp.asarray(best.x[:count], problem.dtype))
        fixed = step is not None or run_tolerance is not None
        wanted = problem.step if fixed else problem.pace(parameters)[1]
        shorter = float(problem.step) > TOO_LONG * float(wanted)
        later = problem.times(parameters).max() > float(problem.t1) * (1 + 1e-9)
        if shorter:
            problem = problem.with_step(wanted)
        if later:
            # not with windows, which know their times
            problem = eqx.tree_at(lambda p: p.t1, problem, problem.end(parameters))
        if not shorter and not later:
            break
    return _ended(judged(problem, best, reached, adjoint), throw)


def _looked_at(problem, x):
    """The problem with a scale for what starts at zero, and the code of a start x that has no derivatives, or `None`.

    The scale is the change that moves the residuals by their own size.
    """
    coordinates = problem.coordinates
    value, jacobian = evaluated(problem, x)
    jacobian = jacobian[:, : coordinates.size]
    if not (np.isfinite(value).all() and np.isfinite(jacobian).all()):
        return problem, NO_START
    if not np.any(jacobian):
        return problem, NO_GRADIENT
    if not coordinates.sizeless:
        return problem, None
    sized = coordinates.sized(np.linalg.norm(value), np.linalg.norm(jacobian, axis=0))
    return eqx.tree_at(lambda p: p.coordinates, problem, sized), None


def _minimised(problem, x0, method, optimiser, tolerance, max_steps):
    """What a method found from every start, and the name of its derivatives."""
    if method == METHODS[0]:
        delay = patience(problem)
        return [least_squares(problem, x, tolerance, max_steps, delay) for x in x0], "forward mode"
    adjoint, most = reverse_mode(problem)
    cost, x0 = MeanSquare(problem, adjoint, most), np.asarray(x0, problem.dtype)
    found = [gradient_descent(cost, x, optimiser, tolerance, max_steps) for x in x0]
    return found, type(adjoint).__name__


def reverse_mode(problem: Problem) -> tuple[diffrax.AbstractAdjoint | Reversible, int | None]:
    """The adjoint that serves a problem in reverse mode, and the most steps that it keeps checkpoints for."""
    if not problem.moving and way_back(problem, problem.coordinates.start) < RETURNS:
        return Reversible(), None
    steps = int(np.ceil(float(problem.t1 - problem.t0) / float(problem.step))) + 1
    return diffrax.RecursiveCheckpointAdjoint(), 1 << (steps - 1).bit_length()


def _ended(result, throw):
    if not result.converged and (throw is None or throw):
        raise RuntimeError(result.outcome)
    return result
