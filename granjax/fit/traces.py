"""Measured traces: what was recorded, where, how well."""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ..checks import concrete, described, one_of, parameter, positive, real, refuse, show, traced
from ..printing import told
from ..types import AnyArray, Count, Displacements, Number, Numbers, Parameter, Scalar, Values
from ..units.names import known_unit

KINDS = ("velocity", "displacement", "force")
QUANTITIES = {"time": "s", "velocity": "m/s", "displacement": "m", "force": "N"}
# a name and the unit in brackets at its end: "Time (us)", "v [mm/s]"
HEADER = re.compile(r"(.*?)\s*[\[(]\s*([^\[\]()]*?)\s*[\])]\s*")


class Traces(eqx.Module):
    r"""Traces of one kind, recorded together: data(t) = gain signal(t + offset) + noise.

    **Arguments:**

    - `times` (T,): of the recorder, rising [s]. Dates become seconds from the first one, and time differences seconds.
    - `velocity` [m/s], `displacement` [m] or `force` [N] (total contact force, compression positive), exactly one of
      them: (T, S), one column per sensor, or (T,) for one. NaN marks what is missing.
    - `sites`: where, for velocity and displacement: S indices, negative from the end, tuples on a grid. `contacts`:
      where, for force: S indices of bonds as `gx.measures.contact_force` counts them; `bond`: of which bond term.
    - `sigma` > 0: standard deviation of the noise, in units of the data; a number, one per sensor (S,), or (T, S).
      `None`: one unknown number, taken from the residuals.
    - `gain`: a number, one per sensor, or the name of a parameter. `offset`: time of the scene at the recorder's time
      0 [s], a number or the name of a parameter; what was recorded before t0 is compared with the state at t0.
    - `field`: where a cell holds several. `component`: of the displacements, where they are vectors.

    **Raises** ValueError for times that do not rise, data of another shape, no sensor, sigma <= 0.

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
        velocity: Parameter | None = None,
        displacement: Parameter | None = None,
        force: Parameter | None = None,
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
        where, name = (contacts, "contacts") if self.kind == "force" else (sites, "sites")
        if where is None:
            refuse(name, f"where the {self.kind} was measured", "None")
        self.places = _places(name, where)
        self.times = parameter("times", _seconds(times))
        value = concrete(self.times)
        if (
            self.times.ndim != 1
            or value is not None
            and (value.size < 2 or not (np.diff(value) > 0).all())
        ):
            refuse(
                "times",
                "at least two rising times",
                show(self.times) if value is not None else "another shape",
            )
        data = jax.device_put(
            np.array(real(self.kind, data)) if concrete(data) is not None else data
        )
        data = data[:, None] if data.ndim == 1 else data
        wanted = (self.times.size, len(self.places))
        if data.shape != wanted:
            refuse(self.kind, f"shape {wanted}: times, then {name}", f"shape {data.shape}")
        if concrete(data) is not None and not np.isfinite(data).any():
            refuse(self.kind, "some finite numbers", "none")
        self.data = data
        self.sigma = (
            None
            if sigma is None
            else positive("sigma", sigma, "It is the noise's standard deviation.")
        )
        own = () if self.sigma is None else self.sigma.shape
        if len(own) > 2 or any(n not in (1, whole) for n, whole in zip(own[::-1], wanted[::-1])):
            refuse(
                "sigma", f"a number, or shape {wanted[1:]} or {wanted}", f"shape {self.sigma.shape}"
            )
        self.gain = (
            gain
            if isinstance(gain, str)
            else checked_shape("gain", parameter("gain", gain), wanted[1:])
        )
        self.offset = (
            offset
            if isinstance(offset, str)
            else checked_shape("offset", parameter("offset", offset))
        )
        self.bond, self.field, self.component = bond, field, component

    @classmethod
    def from_csv(
        cls,
        path: str | Path,
        *,
        time: str | int = "Time",
        velocity: str | int | Sequence[str | int] | None = None,
        displacement: str | int | Sequence[str | int] | None = None,
        force: str | int | Sequence[str | int] | None = None,
        units: dict[str | int, str | Number] | None = None,
        read: dict[str, Any] | None = None,
        **traces: Any,
    ) -> "Traces":
        """Read traces from a table of columns, by `pandas.read_csv`.

        A column is named by its header, with or without the unit in brackets at its end, or by its index from 0. The
        data are turned into SI: s, m/s, m, N.

        **Arguments:**

        - `time`: the column of times.
        - `velocity`, `displacement` or `force`, exactly one of them: a column, or a list with one per sensor.
        - `units`: {column: unit}, for columns whose header does not end in a unit such as "Time (us)" or "v [mm/s]".
          A unit is a name, such as us, mm/s, nm or kN; or a number, the size in SI of one unit of the column:
          {"Bead 3": 0.025} for a vibrometer with 0.025 (m/s)/V.
        - `read`: keywords of `pandas.read_csv`, such as {"sep": ";", "decimal": ",", "comment": "#"}.
        - `traces`: what `Traces` takes besides, such as `sites`, `sigma` or `gain`.

        **Raises** ValueError for a column that is not in the table, holds text or has no known unit, and as `Traces`
        does; OSError and pandas' own errors for a file that cannot be read.

        **Example:**

        >>> np.savetxt("v.csv", [[0, 0], [5, 20]], delimiter=",", header="Time (us),v [mm/s]", comments="")
        >>> traces = gx.Traces.from_csv("v.csv", velocity="v", sites=3)
        >>> traces.times.tolist(), traces.data[:, 0].tolist()
        ([0.0, 5e-06], [0.0, 0.02])
        """
        import pandas

        table, left = pandas.read_csv(path, **(read or {})), dict(units or {})

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
            if isinstance(unit, (int, float)):
                return unit * values.astype(float)
            known, own = known_unit(str(unit).replace("\u03bc", "u")), QUANTITIES[quantity]
            if known is None or known.dimension != known_unit(own).dimension:
                wanted = f"the unit of {name!r}, such as {own}, or its size in {own}"
                refuse("units", wanted, repr(unit), f"Give units={{{key!r}: {own!r}}}.")
            return known.size * values.astype(float)

        signals = {}
        for kind, keys in zip(KINDS, (velocity, displacement, force)):
            if keys is not None:
                keys = [keys] if isinstance(keys, (str, int)) else keys
                signals[kind] = np.column_stack([column(kind, key) for key in keys])
        times = column("time", time)
        for key in left:
            refuse(
                "units", "columns that are read, by the names that the call gives them", repr(key)
            )
        return cls(times, **signals, **traces)

    @property
    def sensors(self) -> list[str]:
        """A name for every column: "velocity of site 2", "force of contact 0"."""
        what = "contact" if self.kind == "force" else "site"
        return [f"{self.kind} of {what} {p[0] if len(p) == 1 else p}" for p in self.places]

    @property
    def indices(self) -> list[tuple]:
        """The index of every sensor in an array over sites, its component included."""
        component = () if self.component is None else (self.component,)
        return [(..., *place, *component) for place in self.places]

    def picked(self, x: Displacements) -> Float[AnyArray, "... S"]:
        """The entries of displacements or velocities, with further axes first, at the sensors."""
        x = x if self.field is None else x[self.field]
        return jnp.stack([x[index] for index in self.indices], axis=-1)

    @property
    def unit(self) -> str:
        """The unit of the data in SI, "" of a recorder's numbers, from which a gain leads that is fitted or not 1."""
        gain = None if isinstance(self.gain, str) else concrete(self.gain)
        return "" if gain is None or (gain != 1).any() else QUANTITIES[self.kind]

    @property
    def weights(self) -> Float[AnyArray, "T S"]:
        """1/sigma where there is a number, 0 where there is none (T, S)."""
        array = jnp if traced(self) else np
        sigma = array.asarray(self.size if self.sigma is None else self.sigma)
        return array.where(array.isfinite(self.data), 1 / sigma, 0.0)

    @property
    def size(self) -> Float[AnyArray, ""]:
        """Root mean square of the data, the unit of residuals while the noise is not known."""
        known = jnp.isfinite(self.data)
        square = jnp.sum(jnp.where(known, self.data, 0) ** 2) / jnp.maximum(jnp.sum(known), 1)
        return jnp.where(square > 0, jnp.sqrt(square), 1.0)


