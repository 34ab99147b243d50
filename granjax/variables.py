"""The arrays of results as variables of a dataset, whose axes are named: sites, fields, components, lanes."""

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from .checks import refuse

if TYPE_CHECKING:
    import xarray  # half a second

COMPONENTS = ["x", "y", "z"]
FIELD, COMPONENT, LANE = "field", "component", "lane"


class Held(NamedTuple):
    """What a field of a result is: its axes, words with a space between; its unit; its name in a file; its description.

    `axes=None` makes an attribute of it instead of a variable, and leaves out a result within. A variable of the one
    axis that has its name is a coordinate. `site` stands for all axes of a lattice: `site`, `site_1` on a grid,
    `component` of vectors, and `field` before them where a cell holds several. Axes beyond those named are lanes, or
    called `NAME_k`. Axes that are not named stand where the dots do ("site ... mode"), or at the end. What is `hidden`
    is neither printed nor in a file. `named`: how the entries of a dict are called that are fields of their own.
    """

    axes: str | None = ""
    unit: str | dict[str, str] = ""
    name: str = ""
    doc: str = ""
    hidden: bool = False
    named: str = ""

    def unit_of(self, entry: str) -> str:
        """The unit of an entry of a dict or of a named tuple, by its name."""
        return self.unit.get(entry, "") if isinstance(self.unit, dict) else self.unit


class Layout(NamedTuple):
    """How the arrays of a result lie.

    `space`: how many axes count sites, and components of a vector at each; `None` where nobody knows. `lanes`: the
    shape of a batch, of whose axes `first` lead all others (as `jax.vmap` has them) and the others come last.
    """

    space: tuple[int, int] | None = None
    lanes: tuple[int, ...] = ()
    first: int = 0

    def words(self, axes: str) -> list[str] | None:
        """The names of an array's own axes, without lanes; `None` where their number is not known."""
        before, dots, _ = axes.partition("...")
        over_sites = any(map(_is_site, before.split()))
        if over_sites and self.space is None or dots and not over_sites:
            return None
        named = []
        for word in axes.replace("...", "").split():
            named.append(word)
            if _is_site(word):
                sites, components = self.space
                named += [f"{word}_{k}" for k in range(1, sites)] + [COMPONENT] * (components > 0)
        return named

    def beyond(self, shape: tuple[int, ...], axes: str) -> int | None:
        """How many axes an array has beside its own ones; `None` where that is not known."""
        words = self.words(axes)
        return None if words is None else len(shape) - len(words)

    def batched(self, shape: tuple[int, ...], axes: str) -> bool:
        """Whether an array of these axes has the lanes beside its own ones."""
        behind = len(shape) - len(self.lanes) + self.first
        if not self.lanes or behind < self.first or self.beyond(shape, axes) == 0:
            return False
        return (*shape[: self.first], *shape[behind:]) == self.lanes

    def fits(self, arrays: list[tuple[tuple[int, ...], str]]) -> bool:
        """Whether each array has its own axes alone, or the lanes beside them."""
        return all(self.batched(*array) or self.beyond(*array) == 0 for array in arrays)


def _is_site(word):
    return word.partition("_")[0] == "site"


def layout_of(
    arrays: list[tuple[tuple[int, ...], str]],
    mark: Any,
    space: tuple[int, int] | None,
    lanes: Mapping | None = None,
) -> Layout:
    """How arrays of such shapes and axes lie.

    Lanes are what the mark of their lattice has beside one entry for all sites. Without a mark they are what all arrays
    of a known number of axes have beyond those, or what is named in `lanes`. Of several ways the first is taken that
    all arrays fit.
    """
    plain, shape, by_mark = Layout(space), np.shape(mark), []
    if space is not None:
        own = space[0] + (space[1] > 0)
        by_mark = [
            Layout(space, shape[:k] + shape[k + own :], k)
            for k in range(len(shape) - own, -1, -1)
            if set(shape[k : k + own]) <= {1}
        ]
    ways = by_mark
    if not by_mark:
        more = {n: x for x, axes in arrays if (n := plain.beyond(x, axes)) is not None}
        if len(more) == 1:
            [(count, one)] = more.items()
            count = max(count, 0)
            ways = [Layout(space, one[len(one) - count :]), Layout(space, one[:count], count)]
        elif not more and arrays and lanes:
            ways = [Layout(space, tuple(map(np.size, lanes.values())))]
    return next((way for way in ways if way.fits(arrays)), by_mark[0] if by_mark else plain)


def lanes_named(lanes: Mapping | None, shape: tuple[int, ...]) -> tuple[tuple[str, ...], dict]:
    """Names of the lanes' axes, and {name: (axes, values)} of the parameters that were swept.

    One parameter for each axis gives it its name; others, one value for each lane, stand along it.
    **Raises** ValueError where they do not fit the lanes.
    """
    plain = tuple(f"{LANE}_{k}" if k else LANE for k in range(len(shape)))
    if lanes is None:
        return plain, {}
    if not shape:
        refuse("lanes", "a result of a batch", "one of a single scene", "Leave lanes= out.")
    values = {str(name): np.asarray(x) for name, x in lanes.items()}
    # columns of a table
    values = {name: x.astype(str) if x.dtype == object else x for name, x in values.items()}
    sizes = tuple(x.shape for x in values.values())
    if sizes == tuple((n,) for n in shape):
        return tuple(values), {name: ((name,), x) for name, x in values.items()}
    if values and set(sizes) == {shape}:
        return plain, {name: (plain, x) for name, x in values.items()}
    axes = " x ".join(map(str, shape))
    got = ", ".join(f"{name} of shape {size}" for name, size in zip(values, sizes)) or "none"
    remedy = "One value for each lane: lanes={'ratio': ratios}."
    refuse("lanes", f"names and values of {axes} lanes", got, remedy)


