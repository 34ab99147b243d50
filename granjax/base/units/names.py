"""Units by name, and whether numbers are in SI or scaled."""

import math
import re
from fractions import Fraction
from functools import lru_cache
from typing import Any, NamedTuple

from ..checks import concrete, nearest, one_of, refuse

SI = "SI"
SCALED = "scaled"
"""Numbers are in SI units or in scaled units."""
_MARKS = {SI: 1.0, SCALED: 0.0, None: math.nan}
# The size in SI, and the powers of force, length, time, angle, voltage. A cycle is 2 pi rad, so
# 1 Hz is 2 pi rad/s.
_BASES = {
    "1": (1.0, (0, 0, 0, 0, 0)),
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
# Units that pictures use and that are suggested for an unknown name. The first line that has a
# dimension serves it.
_READ = (
    "s ms us ns",
    "Hz kHz MHz mHz",
    "rad/s krad/s Mrad/s",
    "1/s 1/ms 1/us",
    "m mm um nm pm",
    "m/s mm/s km/s um/s nm/s",
    "m/s^2 mm/s^2 km/s^2",
    "N mN kN uN",
    "J mJ kJ uJ nJ pJ",
    "W mW kW uW",
    "Pa kPa MPa GPa",
    "kg g mg",
    "N/m kN/m MN/m GN/m",
    "V mV kV uV",
)
# the operator before a factor, its symbol, its power
_FACTOR = re.compile(r"([ */]?)(1|[A-Za-z]+)(?:\^?\{?([+-]?\d(?:\.\d+|/[1-9])?)\}?)?")


class Named(NamedTuple):
    """A unit: its name, size in SI, and powers of force, length, time, angle and voltage."""

    name: str
    size: float
    dimension: tuple[Fraction, ...]

    @property
    def label(self) -> str:
        """The name as a picture writes it: µs, m/s², N/m$^{3/2}$."""
        text = re.sub(r"u(?=[A-Z]|m|s|g|rad)", "µ", self.name)
        text = re.sub(r"\^2(?![.\d/])", "²", text)
        return re.sub(r"\^\{?([-\d./]+)\}?", r"$^{\1}$", text)

    @property
    def inverse(self) -> "Named | None":
        """1/kHz of kHz, s/rad of rad/s."""
        over, _, under = self.name.partition("/")
        return known_unit(f"{under or 1}/{over}")


@lru_cache(maxsize=256)
def known_unit(word: str) -> Named | None:
    """Return the unit of a name, also of products and powers; `None` if unknown.

    Examples: "mm/s", "N/m^{3/2}", "1/ms".
    """
    text = word.replace("µ", "u").replace("²", "^2")
    size = 1.0
    powers = [Fraction(0)] * 5
    factors = list(_FACTOR.finditer(text))
    if not text or text[0] in " */" or "".join(x[0] for x in factors) != text:
        return None
    for way, symbol, power in (x.groups() for x in factors):
        prefix, base = (1.0, symbol) if symbol in _BASES else (_PREFIXES.get(symbol[0]), symbol[1:])
        if prefix is None or base not in _BASES:
            return None
        power = Fraction(power or 1) * (-1 if way == "/" else 1)
        size *= (prefix * _BASES[base][0]) ** float(power)
        powers = [x + power * y for x, y in zip(powers, _BASES[base][1])]
    return Named(word, size, tuple(powers))


def named_unit(word: str) -> Named:
    """Return the unit of a name.

    **Raises** ValueError for an unknown name, suggesting the nearest.
    """
    found = known_unit(word)
    if found is None:
        remedy = nearest(word, " ".join(_READ).split(), 3) or "Such as 'us', 'kHz', 'mm/s', 'N'."
        refuse("units", "the name of a unit", repr(word), remedy)
    return found


def readable(unit: Named, largest: float) -> Named:
    """Return the unit of a dimension in which a size in SI is between 1 and 1000, or closest.

    Angular frequencies are given in Hz.
    """
    for names in _READ:
        units = [known_unit(name) for name in names.split()]
        if units[0].dimension != unit.dimension:
            continue
        if not (largest > 0 and math.isfinite(largest)):
            return units[0]
        fitting = [x for x in units if largest >= x.size * (1 - 1e-9)]
        return max(fitting or [min(units, key=_size)], key=_size)
    return unit


def _size(unit):
    return unit.size


def mark_of(units: str | None) -> float:
    """Return a number that marks SI or scaled units and passes through transformations."""
    return _MARKS[units if units is None else one_of("units", units, (SI, SCALED))]


def counted_in(mark: Any) -> str | None:
    """Return "SI" or "scaled" for a mark; `None` if unset, or unknown while traced."""
    value = concrete(mark)
    if value is None or not value.size or math.isnan(value.flat[0]):
        return None
    return SI if value.flat[0] else SCALED
