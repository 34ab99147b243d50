"""`Traces`: measured signals, their sensors and their noise."""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ..base.checks import (
    concrete,
    described,
    is_whole,
    one_of,
    parameter,
    positive,
    real,
    refuse,
    require,
    traced,
)
from ..base.printing import told
from ..base.types import AnyArray, Count, Displacements, Number, Numbers, Parameter, Scalar, Values
from ..base.units.names import known_unit
from ..results import COMPONENTS

KINDS = ("velocity", "displacement", "force")
QUANTITIES = {"time": "s", "velocity": "m/s", "displacement": "m", "force": "N"}
# Components by number; one that has no letter is named by its number.
AXES = dict(enumerate(COMPONENTS))
# a name followed by a unit in brackets: "Time (us)", "v [mm/s]"
HEADER = re.compile(r"(.*?)\s*[\[(]\s*([^\[\]()]*?)\s*[\])]\s*")


class Traces(eqx.Module):
    r"""Traces of one kind, recorded together: data(t) = gain signal(t + offset) + noise.

    **Arguments:**

    - `times` (T,): of the recorder, increasing [s]. Dates become seconds since the first one,
      time differences seconds.
    - `velocity` [m/s], `displacement` [m] or `force` [N] (compression positive), exactly one:
      (T, S), one column per sensor, or (T,) for one. NaN is missing data.
    - `sites`: S indices of sites; negative ones count from the end; tuples on a grid. A force there
      is `gx.measures.sensor_force`.
    - `contacts`: S indices of contacts, for `gx.measures.contact_force`. `bond`: the index of the
      bond term.
    - `sigma` > 0: standard deviation of the noise, in units of the data: a number, (S,) or (T, S).
      `None`: one unknown number, estimated from the residuals.
    - `gain`: a number, one per sensor, or the name of a parameter.
    - `offset`: scene time at the recorder's time 0 [s], a number or the name of a parameter.
      Samples before t0 are compared with the state at t0.
    - `field`: if a cell holds several. `component`: of vector displacements.

    **Raises** ValueError for times that do not increase, data of another shape, no sensor,
    sigma <= 0.

    **Example:**

    >>> times = np.linspace(0.0, 5.0, 6)
    >>> traces = gx.Traces(times, velocity=np.zeros((6, 2)), sites=[2, 5], sigma=0.01)
    >>> traces.data.shape, traces.sensors
    ((6, 2), ['velocity of site 2', 'velocity of site 5'])
    """

    times: Float[AnyArray, " T"]
    data: Float[AnyArray, "T S"]
    sigma: Numbers | None
    gain: Numbers | str
    offset: Numbers | str
    kind: str = eqx.field(static=True)
    at: str = eqx.field(static=True)
    places: tuple[tuple[int, ...], ...] = eqx.field(static=True)
    bond: int = eqx.field(static=True)
    field: str | None = eqx.field(static=True)
    component: int | None = eqx.field(static=True)
    _shown = {name: name for name in ("sensors", "times", "data", "sigma", "gain", "offset")}
    __repr__ = told

    def __init__(
        self,
        times: Any,
        *,
        velocity: Any = None,
        displacement: Any = None,
        force: Any = None,
        sites: Count | Values | None = None,
        contacts: Count | Values | None = None,
        bond: Count = 0,
        sigma: Parameter | None = None,
        gain: Parameter | str = 1.0,
        offset: Scalar | str = 0.0,
        field: str | None = None,
        component: Count | None = None,
    ):
        given = {k: x for k, x in zip(KINDS, (velocity, displacement, force)) if x is not None}
        if len(given) != 1:
            refuse(
                "data",
                "one of velocity=, displacement=, force=",
                f"{sorted(given) or 'none'}",
                "Give several kinds as a list of Traces.",
            )
        ((self.kind, data),) = given.items()
        force = self.kind == "force"
        where = {k: x for k, x in (("sites", sites), ("contacts", contacts)) if x is not None}
        if len(where) != 1 or not force and sites is None:
            wanted = "sites= of sensor beads or contacts=" if force else "sites="
            got = " and ".join(where) or "none"
            refuse("sites", f"{wanted}, where the {self.kind} was measured", got)
        ((self.at, where),) = where.items()
        self.places = _places(self.at, where)
        _check_unit("times", "time", times)
        _check_unit(self.kind, self.kind, data)
        times = parameter("times", _seconds(times))
        rising = lambda t: t.ndim == 1 and t.size > 1 and np.diff(t) > 0
        self.times = require("times", times, rising, "at least two rising times")
        data = jax.device_put(
            np.array(real(self.kind, data)) if concrete(data) is not None else data
        )
        data = data[:, None] if data.ndim == 1 else data
        wanted = (self.times.size, len(self.places))
        if data.shape != wanted:
            one = len(self.places) == 1 and data.shape[1:] == np.shape(where)
            remedy = (
                f"A tuple is one place on a grid: write {self.at}={list(where)}." if one else ""
            )
            refuse(
                self.kind, f"shape {wanted}: times, then {self.at}", f"shape {data.shape}", remedy
            )
        some = lambda x: np.isfinite(x).any()
        self.data = require(self.kind, data, some, "some finite numbers")
        self.sigma = (
            None
            if sigma is None
            else positive("sigma", sigma, "It is the noise's standard deviation.")
        )
        own = np.shape(self.sigma)
        if len(own) > 2 or any(n not in (1, whole) for n, whole in zip(own[::-1], wanted[::-1])):
            refuse("sigma", f"a number, or shape {wanted[1:]} or {wanted}", f"shape {own}")
        self.gain = _named_or_number("gain", gain, wanted[1:])
        self.offset = _named_or_number("offset", offset)
        self.bond = bond
        self.field = field
        self.component = component

    @classmethod
    def from_csv(
        cls,
        path: str | Path,
        *,
        time: str | Count = "Time",
        velocity: str | Count | Values | None = None,
        displacement: str | Count | Values | None = None,
        force: str | Count | Values | None = None,
        units: dict[str | Count, str | Number] | None = None,
        read: dict[str, Any] | None = None,
        **traces: Any,
    ) -> "Traces":
        """Read traces from a table by `pandas.read_csv`, and convert them to SI.

        A column is given by its header, with or without the unit in brackets, or its index from 0.

        **Arguments:**

        - `time`: the column of times.
        - `velocity`, `displacement` or `force`, exactly one: a column, or a list of one per sensor.
        - `units`: {column: unit}, for headers without a unit such as "Time (us)" or "v [mm/s]". A
          unit is a name (us, mm/s, nm, kN) or its size in SI: {"Bead 3": 0.025} for a vibrometer
          with 0.025 (m/s)/V.
        - `read`: keywords of `pandas.read_csv`, such as {"sep": ";", "decimal": ",", "comment": "#"}.
        - `traces`: other arguments of `Traces`, such as `sites`, `sigma` or `gain`.

        **Raises** ValueError for a column that is missing, holds text or has no known unit, and as
        `Traces` does; OSError and pandas' own errors for an unreadable file.

        **Example:**

        >>> np.savetxt("v.csv", [[0, 0], [5, 20]], delimiter=",", header="Time (us),v [mm/s]", comments="")
        >>> traces = gx.Traces.from_csv("v.csv", velocity="v", sites=3)
        >>> traces.times.tolist(), traces.data[:, 0].tolist()
        ([0.0, 5e-06], [0.0, 0.02])
        """
        import pandas

        table = pandas.read_csv(path, **(read or {}))
        left = dict(units or {})

        def column(quantity, key):
            name = _column(table, quantity, key)
            header = HEADER.fullmatch(str(name))
            unit = left.pop(key, header[2] if header else None)
            values = table[name].to_numpy()
            if values.dtype.kind in "mM":
                return values
            if values.dtype.kind not in "iuf":
                refuse(
                    quantity,
                    "a column of numbers",
                    f"{name!r}, which holds text",
                    "Name in read= what the file writes: decimal, na_values, comment.",
                )
            if np.ndim(unit) == 0 and np.asarray(unit).dtype.kind in "iuf":
                return unit * values.astype(float)
            known = known_unit(str(unit).replace("\u03bc", "u"))
            own = QUANTITIES[quantity]
            if known is None or known.dimension != known_unit(own).dimension:
                wanted = f"the unit of {name!r}, such as {own}, or its size in {own}"
                refuse("units", wanted, repr(unit), f"Give units={{{key!r}: {own!r}}}.")
            return known.size * values.astype(float)

        signals = {}
        for kind, keys in zip(KINDS, (velocity, displacement, force)):
            if keys is not None:
                keys = [keys] if isinstance(keys, str) or is_whole(keys) else keys
                signals[kind] = np.column_stack([column(kind, key) for key in keys])
        times = column("time", time)
        for key in left:
            refuse(
                "units", "columns that are read, by the names that the call gives them", repr(key)
            )
        return cls(times, **signals, **traces)

    @property
    def sensors(self) -> list[str]:
        """The names of the columns: "force of contact 0", "velocity of site 2, bead, x"."""
        if self.at == "contacts":
            more = [f"bond {self.bond}" if self.bond else None]
        else:
            more = [self.field, AXES.get(self.component, self.component)]
        rest = "".join(f", {x}" for x in more if x is not None)
        return [
            f"{self.kind} of {self.at[:-1]} {p[0] if len(p) == 1 else p}{rest}" for p in self.places
        ]

    @property
    def indices(self) -> list[tuple]:
        """The index of each sensor in an array over sites, with its component."""
        component = () if self.component is None else (self.component,)
        return [(..., *place, *component) for place in self.places]

    def picked(self, x: Displacements) -> Float[AnyArray, "... S"]:
        """Return displacements or velocities (..., sites) at the sensors."""
        x = x if self.field is None else x[self.field]
        return jnp.stack([x[index] for index in self.indices], axis=-1)

    @property
    def unit(self) -> str:
        """The SI unit of the data; "" if the gain is fitted or not 1."""
        gain = None if isinstance(self.gain, str) else concrete(self.gain)
        return "" if gain is None or (gain != 1).any() else QUANTITIES[self.kind]

    @property
    def weights(self) -> Float[AnyArray, "T S"]:
        """1/sigma (T, S); 0 for missing samples."""
        array = jnp if traced(self) else np
        sigma = array.asarray(self.size if self.sigma is None else self.sigma)
        return array.where(array.isfinite(self.data), 1 / sigma, 0.0)

    @property
    def size(self) -> Float[AnyArray, ""]:
        """The rms of the data, which replaces an unknown sigma."""
        known = jnp.isfinite(self.data)
        square = jnp.sum(jnp.where(known, self.data, 0) ** 2) / jnp.maximum(jnp.sum(known), 1)
        return jnp.where(square > 0, jnp.sqrt(square), 1.0)


