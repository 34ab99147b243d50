"""Calls with a clock: once, cold and warm, and in turns."""

import time
from typing import NamedTuple

import jax
import numpy as np

from ..checks import refuse

# what a point may take altogether [s], before it is called less often
ENOUGH = 3.0


class Outcome(NamedTuple):
    """What one call gave: its state, its counts, its wall time [s], and a sentence where it failed."""

    state: object
    evaluations: float
    steps: float
    seconds: float
    note: str


def once(call, value):
    """Call and wait for the result; a ValueError or RuntimeError becomes the outcome's note."""
    start = time.perf_counter()
    try:
        result = jax.block_until_ready(call(value))
    except (ValueError, RuntimeError) as error:
        return Outcome(None, np.nan, np.nan, time.perf_counter() - start, str(error))
    seconds = time.perf_counter() - start
    if not isinstance(result, tuple) or len(result) not in (2, 3):
        refuse("call", "a function that returns (state, evaluations) or (state, evaluations, steps)", repr(result)[:60])
    state, *counts = result
    evaluations, steps = (*counts, None, None)[:2]
    return Outcome(state, _number(evaluations), _number(steps), seconds, "")


def _number(x):
    return np.nan if x is None else float(np.max(x))


def warmed(ladder):
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


def in_turns(calls, repeats, known=None):
    """Median and shortest wall time of calls [s] that take turns, A B C A B C, so that a drift of the machine hits all.

    `calls`: pairs (call, value). Each is called `repeats` times, or until its times add up to `ENOUGH`; `known`: the
    time that each took before, which is enough where it is more than that.
    """
    spent = [[x] if x > ENOUGH else [] for x in (np.zeros(len(calls)) if known is None else known)]
    for _ in range(repeats):
        for (call, value), times in zip(calls, spent):
            if sum(times) < ENOUGH:
                times.append(once(call, value).seconds)
    return np.array([[np.median(times), np.min(times)] for times in spent]).reshape(-1, 2).T
