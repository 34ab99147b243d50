"""Which solver and which step: the choice, and what is refused."""

from typing import Any

import diffrax
import jax
import jax.numpy as jnp
import numpy as np

from ..checks import concrete, refuse, show, traced
from ..lattice import Lattice, acceleration_only, split_system
from ..programs import compiled
from ..solvers import RKN86, AbstractNystrom, AbstractSplitting, SRKN11b
from ..solvers.stability import refused_from
from ..terms.tracing import reads
from ..terms.waveforms import count_breaks, functions_of_time
from ..types import Number, Scalar, StateLike
from .control import least_tolerance, refuse_unresolved
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
# tolerance from which on a run is remarked upon, and relative energy error
LOOSE, SUSPICIOUS = 1e-2, 0.02
# where an energy is told again, over the displacements at the end, and how much of it may be lost over what is seen
NEARBY, ROUNDED = 1e-3, 10
MOST_STEPS = 1e8
# places at which a function of time is looked at: in all, about, and in each step; steps at a time
MOST_PLACES = 2**18
PLACES = 8, 2048
BLOCK = 64
# of its range, from which on it leaves what the ends of steps show
LEAP = 0.25
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
    value = None if tolerance is None else concrete(tolerance)
    least = 0 if value is None else least_tolerance(dtype)
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
    # an array, so that another tolerance compiles nothing
    return solver, step, None if tolerance is None else number(tolerance, dtype)


def _refuse_unfit(lattice, solver, step, tolerance, found):
    """The tolerance, where a solver that is asked for by name has one; a lattice or sizes that it cannot serve."""
    dtype, velocity, splits = found.dtype, found.reads_velocity, found.splits
    if isinstance(solver, AbstractSplitting):
        if not splits:
            split_system(lattice)  # refuses, naming the term
            _refuse_unsaid(lattice)
        if tolerance is not None:
            refuse(
                "tolerance",
                f"a fixed step with {type(solver).__name__}",
                f"tolerance={show(tolerance)}",
                "A symplectic method loses its virtue under adaptive steps; use step=, or solver=gx.RKN86().",
            )
    if velocity and isinstance(solver, AbstractNystrom):
        acceleration_only(lattice)  # refuses, naming the term
        _refuse_unsaid(lattice)
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


def _refuse_unsaid(lattice):
    """Where a force reads the velocity and its kind says that it does not."""
    names = [type(term).__name__ for term in lattice.terms if reads(term, lattice).velocity]
    refuse(
        "solver",
        "forces that do not read the velocity",
        f"{', '.join(names)}, whose `dependence` does not say so",
        "Use solver=diffrax.Dopri8() with tolerance=....",
    )


def number(x: Any, dtype: Any) -> Any:
    """One number as an array of a type: NumPy's where it is known, which is quickly made."""
    return x.astype(dtype) if isinstance(x, jax.Array) else dtype.type(x)


def _default_tolerance(dtype):
    return max(DEFAULT_TOLERANCE, least_tolerance(dtype))


def fixed_step(
    lattice: Lattice,
    state: StateLike,
    t0: Scalar,
    t1: Scalar,
    step: Scalar | None,
    solver: diffrax.AbstractSolver | type,
    frames: int,
    bound: Any = None,
) -> tuple:
    """The step, the number of steps where it is known, what was chosen, a remark, and whether the run may pass it.

    `bound`: the highest frequency, where a run has shown it; by default that of the scene's energy.
    """
    remark, choice, known, beyond = "", "given step", facts(lattice).known, False
    limit = refused_from(solver)
    if step is None:
        bound, beyond = _bound(lattice, state, t0, t1) if bound is None else (bound, True)
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
        _refuse_useless(step, t0, t1)
        choice = f"default step, h omega_max <= {fraction:.3g}"
    else:
        _refuse_unstable(lattice, state, t0, t1, step, solver, limit)
        if isinstance(step, jax.core.Tracer):
            step = jnp.where(step > 0, step, jnp.nan)  # what the outcome then says
    refuse_unresolved(t0, t1, step, facts(lattice).dtype)
    if "softens" not in known:
        known["softens"] = softens(lattice)
    if known["softens"]:
        remark = "An exponent below 1: a contact that re-opens is infinitely stiff, and no step bound exists there."
    span = chosen((t1 - t0) / frames)
    count = _ceil(span / step)
    steps = None if isinstance(count, jax.core.Tracer) else int(count) * frames
    if "breaks" not in known:
        known["breaks"] = bool(lattice.breaks)
    if steps is not None and known["breaks"]:
        more = count_breaks(lattice.breaks, t0, t1)
        steps = None if isinstance(more, jax.core.Tracer) else steps + int(more)
    return (t1 - t0) / (count * frames), steps, choice, remark, beyond


