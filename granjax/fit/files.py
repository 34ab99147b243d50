"""Traces from files: comma-separated values and MATLAB's, as vibrometers and oscilloscopes write them."""

from collections.abc import Sequence
from pathlib import Path
from typing import TypeAlias

import numpy as np

from ..checks import one_of, parameter, positive, refuse, show
from ..types import Parameter, Scalar
from .traces import KINDS, Traces

# by index, by name, or both
Column: TypeAlias = int | str | tuple[str, int]
COMMENTS = ("#", "%", "//")
DELIMITERS = ("\t", ";", ",", None)
# samples before the trigger from which on their standard deviation is taken, and the share of them that counts:
# a channel that triggers on its own signal rises before it reaches the level
LEAST_NOISE, QUIET = 16, 0.9


def read_csv(
    path: str | Path, *, velocity: Column | Sequence[Column] | None = None,
    displacement: Column | Sequence[Column] | None = None, force: Column | Sequence[Column] | None = None,
    time: Column = 0, sampling: Scalar | str | None = None, gain: Parameter | str = 1.0,
    trigger: Scalar | tuple[Column, Scalar] | None = None, start: Scalar | None = None, stop: Scalar | None = None,
    sigma: Parameter | None = None, baseline: bool = False, delimiter: str | None = None, **where: object,
) -> Traces:
    r"""`Traces` from a text file of columns.

    Header lines, comments (#, %, //), the delimiter (tab, semicolon, comma, blanks) and a decimal comma are recognised:
    the last line tells how columns are written, the first line of numbers like it is where they begin. An empty field
    is a sample that is missing.

    **Arguments:**

    - `velocity`, `displacement` or `force`, exactly one: a column, or a list of them, one per sensor; by index from 0,
      or by name in the header, without regard to case and to units in brackets: "velocity" finds "Velocity [m/s]".
    - `time`: the column of times [s]. `sampling`: samples per second [Hz] instead, where there is no such column, it is
      not in seconds, or it is written with so few digits that times do not rise.
    - `gain`: from the file to SI, a number or one per sensor: 0.125 (m/s)/V makes 0.125. A name of a parameter keeps
      the data as they are, and the gain is fitted.
    - `trigger`: a time in the file [s], or a pair (column, level in the file's units), whose first crossing, in either
      direction and interpolated, is the trigger. Times are measured from it.
    - `start`, `stop`: first and last time that is kept [s], from the trigger on; `start=None` is 0 with a trigger, else
      everything.
    - `sigma`: as in `Traces`, in SI. `None` with a trigger and at least 16 samples before it: their standard deviation,
      per sensor, the last tenth of them left out. Else unknown.
    - `baseline`: subtract the mean of the same samples, per sensor: a recorder's direct offset. Needs a trigger.
    - `delimiter`: of the columns, where it is not recognised.
    - `where`: `sites` or `contacts`, and whatever else `Traces` takes (`bond`, `offset`, `field`, `component`).

    **Returns:** `Traces`. **Raises** ValueError for a column that is not there, a file without numbers, a level that is
    never crossed, a window that holds fewer than two samples, and as `Traces` does; OSError for a file that is not
    there. Typical: `read_csv("scan.csv", velocity="Vib 1", sites=4, gain=0.125, trigger=("Trig", 2.5), stop=3e-3)`.
    """
    names, table = _table(Path(path), delimiter)

    def column(argument, key):
        if isinstance(key, str):
            return table[:, _named(argument, key, names)]
        if isinstance(key, bool) or not isinstance(key, (int, np.integer)) or not 0 <= key < table.shape[1]:
            refuse(argument, f"a column from 0 to {table.shape[1] - 1}, or its name", repr(key))
        return table[:, key]

    return _traces(column, (velocity, displacement, force), time, sampling, gain, trigger, start, stop, sigma, baseline,
                   where)


