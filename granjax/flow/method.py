"""Which solver and which step: the choice, and what is refused."""

import diffrax
import jax
import jax.numpy as jnp
import numpy as np

from ..checks import concrete, refuse, show
from ..lattice import acceleration_only, split_system
from ..solvers import RKN86, RKN1210, AbstractSplitting, SRKN11b
from ..terms import Damping
from .inputs import checked_size
from .stiffness import frequency_bound, linear_frequency, softens

# h omega of the default step
STEP_FRACTION = 0.5
DEFAULT_TOLERANCE = 1e-8
MOST_STEPS = 1e8


def checked_method(lattice, solver, step, tolerance):
    """Solver, step and tolerance that go together, chosen where they are not given."""
    if step is not None and tolerance is not None:
        refuse("tolerance", "a fixed step or a tolerance", "both", "Give one of them.")
    if solver is not None and not isinstance(solver, diffrax.AbstractSolver):
        name = getattr(solver, "__name__", None) or repr(solver)
        refuse("solver", "a solver, such as gx.SRKN11b()", name, "Solvers are instances: write the brackets.")
    if solver is not None and solver.term_structure is not diffrax.AbstractTerm:
        remedy = "gx.VelocityVerlet() splits by itself."
        refuse("solver", "one for a single vector field", type(solver).__name__, remedy)
    step, tolerance = checked_size("step", step), checked_size("tolerance", tolerance)
    velocity = [i for i, term in enumerate(lattice.terms) if term.reads_velocity]
    splits = all(isinstance(lattice.terms[i], Damping) for i in velocity)
    if solver is None:
        if tolerance is not None:
            solver = diffrax.Dopri8() if velocity else RKN86()
        elif splits:
            solver = SRKN11b()
        else:
            solver = diffrax.Dopri8()
            tolerance = None if step is not None else _default_tolerance(lattice)
    if isinstance(solver, AbstractSplitting):
        if not splits:
            split_system(lattice)  # refuses, naming the term
        if tolerance is not None:
            refuse(
                "tolerance", f"a fixed step with {type(solver).__name__}", f"tolerance={show(tolerance)}",
                "A symplectic method loses its virtue under adaptive steps; use step=, or solver=gx.RKN86().",
            )
    if isinstance(solver, (RKN86, RKN1210)):
        acceleration_only(lattice)
    if tolerance is not None and not isinstance(solver, diffrax.AbstractAdaptiveSolver):
        wanted = "one with an error estimate for a tolerance"
        refuse("solver", wanted, type(solver).__name__, "Use gx.RKN86(), or step=.")
    if tolerance is None and step is None and not isinstance(solver, AbstractSplitting):
        tolerance = _default_tolerance(lattice) if isinstance(solver, diffrax.AbstractAdaptiveSolver) else None
    value = None if tolerance is None else concrete(tolerance)
    least = 0 if value is None else _least_tolerance(lattice)
    if value is not None and value < least:
        refuse("tolerance", f"at least {least:.1e}, what {lattice.dtype} holds", show(value), "Use a larger one.")
    # an array, so that another tolerance compiles nothing
    return solver, step, None if tolerance is None else jnp.asarray(tolerance, lattice.dtype)


def _least_tolerance(lattice):
    return 16 * float(jnp.finfo(lattice.dtype).eps)


def _default_tolerance(lattice):
    return max(DEFAULT_TOLERANCE, _least_tolerance(lattice))


def fixed_step(lattice, state, t0, t1, step, solver, frames):
    """The step, the number of steps where it is known, what was chosen, and a remark."""
    remark, choice = "", "given step"
    limit = type(solver).stability_limit() if isinstance(solver, AbstractSplitting) else None
    if step is None:
        bound = _known(frequency_bound(lattice, state, jnp.asarray(t0, float), jnp.asarray(t1, float)))
        if not isinstance(bound, jax.core.Tracer) and not bound > 0:
            refuse(
                "step", "a time step", "None",
                "Nothing is stiff at this energy (a sonic vacuum at rest?), so no time scale sets one: give step=.",
            )
        step = STEP_FRACTION / bound
        _refuse_useless(step, t0, t1)
        choice = f"default step, h omega_max <= {STEP_FRACTION}"
        if softens(lattice):
            remark = "An exponent below 1: a contact that re-opens is infinitely stiff, and no step bound exists there."
    else:
        _refuse_unstable(lattice, state, t0, t1, step, solver, limit)
    span = _known((t1 - t0) / frames)
    count = _ceil(span / step)
    steps = None if isinstance(count, jax.core.Tracer) else int(count) * frames
    return (t1 - t0) / (count * frames), steps, choice, remark


def _refuse_useless(step, t0, t1):
    if any(isinstance(x, jax.core.Tracer) for x in (step, t0, t1)):
        return
    if not np.isfinite(step) or (t1 - t0) / step > MOST_STEPS:
        refuse(
            "step", "a time step", "None",
            f"The bound on the stiffness at this energy asks for steps of {step:.1e}: no useful one (a law without a "
            "floor, or energy that is spread over many sites). Give step= or tolerance=.",
        )


def _known(x):
    """The value where differentiation alone stands in the way: a step is a choice, not a function of the scene."""
    return jax.lax.stop_gradient(x) if isinstance(x, jax.Array) else x


def _ceil(x):
    # a few ulp of slack, so that 120/0.05 is 2400 and not 2401
    if isinstance(x, jax.core.Tracer):
        return jnp.maximum(jnp.ceil(x * (1 - 1e-12)), 1)
    return np.maximum(np.ceil(float(x) * (1 - 1e-12)), 1)


def _refuse_unstable(lattice, state, t0, t1, step, solver, limit):
    leaves = (lattice, state, t0, t1, step)
    if any(isinstance(x, jax.core.Tracer) for x in jax.tree.leaves(leaves)):
        return
    if step < 4 * jnp.finfo(lattice.dtype).eps * max(abs(t0), abs(t1)):
        refuse("step", "a step that changes the time", f"{step}", f"At t = {t1} {lattice.dtype} does not resolve it.")
    if limit is None:
        return
    omega = concrete(linear_frequency(lattice, 0))
    if omega is None or 0 < step * omega <= limit:
        return
    omega = concrete(linear_frequency(lattice))
    what = "the highest linear frequency"
    if omega == 0:
        omega = concrete(frequency_bound(lattice, state, jnp.asarray(t0, float), jnp.asarray(t1, float)))
        what = "the highest frequency at this energy"
    if step * omega > limit:
        refuse(
            "step", f"at most {limit / omega:.4g}, where {type(solver).__name__} is stable", f"{step}",
            f"{what[0].upper()}{what[1:]} is {omega:.4g} and the limit h omega < {limit:.4g}.",
        )
