"""What the plots are given, as NumPy arrays of known shape."""

from typing import Any, ClassVar, TypeAlias

import jax
import numpy as np
from jaxtyping import Float

from ..checks import described, parameter, real, refuse, show
from ..types import Parameter

Samples: TypeAlias = Parameter | np.ma.MaskedArray
"""Numbers to draw; what is masked is a gap."""


def numbers(argument: str, x: Any, ndim: int | None = None, finite: bool = True) -> Float[np.ndarray, "..."]:
    """A floating NumPy array; with `finite=False` NaN and infinity pass, as gaps in the picture."""
    if finite:
        array = np.asarray(parameter(argument, x))
    else:
        if isinstance(x, jax.core.Tracer):
            refuse(argument, "real numbers known before tracing", f"{type(x).__name__}")
        # what is masked is a gap, as NaN is
        array = real(argument, x.astype(float).filled(np.nan) if isinstance(x, np.ma.MaskedArray) else x)
    if ndim is not None and array.ndim != ndim:
        names = {0: "one number", 1: "one row, shape (N,)", 2: "frames of sites, shape (T, N)"}
        refuse(argument, names.get(ndim, f"{ndim} axes"), f"shape {array.shape}")
    return array


def having(argument: str, x: Any, expected: str, *names: str) -> None:
    """Refuse what has not the attributes that are drawn."""
    missing = [name for name in names if not hasattr(x, name)]
    if missing or isinstance(x, type):
        refuse(argument, f"{expected}, or anything with {', '.join(names)}", described(x))


def rising(argument: str, x: Any, size: int) -> Float[np.ndarray, " size"]:
    """`size` numbers, each above the one before."""
    x = numbers(argument, x, 1)
    if len(x) != size:
        refuse(argument, f"{size} numbers, one per row or column of the data", f"shape {x.shape}")
    if not np.all(np.diff(x) > 0):
        refuse(argument, "rising numbers", show(x))
    return x


class _Stored:
    """A run that was saved, as one: `ts`, `us`, `vs` of a dataset with `time`, `u`, `v`, read when they are drawn."""

    names: ClassVar = {"ts": "time", "us": "u", "vs": "v"}

    def __init__(self, data):
        self.data = data

    def __getattr__(self, name):
        key = self.names.get(name, "")
        if key not in self.data:
            raise AttributeError(name)
        return self.data[key].values

    @property
    def units(self):
        return getattr(self.data, "units", None)


def is_stored(x: Any) -> bool:
    """Whether it is a dataset of a run, as `run.to_xarray()` gives it: `time`, and `u` or `v`."""
    held = getattr(x, "data_vars", ())
    return "time" in getattr(x, "variables", ()) and ("u" in held or "v" in held)


def opened(x: Any) -> Any:
    """A run, as it is or as a dataset holds it."""
    return _Stored(x) if is_stored(x) else x


def is_run(x: Any) -> bool:
    """Whether it is a run: anything with ts, us and vs, or a dataset of one."""
    return is_stored(x) or all(hasattr(x, name) for name in ("ts", "us", "vs"))


def history(run_or_array: Any, quantity: Any, ts: Any) -> tuple[Any, Float[np.ndarray, "T N"]]:
    """Times (or `None`) and data (T, N) of a run and one of its quantities, or of an array."""
    if not is_run(run_or_array):
        if not (isinstance(quantity, str) and quantity == "v"):
            refuse("quantity", "nothing beside an array, which is the quantity", repr(quantity)[:60],
                   "Give the array alone, or a run and quantity='u', 'v' or an array.")
        return ts, numbers("run_or_array", run_or_array, 2, finite=False)
    run = opened(run_or_array)
    if np.size(run.ts) == 1:
        refuse("run_or_array", "a run with several frames", "one that saved a single time",
               "Give simulate the number of frames, such as save_at=401.")
    ts = run.ts if ts is None else ts
    if isinstance(quantity, str):
        if quantity not in ("u", "v"):
            refuse("quantity", "'u', 'v', or an array (T, N)", repr(quantity))
        having("run_or_array", run, f"a run with {quantity}", f"{quantity}s")
        data = run.us if quantity == "u" else run.vs
        if isinstance(data, dict):
            names = ", ".join(map(repr, data))
            refuse("quantity", "an array where a cell holds several fields", repr(quantity),
                   f"Fields {names}: quantity=run.{quantity}s[...].")
    else:
        data = quantity
    if np.ndim(data) != 2:
        refuse("quantity", "frames of sites, shape (T, N)", f"shape {np.shape(data)}",
               "Pick one lane or component: quantity=run.vs[:, :, 0].")
    data = numbers("quantity", data, 2, finite=False)
    if len(data) != np.size(run.ts):
        refuse("quantity", f"{np.size(run.ts)} frames, one per time of the run", f"shape {data.shape}")
    return ts, data
