"""`Result`: what every record of the library is: an outcome, text for reading, named arrays with units, files."""

import dataclasses
import io
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, get_args, get_origin

import equinox as eqx
import jax
import numpy as np

from . import reading
from .checks import concrete, refuse, traced
from .entry import checked
from .files import netcdf, target, write
from .units import SCALED, SI, Units
from .units.names import Counted, counted_in, settled

if TYPE_CHECKING:
    import xarray  # half a second


class Held(NamedTuple):
    """What a field of a result holds: its axes, words with a space between; its unit; its name in a file.

    `axes=None` makes an attribute of it instead of a variable, and leaves out a result within. A variable of the one
    axis that has its name is a coordinate. Axes beyond those named are called `NAME_k`, but behind the axis `site`
    `site_1`, `site_2`: those of a lattice in the plane and of vectors. They stand where the dots do
    ("site ... mode"), or at the end.
    """

    axes: str | None = ""
    unit: str = ""
    name: str = ""


# the unit of a `State`, which has two
STATE, MOTION = "m, m/s", {"u": "m", "v": "m/s"}


class Result(eqx.Module):
    """What a computation returns.

    `outcome` says in a sentence what became of it. Printing shows numbers as numbers and arrays by shape and range.
    `to_xarray()` gives the arrays with named axes, units and where they come from; `save` writes them to a file and
    `load` reads one.

    To add one: fields with their types, `outcome` as a field or a property, and for arrays with names of their own
    a line each in the table `held`, with their units in SI. What comes from a lattice has its `_mark`, or it as a field
    `lattice`: where that is not in SI, files say "scaled" in place of a unit.
    """

    outcome: eqx.AbstractVar[str]
    held: ClassVar[dict[str, Held]] = {}
    # what a result without a mark is counted in: in what `held` says, or nobody knows
    _else: ClassVar[str | None] = SI
    # of the lattice that it comes from
    _mark: Any = eqx.field(default=None, kw_only=True, repr=False)

    @property
    def units(self) -> str | None:
        """What its numbers are counted in, "SI" or "scaled"; `None` where nobody said so, or while traced."""
        mark = self._known_mark
        return self._else if mark is None else counted_in(mark)

    @property
    def _known_mark(self):
        return getattr(getattr(self, "lattice", None), "_mark", None) if self._mark is None else self._mark

    def __repr__(self) -> str:
        if traced(self):
            return f"{type(self).__name__}(traced)"
        rows = list(self._rows())
        width = max(15, 1 + max(len(name) for name, _ in rows))
        return "\n".join(f"{name:<{width}}{value}" for name, value in rows)

    def _rows(self) -> Iterator[tuple[str, str]]:
        """Name and text of each line of what is printed."""
        for name, value in self._fields():
            unit = settled(None, self.units).conversion(self.held.get(name, Held()).unit)[1]
            yield name.replace("_", " "), _text(value, "" if unit in (SCALED, STATE) else unit)
        yield "outcome", self.outcome

    def _fields(self) -> Iterator[tuple[str, object]]:
        """Names and values of the fields that are shown and kept, without the outcome and what is not there."""
        for name in (field.name for field in dataclasses.fields(self)):
            if name == "outcome" or name[0] == "_":
                continue
            value = getattr(self, name)
            if value is not None:
                yield name, value

    def to_xarray(self) -> "xarray.Dataset":
        """The arrays as an `xarray.Dataset`, with units; the rest, the versions and the outcome as attributes.

        A dict gives a variable for each of its arrays, NAME_KEY, over an axis `site_KEY` of its own; complex numbers
        give two, NAME_real and NAME_imag. A result within gives its variables as NAME_VARIABLE, a tuple of records
        arrays of their numbers and words, NAME_FIELD. Units are the attribute `units` of every variable and of the
        whole; scaled numbers have "scaled", and as `si_units` what a `gx.Units` leads back to. **Raises** ValueError
        where the result is traced.
        """
        import xarray

        held, types = self.held, {field.name: field.type for field in dataclasses.fields(self)}
        counted = settled(None, self.units)
        variables, attributes, within = {}, {}, {}
        for field, value in self._fields():
            axes, told, name = held.get(field, Held())
            records = _records(types.get(field), value)
            if isinstance(value, Result):
                within |= {} if axes is None else {name or field: value}
                continue
            if records is not None:
                axes, value = axes or name or field, records
            for key, fields, x in _arrays(name or field, value):
                unit = MOTION.get(key[len(name or field) + 1 :][:1], "") if told == STATE else told
                if isinstance(x, jax.core.Tracer):
                    refuse("result", "numbers", f"{field}, which is traced", "Call to_xarray outside of jit and vmap.")
                if axes is None or x.ndim == 0:
                    attributes[key] = x.astype(int).tolist() if x.dtype == bool else x.tolist()
                    attributes |= {f"{key}_{k}": told for k, told in _attributes(counted, unit).items()}
                    continue
                dims = _axes(axes, key, x.ndim, f"site_{fields}" if fields else "site")
                for part, y in (("_real", x.real), ("_imag", x.imag)) if x.dtype.kind == "c" else (("", x),):
                    variables[key + part] = (dims, y, _attributes(counted, unit))
        origin = {"result": type(self).__name__, "outcome": self.outcome}
        origin |= {"units": self.units} if self.units else {}
        versions = {"granjax": sys.modules[__package__].__version__, "jax": jax.__version__}
        data = xarray.Dataset(variables, attrs=attributes | origin | versions)
        for name, result in within.items():
            own = result if result._known_mark is not None else dataclasses.replace(result, _mark=self._known_mark)
            data = _joined(data, name, own.to_xarray())
        return data

    @checked
    def in_units(self, *units: str | Units) -> "xarray.Dataset":
        """`to_xarray()` with its numbers counted in other units.

        `run.in_units("us", "mm/s")`: words, each for all that has its dimension; "kHz" turns an angular frequency into
        one of cycles. All else stays in SI. Scaled numbers come to SI by the `gx.Units` that leads there,
        `run.in_units(units)`, or to words, `run.in_units(units, "us")`; those in SI become scaled by a `gx.Units`
        alone. What has no unit of its own, such as a record of yours, stays as it is.

        **Raises** ValueError for a word that nothing here takes or that is not known, and for words of scaled numbers.
        """
        counted = settled(units, self.units)
        data, taken = self.to_xarray(), set()

        def converted(x, told):
            unit = told.get("si_units", told.get("units", ""))
            factor, name = counted.conversion(unit)
            taken.update(word.name for word in counted.words if word.name == name)
            return x * factor if factor != 1 else x, _attributes(counted, unit) if unit else {}

        for name, x in data.variables.items():
            values, told = converted(x.values, x.attrs) if x.dtype.kind in "fc" else (x.values, x.attrs)
            data[name] = (x.dims, values, {k: v for k, v in x.attrs.items() if k not in ("units", "si_units")} | told)
        for key in [key for key in data.attrs if f"{key}_units" in data.attrs]:
            told = {k: data.attrs.pop(f"{key}_{k}") for k in ("units", "si_units") if f"{key}_{k}" in data.attrs}
            values, told = converted(np.asarray(data.attrs[key]), told)
            data.attrs |= {key: values.tolist()} | {f"{key}_{k}": x for k, x in told.items()}
        left = [word.name for word in counted.words if word.name not in taken]
        if left:
            there = sorted({x.attrs.get("si_units", x.attrs.get("units", "")) for x in data.variables.values()} - {""})
            refuse("units", f"units of {', '.join(there)}", ", ".join(map(repr, left)), "Nothing here has such.")
        said = SCALED if counted.sizes is not None and counted.said == SI else SI
        return data.assign_attrs(units=said) if counted.sizes is not None or counted.words else data

    def save(self, path: str | Path) -> Path:
        """Write `to_xarray()` to a file: netCDF (`.nc`), or MATLAB's `.mat` with the attributes in a struct.

        The file is there whole or not at all, and what was there before stays where writing fails; a file that is open
        elsewhere may be written again.

        **Returns:** the path. **Raises** ValueError for another ending, or where nothing can be written (no such
        folder, no right to); OSError where writing fails (a full disk).
        """
        path = target("path", path)
        ending = path.suffix.lower()
        if ending not in (".nc", ".mat"):
            refuse("path", "a name that ends in .nc or .mat", repr(path.name))
        data = self.to_xarray()
        if ending == ".nc":
            return write(path, netcdf(data))
        from scipy.io import savemat

        buffer, arrays = io.BytesIO(), {str(name): x.values for name, x in data.variables.items()}
        savemat(buffer, arrays | {"attributes": dict(data.attrs)}, long_field_names=True)
        return write(path, buffer.getvalue())

    @staticmethod
    @checked
    def load(path: str | Path) -> "xarray.Dataset":
        """What `save` wrote as netCDF: the `xarray.Dataset`, with everything in memory and the file closed.

        The result itself, which may hold a lattice and functions, is not made anew: its arrays are what a file keeps.
        It is read in a process of its own, as `gx.Traces.from_mat` does: a damaged file costs a sentence, the first one
        of a session 0.6 s. **Raises** ValueError for a file that is not there, is no such one or is damaged.
        """
        return reading.netcdf(path)


