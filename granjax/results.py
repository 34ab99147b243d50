"""`Result`: what every record of the library is: an outcome, text for reading, named arrays with units, files."""

import dataclasses
import sys
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, TypeAlias, get_args, get_origin

import equinox as eqx
import jax
import numpy as np

from .checks import refuse, traced
from .files import save
from .printing import text
from .types import Values
from .units import SCALED, SI, Units
from .units import names as by_name
from .variables import STATE, Held, Layout, Table, lanes_named, lanes_of

if TYPE_CHECKING:
    import xarray  # half a second

Lanes: TypeAlias = dict[str, Values] | None
"""The parameters that the lanes of a batch were swept over, by name, `None` where they have no names."""


def array(
    doc: str = "", unit: str = "", axes: str | None = None, *, name: str = "", **options: Any
) -> Any:
    """A field of a result: its description, its unit in SI, its axes, its name in a file if it has another there.

    Axes are read off an annotation that names them, `Float[np.ndarray, "point mode"]`, where they are not given.
    `options` are those of `equinox.field`.
    """
    return eqx.field(metadata={"held": Held(axes, unit, name, doc)}, **options)


def part(doc: str = "", axes: str | None = None, *, name: str = "", **options: Any) -> Any:
    """A field that is a `State`, or a result within, whose variables have the name of the field in front."""
    return array(doc, STATE, axes, name=name, **options)


def note(doc: str = "", unit: str = "", *, name: str = "", **options: Any) -> Any:
    """A field that a dataset has as an attribute, whatever its shape; results and states within are left out."""
    return eqx.field(metadata={"held": Held(None, unit, name, doc), "note": True}, **options)


def _axes(hint: Any) -> str:
    """The axes that an annotation names, without lanes."""
    words = getattr(hint, "dim_str", "").split()
    if words or not get_args(hint):
        return "" if "..." in words else " ".join(x for x in words if x[0] not in "*_123456789")
    return next(filter(None, map(_axes, get_args(hint))), "")


