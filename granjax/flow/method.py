"""The checks of the arguments of `simulate`, and the choice of solver and step."""

import math
from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import diffrax
import jax
import jax.numpy as jnp
import numpy as np

from ..checks import concrete, held_in_memory, one_of, real, refuse, show, traced, whole
from ..lattice import Lattice, State, acceleration_only, split_system
from ..programs import compiled, concretely, library, once
from ..solvers import RKN86, AbstractNystrom, AbstractSplitting, SRKN11b
from ..solvers.stability import refused_from
from ..terms.base import memory_of
from ..terms.reach import reads
from ..terms.waveforms import count_breaks
from ..types import Count, Number, Scalar, StateLike, Times
from .record import CLOSEST, EXTREMES, Record
from .stiffness import NEIGHBOURHOOD, chosen, gathered_frequency, linear_frequency, softens


class Facts(NamedTuple):
    """Properties of a lattice that every call needs, and that its terms and shapes determine.

    - `template`: arrays of the shape and `dtype` of its displacements
    - `space`: the number of axes of its sites, and of components of a vector
    - `numbers`: the number of displacements; `lanes`: of a batch
    - `traced`: whether a parameter is traced
    - `reads_velocity`: whether some force does; `splits`: whether only linear damping does
    - `remembers`: whether some force reads the past; `has_breaks`: whether some jumps in time
    - `known`: a dict for values that others compute on first use
    """

    template: object
    dtype: object
    space: tuple[int, int]
    numbers: int
    lanes: tuple[int, ...]
    traced: bool
    reads_velocity: bool
    splits: bool
    remembers: bool
    has_breaks: bool
    known: dict


@once
def facts(lattice: Lattice) -> Facts:
    """Return the `Facts` of a lattice, which are kept while it lives, as it never changes."""
    velocity = [term for term in lattice.terms if reads(term, lattice).velocity]
    template = lattice.template()
    return Facts(
        template=template,
        dtype=lattice.dtype,
        space=lattice.space,
        numbers=sum(math.prod(x.shape) for x in jax.tree.leaves(template)),
        lanes=lattice.lanes,
        traced=traced(lattice),
        reads_velocity=bool(velocity),
        splits=all(term.exact_damping() is not None for term in velocity),
        remembers=any(memory_of(term) for term in lattice.terms),
        has_breaks=bool(lattice.breaks),
        known={},
    )


# A step spans at least this many rounding units of t0, since the user can avoid that loss of
# accuracy with t0 = 0.
UNITS_AT_START = 256
# It also spans this many rounding units of the later of t0 and t1, so that steps change the time.
# More is not asked, as long runs lose accuracy in other ways.
UNITS_AT_END = 4
RESERVED = ("time", "ts", "us", "vs", "u", "v", CLOSEST, EXTREMES)


def checked_state(lattice: Lattice, state: StateLike) -> State:
    """Return the state as arrays of the lattice's structure, shape and floating type."""
    template, dtype = facts(lattice)[:2]
    return State(
        _checked_field("state.u", state[0], template, dtype),
        _checked_field("state.v", state[1], template, dtype),
    )


def _checked_field(name, x, template, dtype):
    if not isinstance(x, dict) and not isinstance(template, dict):
        return _checked_array(name, x, template.shape, dtype)
    kinds = [
        f"fields {sorted(tree)}" if isinstance(tree, dict) else "an array" for tree in (template, x)
    ]
    if kinds[0] != kinds[1]:
        refuse(name, f"{kinds[0]}, as of the lattice", kinds[1])
    return {k: _checked_array(f"{name}[{k!r}]", x[k], template[k].shape, dtype) for k in template}


def _checked_array(name, x, shape, dtype):
    if not isinstance(x, jax.Array):
        x = np.asarray(x)
    if x.dtype.kind != "f":
        refuse(
            name,
            f"floating numbers ({dtype})",
            f"{x.dtype}",
            "Write 0.0 instead of 0, or .astype(float).",
        )
    if x.shape != shape:
        turned = len(shape) > 1 and sorted(x.shape) == sorted(shape)
        remedy = (
            "Lanes come last: out_axes=-1 in the vmap that made it."
            if turned
            else "Start from lattice.zeros()."
        )
        refuse(name, f"shape {shape}, that of the lattice", f"shape {x.shape}", remedy)
    if x.dtype != dtype:
        refuse(
            name,
            f"{dtype}, the lattice's type",
            f"{x.dtype}",
            f"Use lattice.astype({x.dtype.name!r}) for a run in {x.dtype}, or state.astype.",
        )
    value = concrete(x)
    if value is not None:
        # For a short chain, counting takes half as long as `all`.
        count = value.size - np.count_nonzero(np.isfinite(value))
        if count:
            refuse(name, "finite numbers", f"{count} that are not", "Look for NaN or infinity.")
    return x if isinstance(x, jax.Array) else jax.device_put(np.array(x))


