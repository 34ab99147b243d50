"""`fit`: parameters of a scene from measured traces."""

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..checks import one_of, positive, refuse, whole
from ..flow import Reversible, frequency_bound
from ..flow.dispatch import facts
from ..flow.inputs import checked_state
from ..flow.method import STEP_FRACTION
from ..parameters import Coordinates
from ..solvers import SRKN11b
from ..terms import Dashpot
from ..tuning import one_thread
from .judge import judged, looked_at, way_back
from .problem import Problem, as_state, check_places, checked_scene, known_times
from .solve import gradient_descent, least_squares
from .traces import checked_traces
from .windows import cut

METHODS = ("least squares", "gradient")
# a return error below which integrating backwards is trusted
RETURNS = 1e-8
# room behind the last sample for an offset that is fitted, in record lengths
ROOM = 0.1
# a step that is this much longer than the fitted scene would choose is shortened, and the fit goes on
TOO_LONG = 1.3


@one_thread
def fit(scene, start, traces, *, state, bounds=None, t0=0.0, step=None, solver=None, windows=1, method="least squares",
        optimiser=None, starts=1, spread=0.2, seed=0, max_steps=100, tolerance=1e-8, throw=None):
    r"""Parameters of a scene that minimise the sum over samples of ((signal - data)/sigma)^2.

    Levenberg and Marquardt's method (optimistix) with derivatives in forward mode, or descent along gradients (optax)
    in reverse mode, through a run at one fixed step.

    **Arguments:**

    - `scene`: a function of a dict of parameters that returns a `Lattice`; keep one function for many fits, since
      another compiles anew. `start`: dict from name to a number or an array, where the search begins.
    - `traces`: `Traces`, or a list of them where several kinds were measured.
    - `state`: at t0, a `State`, or a function (parameters, lattice) that returns one (an unknown velocity of impact).
    - `bounds`: dict from name to (low, high), `None` for no bound, kept by a transformation: (0, None) for a stiffness.
    - `t0`: when the scene starts. `step`, `solver`: as in `simulate`; `None` takes SRKN11b, or Dopri8 where a force
      reads velocities, at h omega_max = 1/2.
    - `method`: `"least squares"`, or `"gradient"` for more than some hundred parameters: descent by `optimiser` (of
      optax; `None` is L-BFGS). Its derivatives are taken by `Reversible` where integrating back returns to the start
      to 1e-8, else from checkpoints; `return_error` and `adjoint` of the result say which.
    - `starts`: how many, the first at `start`, the others Gaussian around it with deviation `spread` (relative, within
      bounds), from `seed`; they run side by side and the best is returned.
    - `windows`: pieces of the record, each with a free state at its start (multiple shooting), for chaotic or long
      records: as many as make each short beside the time in which neighbouring runs part. Wants sensors at most sites.
    - `max_steps`: of the minimiser. `tolerance`: relative change of parameters and residuals at which it ends.
    - `throw`: raise where it does not converge; `None` does.

    **Returns:** `Fit`. **Raises** ValueError for input that cannot be meant; RuntimeError where `throw` and the fit
    fails: not finite at the start, traces that do not depend on any parameter there (contacts that never close on the
    way to the sensors have no gradient), steps spent. Typical: 20 beads, 4 sensors, 4 parameters: well below a second.
    Source: Levenberg, Quart. Appl. Math. 2, 164 (1944); Marquardt, SIAM J. Appl. Math. 11, 431 (1963).
    """
    coordinates = Coordinates(start, bounds)
    problem = prepared(scene, coordinates, traces, state, t0, step, solver)
    windows, starts, spread = whole("windows", windows, 1), whole("starts", starts, 1), positive("spread", spread)
    if one_of("method", method, METHODS) == METHODS[1] and windows > 1:
        refuse("method", f"{METHODS[0]!r} with windows", repr(method))
    x0 = np.zeros((starts, coordinates.size))
    x0[1:] = np.random.default_rng(seed).normal(size=x0[1:].shape) * float(spread)
    x0 = jnp.asarray(x0, problem.step.dtype)
    if windows > 1:
        problem = cut(problem, windows)
        x0 = jax.vmap(problem.guess)(x0)
    failed = looked_at(problem, x0[0])
    if failed is not None:
        return _ended(failed, throw)
    reached = ()
    for _ in range(3):
        found, adjoint = _minimised(problem, x0, method, optimiser, tolerance, whole("max_steps", max_steps, 1))
        costs = np.where(np.isfinite(found.cost), found.cost, np.inf)
        best = int(np.argmin(costs))
        reached = reached or tuple(float(2 * c) for c in costs)
        plain = problem.problem if windows > 1 else problem
        x0, own = found.x[best : best + 1], found.x[best, : coordinates.size]
        shorter = None if step is not None else shorter_step(plain, own)
        later = longer(plain, own)
        if shorter is None and later is None:
            break
        problem = problem if shorter is None else problem.with_step(shorter)
        problem = problem if later is None else eqx.tree_at(lambda p: p.t1, problem, later)
    return _ended(judged(problem, jax.tree.map(lambda x: x[best], found), reached, adjoint), throw)


