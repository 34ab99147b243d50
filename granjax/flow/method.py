"""What `simulate` is given, checked before tracing, and how it is run: the solver, the step, what is refused."""

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
    """What every call asks of a lattice, and what only its terms and shapes decide.

    `template`: arrays of the shape of its displacements, of type `dtype`; `space`: the axes of its sites and the
    components of a vector; `numbers`: how many displacements there are; `lanes`: of a batch. `traced`: whether a
    parameter is. `reads_velocity`: whether some force does; `splits`: whether none does but linear damping;
    `remembers`: whether some force reads the past; `has_breaks`: whether some force jumps in time. `known`: a dict for
    what others work out when they first ask for it.
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
    """The `Facts` of a lattice, kept while it lives: its parameters never change."""
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


# rounding units of t0 that a step has at least, as what they cost can be avoided
UNITS_AT_START = 256
# and of the later of t0 and t1, as a long run loses much in other ways: steps that change the time at all
UNITS_AT_END = 4
RESERVED = ("time", "ts", "us", "vs", "u", "v", CLOSEST, EXTREMES)


def checked_state(lattice: Lattice, state: StateLike) -> State:
    """The state as arrays of the lattice's structure, shape and floating type."""
    template, dtype = facts(lattice)[:2]
    return State(
        _checked_field("state.u", state[0], template, dtype),
        _checked_field("state.v", state[1], template, dtype),
    )


def _checked_field(name, x, template, dtype):
    """Displacements or velocities: an array, or a dict of one for each field of a cell."""
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
        # counting takes half as long as `all`, of a short chain
        count = value.size - np.count_nonzero(np.isfinite(value))
        if count:
            refuse(name, "finite numbers", f"{count} that are not", "Look for NaN or infinity.")
    return x if isinstance(x, jax.Array) else jax.device_put(np.array(x))


def checked_times(t0: Any, t1: Any) -> tuple:
    """Start and end, in order; known ones as Python numbers, with which tracing does not interfere."""
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
    """A step or a tolerance: one finite number above zero, or `None`."""
    if x is None or isinstance(x, jax.core.Tracer) or type(x) is float and 0 < x < math.inf:
        return x
    value = np.asarray(x)
    if value.ndim or value.dtype.kind not in "fiu" or not np.isfinite(value) or not value > 0:
        refuse(name, "one finite number above zero", repr(x))
    return float(value)


def held_frames(
    argument: str, count: int, state: StateLike, what: str = "frames", each: int = 1
) -> None:
    """Refuse a count of frames of a state, with their times, that memory cannot hold."""
    size = 8 + sum(x.size * x.dtype.itemsize for x in jax.tree.leaves(state))
    held_in_memory(argument, count, each * size, f"{what} of such a state")


def checked_save_at(save_at: Any, t0: Scalar, t1: Scalar, state: StateLike) -> tuple:
    """Times to save at, the number of equal intervals that fixed steps have to fit, and whether to save every step."""
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
    """The number of equal intervals from t0 to t1 of which all times are ends; 1 where there is no such number."""
    gaps = np.diff(ts)
    spacing = gaps.min(initial=t1 - t0)
    places = (np.append(ts, t1) - t0) / spacing
    fits = np.ptp(gaps) < 1e-6 * spacing if gaps.size else True
    fits = fits and np.abs(places - np.round(places)).max() < 1e-6
    return int(round((t1 - t0) / spacing)) if fits else 1


def checked_records(record: Any) -> dict:
    """The records as a dict, empty where there are none."""
    if record is None:
        return {}
    for name in record:
        if name in RESERVED or name.startswith(("u_", "v_", "error_")):
            taken = f"Taken: {', '.join(RESERVED)}, and error_NAME."
            refuse("record", "names other than those of a run's own results", repr(name), taken)
    return dict(record)


@cache
def rounding_unit(dtype: Any) -> float:
    """The spacing of the numbers of a floating type at 1, kept, as JAX takes long to say it."""
    return float(jnp.finfo(dtype).eps)


def least_tolerance(dtype: Any) -> float:
    """The smallest tolerance that a floating type can hold."""
    return 16 * rounding_unit(dtype)


