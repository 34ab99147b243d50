"""Waveforms in files, of which a window is kept: samples are read a block at a time, however many there are."""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from ..checks import parameter, positive, refuse, show
from ..types import Count
from ..units import UnitsOrWords
from .columns import Read, unit_of

# samples that are looked at together, and most of those before a trigger of which the noise is taken
BLOCK, MOST_QUIET = 2**20, 2**24


class Waveform(NamedTuple):
    """Columns of a file: an array, in memory or in the file, its axis of samples, which columns (`None`: all)."""

    array: Any
    axis: int = 0
    index: int | tuple[int, ...] | None = None

    @property
    def length(self) -> int:
        """How many samples."""
        return self.array.shape[self.axis]

    @property
    def shape(self) -> tuple[int, ...]:
        """As a vector, or a matrix of columns."""
        return (self.length,) if self.width == 1 else (self.length, self.width)

    @property
    def width(self) -> int:
        """How many columns."""
        if isinstance(self.index, tuple):
            return len(self.index)
        return 1 if self.index is not None or len(self.array.shape) == 1 else self.array.shape[1 - self.axis]

    def rows(self, start: int, stop: int) -> np.ndarray:
        """Samples from `start` to `stop`, (samples, columns); what is beyond a recorder's range is not known."""
        if start >= stop:
            return np.zeros((0, self.width))
        rows, columns = slice(start, stop), slice(None) if self.index is None else self.index
        if isinstance(columns, tuple):
            # a file gives its columns once and in order
            columns, order = np.unique(columns, return_inverse=True)
        key = rows if len(self.array.shape) == 1 else (rows, columns) if self.axis == 0 else (columns, rows)
        found = np.asarray(self.array[key], float)
        found = found.T if found.ndim == 2 and self.axis else found
        found = found[:, order] if isinstance(self.index, tuple) else found
        return np.where(np.isfinite(found), found, np.nan).reshape(stop - start, self.width)

    def blocks(self) -> Iterator[tuple[int, np.ndarray]]:
        """Where each block of samples begins, and the first column of it."""
        for start in range(0, self.length, BLOCK):
            yield start, self.rows(start, min(start + BLOCK, self.length))[:, 0]


class Clock(NamedTuple):
    """The times of samples [s]: stamps, or so many per second."""

    count: int
    rate: float | None
    stamps: Waveform | None
    unit: float

    def at(self, start: int, stop: int) -> np.ndarray:
        """Times of the samples from `start` to `stop`."""
        if self.stamps is None:
            return np.arange(start, stop) / self.rate
        return self.stamps.rows(start, stop)[:, 0] * self.unit

    def below(self, time: float, zero: float = 0.0, reached: bool = False) -> int:
        """How many samples are before a time, counted from `zero`; with `reached` those at it too."""
        side = "right" if reached else "left"
        low, high = 0, self.count
        while high - low > BLOCK:
            middle = (low + high) // 2
            before = self.at(middle, middle + 1)[0] - zero
            low, high = (middle, high) if before < time or reached and before == time else (low, middle)
        return low + int(np.searchsorted(self.at(low, high) - zero, time, side))


def clock(
    stamps: Waveform | None, sampling: Any, count: Count, units: UnitsOrWords, called: list[str],
) -> tuple[Clock, dict[str, Read]]:
    """The times of so many samples, and how their unit was read. **Raises** ValueError for stamps that do not rise."""
    if sampling is not None:
        return Clock(count, float(positive("sampling", sampling, "It is in samples per second.")), None, 1.0), {}
    if stamps is None:
        refuse("time", "where the times are, or sampling=", "None")
    if stamps.length != count or stamps.width != 1:
        refuse("time", f"{count} times", f"shape {stamps.shape}")
    unknown, last, falls = 0, -np.inf, None
    for _, x in stamps.blocks():
        unknown += np.count_nonzero(np.isnan(x))
        if falls is None and not (np.diff(x, prepend=last) > 0).all():
            falls = x
        last = x[-1]
    if unknown:
        refuse("time", "a time in every row", f"none in {unknown} of {count}",
               "Give sampling= where rows are equally spaced.")
    if falls is not None:
        refuse("time", "times that rise", show(falls), "Give sampling= where too few digits were written.")
    read = unit_of("time", "time", called, units)
    return Clock(count, None, stamps, read.unit.size), {"time": read}


def trigger_time(trigger: Any, channel: Waveform | None, times: Clock) -> float:
    """The time of the trigger: said, or that at which a channel first crosses a level, interpolated."""
    pair = isinstance(trigger, (tuple, list))
    time = parameter("trigger", trigger[-1] if pair and trigger else trigger)
    if time.ndim or pair and len(trigger) != 2:
        refuse("trigger", "a time, or a pair (column, level)", repr(trigger))
    if not pair:
        return float(time)
    if channel.length != times.count or channel.width != 1:
        refuse("trigger", "one channel", f"shape {channel.shape}")
    level, low, high, last = float(time), np.inf, -np.inf, None
    for start, x in channel.blocks():
        known = np.flatnonzero(np.isfinite(x))
        if not known.size:
            continue
        # (place, sample) of all that are known, that before this block too
        places = np.concatenate([[] if last is None else [last[0]], start + known]).astype(int)
        samples = np.concatenate([[] if last is None else [last[1]], x[known]])
        above = samples > level
        if (above != above[0]).any():
            k = int(np.argmax(above != above[0]))
            part = (level - samples[k - 1]) / (samples[k] - samples[k - 1])
            before, after = (times.at(place, place + 1)[0] for place in places[k - 1 : k + 1].tolist())
            return float(before + part * (after - before))
        low, high, last = min(low, samples.min()), max(high, samples.max()), (places[-1], samples[-1])
    span = f", from {low:g} to {high:g}" if last is not None else ""
    refuse("trigger", f"a level that {trigger[0]!r} crosses{span}", f"{level:g}")