def _attributes(counted: Counted, unit: str) -> dict[str, str]:
    """The attributes that say what numbers are counted in whose unit in SI is known."""
    said = counted.conversion(unit)[1]
    return ({"units": said} if said else {}) | ({"si_units": unit} if said == SCALED else {})


def _axes(axes: str, name: str, count: int, site: str) -> list[str]:
    """Names of an array's axes."""
    first, _, last = (part.split() for part in axes.partition("..."))
    first = first[: max(count - len(last), 0)]
    between = range(len(first), count - len(last))
    more = [f"{site}_{k - len(first) + 1}" if first[-1:] == ["site"] else f"{name}_{k}" for k in between]
    named = first + more + last[len(last) - min(len(last), count) :]
    return [site if axis == "site" else axis for axis in named]


def _records(hint: object, value: object) -> dict[str, np.ndarray] | None:
    """Arrays of the numbers and words that all records of a tuple have; `None` where its type is none of records."""
    kind = next(iter(get_args(hint)), None) if get_origin(hint) is tuple else None
    if not (isinstance(kind, type) and isinstance(value, tuple)):
        return None
    if not (issubclass(kind, Result) or hasattr(kind, "_asdict")):
        return None
    hints = {name: type_ for name, type_ in kind.__annotations__.items() if type_ in (str, int, float)}
    return {name: np.array([getattr(x, name) for x in value], type_) for name, type_ in hints.items()}


