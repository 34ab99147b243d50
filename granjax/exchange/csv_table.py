"""A dataset as a text of columns: what spreadsheets, pandas and NumPy read, and what makes the same dataset again."""

import csv
import io
import json
import math
import re
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..checks import refuse
from ..reading import regular
from ..reading.formats import STRUCTURE, listed, told
from . import structure

if TYPE_CHECKING:
    import xarray

# numbers of a text, and of what is beside the table
MOST, BESIDE = 2**24, 2**16
LARGEST, WHAT = 2**30, "a .csv file that `save` wrote"
LAST = f"# {STRUCTURE}: "
# axes whose entries stand side by side
ACROSS = re.compile(r"(.*_)?(site|field|component|word)(_\w+)?")
NUMBER = re.compile(r"[+-]?(\d+(\.\d*)?([eE][+-]?\d+)?|inf)|nan")


def csv_text(data: "xarray.Dataset") -> str:
    """A dataset as a table: time in the first column, one for each site; of a batch or a sweep a row for each lane.

    Rows run over the axes that all variables share, `time` first of all and none that counts sites; where there is no
    such, over time or the axis of the most variables. What has not these axes stands in the comments below, as do
    attributes, and what makes the same dataset again. Numbers have as many digits as tell them apart.

    **Raises** ValueError for more than 2^24 numbers, or 2^16 beside the table.
    """
    names = {str(name): str(name) for name in data.variables}
    told, arrays = structure.described(data, names)
    if sum(x.size for x in arrays.values()) > MOST:
        refuse("path", f"at most {MOST} numbers in a .csv file", f"{sum(x.size for x in arrays.values())}",
               "Write a .nc, .npz or .mat file, or less: gx.exchange.save(run.to_xarray()[['u']], path).")
    axes = _rows(data)
    inside = [name for name in _ordered(data, axes) if _stands(data[name].dims, axes, data.sizes)]
    beside = {name: x for name, x in arrays.items() if name not in inside}
    if sum(x.size for x in beside.values()) > BESIDE:
        large = max(beside, key=lambda name: beside[name].size)
        refuse("path", f"a table over {' and '.join(axes)}", f"{large} over {' and '.join(data[large].dims)} too",
               f"Write a .nc, .npz or .mat file, or that alone: gx.exchange.save(data[[{large!r}]], path).")
    sizes = {axis: data.sizes[axis] for axis in axes}
    head, columns = [], []
    for k, axis in enumerate(axes if len(axes) > 1 else ()):
        if axis not in inside:
            head.append("frame" if axis == "time" else axis)
            columns.append([str(place) for place in np.indices([*sizes.values()])[k].ravel().tolist()])
    counted = len(head)
    for name in inside:
        values, labels = _columns(data, name, sizes)
        unit = data[name].attrs.get("units", "")
        head += [f"{name}{x}{f' ({unit})' if unit and unit != 'scaled' else ''}" for x in labels]
        columns += [_texts(x) for x in values]
    for name in inside:
        told["variables"][name].pop("words", None)
    told |= {"axes": sizes, "inside": inside, "columns": len(head), "counted": counted,
             "beside": {name: (x.astype("u1") if x.dtype.kind == "b" else x).ravel().tolist()
                        for name, x in beside.items() if x.dtype.kind != "O"}}
    lines = [",".join(_quoted(x) if set(x) & set(",\"'\r\n#") else x for x in head), *map(",".join, zip(*columns))]
    comments = [f"# {json.dumps({key: x}, ensure_ascii=False)[1:-1]}" for key, x in told["attributes"].items()]
    told["comments"] = len(comments) + 1
    return "\n".join([*lines, *comments, LAST + structure.text(told)]) + "\n"


def _rows(data):
    """The axes that rows run over: those that all variables share, or all that run over time; else the commonest."""
    arrays = {name: x.dims for name, x in data.variables.items() if x.dims and name not in data.indexes}
    arrays = arrays or {name: x.dims for name, x in data.variables.items() if x.dims}
    if not arrays:
        return []
    if any("time" in dims for dims in arrays.values()):
        arrays = {name: dims for name, dims in arrays.items() if "time" in dims}
    shared = [axis for axis in data.sizes if all(axis in dims for dims in arrays.values())]
    along = [axis for axis in shared if not ACROSS.fullmatch(axis)] or shared
    if not along:
        count = {axis: sum(axis in dims for dims in arrays.values()) for axis in data.sizes}
        along = [max(count, key=count.get)]
    return sorted(along, key=lambda axis: axis == "time")


def _stands(dims, axes, sizes):
    """Whether a variable stands in the table: over its rows, or alike in some of them, where there are any."""
    alike = {*dims} <= {*axes} and all(sizes[axis] for axis in axes)
    return bool(dims) and ({*axes} <= {*dims} or alike)


def _ordered(data, axes):
    """Names of variables: coordinates first, and of them those of the rows."""
    first = [axis for axis in axes if axis in data.variables]
    return list(dict.fromkeys([*first, *map(str, data.coords), *map(str, data.data_vars)]))