def _check_unit(name, quantity, x):
    # Arrays of xarray may say a unit, such as those of `run.in_units("mm/s")`.
    own = QUANTITIES[quantity]
    word = getattr(x, "attrs", {}).get("units", own)
    unit = known_unit(str(word))
    if unit is not None and unit[1:] != known_unit(own)[1:]:
        refuse(name, f"numbers in {own}", f"numbers in {word!r}", "Convert them and give .values.")


def _seconds(times):
    if isinstance(times, jax.Array) or np.asarray(times).dtype.kind not in "OMm":
        return times
    import pandas

    column = pandas.Series(times)
    if column.dtype.kind == "M":
        column = column - column.iloc[0]
    return column.dt.total_seconds().to_numpy() if column.dtype.kind == "m" else times


def _column(table, quantity, key):
    names = list(table.columns)
    if is_whole(key):
        if not -len(names) <= key < len(names):
            refuse(quantity, f"a column below {len(names)}", f"{key}", "Columns count from 0.")
        return names[key]
    found = [name for name in names if name == key]
    found = found or [name for name in names if (HEADER.fullmatch(str(name)) or [""] * 2)[1] == key]
    if len(found) != 1:
        one_of(quantity, key, names)
    return found[0]


def number(x: Numbers | str, parameters: dict[str, Numbers]) -> Numbers:
    """Return a gain or offset as a number, by name if it is a parameter."""
    return parameters[x] if isinstance(x, str) else x