def checked_times(t0: Any, t1: Any) -> tuple:
    """Return start and end, in order; known ones as Python numbers, which tracing leaves alone."""
    t0, t1 = _checked_time("t0", t0), _checked_time("t1", t1)
    if not isinstance(t0, jax.core.Tracer) and not isinstance(t1, jax.core.Tracer) and not t1 > t0:
        refuse(
            "t1", f"a time after t0 = {t0}", f"{t1}", "To go back in time, reverse the velocities."
        )
    return t0, t1


def _checked_time(name, t):
    if isinstance(t, jax.core.Tracer) or type(t) is float and math.isfinite(t):
        return t
    value = np.asarray(t)
    if value.ndim or value.dtype.kind not in "fiu" or not np.isfinite(value):
        refuse(name, "one finite number", repr(t))
    return value.item()


def checked_size(name: str, x: Any) -> Scalar | None:
    """Return a step or a tolerance: one finite number above zero, or `None`."""
    if x is None or isinstance(x, jax.core.Tracer) or type(x) is float and 0 < x < math.inf:
        return x
    value = np.asarray(x)
    if value.ndim or value.dtype.kind not in "fiu" or not np.isfinite(value) or not value > 0:
        refuse(name, "one finite number above zero", repr(x))
    return float(value)


def held_frames(
    argument: str, count: int, state: StateLike, what: str = "frames", each: int = 1
) -> None:
    """Refuse a number of frames of a state that memory cannot hold."""
    size = 8 + sum(x.size * x.dtype.itemsize for x in jax.tree.leaves(state))
    held_in_memory(argument, count, each * size, f"{what} of such a state")


def checked_save_at(save_at: Any, t0: Scalar, t1: Scalar, state: StateLike) -> tuple:
    """Return the times to save, the number of equal intervals for fixed steps, and `every`.

    `every`: whether to save every step.
    """
    if save_at is None:
        return None, 1, False
    if isinstance(save_at, str):
        one_of("save_at", save_at, ("steps",))
        return None, 1, True
    if np.ndim(save_at) == 0:
        frames = whole("save_at", save_at, 1, "A number of frames, an array of times, or 'steps'.")
        held_frames("save_at", frames, state)
        if frames == 1:
            return None, 1, False
        return t0 + (t1 - t0) * library(t0, t1).linspace(0.0, 1.0, frames), frames - 1, False
    ts = (
        save_at
        if isinstance(save_at, jax.core.Tracer)
        else real("save_at", save_at, "a number of frames, a list of times, or 'steps'")
    )
    if ts.ndim != 1 or ts.size == 0:
        refuse("save_at", "a list of times", f"shape {ts.shape}")
    held_frames("save_at", ts.size, state, "times")
    value = concrete(ts)
    if value is not None:
        if not np.isfinite(value).all() or not (np.diff(value) > 0).all():
            refuse(
                "save_at",
                "finite times, each after the one before",
                show(value),
                "Sort them, without repeats.",
            )
        if not isinstance(t0, jax.core.Tracer) and not isinstance(t1, jax.core.Tracer):
            slack = 4 * np.finfo(float).eps * max(abs(t0), abs(t1))
            if value[0] < t0 - slack or value[-1] > t1 + slack:
                refuse("save_at", f"times within [{t0}, {t1}]", f"{value[0]} ... {value[-1]}")
            value = np.clip(value, t0, t1)
            return value, _intervals(value, t0, t1), False
    return jnp.asarray(ts), 1, False


def _intervals(ts, t0, t1):
    # The number of equal intervals from t0 to t1 whose ends include all times; 1 if there is none.
    gaps = np.diff(ts)
    spacing = gaps.min(initial=t1 - t0)
    places = (np.append(ts, t1) - t0) / spacing
    fits = np.ptp(gaps) < 1e-6 * spacing if gaps.size else True
    fits = fits and np.abs(places - np.round(places)).max() < 1e-6
    return int(round((t1 - t0) / spacing)) if fits else 1


def checked_records(record: Any) -> dict:
    """Return the records as a dict, empty if there are none."""
    if record is None:
        return {}
    for name in record:
        if name in RESERVED or name.startswith(("u_", "v_", "error_")):
            taken = f"Taken: {', '.join(RESERVED)}, and error_NAME."
            refuse("record", "names other than those of a run's own results", repr(name), taken)
    return dict(record)


@cache
def rounding_unit(dtype: Any) -> float:
    """Return the spacing of a floating type's numbers at 1, cached, since JAX is slow at it."""
    return float(jnp.finfo(dtype).eps)


