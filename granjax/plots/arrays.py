"""What the plots are given, as NumPy arrays of known shape."""

from typing import Any, ClassVar, TypeAlias

import numpy as np
from jaxtyping import Float

from ..checks import one_of, parameter, real, refuse, show
from ..types import Parameter

Samples: TypeAlias = Parameter | np.ma.MaskedArray
"""Numbers to draw; what is masked is a gap."""


def numbers(
    argument: str, x: Any, ndim: int | None = None, finite: bool = True
) -> Float[np.ndarray, "..."]:
    """A floating NumPy array; with `finite=False` NaN and infinity pass, as gaps in the picture."""
    if finite:
        array = np.asarray(parameter(argument, x))
    else:
        # what is masked is a gap, as NaN is
        array = real(
            argument, x.astype(float).filled(np.nan) if isinstance(x, np.ma.MaskedArray) else x
        )
    if ndim is not None and array.ndim != ndim:
        names = {0: "one number", 1: "one row, shape (N,)", 2: "frames of sites, shape (T, N)"}
        refuse(argument, names.get(ndim, f"{ndim} axes"), f"shape {array.shape}")
    return array


def rising(argument: str, x: Any, size: int) -> Float[np.ndarray, " size"]:
    """`size` numbers, each above the one before."""
    x = numbers(argument, x, 1)
    if len(x) != size or not np.all(np.diff(x) > 0):
        refuse(argument, f"{size} rising numbers, as many as the data has", show(x))
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
            refuse(
                "quantity",
                "nothing beside an array, which is the quantity",
                repr(quantity)[:60],
                "Give the array alone, or a run and quantity='u', 'v' or an array.",
            )
        return ts, numbers("run_or_array", run_or_array, 2, finite=False)
    run = opened(run_or_array)
    if np.size(run.ts) == 1:
        refuse(
            "run_or_array",
            "a run with several frames",
            "one that saved a single time",
            "Give simulate the number of frames, such as save_at=401.",
        )
    ts = run.ts if ts is None else ts
    if isinstance(quantity, str):
        data = run.us if one_of("quantity", quantity, ("u", "v")) == "u" else run.vs
        if isinstance(data, dict):
            names = ", ".join(map(repr, data))
            refuse(
                "quantity",
                "an array where a cell holds several fields",
                repr(quantity),
                f"Fields {names}: quantity=run.{quantity}s[...].",
            )
    else:
        data = quantity
    data = numbers("quantity", data, 2, finite=False)
    return ts, data
