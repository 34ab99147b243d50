"""`design`: minimise or maximise a scalar of a simulation, of modes or of bands by its gradient."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Integer

from ..base.checks import described, one_of, parameter, refuse, whole, within
from ..base.checks import tolerance as checked_tolerance
from ..base.types import AnyArray, Count, Numbers, Parameter, Scalar
from ..results import Result, array
from .descent import (
    CONVERGED,
    NO_GRADIENT,
    NO_START,
    NOT_FINITE,
    SPENT,
    STALLED,
    descend,
    value_and_gradient,
)
from .determined import listed
from .parameters import Bounds, Coordinates, looked_up

MODES = ("forward", "reverse")
# up to this many parameters a simulation in forward mode is faster, compilation included
FEW = 20


class Design(Result):
    """The result of `design`: the best point that it met.

    `code`: 0 converged, 1 stalled, 2 steps spent, 3 not finite on the way, 4 gradient zero at the
    start, 5 not finite at the start.
    """

    parameters: dict[str, Numbers] = array("The parameters, by name.")
    value: Float[AnyArray, ""] = array("The objective at the best point.")
    start_value: Float[AnyArray, ""] = array("The objective at the start.")
    history: Float[AnyArray, " point"] = array(
        "The objective at each point, the start first; NaN after the last point."
    )
    gradient_norm: Float[AnyArray, " point"] = array(
        "The largest entry of the gradient in the free coordinates at each point."
    )
    start_gradient: Float[AnyArray, " parameter"] = array(
        "The gradient at the start in the free coordinates, by `names`."
    )
    iterations: Integer[AnyArray, ""] = array("The number of iterations.")
    every: Numbers = array(
        "The best value from each start; NaN for a start without a gradient.", axes="start"
    )
    code: Integer[AnyArray, ""] = array("The code of how the search ended.")
    names: tuple[str, ...] = array(
        "The names of the parameters.", axes="parameter", name="parameter", static=True
    )

    @property
    def outcome(self) -> str:
        code = int(self.code)
        slopes = self.start_gradient
        if code == NO_GRADIENT:
            return (
                "The gradient is exactly zero at the start: the objective does not feel the parameters there. Look "
                "for a contact that never closes, a run that ends too early or a measure that is a step, and start "
                "elsewhere."
            )
        if code == NO_START:
            which = listed(self.names, ~np.isfinite(slopes)) or "no parameter"
            return (
                f"The start is not finite: the objective is {float(self.start_value):.6g}, its gradient is not "
                f"finite in {which}."
            )
        went = f"the objective went from {float(self.start_value):.6g} to {float(self.value):.6g}"
        left = self.gradient_norm[self.iterations] / np.abs(slopes).max()
        sentence = {
            CONVERGED: f"Converged: {went} in {int(self.iterations)} steps, the gradient is {left:.0e} of the start's.",
            STALLED: f"No step is better: {went} in {int(self.iterations)} steps, the gradient is {left:.0e} of the "
            "start's (a kink or the floor of rounding).",
            SPENT: f"The {int(self.iterations)} steps are spent: {went}, the gradient is {left:.0e} of the start's.",
            NOT_FINITE: f"Stopped where the objective is not finite: {went} in {int(self.iterations)} steps. "
            "Give bounds.",
        }[code]
        still = listed(self.names, slopes == 0)
        return sentence + (f" At the start it does not feel {still}." if still else "")


def design(
    objective: Callable[[Any], Any],
    start: dict[str, Parameter],
    *,
    bounds: Bounds = None,
    maximise: bool = False,
    optimiser: object = None,
    max_steps: Count = 200,
    tolerance: Scalar = 1e-6,
    mode: str | None = None,
    starts: Count | Sequence[dict[str, Parameter]] | None = None,
    seed: Count = 0,
    throw: bool = True,
) -> Design:
    r"""Find parameters that minimise (or maximise) an objective, by its gradient.

    The optimiser moves the free coordinates of `granjax.fit.parameters.Coordinates`, which keep the
    bounds. The objective and its gradient are one compiled program; the best point met is kept. It
    is a local optimum: `starts` tries several.

    **Arguments:**

    - `objective(parameters)`: one real number, by any JAX function of the dict: of `simulate` and
      its records, `granjax.linear.normal_modes`, `granjax.linear.bands` with `cell=`, a breather.
      Give `simulate` its `step`: reverse mode must know the number of steps.
    - `start`: dict from name to number or array; `bounds`: dict from name to (low, high), `None`
      for no bound.
    - `maximise`: whether to maximise.
    - `optimiser`: any of optax; `None` takes `optax.lbfgs` with steps that are shortened until the
      objective falls. With kinks or noise try
      `optax.adam(optax.cosine_decay_schedule(0.1, max_steps))`.
    - `max_steps`: the most steps. `tolerance`: it ends when every entry of the gradient is below
      `tolerance` times its own largest, or 1e-4 of the start's largest entry.
    - `mode`: `"forward"` costs some 2.4 runs of a simulation per parameter, keeps no steps (with
      `adjoint=diffrax.ForwardMode()`) and compiles three times faster. `"reverse"` costs six to
      eight runs for all parameters and keeps every step, or checkpoints by
      `adjoint=diffrax.RecursiveCheckpointAdjoint()`, which has no forward mode. `None`: forward for
      up to 20 parameters.
    - `starts`: a list of dicts tried beside `start`, or the number of random ones: normal with
      deviation 1 in the free coordinates, from `seed`. The best is returned.
    - `throw`: raise if no start has a finite gradient that is not zero.

    **Returns:** `Design`. **Raises** ValueError for invalid input; RuntimeError with `throw` if the
    gradient at the start is exactly zero or not finite.

    **Example:**

    >>> def miss(p):
    ...     chain = gx.scenes.dimer(20, ratio=p["ratio"], precompression=1.0, boundary="periodic")
    ...     return (gx.linear.normal_modes(chain).omega[-1] - 3.0) ** 2
    >>> found = gx.design(miss, {"ratio": 0.8}, bounds={"ratio": (0.1, 1.0)})
    >>> round(float(found.parameters["ratio"]), 3)
    0.5
    """
    coordinates = Coordinates(start, bounds)
    mode = one_of("mode", mode or MODES[coordinates.size > FEW], MODES)
    tolerance = checked_tolerance("tolerance", tolerance)
    max_steps = whole("max_steps", max_steps)
    zero = np.zeros(coordinates.size)
    sign = -1.0 if maximise else 1.0
    if coordinates.sizeless:
        cost = _Cost(objective, coordinates, sign)
        coordinates = coordinates.sized(*value_and_gradient(cost, mode, zero))
    every = (coordinates, *_others(coordinates, bounds, starts, seed))
    costs = [_Cost(objective, each, sign) for each in every]
    ends = [descend(cost, zero, optimiser, max_steps, tolerance, mode) for cost in costs]
    reached = np.array([end.least if end.code < NO_GRADIENT else np.nan for end in ends])
    best = int(np.argmin(np.nan_to_num(reached, nan=np.inf)))
    end = ends[best]
    coordinates = every[best]
    history, norms = np.full((2, max_steps + 1), np.nan)
    history[: len(end.values)] = end.values
    norms[: len(end.norms)] = end.norms
    numbers = (
        sign * end.least,
        sign * end.values[0],
        sign * history,
        norms,
        end.start,
        len(end.values) - 1,
        sign * reached,
        end.code,
    )
    parameters = coordinates.parameters(jnp.asarray(end.x))
    found = Design(parameters, *map(jnp.asarray, numbers), tuple(coordinates.names))
    if throw and end.code in (NO_GRADIENT, NO_START):
        raise RuntimeError(found.outcome)
    return found


def smooth_peak(
    values: Parameter, power: Scalar = 40, axis: int | tuple[int, ...] | None = None
) -> Numbers:
    r"""Return a smooth largest value of positive quantities: the p-norm (mean [v]_+^p)^{1/p}.

    It lies between the mean and the largest value, whose kink where two peaks change places it
    rounds off. A history needs frames that resolve it; `simulate(record={"peak": Peak(...)})` finds
    each largest value between steps, smooth but for such kinks.

    **Arguments:** `values`: those below zero count as zero. `power`: p > 1, typical 20 ... 100.
    `axis`: `None` for all.
    """
    values = jnp.maximum(parameter("values", values), 0)
    if values.size == 0:
        refuse("values", "at least one number", "none")
    power = within("power", power, 1, np.inf, open_low=True, open_high=True)
    return _peak(values, power, axis)


@partial(jax.jit, static_argnums=2)
def _peak(values, power, axis):
    top = jax.lax.stop_gradient(values.max(axis, keepdims=True))
    top = jnp.where(top > 0, top, 1)
    mean = ((values / top) ** power).mean(axis, keepdims=True)
    some = mean > 0
    norm = jnp.where(some, top * jnp.where(some, mean, 1) ** (1 / power), 0)
    return norm.squeeze(axis) if axis is not None else norm.reshape(())


def _others(coordinates, bounds, starts, seed):
    if starts is None:
        return []
    if isinstance(starts, (list, tuple)):
        for start in starts:
            if start.keys() != coordinates.start.keys():
                refuse("starts", f"dicts of {', '.join(coordinates.order)}", described(start))
        return [
            Coordinates(coordinates.unflat(coordinates.flat(start)), bounds) for start in starts
        ]
    size = whole("starts", starts), coordinates.size
    draws = np.random.default_rng(whole("seed", seed)).normal(size=size)
    return [Coordinates(coordinates.parameters(jnp.asarray(x)), bounds) for x in draws]


class _Cost(eqx.Module):
    objective: Callable
    coordinates: Coordinates
    sign: float = eqx.field(static=True)

    def __call__(self, x):
        parameters = self.coordinates.parameters(x)
        value = jnp.asarray(looked_up("objective", self.objective, parameters))
        if value.ndim or not jnp.issubdtype(value.dtype, jnp.floating):
            refuse(
                "objective",
                "a function that gives one real number",
                f"one that gives {described(value)}",
                "Reduce it, such as by .sum() or smooth_peak.",
            )
        return self.sign * value
