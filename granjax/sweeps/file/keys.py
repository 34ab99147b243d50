"""A table of a sweep's file: its keys by their names, each of its kind; what is not known is refused."""

import difflib
import math
from collections.abc import Iterable
from typing import Any

from ...checks import LEAST, MOST, described, one_of, refuse

REQUIRED = object()


class Table:
    """A table, and where it stands in the file. Every refusal names table and key."""

    def __init__(self, where: str, values: Any):
        if not isinstance(values, dict):
            refuse(where, "a table of names and values", described(values))
        self.where, self.values = where, values

    def __contains__(self, key: str) -> bool:
        return key in self.values

    def place(self, key: str) -> str:
        """Where a key stands, for a sentence."""
        return f"{self.where} {key}".strip()

    def only(self, names: Iterable[str]) -> None:
        """Refuse keys that are not known, with the nearest that is."""
        names = list(names)
        for key in self.values:
            if key not in names:
                near = difflib.get_close_matches(key, names, n=1, cutoff=0.4)
                refuse(self.where or "FILE", f"one of {', '.join(names)}", described(key),
                       f"Did you mean {near[0]!r}?" if near else "")

    def get(self, key: str, default: Any = REQUIRED) -> Any:
        """What a key holds, as it is."""
        if key not in self.values and default is REQUIRED:
            refuse(self.place(key), "a value", "none")
        return self.values.get(key, default)

    def table(self, key: str, default: Any = REQUIRED) -> "Table":
        """A table within."""
        value = self.values.get(key, default)
        where = f"{self.where.removesuffix(']')}.{key}]" if self.where else f"[{key}]"
        if value is REQUIRED:
            refuse(where, "a table", "none")
        return Table(where, value)

    def number(self, key: str, default: Any = REQUIRED) -> Any:
        """A finite number."""
        value = self.get(key, default)
        return value if value is default else number(self.place(key), value)

    def above_zero(self, key: str, default: Any = REQUIRED) -> Any:
        """A number above zero."""
        value = self.number(key, default)
        if value is not default and not value > 0:
            refuse(self.place(key), "a number above zero", f"{value:g}")
        return value

    def whole(self, key: str, default: Any = REQUIRED, at_least: int = LEAST, most: int = MOST) -> Any:
        """A whole number."""
        value = self.get(key, default)
        return value if value is default else whole(self.place(key), value, at_least, most)

    def word(self, key: str, known: Iterable[str], default: Any = REQUIRED) -> Any:
        """One of some words."""
        value = self.get(key, default)
        return value if value is default else one_of(self.place(key), value, known)

    def text(self, key: str, default: Any = REQUIRED) -> Any:
        """A word of any letters."""
        value = self.get(key, default)
        if value is not default and (not isinstance(value, str) or not value):
            refuse(self.place(key), "a word", described(value))
        return value


def number(place: str, value: Any) -> float:
    """A finite real number as a float."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        refuse(place, "a number", described(value))
    if not math.isfinite(value if isinstance(value, float) else _float(value)):
        refuse(place, "a finite number", described(value))
    return float(value)


def _float(value):
    try:
        return float(value)
    except OverflowError:
        return math.inf


def whole(place: str, value: Any, at_least: int = LEAST, most: int = MOST) -> int:
    """A whole number within bounds."""
    if isinstance(value, bool) or not isinstance(value, int) or not at_least <= value <= most:
        bounds = "" if (at_least, most) == (LEAST, MOST) else f" within {at_least} ... {most}"
        refuse(place, f"a whole number{bounds}", described(value))
    return value
