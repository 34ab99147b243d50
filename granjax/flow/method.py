"""Which solver and which step: the choice, and what is refused."""

import math
from typing import Any, NamedTuple

import diffrax
import jax
import jax.numpy as jnp
import numpy as np

from ..checks import concrete, refuse, show, traced
from ..lattice import Lattice, acceleration_only, split_system
from ..programs import concretely, once
from ..solvers import RKN86, AbstractNystrom, AbstractSplitting, SRKN11b
from ..solvers.stability import refused_from
from ..terms.waveforms import count_breaks
from ..types import Number, Scalar, StateLike
from .control import least_tolerance, refuse_unresolved, rounding_unit
from .dispatch import facts
from .inputs import checked_size
from .run import Found
from .stiffness import chosen, frequency_bound, gathered_frequency, linear_frequency, softens

# h omega of the default step
STEP_FRACTION = 0.5
# neighbourhoods from which energy may gather in a bond, where it is looked at afterwards; the second one for a law
# without a floor
GATHERED = (4, 1)
# how far beyond its bound a run at the default step may go before it is taken again
PASSED = 1.1
DEFAULT_TOLERANCE = 1e-8
MOST_STEPS = 1e8
# of a run's length, below which the rounding of t0 is none that could be felt
NEAR = 1e-9
# built once: making a module takes longer than a short run
_FIXED, _ADAPTIVE, _GENERAL = SRKN11b(), RKN86(), diffrax.Dopri8()


def checked_method(lattice: Lattice, solver: Any, step: Any, tolerance: Any) -> tuple:
    """Solver, step and tolerance that go together, chosen where they are not given."""
    if solver is not None and not isinstance(solver, diffrax.AbstractSolver):
        name = getattr(solver, "__name__", None) or repr(solver)
        refuse(
            "solver",
            "a solver, such as gx.SRKN11b()",
            name,
            "Solvers are instances: write the brackets.",
        )
    if solver is not None and solver.term_structure is not diffrax.AbstractTerm:
        remedy = "gx.VelocityVerlet() splits by itself."
        refuse("solver", "one for a single vector field", type(solver).__name__, remedy)
    step, tolerance = checked_size("step", step), checked_size("tolerance", tolerance)
    found = facts(lattice)
    dtype, velocity, splits = found.dtype, found.reads_velocity, found.splits
    if solver is None:
        if tolerance is not None:
            solver = _GENERAL if velocity else _ADAPTIVE
        elif splits:
            solver = _FIXED
        else:
            solver = _GENERAL
            tolerance = None if step is not None else _default_tolerance(dtype)
    else:
        tolerance = _refuse_unfit(lattice, solver, step, tolerance, found)
    return solver, step, None if tolerance is None else checked_tolerance(tolerance, dtype)


def checked_tolerance(tolerance: Any, dtype: Any) -> Any:
    """A tolerance that the floating type holds, as an array, so that another one compiles nothing."""
    tolerance = checked_size("tolerance", tolerance)
    value, least = concrete(tolerance), least_tolerance(dtype)
    if value is not None and value < least:
        refuse(
            "tolerance",
            f"at least {least:.1e}, what {dtype} holds",
            show(value),
            "Use a larger one.",
        )
    if value is not None and value >= 1:
        refuse(
            "tolerance",
            "below 1, the size of the motion itself",
            show(value),
            "1e-6 to 1e-9 are usual.",
        )
    return number(tolerance, dtype)


def _refuse_unfit(lattice, solver, step, tolerance, found):
    """The tolerance, where a solver that is asked for by name has one; a lattice or sizes that it cannot serve."""
    dtype, velocity, splits = found.dtype, found.reads_velocity, found.splits
    if isinstance(solver, AbstractSplitting):
        if not splits:
            split_system(lattice)  # refuses, naming the term
        if tolerance is not None:
            refuse(
                "tolerance",
                f"a fixed step with {type(solver).__name__}",
                f"tolerance={show(tolerance)}",
                "A symplectic method loses its virtue under adaptive steps; use step=, or solver=gx.RKN86().",
            )
    if velocity and isinstance(solver, AbstractNystrom):
        acceleration_only(lattice)  # refuses, naming the term
    if tolerance is not None and not isinstance(solver, diffrax.AbstractAdaptiveSolver):
        wanted = "one with an error estimate for a tolerance"
        refuse("solver", wanted, type(solver).__name__, "Use gx.RKN86(), or step=.")
    if tolerance is None and step is None and not isinstance(solver, AbstractSplitting):
        tolerance = (
            _default_tolerance(dtype)
            if isinstance(solver, diffrax.AbstractAdaptiveSolver)
            else None
        )
    return tolerance


def number(x: Any, dtype: Any) -> Any:
    """One number as an array of a type: NumPy's where it is known, which is quickly made."""
    return x.astype(dtype) if isinstance(x, jax.Array) else dtype.type(x)


def _default_tolerance(dtype):
    return max(DEFAULT_TOLERANCE, least_tolerance(dtype))


class Steps(NamedTuple):
    """Equal steps: their size, their number (`None` where it is traced), how they were chosen, a remark.

    `watch`: whether the run may pass the bound that set the step, and so is to be looked at when it has ended.
    """

    size: Number
    count: int | None
    choice: str
    remark: str
    watch: bool


