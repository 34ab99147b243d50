"""The points of a sweep: a grid or a list."""

import math
from collections.abc import Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np

from ..base.checks import described, held_in_memory, refuse, show
from ..base.printing import called, numbers
from ..base.types import Values

LANE = "lane"
# names that a sweep reserves
TAKEN = {LANE, "reason", "outcome"}


class Points:
    """The lanes of a sweep, in order.

    - `design`: `"grid"` for all combinations, where the last parameter varies fastest, or `"list"`.
    - `axes`: {name: values}, the coordinates along each axis of a grid, or one value per lane.
    - `shape`, `dims`: of the results; `count`: the number of lanes.
    """

    def __init__(self, axes: dict[str, np.ndarray], design: str):
        self.axes = axes
        self.design = design
        sizes = tuple(len(x) for x in axes.values())
        self.shape = sizes if design == "grid" else sizes[:1]
        self.dims = tuple(axes) if design == "grid" else (LANE,)
        self.count = math.prod(self.shape)
        # the index and the values of each
        held_in_memory("parameters", self.count, 8 * (1 + len(axes)), "points")

    def values(self, lanes: np.ndarray) -> dict[str, np.ndarray]:
        """Return the parameters of lanes, given by their indices (n,)."""
        if self.design == "list":
            return {name: x[lanes] for name, x in self.axes.items()}
        places = np.unravel_index(lanes, self.shape)
        return {name: x[place] for (name, x), place in zip(self.axes.items(), places)}

    def at(self, lane: int) -> dict[str, Any]:
        """Return the parameters of one lane as Python numbers and words."""
        return {name: x.item() for name, x in self.values(np.array([lane])).items()}

    def __repr__(self) -> str:
        return called(
            self.design, {name: f"{numbers(x)} ({len(x)})" for name, x in self.axes.items()}
        )


Parameters: TypeAlias = Mapping[str, Any] | Sequence[Mapping[str, Any]] | Points
"""Parameters: {name: values} for all combinations, a list of dicts, or the result of `paired`."""


def points_of(parameters: Parameters) -> Points:
    """Convert parameters to `Points`. **Raises** ValueError for invalid ones."""
    if isinstance(parameters, Points):
        return parameters
    if isinstance(parameters, Mapping):
        axes = {_name(name): _row(name, x) for name, x in parameters.items()}
        if not axes:
            refuse("parameters", 'names and values, such as {"ratio": [0.5, 0.6]}', "none")
        return Points(axes, "grid")
    rows = list(parameters)
    if not rows or not all(isinstance(row, Mapping) for row in rows):
        refuse(
            "parameters", "a dict from names to values, or a list of dicts", described(parameters)
        )
    for i, row in enumerate(rows):
        if row.keys() != rows[0].keys():
            got = f"{', '.join(row) or 'none'} in number {i}"
            refuse("parameters", f"{', '.join(rows[0])} in every dict", got)
    return paired({name: [row[name] for row in rows] for name in rows[0]})


def paired(parameters: dict[str, Values]) -> Points:
    """Combine lists entry by entry, as rows of a table: lane i has the i-th value of each.

    **Arguments:** `parameters`: {name: values}, numbers or words, all of one length.
    **Returns:** `Points` for `gx.sweep`.
    **Raises** ValueError for lists of different lengths, empty lists and other values.

    **Example:**

    >>> points = gx.sweeps.paired({"ratio": [0.5, 1.0], "load": [1.0, 2.0]})
    >>> points.count, points.at(1)
    (2, {'ratio': 1.0, 'load': 2.0})
    """
    axes = {_name(name): _row(name, x) for name, x in parameters.items()}
    lengths = {name: len(x) for name, x in axes.items()}
    if not axes or len(set(lengths.values())) != 1:
        got = ", ".join(f"{name} of {n}" for name, n in lengths.items()) or "none"
        refuse(
            "parameters",
            "lists of one length",
            got,
            "A dict given to gx.sweep itself means all combinations.",
        )
    return Points(axes, "list")


def _name(name):
    if not isinstance(name, str) or not name.isidentifier():
        refuse("parameters", "names that a function's arguments can have", repr(name))
    if name in TAKEN:
        refuse(
            "parameters",
            f"other names than {', '.join(sorted(TAKEN))}",
            repr(name),
            "These are a sweep's own.",
        )
    return name


def _row(name, given):
    try:
        x = np.asarray(given)
    except (TypeError, ValueError):
        refuse(f"parameters[{name!r}]", "a row of numbers or words", described(given))
    if x.dtype.kind in "UO":
        words = [isinstance(word, str) for word in np.asarray(given, object).flat]
        if any(words) and not all(words):
            refuse(f"parameters[{name!r}]", "numbers or words", f"both, {described(given)}")
        x = x.astype(str) if any(words) else x
    if x.ndim != 1 or not x.size or x.dtype.kind not in "biufU":
        refuse(
            f"parameters[{name!r}]",
            "a row of numbers or words",
            f"{x.dtype} of shape {x.shape}",
            "Put a number that all points share into the function; to sweep over several arrays, sweep their index.",
        )
    if x.dtype.kind == "f":
        x = x.astype(float)
        if not np.isfinite(x).all():
            refuse(f"parameters[{name!r}]", "finite numbers", show(x))
    return x.astype(np.int64) if x.dtype.kind in "iu" else x
