"""The checks of the arguments of `simulate`, and what it asks of a lattice at every call."""

import math
from functools import cache
from typing import Any, NamedTuple

import diffrax
import jax
import jax.numpy as jnp
import numpy as np

from ..base.checks import concrete, held_in_memory, one_of, real, refuse, show, traced, whole
from ..base.programs import library, once
from ..base.types import Scalar, StateLike
from ..lattice import Lattice, State, split_system
from ..lattice.split import refuse_velocity
from ..solvers import RKN86, AbstractNystrom, AbstractSplitting, SRKN11b
from ..terms.base import memory_of
from ..terms.reach import reads
from .record import CLOSEST, EXTREMES, Record

RESERVED = ("time", "ts", "us", "vs", "u", "v", CLOSEST, EXTREMES)
# The default tolerance of adaptive steps, unless the floating type needs a larger one.
DEFAULT_TOLERANCE = 1e-8
# Built once, because making a module takes longer than a short run.
_FIXED = SRKN11b()
_ADAPTIVE = RKN86()
_GENERAL = diffrax.Dopri8()


class Facts(NamedTuple):
    """Properties of a lattice that every call needs, and that its terms and shapes determine.

    - `template`: arrays of the shape and `dtype` of its displacements
    - `numbers`: the number of displacements; `lanes`: of a batch
    - `traced`: whether a parameter is traced
    - `reads_velocity`: whether some force does; `splits`: whether only linear damping does
    - `remembers`: whether some force reads the past; `has_breaks`: whether some jumps in time
    """

    template: object
    dtype: object
    numbers: int
    lanes: tuple[int, ...]
    traced: bool
    reads_velocity: bool
    splits: bool
    remembers: bool
    has_breaks: bool


@once
def facts(lattice: Lattice) -> Facts:
    """Return the `Facts` of a lattice, which are kept while it lives, as it never changes."""
    velocity = [term for term in lattice.terms if reads(term, lattice).velocity]
    template = lattice.template()
    if 0 in lattice.lanes:
        refuse("lattice", "one lane or more", f"lanes of shape {lattice.lanes}")
    return Facts(
        template=template,
        dtype=lattice.dtype,
        numbers=sum(math.prod(x.shape) for x in jax.tree.leaves(template)),
        lanes=lattice.lanes,
        traced=traced(lattice),
        reads_velocity=bool(velocity),
        splits=all(term.exact_damping() is not None for term in velocity),
        remembers=any(memory_of(term) for term in lattice.terms),
        has_breaks=bool(lattice.breaks),
    )


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
    t0, t1 = (
        _one_number(name, t, -math.inf, "one finite number") for name, t in (("t0", t0), ("t1", t1))
    )
    if not traced((t0, t1)) and not t1 > t0:
        refuse(
            "t1", f"a time after t0 = {t0}", f"{t1}", "To go back in time, reverse the velocities."
        )
    return t0, t1


def _one_number(name, x, above, expected):
    if isinstance(x, jax.core.Tracer) or type(x) is float and above < x < math.inf:
        return x
    value = np.asarray(x)
    if value.ndim or value.dtype.kind not in "fiu" or not above < value < math.inf:
        refuse(name, expected, repr(x))
    return value.item()


def checked_size(name: str, x: Any) -> Scalar | None:
    """Return a step or a tolerance: one finite number above zero, or `None`."""
    if x is None or isinstance(x, jax.core.Tracer):
        return x
    return float(_one_number(name, x, 0, "one finite number above zero"))


def held_frames(argument: str, count: int, state: StateLike, what: str = "frames") -> None:
    """Refuse a number of frames of a state that memory cannot hold."""
    size = 8 + sum(x.size * x.dtype.itemsize for x in jax.tree.leaves(state))
    held_in_memory(argument, count, size, f"{what} of such a state")


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
        xp = library(t0, t1)
        ts = t0 + (t1 - t0) * xp.linspace(0.0, 1.0, frames)
        # The last one may be rounded up beyond t1.
        return xp.minimum(ts, t1), frames - 1, False
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
        if not traced((t0, t1)):
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
    expected = "a dict of records, such as {'peak': gx.Peak(gx.measures.contact_force)}"
    if not isinstance(record, dict):
        refuse("record", expected, repr(record))
    for name, x in record.items():
        if name in RESERVED or name.startswith(("u_", "v_", "error_")):
            taken = f"Taken: {', '.join(RESERVED)}, and error_NAME."
            refuse("record", "names other than those of a run's own results", repr(name), taken)
        if not (isinstance(x, Record) and callable(x.quantity)):
            refuse("record", expected, repr(record))
    return dict(record)


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
    step = checked_size("step", step)
    about = facts(lattice)
    if solver is None:
        plain = about.splits if tolerance is None else not about.reads_velocity
        solver = (_FIXED if tolerance is None else _ADAPTIVE) if plain else _GENERAL
    if isinstance(solver, AbstractSplitting):
        if not about.splits:
            split_system(lattice)  # Refuses, and names the term.
        if tolerance is not None:
            refuse(
                "tolerance",
                f"a fixed step with {type(solver).__name__}",
                f"tolerance={show(tolerance)}",
                "A symplectic method loses its virtue under adaptive steps; use step=, or solver=gx.RKN86().",
            )
    if about.reads_velocity and isinstance(solver, AbstractNystrom):
        refuse_velocity(lattice)
    adapts = isinstance(solver, diffrax.AbstractAdaptiveSolver)
    if tolerance is not None and not adapts:
        wanted = "one with an error estimate for a tolerance"
        refuse("solver", wanted, type(solver).__name__, "Use gx.RKN86(), or step=.")
    if tolerance is None and step is None and adapts:
        tolerance = max(DEFAULT_TOLERANCE, least_tolerance(about.dtype))
    if tolerance is not None:
        tolerance = checked_tolerance(tolerance, about.dtype)
    return solver, step, tolerance


def checked_tolerance(tolerance: Any, dtype: Any) -> Any:
    """Return the tolerance as an array, so that another one compiles nothing; check its range."""
    tolerance = checked_size("tolerance", tolerance)
    value = concrete(tolerance)
    least = least_tolerance(dtype)
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


@cache
def rounding_unit(dtype: Any) -> float:
    """Return the spacing of a floating type's numbers at 1, cached, since JAX is slow at it."""
    return float(jnp.finfo(dtype).eps)


def least_tolerance(dtype: Any) -> float:
    """Return the smallest tolerance that a floating type can hold."""
    return 16 * rounding_unit(dtype)


def number(x: Any, dtype: Any) -> Any:
    """Return one number as an array of a type: NumPy's if known, as it is quickly made."""
    return x.astype(dtype) if isinstance(x, jax.Array) else dtype.type(x)