def _seconds(times):
    """Times as numbers: dates in seconds from the first one, time differences in seconds."""
    if isinstance(times, jax.Array) or np.asarray(times).dtype.kind not in "OMm":
        return times
    import pandas

    column = pandas.Series(times)
    if column.dtype.kind == "M":
        column = column - column.iloc[0]
    return column.dt.total_seconds().to_numpy() if column.dtype.kind == "m" else times


def _column(table, quantity, key):
    """The name of a table's column, from its index or its name, with or without a unit in brackets."""
    names = list(table.columns)
    if isinstance(key, int):
        return names[key]
    found = [name for name in names if name == key]
    found = found or [name for name in names if (HEADER.fullmatch(str(name)) or [""] * 2)[1] == key]
    if len(found) != 1:
        one_of(quantity, key, names)
    return found[0]


def number(x: Numbers | str, parameters: dict[str, Numbers]) -> Numbers:
    """A gain or an offset: a number, or the parameter that it names."""
    return parameters[x] if isinstance(x, str) else x


def checked_shape(name: str, x: Numbers, *others: tuple[int, ...]) -> Numbers:
    """An array that is a number or has one of some shapes."""
    if jnp.shape(x) not in ((), *others):
        shown = "".join(f", or shape {shape}" for shape in others)
        refuse(name, f"one number{shown}", f"shape {jnp.shape(x)}")
    return x


def _places(name, where):
    """Indices of the sensors, each a tuple; one tuple is one place on a grid."""
    one = isinstance(where, tuple) and all(isinstance(i, (int, np.integer)) for i in where)
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
    """A tuple of `Traces`."""
    return (traces,) if isinstance(traces, Traces) else tuple(traces)
