"""Measured traces: what was recorded, where, how well."""

import dataclasses
from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ..checks import concrete, described, parameter, positive, real, refuse, show, whole
from ..entry import checked, shape_of
from ..types import AnyArray, Count, Numbers, Parameter, Scalar, Values
from .columns import QUANTITIES

KINDS = ("velocity", "displacement", "force")


@dataclasses.dataclass(frozen=True)
class Origin:
    """Where traces were read: the file, its header's lines, what was passed over or is missing, units of the columns.

    Two are equal whatever they say: what is compiled for one file serves another, and traces that a compiled function
    returns may name the file that it was compiled for.
    """

    file: str = dataclasses.field(compare=False)
    header: tuple[str, ...] = dataclasses.field(default=(), compare=False, repr=False)
    remark: str = dataclasses.field(default="", compare=False)
    units: str = dataclasses.field(default="", compare=False)


class Traces(eqx.Module):
    r"""Traces of one kind, recorded together: data(t) = gain signal(t + offset) + noise.

    **Arguments:**

    - `times` (T,): of the recorder, rising [s].
    - `velocity` [m/s], `displacement` [m] or `force` [N] (total contact force, compression positive), exactly one of
      them: (T, S), one column per sensor, or (T,) for one. NaN marks what is missing.
    - `sites`: where, for velocity and displacement: S indices, negative from the end, tuples on a grid. `contacts`:
      where, for force: S indices of bonds as `gx.measures.contact_force` counts them; `bond`: of which bond term.
    - `sigma` > 0: standard deviation of the noise, in units of the data; a number, one per sensor (S,), or (T, S).
      `None`: one unknown number, taken from the residuals.
    - `gain`: a number, one per sensor, or the name of a parameter. `offset`: time of the scene at the recorder's time
      0 [s], a number or the name of a parameter; what was recorded before t0 is compared with the state at t0.
    - `field`: where a cell holds several. `component`: of the displacements, where they are vectors.
    - `origin`: of traces that were read from a file.

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
    origin: Origin | None = eqx.field(static=True)

    @checked
    def __init__(
        self, times: Parameter, *, velocity: Parameter | None = None, displacement: Parameter | None = None,
        force: Parameter | None = None, sites: Count | Values | None = None,
        contacts: Count | Values | None = None, bond: Count = 0, sigma: Parameter | None = None,
        gain: Parameter | str = 1.0, offset: Scalar | str = 0.0, field: str | None = None,
        component: Count | None = None, origin: Origin | None = None,
    ):
        given = {k: x for k, x in zip(KINDS, (velocity, displacement, force)) if x is not None}
        if len(given) != 1:
            refuse("data", "one of velocity=, displacement=, force=", f"{sorted(given) or 'none'}",
                   "Give several kinds as a list of Traces.")
        ((self.kind, data),) = given.items()
        where, name = (contacts, "contacts") if self.kind == "force" else (sites, "sites")
        if where is None:
            refuse(name, f"where the {self.kind} was measured", "None")
        self.places = _places(name, where)
        self.times = parameter("times", times)
        value = concrete(self.times)
        if self.times.ndim != 1 or value is not None and (value.size < 2 or not (np.diff(value) > 0).all()):
            refuse("times", "at least two rising times", show(self.times) if value is not None else "another shape")
        data = jnp.asarray(real(self.kind, data) if concrete(data) is not None else data)
        data = data[:, None] if data.ndim == 1 else data
        wanted = (self.times.size, len(self.places))
        if data.shape != wanted:
            refuse(self.kind, f"shape {wanted}: times, then {name}", f"shape {data.shape}")
        if concrete(data) is not None and not np.isfinite(data).any():
            refuse(self.kind, "some finite numbers", "none")
        self.data = data
        self.sigma = None if sigma is None else positive("sigma", sigma, "It is the noise's standard deviation.")
        own = () if self.sigma is None else self.sigma.shape
        if len(own) > 2 or any(n not in (1, whole) for n, whole in zip(own[::-1], wanted[::-1])):
            refuse("sigma", f"a number, or shape {wanted[1:]} or {wanted}", f"shape {self.sigma.shape}")
        self.gain = gain if isinstance(gain, str) else checked_shape("gain", parameter("gain", gain), wanted[1:])
        self.offset = offset if isinstance(offset, str) else checked_shape("offset", parameter("offset", offset))
        self.bond, self.field = whole("bond", bond), field
        self.component = None if component is None else whole("component", component)
        if origin is not None and not isinstance(origin, Origin):
            refuse("origin", "an Origin, or None", repr(origin)[:60], "`from_csv` and `from_mat` give it.")
        self.origin = origin

    def __repr__(self) -> str:
        if concrete(self.times) is None or concrete(self.data) is None:
            return "Traces(traced)"
        t, known = np.asarray(self.times), int(np.isfinite(np.asarray(self.data)).sum())
        sigma = "unknown" if self.sigma is None else show(self.sigma)
        second = "" if self.origin is None else " s"
        rows = [("sensors", ", ".join(self.sensors[:6]) + ", ..." * (len(self.sensors) > 6)),
                ("times", f"{t.size}, {t[0]:.6g} ... {t[-1]:.6g}{second}"), ("samples", f"{known} of {self.data.size}"),
                ("sigma", sigma), ("gain", show(self.gain)), ("offset", show(self.offset))]
        if self.origin is not None:
            said = "; ".join(x for x in (self.origin.units, self.origin.remark) if x)
            rows += [("file", self.origin.file), ("read", said)]
        return "\n".join(f"{name:<9}{value}" for name, value in rows)

    @property
    def sensors(self) -> list[str]:
        """A name for every column: "velocity of site 2", "force of contact 0"."""
        what = "contact" if self.kind == "force" else "site"
        return [f"{self.kind} of {what} {p[0] if len(p) == 1 else p}" for p in self.places]

    @property
    def unit(self) -> str:
        """The unit of the data in SI, "" of a recorder's numbers, from which a gain leads that is fitted or not 1."""
        gain = None if isinstance(self.gain, str) else concrete(self.gain)
        return "" if gain is None or (gain != 1).any() else QUANTITIES[self.kind]

    @property
    def weights(self) -> Float[AnyArray, "T S"]:
        """1/sigma where there is a number, 0 where there is none (T, S)."""
        known = jnp.isfinite(self.data)
        return jnp.where(known, 1 / (self.size if self.sigma is None else self.sigma), 0.0)

    @property
    def size(self) -> Float[AnyArray, ""]:
        """Root mean square of the data, the unit of residuals while the noise is not known."""
        known = jnp.isfinite(self.data)
        square = jnp.sum(jnp.where(known, self.data, 0) ** 2) / jnp.maximum(jnp.sum(known), 1)
        return jnp.where(square > 0, jnp.sqrt(square), 1.0)


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
    single = isinstance(where, tuple) and all(isinstance(i, (int, np.integer)) for i in where) or shape_of(where) == ()
    where = [where] if single else list(where)
    shapes = [shape_of(place, "iu") for place in where]
    one = bool(shapes) and all(shape == () or shape and len(shape) == 1 for shape in shapes)
    if not one or len({shape or (1,) for shape in shapes}) > 1:
        refuse(name, "whole numbers, such as [2, 5] (tuples on a grid: [(1, 2), (3, 4)])", described(where))
    places = [np.atleast_1d(np.asarray(place)) for place in where]
    return tuple(tuple(int(i) for i in place) for place in places)


def checked_traces(traces: Traces | Sequence[Traces]) -> tuple[Traces, ...]:
    """A tuple of `Traces`."""
    traces = (traces,) if isinstance(traces, Traces) else tuple(traces)
    if not traces:
        refuse("traces", "Traces, or a list of them", "none", "Traces(times=t, velocity=data, sites=[2, 5])")
    return traces
