"""`Result`: what every record of the library is: an outcome, text for reading, named arrays with units, files."""

import dataclasses
import sys
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, TypeAlias, get_args, get_origin

import equinox as eqx
import jax
import numpy as np

from .checks import refuse, traced
from .files import save
from .printing import text
from .types import Values
from .units import SCALED, SI, Units
from .units.names import counted_in, known_unit, named_unit

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


# the units of a `State`
MOTION = {"u": "m", "v": "m/s"}

Lanes: TypeAlias = dict[str, Values] | None
"""The parameters that the lanes of a batch were swept over, by name, `None` where they have no names."""

SAY = (
    "Say it where it is made, as in spectrum(..., units=run.units), or here, in_units('SI', 'us')."
)
LEAD = (
    "Give the Units that leads back to SI beside it, gx.Units() where the numbers are those of SI, or say so "
    "of the lattice: lattice.counted_in('SI'), gx.Lattice(..., units='SI')."
)


def array(
    doc: str = "",
    unit: str | dict[str, str] = "",
    axes: str | None = None,
    *,
    name: str = "",
    **options: Any,
) -> Any:
    """A field of a result: its description, its unit in SI, its axes, its name in a file if it has another there.

    A named tuple may have a unit for each of its entries.

    Axes are read off an annotation that names them, `Float[np.ndarray, "point mode"]`, where they are not given.
    `options` are those of `equinox.field`.
    """
    held = Held(axes, unit, name, doc)
    return eqx.field(metadata={"held": held, "annotated": axes is None}, **options)


def part(doc: str = "", axes: str | None = None, *, name: str = "", **options: Any) -> Any:
    """A field that is a `State`, or a result within, whose variables have the name of the field in front."""
    return array(doc, MOTION, axes, name=name, **options)


def note(doc: str = "", unit: str = "", *, name: str = "", **options: Any) -> Any:
    """A field that a dataset has as an attribute, whatever its shape; results and states within are left out."""
    return eqx.field(metadata={"held": Held(None, unit, name, doc)}, **options)


def hidden(doc: str = "", **options: Any) -> Any:
    """A field that is neither printed nor in a dataset."""
    return eqx.field(metadata={"held": Held(doc=doc, hidden=True)}, **options)


def entries(
    doc: str = "",
    unit: str | dict[str, str] = "",
    axes: str = "",
    *,
    named: str = "{}",
    name: str = "",
    **options: Any,
) -> Any:
    """A dict of arrays, each of them a field of its own, with one unit for all or one by key.

    A file calls an entry by `named`, "stats_{}", or NAME_KEY where another field has that name already; NAME is the
    field's own where it is not given. The description is that of the dict.
    """
    held = Held(axes, unit, name, doc, named=named)
    return eqx.field(metadata={"held": held}, **options)


def _axes(hint: Any) -> str:
    """The axes that an annotation names, without lanes."""
    words = getattr(hint, "dim_str", "").split()
    if words or not get_args(hint):
        return "" if "..." in words else " ".join(x for x in words if x[0] not in "*_123456789")
    return next(filter(None, map(_axes, get_args(hint))), "")