def refuse_far(lattice: Lattice, state: StateLike, t0: Scalar, t1: Scalar) -> None:
    """The same refusal for adaptive steps, which are about as long as the default one."""
    eps = float(jnp.finfo(facts(lattice).dtype).eps)
    # as a rule; the rest takes longer
    if (
        traced((t0, t1))
        or eps * abs(t0) < NEAR * (t1 - t0)
        or facts(lattice).traced
        or traced(state)
    ):
        return
    omega = linear_bound(lattice) or _bound(lattice, state, t0, t1)[0]
    if omega > 0:
        refuse_unresolved(t0, t1, STEP_FRACTION / omega, facts(lattice).dtype)


def passed(solver: diffrax.AbstractSolver | type, run: Found, step: Number) -> Any:
    """The highest frequency that a run at the default step has reached, where it passed the bound; else `None`."""
    omega = run.stats["omega"]
    if isinstance(omega, jax.core.Tracer):
        return None
    omega = np.asarray(omega).item()
    return (
        omega
        if step * omega > PASSED * min(STEP_FRACTION, refused_from(solver) or STEP_FRACTION)
        else None
    )


def useless(step: Any, t0: Any, t1: Any) -> bool:
    """Whether a step is none, or one of which a run has more than anybody waits for; not where that is traced."""
    if traced((step, t0, t1)):
        return False
    return bool(not np.isfinite(step) or (t1 - t0) / step > MOST_STEPS)


def _refuse_useless(step, t0, t1):
    if useless(step, t0, t1):
        refuse(
            "step",
            "a time step",
            "None",
            f"The bound on the stiffness at this energy asks for steps of {step:.1e}: no useful one (a law without a "
            "floor, or far more energy than moves). Give step= or tolerance=.",
        )


def _bound(lattice, state, t0, t1):
    """(The bound, a Python number where it is known, and whether a run may pass it, which is then looked at)."""
    span = number(t0, np.dtype(float)), number(t1, np.dtype(float))
    if facts(lattice).traced or traced((state, t0, t1)):
        return frequency_bound(*jax.tree.map(chosen, (lattice, state, *span))), False
    for neighbourhood in GATHERED:
        found = gathered_frequency(lattice, state, *span, neighbourhood)
        if isinstance(
            found, jax.core.Tracer
        ):  # plain numbers inside a transformation of something else
            return frequency_bound(lattice, state, *span), False
        bound, beyond = np.asarray(found).tolist()
        if not bound > 0 or not useless(STEP_FRACTION / bound, t0, t1):
            break
    return bound, bool(beyond)


def doubts(
    lattice: Lattice,
    state: StateLike,
    t0: Scalar,
    t1: Scalar,
    step: Scalar | None,
    tolerance: Any,
    solver: diffrax.AbstractSolver,
    run: Found,
) -> str:
    """Remarks on a run that has ended: a loose tolerance, much energy lost, an energy that is none; empty without."""
    said = []
    if tolerance is not None and tolerance > LOOSE:
        said.append(
            f"A tolerance of {show(tolerance)} is loose: a step may err by that part of the motion."
        )
    lost, known = np.asarray(run.energy_error), facts(lattice).known
    if lost.max() <= SUSPICIOUS:  # as a rule; the rest takes longer
        return " ".join(said)
    if "conserves" not in known:
        known["conserves"] = lattice.conserves
    if not known["conserves"]:
        return " ".join(said)
    if np.isnan(lost).any() and np.all(run.completed):
        ends = [lattice.energy(t, *y) for t, y in ((t0, state), (t1, run.final))]
        gaps = {
            type(term).__name__: np.max(term.energy_gap(lattice, t1, run.final.u))
            for term in lattice.terms
        }
        if not np.isfinite(ends).all() or not np.isfinite(list(gaps.values())).all():
            dtype = facts(lattice).dtype
            said.append(
                f"The energy is larger than any number of {dtype}, or no number at all, so what is lost of it "
                "is not known. Count lengths and times in larger units."
            )
        else:
            said.append(
                f"The force of {max(gaps, key=gaps.get)} is not the slope of its `energy`, so none is kept."
            )
    if not np.isnan(lost).all() and np.nanmax(lost) > SUSPICIOUS:
        if _resolved(lattice, state, t0, t1, run):
            said.append(
                _lost(lattice, state, t0, t1, step, tolerance, solver, float(np.nanmax(lost)))
            )
        else:
            said.append(
                "The energy error is the rounding of `energy`, which does not resolve so small a motion."
            )
    return " ".join(said)