class Result(eqx.Module):
    """What a computation returns.

    `outcome` says in a sentence what became of it. Printing shows numbers as numbers and arrays by shape and range.
    `to_xarray()` gives the arrays with named axes, units and where they come from; `save` writes them to a file.

    To add one: fields with their types, each `= array("What it is.", "m/s", "time site")` (a `State`: `part`, what is
    an attribute in a file: `note`), and `outcome`, a field or a property; properties that a file has too are named in
    `exported`. What comes from a lattice has its `_mark`, or it as a field
    `lattice`: where that is not in SI, files say "scaled" in place of a unit. What has neither is counted in what
    nobody knows, and files give no units; a class that is always in SI says so by `_else = SI`.

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
    # what a result without a mark is counted in, "SI" for what `held` says; `None` where nobody knows
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
                axes = told["held"].axes
                fixed = axes is not None or "note" in told
                own[name] = told["held"] if fixed else told["held"]._replace(axes=_axes(hint))
        cls._described = {**getattr(cls, "_described", {}), **own, **cls.exported}
        rows = [
            f"- `{name}`{f' ({x.axes})' if x.axes else ''}{f' [{x.unit}]' if x.unit else ''}: {x.doc}"
            for name, x in own.items()
            if x.doc
        ]
        if rows:
            cls.__doc__ = "\n    ".join([f"{cls.__doc__ or ''}\n", "**Fields:**", "", *rows, ""])

    @property
    def held(self) -> dict[str, Held]:
        """What each field is: axes, unit, name in a file, description."""
        return self._described

    @property
    def units(self) -> str | None:
        """What its numbers are counted in, "SI" or "scaled"; `None` where nobody said so, or while traced."""
        mark = self._known_mark
        return self._else if mark is None else by_name.counted_in(mark)

    @property
    def _known_mark(self):
        return (
            getattr(getattr(self, "lattice", None), "_mark", None)
            if self._mark is None
            else self._mark
        )

    def __repr__(self) -> str:
        if traced(self):
            return f"{type(self).__name__}(traced)"
        rows = list(self._rows())
        width = max(15, 1 + max(len(name) for name, _ in rows))
        return "\n".join(f"{name:<{width}}{value}" for name, value in rows)

    def _rows(self) -> Iterator[tuple[str, str]]:
        """Name and text of each line of what is printed."""
        for name, value in self._fields():
            yield name.replace("_", " "), self._told(name, value)
        yield "outcome", self.outcome

    def _told(self, name: str, value: object) -> str:
        """A value of a field, with its unit."""
        return text(value, self._unit(name))

    def _unit(self, name: str) -> str:
        """The unit in which a field is counted; nothing where it is scaled."""
        unit = _attributes(self.units, self.held.get(name, Held()).unit).get("units", "")
        return "" if unit in (SCALED, STATE) else unit

    def _fields(self) -> Iterator[tuple[str, object]]:
        """Names and values of the fields that are shown and kept, without the outcome and what is not there."""
        for name in (*(field.name for field in dataclasses.fields(self)), *self.exported):
            if name != "outcome" and name[0] != "_" and getattr(self, name) is not None:
                yield name, getattr(self, name)

    def _layout(self, fields: dict[str, object], space: tuple[int, int] | None) -> Layout:
        """How the arrays lie: lanes as its lattice's mark has them, else what all have beyond axes that are named.

        The latter come last, or first, as `jax.vmap` has them.
        """
        marked = lanes_of(self._known_mark, space)
        if marked is not None:
            return Layout(*space, *marked)
        known, over = [], []
        for name, held in self.held.items():
            if held.axes is not None and _is_array(fields.get(name)):
                plain = "site" not in held.axes and "..." not in held.axes
                (known if plain else over).append((np.shape(fields[name]), len(held.axes.split())))
        more = {len(shape) - own for shape, own in known}
        count = max(more.pop(), 0) if len(more) == 1 else 0
        last = {shape[len(shape) - count :] for shape, _ in known + over}
        first = {shape[:count] for shape, _ in known}
        if not count or len(last) == 1:
            return Layout(*(space or (None, 0)), last.pop() if count else ())
        return Layout(*(space or (None, 0)), *((first.pop(), count) if len(first) == 1 else ()))

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
        return self._dataset(lanes, self._space)

    def _dataset(self, lanes, space):
        import xarray

        fields = dict(self._fields())
        layout = self._layout(fields, space)
        if lanes is not None and not layout.lanes and layout.sites is None:
            # those that the user names, where they end all that has axes to spare
            sizes = tuple(np.size(x) for x in lanes.values())
            over = [
                np.shape(fields[field])
                for field, (axes, *_) in self.held.items()
                if axes is not None and _is_array(fields.get(field)) and _more(fields[field], axes)
            ]
            if over and all(len(x) > len(sizes) and x[-len(sizes) :] == sizes for x in over):
                layout = Layout(lanes=sizes)
        names, swept = lanes_named(lanes, layout.lanes)
        table = Table(layout, names, partial(_attributes, self.units))
        types, within = {field.name: field.type for field in dataclasses.fields(self)}, {}
        for field, value in fields.items():
            held = self.held.get(field, Held())
            name, records = held.name or field, _records(types.get(field), value)
            if isinstance(value, Result) or held.axes is None and hasattr(value, "_asdict"):
                within |= {} if held.axes is None else {name: value}
            elif (
                isinstance(value, dict)
                and value
                and all(isinstance(x, Result) for x in value.values())
            ):
                within |= {f"{name}_{key}".replace("/", "_"): x for key, x in value.items()}
            elif records is not None:
                table.add(name, records, held._replace(axes=held.axes or name))
            else:
                table.add(name, value, held, self.held)
        origin = {"result": type(self).__name__, "outcome": self.outcome}
        origin |= {"units": self.units} if self.units else {}
        versions = {"granjax": sys.modules["granjax"].__version__, "jax": jax.__version__}
        variables, coordinates = table.finished(swept)
        data = xarray.Dataset(variables, coordinates, table.attributes | origin | versions)
        for name, result in within.items():
            space = result._space or layout.space
            alike = result._layout(dict(result._fields()), space).lanes == layout.lanes
            own = (
                result
                if result._known_mark is not None
                else dataclasses.replace(result, _mark=self._known_mark)
            )
            data = _joined(data, name, own._dataset(lanes if alike else None, space))
        return data

    def in_units(self, *units: str | Units, lanes: Lanes = None) -> "xarray.Dataset":
        """`to_xarray(lanes=lanes)` with its numbers counted in other units.

        `run.in_units("us", "mm/s")`: words, each for all that has its dimension; "kHz" turns an angular frequency into
        one of cycles. All else stays in SI. Scaled numbers come to SI by the `gx.Units` that leads there,
        `run.in_units(units)`, or to words, `run.in_units(units, "us")`; those in SI become scaled by a `gx.Units`
        alone. What has no unit of its own, such as a record of yours, stays as it is, and says so by `units` where that
        is not what all else is counted in. Of a result that does not say
        what it is counted in "SI" or "scaled" says it, `peaks.in_units("SI", "us")`.

        **Raises** ValueError for a word that nothing here takes or that is not known, for words of scaled numbers, and
        for units of what nobody has said.
        """
        if units and self.units is None:
            return self._said(units).in_units(*units, lanes=lanes)
        counted = by_name.settled(units, self.units)
        data, taken = self.to_xarray(lanes=lanes), set()
        stays = {} if counted.sizes is None else {"units": counted.said}

        def converted(x, told):
            unit = told.get("si_units", told.get("units", ""))
            factor, name = counted.conversion(unit)
            taken.update(word.name for word in counted.words if word.name == name)
            own = {"units": name} | ({"si_units": unit} if name == SCALED else {})
            return x * factor if factor != 1 else x, own if unit else stays

        for name, x in data.variables.items():
            values, told = (
                converted(x.values, x.attrs) if x.dtype.kind in "fc" else (x.values, x.attrs)
            )
            data[name] = (
                x.dims,
                values,
                {k: v for k, v in x.attrs.items() if k not in ("units", "si_units")} | told,
            )
        for key in [key for key in data.attrs if f"{key}_units" in data.attrs]:
            told = {
                k: data.attrs.pop(f"{key}_{k}")
                for k in ("units", "si_units")
                if f"{key}_{k}" in data.attrs
            }
            values, told = converted(np.asarray(data.attrs[key]), told)
            data.attrs |= {key: values.tolist()} | {f"{key}_{k}": x for k, x in told.items()}
        left = [word.name for word in counted.words if word.name not in taken]
        if left:
            there = sorted(
                {x.attrs.get("si_units", x.attrs.get("units", "")) for x in data.variables.values()}
                - {""}
            )
            refuse(
                "units",
                f"units of {', '.join(there)}",
                ", ".join(map(repr, left)),
                "Nothing here has such.",
            )
        said = SCALED if counted.sizes is not None and counted.said == SI else SI
        return data.assign_attrs(units=said) if counted.sizes is not None or counted.words else data

    def _said(self, units):
        """The same, counted in what somebody says by "SI" or "scaled" who asks for units."""
        kind = by_name.asked_for(units)[0]
        if kind is None:
            refuse(
                "units",
                "units of a result that says what it is in",
                f"a {type(self).__name__}, which does not",
                "Say it where it is made, as in spectrum(..., units=run.units), or here, in_units('SI', 'us').",
            )
        mark = self._known_mark
        return dataclasses.replace(
            self, _mark=np.full(np.shape(0.0 if mark is None else mark), by_name.mark_of(kind))
        )

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


def _attributes(counted: str | None, unit: str) -> dict[str, str]:
    """The attributes of numbers whose unit in SI is known, counted in "SI", "scaled" or nobody knows what."""
    known = by_name.known_unit(unit)
    if known is None or not any(known.dimension) or counted == SI:
        return {"units": unit} if unit else {}
    return {"units": SCALED, "si_units": unit} if counted == SCALED else {}


def _more(x, axes):
    return "site" in axes.split() or np.ndim(x) > len(axes.split())


def _is_array(x):
    return isinstance(x, (jax.Array, np.ndarray))


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
