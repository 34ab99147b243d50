"""Traces from files: comma-separated values and MATLAB's, as vibrometers and oscilloscopes write them."""

import contextlib
import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from .. import reading
from ..checks import is_whole, one_of, parameter, positive, refuse, show
from ..entry import checked
from ..types import Count, Parameter, Scalar
from ..units import UnitsOrWords
from .columns import in_si, names_of, refuse_unused, said, unit_of
from .traces import KINDS, Origin, Traces

# by index, by name, or both
Column: TypeAlias = int | str | tuple[str, int]
# samples before the trigger from which on their standard deviation is taken, and the share of them that counts:
# a channel that triggers on its own signal rises before it reaches the level
LEAST_NOISE, QUIET = 16, 0.9


@checked
def read_csv(
    path: str | Path, *, velocity: Column | Sequence[Column] | None = None,
    displacement: Column | Sequence[Column] | None = None, force: Column | Sequence[Column] | None = None,
    time: Column = 0, sampling: Scalar | str | None = None, units: UnitsOrWords = None,
    gain: Parameter | str | None = None, trigger: Scalar | tuple[Any, ...] | None = None,
    start: Scalar | None = None, stop: Scalar | None = None, sigma: Parameter | None = None, baseline: bool = False,
    delimiter: str | None = None, decimal: str | None = None, header: Count | None = None, **where: object,
) -> Traces:
    r"""`Traces` from a text file of columns: UTF-8, UTF-16 with its mark, or Latin-1, of at most 0.5 GiB.

    Delimiter (tab, semicolon, comma, blanks) and decimal mark (point, comma) are those under which everything below
    the header is one table of numbers, with the columns that are asked for and times that rise. A file that can be
    read in two ways is refused: `0,12` in every line is one column or two. The header ends at the first line of
    numbers; comments (#, %, //) are passed over. Nothing that may be a sample is: rows of unequal length, words among
    numbers, a line between names and first row that has something like a number where one is expected, a time out of
    step with all that follow, and a first row of column numbers (0,1,2 without names above; two columns in step with
    the times are a row) are refused, naming the line. An empty field, NaN, infinity and an instrument's word or number
    for what is beyond its range (OVER, 9.9E37) are samples that are missing. `origin` of the traces keeps the header's
    lines and says what was passed over or is missing.

    **Arguments:**

    - `velocity`, `displacement` or `force`, exactly one: a column, or a list of them, one per sensor; by index from 0,
      or by name in the header, without regard to case and to units in brackets: "velocity" finds "Velocity [m/s]".
    - `time`: the column of times. `sampling`: samples per second [Hz] instead, where there is no such column, or it is
      written with so few digits that times do not rise.
    - `units`: what columns are in, words such as `"us"` or `("us", "mm/s")`, each for the columns of its dimension.
      `None` reads them from the header, "Time (us)", "Bead 3 [mm/s]", "t/ms", "velocity_mm_s" or a line of units, and
      takes SI where that says nothing; what it may mean in two ways is refused, and words in brackets that are neither
      a unit nor a known remark such as "(filtered)". All is turned into SI; `origin` says
      what was read.
    - `gain`: from the file to SI, a number or one per sensor: 0.125 (m/s)/V makes 0.125. Of a column in V it has to be
      given. A name of a parameter keeps the data as they are, and the gain is fitted.
    - `trigger`: a time [s], or a pair (column, level in the file's units), whose first crossing, in either
      direction and interpolated, is the trigger. Times are measured from it.
    - `start`, `stop`: first and last time that is kept [s], from the trigger on; `start=None` is 0 with a trigger, else
      everything.
    - `sigma`: as in `Traces`, in SI. `None` with a trigger and at least 16 samples before it: their standard deviation,
      per sensor, the last tenth of them left out. Else unknown.
    - `baseline`: subtract the mean of the same samples, per sensor: a recorder's direct offset. Needs a trigger.
    - `delimiter` of the columns, `decimal` mark, lines of `header`: what the file does not tell. Where `header` is
      given, words in columns that are not asked for, by index, do not matter.
    - `where`: `sites` or `contacts`, and whatever else `Traces` takes (`bond`, `offset`, `field`, `component`).

    **Returns:** `Traces`. **Raises** ValueError, which names the file, for one that is not there or no such table, a
    column that is not there, a level that is never crossed, a window that holds fewer than two samples, and as `Traces`
    does. Typical: `read_csv("scan.csv", velocity="Vib 1", sites=4, gain=0.125, trigger=("Trig", 2.5), stop=3e-3)`.
    """
    times = None if sampling is not None else time
    keys = _keys(velocity, displacement, force, times, *(trigger[:1] if isinstance(trigger, tuple) else ()))
    table = reading.table(path, delimiter=delimiter, decimal=decimal, header=header, asked=keys,
                          time=times if times in keys else None)

    def called(key):
        k = _named("time", key, table.names) if isinstance(key, str) else key
        return names_of(k, table.names)

    def column(argument, key):
        if isinstance(key, str):
            return table.numbers[:, _named(argument, key, table.names)]
        return table.numbers[:, _index(argument, key, table.numbers.shape[1], ", or its name")]

    with _naming(path):
        return _traces(column, (velocity, displacement, force), time, sampling, (units, called), gain, trigger, start,
                       stop, sigma, baseline, where | {"origin": Origin(str(path), table.header, table.remark)})


