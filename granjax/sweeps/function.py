"""The user's function: how it is called, and what it returns as columns of numbers and words."""

import inspect
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np

from ..checks import described, refuse
from ..results import Result

# the axis of lanes in the files of results
LANE = "lane"


def by_keywords(function: Callable, names: tuple[str, ...]) -> bool:
    """Whether a function takes parameters by their names, else all of them as one dict.

    **Raises** ValueError where it takes neither.
    """
    try:
        signature = inspect.signature(function)
    except (TypeError, ValueError):
        return True
    wanted = signature.parameters
    free = any(p.kind is p.VAR_KEYWORD for p in wanted.values())
    plain = [n for n, p in wanted.items() if p.kind in (p.POSITIONAL_ONLY, p.POSITIONAL_OR_KEYWORD, p.KEYWORD_ONLY)]
    needed = [n for n in plain if wanted[n].default is inspect.Parameter.empty]
    if set(needed) <= set(names) and (free or set(names) <= set(plain)):
        return True
    if len(needed) == 1 and needed[0] not in names or not needed and len(plain) == 1 and plain[0] not in names:
        return False
    refuse("function", f"a function of {', '.join(names)}, or of one dict with these",
           f"{getattr(function, '__name__', 'one')}({', '.join(plain)})", "Parameters are given by their names.")


def call(function: Callable, values: Mapping[str, Any], keywords: bool) -> Any:
    """What the function returns for one lane."""
    return function(**values) if keywords else function(dict(values))


def name_of(function: Callable) -> str:
    """What the one number that a function returns is called."""
    name = getattr(function, "__name__", "")
    return name if name.isidentifier() else "value"


def columns(value: Any, name: str, lanes: int | None) -> dict[str, tuple[np.ndarray, dict]]:
    """{name: (array, what is known of it)} of what a function returned.

    `lanes`: how many lanes lead every array in it; `None` for those of one lane, which have no such axis.
    **Raises** ValueError for what is no number, word, array, dict or result.
    """
    found = {}
    for key, x, told in _entries(value, "", lanes):
        key = key or name
        if key in found:
            refuse("function", "results of different names", f"two of {key!r}")
        if x.dtype.kind == "c":
            found |= {f"{key}_real": (x.real, told), f"{key}_imag": (x.imag, told)}
        else:
            found[key] = x, told
    if not found:
        refuse("function", "one that returns numbers or words", f"one that returns {described(value)}")
    return found


def _entries(value, name, lanes) -> Iterator[tuple[str, np.ndarray, dict]]:
    if hasattr(value, "_asdict"):
        value = value._asdict()
    if isinstance(value, Mapping):
        for key, x in value.items():
            yield from _entries(x, f"{name}_{key}".replace("/", "_") if name else str(key).replace("/", "_"), lanes)
    elif isinstance(value, Result):
        yield from _of_dataset(value.to_xarray(), name, lanes)
    elif hasattr(value, "data_vars"):
        yield from _of_dataset(value, name, lanes)
    elif hasattr(value, "dims") and hasattr(value, "attrs"):
        yield from _of_dataset(value.to_dataset(name=name or value.name or "value"), "", lanes)
    elif isinstance(value, (tuple, list)) and not _plain(value):
        for i, x in enumerate(value):
            yield from _entries(x, f"{name or 'value'}_{i}", lanes)
    elif value is not None:
        x = np.asarray(value)
        if x.dtype.kind not in "biufcU":
            refuse("function", "one that returns numbers, words, arrays, dicts or results of granjax",
                   f"{name or 'one'} of {described(value)}")
        if lanes is not None and x.shape[:1] != (lanes,):
            x = np.broadcast_to(x, (lanes, *x.shape))
        yield name, x, {}


def _plain(value):
    """Whether a list is one of numbers or words, which is an array."""
    return bool(value) and all(isinstance(x, (bool, int, float, complex, str, np.generic)) for x in value)


def _of_dataset(data, name, lanes):
    """Variables of a dataset, and the numbers and words among its attributes."""
    prefix = f"{name}_" if name else ""
    for key, x in data.variables.items():
        if key in data.dims and x.dims == (key,) and key in (LANE, "site", "component", "field"):
            continue
        values, dims = x.values, [d for d in x.dims if d != LANE]
        if values.dtype.kind not in "biufcU":
            values = values.astype(str)
        if lanes is not None:
            own = np.moveaxis(values, x.dims.index(LANE), 0) if LANE in x.dims else values
            values = own if LANE in x.dims else np.broadcast_to(own, (lanes, *own.shape))
        yield f"{prefix}{key}", values, {"dims": dims} | {k: u for k, u in x.attrs.items() if isinstance(u, str)}
    for key, x in data.attrs.items():
        # of all lanes together
        shared = lanes is not None and key == "outcome"
        known = shared or key in ("granjax", "jax", "result", "units") or key.endswith("_units")
        if not known and isinstance(x, (bool, int, float, str, np.number)):
            told = {"units": data.attrs[f"{key}_units"]} if f"{key}_units" in data.attrs else {}
            x = np.asarray(x)
            yield f"{prefix}{key}", x if lanes is None else np.broadcast_to(x, (lanes, *x.shape)), {"dims": [], **told}


def stacked(parts: list[dict[str, tuple[np.ndarray, dict]] | None]) -> tuple[dict[str, np.ndarray], dict[str, dict]]:
    """Columns of lanes one by one, `None` for a lane without any: missing numbers are NaN, missing words empty.

    Arrays of several lengths are filled up likewise.
    """
    names = list(dict.fromkeys(name for part in parts if part for name in part))
    found, told = {}, {}
    for name in names:
        lanes = [part[name][0] if part and name in part else None for part in parts]
        told[name] = next(part[name][1] for part in parts if part and name in part)
        found[name] = joined([None if x is None else x[None] for x in lanes], [1] * len(lanes))
    return found, told


def joined(parts: list[np.ndarray | None], counts: list[int]) -> np.ndarray:
    """Arrays (lanes, ...) one behind another, `None` for so many lanes without one.

    Where some are missing or shorter than others NaN stands, for words "".
    """
    there = [x for x in parts if x is not None]
    axes = max(x.ndim for x in there)
    there = [x.reshape(x.shape + (1,) * (axes - x.ndim)) for x in there]
    own = tuple(max(x.shape[k] for x in there) for k in range(1, axes))
    kind = np.result_type(*there) if len({x.dtype.kind == "U" for x in there}) == 1 else np.dtype(str)
    whole = len(there) == len(parts) and all(x.shape[1:] == own for x in there)
    if not whole and kind.kind in "biu":
        kind = np.dtype(float)
    if kind.kind == "U":
        kind = max((x.astype(str).dtype for x in there), key=lambda dtype: dtype.itemsize)
    out = np.full((sum(counts), *own), "" if kind.kind == "U" else np.nan if kind.kind in "fc" else 0, kind)
    place, left = 0, iter(there)
    for x, count in zip(parts, counts):
        if x is not None:
            x = next(left)
            out[(slice(place, place + count), *(slice(n) for n in x.shape[1:]))] = x
        place += count
    return out
