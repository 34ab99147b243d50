"""Named parameters within bounds as one vector of free numbers, for fits and designs."""

from collections.abc import Callable
from typing import Any, TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ..base.checks import described, one_of, parameter, refuse, show, traced
from ..base.derivatives import with_slope
from ..base.printing import told
from ..base.programs import compiled
from ..base.types import AnyArray, Numbers, Parameter, Scalar

Bounds: TypeAlias = dict[str, tuple | list | None] | None
"""Dict from name to (low, high), numbers or arrays; `None` for no bound. Other names are free."""

# A parameter is at a bound if its distance is below this share of that of the start.
NEAR = 1e-4


class Coordinates(eqx.Module):
    r"""Free coordinates x (P,) of a dict of parameters: x = 0 at the start, changes of order one.

    - No bounds: theta = start + scale x, where scale is the largest entry of |start|, or 1 if that
      is zero (see `sized`).
    - A lower bound: theta = low + (start - low) e^x; an upper one is the mirror image.
    - Both: theta = low + (high - low) s with log(s/(1 - s)) = x + its value at the start.

    Bounds are never passed; rounding may reach them.

    **Arguments:** `start`: dict from name to a number or an array. `bounds`: `Bounds`.
    **Raises** ValueError for bounds of an unknown name, or a start that is not inside its bounds.
    """

    start: dict[str, Numbers]
    low: dict[str, Numbers | None]
    high: dict[str, Numbers | None]
    scale: dict[str, Numbers]
    order: tuple[str, ...] = eqx.field(static=True)
    __repr__ = told

    def __init__(self, start: dict[str, Parameter], bounds: Bounds = None):
        if not isinstance(start, dict):
            refuse("start", "a dict from names to numbers or arrays", described(start))
        bounds = bounds or {}
        for name in bounds:
            one_of("bounds", name, tuple(start))
        # Conversion by NumPy removes weak types, which would cause another compilation.
        self.start = {
            name: jax.device_put(np.asarray(parameter(name, x))) for name, x in start.items()
        }
        self.order = tuple(start)
        both = {name: _interval(name, x, bounds.get(name)) for name, x in self.start.items()}
        self.low = {name: low for name, (low, _) in both.items()}
        self.high = {name: high for name, (_, high) in both.items()}
        # An array has one scale, so that a zero entry can move as far as the others.
        self.scale = {
            name: jax.device_put(np.asarray(np.abs(x).max() or 1.0, x.dtype))
            for name, x in self.start.items()
        }

    @property
    def names(self) -> list[str]:
        """Names of all free numbers, in the order of the start: "damping", "stiffness[0]", ..."""
        return [
            f"{name}[{', '.join(map(str, index))}]" if index else name
            for name in self.order
            for index in np.ndindex(self.start[name].shape)
        ]

    @property
    def sizeless(self) -> list[str]:
        """Names of unbounded parameters that start at zero, so that they have no natural scale."""
        return [
            name
            for name, x in self.start.items()
            if self.low[name] is None and self.high[name] is None and not np.asarray(x).any()
        ]

    def sized(self, value: Scalar, slopes: Float[AnyArray, " P"]) -> "Coordinates":
        """Scale `sizeless` parameters: a unit change then changes a value by its own size.

        `slopes`: derivatives of the value by the free coordinates (P,).
        """
        scale = dict(self.scale)
        slopes = self.unflat(np.asarray(slopes))
        for name in self.sizeless:
            steepest = np.abs(slopes[name]).max()
            if steepest > 0 and 0 < np.abs(value) / steepest < np.inf:
                sized = np.asarray(scale[name]) * (np.abs(value) / steepest)
                scale[name] = jnp.asarray(sized, scale[name].dtype)
        return eqx.tree_at(lambda c: c.scale, self, scale)

    @property
    def size(self) -> int:
        """P, the number of free numbers."""
        return sum(value.size for value in self.start.values())

    def parameters(self, x: Float[AnyArray, " P"]) -> dict[str, Numbers]:
        """Return the dict of parameters at x (P,)."""
        found = self._parameters(x)
        # Compiled functions sort the names of a dict.
        return {name: found[name] for name in self.order}

    @compiled
    def _parameters(self, x):
        return {name: self._at(name, part) for name, part in self.unflat(x).items()}

    def _at(self, name, x):
        start = self.start[name]
        low = self.low[name]
        high = self.high[name]
        if low is None and high is None:
            return start + self.scale[name] * x
        if high is None:
            return low + (start - low) * jnp.exp(x)
        if low is None:
            return high - (high - start) * jnp.exp(-x)
        return low + (high - low) * jax.nn.sigmoid(x + jnp.log((start - low) / (high - start)))

    def resolved(self, x: Float[AnyArray, " P"]) -> Float[np.ndarray, " P"]:
        """Return x (P,), as near to bounds as rounding resolves."""

        def kept(name, x):
            start, low, high = self.start[name], self.low[name], self.high[name]
            both = low is not None and high is not None
            middle = np.log((high - start) / (start - low)) if both else 0.0
            far = -np.log(4 * np.finfo(start.dtype).eps)
            least = -np.inf if low is None else middle - far
            return np.clip(x, least, np.inf if high is None else middle + far)

        return self.flat({name: kept(name, part) for name, part in self.unflat(x).items()})

    def sides(self, parameters: dict[str, Parameter]) -> Float[np.ndarray, " P"]:
        """Return -1 at a lower bound, within 1e-4, 1 at an upper one, else 0."""

        def touches(name, bound):
            if bound is None:
                return np.zeros(self.start[name].shape)
            left, whole = (np.subtract(x[name], bound) for x in (parameters, self.start))
            return (np.abs(left) < NEAR * np.abs(whole)) * 1.0

        low, high = (
            self.flat({name: touches(name, side[name]) for name in self.order})
            for side in (self.low, self.high)
        )
        return high - low

    def flat(self, parameters: dict[str, Parameter]) -> Float[AnyArray, " P"]:
        """Return parameters as a vector (P,) in the order of `names`; NumPy's unless traced."""
        array = jnp if traced(parameters) else np
        parts = [
            array.broadcast_to(parameters[name], self.start[name].shape).ravel()
            for name in self.order
        ]
        return array.concatenate(parts)

    def unflat(self, vector: Float[AnyArray, " P"]) -> dict[str, Numbers]:
        """Return the dict of parameters of a vector (P,), the inverse of `flat`."""
        ends = np.cumsum([self.start[name].size for name in self.order])
        return {
            name: vector[end - self.start[name].size : end].reshape(self.start[name].shape)
            for name, end in zip(self.order, ends)
        }

    @compiled
    def slopes(self, x: Float[AnyArray, " P"]) -> Float[AnyArray, " P"]:
        """Return d theta/d x at x (P,); the Jacobian is diagonal."""
        return with_slope(lambda x: self.flat(self.parameters(x)), x)[1]