class Result(eqx.Module):
    """What a computation returns.

    `outcome` says in a sentence what became of it. Printing shows numbers as numbers and arrays by shape and range.
    What is read (`outcome`, what is printed, a dataset) is made of NumPy's arrays: reading compiles and runs nothing.
    `to_xarray()` gives the arrays with named axes, units and where they come from; `save` writes them to a file.

    To add one: fields with their types, each `= array("What it is.", "m/s", "time site")` (a `State`: `part`, what is
    an attribute in a file: `note`, a dict of fields: `entries`), and `outcome`, a field or a property; properties that
    a file has too are named in `exported`. What only the result itself knows of a field, it says in `_held`; a class
    that is printed in another way than field by field gives its rows in `_rows`. What comes from a lattice has its
    `_mark`, or it as a field `lattice`: where that is not in SI, files say "scaled" in place of a unit. What has
    neither is counted in what nobody knows, and files give no units; a class that is always in SI says so by
    `_else = SI`.

    **Example:**

    >>> chain = gx.scenes.monomer(20)
    >>> run = gx.simulate(chain, gx.states.impact(chain), 5.0, step=0.05, save_at=11)
    >>> isinstance(run, gx.Result), run.outcome
    (True, 'Completed at t = 5 after 100 steps.')
    >>> dict(run.to_xarray().sizes)
    {'time': 11, 'site': 20}
    """

    outcome: eqx.AbstractVar[str]
    exported: ClassVar[dict[str, Held]] = {}
    # what a result without a mark is counted in, "SI" where its fields say their units so; `None` where nobody knows
    _else: ClassVar[str | None] = None
    # of the lattice that it comes from: its units; axes that count sites, and components of a vector at each
    _mark: Any = eqx.field(default=None, kw_only=True, repr=False)
    _space: tuple[int, int] | None = eqx.field(static=True, kw_only=True, default=None)

    def __init_subclass__(cls, **keywords):
        super().__init_subclass__(**keywords)
        own = {}
        for name, hint in vars(cls).get("__annotations__", {}).items():
            told = getattr(vars(cls).get(name), "metadata", {})
            if "held" in told:
                held = told["held"]
                own[name] = held._replace(axes=_axes(hint)) if told.get("annotated") else held
        inherited = getattr(cls, "_described", {})
        inherited = {name: held for name, held in inherited.items() if name not in own}
        cls._described = {**inherited, **own, **cls.exported}
        rows = [
            f"- `{name}`{_in_brackets(held)}: {held.doc}"
            for name, held in cls._described.items()
            if held.doc
        ]
        if rows:
            cls.__doc__ = "\n    ".join([f"{cls.__doc__ or ''}\n", "**Fields:**", "", *rows, ""])
        outcome = vars(cls).get("outcome")
        if isinstance(outcome, property):
            cls.outcome = property(lambda self: outcome.fget(_by_numpy(self)), doc=outcome.__doc__)

    @property
    def units(self) -> str | None:
        """What its numbers are counted in, "SI" or "scaled"; `None` where nobody said so, or while traced."""
        mark, _ = self._origin
        return self._else if mark is None else counted_in(mark)

    @property
    def _origin(self):
        """The mark and the space of the lattice that it comes from."""
        lattice = vars(self).get("lattice")
        if self._mark is None and getattr(lattice, "_mark", None) is not None:
            return lattice._mark, lattice.space
        return self._mark, self._space

    def __repr__(self) -> str:
        if traced(self):
            return f"{type(self).__name__}(traced)"
        rows = list(_by_numpy(self)._rows())
        width = max(15, 1 + max(len(name) for name, _ in rows))
        return "\n".join(f"{name:<{width}}{value}" for name, value in rows)

    def _rows(self) -> Iterator[tuple[str, str]]:
        """Name and text of each line of what is printed."""
        for name, value, held in self._fields():
            yield name.replace("_", " "), text(value, self._unit(held))
        yield "outcome", self.outcome

    def _told(self, name: str, value: object) -> str:
        """A value of a field, with its unit."""
        return text(value, self._unit(self._described[name]))

    def _unit(self, held: Held) -> str:
        """The unit in which a field is counted; nothing where it is scaled."""
        if isinstance(held.unit, dict):
            return ""
        unit = _said(self.units, None, held.unit)[1].get("units", "")
        return "" if unit == SCALED else unit

    def _held(self, name: str) -> Held:
        """The description of a field."""
        return self._described.get(name, Held())

    def _fields(self) -> Iterator[tuple[str, Any, Held]]:
        """Name, value and description of what is shown and kept, without the outcome and what is not there."""
        taken, dicts = {"outcome"}, []
        for name in (*(field.name for field in dataclasses.fields(self)), *self.exported):
            held = self._held(name)
            if name == "outcome" or name[0] == "_" or held.hidden:
                continue
            value = getattr(self, name)
            if value is None:
                continue
            if held.named:
                dicts.append((held.name or name, value, held))
            else:
                taken |= {name, held.name}
                yield name, value, held
        for name, value, held in dicts:
            for key, x in value.items():
                called = held.named.format(key)
                called = f"{name}_{key}" if called in taken else called
                yield called, x, Held(held.axes, held.unit_of(key))

    def to_xarray(self, *, lanes: Lanes = None) -> "xarray.Dataset":
        """The arrays as an `xarray.Dataset`, with units; the rest, the versions and the outcome as attributes.

        Axes are called what they count. `site` is a coordinate; a cell's fields of one shape lie along `field`, others
        are variables of their own (NAME_FIELD over `site_FIELD`); vectors have a `component`, "x", "y". The lanes of a
        batch are an axis `lane`, or what `lanes` calls them: `run.to_xarray(lanes={"ratio": ratios})`, one parameter
        for each of their axes, or several of the shape of the batch.
        Other dicts give NAME_KEY for each array; complex numbers two, NAME_real and NAME_imag. A result within gives
        its variables as NAME_VARIABLE, a tuple of records arrays of their numbers and words, NAME_FIELD.
        Units are the attribute `units` of every variable and of the whole; scaled numbers have "scaled", and as
        `si_units` what a `gx.Units` leads back to.
        **Raises** ValueError where the result is traced, or `lanes` do not fit the batch.
        """
        return _by_numpy(self)._dataset(lanes, self.units, _said)

    def _dataset(self, lanes, counted, count, outer=(None, None)):
        """The dataset of numbers `counted` in SI or scaled, which `count` gives another unit.

        Of a result around it: its mark, how its arrays lie.
        """
        if traced(self):
            refuse("result", "numbers", "traced ones", "Call to_xarray outside of jit and vmap.")
        fields = list(self._fields())
        arrays = [
            (x.shape, held.axes)
            for _, x, held in fields
            if held.axes is not None and isinstance(x, np.ndarray)
        ]
        mark, space = self._origin
        mark = outer[0] if mark is None else mark
        layout = _layout(arrays, mark, space or (outer[1] and outer[1].space), lanes)
        alike = outer[1] is None or layout.lanes == outer[1].lanes
        table = _Table(layout, lanes if alike else None, partial(count, counted))
        types, within = {field.name: field.type for field in dataclasses.fields(self)}, {}
        for field, x, held in fields:
            name, records = held.name or field, _records(types.get(field), x)
            if isinstance(x, Result) or held.axes is None and hasattr(x, "_asdict"):
                within |= {} if held.axes is None else {name: x}
            elif records is not None:
                table.add(name, records, held._replace(axes=held.axes or name))
            else:
                table.add(name, x, held)
        origin = {"result": type(self).__name__, "outcome": self.outcome}
        origin |= {"units": counted} if counted else {}
        versions = {"granjax": sys.modules["granjax"].__version__, "jax": jax.__version__}
        data = table.finished(origin | versions)
        for name, x in within.items():
            inner = x._dataset(lanes, x.units or counted, count, (mark, layout))
            data = _joined(data, name, inner)
        return data

    def in_units(self, *units: str | Units, lanes: Lanes = None) -> "xarray.Dataset":
        """`to_xarray(lanes=lanes)` with its numbers counted in other units.

        `run.in_units("us", "mm/s")`: words, each for all that has its dimension; "kHz" turns an angular frequency into
        one of cycles. All else stays in SI. Scaled numbers come to SI by the `gx.Units` that leads there,
        `run.in_units(units)`, or to words, `run.in_units(units, "us")`; those in SI become scaled by a `gx.Units`
        alone. A variable without a unit, such as a user-defined record, stays as it is, and says so by `units` where
        that is not what all else is counted in. Of a result that does not say
        what it is counted in "SI" or "scaled" says it, `peaks.in_units("SI", "us")`.

        **Raises** ValueError for a word that nothing here takes or that is not known, for words of scaled numbers, and
        for units of what nobody has said.
        """
        if not units:
            return self.to_xarray(lanes=lanes)
        kinds = [x for x in units if isinstance(x, str) and x in (SI, SCALED)]
        # by NumPy, as for JAX each power is a program
        sizes = [jax.tree.map(np.asarray, x) for x in units if isinstance(x, Units)]
        words = [named_unit(x) for x in units if isinstance(x, str) and x not in kinds]
        counted = self.units or next(iter(kinds), None)
        scaled, asked = counted == SCALED, repr(units)
        if max(len(kinds), len(sizes)) > 1 or len({x.dimension for x in words}) < len(words):
            refuse("units", "one word for each dimension, and one Units at most", asked)
        if counted is None:
            got = f"a {type(self).__name__}, which does not"
            refuse("units", "units of a result that says what it is in", got, SAY)
        if scaled and not sizes and (words or SI in kinds):
            refuse("units", "None or 'scaled' for scaled numbers", asked, LEAD)
        if not scaled and (SCALED in kinds or sizes and words):
            expected = "units of numbers in SI: words, or a Units, which makes scaled ones of them"
            refuse("units", expected, asked)
        seen = {}

        def count(counted, x, unit):
            """Numbers in the units that are asked for, and attributes that say these."""
            x, told = _said(counted, x, unit)
            known = known_unit(unit)
            if known is None or not any(known.dimension):
                own = sizes and x.ndim and x.dtype.kind in "fc"
                return x, told or ({"units": counted} if own else {})
            seen[known.dimension] = unit
            if counted == SCALED and not sizes:
                return x, told
            size = float(sizes[0].of(*map(float, known.dimension[:3]))) if sizes else 1.0
            if sizes and counted == SI:
                return x / size, {"units": SCALED, "si_units": unit}
            word = next((word for word in words if word.dimension == known.dimension), known)
            return x * (size * known.size / word.size), {"units": word.name}

        data = _by_numpy(self)._dataset(lanes, counted, count)
        left = [word.name for word in words if word.dimension not in seen]
        if left:
            expected = f"units of {', '.join(sorted(seen.values()))}"
            refuse("units", expected, ", ".join(map(repr, left)))
        if sizes or words:
            data.attrs["units"] = SCALED if sizes and not scaled else SI
        return data

    def save(self, path: str | Path, *, lanes: Lanes = None) -> Path:
        """Write `to_xarray(lanes=lanes)` to a file: netCDF (`.nc`) or MATLAB (`.mat`, version 5).

        `xarray.load_dataset(path)` reads the netCDF file back as the same dataset, with names, units and versions, and
        checks the sums that the file holds of its arrays; `gx.states.stored(lattice, data)` is a state of it to go on
        from. `load` of MATLAB and `scipy.io.loadmat` read the `.mat` file: arrays by name, and attributes in a struct
        `attributes`. Complex numbers are NAME_real and NAME_imag.

        **Returns:** the path. **Raises** ValueError for another ending, for lanes that do not fit, and where nothing
        can be written; OSError where writing fails. What was there before stays then.
        """
        return save(self.to_xarray(lanes=lanes), path)