def _joined(data: "xarray.Dataset", name: str, inner: "xarray.Dataset") -> "xarray.Dataset":
    """A dataset with that of a result within: its variables as NAME_VARIABLE, on axes of their own but sites.

    Axes that both have are shared where they are as long and have the same coordinates.
    """
    shared = [
        x for x in inner.dims if inner.sizes[x] == data.sizes.get(x, inner.sizes[x])
        and (x in data.dims or x.startswith("site")) and (x not in inner.coords or inner[x].equals(data[x]))
    ]
    inner = inner.rename({x: f"{name}_{x}" for x in {*inner.variables, *inner.dims} - {*shared}})
    told = {f"{name}_{key}": x for key, x in inner.attrs.items() if key not in ("granjax", "jax", "units")}
    return data.merge(inner, combine_attrs="override").assign_attrs(told)


def _arrays(name: str, value: object, fields: str = "") -> Iterator[tuple[str, str, object]]:
    """Names, keys and arrays of a field: of a dict or a named tuple one for each entry, none of what is no array."""
    if hasattr(value, "_asdict"):
        for key, x in value._asdict().items():
            yield from _arrays(f"{name}_{key}", x, fields)
    elif isinstance(value, dict):
        for key, x in value.items():
            yield from _arrays(f"{name}_{key}", x, f"{fields}_{key}" if fields else str(key))
    elif isinstance(value, jax.core.Tracer):
        yield name, fields, value
    elif isinstance(value, (jax.Array, np.ndarray, np.generic, int, float, complex, str, list, tuple)):
        try:
            x = np.asarray(value)
        except ValueError:
            return
        if x.dtype.kind in "biufcU":
            yield name, fields, x


def _text(value: object, unit: str = "") -> str:
    """A value for reading: a number as a number, arrays by shape and range."""
    if isinstance(value, str):
        return value
    if isinstance(value, (bool, np.bool_)):
        return "yes" if value else "no"
    entries = value._asdict() if hasattr(value, "_asdict") else value
    if isinstance(entries, dict):
        return ", ".join(f"{key}: {_text(x, unit)}" for key, x in entries.items()) or "none"
    if isinstance(value, Result):
        return f"{type(value).__name__}: {value.outcome}"
    if isinstance(value, (jax.Array, np.ndarray, np.generic, int, float, complex)):
        x = concrete(value)
        if x is None:
            return f"traced, shape {value.shape}"
        return f"{_numbers(x)} {'' if unit == '1' else unit}".strip()
    if isinstance(value, (list, tuple)):
        if value and all(isinstance(x, (int, float, complex, np.generic)) for x in value):
            return _text(np.asarray(value), unit)
        few = [_text(x, unit) for x in value[:4]] + (["..."] if len(value) > 4 else [])
        return ", ".join(few) or "none"
    return type(value).__name__


def _numbers(x: np.ndarray) -> str:
    if x.ndim == 0:
        return _text(bool(x)) if x.dtype == bool else f"{x:.6g}" if x.dtype.kind in "fc" else f"{x}"
    if x.size == 0:
        return "none"
    shape = f"shape ({', '.join(map(str, x.shape))})"
    if x.dtype == bool:
        return f"{shape}, {np.count_nonzero(x)} of {x.size} yes"
    if x.dtype.kind not in "iufc":
        return f"{shape}: {', '.join(dict.fromkeys(map(str, x.reshape(-1)[:100])))}"
    if x.ndim == 1 and x.size <= 6:
        return ", ".join(f"{y:.6g}" for y in x)
    size = np.abs(x) if x.dtype.kind == "c" else x
    known = size[np.isfinite(size)]
    span = f"{known.min():.6g} ... {known.max():.6g}" if known.size else "not finite"
    lost = f", {size.size - known.size} not finite" if 0 < known.size < size.size else ""
    return f"{shape}, {'modulus ' if x.dtype.kind == 'c' else ''}{span}{lost}"
