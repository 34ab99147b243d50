"""`Result`: the base of all results, with an outcome, named arrays with units, and files."""

import dataclasses
import sys
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, TypeAlias, get_args, get_origin

import equinox as eqx
import jax
import numpy as np

from .base.checks import refuse, traced
from .base.files import save
from .base.printing import text
from .base.programs import in_numpy
from .base.types import Values
from .base.units import SCALED, SI, Units
from .base.units.names import counted_in, known_unit, named_unit

if TYPE_CHECKING:
    import xarray  # half a second

COMPONENTS = ["x", "y", "z"]
FIELD = "field"
COMPONENT = "component"
LANE = "lane"


class Held(NamedTuple):
    """The metadata of a field of a result.

    - `axes`: names separated by spaces. `None` makes the field an attribute instead of a variable,
      and leaves out a nested result. A variable whose only axis has its name is a coordinate.
      `site` stands for all axes of a lattice: `site`, `site_1` on a grid, `component` of vectors,
      preceded by `field` if a cell holds several. Further axes are lanes, or called `NAME_k`; they
      stand at the dots ("site ... mode"), or at the end.
    - `unit`: in SI, or a dict by entry. `name`: in a file. `doc`: the description.
    - `hidden`: neither printed nor in a file.
    - `named`: the pattern of the names of dict entries that are fields of their own.
    """

    axes: str | None = ""
    unit: str | dict[str, str] = ""
    name: str = ""
    doc: str = ""
    hidden: bool = False
    named: str = ""

    def unit_of(self, entry: str) -> str:
        """Return the unit of an entry of a dict or named tuple."""
        return self.unit.get(entry, "") if isinstance(self.unit, dict) else self.unit


# the units of a `State`
MOTION = {"u": "m", "v": "m/s"}

Lanes: TypeAlias = dict[str, Values] | None
"""Names and values of the parameters that vary over the lanes of a batch; `None` for no names."""

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
    """Declare a field of a result, with its description, SI unit, axes, and name in a file.

    A named tuple may have a unit for each entry. Axes that are not given are taken from an
    annotation such as `Float[np.ndarray, "point mode"]`. `options` are those of `equinox.field`.
    """
    held = Held(axes, unit, name, doc)
    return eqx.field(metadata={"held": held, "annotated": axes is None}, **options)


def part(doc: str = "", axes: str | None = None, *, name: str = "", **options: Any) -> Any:
    """Declare a `State` or nested result; the field's name prefixes its variables."""
    return array(doc, MOTION, axes, name=name, **options)


def note(doc: str = "", unit: str = "", *, name: str = "", **options: Any) -> Any:
    """Declare a field that is an attribute of a dataset. Nested results and states are left out."""
    return eqx.field(metadata={"held": Held(None, unit, name, doc)}, **options)


def hidden(doc: str = "", **options: Any) -> Any:
    """Declare a field that is neither printed nor in a dataset."""
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
    """Declare a dict of arrays, each a field of its own, with one unit for all or one by key.

    `named`, such as "stats_{}", gives the name of an entry in a file. It is NAME_KEY if another
    field has that name; NAME is `name` or that of the field. `doc` describes the dict.
    """
    held = Held(axes, unit, name, doc, named=named)
    return eqx.field(metadata={"held": held}, **options)


def _axes(hint: Any) -> str:
    words = getattr(hint, "dim_str", "").split()
    if words or not get_args(hint):
        return "" if "..." in words else " ".join(x for x in words if x[0] not in "*_123456789")
    return next(filter(None, map(_axes, get_args(hint))), "")