def least_tolerance(dtype: Any) -> float:
    """Return the smallest tolerance that a floating type can hold."""
    return 16 * rounding_unit(dtype)


def least_step(t0: Scalar, t1: Scalar, dtype: Any, larger: Callable = max) -> Scalar:
    """Return the shortest step that the floating type resolves at these times.

    `larger`: a function of two numbers.
    """
    start = UNITS_AT_START * abs(t0)
    return rounding_unit(dtype) * larger(start, UNITS_AT_END * larger(abs(t0), abs(t1)))


def refuse_unresolved(t0: Scalar, t1: Scalar, step: Scalar, dtype: Any) -> None:
    """Refuse known times at which the floating type does not resolve the steps."""
    if step < least_step(t0, t1, dtype):
        gap = rounding_unit(dtype) * max(abs(t0), abs(t1))
        finer = "" if dtype == np.dtype(float) else " Or compute in float64."
        refuse(
            "t0, t1, step",
            f"a step that is long against the gaps between numbers of {dtype} at these times",
            f"a step of {step:.3g} from t0 = {t0:g} to t1 = {t1:g}, where numbers lie {gap:.2g} apart",
            f"Count time from t0=0 (of what drives the lattice too), or take a longer step.{finer}",
        )


# Where the smallest overlap of a contact is sought: at the ends of steps, also on the cubic through
# both ends of each step, or on the dense output.
ENDS, CUBICS, DENSE = "ends", "cubics", "dense output"


class Plan(NamedTuple):
    """How a run is integrated; its arrays are `step`, `tolerance`, `save_ts` and `records`.

    - `step` [s]: the fixed step; with a `tolerance` the longest step, or `None`
    - `save_ts`: times to save, `None` for the end only; `every`: save the end of each step
    - `max_steps`: `None` for a loop without a bound, which has no reverse mode
    - `watch`: follow all compressions, for the highest frequency that the run reaches
    - `openings`: where contacts that open are sought
    """

    solver: diffrax.AbstractSolver
    step: Number | None
    tolerance: Number | None
    save_ts: Times | None
    records: dict[str, Record]
    adjoint: diffrax.AbstractAdjoint
    max_steps: int | None = None
    every: bool = False
    progress: bool = False
    watch: bool = False
    openings: str = ENDS

    @property
    def has_pieces(self) -> bool:
        """Whether a run may be split: not every step is saved, and the adjoint stores nothing."""
        return isinstance(self.adjoint, diffrax.ForwardMode) and not self.every


# h omega of the default step.
STEP_FRACTION = 0.5
# The neighbourhoods, in lengths of a bond, from which energy may gather in a bond, where the run is
# checked at its end. The second one is for a law without a floor.
GATHERED = (4, 1)
# A run at the default step is repeated if it passed its bound by more than this factor.
PASSED = 1.1
DEFAULT_TOLERANCE = 1e-8
MOST_STEPS = 1e8
# Below this part of a run's length, the rounding of t0 does not matter.
NEAR = 1e-9
# Built once, because making a module takes longer than a short run.
_FIXED, _ADAPTIVE, _GENERAL = SRKN11b(), RKN86(), diffrax.Dopri8()


def checked_method(lattice: Lattice, solver: Any, step: Any, tolerance: Any) -> tuple:
    """Return solver, step and tolerance that fit together, with defaults filled in."""
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
    """Return the tolerance as an array, so that another one compiles nothing; check its range."""
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
    # For a solver that the user chose: refuses a lattice or sizes that it cannot serve, and returns
    # the tolerance.
    dtype, velocity, splits = found.dtype, found.reads_velocity, found.splits
    if isinstance(solver, AbstractSplitting):
        if not splits:
            split_system(lattice)  # Refuses, and names the term.
        if tolerance is not None:
            refuse(
                "tolerance",
                f"a fixed step with {type(solver).__name__}",
                f"tolerance={show(tolerance)}",
                "A symplectic method loses its virtue under adaptive steps; use step=, or solver=gx.RKN86().",
            )
    if velocity and isinstance(solver, AbstractNystrom):
        acceleration_only(lattice)  # Refuses, and names the term.
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
    """Return one number as an array of a type: NumPy's if known, as it is quickly made."""
    return x.astype(dtype) if isinstance(x, jax.Array) else dtype.type(x)


def _default_tolerance(dtype):
    return max(DEFAULT_TOLERANCE, least_tolerance(dtype))


