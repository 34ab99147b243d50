"""The arrays of results as variables of a dataset, whose axes are named: sites, fields, components, lanes."""

import math
from collections.abc import Callable, Iterator, Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

import jax
import numpy as np

from .checks import refuse

COMPONENTS = ("x", "y", "z")
FIELD, COMPONENT, LANE = "field", "component", "lane"


class Held(NamedTuple):
    """What a field of a result is: its axes, words with a space between; its unit; its name in a file; its description.

    `axes=None` makes an attribute of it instead of a variable, and leaves out a result within. A variable of the one
    axis that has its name is a coordinate. `site` stands for all axes of a lattice: `site`, `site_1` on a grid,
    `component` of vectors, and `field` before them where a cell holds several. Axes beyond those named are lanes, or
    called `NAME_k`. Axes that are not named stand where the dots do ("site ... mode"), or at the end.
    """

    axes: str | None = ""
    unit: str = ""
    name: str = ""
    doc: str = ""


# the unit of a `State`, which has two
STATE, MOTION = "m, m/s", {"u": "m", "v": "m/s"}


class Layout(NamedTuple):
    """How the arrays of a result lie.

    `sites`: how many axes count sites, `None` where nobody knows; `components`: of a vector at each of them, 0 where it
    is a number. `lanes`: the shape of a batch, of whose axes `first` lead all others (as `jax.vmap` has them) and the
    others come last.
    """

    sites: int | None = None
    components: int = 0
    lanes: tuple[int, ...] = ()
    first: int = 0

    @property
    def space(self) -> tuple[int, int] | None:
        """Axes of sites and components, `None` where nobody knows."""
        return None if self.sites is None else (self.sites, self.components)

    def words(self, axes: str) -> list[str] | None:
        """The names of an array's own axes, without lanes; `None` where their number is not known."""
        before, dots, after = axes.partition("...")
        known = self.sites is not None if "site" in before.split() else not dots
        if not known:
            return None
        sites = [
            "site",
            *(f"site_{k}" for k in range(1, self.sites or 1)),
            *[COMPONENT] * (self.components > 0),
        ]
        return [
            word for own in (before + after).split() for word in (sites if own == "site" else [own])
        ]

    def lanes_last(self, x: np.ndarray, own: int | None) -> tuple[np.ndarray, bool]:
        """An array of so many axes of its own with its lanes at the end, and whether it has any."""
        first, shape, behind = self.first, x.shape, x.ndim - len(self.lanes) + self.first
        if not self.lanes or behind < first or x.ndim == own:
            return x, False
        if (*shape[:first], *shape[behind:]) != self.lanes:
            return x, False
        return np.moveaxis(x, range(first), range(behind - first, behind)), True


def lanes_of(mark: Any, space: tuple[int, int] | None) -> tuple[tuple[int, ...], int] | None:
    """The lanes' shape and how many of their axes lead, from a lattice's mark, which has one entry for all sites."""
    own = None if space is None else space[0] + (space[1] > 0)
    shape = np.shape(mark)
    if own is None or len(shape) < own:
        return None
    places = [
        first for first in range(len(shape) - own, -1, -1) if set(shape[first : first + own]) <= {1}
    ]
    return ((*shape[: places[0]], *shape[places[0] + own :]), places[0]) if places else None


def along_waves(result: Any) -> dict[str, Held]:
    """The fields of bands with as many axes for the wave as `k` has: none where it is one number."""
    lanes = lanes_of(result._mark, result._space)
    count = result.omega.ndim - 1 - len(lanes[0] if lanes else ())
    wave = " ".join(["wave", *(f"wave_{i}" for i in range(1, count))][:count])
    return {
        name: held if held.axes is None else held._replace(axes=held.axes.replace("wave", wave))
        for name, held in result._described.items()
    }


def laid(
    axes: str, name: str, x: np.ndarray, layout: Layout, lanes: tuple[str, ...], site: str = "site"
) -> tuple[list[str], np.ndarray]:
    """Names of an array's axes, those that its result tells, then lanes, and the array in their order."""
    words = layout.words(axes)
    own = None if words is None else len(words)
    x, batched = layout.lanes_last(x, own)
    count = x.ndim - batched * len(lanes)
    named = words if count == own else _counted(axes, name, count)
    named = [
        word.replace("site", site, 1) if word.partition("_")[0] == "site" else word
        for word in named
    ]
    return [*named, *(lanes if batched else ())], x