def fixed_step(
    lattice: Lattice,
    state: StateLike,
    t0: Scalar,
    t1: Scalar,
    step: Scalar | None,
    solver: diffrax.AbstractSolver | type,
    frames: int,
    bound: Any = None,
) -> Steps:
    """The steps of a run, which fit so many equal frames.

    `bound`: the highest frequency, where a run has shown it; by default that of the scene's energy.
    """
    about, limit, watch, given = facts(lattice), refused_from(solver), False, step is not None
    if not given:
        bound, watch = reachable(lattice, state, t0, t1) if bound is None else (bound, True)
        bound = chosen(bound)
        if not isinstance(bound, jax.core.Tracer) and not bound > 0:
            refuse(
                "step",
                "a time step",
                "None",
                "Nothing is stiff at this energy (a sonic vacuum at rest?), so no time scale sets one: give step=.",
            )
        fraction = min(STEP_FRACTION, limit or STEP_FRACTION)
        step = fraction / bound
    known = not traced((step, t0, t1))
    if given:
        choice = "given step"
        if known and limit is not None and not (about.traced or traced(state)):
            _refuse_unstable(lattice, state, t0, t1, step, solver, limit)
        if isinstance(step, jax.core.Tracer):
            step = jnp.where(step > 0, step, jnp.nan)  # what the outcome then says
    else:
        choice = f"default step, h omega_max <= {fraction:.3g}"
        if known and useless(step, t0, t1):
            refuse(
                "step",
                "a time step",
                "None",
                f"The bound on the stiffness at this energy asks for steps of {step:.1e}: no useful one (a law "
                "without a floor, or far more energy than moves). Give step= or tolerance=.",
            )
    remark = ""
    if softens(lattice):
        remark = "An exponent below 1: a contact that re-opens is infinitely stiff, and no step bound exists there."
    span = chosen((t1 - t0) / frames)
    # a few ulp of slack, so that 120/0.05 is 2400 and not 2401
    count = span / step * (1 - 1e-12)
    if not known:
        count = jnp.maximum(jnp.ceil(count), 1)
        return Steps((t1 - t0) / (count * frames), None, choice, remark, watch)
    refuse_unresolved(t0, t1, step, about.dtype)
    count = max(math.ceil(count), 1) * frames
    more = count_breaks(lattice.breaks, t0, t1) if about.has_breaks else 0
    steps = None if isinstance(more, jax.core.Tracer) else count + int(more)
    return Steps((t1 - t0) / count, steps, choice, remark, watch)


def refuse_far(lattice: Lattice, state: StateLike, t0: Scalar, t1: Scalar) -> None:
    """The same refusal for adaptive steps, which are about as long as the default one."""
    about = facts(lattice)
    eps = rounding_unit(about.dtype)
    # as a rule; the rest takes longer
    if traced((t0, t1)) or eps * abs(t0) < NEAR * (t1 - t0) or about.traced or traced(state):
        return
    omega = linear_bound(lattice) or reachable(lattice, state, t0, t1)[0]
    if omega > 0:
        refuse_unresolved(t0, t1, STEP_FRACTION / omega, about.dtype)


def passed(solver: diffrax.AbstractSolver | type, run: Found, step: Number) -> Any:
    """The highest frequency that a run at the default step has reached, where it passed the bound; else `None`."""
    omega = run.stats["omega"]
    if isinstance(omega, jax.core.Tracer):
        return None
    omega = np.asarray(omega).item()
    allowed = PASSED * min(STEP_FRACTION, refused_from(solver) or STEP_FRACTION)
    return omega if step * omega > allowed else None


def useless(step: Any, t0: Any, t1: Any) -> bool:
    """Whether a step is none, or one of which a run has more than anybody waits for."""
    return bool(not math.isfinite(step) or (t1 - t0) / step > MOST_STEPS)


def reachable(lattice: Lattice, state: StateLike, t0: Scalar, t1: Scalar) -> tuple:
    """(A bound on the frequencies at this energy, a Python number where it is known, and whether a run may pass it)."""
    span = number(t0, np.dtype(float)), number(t1, np.dtype(float))
    if facts(lattice).traced or traced((state, t0, t1)):
        return frequency_bound(*jax.tree.map(chosen, (lattice, state, *span))), False
    for neighbourhood in GATHERED:
        found = gathered_frequency(lattice, state, *span, neighbourhood)
        # plain numbers inside a transformation of something else
        if isinstance(found, jax.core.Tracer):
            return frequency_bound(lattice, state, *span), False
        bound, beyond = np.asarray(found).tolist()
        if not bound > 0 or not useless(STEP_FRACTION / bound, t0, t1):
            break
    return bound, bool(beyond)


@once
def linear_bound(lattice: Lattice) -> float:
    """A bound on the linear frequencies of a lattice that is known, quickly found and kept."""
    return float(concretely(linear_frequency, lattice, 0))


def _refuse_unstable(lattice, state, t0, t1, step, solver, limit):
    omega = linear_bound(lattice)
    if 0 < step * omega <= limit:
        return
    what = "the highest linear frequency"
    if omega > 0:
        omega = concrete(linear_frequency(lattice))
    else:
        omega = concrete(reachable(lattice, state, t0, t1)[0])
        what = "the highest frequency at this energy"
    if omega is not None and step * omega > limit:
        refuse(
            "step",
            f"at most {limit / omega:.4g}, where {type(solver).__name__} is stable",
            f"{step}",
            f"{what[0].upper()}{what[1:]} is {omega:.4g} and the limit h omega < {limit:.4g}.",
        )
