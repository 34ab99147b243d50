"""What a reproduced figure is: a simulation, a picture of it, and one number that can be wrong."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from ...checks import one_of, refuse
from ...entry import checked


class Choice(NamedTuple):
    """A parameter that the source does not state: the value chosen here, its unit, and what it is.

    **Example:**

    >>> choice = gx.reproduce.figure("fig1.2").chosen["speed"]
    >>> choice.value, choice.about
    (1.0, 'speed of the wave, contacts per time')
    """

    value: object
    unit: str
    about: str


@checked
@dataclass(frozen=True)
class Figure:
    """One figure of the review.

    - `label`: the review's, such as `"fig1.3"`; `title`: a line; `caption`: what is shown and how it was made.
    - `compute(**chosen)`: an `xarray.Dataset`, without drawing anything.
    - `draw(plots, figure, data)`: draws the data into an empty matplotlib figure with the functions of `granjax.plots`,
      which are handed in; `size`: of that figure [inch].
    - `number(data)`: one number of the data; `quantity`: what it is; `expected`, `tolerance` (absolute): what it has to
      be; `source`: where the expected value comes from.
    - `chosen`: dict from name to `Choice`; `binding`: names of those that the expected value holds for.

    **Example:**

    >>> figure = gx.reproduce.figure("fig1.2")
    >>> figure.quantity, {name: choice.value for name, choice in figure.chosen.items()}
    ('peak strain over c^4', {'speed': 1.0, 'reach': 6})
    """

    label: str
    title: str
    caption: str
    compute: Callable
    draw: Callable
    number: Callable
    quantity: str
    expected: float
    tolerance: float
    source: str
    chosen: Mapping[str, Choice] = field(default_factory=dict)
    binding: tuple[str, ...] = ()
    size: tuple[float, float] = (8.8, 3.6)

    @checked
    def parameters(self, overrides: Mapping[str, object] | None = None) -> dict[str, object]:
        """The chosen parameters with some replaced; text is read as the kind of number that it replaces.

        **Raises** ValueError for a name that this figure does not have, or text that is no such number.
        """
        values = {name: choice.value for name, choice in self.chosen.items()}
        for name, value in (overrides or {}).items():
            one_of(f"overrides (parameters of {self.label})", name, tuple(values))
            values[name] = _read(name, value, values[name])
        return values


def _read(name, value, default):
    kind = type(default)
    if isinstance(value, kind) and not isinstance(value, bool):
        return value
    try:
        read = kind(value)
    except (TypeError, ValueError):
        read = None
    if read is None or isinstance(value, bool) or (kind is int and not isinstance(value, str) and read != value):
        names = {int: "a whole number", float: "a number", str: "a name"}
        refuse(name, f"{names[kind]} such as {default!r}", repr(value))
    return read