def least_step(t0: Scalar, t1: Scalar, dtype: Any, larger: Callable = max) -> Scalar:
    """The shortest step whose ends the floating type tells apart well enough; `larger` takes two numbers."""
    start = UNITS_AT_START * abs(t0)
    return rounding_unit(dtype) * larger(start, UNITS_AT_END * larger(abs(t0), abs(t1)))


def refuse_unresolved(t0: Scalar, t1: Scalar, step: Scalar, dtype: Any) -> None:
    """Refuse times, known ones, that the floating type does not tell apart as well as steps need it."""
    if step < least_step(t0, t1, dtype):
        gap = rounding_unit(dtype) * max(abs(t0), abs(t1))
        finer = "" if dtype == np.dtype(float) else " Or compute in float64."
        refuse(
            "t0, t1, step",
            f"a step that is long against the gaps between numbers of {dtype} at these times",
            f"a step of {step:.3g} from t0 = {t0:g} to t1 = {t1:g}, where numbers lie {gap:.2g} apart",
            f"Count time from t0=0 (of what drives the lattice too), or take a longer step.{finer}",
        )


# where it is looked for the smallest overlap of a contact: at the ends of steps, also on the cubic through both ends of
# each step, or on the dense output
ENDS, CUBICS, DENSE = "ends", "cubics", "dense output"


class Plan(NamedTuple):
    """How a run is integrated. As a pytree its arrays are those of `step`, `tolerance`, `save_ts` and `records`.

    `step` [s]: the fixed step; with a `tolerance` the longest, or `None`. `save_ts`: times to save at, `None` for the
    end alone; `every`: save the end of each step. `max_steps`: `None` for a loop that may go on, which has no reverse
    mode. `watch`: follow every compression, for the highest frequency that the run reaches. `openings`: where it is
    looked for contacts that open.
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
        """Whether a run may have pieces: it is not saved at each step, and its adjoint keeps nothing of it."""
        return isinstance(self.adjoint, diffrax.ForwardMode) and not self.every


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

    `allowed`: h omega that the run may reach, where it may pass the bound that set the step, and so is to be looked at
    when it has ended; else `None`.
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
    """The steps of a run, a whole number of them in each of the equal frames.

    `bound`: the highest frequency, where a run has shown it; by default that of the scene's energy.
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
        return Steps((t1 - t0) / (count * frames), None, choice, remark, allowed)
    refuse_unresolved(t0, t1, step, about.dtype)
    count = max(math.ceil(count), 1) * frames
    more = count_breaks(lattice.breaks, t0, t1) if about.has_breaks else 0
    steps = None if isinstance(more, jax.core.Tracer) else count + int(more)
    return Steps((t1 - t0) / count, steps, choice, remark, allowed)


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


def frequency_bound(
    lattice: Lattice,
    state: StateLike,
    t0: Scalar,
    t1: Scalar,
    neighbourhood: Count = NEIGHBOURHOOD,
) -> Number:
    """Bound on the angular frequencies that linearisation finds at what the scene's energy can reach.

    The energy that may gather in a bond is the largest that a neighbourhood, some bonds' lengths wide, holds at the
    start (the whole lattice's, where a term says nothing of how far it couples). A drive adds what a quasi-static push
    to twice its largest value would store; a moving wall the energy of the heaviest site at twice its largest speed, or
    its displacement shared by all sites, whichever is more. A modulation counts with its largest value and with the
    energy that it gives the initial state. Where contacts may open all over the lattice it is doubled.

    **Returns:** omega_max, one number for all lanes; zero for a lattice without any stiffness at its energy.
    **Raises** ValueError for a state of another shape, and times that are not in order.
    """
    state, neighbourhood = checked_state(lattice, state), whole("neighbourhood", neighbourhood, 1)
    # arrays, whose values compile nothing anew
    t0, t1 = (jnp.asarray(t, lattice.dtype) for t in checked_times(t0, t1))
    return _bound_at(lattice, state, t0, t1, neighbourhood)


@compiled
def _bound_at(lattice, state, t0, t1, neighbourhood):
    return gathered_frequency(lattice, state, t0, t1, neighbourhood)[0]


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
