"""Units by their names, and what numbers are counted in."""

import difflib
import math
import re
from collections.abc import Sequence
from fractions import Fraction
from functools import lru_cache
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from ..checks import concrete, one_of, refuse
from .sizes import Units

SI, SCALED = "SI", "scaled"
"""What numbers are counted in: those of SI, or units of their own."""
_MARKS = {SI: 1.0, SCALED: 0.0, None: math.nan}
# size in SI, and powers of force, length, time, angle, voltage; a cycle is 2 pi rad, so 1 Hz is 2 pi rad/s
_BASES = {
    "s": (1.0, (0, 0, 1, 0, 0)),
    "Hz": (2 * math.pi, (0, 0, -1, 1, 0)),
    "rad": (1.0, (0, 0, 0, 1, 0)),
    "m": (1.0, (0, 1, 0, 0, 0)),
    "N": (1.0, (1, 0, 0, 0, 0)),
    "J": (1.0, (1, 1, 0, 0, 0)),
    "W": (1.0, (1, 1, -1, 0, 0)),
    "Pa": (1.0, (1, -2, 0, 0, 0)),
    "g": (1e-3, (1, -1, 2, 0, 0)),
    "V": (1.0, (0, 0, 0, 0, 1)),
}
_PREFIXES = {"G": 1e9, "M": 1e6, "k": 1e3, "c": 1e-2, "m": 1e-3, "u": 1e-6, "n": 1e-9, "p": 1e-12}
# those that pictures choose from, of each dimension, and those that are proposed for what is not known
_READ = (
    ("s", "ms", "us", "ns"),
    ("Hz", "kHz", "MHz", "mHz"),
    ("rad/s", "krad/s", "Mrad/s"),
    ("1/s", "1/ms", "1/us"),
    ("m", "mm", "um", "nm", "pm"),
    ("m/s", "mm/s", "km/s", "um/s", "nm/s"),
    ("m/s^2", "mm/s^2", "km/s^2"),
    ("N", "mN", "kN", "uN"),
    ("J", "mJ", "kJ", "uJ", "nJ", "pJ"),
    ("W", "mW", "kW", "uW"),
    ("Pa", "kPa", "MPa", "GPa"),
    ("kg", "g", "mg"),
    ("N/m", "kN/m", "MN/m", "GN/m"),
    ("V", "mV", "kV", "uV"),
)
_FACTOR = re.compile(
    r"\s*([*/·⋅]?)\s*(1|[A-Za-z]+)(?:\^?(\{[^}]*\}|\([^)]*\)|[+-]?\d+(?:\.\d+)?))?"
)
_RAISED = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁻", "0123456789-")


class Named(NamedTuple):
    """A unit: its name, its size in SI, and its dimension, powers of force, length, time, angle and voltage."""

    name: str
    size: float
    dimension: tuple[Fraction, ...]

    @property
    def label(self) -> str:
        """The name as a picture writes it: µs, m/s², N/m$^{3/2}$."""
        text = re.sub(r"u(?=[A-Z]|m|s|g|rad)", "µ", self.name)
        text = re.sub(r"\^2(?![.\d/])", "²", text)
        return re.sub(r"\^\{?([-\d./]+)\}?", r"$^{\1}$", text)


UnitsOrWords: TypeAlias = str | Units | Sequence[str | Units] | None
"""What numbers are to be counted in: words such as `"us"`, `("kHz", "mm/s")`, `"SI"`, `"scaled"`, and a `Units`."""


@lru_cache(maxsize=256)
def known_unit(word: str) -> Named | None:
    """The unit of a name, products and powers such as "mm/s", "N/m^{3/2}", "1/ms" too; `None` where there is none."""
    text = re.sub("[⁻⁰¹²³⁴-⁹]+", lambda x: "^" + x[0].translate(_RAISED), word.strip())
    text, size, powers, at = text.replace("µ", "u").replace("μ", "u"), 1.0, [Fraction(0)] * 5, 0
    while at < len(text):
        found = _FACTOR.match(text, at)
        one = found and _symbol(found[2])
        if not one or not at and found[1]:
            return None
        try:
            power = Fraction((found[3] or "1").strip("{}()"))
        except (ValueError, ZeroDivisionError):
            return None
        power, at = -power if found[1] == "/" else power, found.end()
        try:
            size, powers = (
                size * one[0] ** float(power),
                [x + power * y for x, y in zip(powers, one[1])],
            )
        except OverflowError:
            return None
    return Named(word.strip(), size, tuple(powers)) if text and 0 < size < math.inf else None


def _symbol(symbol):
    if symbol == "1":
        return 1.0, (0,) * 5
    if symbol in _BASES:
        return _BASES[symbol]
    prefix, base = _PREFIXES.get(symbol[0]), _BASES.get(symbol[1:])
    return (prefix * base[0], base[1]) if prefix and base else None


def named_unit(word: str) -> Named:
    """The unit of a name. **Raises** ValueError for one that is not known, with the nearest that is."""
    found = known_unit(word)
    if found is None:
        every = [name for names in _READ for name in names]
        near = (
            difflib.get_close_matches(word, every, 3, 0.5)
            or difflib.get_close_matches(word.lower(), [name.lower() for name in every], 3, 0.5)
            or ["us", "kHz", "mm/s", "N"]
        )
        refuse("units", "the name of a unit", repr(word), f"Nearest: {', '.join(map(repr, near))}.")
    return found


