"""Conversion of plot arguments to NumPy arrays of known shape."""

from typing import Any, NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Float

from ..base.checks import parameter, real, refuse, show
from ..base.types import Parameter
from .style import said_by, units_of

Samples: TypeAlias = Parameter | np.ma.MaskedArray
"""Numbers to draw; masked entries are gaps."""

# The relative tolerance for evenly spaced sites, times and parameters.
EVEN = 1e-6
LABELS = {"u": ("displacement", "m"), "v": ("velocity", "m/s")}


def numbers(
    argument: str, x: Any, ndim: int | None = None, finite: bool = True
) -> Float[np.ndarray, "..."]:
    """Return a floating NumPy array; with `finite=False` NaN and infinity are allowed, as gaps."""
    if isinstance(x, np.ma.MaskedArray):
        x = x.astype(float).filled(np.nan)
    array = np.asarray(parameter(argument, np.asarray(x)) if finite else real(argument, x))
    if ndim is not None and array.ndim != ndim:
        names = {1: "one row, shape (N,)", 2: "frames of sites, shape (T, N)"}
        refuse(argument, names.get(ndim, f"{ndim} axes"), f"shape {array.shape}")
    return array


def rising(argument: str, x: Any, size: int) -> Float[np.ndarray, " size"]:
    """Return `size` increasing numbers; `None` counts from 0."""
    x = numbers(argument, np.arange(size) if x is None else x, 1)
    if len(x) != size or not np.all(np.diff(x) > 0):
        refuse(argument, f"{size} rising numbers, as many as the data has", show(x))
    return x


def even(x: np.ndarray) -> bool:
    """Return whether numbers are evenly spaced, to within `EVEN` of the spacing."""
    steps = np.diff(x)
    return len(x) < 2 or bool(np.ptp(steps) <= EVEN * abs(steps.mean()))


class History(NamedTuple):
    """A quantity over time: times (T,) or `None`, numbers (T, ...), label, unit, unit system."""

    ts: Any
    data: Any
    label: str
    unit: str | None
    units: str | None


def history(run_or_array: Any, quantity: Any, label: str | None = None) -> History:
    """Return a quantity of a run or its dataset; an array is itself the quantity.

    `quantity`: "u", "v", another variable of a dataset, or an array over the times. **Raises**
    ValueError for a run with a single time, and for an unknown quantity.
    """
    stored = "time" in getattr(run_or_array, "variables", ())
    if not stored and not hasattr(run_or_array, "ts"):
        return History(None, run_or_array, label or "quantity", None, units_of(run_or_array))
    ts = run_or_array["time"] if stored else run_or_array.ts
    if np.size(ts) == 1:
        remedy = "Give simulate the number of frames, such as save_at=401."
        refuse("run", "a run with several frames", "one that saved a single time", remedy)
    name = "quantity"
    unit = None
    data = quantity
    if isinstance(quantity, str):
        name, unit = LABELS.get(quantity, (quantity, None))
        held = run_or_array if stored else {"u": run_or_array.us, "v": run_or_array.vs}
        if quantity not in held:
            refuse("quantity", "one of 'u', 'v', a variable of a dataset", repr(quantity))
        data = held[quantity]
        name = name if unit else str(getattr(data, "attrs", {}).get("long_name", name))
    return History(ts, data, label or name, *said_by(data, unit, units_of(run_or_array)))


def frames_of(data: Any, argument: str = "quantity") -> Float[np.ndarray, "T N"]:
    """Return the numbers (T, N) of a chain with one number per site."""
    if isinstance(data, dict):
        names = ", ".join(map(repr, data))
        remedy = "Pick one: quantity=run.vs[...]."
        refuse(argument, "an array where a cell holds several fields", f"fields {names}", remedy)
    return numbers(argument, data, 2, finite=False)
