"""A sweep as a table for reading."""

from typing import Any

import numpy as np

from ..checks import refuse, whole
from ..entry import checked
from ..printing import numbers
from ..types import Count

REASON, NOT_YET = "reason", "not computed yet"
# letters of a column, and of a reason
WIDTH, SENTENCE = 18, 100


@checked
def table(data: Any, rows: Count = 12) -> str:
    """A row per lane: the parameters, what was found, and for lanes that failed the reason.

    **Arguments:** `data`: what `gx.sweep` returns, or an `xarray.Dataset` of its form; `rows`: the most that are shown
    of those that hold, and of those that failed; a line says how many more there are. Arrays of a lane are shown by
    shape and range.

    **Returns:** the text. **Raises** ValueError for what is no such dataset, `rows` < 2.

    **Example:**

    >>> data = gx.sweep(lambda x: {"y": x**2}, {"x": [1.0, 2.0, 3.0]})
    >>> print(gx.sweeps.table(data))
    x  y
    1  1
    2  4
    3  9
    3 lanes.
    """
    rows = whole("rows", rows, 2)
    if not all(hasattr(data, name) for name in ("data_vars", "coords", "dims")):
        refuse("data", "a sweep, or an xarray.Dataset of its form", type(data).__name__)
    dims, shape = _lanes(data)
    count = int(np.prod(shape))
    columns = {name: x for name, x in _columns(data, dims, shape).items() if name != REASON}
    reason = np.full(count, "")
    if REASON in data:
        reason = np.asarray(data[REASON].transpose(*dims).values).astype(str).reshape(-1)
    coming = reason == NOT_YET
    good, failed = (np.flatnonzero(which) for which in (reason == "", (reason != "") & ~coming))
    head = [f"{name} [{unit}]" if unit else name for name, unit in ((n, _unit(data, n)) for n in columns)]
    lines, ahead = [head], []
    for which in (_few(good, rows), _few(failed, rows)):
        ahead.append(len(lines))
        lines += [["..."] * len(head) if i is None else [_cell(x, i) for x in columns.values()] for i in which]
    width = [min(max(len(line[k]) for line in lines), 3 * WIDTH) for k in range(len(head))]
    text = ["  ".join(cell.rjust(w) for cell, w in zip(line, width)).rstrip() for line in lines]
    for k, i in enumerate(_few(failed, rows)):
        text[ahead[1] + k] += "" if i is None else f"  {_sentence(reason[i])}"
    left = {"": len(good) - rows, "that failed": len(failed) - rows}
    more = [f"{n} more rows {which}".strip() for which, n in left.items() if n > 0]
    said = f"{count} lanes, {len(failed)} of them failed" if len(failed) else f"{count} lanes"
    said += f", {np.count_nonzero(coming)} not computed yet" if coming.any() else ""
    return "\n".join(text + [f"{said}{': ' if more else ''}{', '.join(more)}."])


def _lanes(data):
    """The dimensions of the lanes, and how many there are along each."""
    if REASON in data:
        dims = data[REASON].dims
    elif "lane" in data.dims:
        dims = ("lane",)
    else:
        shared = set.intersection(*[set(x.dims) for x in data.data_vars.values()] or [set()])
        dims = tuple(name for name in data.dims if name in shared and name in data.coords)
    if not dims:
        refuse("data", "coordinates by the names of the parameters that vary", f"dimensions {tuple(data.dims)}")
    return dims, tuple(data.sizes[name] for name in dims)


def _columns(data, dims, shape):
    """Arrays of a value, or of an array, per lane."""
    found = {}
    for k, name in enumerate(dims):
        if name in data.coords:
            turned = [1] * len(shape)
            turned[k] = shape[k]
            found[name] = np.broadcast_to(np.asarray(data[name].values).reshape(turned), shape).reshape(-1)
    for name, x in {**data.coords, **data.data_vars}.items():
        if name not in found and set(dims) <= set(x.dims):
            values = np.asarray(x.transpose(*dims, ...).values)
            found[name] = values.reshape(-1, *values.shape[len(shape) :])
    return found


def _unit(data, name):
    return str(data[name].attrs.get("units", ""))


def _few(which, rows):
    """The first and the last of some indices, with `None` between them for what is left out."""
    if len(which) <= rows:
        return [*which]
    return [*which[: rows - rows // 2], None, *which[len(which) - rows // 2 :]]


def _cell(x, i):
    value = x[i]
    if np.ndim(value) == 0 and x.dtype.kind not in "fiucb":
        return str(value)
    return numbers(np.asarray(value))


def _sentence(reason):
    return reason if len(reason) <= SENTENCE else reason[: SENTENCE - 3] + "..."