def _in_brackets(held):
    """Axes and unit of a field, as its row in a docstring has them."""
    units = held.unit
    if isinstance(units, dict):
        units = "" if held.named else ", ".join(units.values())
    return (f" ({held.axes})" if held.axes else "") + (f" [{units}]" if units else "")


def _by_numpy(result):
    """The same with NumPy's arrays in place of JAX's, but for those that are traced."""
    known = lambda x: isinstance(x, jax.Array) and not isinstance(x, jax.core.Tracer)
    return jax.tree.map(lambda x: np.asarray(x) if known(x) else x, result)


def _said(counted, x, unit):
    """Numbers counted in SI or scaled, and attributes that say their unit; none where nobody knows."""
    known = known_unit(unit)
    if known is None or not any(known.dimension) or counted == SI:
        return x, {"units": unit} if unit else {}
    return x, {"units": SCALED, "si_units": unit} if counted == SCALED else {}


def _records(hint: object, value: object) -> dict[str, np.ndarray] | None:
    """Arrays of the numbers and words that all records of a tuple have; `None` where its type is none of records."""
    kind = next(iter(get_args(hint)), None) if get_origin(hint) is tuple else None
    if not (isinstance(kind, type) and isinstance(value, tuple)):
        return None
    if not (issubclass(kind, Result) or hasattr(kind, "_asdict")):
        return None
    hints = {
        name: type_ for name, type_ in kind.__annotations__.items() if type_ in (str, int, float)
    }
    return {
        name: np.array([getattr(x, name) for x in value], type_) for name, type_ in hints.items()
    }