@checked
def read_mat(
    path: str | Path, *, velocity: Column | Sequence[Column] | None = None,
    displacement: Column | Sequence[Column] | None = None, force: Column | Sequence[Column] | None = None,
    time: Column | None = None, sampling: Scalar | str | None = None, units: UnitsOrWords = None,
    gain: Parameter | str | None = None, trigger: Scalar | tuple[Any, ...] | None = None,
    start: Scalar | None = None, stop: Scalar | None = None, sigma: Parameter | None = None, baseline: bool = False,
    **where: object,
) -> Traces:
    r"""`Traces` from a MATLAB file, up to version 7 (SciPy) or 7.3 (h5py), with at most 2 GiB of numbers.

    It is read in a process of its own, so that a damaged one costs a sentence and not the session: 0.4 s for the first
    file, milliseconds for those that follow within two minutes, at most 10 s and 1 s for 10 MB.

    **Arguments:** as in `read_csv`, but a column is a variable by its name, "scan.velocity" for a field of a struct; or
    a pair (name, index) for one column of a matrix. A matrix alone is one column per sensor; its longer axis is time.
    `sampling` may be a name too, such as "Fs". One of `time` and `sampling` is needed. Units are read from the names of
    variables, "t_us", "velocity_mm_s".

    **Returns:** `Traces`. **Raises** ValueError, which names the file, for one that cannot be read, a variable that is
    not there or holds no real numbers, and as `read_csv` does. Typical:
    `read_mat("scan.mat", velocity="data", sites=[2, 5], sampling="Fs", gain=0.125, trigger=1e-3)`.
    """
    rate = sampling if isinstance(sampling, str) else None
    keys = _keys(velocity, displacement, force, time, rate, *(trigger[:1] if isinstance(trigger, tuple) else ()))
    variables, others = reading.arrays("matlab", path, [key for key in keys if isinstance(key, str)])
    words = {"c": "complex", "O": "char", "U": "char"}
    others |= {name: words[x.dtype.kind] for name, x in variables.items() if x.dtype.kind in words}
    variables = {name: np.asarray(x, float) for name, x in variables.items() if name not in others}

    def column(argument, key):
        name, index = key if isinstance(key, tuple) and len(key) == 2 else (key, None)
        if not isinstance(name, str):
            refuse(argument, "the name of a variable, or (name, column)", repr(key))
        if name not in variables:
            if name in others:
                refuse(argument, "a variable of real numbers", f"{name!r}, which is {others[name] or 'none'}")
            one_of(argument, name, sorted({*variables, *(other for other, kind in others.items() if not kind)}))
        x = variables[name]
        x = x[:, None] if x.ndim == 1 else x
        if x.ndim != 2 or not x.size:
            refuse(argument, "a vector or a matrix", f"{name} of shape {x.shape}")
        x = x if x.shape[0] >= x.shape[1] else x.T
        if index is None:
            return x[:, 0] if x.shape[1] == 1 else x
        return x[:, _index(argument, index, x.shape[1])]

    def called(key):
        return [(key[0] if isinstance(key, tuple) else key).rpartition(".")[2]]

    with _naming(path):
        if rate is not None:
            sampling = column("sampling", rate)
            if sampling.size != 1:
                refuse("sampling", "one number", f"{rate} of shape {sampling.shape}")
            sampling = sampling.item()
        return _traces(column, (velocity, displacement, force), time, sampling, (units, called), gain, trigger, start,
                       stop, sigma, baseline, where | {"origin": Origin(str(path))})