def read_mat(
    path: str | Path, *, velocity: Column | Sequence[Column] | None = None,
    displacement: Column | Sequence[Column] | None = None, force: Column | Sequence[Column] | None = None,
    time: Column | None = None, sampling: Scalar | str | None = None, gain: Parameter | str = 1.0,
    trigger: Scalar | tuple[Column, Scalar] | None = None, start: Scalar | None = None, stop: Scalar | None = None,
    sigma: Parameter | None = None, baseline: bool = False, **where: object,
) -> Traces:
    r"""`Traces` from a MATLAB file, up to version 7 (SciPy) or 7.3 (h5py).

    **Arguments:** as in `read_csv`, but a column is a variable by its name, "scan.velocity" for a field of a struct; or
    a pair (name, index) for one column of a matrix. A matrix alone is one column per sensor; its longer axis is time.
    `sampling` may be a name too, such as "Fs". One of `time` and `sampling` is needed.

    **Returns:** `Traces`. **Raises** ValueError for a variable that is not there or holds no numbers, and as `read_csv`
    does. Typical: `read_mat("scan.mat", velocity="data", sites=[2, 5], sampling="Fs", gain=0.125, trigger=1e-3)`.
    """
    variables = _variables(str(path))

    def column(argument, key):
        name, index = key if isinstance(key, tuple) and len(key) == 2 else (key, None)
        if not isinstance(name, str):
            refuse(argument, "the name of a variable, or (name, column)", repr(key))
        x = variables[one_of(argument, name, tuple(variables))]
        if x.ndim != 2:
            refuse(argument, "a vector or a matrix", f"{name} of shape {x.shape}")
        x = x if x.shape[0] >= x.shape[1] else x.T
        if index is None:
            return x[:, 0] if x.shape[1] == 1 else x
        if index not in range(x.shape[1]):
            refuse(argument, f"a column from 0 to {x.shape[1] - 1}", repr(index))
        return x[:, index]

    if isinstance(sampling, str):
        sampling = column("sampling", sampling)[0]
    return _traces(column, (velocity, displacement, force), time, sampling, gain, trigger, start, stop, sigma, baseline,
                   where)


def _traces(column, data, time, sampling, gain, trigger, start, stop, sigma, baseline, where):
    """The steps that both formats share."""
    given = [(kind, keys) for kind, keys in zip(KINDS, data) if keys is not None]
    if len(given) != 1:
        refuse("data", "one of velocity=, displacement=, force=", f"{[kind for kind, _ in given] or 'none'}",
               "Read several kinds one by one and give fit a list.")
    ((kind, keys),) = given
    data = np.column_stack([column(kind, key) for key in (keys if isinstance(keys, list) else [keys])])
    times = _times(column, time, sampling, len(data))
    if not isinstance(gain, str):
        factor = np.asarray(parameter("gain", gain))
        if factor.shape not in ((), (data.shape[1],)):
            refuse("gain", f"a number, or one for each of {data.shape[1]} sensors", f"shape {factor.shape}")
        data, gain = data * factor, 1.0
    quiet = None
    if trigger is not None:
        zero = _trigger(column, trigger, times)
        before = np.searchsorted(times, zero)
        times, start = times - zero, 0.0 if start is None else start
        quiet = data[: int(QUIET * before)] if before >= LEAST_NOISE else None
    if baseline:
        if quiet is None:
            refuse("baseline", f"at least {LEAST_NOISE} samples before a trigger", "fewer", "Give trigger=.")
        data = data - np.nanmean(quiet, axis=0)
    if sigma is None and quiet is not None:
        sigma = np.nanstd(quiet, axis=0, ddof=1)
        if not (sigma > 0).all():
            refuse("sigma", "noise before the trigger", f"standard deviations {show(sigma)}", "Give sigma=.")
    kept = (times >= (-np.inf if start is None else start)) & (times <= (np.inf if stop is None else stop))
    if kept.sum() < 2:
        refuse("start, stop", f"a window within {times[0]:g} ... {times[-1]:g} s", f"{start} ... {stop}")
    if np.ndim(sigma) == 2 and len(sigma) == len(data):
        sigma = np.asarray(sigma)[kept]
    return Traces(times[kept], sigma=sigma, gain=gain, **{kind: data[kept]}, **where)


def _times(column, time, sampling, count):
    if sampling is not None:
        return np.arange(count) / float(positive("sampling", sampling, "It is in samples per second."))
    if time is None:
        refuse("time", "where the times are, or sampling=", "None")
    times = column("time", time)
    if times.shape != (count,):
        refuse("time", f"{count} times", f"shape {times.shape}")
    if not (np.diff(times) > 0).all():
        refuse("time", "times that rise", show(times), "Give sampling= where too few digits were written.")
    return times