def _joined(data: "xarray.Dataset", name: str, inner: "xarray.Dataset") -> "xarray.Dataset":
    """A dataset with that of a result within: its variables as NAME_VARIABLE, on axes of their own but sites.

    Axes that both have are shared where they are as long and have the same coordinates.
    """
    shared = [
        x
        for x in inner.dims
        if inner.sizes[x] == data.sizes.get(x, inner.sizes[x])
        and (x in data.dims or x.startswith("site"))
        and (x not in inner.coords or x not in data.coords or inner[x].equals(data[x]))
    ]
    inner = inner.rename({x: f"{name}_{x}" for x in {*inner.variables, *inner.dims} - {*shared}})
    told = {
        f"{name}_{key}": x
        for key, x in inner.attrs.items()
        if key not in ("granjax", "jax", "units")
    }
    return data.merge(inner, combine_attrs="override").assign_attrs(told)


class _Layout(NamedTuple):
    """How the arrays of a result lie.

    `space`: how many axes count sites, and components of a vector at each; `None` where nobody knows. `lanes`: the
    shape of a batch, of whose axes `first` lead all others (as `jax.vmap` has them) and the others come last.
    """

    space: tuple[int, int] | None
    lanes: tuple[int, ...] = ()
    first: int = 0

    def words(self, axes: str) -> tuple[list[str], bool]:
        """The names of an array's own axes, without lanes, and whether these are all that there are."""
        named, every = [], True
        for word in axes.split():
            named.append(word)
            if word == "...":
                every = any(map(_is_site, named))
            elif _is_site(word) and self.space is not None:
                sites, components = self.space
                named += [f"{word}_{k}" for k in range(1, sites)] + [COMPONENT] * (components > 0)
        return named, every and (self.space is not None or not any(map(_is_site, named)))

    def beyond(self, shape: tuple[int, ...], axes: str) -> int | None:
        """How many axes an array has beside its own ones; `None` where that is not known."""
        words, every = self.words(axes)
        return len(shape) - len(words) + words.count("...") if every else None

    def around(self, shape: tuple[int, ...], axes: str) -> bool:
        """Whether the lanes stand around an array's own axes."""
        behind = len(shape) - len(self.lanes) + self.first
        if not self.lanes or behind < self.first or self.beyond(shape, axes) == 0:
            return False
        return shape[: self.first] + shape[behind:] == self.lanes

    def named(self, shape: tuple[int, ...], axes: str, name: str, lanes: list[str]) -> list[str]:
        """A name for every axis of an array; those that are not told are `NAME_k`, behind sites `site_k`."""
        around = self.around(shape, axes)
        count = len(shape) - len(lanes) * around
        words, _ = self.words(axes)
        place = words.index("...") if "..." in words else len(words)
        last = words[place + 1 :]
        first = words[: min(place, max(count - len(last), 0))]
        site = first[-1] if first and _is_site(first[-1]) else None
        between = [
            f"{site}_{k - len(first) + 1}" if site else f"{name}_{k}"
            for k in range(len(first), count - len(last))
        ]
        own = first + between + last[len(last) - min(len(last), count) :]
        return [*lanes[: self.first], *own, *lanes[self.first :]] if around else own