def _keys(*asked):
    """What is asked for, without what is no name or index: that is refused where it is used."""
    keys = [key for keys in asked for key in (keys if isinstance(keys, list) else [keys])]
    keys = [key[0] if isinstance(key, tuple) and len(key) == 2 else key for key in keys]
    return tuple(k for k in keys if isinstance(k, str) or is_whole(k))


@contextlib.contextmanager
def _naming(path):
    """Refusals that say which file it was."""
    try:
        yield
    except ValueError as error:
        raise ValueError(f"{error} The file is {str(path)!r}.") from None


def _traces(column, data, time, sampling, units, gain, trigger, start, stop, sigma, baseline, where):
    """The steps that both formats share."""
    given = [(kind, keys) for kind, keys in zip(KINDS, data) if keys is not None]
    if len(given) != 1:
        refuse("data", "one of velocity=, displacement=, force=", f"{[kind for kind, _ in given] or 'none'}",
               "Read several kinds one by one and give fit a list.")
    ((kind, keys),) = given
    units, called = units
    keys = keys if isinstance(keys, list) else [keys]
    data = [column(kind, key) for key in keys]
    if len({len(x) for x in data}) != 1:
        refuse(kind, "one column or more, equally long", f"lengths {[len(x) for x in data]}")
    data = np.column_stack(data)
    # an infinite sample is beyond the recorder's range: nothing is known of it
    data = np.where(np.isfinite(data), data, np.nan)
    if len(data) < 2:
        refuse(kind, "at least two samples", f"{len(data)}")
    times, reads = _times(column, time, sampling, len(data), units, called)
    own = {str(key): unit_of(kind, kind, called(key), units, gain is not None) for key in keys}
    refuse_unused(units, [*reads.values(), *own.values()])
    data, gain = _in_si(kind, data, [own[str(key)] for key in keys], gain)
    where["origin"] = dataclasses.replace(where["origin"], units=said(reads | own))
    if not isinstance(gain, str):
        factor = np.asarray(parameter("gain", gain))
        if factor.shape not in ((), (data.shape[1],)):
            refuse("gain", f"a number, or one for each of {data.shape[1]} sensors", f"shape {factor.shape}")
        with np.errstate(over="ignore"):
            scaled, gain = data * factor, 1.0
        if np.isinf(scaled).any():
            refuse("gain", "numbers that keep the data finite", show(factor))
        data = scaled
    quiet, asked = None, {"trigger": trigger, "start": start, "stop": stop}
    if trigger is not None:
        zero = _trigger(column, trigger, times)
        before = np.searchsorted(times, zero)
        times, start = times - zero, 0.0 if start is None else start
        quiet = data[: int(QUIET * before)] if before >= LEAST_NOISE else None
    if baseline:
        if quiet is None:
            refuse("baseline", f"at least {LEAST_NOISE} samples before a trigger", "fewer", "Give trigger=.")
        if not np.isfinite(quiet).any(axis=0).all():
            refuse("baseline", "samples of every sensor before the trigger", "none of one")
        data = data - np.nanmean(quiet, axis=0)
    if sigma is None and quiet is not None:
        known = np.isfinite(quiet).sum(axis=0) > 1
        sigma = np.where(known, np.nanstd(np.where(known, quiet, 0.0), axis=0, ddof=1), np.nan)
        if not (sigma > 0).all():
            refuse("sigma", "noise before the trigger", f"standard deviations {show(sigma)}", "Give sigma=.")
    window = -np.inf if start is None else start, np.inf if stop is None else stop
    kept = (times >= window[0]) & (times <= window[1])
    if kept.sum() < 2:
        given = ", ".join(name for name, x in asked.items() if x is not None)
        refuse(given, f"a window with two samples, within {times[0]:g} ... {times[-1]:g} s" + (
            " from the trigger on" if trigger is not None else ""), f"{window[0]:g} ... {window[1]:g} s")
    if np.ndim(sigma) == 2 and len(sigma) == len(data):
        sigma = np.asarray(sigma)[kept]
    return Traces(times[kept], sigma=sigma, gain=gain, **{kind: data[kept]}, **where)