class Steps(NamedTuple):
    """Equal steps: their size, number (`None` while traced), how they were chosen, and a remark.

    `allowed`: the h omega that the run may reach, if it may pass the bound that set the step, so
    that it must be checked at the end; else `None`.
    """

    size: Number
    count: int | None
    choice: str
    remark: str
    allowed: float | None


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
    """Return the steps of a run, a whole number of them in each of the equal frames.

    `bound`: the highest frequency that a run has shown; by default that of the lattice's energy.
    """
    about, limit, allowed, given = facts(lattice), refused_from(solver), None, step is not None
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
        step, allowed = fraction / bound, PASSED * fraction if watch else None
    known = not traced((step, t0, t1))
    if given:
        choice = "given step"
        if known and limit is not None and not (about.traced or traced(state)):
            _refuse_unstable(lattice, state, t0, t1, step, solver, limit)
        if isinstance(step, jax.core.Tracer):
            step = jnp.where(step > 0, step, jnp.nan)  # The outcome then reports it.
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
    # A few ulp of slack, so that 120/0.05 is 2400 and not 2401.
    count = span / step * (1 - 1e-12)
    if not known:
        count = jnp.maximum(jnp.ceil(count), 1)
        return Steps((t1 - t0) / (count * frames), None, choice, remark, allowed)
    refuse_unresolved(t0, t1, step, about.dtype)
    count = max(math.ceil(count), 1) * frames
    more = count_breaks(lattice.breaks, t0, t1) if about.has_breaks else 0
    steps = None if isinstance(more, jax.core.Tracer) else count + int(more)
    return Steps((t1 - t0) / count, steps, choice, remark, allowed)


def refuse_far(lattice: Lattice, state: StateLike, t0: Scalar, t1: Scalar) -> None:
    """Refuse times as `refuse_unresolved` does, for adaptive steps.

    Those are about as long as the default step.
    """
    about = facts(lattice)
    eps = rounding_unit(about.dtype)
    # Most calls end here; the rest takes longer.
    if traced((t0, t1)) or eps * abs(t0) < NEAR * (t1 - t0) or about.traced or traced(state):
        return
    omega = linear_bound(lattice) or reachable(lattice, state, t0, t1)[0]
    if omega > 0:
        refuse_unresolved(t0, t1, STEP_FRACTION / omega, about.dtype)


def frequency_bound(
    lattice: Lattice,
    state: StateLike,
    t0: Scalar,
    t1: Scalar,
    neighbourhood: Count = NEIGHBOURHOOD,
) -> Number:
    """Return a bound on the frequencies of linearisation about all states that the energy allows.

    A bond may gather the largest energy that a neighbourhood, some bond lengths wide, holds at the
    start (that of the whole lattice if a term does not say how far it couples). Driving adds
    energy:

    - a drive adds that stored by a quasi-static push to twice its largest value;
    - a moving wall adds that of the heaviest site at twice the wall's largest speed, or its
      displacement shared by all sites, whichever is more;
    - a modulation counts with its largest value and the energy that it gives the initial state.

    The bound is doubled where contacts may open all over the lattice.

    **Returns:** omega_max [rad/s], one number for all lanes; zero for a lattice without stiffness
    at its energy. **Raises** ValueError for a state of another shape, and times that are not in
    order.
    """
    state, neighbourhood = checked_state(lattice, state), whole("neighbourhood", neighbourhood, 1)
    # As arrays, so that other values compile nothing.
    t0, t1 = (jnp.asarray(t, lattice.dtype) for t in checked_times(t0, t1))
    return _bound_at(lattice, state, t0, t1, neighbourhood)


@compiled
def _bound_at(lattice, state, t0, t1, neighbourhood):
    return gathered_frequency(lattice, state, t0, t1, neighbourhood)[0]


def useless(step: Any, t0: Any, t1: Any) -> bool:
    """Return whether a step is not finite, or a run would take too many of them."""
    return bool(not math.isfinite(step) or (t1 - t0) / step > MOST_STEPS)


def reachable(lattice: Lattice, state: StateLike, t0: Scalar, t1: Scalar) -> tuple:
    """Return a bound on the frequencies at this energy, and whether a run may pass it.

    The bound is a Python number where it is known.
    """
    span = number(t0, np.dtype(float)), number(t1, np.dtype(float))
    if facts(lattice).traced or traced((state, t0, t1)):
        return frequency_bound(*jax.tree.map(chosen, (lattice, state, *span))), False
    for neighbourhood in GATHERED:
        found = gathered_frequency(lattice, state, *span, neighbourhood)
        # Plain numbers within a transformation of something else.
        if isinstance(found, jax.core.Tracer):
            return frequency_bound(lattice, state, *span), False
        bound, beyond = np.asarray(found).tolist()
        if not bound > 0 or not useless(STEP_FRACTION / bound, t0, t1):
            break
    return bound, bool(beyond)


@once
def linear_bound(lattice: Lattice) -> float:
    """Return a bound on the linear frequencies of a known lattice; it is quick and cached."""
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
