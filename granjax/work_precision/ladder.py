"""A ladder: one method, and the steps or tolerances that it is tried with."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ..checks import one_of, refuse, show

PARAMETERS = ("step", "tolerance")
DEFAULT = "default"


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
    values: object
    call: Callable
    stops: bool = False
    limit: float = np.inf
    solver: object = None
    compile_seconds: float | None = None


def checked_ladders(ladders):
    """The ladders as a tuple. **Raises** ValueError for another kind, two of one name, values that cannot be meant."""
    if isinstance(ladders, Ladder) or not isinstance(ladders, (tuple, list)) or not ladders:
        refuse("ladders", "a list of Ladder(name, parameter, values, call)", repr(ladders)[:60])
    for i, ladder in enumerate(ladders):
        if not isinstance(ladder, Ladder):
            refuse(f"ladders[{i}]", "a Ladder(name, parameter, values, call)", repr(ladder)[:60])
        one_of(f"ladders[{i}].parameter", ladder.parameter, PARAMETERS)
        if not callable(ladder.call):
            refuse(f"ladders[{i}].call", "a function of the value", repr(ladder.call)[:60])
    names = [ladder.name for ladder in ladders]
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        refuse("ladders", "a name of its own for each", f"{twice!r} twice")
    return tuple(
        ladder._replace(values=ladder.values if ladder.name == DEFAULT else checked_values(ladder.name, ladder.values))
        for ladder in ladders
    )


def checked_values(name, values):
    """Steps or tolerances as a tuple of floats, the coarsest first."""
    try:
        array = np.atleast_1d(np.asarray(values, dtype=float))
    except (TypeError, ValueError):
        array = np.array([np.nan])
    if array.ndim != 1 or not array.size or not np.all(np.isfinite(array) & (array > 0)):
        got = show(array) if array.ndim == 1 and not np.isnan(array).all() else repr(values)[:60]
        refuse(f"steps of {name}", "finite numbers above zero, such as [0.1, 0.05]", got)
    return tuple(float(x) for x in np.unique(array)[::-1])
