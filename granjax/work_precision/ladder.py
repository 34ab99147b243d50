"""One method at many steps or tolerances: its ladder, calls with a clock, errors, observed orders."""

import math
import time
from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from ..checks import one_of, real, refuse, show
from ..printing import told
from ..types import Count, Parameter, Pytree, Scalar

PARAMETERS = ("step", "tolerance")
DEFAULT = "default"
# what a point may take altogether [s], before it is called less often
ENOUGH = 3.0
# where the error is small enough to fall as a power of the step, and far enough above the reference's own
ASYMPTOTIC, CLEAR = 1e-2, 10.0
LEAST_POINTS = 3


class Ladder(NamedTuple):
    """One method and the values of its step or tolerance, for `measure`.

    - `name`: of the method; `parameter`: `"step"` or `"tolerance"`; `values`: of that, the coarsest first.
    - `call(value)`: computes the final state, and returns `(state, evaluations)` or `(state, evaluations, steps)`:
      the state a pair (u, v) or any tree of arrays like the reference, force evaluations and steps numbers, or `None`
      where they are not known. It may compile on its first call. A ValueError or RuntimeError marks the point alone.
    - `stops`: whether the ladder ends where its error reaches the floor or has not fallen for four values, or where one
      call takes longer than `measure` is told; otherwise every value is tried.
    - `limit`: the longest stable step; orders are read off below half of it.
    - `solver`: the solver that `gx.simulate` takes, where there is one, for the advice.
    - `compile_seconds`: of the first call, where it was measured before.

    A ladder called `"default"` is what happens without any choice, which the advice compares with.
    """

    name: str
    parameter: str
    values: Parameter
    call: Callable[[float], tuple]
    stops: bool = False
    limit: float = np.inf
    solver: object = None
    compile_seconds: float | None = None
    __repr__ = told


def checked_ladders(ladders: Sequence[Ladder]) -> tuple[Ladder, ...]:
    """The ladders as a tuple. **Raises** ValueError for none, two of one name, values that cannot be meant."""
    for i, ladder in enumerate(ladders):
        one_of(f"ladders[{i}].parameter", ladder.parameter, PARAMETERS)
    names = [ladder.name for ladder in ladders]
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        refuse("ladders", "a name of its own for each", f"{twice!r} twice")
    return tuple(
        ladder._replace(
            values=ladder.values
            if ladder.name == DEFAULT
            else checked_values(ladder.name, ladder.values)
        )
        for ladder in ladders
    )


def checked_values(name: str, values: Parameter) -> tuple[float, ...]:
    """Steps or tolerances as a tuple of floats, the coarsest first."""
    array = np.atleast_1d(
        real(f"steps of {name}", values, "finite numbers above zero, such as [0.1, 0.05]")
    )
    if array.ndim != 1 or not array.size or not np.all(np.isfinite(array) & (array > 0)):
        got = show(array) if array.ndim == 1 and not np.isnan(array).all() else repr(values)[:60]
        refuse(f"steps of {name}", "finite numbers above zero, such as [0.1, 0.05]", got)
    return tuple(float(x) for x in np.unique(array)[::-1])


class Called(NamedTuple):
    """What one call gave: its state, its counts, its wall time [s], and a sentence where it failed."""

    state: object
    evaluations: float
    steps: float
    seconds: float
    note: str
    __repr__ = told


def once(call: Callable, value: float) -> Called:
    """Call and wait for the result; a ValueError or RuntimeError becomes a note."""
    start = time.perf_counter()
    try:
        result = jax.block_until_ready(call(value))
    except (ValueError, RuntimeError) as error:
        return Called(None, np.nan, np.nan, time.perf_counter() - start, str(error))
    seconds = time.perf_counter() - start
    state, *counts = result
    evaluations, steps = (*counts, None, None)[:2]
    return Called(state, _count(evaluations), _count(steps), seconds, "")


def _count(x):
    return np.nan if x is None else float(np.max(x))


def warmed(ladder: Ladder) -> tuple[Ladder, float]:
    """The ladder with its `compile_seconds`, and the time of a warm call of the coarsest value that works.

    Compile time is that of the first call less that of the second.
    """
    compiling, seconds = 0.0, np.nan
    for value in ladder.values:
        first, second = once(ladder.call, value), once(ladder.call, value)
        compiling = max(compiling, first.seconds - second.seconds)
        if not second.note:
            seconds = second.seconds
            break
    return ladder._replace(compile_seconds=compiling), seconds


