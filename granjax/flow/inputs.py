"""What `simulate` is given, checked before tracing; and what every call asks of a lattice."""

import math
from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..checks import concrete, held_in_memory, one_of, real, refuse, show, traced, whole
from ..lattice import Lattice, State
from ..programs import library, once
from ..terms.base import memory_of
from ..terms.tracing import reads
from ..types import Scalar, StateLike
from .record import CLOSEST, EXTREMES


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
    """Refuse a count of which each keeps so many frames of a state, with their times, that memory holds them not."""
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