class Table:
    """A dataset in the making, which is filled field by field.

    `converted(x, unit)` gives the numbers that are kept, and attributes that say their unit; `cell`: fields along one
    axis.
    """

    def __init__(self, layout: Layout, lanes: Mapping | None, converted: Callable):
        self.layout, self.converted = layout, converted
        self.lanes, self.swept = lanes_named(lanes, layout.lanes)
        self.sizes, self.own = dict(zip(self.lanes, layout.lanes)), set()
        self.variables, self.attributes, self.cell = {}, {}, []

    def add(self, name: str, value: Any, held: Held) -> None:
        """What a field of a result holds: an array, or a dict or named tuple of such."""
        over_sites = "site" in (held.axes or "").split()
        if hasattr(value, "_asdict"):
            for key, x in value._asdict().items():
                self.add(f"{name}_{key}", x, held._replace(unit=held.unit_of(key)))
        elif isinstance(value, dict) and over_sites and self._alike(value):
            self.cell, arrays = [*value], [np.asarray(x) for x in value.values()]
            axes = self._axes(name, arrays[0].shape, held)
            place = axes.index("site")
            axes.insert(place, FIELD)
            self._put(name, np.stack(arrays, place), axes, held)
        elif isinstance(value, dict):
            for key, x in value.items():
                axes = held.axes.replace("site", f"site_{key}", 1) if over_sites else held.axes
                self.add(f"{name}_{key}", x, held._replace(axes=axes))
        else:
            name, x = name.replace("/", "_") or "_", _numbers(value)
            if x is not None:
                self._put(name, x, self._axes(name, x.shape, held), held)

    def _alike(self, cell):
        """Whether the fields of a cell lie along one axis: all have one shape, and are those of others."""
        return len({np.shape(x) for x in cell.values()}) == 1 and self.cell in ([], [*cell])

    def _axes(self, name, shape, held):
        """The name of every axis of an array, the lanes' where they are."""
        axes, lanes, first = held.axes or "", [*self.lanes], self.layout.first
        batched, words = self.layout.batched(shape, axes), self.layout.words(axes)
        count = len(shape) - len(lanes) * batched
        if words is None or len(words) != count:
            words = _counted(axes, name, count)
        self.own |= {*words}
        return [*lanes[:first], *words, *lanes[first:]] if batched else words

    def _put(self, name, x, axes, held):
        """An array as a variable, or where it has neither axes nor lanes as an attribute."""
        x, told = self.converted(x, held.unit)
        if not x.ndim or held.axes is None and x.shape != self.layout.lanes:
            x = x.astype(int) if x.dtype == bool else x
            # a list of one is one in netCDF
            parts = {key: y.item() if y.size == 1 else y.tolist() for key, y in _parts(name, x)}
            told = {f"{name}_{key}": word for key, word in told.items()} if held.unit else {}
            self.attributes |= parts | told
            return
        axes = [
            axis if self.sizes.setdefault(axis, n) == n else f"{name}_{axis}"
            for axis, n in zip(axes, x.shape)
        ]
        self.sizes |= dict(zip(axes, x.shape))
        told |= {"long_name": held.doc} if held.doc else {}
        self.variables |= {key: (axes, y, told) for key, y in _parts(name, x)}

    def finished(self, attributes: dict[str, Any]) -> "xarray.Dataset":
        """The dataset, lanes last, with its coordinates and further attributes."""
        import xarray

        taken = {*self.swept} & {*self.variables, *self.attributes, *self.own, FIELD, COMPONENT}
        if taken:
            rest = repr(min(taken)), "Call it otherwise."
            refuse("lanes", "names that nothing else in the result has", *rest)
        labels = {FIELD: self.cell, COMPONENT: COMPONENTS}
        coordinates = {
            axis: (axis, labels.get(axis, np.arange(n))[:n])
            for axis, n in self.sizes.items()
            if _is_site(axis) or axis in labels
        }
        variables = {}
        for key, told in self.variables.items():
            x = xarray.Variable(*told).transpose(..., *self.lanes, missing_dims="ignore")
            if key in self.sizes and x.dims != (key,):
                # times of each lane: one clock where all lanes have the same, else beside the axis of that name
                one = x.isel(dict.fromkeys(self.lanes, 0), missing_dims="ignore") if x.size else x
                key, x = (key, one) if one.dims == (key,) and (x == one).all() else (f"{key}s", x)
            variables[key] = x
        coordinates = {key: x for key, x in coordinates.items() if key not in variables}
        return xarray.Dataset(variables, coordinates | self.swept, self.attributes | attributes)


def _counted(axes, name, count):
    """As many names as there are axes; those that are not told are `NAME_k`, behind sites `site_k`."""
    first, _, last = (part.split() for part in axes.partition("..."))
    first = first[: max(count - len(last), 0)]
    site = first[-1] if first and _is_site(first[-1]) else None
    between = range(len(first), count - len(last))
    more = [f"{site}_{k - len(first) + 1}" if site else f"{name}_{k}" for k in between]
    return first + more + last[len(last) - min(len(last), count) :]


def _parts(name, x):
    if x.dtype.kind != "c":
        return [(name, x)]
    return [(f"{name}_real", x.real), (f"{name}_imag", x.imag)]


def _numbers(value):
    """Numbers or words as an array, `None` of what is neither."""
    try:
        x = np.asarray(value)
    except ValueError:
        return None
    return x if x.dtype.kind in "biufcU" else None
