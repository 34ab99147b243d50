"""Units of a file's columns, from their names: "Time (us)", "Bead 3 [V]", "t/ms", "velocity_mm_s"."""

import re
from typing import NamedTuple

import numpy as np

from ..checks import refuse
from ..units import SCALED, SI, UnitsOrWords
from ..units.names import Named, asked_for, family, known_unit

# as instruments write them, small
_WORDS = {
    "sec": "s", "secs": "s", "second": "s", "seconds": "s", "msec": "ms", "millisecond": "ms", "milliseconds": "ms",
    "usec": "us", "µsec": "us", "microsecond": "us", "microseconds": "us", "nanoseconds": "ns", "nsec": "ns",
    "volt": "V", "volts": "V", "millivolt": "mV", "millivolts": "mV", "metre": "m", "metres": "m", "meter": "m",
    "meters": "m", "newton": "N", "newtons": "N", "hertz": "Hz",
}
_MINUTES = {"min": 60.0, "minute": 60.0, "minutes": 60.0, "h": 3600.0, "hour": 3600.0, "hours": 3600.0}
# units that are none of SI, and columns that count rows
_OTHERS = {"in", "inch", "inches", "ft", "mil", "mils", "ips", "lb", "lbf", "kgf", "gf", "a.u.", "au", "arb", "arb.",
           "raw", "counts", "count", "adc", "lsb", "bits", "%", "db"}
_COUNTED = {"frame", "frames", "sample", "samples", "index", "no", "no.", "#", "row", "point", "points"}
QUANTITIES = {"time": "s", "velocity": "m/s", "displacement": "m", "force": "N"}
_VOLT = known_unit("V").dimension


class Read(NamedTuple):
    """The unit of a column, and what said so: "header", "units=", or "" where nobody did and SI is taken."""

    unit: Named
    by: str


def unit_in(name: str, wanted: tuple) -> tuple[Named | None, str]:
    """(the unit in a column's name, the words that may be one): brackets, "t/ms", "time in us", "velocity_mm_s".

    Words behind a blank or an underscore are a unit where they have the dimension that is `wanted`: "Bead V" is a name.
    """
    found = re.findall(r"[\[(]([^\])]*)[\])]", name) or re.findall(r"\bin\s+(\S+)\s*$", name)
    if found:
        # of several the one that is a unit, of what is wanted if there is such: "Velocity [mm/s] (filtered)"
        units = [(_known(text), text.strip()) for text in found]
        return min(reversed(units), key=lambda x: 2 if x[0] is None else int(x[0].dimension != wanted))
    parts = [x for x in re.split(r"[_\s,;:]+", name.strip()) if x != "per"]
    for text in ("/".join(parts[-2:]) if parts[2:] else "", parts[-1] if parts[1:] else ""):
        unit = _known(text) if text else None
        if unit is not None and unit.dimension == wanted:
            return unit, text
    _, slash, text = name.partition("/")
    return (_known(text), text.strip()) if slash else (None, "")


def _known(word):
    word = word.strip()
    small = _WORDS.get(word.lower()) if len(word) > 1 else {"S": "s", "v": "V"}.get(word)
    if word.lower() in _MINUTES:
        return Named(word, _MINUTES[word.lower()], known_unit("s").dimension)
    return known_unit(word) or known_unit(small or "") or known_unit(word.replace("sec", "s"))


def unit_of(
    argument: str, kind: str, lines: list[str], units: UnitsOrWords, given: bool = False,
) -> Read:
    """The unit of a column of times, velocities, ... from what a header's lines call it.

    `lines`: its name in each line, the last one first; a line of units alone comes as "[unit]". `units`: words that
    settle it. `given`: whether a gain leads from the file to SI, so that volts or anything else may be in it.
    **Raises** ValueError, which names `units`, for what may be a unit and is none of the quantity.
    """
    si = known_unit(QUANTITIES[kind])
    whole, sizes, words = asked_for(units)
    if whole == SCALED or sizes is not None:
        refuse("units", "words such as 'us', 'mm/s', or 'SI': traces are in SI", repr(units))
    if whole == SI:
        return Read(si, "units=")
    said = [word for word in words if word.dimension in ((si.dimension, _VOLT) if given else (si.dimension,))]
    if said:
        return Read(said[0], "units=")
    for name in lines:
        unit, text = unit_in(name, si.dimension)
        if unit is not None and unit.dimension == si.dimension:
            return Read(unit, "header")
        if unit is not None and (unit.dimension == _VOLT and kind != "time" or given):
            return Read(unit, "header")
        # a word in round brackets need be no unit: "Velocity (filtered)"
        strange = "[" in name or "/" in text or text.lower() in _OTHERS
        counted = kind == "time" and name.strip().lower() in _COUNTED
        if counted or text and (unit is not None or kind == "time" or strange and not given):
            such = ", ".join(repr(x.name) for x in family(si.dimension)[:3])
            refuse(argument, f"a column in a unit of {kind} ({si.name})", repr(name),
                   f"Say units= of it, such as {such}{', or sampling=' if kind == 'time' else ''}.")
    return Read(si, "")


def names_of(k: int, names: list[list[str]]) -> list[str]:
    """What each line of a header calls column k, the last line first; what stands in a line of units as "[unit]"."""
    def called(line):
        alone = len(names) > 1 and all(_known(x.strip("[]() ")) or not x for x in line)
        return f"[{line[k].strip('[]() ')}]" if alone and line[k] else line[k]

    return [called(line) for line in reversed(names)]


def refuse_unused(units: UnitsOrWords, reads: list[Read]) -> None:
    """Refuse a word that no column takes."""
    for word in asked_for(units)[2]:
        if not any(read.unit.name == word.name for read in reads):
            refuse("units", "units of the columns that are asked for", f"{word.name!r}, which none of them takes")


def said(reads: dict[str, Read]) -> str:
    """How columns were read, a sentence."""
    how = {"header": " (header)", "units=": " (units=)", "": " (taken: nothing says)"}
    return ", ".join(f"{name} in {read.unit.name}{how[read.by]}" for name, read in reads.items())


def in_si(argument: str, x: np.ndarray, read: Read, gain: object) -> tuple[np.ndarray, object]:
    """(numbers in SI but for the gain, the gain that is left), of a column as it stands in the file.

    A number for the gain leads from the file to SI. Where a header's unit says something else, it is not known which.
    """
    volts = read.unit.dimension == _VOLT
    if isinstance(gain, str):
        return x, gain
    if gain is None:
        if volts:
            refuse("gain", f"what leads from {read.unit.name} to SI, such as 0.125 for 0.125 (m/s)/V", "None",
                   "gain='name' fits it.")
        return x * read.unit.size, 1.0
    if read.by == "units=":
        return x * read.unit.size, gain
    if read.by == "header" and read.unit.size != 1 and not np.all(np.asarray(gain) == read.unit.size):
        refuse("gain", f"{read.unit.size:g}, for {argument} is in {read.unit.name}" if not volts else
               f"one of which is known whether it is for 1 V or for 1 {read.unit.name}", f"{gain}",
               f"units={read.unit.name!r} has the file's numbers turned into SI before the gain, "
               f"units={'V' if volts else family(read.unit.dimension)[0].name!r} takes them as they are.")
    return x, gain
