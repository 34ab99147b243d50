"""Traces from files: columns of a text, as vibrometers and oscilloscopes write them, and arrays by their names."""

import contextlib
import dataclasses
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from .. import reading
from ..checks import is_whole, one_of, parameter, refuse, show
from ..entry import checked
from ..types import Count, Parameter, Scalar
from ..units import SCALED, UnitsOrWords
from .columns import in_si, names_of, refuse_unused, said, unit_of
from .traces import KINDS, Origin, Traces
from .waveforms import MOST_QUIET, Waveform, clock, trigger_time

# the axis and the coordinate that name sites
SITE = "site"
KINDS_OF = {".npz": "npz", ".nc": "netcdf", ".nc4": "netcdf", ".cdf": "netcdf"}
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
      per sensor, the last tenth of them left out, and all but the last 2^24 of a long record. Else unknown.
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
            return Waveform(table.numbers, 0, _named(argument, key, table.names))
        return Waveform(table.numbers, 0, _index(argument, key, table.numbers.shape[1], ", or its name"))

    with _naming(path):
        return _traces(column, (velocity, displacement, force), time, sampling, (units, called), gain, trigger, start,
                       stop, sigma, baseline, where | {"origin": Origin(str(path), table.header, table.remark)})


@checked
def read_arrays(
    path: str | Path, *, velocity: Column | Sequence[Column] | None = None,
    displacement: Column | Sequence[Column] | None = None, force: Column | Sequence[Column] | None = None,
    time: Column | None = None, sampling: Scalar | str | None = None, units: UnitsOrWords = None,
    gain: Parameter | str | None = None, trigger: Scalar | tuple[Any, ...] | None = None,
    start: Scalar | None = None, stop: Scalar | None = None, sigma: Parameter | None = None, baseline: bool = False,
    **where: object,
) -> Traces:
    r"""`Traces` from a file of arrays by name: MATLAB's (any version), NumPy's `.npz` or netCDF, by the file's ending.

    Of a long waveform the window from `start` to `stop` is read, and what a trigger, noise and rising times ask for a
    block at a time, so that memory holds what is kept (at most 2 GiB); MATLAB's versions up to 7 and deflated `.npz`
    are read whole. It is read in a process of its own, so that a damaged one costs a sentence and not the session:
    0.4 s for the first file, milliseconds for those that follow within two minutes, at most 10 s and 1 s for 10 MB.

    **Arguments:** as in `read_csv`, but a column is a variable by its name, "scan.velocity" for a field of a struct; or
    a pair (name, index) for one column of a matrix. A matrix alone is one column per sensor, of a run that was saved
    those of `sites`. Time is its axis of the
    same name as that of `time`, or "time", where the file names axes (netCDF, what `save` wrote), else the longer one.
    `sampling` may be a name too, such as "Fs". One of `time` and `sampling` is needed. Units are read from the
    attribute `units`, or the names of variables, "t_us", "velocity_mm_s".

    **Returns:** `Traces`. **Raises** ValueError, which names the file, for one that cannot be read, a variable that is
    not there or holds no real numbers, and as `read_csv` does. Typical:
    `read_arrays("scan.mat", velocity="data", sites=[2, 5], sampling="Fs", gain=0.125, trigger=1e-3)`; of a run,
    `gx.Traces.from_netcdf("run.nc", velocity="v", sites=[2, 5], time="time")`.
    """
    rate = sampling if isinstance(sampling, str) else None
    keys = _keys(velocity, displacement, force, time, rate, *(trigger[:1] if isinstance(trigger, tuple) else ()))
    ending = os.path.splitext(os.fsdecode(path))[1].lower() if isinstance(path, (str, os.PathLike)) else ""
    names = [x for x in keys if isinstance(x, str)]
    columns, others = reading.columns(KINDS_OF.get(ending, "matlab"), path, [*names, SITE])
    others |= {name: x.word for name, x in columns.items() if x.word}
    stamped = columns[time].axes[:1] if isinstance(time, str) and time in columns else ()

    def column(argument, key):
        name, index = key if isinstance(key, tuple) and len(key) == 2 else (key, None)
        if not isinstance(name, str):
            refuse(argument, "the name of a variable, or (name, column)", repr(key))
        if name in others:
            refuse(argument, "a variable of real numbers", f"{name!r}, which is {others[name] or 'none'}")
        if name not in columns:
            one_of(argument, name, sorted(columns.keys() - others.keys()))
        found = _waveform(argument, name, columns[name], stamped)
        if index is not None:
            return found._replace(index=_index(argument, index, found.width))
        if argument in KINDS and SITE in columns[name].axes and SITE in columns:
            return found._replace(index=_of_sites(columns[SITE].array, where.get("sites"), found))
        return found

    def called(key):
        name = key[0] if isinstance(key, tuple) else key
        unit = columns[name].units
        return [f"[{unit}]"] * (unit not in ("", SCALED)) + [name.rpartition(".")[2]]

    with _naming(path):
        if rate is not None:
            found = column("sampling", rate)
            if found.length * found.width != 1:
                refuse("sampling", "one number", f"{rate} of shape {found.shape}")
            sampling = found.rows(0, 1).item()
        return _traces(column, (velocity, displacement, force), time, sampling, (units, called), gain, trigger, start,
                       stop, sigma, baseline, where | {"origin": Origin(str(path))})


