"""Named parameters within bounds, as one vector of free numbers: what fitting and design move."""

from typing import TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from .checks import one_of, parameter, refuse, show, traced
from .printing import told
from .programs import compiled
from .types import AnyArray, Numbers, Parameter, Scalar

Bounds: TypeAlias = dict[str, tuple | list | None] | None
"""From name to (low, high), numbers or arrays, `None` for no bound; names that are left out are free."""

# part of the way to a bound that is left where a parameter counts as being there
NEAR = 1e-4


class Coordinates(eqx.Module):
    r"""Free coordinates x (P,) of a dict of parameters, with x = 0 at the start and changes of order one.

    Without bounds theta = start + scale x, scale = |start| (its largest entry; where that is zero 1, or what `sized`
    makes of it); above a lower bound theta = low + (start - low) e^x, below an upper one its mirror image; between two
    theta = low + (high - low) s, log(s/(1 - s)) = x + its value at the start. Bounds are approached, and in
    floating point touched, but never passed.

    **Arguments:** `start`: dict from name to a number or an array. `bounds`: `Bounds`.
    **Raises** ValueError for a bound of no parameter, or a start that is not inside of its bounds.
    """

    start: dict[str, Numbers]
    low: dict[str, Numbers | None]
    high: dict[str, Numbers | None]
    scale: dict[str, Numbers]
    order: tuple[str, ...] = eqx.field(static=True)
    __repr__ = told

    def __init__(self, start: dict[str, Parameter], bounds: Bounds = None):
        bounds = bounds or {}
        for name in bounds:
            one_of("bounds", name, tuple(start))
        # by way of NumPy, which has no weak types: each would be another program
        self.start = {
            name: jax.device_put(np.asarray(parameter(name, x))) for name, x in start.items()
        }
        self.order = tuple(start)
        both = {name: _interval(name, x, bounds.get(name)) for name, x in self.start.items()}
        self.low = {name: low for name, (low, _) in both.items()}
        self.high = {name: high for name, (_, high) in both.items()}
        # one scale for an array: an entry that is zero may move as far as its neighbours
        self.scale = {
            name: jax.device_put(np.asarray(np.abs(x).max() or 1.0, x.dtype))
            for name, x in self.start.items()
        }

    @property
    def names(self) -> list[str]:
        """A name for every free number, in the order of the start: "damping", "stiffness[0]", "stiffness[1]", ..."""
        return [
            f"{name}[{', '.join(map(str, index))}]" if index else name
            for name in self.order
            for index in np.ndindex(self.start[name].shape)
        ]

    @property
    def sizeless(self) -> list[str]:
        """Names of the parameters that start at zero without a bound, which says nothing of how far they may move."""
        return [
            name
            for name, x in self.start.items()
            if self.low[name] is None and self.high[name] is None and not np.asarray(x).any()
        ]

    def sized(self, value: Scalar, slopes: Float[AnyArray, " P"]) -> "Coordinates":
        """The same with a scale for what is `sizeless`: the change that moves a value by its own size.

        `slopes`: of the value in the free coordinates, (P,). Without it a start at zero would count in units of 1.
        """
        scale, slopes = dict(self.scale), self.unflat(np.asarray(slopes))
        for name in self.sizeless:
            steepest = np.abs(slopes[name]).max()
            if steepest > 0 and 0 < np.abs(value) / steepest < np.inf:
                sized = np.asarray(scale[name]) * (np.abs(value) / steepest)
                scale[name] = jnp.asarray(sized, scale[name].dtype)
        return eqx.tree_at(lambda c: c.scale, self, scale)

    @property
    def size(self) -> int:
        """P, how many free numbers there are."""
        return sum(value.size for value in self.start.values())

    def parameters(self, x: Float[AnyArray, " P"]) -> dict[str, Numbers]:
        """The dict of parameters at x (P,)."""
        found = self._parameters(x)
        # a program sorts the names
        return {name: found[name] for name in self.order}

    @compiled
    def _parameters(self, x):
        return {name: self._at(name, part) for name, part in self.unflat(x).items()}

    def _at(self, name, x):
        start, low, high = self.start[name], self.low[name], self.high[name]
        if low is None and high is None:
            return start + self.scale[name] * x
        if high is None:
            return low + (start - low) * jnp.exp(x)
        if low is None:
            return high - (high - start) * jnp.exp(-x)
        return low + (high - low) * jax.nn.sigmoid(x + jnp.log((start - low) / (high - start)))

    def at_bounds(self, parameters: dict[str, Parameter]) -> list[str]:
        """Names of the parameters with an entry that touches a bound, as nearly as floating numbers do."""

        def touches(name, bound):
            left, whole = (np.subtract(x[name], bound) for x in (parameters, self.start))
            return np.any(np.abs(left) < NEAR * np.abs(whole))

        bounds = [(name, side[name]) for name in self.order for side in (self.low, self.high)]
        return [name for name, bound in bounds if bound is not None and touches(name, bound)]

    def flat(self, parameters: dict[str, Parameter]) -> Float[AnyArray, " P"]:
        """A dict of parameters as one vector (P,), in the order of `names`; NumPy's unless it is traced."""
        array = jnp if traced(parameters) else np
        parts = [
            array.broadcast_to(parameters[name], self.start[name].shape).ravel()
            for name in self.order
        ]
        return array.concatenate(parts)

    def unflat(self, vector: Float[AnyArray, " P"]) -> dict[str, Numbers]:
        """The inverse of `flat`: a vector (P,) as a dict of the parameters' shapes."""
        ends = np.cumsum([self.start[name].size for name in self.order])
        return {
            name: vector[end - self.start[name].size : end].reshape(self.start[name].shape)
            for name, end in zip(self.order, ends)
        }

    @compiled
    def slopes(self, x: Float[AnyArray, " P"]) -> Float[AnyArray, " P"]:
        """d theta/d x at x, (P,): every parameter has a coordinate of its own."""
        return jax.jvp(lambda x: self.flat(self.parameters(x)), (x,), (jnp.ones_like(x),))[1]


def _interval(name, value, bounds):
    low, high = (
        None if bound is None else parameter(f"bounds[{name!r}]", bound)
        for bound in bounds or (None, None)
    )
    for bound, side, inside in ((low, "above", np.greater), (high, "below", np.less)):
        if bound is not None and not np.all(inside(value, bound)):
            refuse(
                name,
                f"a start {side} its bound {show(bound)}",
                show(value),
                "A bound is no place to start from.",
            )
    return low, high