def looked_up(
    what: str, function: Callable, parameters: dict[str, Parameter], *others: object
) -> Any:
    """Call a function; refuse a start without a name that it looks up."""
    try:
        return function(parameters, *others)
    except KeyError as error:
        if not error.args or error.args[0] in parameters:
            raise
        names = ", ".join(map(repr, parameters))
        refuse("start", f"a value for {error.args[0]!r}, which the {what} looks up", names)
    except (jax.errors.TracerArrayConversionError, jax.errors.ConcretizationTypeError) as error:
        error.add_note(f"JAX traces the {what}: write jax.numpy for numpy; no float() and no if.")
        raise


def _interval(name, value, bounds):
    argument = f"bounds[{name!r}]"
    if bounds is None:
        bounds = None, None
    if not isinstance(bounds, (tuple, list)) or len(bounds) != 2:
        refuse(argument, "(low, high), None for no bound", described(bounds))
    low, high = (None if bound is None else parameter(argument, bound) for bound in bounds)
    for bound, side, inside in ((low, "above", np.greater), (high, "below", np.less)):
        if bound is not None and not np.all(inside(value, bound)):
            refuse(
                name,
                f"a start {side} its bound {show(bound)}",
                show(value),
                "A start lies between its bounds.",
            )
    return low, high
