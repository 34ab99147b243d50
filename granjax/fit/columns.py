"""Units of a file's columns, from their names: "Time (us)", "Bead 3 [V]", "t/ms", "velocity_mm_s"."""

import re
from typing import NamedTuple

import numpy as np

from ..checks import refuse
from ..units import SCALED, SI, UnitsOrWords
from ..units.names import Named, asked_for, family, known_unit

# names that are spelled out, each with a prefix of its kind, and words between them
_SPELLED = {
    "second": "s", "sec": "s", "metre": "m", "meter": "m", "newton": "N", "volt": "V", "hertz": "Hz", "joule": "J",
    "watt": "W", "pascal": "Pa", "gram": "g", "gramme": "g", "radian": "rad",
}
_BEFORE = {"nano": "n", "micro": "u", "milli": "m", "centi": "c", "kilo": "k", "mega": "M", "giga": "G",
           "n": "n", "u": "u", "µ": "u", "μ": "u", "m": "m", "": ""}
_NAME = re.compile(rf"(nano|micro|milli|centi|kilo|mega|giga|[nuµμm]?)({'|'.join(_SPELLED)})e?s?")
_WORDS = {"micron": "um", "microns": "um", "per": "/", "squared": "^2", "cubed": "^3"}
_MINUTES = {"min": 60.0, "minute": 60.0, "minutes": 60.0, "h": 3600.0, "hour": 3600.0, "hours": 3600.0}
# units that are none of SI, and columns that count rows
_OTHERS = set("inch inches ft foot feet mil mils ips mph kph fps knots lb lbs lbf pound pounds kgf gf dyn dyne dynes "
              "psi a.u. au arb arb. counts adc lsb db".split())
_COUNTED = {"frame", "frames", "sample", "samples", "index", "no", "no.", "#", "row", "point", "points"}
QUANTITIES = {"time": "s", "velocity": "m/s", "displacement": "m", "force": "N"}
_VOLT, _TIME = known_unit("V").dimension, known_unit("s").dimension
# what stands in brackets, of any kind, which are no power
_BRACKETS = re.compile(r"(?<!\^)(?:\[([^\]]*)\]|\(((?:[^()]|\([^()]*\))*)\)|\{([^}]*)\}|<([^>]*)>)")
# between the words of a name; a minus, or a point, before a letter is none of a number
_BETWEEN = re.compile(r"[_\s,;:|]+|(?<!\^)[\[({<]|[-.](?=[^\W\d])")
# words in brackets that are no unit, beside numbers and what is numbered: "(filtered)", "(2)", "(ch 3)", "(OFV-505)"
_REMARKS = set(
    "filtered unfiltered smoothed raw left right top bottom front back rear upper lower middle centre center central "
    "side inner outer x y z horizontal vertical radial axial normal tangential rel relative abs absolute measured "
    "measurement calculated computed simulated fit fitted exp experiment experimental theory calibrated uncalibrated "
    "corrected uncorrected mean average averaged avg rms peak signal channel ch bead site sensor probe contact point "
    "position trace laser vibrometer ldv piezo wall first last out input output reference ref from since start "
    "trigger time velocity displacement force and of the total dynamic static new old test run".split())
_NUMBERED = re.compile(r"([^\W\d_]*)[\s#.-]*\d+")


class Read(NamedTuple):
    """The unit of a column, and what said so: "header", "units=", or "" where nobody did and SI is taken."""

    unit: Named
    by: str


def unit_in(name: str, wanted: tuple) -> tuple[Named | None, str]:
    """(the unit in a column's name, the words that may be one, "" for none): "mm/s", brackets, "t/ms", "velocity_mm_s".

    Words beside others are a unit where they have the dimension that is `wanted`: "Bead V" is a name.
    """
    whole = _known(name)
    if whole is not None and (whole.dimension == wanted or len(name.strip()) > 1 and whole.dimension != _TIME):
        return whole, name.strip()
    found = ["".join(groups).strip() for groups in _BRACKETS.findall(name)]
    # of several the one that is a unit, of what is wanted if there is such: "Velocity [mm/s] (filtered)"
    units = [(_known(text), text) for text in reversed(found) if not _is_remark(text)]
    if units:
        return min(units, key=lambda x: 2 if x[0] is None else int(x[0].dimension != wanted))
    name = _BRACKETS.sub(" ", name)
    words = [x for x in _BETWEEN.split(name) if x]
    parts = [words[-n:] for n in (4, 3, 2, 1) if n < len(words)] + [words[:n] for n in (4, 3, 2, 1) if n < len(words)]
    for text in (mark.join(part) for part in parts for mark in (" ", "/") if mark == " " or len(part) > 1):
        unit = _known(text)
        if unit is not None and unit.dimension == wanted:
            # "min time" may be the least one
            return (None if words[0] == text and text.lower() in ("min", "h") else unit), text
    _, slash, text = name.partition("/")
    if slash and not _is_remark(text):
        return _known(text), text.strip()
    last = words[-1] if words else ""
    unit = _known(last) if len(last) > 1 else None
    if unit is not None and unit.dimension == _VOLT or last.lower() in _OTHERS:
        return unit, last
    # "TIME MS"
    return None, last if last.isupper() and getattr(known_unit(last.lower()), "dimension", ()) == wanted else ""


def _is_remark(text):
    """Whether words in brackets are known to be no unit."""
    words = re.findall(r"[^\W\d_]+|\d+(?:\.\d+)?", text.lower())
    if any(word in _OTHERS for word in words) or _known(text) is not None:
        return False
    if _NUMBERED.fullmatch(text.strip()) or not text:
        return True
    return bool(words) and all(word in _REMARKS or word[0].isdigit() for word in words)


def _known(word):
    """The unit that words are, a dimension at least: symbols, or names spelled out."""
    word = word.strip()
    if word.lower() in _MINUTES:
        return Named(word, _MINUTES[word.lower()], _TIME)
    small = re.sub(r"[^\W\d_]+", lambda x: _symbol(x[0]), re.sub(r"\s*(\*\*|\^)\s*", "^", word))
    small = re.sub(r"\s+\^", "^", re.sub(r"\s*/\s*", "/", re.sub(r"(?<=\w)\.(?=[^\W\d])", " ", small)))
    small = {"S": "s", "v": "V"}.get(small, small)
    found = known_unit(word) or known_unit(small)
    return found if found is not None and any(found.dimension) else None


def _symbol(word):
    """The symbol of a unit whose name is spelled out; other words as they are."""
    spelled = _NAME.fullmatch(word.lower())
    return _BEFORE[spelled[1]] + _SPELLED[spelled[2]] if spelled else _WORDS.get(word.lower(), word)


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
        counted = kind == "time" and name.strip().lower() in _COUNTED
        if counted or text and (unit is not None or kind == "time" or not given):
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