def _is_site(word):
    return word.partition("_")[0] == "site"


def _layout(arrays, mark, space, lanes):
    """How arrays of such shapes and axes lie.

    Lanes are what the mark of their lattice has beside one entry for all sites; without a mark what every array has
    beyond its own axes, or where no number of axes is known what `lanes` names.
    """
    plain, mark = _Layout(space), np.shape(mark)
    beyond = [(shape, plain.beyond(shape, axes)) for shape, axes in arrays]
    own = space and space[0] + (space[1] > 0)
    if space is not None and len(mark) >= own:
        count = len(mark) - own
        ways = [k for k in range(count + 1) if set(mark[k : k + own]) <= {1}]
        beyond.append((mark, count))
    else:
        counts = {n for _, n in beyond if n is not None}
        if lanes and not counts:
            return _Layout(space, tuple(map(np.size, lanes.values())))
        count = max(*counts, 0) if len(counts) == 1 else 0
        ways = [0, count]
    found = []
    for first in ways:
        ends = {x[:first] + x[len(x) - count + first :] for x, n in beyond if n == count}
        found += [_Layout(space, one, first) for one in ends if len(ends) == 1]
    return found[0] if found else plain


def _lanes_named(lanes, shape):
    """Names of the lanes' axes, and {name: (axes, values)} of the parameters that were swept.

    One parameter for each axis gives it its name; others, one value for each lane, stand along it.
    """
    plain = [f"{LANE}_{k}" if k else LANE for k in range(len(shape))]
    if lanes is None:
        return plain, {}
    if not shape:
        refuse("lanes", "a result of a batch", "one of a single scene", "Leave lanes= out.")
    values = {str(name): np.asarray(x) for name, x in lanes.items()}
    # columns of a table
    values = {name: x.astype(str) if x.dtype == object else x for name, x in values.items()}
    sizes = [x.shape for x in values.values()]
    if sizes == [(n,) for n in shape]:
        return [*values], {name: ((name,), x) for name, x in values.items()}
    if values and {*sizes} == {shape}:
        return plain, {name: (plain, x) for name, x in values.items()}
    axes = " x ".join(map(str, shape))
    got = ", ".join(f"{name} of shape {size}" for name, size in zip(values, sizes)) or "none"
    remedy = "One value for each lane: lanes={'ratio': ratios}."
    refuse("lanes", f"names and values of {axes} lanes", got, remedy)