def _waveform(argument, name, column, stamped):
    """An array of a file as columns of samples."""
    shape = column.array.shape
    if not 1 <= len(shape) <= 2 or 0 in shape:
        refuse(argument, "a vector or a matrix", f"{name} of shape {shape}")
    along = [axis for axis in (*stamped, "time") if axis in column.axes]
    axis = column.axes.index(along[0]) if along else int(len(shape) == 2 and shape[0] < shape[1])
    # a vector of MATLAB's is a matrix
    single = len(shape) == 2 and shape[1 - axis] == 1
    return Waveform(column.array, axis, 0 if single else None)


def _of_sites(labels, sites, found):
    """Columns of the sites that are asked for, in a matrix of all sites that a file has; as it is where none are."""
    labels = np.ravel(labels[(slice(None),) * len(labels.shape)])
    asked = np.asarray([] if sites is None else sites)
    if asked.ndim > 1 or asked.dtype.kind not in "iu" or found.width != labels.size or found.index is not None:
        return found.index
    places = []
    for site in np.atleast_1d(asked):
        place = [labels.size + site] if -labels.size <= site < 0 else np.flatnonzero(labels == site)
        if len(place) != 1:
            refuse("sites", f"sites of the file, {show(labels)}", f"{site}")
        places.append(int(place[0]))
    return tuple(places)


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
    waves = [column(kind, key) for key in keys]
    count = waves[0].length if waves else 0
    if len({wave.length for wave in waves}) != 1:
        refuse(kind, "one column or more, equally long", f"lengths {[wave.length for wave in waves]}")
    if count < 2:
        refuse(kind, "at least two samples", f"{count}")
    stamps = column("time", time) if sampling is None and time is not None else None
    times, reads = clock(stamps, sampling, count, units, called(time) if stamps is not None else [])
    own = {str(key): unit_of(kind, kind, called(key), units, gain is not None) for key in keys}
    refuse_unused(units, [*reads.values(), *own.values()])
    where["origin"] = dataclasses.replace(where["origin"], units=said(reads | own))
    each = [own[str(key)] for key, wave in zip(keys, waves) for _ in range(wave.width)]
    left = _left(gain, len(each))

    def signal(first, last):
        return _in_si(kind, np.column_stack([wave.rows(first, last) for wave in waves]), each, gain)

    signal(0, 1)
    quiet, asked = None, {"trigger": trigger, "start": start, "stop": stop}
    zero = 0.0
    if trigger is not None:
        pair = isinstance(trigger, (tuple, list)) and len(trigger) == 2
        zero = trigger_time(trigger, column("trigger", trigger[0]) if pair else None, times)
        before = times.below(zero)
        start = 0.0 if start is None else start
        if before >= LEAST_NOISE and (baseline or sigma is None):
            quiet = signal(max(0, int(QUIET * before) - MOST_QUIET), int(QUIET * before))
    if baseline:
        if quiet is None:
            refuse("baseline", f"at least {LEAST_NOISE} samples before a trigger", "fewer", "Give trigger=.")
        if not np.isfinite(quiet).any(axis=0).all():
            refuse("baseline", "samples of every sensor before the trigger", "none of one")
    if sigma is None and quiet is not None:
        known = np.isfinite(quiet).sum(axis=0) > 1
        with np.errstate(over="ignore"):
            sigma = np.where(known, np.nanstd(np.where(known, quiet, 0.0), axis=0, ddof=1), np.nan)
        if not (sigma > 0).all():
            refuse("sigma", "noise before the trigger", f"standard deviations {show(sigma)}", "Give sigma=.")
    window = -np.inf if start is None else start, np.inf if stop is None else stop
    first, last = times.below(window[0], zero), times.below(window[1], zero, reached=True)
    if last - first < 2:
        given = ", ".join(name for name, x in asked.items() if x is not None)
        ends = times.at(0, 1)[0] - zero, times.at(count - 1, count)[0] - zero
        refuse(given, f"a window with two samples, within {ends[0]:g} ... {ends[1]:g} s" + (
            " from the trigger on" if trigger is not None else ""), f"{window[0]:g} ... {window[1]:g} s")
    data = signal(first, last)
    data = data - np.nanmean(quiet, axis=0) if baseline else data
    if np.ndim(sigma) == 2 and len(sigma) == count:
        sigma = np.asarray(sigma)[first:last]
    return Traces(times.at(first, last) - zero, sigma=sigma, gain=left, **{kind: data}, **where)


def _left(gain, count):
    """The gain that is left to a fit, where the numbers of the file are turned into SI by one."""
    if gain is None or isinstance(gain, str):
        return 1.0 if gain is None else gain
    if np.asarray(parameter("gain", gain)).shape not in ((), (count,)):
        refuse("gain", f"a number, or one for each of {count} sensors", f"shape {np.shape(gain)}")
    return 1.0


def _in_si(kind, data, reads, gain):
    """The data in SI, where the sensors' units and the gain have been put in."""
    each = gain if np.ndim(gain) == 1 else [gain] * len(reads)
    done = [in_si(kind, data[:, k], *both) for k, both in enumerate(zip(reads, each))]
    data = np.column_stack([x for x, _ in done])
    factors = [1.0 if isinstance(x, str) else x for _, x in done]
    with np.errstate(over="ignore"):
        scaled = data * np.asarray(factors)
    if np.isinf(scaled).any():
        refuse("gain", "numbers that keep the data finite", show(np.asarray(factors)))
    return scaled


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
