"""What axes count: which quantity a label names, and in which units it is drawn."""

import re
from typing import Any, NamedTuple

import numpy as np

from ..checks import refuse
from ..units import SCALED, SI, UnitsOrWords
from ..units.names import family, known_unit, readable, settled

CYCLES = known_unit("Hz")
# what a label ends with, and the unit in which numbers in SI are given; "" is a pure number
_QUANTITIES = {
    "time": "s",
    "displacement": "m",
    "strain": "m",
    "compression": "m",
    "overlap": "m",
    "length": "m",
    "amplitude": "m",
    "velocity": "m/s",
    "speed": "m/s",
    "group velocity": "1/s",
    "acceleration": "m/s^2",
    "force": "N",
    "load": "N",
    "energy": "J",
    "power": "W",
    "frequency": "Hz",
    "angular frequency": "rad/s",
    "damping": "1/s",
    "rate": "1/s",
    "stress": "Pa",
    "pressure": "Pa",
    "modulus": "Pa",
    "mass": "kg",
    "voltage": "V",
    "site": "",
    "contact": "",
    "frame": "",
    "period": "s",
    "delay": "s",
    "bead": "",
    "wave number": "",
}
OMEGA = r"angular frequency $\omega$"
SAID = re.compile(r".*[([][^)\]]+[)\]]\s*$")


class Axis(NamedTuple):
    """An axis to be drawn: its label, its numbers (or the largest of them), and the unit of these in SI.

    `unit` is `None` where the label names the quantity, or nobody knows it; "" is that of a pure number.
    """

    label: str
    numbers: Any
    unit: str | None = None


class Shown(NamedTuple):
    """How an axis is drawn: what its numbers are multiplied with, its label, and the unit's name, "" for none."""

    factor: float
    label: str
    unit: str


def units_of(x: Any) -> str | None:
    """What the numbers of a result are counted in; `None` where it does not say."""
    found = getattr(x, "units", None)
    return found if found in (SI, SCALED) else None


def units_of_both(first: Any, second: Any, argument: str, what: str) -> str | None:
    """What both are counted in that go into one picture; the second may be `None`.

    **Raises** ValueError, which names the second's `argument`, where they are counted in different numbers.
    """
    said = [x for x in map(units_of, (first, second)) if x]
    if len(set(said)) > 1:
        refuse(argument, f"one in {said[0]} numbers, as the {what}", said[1])
    return next(iter(said), None)


def quantity(label: str) -> str | None:
    """The unit in SI of what a label names by its last words; "" for a pure number, `None` where nobody knows."""
    plain = re.sub(r"\$[^$]*\$", "", label).strip(" |").lower()
    fitting = [name for name in _QUANTITIES if plain == name or plain.endswith(" " + name)]
    return _QUANTITIES[max(fitting, key=len)] if fitting and "/" not in plain else None


def drawn_in(
    units: UnitsOrWords, said: str | None, *axes: Axis, argument: str = "units"
) -> list[Shown]:
    """How axes are drawn in the units that are asked for.

    **Arguments:** `units`: as every plot takes them, below. `said`: what the numbers are counted in, "SI", "scaled", or
    `None` where nobody knows.

    - `None`: numbers in SI with the prefix that reads, scaled ones as they are.
    - Words, `"us"` or `("kHz", "mm/s")`: each for the axes of its dimension. The numbers are in SI.
    - `"SI"`: they are in SI, `"scaled"`: they are not; this settles it for arrays.
    - A `Units`: scaled numbers are drawn in SI, with words or without; numbers in SI are drawn scaled.

    **Raises** ValueError for words that no axis takes, and for units of numbers that are scaled.
    """
    counted = settled(units, said, argument)
    known = [quantity(a.label) if a.unit is None else a.unit for a in axes]
    known = [
        None if SAID.match(a.label) else known_unit(unit) if unit else unit
        for a, unit in zip(axes, known)
    ]
    left = [
        word
        for word in counted.words
        if not any(unit and unit.dimension == word.dimension for unit in known)
    ]
    unknown = [
        i
        for i, (a, unit) in enumerate(zip(axes, known))
        if unit is None and not SAID.match(a.label)
    ]
    if left and len(left) == len(unknown) == 1:
        # what nobody knows is what somebody says, but for a factor of 2 pi
        if left[0].dimension == CYCLES.dimension:
            refuse(
                argument,
                f"a label that says what {axes[unknown[0]].label!r} counts",
                repr(left[0].name),
                "Call the axis 'frequency', of numbers in Hz, or 'angular frequency', of numbers in rad/s.",
            )
        known[unknown[0]] = family(left.pop().dimension)[0]
    if left:
        there = dict.fromkeys(f"{a.label} ({unit.name})" for a, unit in zip(axes, known) if unit)
        none = (
            "None: no label here names a quantity with units"
            if axes
            else "None: the axes are pure numbers"
        )
        refuse(
            argument,
            f"units of {', '.join(there)}" if there else none,
            ", ".join(repr(word.name) for word in left),
            f"Such as {', '.join(repr(family(u.dimension, u.size)[1].name) for u in known if u and _many(u))}."
            if any(u and _many(u) for u in known)
            else "",
        )
    return [_drawn(axis, unit, counted) for axis, unit in zip(axes, known)]


def _many(unit):
    return len(family(unit.dimension, unit.size)) > 1


def _drawn(axis, unit, counted):
    """How one axis is drawn; `unit` is that of its numbers in SI, `None` unknown, "" none."""
    if SAID.match(axis.label) or unit == "":
        return Shown(1.0, axis.label, "")
    said, sizes, _ = counted
    size = counted.size(unit) if sizes is not None and unit else 1.0
    if said == SI and sizes is not None:
        return (
            Shown(1 / size, f"{axis.label} ({SCALED})", SCALED)
            if unit
            else Shown(1.0, axis.label, "")
        )
    if said is None or said == SCALED and sizes is None:
        return Shown(
            1.0,
            axis.label if said is None else f"{axis.label} ({SCALED})",
            "" if said is None else SCALED,
        )
    if unit is None:
        return Shown(1.0, axis.label, "")
    own = counted.word(unit.dimension)
    finite = np.abs(np.asarray(axis.numbers, float)[np.isfinite(axis.numbers)])
    largest = float(finite.max(initial=0.0)) * size * unit.size
    angular = unit.dimension == CYCLES.dimension
    shown_in = own or readable(
        family(unit.dimension, CYCLES.size if angular else unit.size), largest
    )
    label = axis.label
    if angular:
        label = _cyclic(label) if "Hz" in shown_in.name else _angular(label)
    return Shown(size * unit.size / shown_in.size, f"{label} ({shown_in.label})", shown_in.label)


def _cyclic(label):
    """A label of angular frequency, as one of frequency."""
    return re.sub(
        r"angular frequency|frequency", "frequency", re.sub(r"\s*\$\\omega[^$]*\$", "", label)
    )


def _angular(label):
    """A label of frequency, as one of angular frequency."""
    return label if "omega" in label else re.sub(r"(angular )?frequency", lambda _: OMEGA, label)


def scaled_by(x: Any, factor: float) -> Any:
    """Numbers times a factor; themselves where it is 1."""
    return x if factor == 1 else np.asarray(x) * factor