def missed(lattice: Lattice, t0: Scalar, t1: Scalar, step: Any, tolerance: Any) -> str:
    """A remark where a function of time, of which no breaks are told, has a pulse that steps of a run may pass over.

    Between the ends of a step it goes beyond what it is at four ends around by a quarter of its range, or more. An
    adaptive step is tried at many places, so that a quarter of its mean length counts. Pulses are looked for at 8 to
    2048 places in each step: shorter ones nobody sees.
    """
    known = facts(lattice).known
    if "signals" not in known:
        known["signals"] = [
            (i, f) for i, term in enumerate(lattice.terms) for f in functions_of_time(term)
        ]
    if not known["signals"]:
        return ""
    step = np.max(step) / (1 if tolerance is None else 4)
    count = max(int(np.ceil((t1 - t0) / step * (1 - 1e-9))), 1)
    places = int(np.clip(4 ** int(np.log2(MOST_PLACES / count) / 2), *PLACES))
    t0, t1 = (jnp.asarray(t, facts(lattice).dtype) for t in (t0, t1))
    for i, function in known["signals"]:
        if _leap(function, t0, t1, jnp.asarray(count), places) > LEAP:
            name = type(lattice.terms[i]).__name__
            return (
                f"terms[{i}] ({name}) has a pulse that is shorter than the steps, or swings within one: the run "
                f"may have missed it. Give {name} breaks= where the pulse begins and ends, or simulate a shorter "
                "step=."
            )
    return ""


@compiled
def _leap(function, t0, t1, count, places):
    """How far a function of time leaves, within one of equal steps, what it is at their ends; over its range."""
    at, h = jax.vmap(function), (t1 - t0) / count
    inner = (np.arange(places) + 0.5) / places

    def one(k):
        ends, inside = (
            at(jnp.clip(t0 + h * (k + np.arange(-1, 3)), t0, t1)),
            at(t0 + h * (k + inner)),
        )
        low, high = jnp.minimum(ends.min(0), inside.min(0)), jnp.maximum(ends.max(0), inside.max(0))
        return jnp.maximum(high - ends.max(0), ends.min(0) - low), low, high

    def block(b, found):
        beyond, low, high = jax.vmap(one)(jnp.minimum(b * BLOCK + np.arange(BLOCK), count - 1))
        own = beyond.max(0), low.min(0), high.max(0)
        return tuple(f(*x) for f, *x in zip((jnp.maximum, jnp.minimum, jnp.maximum), found, own))

    beyond, low, high = jax.lax.fori_loop(0, (count - 1) // BLOCK + 1, block, one(0))
    return jnp.max(beyond / jnp.where(high > low, high - low, 1))


def _resolved(lattice, state, t0, t1, run):
    """Whether some lane lost more energy than what its terms' arithmetic leaves uncertain.

    That shows where the energy is told along a short straight line through the end, on which it hardly bends.
    """
    scale = np.maximum(np.abs(lattice.energy(t0, *state)), lattice.kinetic_energy(state.v))
    parts = 1 + NEARBY * np.linspace(-1, 1, 9)
    line = [
        lattice.potential_energy(t1, jax.tree.map(lambda u: u * part, run.final.u))
        for part in parts
    ]
    rounding = ROUNDED * np.abs(np.diff(np.asarray(line), 2, axis=0)).max(axis=0)
    lost = np.asarray(run.energy_error) * scale
    return bool(np.any((lost > SUSPICIOUS * scale) & ~(lost <= rounding)))


def _lost(lattice, state, t0, t1, step, tolerance, solver, lost):
    limit = None if tolerance is not None else refused_from(solver)
    if limit is not None and step is not None:
        omega, _ = _bound(lattice, state, t0, t1)
        if step * omega > limit:
            return (
                f"Much energy was lost: the step is past stability for frequencies that this energy can reach, "
                f"h omega <= {step * omega:.3g}, where {type(solver).__name__} is stable below {limit:.3g}."
            )
    way = "a shorter step=" if tolerance is None else "a smaller tolerance="
    return f"Much energy was lost or won, {lost:.2g} of it: the run is not accurate; give {way}."


def _ceil(x):
    # a few ulp of slack, so that 120/0.05 is 2400 and not 2401
    if isinstance(x, jax.core.Tracer):
        return jnp.maximum(jnp.ceil(x * (1 - 1e-12)), 1)
    return np.maximum(np.ceil(float(x) * (1 - 1e-12)), 1)


def linear_bound(lattice: Lattice) -> Any:
    """A bound on the linear frequencies, quickly found and kept; `None` where it is traced."""
    known = facts(lattice).known
    if "linear bound" not in known:
        known["linear bound"] = concrete(linear_frequency(lattice, 0))
    return known["linear bound"]


def _refuse_unstable(lattice, state, t0, t1, step, solver, limit):
    if facts(lattice).traced or traced((state, t0, t1, step)):
        return
    if limit is None:
        return
    omega = linear_bound(lattice)
    if omega is None or 0 < step * omega <= limit:
        return
    if omega > 0:
        omega = concrete(linear_frequency(lattice))
    what = "the highest linear frequency"
    if omega == 0:
        omega = concrete(_bound(lattice, state, t0, t1)[0])
        what = "the highest frequency at this energy"
    if step * omega > limit:
        refuse(
            "step",
            f"at most {limit / omega:.4g}, where {type(solver).__name__} is stable",
            f"{step}",
            f"{what[0].upper()}{what[1:]} is {omega:.4g} and the limit h omega < {limit:.4g}.",
        )