class Result(eqx.Module):
    """The result of a computation.

    `outcome` is a sentence on how the computation ended. Printing shows numbers, and arrays by
    shape and range. Reading (`outcome`, printing, datasets) uses NumPy arrays, so that it compiles
    nothing. `to_xarray()` returns the arrays with named axes, units and provenance; `save` writes
    them to a file.

    To write a new class:

    - Declare each field with its type and `= array("What it is.", "m/s", "time site")`; use `part`
      for a `State`, `note` for an attribute in a file, `entries` for a dict of fields.
    - Define `outcome`, as a field or a property. List in `exported` the properties that files have.
    - Override `_held` for metadata known only at run time, and `_rows` for another printed form.
    - Results of a lattice have its `_mark`, or a field `lattice`; if that is not in SI, files say
      "scaled" instead of a unit. Without either, units are unknown and files give none; a class
      that is always in SI sets `_else = SI`.

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
    # the units of a result without a mark: "SI" if its fields are in SI, `None` if unknown
    _else: ClassVar[str | None] = None
    # of its lattice: the mark of its units; the numbers of site axes and of vector components
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
            cls.outcome = property(lambda self: outcome.fget(in_numpy(self)), doc=outcome.__doc__)

    @property
    def units(self) -> str | None:
        """The units of the numbers, "SI" or "scaled"; `None` if unknown or traced."""
        mark, _ = self._origin
        return self._else if mark is None else counted_in(mark)

    @property
    def _origin(self):
        lattice = vars(self).get("lattice")
        if self._mark is None and getattr(lattice, "_mark", None) is not None:
            return lattice._mark, lattice.space
        return self._mark, self._space

    def __repr__(self) -> str:
        if traced(self):
            return f"{type(self).__name__}(traced)"
        rows = list(in_numpy(self)._rows())
        width = max(15, 1 + max(len(name) for name, _ in rows))
        return "\n".join(f"{name:<{width}}{value}" for name, value in rows)

    def _rows(self) -> Iterator[tuple[str, str]]:
        for name, value, held in self._fields():
            yield name.replace("_", " "), text(value, self._unit(held))
        yield "outcome", self.outcome

    def _told(self, name: str, value: object) -> str:
        return text(value, self._unit(self._described[name]))

    def _unit(self, held: Held) -> str:
        if isinstance(held.unit, dict):
            return ""
        unit = _said(self.units, None, held.unit)[1].get("units", "")
        return "" if unit == SCALED else unit

    def _held(self, name: str) -> Held:
        return self._described.get(name, Held())

    def _fields(self) -> Iterator[tuple[str, Any, Held]]:
        # Yield the name, value and metadata of each shown field but `outcome`.
        taken = {"outcome"}
        dicts = []
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
        """Return the arrays as an `xarray.Dataset`, with the rest and versions as attributes.

        - Sites: `site` is a coordinate. Vectors have an axis `component`, "x", "y". Fields of a
          cell lie along `field` if they have one shape, else in NAME_FIELD over `site_FIELD`.
        - Lanes of a batch: an axis `lane`, or named by `lanes`, as in
          `run.to_xarray(lanes={"ratio": ratios})`: one parameter for each axis, or several of the
          shape of the batch.
        - Names: dicts give NAME_KEY, complex numbers NAME_real and NAME_imag, nested results
          NAME_VARIABLE, tuples of records NAME_FIELD for their numbers and words.
        - Units: the attribute `units` of each variable and of the dataset. Scaled numbers have
          "scaled", and `si_units`, the unit to which a `gx.Units` converts them.

        **Raises** ValueError if the result is traced, or `lanes` do not fit the batch.
        """
        return in_numpy(self)._dataset(lanes, self.units, _said)

    def _dataset(self, lanes, counted, count, outer=(None, None)):
        """Return the dataset. `counted`: "SI" or "scaled". `count` converts units.

        `outer`: the mark and the layout of the enclosing result.
        """
        if traced(self):
            refuse("result", "numbers", "traced ones", "Call to_xarray outside of jit and vmap.")
        fields = list(self._fields())
        arrays = [
            (x.shape, held.axes, held.name or name)
            for name, x, held in fields
            if held.axes is not None and isinstance(x, np.ndarray)
        ]
        # Lanes share a coordinate that has one axis, its own.
        others = [x for x in arrays if len(x[0]) != 1 or x[1] != x[2]]
        arrays = [x[:2] for x in others or arrays]
        mark, space = self._origin
        mark = outer[0] if mark is None else mark
        layout = _layout(arrays, mark, space or (outer[1] and outer[1].space), lanes)
        alike = outer[1] is None or layout.lanes == outer[1].lanes
        table = _Table(layout, lanes if alike else None, partial(count, counted))
        types = {field.name: field.type for field in dataclasses.fields(self)}
        within = {}
        for field, x, held in fields:
            name = held.name or field
            records = _records(types.get(field), x)
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
        """Return `to_xarray(lanes=lanes)` with other units.

        - `run.in_units("us", "mm/s")` converts quantities with the dimensions of these units;
          the others stay in SI. "kHz" converts angular frequencies, and densities over them, to cycles.
        - `run.in_units(units)` with a `gx.Units` converts scaled numbers to SI, and SI to scaled
          ones. `run.in_units(units, "us")` converts scaled numbers to SI and then to "us".
        - `peaks.in_units("SI", "us")` states "SI" or "scaled" for a result of unknown units.

        Variables without a unit, such as user-defined records, stay unchanged; their attribute
        `units` says so if they differ from the rest.

        **Raises** ValueError for unit names that are unknown or match no variable, for unit names
        without a `gx.Units` on scaled numbers, and for a result of unknown units.
        """
        if not units:
            return self.to_xarray(lanes=lanes)
        kinds = [x for x in units if isinstance(x, str) and x in (SI, SCALED)]
        # NumPy, since JAX would compile each power.
        sizes = [jax.tree.map(np.asarray, x) for x in units if isinstance(x, Units)]
        words = [named_unit(x) for x in units if isinstance(x, str) and x not in kinds]
        # "Hz" also makes a density per rad/s one per Hz.
        chosen = [*words, *(per for x in words if x.dimension[3] and (per := x.inverse))]
        counted = self.units or next(iter(kinds), None)
        scaled = counted == SCALED
        asked = repr(units)
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
            word = next((word for word in chosen if word.dimension == known.dimension), known)
            return x * (size * known.size / word.size), {"units": word.name}

        data = in_numpy(self)._dataset(lanes, counted, count)
        left = [word.name for word in words if word.dimension not in seen]
        if left:
            expected = f"units of {', '.join(sorted(seen.values()))}"
            refuse("units", expected, ", ".join(map(repr, left)))
        if sizes or words:
            data.attrs["units"] = SCALED if sizes and not scaled else SI
        if sizes and "outcome" in data.attrs:
            data.attrs["outcome"] = f"In {counted} numbers: {data.attrs['outcome']}"
        return data

    def save(self, path: str | Path, *, lanes: Lanes = None) -> Path:
        """Write `to_xarray(lanes=lanes)` to a netCDF (`.nc`) or MATLAB (`.mat`, version 5) file.

        `xarray.load_dataset(path)` reads the netCDF file as the same dataset and verifies the
        checksums of its arrays; `gx.states.stored(lattice, data)` returns a state to continue from.
        MATLAB's `load` and `scipy.io.loadmat` read the `.mat` file: arrays by name, attributes in a
        struct `attributes`. Complex numbers are NAME_real and NAME_imag.

        **Returns:** the path.
        **Raises** ValueError for another extension, lanes that do not fit, or a path that is a
        folder or whose folder is missing; OSError if writing fails. An existing file then stays.
        """
        return save(self.to_xarray(lanes=lanes), path)


def _in_brackets(held):
    units = held.unit
    if isinstance(units, dict):
        units = "" if held.named else ", ".join(units.values())
    return (f" ({held.axes})" if held.axes else "") + (f" [{units}]" if units else "")


def _said(counted, x, unit):
    # Return the numbers, and attributes that state their unit; none if it is unknown.
    known = known_unit(unit)
    if known is None or not any(known.dimension) or counted == SI:
        return x, {"units": unit} if unit else {}
    return x, {"units": SCALED, "si_units": unit} if counted == SCALED else {}


def _records(hint: object, value: object) -> dict[str, np.ndarray] | None:
    # Return arrays of the numbers and words in a tuple of records; `None` for other types.
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
    """Merge the dataset of a nested result, with variables NAME_VARIABLE.

    Site axes and common axes are shared if lengths and coordinates agree.
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
    """The layout of the arrays of a result.

    - `space`: the numbers of site axes and of vector components; `None` if unknown.
    - `lanes`: the shape of the batch. Its `first` axes lead (as in `jax.vmap`), the others come
      last.
    """

    space: tuple[int, int] | None
    lanes: tuple[int, ...] = ()
    first: int = 0

    def words(self, axes: str) -> tuple[list[str], bool]:
        """Return the names of an array's axes without lanes, and whether they are complete."""
        named = []
        every = True
        for word in axes.split():
            named.append(word)
            if word == "...":
                every = any(map(_is_site, named))
            elif _is_site(word) and self.space is not None:
                sites, components = self.space
                named += [f"{word}_{k}" for k in range(1, sites)] + [COMPONENT] * (components > 0)
        return named, every and (self.space is not None or not any(map(_is_site, named)))

    def beyond(self, shape: tuple[int, ...], axes: str) -> int | None:
        """Return the number of axes beyond the array's own; `None` if unknown."""
        words, every = self.words(axes)
        return len(shape) - len(words) + words.count("...") if every else None

    def around(self, shape: tuple[int, ...], axes: str) -> bool:
        behind = len(shape) - len(self.lanes) + self.first
        if not self.lanes or behind < self.first or self.beyond(shape, axes) == 0:
            return False
        return shape[: self.first] + shape[behind:] == self.lanes

    def named(self, shape: tuple[int, ...], axes: str, name: str, lanes: list[str]) -> list[str]:
        """Return names of all axes; unnamed ones are `NAME_k`, or `site_k` after a site axis."""
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
    """Find the layout of arrays.

    The lanes are the axes of the lattice's mark besides those of its sites. Without a mark they are
    the axes that all arrays have beyond their own, or if these are unknown, those in `lanes`.
    """
    plain = _Layout(space)
    mark = np.shape(mark)
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
    """Return the names of the lane axes, and {name: (axes, values)} of the swept parameters.

    One parameter per axis names it. Others have one value for each lane.
    """
    plain = [f"{LANE}_{k}" if k else LANE for k in range(len(shape))]
    if lanes is None:
        return plain, {}
    if not shape:
        refuse("lanes", "a result of a batch", "one of a single scene", "Leave lanes= out.")
    values = {str(name): np.asarray(x) for name, x in lanes.items()}
    # Columns of a pandas table have the type object.
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
    """A builder of a dataset, field by field. `cell`: the names along the axis `field`."""

    def __init__(self, layout, lanes, count):
        self.layout = layout
        self.count = count
        self.lanes, self.swept = _lanes_named(lanes, layout.lanes)
        self.sizes = dict(zip(self.lanes, layout.lanes))
        self.own = set()
        self.variables = {}
        self.attributes = {}
        self.cell = []

    def add(self, name, value, held):
        over_sites = "site" in (held.axes or "").split()
        if hasattr(value, "_asdict"):
            for key, x in value._asdict().items():
                self.add(f"{name}_{key}", x, held._replace(unit=held.unit_of(key)))
        elif isinstance(value, dict) and over_sites and self._alike(value):
            self.cell = [*value]
            arrays = [np.asarray(x) for x in value.values()]
            axes = self._axes(name, arrays[0].shape, held)
            place = axes.index("site")
            axes.insert(place, FIELD)
            self._put(name, np.stack(arrays, place), axes, held)
        elif isinstance(value, dict):
            for key, x in value.items():
                axes = held.axes.replace("site", f"site_{key}") if over_sites else held.axes
                self.add(f"{name}_{key}", x, held._replace(axes=axes))
        else:
            name = name.replace("/", "_") or "_"
            x = _numbers(value)
            if x is not None:
                self._put(name, x, self._axes(name, x.shape, held), held)

    def _alike(self, cell):
        # Return whether a cell fits one axis: equal shapes, and the names of earlier cells.
        return len({np.shape(x) for x in cell.values()}) == 1 and self.cell in ([], [*cell])

    def _axes(self, name, shape, held):
        axes = self.layout.named(shape, held.axes or "", name, self.lanes)
        self.own |= {*axes} - {*self.lanes}
        return axes

    def _put(self, name, x, axes, held):
        # Add an array as a variable, or as an attribute if it has neither axes nor lanes.
        parts = {name: x}
        if x.dtype.kind == "c":
            parts = {f"{name}_real": x.real, f"{name}_imag": x.imag}
        # Both parts have the same unit.
        for key, part in parts.items():
            parts[key], told = self.count(part, held.unit)
        if not x.ndim or held.axes is None and x.shape != self.layout.lanes:
            for key, y in parts.items():
                y = y.astype(int) if y.dtype == bool else y
                # netCDF reads a list of one number as a number.
                self.attributes[key] = y.item() if y.size == 1 else y.tolist()
            self.attributes |= {f"{name}_{key}": word for key, word in told.items()}
            return
        axes = [
            axis if self.sizes.setdefault(axis, n) == n else f"{name}_{axis}"
            for axis, n in zip(axes, x.shape)
        ]
        self.sizes |= dict(zip(axes, x.shape))
        for key, y in parts.items():
            # xarray writes the long name beside an axis.
            said = {"long_name": key.replace("_", " "), "description": held.doc} if held.doc else {}
            self.variables[key] = axes, y, told | said

    def finished(self, attributes):
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
                # Times by lane become the coordinate if all lanes have the same, else a variable
                # with another name.
                one = x.isel(dict.fromkeys(self.lanes, 0), missing_dims="ignore") if x.size else x
                key, x = (key, one) if one.dims == (key,) and (x == one).all() else (f"{key}s", x)
            variables[key] = x
        coordinates = {key: x for key, x in coordinates.items() if key not in variables}
        return xarray.Dataset(variables, coordinates | self.swept, self.attributes | attributes)


def _numbers(value):
    try:
        x = np.asarray(value)
    except ValueError:
        return None
    return x if x.dtype.kind in "biufcU" else None