def family(dimension: Sequence[Fraction], size: float = 1.0) -> tuple[Named, ...]:
    """The units of a dimension that pictures choose from; the one of SI comes first. Angles of `size` 2 pi are cycles.

    A dimension of no name has the product of its powers.
    """
    for names in _READ:
        first = known_unit(names[0])
        if first.dimension == tuple(dimension) and first.size == size:
            return tuple(map(known_unit, names))
    parts = [(name, power) for name, power in zip(("N", "m", "s", "rad", "V"), dimension) if power]
    text = " ".join(name + (f"^{power}" if power != 1 else "") for name, power in parts)
    return (Named(text, 1.0, tuple(dimension)),)


def readable(units: Sequence[Named], largest: float) -> Named:
    """Of several units the one in which a size is 1 to 1000, or comes next to it."""
    fitting = [unit for unit in units if largest >= unit.size * (1 - 1e-9)]
    if not (largest > 0 and math.isfinite(largest)):
        return units[0]
    return max(fitting, key=lambda u: u.size) if fitting else min(units, key=lambda u: u.size)


def mark_of(units: str | None) -> float:
    """A number that says what others are counted in, and goes with them through transformations."""
    return _MARKS[units if units is None else one_of("units", units, (SI, SCALED))]


def counted_in(mark: Any) -> str | None:
    """Give "SI" or "scaled", from a mark; `None` where it was not said or is not known while traced."""
    value = concrete(mark)
    if value is None or not value.size or math.isnan(value.flat[0]):
        return None
    return SI if value.flat[0] else SCALED


class Counted(NamedTuple):
    """What somebody asks numbers to be counted in: what they are, a `Units`, the units that are named."""

    said: str | None
    sizes: Units | None
    words: list[Named]

    def size(self, unit: Named) -> float:
        """Size of a quantity's unit in SI, of numbers that are scaled by a `Units`."""
        size = np.asarray(self.sizes.of(*(float(x) for x in unit.dimension[:3])))
        return float(size)

    def word(self, dimension: Sequence[Fraction]) -> Named | None:
        """The unit that is named for a dimension."""
        return next((word for word in self.words if word.dimension == dimension), None)

    def conversion(self, unit: str) -> tuple[float, str]:
        """What numbers are multiplied with whose unit in SI is known by its name, and the name of what they are then.

        A pure number stays as it is, and so does what has a unit that is none of SI.
        """
        known = known_unit(unit)
        if known is None or not any(known.dimension):
            return 1.0, unit
        size = 1.0 if self.sizes is None else self.size(known)
        if self.said == SI and self.sizes is not None:
            return 1 / size, SCALED
        if self.said is None or self.said == SCALED and self.sizes is None:
            return 1.0, self.said or ""
        word = self.word(known.dimension)
        return (size, unit) if word is None else (size * known.size / word.size, word.name)


def settled(units: UnitsOrWords, said: str | None) -> Counted:
    """What numbers are counted in, "SI", "scaled" or `None` as far as `said` tells, when somebody asks for units.

    Words are for numbers in SI, or for scaled ones with the `Units` that leads there. A `Units` beside numbers in SI
    turns them into scaled ones. **Raises** ValueError for units that the numbers cannot have.
    """
    kind, sizes, words = asked_for(units)
    remedy = (
        "Give the Units that leads back to SI beside it, gx.Units() where the numbers are those of SI, or say so "
        "of the lattice: lattice.counted_in('SI'), gx.Lattice(..., units='SI')."
    )
    if said == SCALED and sizes is None and (kind == SI or words):
        refuse("units", "None or 'scaled' for scaled numbers", repr(units), remedy)
    if said == SI and kind == SCALED:
        refuse(
            "units",
            "units of numbers in SI",
            repr(units),
            "A Units counts them in scaled numbers.",
        )
    # of scaled numbers and a Units "SI" is where they go
    if said != SCALED or sizes is None:
        said = kind or said or (SCALED if sizes is not None else SI if words else None)
    if words and said == SI and sizes is not None:
        refuse(
            "units", "words, or a Units, which turns numbers in SI into scaled ones", repr(units)
        )
    if words and said == SCALED and sizes is None:
        refuse("units", "a Units beside words, for scaled numbers", repr(units), remedy)
    return Counted(said, sizes, words)


def asked_for(units: UnitsOrWords) -> tuple[str | None, Units | None, list[Named]]:
    """("SI" or "scaled", a `Units`, the units that are named) of what somebody asks for."""
    every = [] if units is None else [units] if isinstance(units, (str, Units)) else list(units)
    kinds = [x for x in every if isinstance(x, str) and x in (SI, SCALED)]
    if len(kinds) > 1 or sum(isinstance(x, Units) for x in every) > 1:
        refuse(
            "units",
            "words such as 'us', ('kHz', 'mm/s'), 'SI' or 'scaled', and one Units at most",
            repr(units),
        )
    words = [named_unit(x) for x in every if not isinstance(x, Units) and x not in kinds]
    for i, word in enumerate(words):
        for other in words[:i]:
            if word.dimension == other.dimension:
                refuse("units", "one word for each dimension", f"{other.name!r} and {word.name!r}")
    return next(iter(kinds), None), next((x for x in every if isinstance(x, Units)), None), words
