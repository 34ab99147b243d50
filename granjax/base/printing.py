"""Readable text: numbers as numbers, arrays by shape and range, functions by name."""

import dataclasses
import reprlib
from typing import Any

import equinox as eqx
import jax
import numpy as np

from .checks import concrete, described

# The most entries of an array or a sequence that are written out.
FEW = 6
# The most characters of a line.
WIDTH = 110
# The most characters of a nested value.
WITHIN = 60
# What is shown as numbers, one by one or by shape and range.
NUMBERS = (jax.Array, np.ndarray, np.generic, int, float, complex)


def text(value: Any, unit: str = "") -> str:
    """Return a value with its unit as text: a number, or an array by shape and range."""
    if isinstance(value, str):
        return value
    if isinstance(value, (bool, np.bool_)):
        return "yes" if value else "no"
    if isinstance(value, dict):
        return ", ".join(f"{key}: {text(x, unit)}" for key, x in value.items()) or "none"
    if isinstance(value, NUMBERS):
        x = _known(value)
        return x if isinstance(x, str) else f"{numbers(x)} {'' if unit == '1' else unit}".strip()
    if hasattr(value, "_asdict"):
        return text(value._asdict(), unit)
    if isinstance(value, (list, tuple)):
        if value and all(isinstance(x, (int, float, complex, np.generic)) for x in value):
            return text(np.asarray(value), unit)
        few = [text(x, unit) for x in value[:4]] + (["..."] if len(value) > 4 else [])
        return ", ".join(few) or "none"
    return brief(value)


def brief(value: Any) -> str:
    """Return part of a line about an object: its outcome or, for a function, its name."""
    if hasattr(value, "outcome"):
        return f"{type(value).__name__}: {value.outcome}"
    if isinstance(value, eqx.Module) or hasattr(value, "_asdict"):
        whole = repr(value)
        return whole if len(whole) <= WITHIN and "\n" not in whole else type(value).__name__
    return getattr(value, "__name__", type(value).__name__)


def numbers(x: np.ndarray) -> str:
    """Return an array of numbers, words or flags as text; by shape and range if it is large."""
    if x.ndim == 0:
        return text(bool(x)) if x.dtype == bool else _one(x[()])
    if x.size == 0:
        return "none"
    shape = f"shape ({', '.join(map(str, x.shape))})"
    if x.dtype == bool:
        return f"{shape}, {np.count_nonzero(x)} of {x.size} yes"
    if x.dtype.kind not in "iufc":
        return f"{shape}: {', '.join(dict.fromkeys(map(str, x.reshape(-1)[:100])))}"
    if x.ndim == 1 and x.size <= FEW:
        return ", ".join(map(_one, x))
    size = np.abs(x) if x.dtype.kind == "c" else x
    known = size[np.isfinite(size)]
    span = f"{_one(known.min())} ... {_one(known.max())}" if known.size else "not finite"
    lost = f", {size.size - known.size} not finite" if 0 < known.size < size.size else ""
    return f"{shape}, {'modulus ' if x.dtype.kind == 'c' else ''}{span}{lost}"


def _one(x):
    # A whole number keeps all of its digits.
    return f"{x:.6g}" if x.dtype.kind in "fc" else f"{x}"


def told(x: Any) -> str:
    """Return the `repr` of a record: its name, and its public fields as parts of a line.

    A class uses it by `__repr__ = told`. Fields that begin with an underscore or are `None` are
    left out. `_shown`, a dict from names of arguments to names of attributes, replaces the fields.
    """
    shown = getattr(x, "_shown", None)
    if not shown:
        names = getattr(x, "_fields", None)
        if names is None:
            names = [field.name for field in dataclasses.fields(x) if field.name[0] != "_"]
        shown = dict(zip(names, names))
    return called(type(x).__name__, {name: getattr(x, at, None) for name, at in shown.items()})


def called(name: str, arguments: dict[str, Any], units: dict[str, str] | None = None) -> str:
    """Return the text of a call without arguments that are `None`, on one line if it fits."""
    units = units or {}
    parts = [
        f"{key}={_argument(value)} {units.get(key, '')}".rstrip()
        for key, value in arguments.items()
        if value is not None
    ]
    line = f"{name}({', '.join(parts)})"
    return (
        line
        if len(line) <= WIDTH and "\n" not in line
        else f"{name}(\n" + "".join(f"  {x},\n" for x in parts) + ")"
    )


def _argument(value):
    if value is None or isinstance(value, (str, bool)):
        return repr(value)
    if isinstance(value, NUMBERS):
        x = _known(value)
        return x if isinstance(x, str) else numbers(x) if x.ndim == 0 else f"[{numbers(x)}]"
    if isinstance(value, dict):
        return f"{{{', '.join(f'{key}: {_argument(x)}' for key, x in value.items())}}}"
    if isinstance(value, (list, tuple)) and not hasattr(value, "_fields"):
        if len(value) == 1:
            return _argument(value[0])
        few = [_argument(x) for x in value[:FEW]] + ["..."] * (len(value) > FEW)
        return f"({', '.join(few)})"
    if isinstance(value, eqx.Module) or hasattr(value, "_fields"):
        whole = repr(value)
        return whole if len(whole) <= WIDTH and "\n" not in whole else brief(value)
    return getattr(value, "__name__", None) or reprlib.repr(value)


def _known(value):
    try:
        x = concrete(value)
    except (TypeError, RuntimeError):  # JAX's keys, and donated or deleted arrays.
        return described(value)
    return f"traced, shape {value.shape}" if x is None else x