def _minimised(problem, x0, method, optimiser, tolerance, max_steps):
    """What a method found from every start, and the name of its derivatives."""
    if method == METHODS[0]:
        return least_squares(problem, x0, tolerance, max_steps), "forward mode"
    adjoint, steps = reverse_mode(problem)
    found = gradient_descent(problem, x0, optimiser, tolerance, max_steps, adjoint, steps)
    return found, type(adjoint).__name__


def reverse_mode(problem):
    """The adjoint that serves a problem in reverse mode, and the most steps that it keeps checkpoints for."""
    moving = any(isinstance(trace.offset, str) for trace in problem.traces)
    if not moving and way_back(problem, problem.coordinates.start) < RETURNS:
        return Reversible(), None
    steps = int(np.ceil((problem.t1 - problem.t0) / problem.step)) + 1
    return diffrax.RecursiveCheckpointAdjoint(), 1 << (steps - 1).bit_length()


def prepared(scene, coordinates, traces, state, t0, step, solver):
    """The checked problem, with a step for the start."""
    parameters = coordinates.start
    lattice, traces = checked_scene(scene, parameters), checked_traces(traces)
    if len(traces) > 1 and any(trace.sigma is None for trace in traces):
        refuse("sigma", "one for each of several traces", "None", "It says how they weigh against each other.")
    make_state = state if callable(state) else None
    given = None if make_state else checked_state(lattice, state)
    begin = given
    if make_state is not None:
        begin = checked_state(lattice, as_state(make_state(parameters, lattice), lattice.dtype))
    check_places(traces, lattice, begin, parameters)
    if any(trace.data.dtype != lattice.dtype for trace in traces):
        refuse("scene", f"a lattice of {traces[0].data.dtype}, as the traces are", f"{lattice.dtype}")
    times = known_times(traces, parameters)
    floating = any(isinstance(trace.offset, str) for trace in traces)
    length = times.max() - times.min()
    end = times.max() + ROOM * length if floating else times.max()
    if not floating and times.min() < t0 - 1e-9 * length:
        refuse("times", f"samples from t0 = {t0} on", f"{times.min()}", "Give offset=, or an earlier t0.")
    if solver is None:
        solver = SRKN11b() if facts(lattice).splits else diffrax.Dopri8()
    dtype = lattice.dtype
    problem = Problem(scene, make_state, given, coordinates, traces, jnp.asarray(t0, dtype), jnp.asarray(end, dtype),
                      jnp.asarray(1.0, dtype), solver)
    step = _default_step(problem, parameters) if step is None else float(positive("step", step))
    return problem.with_step(step)


def _default_step(problem, parameters):
    lattice = problem.lattice(parameters)
    state = checked_state(lattice, problem.state(parameters, lattice))
    omega = float(frequency_bound(lattice, state, problem.t0, problem.t1))
    if not omega > 0:
        refuse("step", "a time step", "None", "Nothing is stiff at this energy, so no time scale sets one: give step=.")
    # a chain of dashpots decays as fast as 4 c/m
    rates = [float(jnp.max(term.coefficient)) for term in lattice.terms if isinstance(term, Dashpot)]
    lightest = min(float(jnp.min(m)) for m in jax.tree.leaves(lattice.mass))
    return min([STEP_FRACTION / omega, *(lightest / c for c in rates if c > 0)])


def shorter_step(problem, x):
    """The step that the parameters x ask for, where it is much shorter than the problem's; else `None`."""
    step = _default_step(problem, problem.coordinates.parameters(x))
    return step if problem.step > TOO_LONG * step else None


def longer(problem, x):
    """A later end, where the offsets of the parameters x have moved samples behind the problem's; else `None`."""
    times = known_times(problem.traces, problem.coordinates.parameters(x))
    if times.max() <= float(problem.t1) * (1 + 1e-9):
        return None
    return jnp.asarray(times.max() + ROOM * np.ptp(times), problem.t1.dtype)


def _ended(result, throw):
    if not result.converged and (throw is None or throw):
        raise RuntimeError(result.outcome)
    return result
