"""Measuring ladders: errors first, then times in turns; and on which machine."""

import datetime
import math
import os
import platform
import subprocess
from collections.abc import Sequence
from importlib import metadata
from pathlib import Path

import numpy as np

from ..checks import refuse, whole
from ..tuning import cores
from ..types import Count, Pytree, Scalar
from .ladder import ASYMPTOTIC, Ladder, checked_ladders, distance, in_turns, once, warmed
from .table import DRAWN, LARGEST_FLOOR, WorkPrecision

BELOW = f"Below {DRAWN:g} times the reference's uncertainty."
NOT_FINITE = "The state is not finite."
MEANINGLESS = "An error above 1: everything is wrong."
# so many values without a smaller error mean that rounding has taken over; where contacts open, errors scatter
PATIENCE = 4

_PACKAGES = ("granjax", "jax", "jaxlib", "diffrax", "equinox", "numpy")
_ROOT = Path(__file__).parents[2]


def measure(
    ladders: Sequence[Ladder],
    reference: Pytree,
    floor: Scalar = math.nan,
    repeats: Count = 5,
    *,
    longest: Scalar = math.inf,
    note: str = "",
) -> WorkPrecision:
    """Error, time and force evaluations of every value of every ladder, against one reference.

    First every ladder is called, for its compile time, its errors and its counts. Then all points are called
    `repeats` times in turns (A B C A B C), and the median wall time of a call counts.

    **Arguments:**

    - `ladders`: list of `Ladder`. `reference`: what all of them approximate, a tree like their states: a pair (u, v),
      or any tuple of arrays.
    - `floor`: the uncertainty of the reference, in the measure of `distance`; NaN where nobody knows it. No error
      below four times the floor is drawn, fitted or advised.
    - `repeats`: timed calls of each point, fewer where they add up to more than 3 s. `longest` [s]: where the ladders
      that stop do so, after the first value whose call takes longer, twice. `note`: what the reference is, in words.

    **Returns:** `WorkPrecision`. **Raises** ValueError for ladders that are none, a floor above 1e-3 (no reference),
    a state of other shapes than the reference.
    """
    ladders, repeats = checked_ladders(ladders), whole("repeats", repeats, 1)
    if floor < 0 or floor > LARGEST_FLOOR:
        remedy = "A reference of that uncertainty tells nothing; end the run earlier."
        refuse(
            "floor",
            f"a number from 0 to {LARGEST_FLOOR:g}, or NaN where it is not known",
            f"{floor:g}",
            remedy,
        )
    ladders = tuple(x if x.compile_seconds is not None else warmed(x)[0] for x in ladders)
    climbed = [_climb(ladder, reference, floor, longest) for ladder in ladders]
    points = [(ladder, *rung) for ladder, rungs in zip(ladders, climbed) for rung in rungs]
    notes = [_judged(error, floor, called) for _, _, called, error in points]
    seconds, fastest = _seconds(points, notes, repeats)
    return WorkPrecision(
        method=tuple(ladder.name for ladder, *_ in points),
        parameter=tuple(ladder.parameter for ladder, *_ in points),
        value=np.array([value for _, value, *_ in points]),
        error=np.array([error for *_, error in points]),
        seconds=seconds,
        fastest=fastest,
        evaluations=np.array([called.evaluations for _, _, called, _ in points]),
        steps=np.array([called.steps for _, _, called, _ in points]),
        drawn=np.array([not note for note in notes]),
        note=tuple(notes),
        methods=tuple(ladder.name for ladder in ladders),
        compile_seconds=np.array([ladder.compile_seconds for ladder in ladders]),
        limit=np.array([ladder.limit for ladder in ladders]),
        floor=float(floor),
        repeats=repeats,
        reference_note=note,
        machine=machine(),
        ladders=ladders,
        reference=reference,
    )


def _climb(ladder, reference, floor, longest):
    """(value, called, error) of the values, as far as the ladder goes."""
    rungs, smallest, waited = [], math.inf, 0
    for value in ladder.values:
        called = once(ladder.call, value)
        error = math.nan if called.note else distance(called.state, reference)
        rungs.append((value, called._replace(state=None), error))
        waited = 0 if error < smallest else waited + 1
        smallest = error if error < smallest else smallest
        stalled = smallest < ASYMPTOTIC and waited == PATIENCE
        # once may be another process that had the processor
        slow = (
            ladder.stops and called.seconds > longest and once(ladder.call, value).seconds > longest
        )
        if ladder.stops and (error < DRAWN * floor or slow or stalled):
            break
    return rungs


def _judged(error, floor, called):
    """Why a point is not drawn, or nothing."""
    if called.note:
        return called.note
    if not math.isfinite(error):
        return NOT_FINITE
    if error < DRAWN * floor:
        return BELOW
    return MEANINGLESS if error > 1 else ""


def _seconds(points, notes, repeats):
    """Median and shortest wall times (2, points) [s] of those that are drawn, rung by rung across ladders; or NaN."""
    rung = np.zeros(len(points), int)
    for i in range(1, len(points)):
        rung[i] = rung[i - 1] + 1 if points[i][0] is points[i - 1][0] else 0
    order = [int(i) for i in np.argsort(rung, kind="stable") if not notes[i]]
    seconds = np.full((2, len(points)), np.nan)
    if order:
        calls = [(points[i][0].call, points[i][1]) for i in order]
        seconds[:, order] = in_turns(calls, repeats, [points[i][2].seconds for i in order])
    return seconds


def machine() -> dict[str, str | int | None]:
    """A dict: processor, cores that this process may use, system, versions, XLA's flags, date (UTC), commit.

    `commit` is that of the checkout that granjax runs from, with `-dirty` where files differ from it; `None` where it
    is installed without one.
    """
    return {
        "processor": _processor(),
        "cores": cores(),
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        **{name: _version(name) for name in _PACKAGES},
        "xla_flags": os.environ.get("XLA_FLAGS", ""),
        "date": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "commit": _commit(),
    }


def _processor():
    cpuinfo = Path("/proc/cpuinfo")
    lines = cpuinfo.read_text().splitlines() if cpuinfo.is_file() else []
    named = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return named[0] if named else platform.processor() or platform.machine()


def _version(name):
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None


def _commit():
    if not (_ROOT / ".git").exists():
        return None
    command = [
        "git",
        "-C",
        str(_ROOT),
        "describe",
        "--always",
        "--dirty",
        "--abbrev=12",
        "--exclude",
        "*",
    ]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=10, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return None
    return done.stdout.strip() or None
