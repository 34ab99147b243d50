"""Units of mass, length and time, and objects that can be converted between units."""

import dataclasses
from collections.abc import Callable
from types import FunctionType
from typing import Any, ClassVar

import equinox as eqx
import jax

from ..checks import positive, refuse
from ..printing import called, told
from ..types import Number, Parameter, StateLike


class Units(eqx.Module):
    """The sizes of units in SI: a scaled number times its unit is the SI number.

    For example `run.ts * units.time` is in seconds.

    **Arguments:** `mass` [kg], `length` [m], `time` [s], above zero. `velocity`, `acceleration`,
    `force`, `energy`, `omega` follow from them. **Raises** ValueError for a unit <= 0.

    **Example:**

    >>> units = gx.Units(mass=2.0, length=0.01, time=1e-3)
    >>> round(float(units.velocity), 4), round(float(units.force), 4)
    (10.0, 20000.0)
    """

    mass: jax.Array
    length: jax.Array
    time: jax.Array

    def __init__(self, mass: Parameter = 1.0, length: Parameter = 1.0, time: Parameter = 1.0):
        self.mass = positive("mass", mass)
        self.length = positive("length", length)
        self.time = positive("time", time)

    def __repr__(self) -> str:
        names = {"mass": "kg", "length": "m", "time": "s"}
        return called("Units", {name: getattr(self, name) for name in names}, names)

    @property
    def velocity(self) -> Number:
        """Unit of velocity [m/s]."""
        return self.length / self.time

    @property
    def acceleration(self) -> Number:
        """Unit of acceleration [m/s^2]."""
        return self.length / self.time / self.time

    @property
    def force(self) -> Number:
        """Unit of force [N]."""
        return self.mass * self.acceleration

    @property
    def energy(self) -> Number:
        """Unit of energy [J]."""
        return self.force * self.length

    @property
    def omega(self) -> Number:
        """Unit of angular frequency and of damping rates [1/s]."""
        return 1 / self.time

    def of(self, force: Number, length: Number, time: Number) -> Number:
        """Return the unit of a quantity with these powers of force, length and time."""
        return self.force**force * self.length**length * self.time**time

    def state_to_si(self, state: StateLike) -> StateLike:
        """Return a scaled `State` in metres and metres per second."""
        return self._convert(state, self.length, self.velocity)

    def state_from_si(self, state: StateLike) -> StateLike:
        """Return a `State` in metres and metres per second in these units."""
        return self._convert(state, 1 / self.length, 1 / self.velocity)

    def _convert(self, state, length, velocity):
        u, v = state
        scaled = jax.tree.map(lambda x: x * length, u), jax.tree.map(lambda x: x * velocity, v)
        return type(state)(*scaled) if hasattr(state, "_fields") else scaled


PART = "a law, strain map or term with parameters of its own, or a tuple of such"


class Signal(tuple):
    """Powers of force, length and time of the values of a function of time."""


def _said(cls):
    kinds = (vars(base).get("__annotations__", {}) for base in cls.__mro__[1:])
    return {name for own in kinds for name, kind in own.items() if "ClassVar" in str(kind)}


class Dimensional(eqx.Module):
    """A law, strain map or term that can be converted to other units.

    `dimensions`, set in the class itself, gives each field that is not static the powers (force,
    length, time) of its unit: a tuple, a function of the instance, a `Signal` for a function of
    time, `PART`, or `None` for whole numbers. A class without it is wrapped: its arguments are
    converted to its own units and its result back.
    """

    dimensions: ClassVar[dict | None] = None
    __repr__ = told

    def __init_subclass__(cls, **keywords):
        super().__init_subclass__(**keywords)
        for name, kind in vars(cls).get("__annotations__", {}).items():
            known = getattr(super(cls, cls), name, None)
            # A class variable that a base class declares, such as `span`, must stay one.
            fixed = name in _said(cls) and "ClassVar" not in str(kind)
            if callable(known) or fixed:
                refuse(
                    f"{cls.__name__}.{name}",
                    "a field of a name of its own",
                    "the name of a method of its kind" if callable(known) else "that of a variable",
                )
        for name in _said(cls) & vars(cls).keys():
            if isinstance(vars(cls)[name], FunctionType):
                refuse(f"{cls.__name__}.{name}", "a value, or a property", "a method")

    def in_units(self, units: Units) -> Any:
        """Return the same object with arguments and results in `units`."""
        dimensions = vars(type(self)).get("dimensions")
        if dimensions is None:
            # each kind has a wrapper that converts arguments to SI and the result back
            return self._wrapped(units)
        fields = [
            field.name
            for field in dataclasses.fields(self)
            if not field.metadata.get("static", False)
        ]
        names = [
            name
            for name in fields
            if getattr(self, name) is not None and dimensions[name] is not None
        ]
        if not names:
            return self
        counted = [_counted(getattr(self, name), dimensions[name], self, units) for name in names]
        return eqx.tree_at(lambda x: [getattr(x, name) for name in names], self, counted)


def _counted(value, powers, owner, units):
    if powers is PART:
        return (
            tuple(v.in_units(units) for v in value)
            if isinstance(value, tuple)
            else value.in_units(units)
        )
    if isinstance(powers, Signal):
        return InUnits(value, units.time, units.of(*powers))
    return jax.tree.map(
        lambda x: x / units.of(*(powers(owner) if callable(powers) else powers)), value
    )


class InUnits(eqx.Module):
    """A function of time in other units: f(time t)/size."""

    function: Callable
    time: jax.Array
    size: jax.Array
    __repr__ = told

    def __call__(self, t: Number) -> Any:
        return self.function(t * self.time) / self.size

    @property
    def breaks(self) -> Any:
        """The times of the function's jumps, if it declares them."""
        found = getattr(self.function, "breaks", None)
        return None if found is None else jax.tree.map(lambda x: x / self.time, found)