def checked_shape(name: str, x: Numbers, *others: tuple[int, ...]) -> Numbers:
    """Return x; refuse it unless it is a number or has one of the shapes `others`."""
    if jnp.shape(x) not in ((), *others):
        shown = "".join(f", or shape {shape}" for shape in others)
        refuse(name, f"one number{shown}", f"shape {jnp.shape(x)}")
    return x


def _named_or_number(name, x, *others):
    return x if isinstance(x, str) else checked_shape(name, parameter(name, x), *others)


def _places(name, where):
    # A single tuple is one place on a grid.
    one = isinstance(where, tuple) and all(map(is_whole, where))
    where = [where] if one or np.ndim(where) == 0 else list(where)
    places = [np.atleast_1d(np.asarray(place)) for place in where]
    whole = all(place.dtype.kind in "iu" and place.ndim == 1 for place in places)
    if not whole or len({place.shape for place in places}) != 1:
        refuse(
            name,
            "whole numbers, such as [2, 5] (tuples on a grid: [(1, 2), (3, 4)])",
            described(where),
        )
    return tuple(tuple(place.tolist()) for place in places)


def checked_traces(traces: Traces | Sequence[Traces]) -> tuple[Traces, ...]:
    """Return a tuple of `Traces`, which is not empty."""
    if isinstance(traces, Traces):
        return (traces,)
    return tuple(traces) or refuse("traces", "Traces, or a list of them", "none")
