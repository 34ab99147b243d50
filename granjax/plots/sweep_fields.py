"""What is drawn of a sweep: a variable and the parameters, and where they stand on axes."""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Shaped
from matplotlib.axis import Axis as OneAxis
from matplotlib.ticker import NullFormatter

from ..checks import one_of, refuse
from ..units import SCALED, SI
from .style import Shown, shown

REASON, LANE, NOT_YET = "reason", "lane", "not computed yet"
EVEN = 1e-6
# largest over smallest value of a parameter that was drawn at random, from which on its axis is logarithmic
WIDE = 100


class Field(NamedTuple):
    """What is drawn of a sweep: parameters (name -> values), lanes first; what failed, and why nothing else is shown.

    `grid`: whether the parameters span a grid, whose axes `values` and `failed` have; else lanes lie side by side.
    `by`: how the axis of each name is drawn; `labels`: their words. `errors`: of the values, where they are known.
    """

    name: str
    values: np.ndarray
    failed: np.ndarray
    parameters: dict[str, np.ndarray]
    grid: bool
    labels: dict[str, str]
    by: dict[str, Shown]
    errors: np.ndarray | None = None


def field_of(data: Any, name: str | None) -> Field:
    """The `Field` of a variable of a dataset."""
    parameters, grid, dims = _parameters(data)
    known = [
        key
        for key, x in data.data_vars.items()
        if key != REASON
        and x.dims[: len(dims)] == dims
        or key != REASON
        and set(dims) <= set(x.dims)
    ]
    if name is None:
        scalar = [key for key in known if data[key].ndim == len(dims)] or known
        name = next((key for key in scalar if data[key].dtype.kind in "fiuc"), scalar[0])
    x = data[one_of("name", name, known)].transpose(*dims, ...)
    values = np.asarray(x.values)
    if values.dtype.kind in "OS":
        values = values.astype(str)
    reason = (
        np.asarray(data[REASON].transpose(*dims).values).astype(str)
        if REASON in data
        else np.full(values.shape[: len(dims)], "")
    )
    failed = (reason != "") & (reason != NOT_YET)
    if values.dtype.kind == "b":
        known = (reason == "").reshape(reason.shape + (1,) * (values.ndim - reason.ndim))
        values = np.where(known, np.where(values, "yes", "no"), "")
    label = f"|{_words(data, name)}|" if values.dtype.kind == "c" else _words(data, name)
    values = np.abs(values) if values.dtype.kind == "c" else values
    names = [name, *parameters]
    labels = {key: _words(data, key) for key in names} | {name: label}
    arrays = {name: values} | parameters
    by = {
        key: _axis_of(labels[key], arrays[key], data[key].attrs.get("units", "")) for key in names
    }
    error = f"{name}_error"
    errors = (
        np.asarray(data[error].transpose(*dims).values)
        if error in data and data[error].dims == dims
        else None
    )
    return Field(name, values, failed, parameters, grid, labels, by, errors)


def _parameters(data):
    """Values of the parameters by name, whether they span a grid, and the dimensions of the lanes."""
    own = [key for key in data.coords if data[key].ndim == 1]
    if LANE in data.dims:
        along = {
            key: np.asarray(data[key].values)
            for key in own
            if data[key].dims == (LANE,) and key != LANE
        }
        return along or {LANE: np.arange(data.sizes[LANE])}, False, (LANE,)
    if REASON in data:
        dims = data[REASON].dims
    else:
        shared = [set(x.dims) for x in data.data_vars.values()] or [set()]
        dims = tuple(key for key in data.dims if key in set.intersection(*shared) and key in own)
    if not dims:
        refuse(
            "data",
            "coordinates by the names of the parameters that vary",
            f"dimensions {tuple(data.dims)}",
        )
    return (
        {
            key: np.asarray(data[key].values) if key in data.coords else np.arange(data.sizes[key])
            for key in dims
        },
        True,
        dims,
    )


def _words(data, name):
    return str(data[name].attrs.get("long_name", name)).replace("_", " ")


def with_lines(field: Field, lines: str) -> Field:
    """The field with a parameter as its last axis."""
    if not field.grid or len(field.parameters) != 2 or field.values.ndim != 2:
        refuse(
            "lines",
            "None, but for a grid of two parameters",
            f"{lines!r} of {len(field.parameters)}",
        )
    names = list(field.parameters)
    at = names.index(one_of("lines", lines, names))
    ordered = {names[1 - at]: field.parameters[names[1 - at]], lines: field.parameters[lines]}
    turned = (lambda x: x) if at else np.transpose
    return field._replace(
        parameters=ordered, values=turned(field.values), failed=turned(field.failed)
    )


def _axis_of(label, x, unit):
    """How an axis is drawn, whose numbers have a unit."""
    numbers = _typical(x) if x.dtype.kind in "fiu" else np.zeros(1)
    return shown(label, numbers, unit, SCALED if unit == SCALED else SI)


def places(
    x: Shaped[np.ndarray, " values"],
    by: Shown,
    drawn: bool = False,
) -> tuple[Float[np.ndarray, " values"], bool]:
    """Places of a parameter's values on an axis, and whether that is logarithmic.

    Words stand one after the other, each at one place. `drawn`: values were drawn at random, and a wide range counts.
    """
    if x.dtype.kind not in "fiu":
        found = list(dict.fromkeys(x.tolist()))
        return np.array([found.index(value) for value in x.tolist()], float), False
    x = by(x)
    return x, _wide(x) if drawn else _spaced(x)


def _spaced(x):
    """Whether numbers are spaced by their logarithm."""
    x = np.sort(x[np.isfinite(x)])
    if len(x) < 3 or x[0] <= 0 or not x[0] < x[-1] < np.inf:
        return False
    steps = np.diff(np.log(x))
    return bool(
        np.ptp(steps) <= EVEN * steps.mean() and np.ptp(np.diff(x)) > EVEN * np.diff(x).mean()
    )


def _typical(x):
    """The numbers of which a unit is to make readable ones: of a logarithmic axis its middle."""
    return (
        np.exp(np.log(x.astype(float)).mean(keepdims=True))
        if x.ndim == 1 and (_spaced(x) or _wide(x))
        else x
    )


def _wide(x):
    """Whether numbers span more than an axis of even steps can show."""
    return bool(len(x) > 2 and x.min() > 0 and WIDE * x.min() <= x.max())


def name_axis(axis: OneAxis, x: Shaped[np.ndarray, " values"], label: str, log: bool) -> None:
    """An axis of a parameter: its label, words at their places, a logarithmic scale."""
    axis.set_label_text(label)
    if log:
        axis._set_axes_scale("log")
        low, high = np.nanmin(x[x > 0]), np.nanmax(x)
        if high / low >= 10:
            axis.set_minor_formatter(NullFormatter())
    elif x.dtype.kind not in "fiu":
        found = list(dict.fromkeys(x.tolist()))
        axis.set_ticks(np.arange(len(found)), [str(value) for value in found])


def edges_of(x: Float[np.ndarray, " values"], log: bool) -> Float[np.ndarray, " edges"]:
    """Ends of the cells about rising places."""
    x = np.log(x) if log else x
    if len(x) == 1:
        edges = np.array([x[0] - 0.5, x[0] + 0.5])
    else:
        middle = (x[1:] + x[:-1]) / 2
        edges = np.concatenate([[2 * x[0] - middle[0]], middle, [2 * x[-1] - middle[-1]]])
    return np.exp(edges) if log else edges