def _columns(data, name, sizes):
    """Columns of a variable, and the ends of their names."""
    x = data[name].variable
    own = [axis for axis in x.dims if axis in sizes]
    others = [axis for axis in x.dims if axis not in sizes]
    values = x.transpose(*sorted(own, key=[*sizes].index), *others).values
    places = tuple(slice(None) if axis in own else None for axis in sizes)
    shape = (*sizes.values(), *(data.sizes[axis] for axis in others))
    table = np.broadcast_to(values[places], shape).reshape(math.prod(sizes.values()), math.prod(shape[len(sizes) :]))
    return table.T, _labels(data, others)


def _labels(data, axes):
    """The ends of the names of columns: places along each axis, or the words that are its coordinate."""
    ends = [""]
    for axis in axes:
        words = range(data.sizes[axis])
        if axis in data.coords and data[axis].dtype.kind in "UO" and data[axis].dims == (axis,):
            words = data[axis].values
        ends = [f"{end}_{word}" for end in ends for word in words]
    return ends


def _texts(x):
    if x.dtype.kind in "UO":
        return [_quoted(word) for word in x.tolist()]
    return ["1" if y else "0" for y in x.tolist()] if x.dtype.kind == "b" else [*map(repr, x.tolist())]


def _quoted(word):
    return '"' + word.replace('"', '""') + '"'


# -------------------------------------------------------------------------------------------------------- and back


def read(path: str | Path) -> tuple[dict[str, tuple[list[str], dict, np.ndarray]], list[str], dict]:
    """({variable: (axes, attributes, array)}, coordinates, attributes) of what `csv_text` wrote.

    **Raises** ValueError for a file that is not there, is none or is damaged.
    """
    path, size = regular(path, WHAT)
    if size > LARGEST:
        refuse("path", WHAT, f"{str(path)!r} of {size / 2**30:.3g} GiB")
    try:
        text = path.read_bytes().decode()
        # a file that was sent through Windows
        return _read((text.replace("\r\n", "\n") if text.endswith("\r\n") else text).rstrip("\n"))
    except OSError as error:
        refuse("path", WHAT, f"{str(path)!r} ({error.strerror})")
    except (AttributeError, csv.Error, LookupError, MemoryError, OverflowError, RecursionError, TypeError,
            ValueError) as error:
        refuse("path", WHAT, f"{str(path)!r}, at which reading ended with '{type(error).__name__}: {str(error)[:200]}'",
               "gx.Traces.from_csv and gx.exchange.arrays read columns of any other.")


def _read(text):
    last = text[text.rfind("\n") + 1 :]
    if not last.startswith(LAST):
        raise ValueError(f"its last line is none of {STRUCTURE}: granjax did not write it, or not to the end")
    found = told(last[len(LAST) :])
    for _ in range(found["comments"]):
        text, _, comment = text.rpartition("\n")
        if not comment.startswith("# "):
            raise ValueError(f"{comment[:40]!r} is no comment")
    sizes = found["axes"]
    # a word may hold the end of a line
    rows = list(csv.reader(io.StringIO(text, newline=""), strict=True))[1:]
    if len(rows) != math.prod(sizes.values()) * bool(sizes) or any(len(row) != found["columns"] for row in rows):
        raise ValueError(f"{len(rows)} rows, where {math.prod(sizes.values())} of {found['columns']} fields are said")
    variables, place = {}, found["counted"]
    for name in found["inside"]:
        x = found["variables"][name]
        own = [axis for axis in sizes if axis in x["axes"]]
        others = [(axis, n) for axis, n in zip(x["axes"], x["shape"]) if axis not in sizes]
        width = math.prod(n for _, n in others)
        values = [field for row in rows for field in row[place : place + width]]
        place += width
        array = _array(values, x["type"]).reshape(*sizes.values(), *(n for _, n in others))
        array = array[tuple(slice(None) if axis in own else 0 for axis in sizes)]
        lies = own + [axis for axis, _ in others]
        array = array.transpose([lies.index(axis) for axis in x["axes"]])
        if list(array.shape) != x["shape"]:
            raise ValueError(f"{name} of shape {array.shape}, where {x['shape']} is said")
        variables[name] = x["axes"], listed(x["told"]), np.ascontiguousarray(array)
    for name, x in found["variables"].items():
        if name not in variables:
            words = x.get("words")
            array = _array([*map(repr, found["beside"][name])], x["type"]) if words is None else _array(words, "O")
            variables[name] = x["axes"], listed(x["told"]), array.reshape(x["shape"])
    variables = {name: variables[name] for name in found["variables"]}
    return variables, found["coordinates"], listed(found["attributes"])


def _array(fields, kind):
    """Fields as an array of their type."""
    if kind == "O":
        return np.array([None, *fields], object)[1:]
    kind = np.dtype(kind)
    wrong = next((x for x in fields if not NUMBER.fullmatch(x)), None)
    if wrong is not None or kind.kind not in "biuf":
        raise ValueError(f"{wrong!r} is no number")
    made = np.array([float(x) if kind.kind == "f" else int(x) for x in fields], None if fields else kind)
    with np.errstate(over="ignore"):
        found = made.astype(kind)
    beyond = [k for k in np.flatnonzero(np.isinf(found)) if "inf" not in fields[k]]
    if beyond or kind.kind != "f" and (found != made).any():
        raise ValueError(f"numbers that are none of type {kind}")
    return found