def _counted(axes, name, count):
    """As many names as there are axes; those that the table does not name are `NAME_k`, behind sites `site_k`."""
    first, _, last = (part.split() for part in axes.partition("..."))
    first = first[: max(count - len(last), 0)]
    between = range(len(first), count - len(last))
    more = [
        f"site_{k - len(first) + 1}" if first[-1:] == ["site"] else f"{name}_{k}" for k in between
    ]
    return first + more + last[len(last) - min(len(last), count) :]


def lanes_named(lanes: Mapping | None, shape: tuple[int, ...]) -> tuple[tuple[str, ...], dict]:
    """Names of the lanes' axes, and {name: (axes, values)} of the parameters that were swept.

    One parameter for each axis gives it its name; others, one value for each lane, stand along it.
    **Raises** ValueError where they do not fit the lanes.
    """
    plain = (LANE, *(f"{LANE}_{k}" for k in range(1, len(shape))))[: len(shape)]
    if lanes is None:
        return plain, {}
    if not shape:
        refuse("lanes", "a result of a batch", "one of a single scene", "Leave lanes= out.")
    values = {str(name): _values(name, x) for name, x in lanes.items()}
    sizes = tuple(x.shape for x in values.values())
    if sizes == tuple((n,) for n in shape):
        names = tuple(values)
        return names, {name: ((name,), x) for name, x in values.items()}
    if values and all(size == shape for size in sizes):
        return plain, {name: (plain, x) for name, x in values.items()}
    axes = (
        f"{len(shape)} axes of {' x '.join(map(str, shape))} lanes"
        if len(shape) > 1
        else f"{shape[0]} lanes"
    )
    got = ", ".join(f"{name} of shape {size}" for name, size in zip(values, sizes)) or "none"
    refuse(
        "lanes",
        f"names and values of {axes}",
        got,
        "One value for each lane: lanes={'ratio': ratios}.",
    )


def _values(name, x):
    if isinstance(name, str) and name and "/" not in name:
        array = np.asarray(x)
        if array.dtype == object and all(
            isinstance(word, str) for word in array.flat
        ):  # a column of a table
            array = array.astype(str)
        if array.ndim and array.dtype.kind in "biufU" and math.prod(array.shape):
            return array
        refuse(
            f"lanes[{name!r}]",
            "numbers or words, one for each lane",
            f"{array.dtype} of shape {array.shape}",
        )
    refuse("lanes", "names of parameters, without a slash", repr(name))


