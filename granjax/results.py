"""`Result`: what every record of the library is: an outcome, text for reading, named arrays with units, files."""

import dataclasses
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, NamedTuple

import equinox as eqx
import jax
import numpy as np

from .checks import concrete, refuse

if TYPE_CHECKING:
    import xarray  # half a second


class Held(NamedTuple):
    """What a field of a result holds: its axes, words with a space between; its unit; its name in a file.

    `axes=None` makes an attribute of it instead of a variable. A variable of the one axis that has its name is a
    coordinate. Axes beyond those named are called `axis_k`, those of a field without any `NAME_k`; they stand where
    the dots do ("site ... mode"), or at the end.
    """

    axes: str | None = ""
    unit: str = ""
    name: str = ""


class Result(eqx.Module):
    """What a computation returns.

    `outcome` says in a sentence what became of it. Printing shows numbers as numbers and arrays by shape and range.
    `to_xarray()` gives the arrays with named axes, units and where they come from; `save` writes them to a file and
    `load` reads one.

    To add one: fields with their types, `outcome` as a field or a property, and for arrays with names of their own
    a line each in the table `held`. Units are those of SI where the scene's parameters were in SI, and else its own.
    """

    outcome: eqx.AbstractVar[str]
    held: ClassVar[dict[str, Held]] = {}

    def __repr__(self) -> str:
        if any(isinstance(x, jax.core.Tracer) for x in jax.tree.leaves(self)):
            return f"{type(self).__name__}(traced)"
        rows = list(self._rows())
        width = max(15, 1 + max(len(name) for name, _ in rows))
        return "\n".join(f"{name:<{width}}{value}" for name, value in rows)

    def _rows(self) -> Iterator[tuple[str, str]]:
        """Name and text of each line of what is printed."""
        for name, value in self._fields():
            yield name.replace("_", " "), _text(value, self.held.get(name, Held()).unit)
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
        give two, NAME_real and NAME_imag. **Raises** ValueError where the result is traced.
        """
        import xarray

        variables, attributes = {}, {}
        for field, value in self._fields():
            axes, unit, name = self.held.get(field, Held())
            for key, x in _arrays(name or field, value):
                if isinstance(x, jax.core.Tracer):
                    refuse("result", "numbers", f"{field}, which is traced", "Call to_xarray outside of jit and vmap.")
                if axes is None or x.ndim == 0:
                    attributes[key] = x.astype(int).tolist() if x.dtype == bool else x.tolist()
                    continue
                suffix = key.removeprefix(f"{name or field}_") if isinstance(value, dict) else ""
                dims = _axes(axes, key, x.ndim)
                dims = [f"site_{suffix}" if axis == "site" and suffix else axis for axis in dims]
                for part, y in (("_real", x.real), ("_imag", x.imag)) if x.dtype.kind == "c" else (("", x),):
                    variables[key + part] = (dims, y, {"units": unit} if unit else {})
        origin = {"result": type(self).__name__, "outcome": self.outcome}
        versions = {"granjax": sys.modules[__package__].__version__, "jax": jax.__version__}
        return xarray.Dataset(variables, attrs=attributes | origin | versions)

    def save(self, path: str | Path) -> Path:
        """Write `to_xarray()` to a file: netCDF (`.nc`), or MATLAB's `.mat` with the attributes in a struct.

        **Returns:** the path. **Raises** ValueError for another ending.
        """
        path, data = Path(path), self.to_xarray()
        if path.suffix == ".nc":
            data.to_netcdf(path, engine="h5netcdf")
        elif path.suffix == ".mat":
            from scipy.io import savemat

            arrays = {str(name): x.values for name, x in data.variables.items()}
            savemat(path, arrays | {"attributes": dict(data.attrs)}, long_field_names=True)
        else:
            refuse("path", "a name that ends in .nc or .mat", repr(path.name))
        return path

    @staticmethod
    def load(path: str | Path) -> "xarray.Dataset":
        """What `save` wrote as netCDF: the `xarray.Dataset`, with everything in memory and the file closed.

        The result itself, which may hold a lattice and functions, is not made anew: its arrays are what a file keeps.
        """
        import xarray

        return xarray.load_dataset(path, engine="h5netcdf")


def _axes(axes: str, name: str, count: int) -> list[str]:
    """Names of an array's axes."""
    first, _, last = (part.split() for part in axes.partition("..."))
    first = first[: max(count - len(last), 0)]
    between = range(len(first), count - len(last))
    return first + [f"{'axis' if axes else name}_{k}" for k in between] + last[len(last) - min(len(last), count) :]


def _arrays(name: str, value: object) -> Iterator[tuple[str, object]]:
    """Names and arrays of a field: of a dict or a named tuple one for each entry, none of what is no array."""
    entries = value._asdict() if hasattr(value, "_asdict") else value
    if isinstance(entries, dict):
        for key, x in entries.items():
            yield from _arrays(f"{name}_{key}", x)
    elif isinstance(value, jax.core.Tracer):
        yield name, value
    elif isinstance(value, (jax.Array, np.ndarray, np.generic, int, float, complex, str, list, tuple)):
        try:
            x = np.asarray(value)
        except ValueError:
            return
        if x.dtype.kind in "biufcU":
            yield name, x


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