def _in_si(kind, data, reads, gain):
    """The data and the gain that is left, where the sensors' units have been put in."""
    widths = data.shape[1] // len(reads)  # a matrix is several sensors of one name
    each = [read for read in reads for _ in range(widths)]
    gains = gain if np.ndim(gain) == 1 and len(gain) == len(each) else [gain] * len(each)
    done = [in_si(kind, data[:, k], *both) for k, both in enumerate(zip(each, gains))]
    left = gain if gain is not None else 1.0
    return np.column_stack([x for x, _ in done]), left


def _times(column, time, sampling, count, units, called):
    """The times [s], and how they were read."""
    if sampling is not None:
        return np.arange(count) / float(positive("sampling", sampling, "It is in samples per second.")), {}
    if time is None:
        refuse("time", "where the times are, or sampling=", "None")
    times = column("time", time)
    if times.shape != (count,):
        refuse("time", f"{count} times", f"shape {times.shape}")
    if not np.isfinite(times).all():
        refuse("time", "a time in every row", f"none in {np.count_nonzero(~np.isfinite(times))} of {count}",
               "Give sampling= where rows are equally spaced.")
    if not (np.diff(times) > 0).all():
        refuse("time", "times that rise", show(times), "Give sampling= where too few digits were written.")
    read = unit_of("time", "time", called(time), units)
    return times * read.unit.size, {"time": read}


def _trigger(column, trigger, times):
    """The time of the trigger."""
    pair = isinstance(trigger, (tuple, list))
    time = parameter("trigger", trigger[-1] if pair and trigger else trigger)
    if time.ndim or pair and len(trigger) != 2:
        refuse("trigger", "a time, or a pair (column, level)", repr(trigger))
    if not pair:
        return float(time)
    x, level = column("trigger", trigger[0]), float(time)
    if x.shape != times.shape:
        refuse("trigger", "one channel", f"shape {x.shape}")
    known = np.flatnonzero(np.isfinite(x))
    above = x[known] > level
    if not known.size or (above == above[0]).all():
        span = f", from {x[known].min():g} to {x[known].max():g}" if known.size else ""
        refuse("trigger", f"a level that {trigger[0]!r} crosses{span}", f"{level:g}")
    k = int(np.argmax(above != above[0]))
    last, first = known[k - 1], known[k]
    part = (level - x[last]) / (x[first] - x[last])
    return float(times[last] + part * (times[first] - times[last]))


def _index(argument, key, count, otherwise=""):
    """An index of one of so many columns."""
    if not is_whole(key) or not 0 <= key < count:
        refuse(argument, f"a column from 0 to {count - 1}{otherwise}", repr(key))
    return key


def _named(argument, key, names):
    """Index of the column that a line of the header names."""
    found = reading.named(key, names)
    if len(found) > 1:
        refuse(argument, "the name of one column", f"{key!r}, of {len(found)} columns", "Give its index.")
    if not names:
        refuse(argument, "an index, for the file has no line of names", repr(key))
    if not found:
        one_of(argument, key, tuple(dict.fromkeys(name for line in names for name in line)))
    return found[0]