class Table:
    """Variables {name: (axes, array, units)} and attributes of a dataset, sizes of its axes, names of fields.

    `units` gives the attributes of a unit.
    """

    def __init__(
        self, layout: Layout, lanes: tuple[str, ...], units: Callable[[str], dict[str, str]]
    ):
        self.layout, self.lanes, self.units, self.fields = layout, lanes, units, []
        self.variables, self.attributes, self.doc = {}, {}, {}
        self.axes, self.own = dict(zip(lanes, layout.lanes)), set()

    def add(
        self, name: str, value: Any, held: Held, more: Mapping[str, Held] = MappingProxyType({})
    ) -> None:
        """What a field of a result holds: an array, or a dict or named tuple of such, `more` of whose parts."""
        self.doc = {"long_name": held.doc} if held.doc else {}
        for key, x in _arrays(name, value, "site" in (held.axes or "").split()):
            self.own |= {word for word in (held.axes or "").split() if word != "..."}
            unit = (
                MOTION.get(key[len(name) + 1 :][:1], "")
                if held.unit == STATE
                else more.get(key, held).unit
            )
            if isinstance(x, dict):
                self._over_fields(key, x, held.axes, unit)
            elif held.axes is not None and x.ndim or self.lanes and x.shape == self.layout.lanes:
                self._put(key, *laid(held.axes or "", key, x, self.layout, self.lanes), unit)
            else:
                parts = _parts(key, x.astype(int) if x.dtype == bool else x)
                # a list of one is one in netCDF
                self.attributes |= {
                    part: y.item() if y.size == 1 else y.tolist() for part, y in parts.items()
                }
                self.attributes |= {
                    f"{key}_{name}": told for name, told in self.units(unit).items()
                }

    def _over_fields(self, key, fields, over, unit):
        """Fields of one shape along an axis, others as variables of their own."""
        found = [
            laid(over, f"{key}_{field}", x, self.layout, self.lanes, f"site_{field}")
            for field, x in fields.items()
        ]
        alike = len({x.shape for x in fields.values()}) == 1 and self.fields in ([], [*fields])
        if not alike:
            for field, own in zip(fields, found):
                self._put(f"{key}_{field}", *own, unit)
            return
        self.fields = [*fields]
        axes, _ = laid(over, key, next(iter(fields.values())), self.layout, self.lanes)
        place = axes.index("site") if "site" in axes else 0
        stacked = np.stack([x for _, x in found], place)
        self._put(key, [*axes[:place], FIELD, *axes[place:]], stacked, unit)

    def _put(self, key, axes, x, unit):
        axes = [
            axis if self.axes.setdefault(axis, n) == n else f"{key}_{axis}"
            for axis, n in zip(axes, x.shape)
        ]
        self.axes |= dict(zip(axes, x.shape))
        for part, y in _parts(key, x).items():
            self.variables[part] = axes, y, self.units(unit) | self.doc

    def finished(self, swept: dict) -> tuple[dict, dict]:
        """Variables and coordinates, those of the lanes among them."""
        taken = {*swept} & ({*self.variables, *self.attributes, FIELD, COMPONENT} | self.own)
        if taken:
            refuse(
                "lanes",
                "names that nothing else in the result has",
                repr(min(taken)),
                "Call it otherwise.",
            )
        variables = {}
        for key, (axes, x, told) in self.variables.items():
            if key in self.axes and axes != [key]:
                key, axes, x = self._beside(key, axes, x)
            variables[key] = axes, x, told
        found = {
            axis: (axis, np.arange(n))
            for axis, n in self.axes.items()
            if axis.partition("_")[0] == "site"
        }
        found |= {FIELD: (FIELD, self.fields)} if self.fields else {}
        if COMPONENT in self.axes:
            found[COMPONENT] = COMPONENT, [*COMPONENTS[: self.axes[COMPONENT]]]
        return variables, {name: x for name, x in found.items() if name not in variables} | swept

    def _beside(self, key, axes, x):
        """A variable that has the name of an axis and other axes too: without the lanes where it is alike in them."""
        if [axis for axis in axes if axis not in self.lanes] == [key]:
            rows = np.moveaxis(x, axes.index(key), -1).reshape(-1, x.shape[axes.index(key)])
            if rows.size and np.array_equal(
                rows, np.broadcast_to(rows[0], rows.shape), equal_nan=x.dtype.kind == "f"
            ):
                return key, [key], rows[0]
        return f"{key}s", axes, x


def _parts(key, x):
    return {f"{key}_real": x.real, f"{key}_imag": x.imag} if x.dtype.kind == "c" else {key: x}


def _arrays(name: str, value: Any, over_sites: bool) -> Iterator[tuple[str, Any]]:
    """Names and arrays of a field, of what has none nothing. A dict over sites stays one."""
    if hasattr(value, "_asdict"):
        for key, x in value._asdict().items():
            yield from _arrays(f"{name}_{key}", x, over_sites)
    elif isinstance(value, dict):
        entries = {str(key): x for key, x in value.items()}
        found = {
            key: x for key, inner in entries.items() for _, x in _arrays(key, inner, over_sites)
        }
        if over_sites and found and found.keys() == entries.keys():
            yield name, found
        else:
            for key, x in entries.items():
                yield from _arrays(f"{name}_{key}", x, over_sites)
    elif isinstance(value, jax.core.Tracer):
        refuse(
            "result",
            "numbers",
            f"{name}, which is traced",
            "Call to_xarray outside of jit and vmap.",
        )
    elif isinstance(
        value, (jax.Array, np.ndarray, np.generic, int, float, complex, str, list, tuple)
    ):
        try:
            x = np.asarray(value)
        except ValueError:
            return
        if x.dtype.kind in "biufcU":
            yield name.replace("/", "_") or "_", x