def in_turns(
    calls: Sequence[tuple[Callable, float]], repeats: Count, known: Sequence[float] | None = None
) -> Float[np.ndarray, "2 calls"]:
    """Median and shortest wall time of calls [s] that take turns, A B C A B C, so that a drift of the machine hits all.

    `calls`: pairs (call, value). Each is called `repeats` times, or until its times add up to `ENOUGH`; `known`: the
    time that each took before, which is enough where it is more than that.
    """
    spent = [[x] if x > ENOUGH else [] for x in (np.zeros(len(calls)) if known is None else known)]
    for _ in range(repeats):
        waiting = [own for own in zip(calls, spent) if sum(own[1]) < ENOUGH]
        if not waiting:
            break
        for (call, value), times in waiting:
            times.append(once(call, value).seconds)
    return np.array([[np.median(times), np.min(times)] for times in spent]).reshape(-1, 2).T


def distance(state: Pytree, reference: Pytree) -> float:
    r"""Largest error of a state, each of its parts by its own scale.

        error = max over parts x of  max |x - x_ref| / max |x_ref|

    The parts of a `State` or a pair are u and v, so that this is the larger of the relative errors of displacements
    and velocities; both maxima go over all sites, fields, vector components and lanes. A longer tuple has as many
    parts as entries; anything else is one part. A part that is zero throughout the reference counts by itself.

    A part that passes through zero at the final time has a small scale and so a large error: end runs elsewhere.

    **Arguments:** two trees of arrays of equal shapes. **Returns:** a float; NaN where the state is not finite.
    **Raises** ValueError where shapes differ.
    """
    state, reference = _parts("state", state), _parts("reference", reference)
    shapes = (
        [[x.shape for x in part] for part in state],
        [[x.shape for x in part] for part in reference],
    )
    if shapes[0] != shapes[1]:
        refuse("reference", f"arrays of the shapes {shapes[0]}, those of the state", f"{shapes[1]}")
    # NumPy's maximum keeps a NaN, Python's own may lose it
    return float(np.max([_relative(x, y) for x, y in zip(state, reference)]))


def _parts(argument, tree):
    parts = tree if isinstance(tree, (tuple, list)) else (tree,)
    return [[real(argument, x) for x in jax.tree.leaves(part)] for part in parts]


def _relative(part, reference):
    largest = np.max([_largest(x - y) for x, y in zip(part, reference)])
    scale = np.max([_largest(y) for y in reference])
    return largest / scale if scale > 0 else largest


def _largest(x):
    return np.max(np.abs(x), initial=0.0)


def observed_order(steps: Parameter, errors: Parameter, floor: Scalar) -> tuple[float, float]:
    r"""Slope of log(error) over log(step), by least squares, and its standard error.

    Only errors below 1e-2 and above ten floors count; where the error rises again towards the shortest steps, so that
    rounding has taken over, only those before, and above ten times the smallest.

    **Arguments:** `steps`, `errors` (P,); `floor`: uncertainty of the reference, or NaN.
    **Returns:** (order, standard error), NaN where fewer than three points are left.
    """
    along = np.argsort(steps)[::-1]
    steps, errors = np.asarray(steps)[along], np.asarray(errors)[along]
    keep = np.isfinite(errors) & (errors > 0) & (errors < ASYMPTOTIC)
    if np.isfinite(floor):
        keep &= errors > CLEAR * floor
    if keep.any():
        least = int(np.argmin(np.where(keep, errors, np.inf)))
        if keep[least + 1 :].any():
            keep &= (errors > CLEAR * errors[least]) & (np.arange(len(errors)) < least)
    if np.count_nonzero(keep) < LEAST_POINTS:
        return np.nan, np.nan
    x, y = np.log(steps[keep]), np.log(errors[keep])
    x = x - x.mean()
    spread = x @ x
    slope = float(x @ y / spread)
    rest = y - y.mean() - slope * x
    return slope, float(np.sqrt(rest @ rest / (len(x) - 2) / spread))


def number(x: Scalar) -> str:
    """Three digits: 0.0123, 2.3e-09."""
    return f"{x:.3g}"


def seconds_in_words(seconds: Scalar) -> str:
    """A time with its unit: 1.9 ms."""
    if not math.isfinite(seconds):
        return "no time"
    unit, name = next(((u, n) for u, n in ((1.0, "s"), (1e-3, "ms")) if seconds >= u), (1e-6, "us"))
    return f"{seconds / unit:.3g} {name}"