class _Table:
    """A dataset in the making, which is filled field by field. `cell`: fields along one axis."""

    def __init__(self, layout, lanes, count):
        self.layout, self.count = layout, count
        self.lanes, self.swept = _lanes_named(lanes, layout.lanes)
        self.sizes, self.own = dict(zip(self.lanes, layout.lanes)), set()
        self.variables, self.attributes, self.cell = {}, {}, []

    def add(self, name, value, held):
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
        axes = self.layout.named(shape, held.axes or "", name, self.lanes)
        self.own |= {*axes} - {*self.lanes}
        return axes

    def _put(self, name, x, axes, held):
        """An array as a variable, or where it has neither axes nor lanes as an attribute."""
        parts = {name: x}
        if x.dtype.kind == "c":
            parts = {f"{name}_real": x.real, f"{name}_imag": x.imag}
        # both parts have one unit
        for key, part in parts.items():
            parts[key], told = self.count(part, held.unit)
        if not x.ndim or held.axes is None and x.shape != self.layout.lanes:
            for key, y in parts.items():
                y = y.astype(int) if y.dtype == bool else y
                # a list of one is one in netCDF
                self.attributes[key] = y.item() if y.size == 1 else y.tolist()
            self.attributes |= {f"{name}_{key}": word for key, word in told.items()}
            return
        axes = [
            axis if self.sizes.setdefault(axis, n) == n else f"{name}_{axis}"
            for axis, n in zip(axes, x.shape)
        ]
        self.sizes |= dict(zip(axes, x.shape))
        told |= {"long_name": held.doc} if held.doc else {}
        self.variables |= {key: (axes, y, told) for key, y in parts.items()}

    def finished(self, attributes):
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


def _numbers(value):
    """Numbers or words as an array, `None` of what is neither."""
    try:
        x = np.asarray(value)
    except ValueError:
        return None
    return x if x.dtype.kind in "biufcU" else None