def _trigger(column, trigger, times):
    """The time of the trigger."""
    if not isinstance(trigger, (tuple, list)):
        zero = parameter("trigger", trigger)
        if zero.ndim:
            refuse("trigger", "a time, or a pair (column, level)", repr(trigger))
        return float(zero)
    if len(trigger) != 2:
        refuse("trigger", "a time, or a pair (column, level)", repr(trigger))
    x, level = column("trigger", trigger[0]), float(parameter("trigger", trigger[1]))
    if x.shape != times.shape:
        refuse("trigger", "one channel", f"shape {x.shape}")
    above = x > level
    if (above == above[0]).all():
        refuse("trigger", f"a level that {trigger[0]!r} crosses, from {np.nanmin(x):g} to {np.nanmax(x):g}",
               f"{level:g}")
    k = int(np.argmax(above != above[0]))
    part = (level - x[k - 1]) / (x[k] - x[k - 1])
    return float(times[k - 1] + part * (times[k] - times[k - 1]))


# ----------------------------------------------------------------------------------------------------------- text files


def _table(path, delimiter):
    """The header's lines that have as many fields as there are columns, and the numbers (T, columns)."""
    lines = path.read_text(encoding="utf-8-sig", errors="replace").splitlines()
    lines = [line for line in lines if line.strip()]
    last = next((line for line in reversed(lines) if not line.lstrip().startswith(COMMENTS)), "")
    delimiter, comma = _written(last, delimiter)
    count = len(_fields(last, delimiter))
    first = next((k for k, line in enumerate(lines) if _is_row(line, delimiter, comma, count)), None)
    if first is None:
        refuse("path", "a file of numbers in columns", f"{path.name} that ends with {last[:60]!r}",
               "Give delimiter= where it is another than tab, semicolon, comma or blanks.")
    names = [_fields(line.lstrip("".join(COMMENTS) + " "), delimiter) for line in lines[:first]]
    rows = [line for line in lines[first:] if not line.lstrip().startswith(COMMENTS)]
    bad = next((row for row in rows if not _is_row(row, delimiter, comma, count)), None)
    if bad is not None:
        refuse("path", f"{count} numbers in every line after the header", repr(bad[:60]))
    rows = [row.replace('"', "").replace("'", "") for row in rows]
    rows = [row.replace(",", ".") for row in rows] if comma else rows
    return [line for line in names if len(line) == count], np.genfromtxt(rows, delimiter=delimiter, ndmin=2)


def _written(line, delimiter):
    """The delimiter of a line of numbers, and whether its decimals follow a comma."""
    for sign in DELIMITERS if delimiter is None else (delimiter,):
        for comma in (False, True):
            fields = _fields(line, sign)
            if not (comma and sign == ",") and any(fields) and all(_is_number(field, comma) for field in fields):
                if sign is None or sign in line:
                    return sign, comma
    return delimiter, False


def _fields(line, delimiter):
    return [field.strip().strip('"') for field in line.strip(" \r\n").split(delimiter)]


def _is_number(field, comma):
    try:
        float(field.replace(",", ".") if comma else field or "nan")
    except ValueError:
        return field == ""
    return True


def _is_row(line, delimiter, comma, count):
    fields = _fields(line, delimiter)
    return len(fields) == count and any(fields) and all(_is_number(field, comma) for field in fields)


def _named(argument, key, names):
    """Index of the column that a line of the header names."""
    for plain in (str.strip, _plain):
        for line in reversed(names):
            found = [k for k, name in enumerate(line) if plain(name) == plain(key)]
            if len(found) > 1:
                refuse(argument, "the name of one column", f"{key!r}, of {len(found)} columns", "Give its index.")
            if found:
                return found[0]
    if not names:
        refuse(argument, "an index, for the file has no line of names", repr(key))
    one_of(argument, key, tuple(dict.fromkeys(name for line in names for name in line)))


def _plain(name):
    for bracket in "([":
        name = name.split(bracket)[0]
    return name.strip().lower()


# ------------------------------------------------------------------------------------------------------- MATLAB's files


def _variables(path):
    """Every variable and field of a struct that holds numbers, as arrays shaped as in MATLAB."""
    import h5py
    from scipy.io import loadmat

    found = {}
    if h5py.is_hdf5(path):

        def visit(name, item):
            if isinstance(item, h5py.Dataset) and item.dtype.kind in "fiu":
                # MATLAB counts columns first
                found[name.replace("/", ".")] = np.asarray(item[()], float).T

        with h5py.File(path) as file:
            file.visititems(visit)
        return found

    def add(name, x):
        if x.dtype.names:
            for field in x.dtype.names if x.size == 1 else ():
                add(f"{name}.{field}", x[field].item())
        elif x.dtype.kind in "fiu":
            found[name] = np.asarray(x, float)

    for name, x in loadmat(path).items():
        if not name.startswith("__") and isinstance(x, np.ndarray):
            add(name, x)
    return found
