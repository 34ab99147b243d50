"""Step control: adaptive steps for scenes whose contacts open and close."""

import math
from collections.abc import Callable
from functools import cache
from typing import Any

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..checks import refuse
from ..types import Number, Pytree, Scalar, StateLike
from .breaks import cut

SAFETY = 0.8
SHRINK, GROW = 0.2, 3.0
HALVINGS = 3
# of an octave, to which a factor is rounded: an error is known to its rounding only, which steps that close in on an
# opening contact would else make larger from one to the next
PARTS = 8
# rounding units of t0 that a step has at least, as what they cost can be avoided
UNITS_AT_START = 256
# and of the later of t0 and t1, as a long run loses much in other ways: steps that change the time at all
UNITS_AT_END = 4


@cache
def rounding_unit(dtype: Any) -> float:
    """The spacing of the numbers of a floating type at 1, kept, as JAX takes long to say it."""
    return float(jnp.finfo(dtype).eps)


def least_tolerance(dtype: Any) -> float:
    """The smallest tolerance that a floating type can hold."""
    return 16 * rounding_unit(dtype)


def least_step(t0: Scalar, t1: Scalar, dtype: Any, larger: Callable = max) -> Scalar:
    """The shortest step whose ends the floating type tells apart well enough; `larger` takes two numbers."""
    start = UNITS_AT_START * abs(t0)
    return rounding_unit(dtype) * larger(start, UNITS_AT_END * larger(abs(t0), abs(t1)))


def refuse_unresolved(t0: Scalar, t1: Scalar, step: Scalar, dtype: Any) -> None:
    """Refuse times, known ones, that the floating type does not tell apart as well as steps need it."""
    if step < least_step(t0, t1, dtype):
        gap = rounding_unit(dtype) * max(abs(t0), abs(t1))
        finer = "" if dtype == np.dtype(float) else " Or compute in float64."
        refuse(
            "t0, t1, step",
            f"a step that is long against the gaps between numbers of {dtype} at these times",
            f"a step of {step:.3g} from t0 = {t0:g} to t1 = {t1:g}, where numbers lie {gap:.2g} apart",
            f"Count time from t0=0 (of what drives the lattice too), or take a longer step.{finer}",
        )


def tighter(tolerance: Number, by: Scalar, dtype: Any) -> Number:
    """A tolerance so many times smaller, or where the type does not hold that, one so many times larger."""
    return jnp.where(tolerance / by >= least_tolerance(dtype), tolerance / by, tolerance * by)


class Scales(eqx.Module):
    """Largest entry of displacements and of velocities, each by its own scale; what is not a number is infinite."""

    displacement: jax.Array
    velocity: jax.Array

    def __call__(self, y: StateLike) -> Number:
        u, v = y
        return jnp.maximum(largest(u) / self.displacement, largest(v) / self.velocity)


def largest(tree: Pytree) -> Number:
    """The largest entry of a tree; what is not a number is infinite."""
    sizes = [_maximum(jnp.abs(x).reshape(-1)) for x in jax.tree.leaves(tree)]
    return jnp.max(jnp.stack(sizes)) if len(sizes) > 1 else sizes[0]


def _maximum(x):
    # XLA's maximum over a long array may lose a NaN
    x = jnp.where(x < jnp.inf, x, jnp.inf)
    # nor does it vectorise: three times the two halves against each other, which overlap where the size is odd
    for _ in range(HALVINGS):
        half = (x.size + 1) // 2
        x = jnp.maximum(x[:half], x[x.size - half :])
    return jnp.max(x)


class StepControl(diffrax.AbstractAdaptiveStepSizeController):
    r"""Steps whose local error stays below a tolerance: h <- h min(3, max(1/5, 0.8 (tolerance/error)^(1/q))).

    q is the order of the error estimate; the factor is rounded to eighths of an octave. A step that fails is tried
    again, shorter; the next one that holds does not grow, since what a step meets first when a contact opens it meets
    again at once. The first step is short, `first` tolerance^(1/q), and no force is spent to choose it.

    **Arguments:** `atol`: the tolerance, dimensionless. `norm`: of a state, in scales of the scene. `first`: a time.
    `longest`: no step is longer; `None` for no such bound. `breaks`: those of a lattice; steps end there, and what
    follows one is as long as was meant before it.
    """

    atol: jax.Array
    norm: Callable
    first: jax.Array
    longest: jax.Array | None = None
    breaks: tuple = ()
    rtol: float = 0.0

    def wrap(self, direction):
        return self

    def init(self, terms, t0, t1, y0, dt0, args, func, error_order):
        step = self._bounded(self.first * self.atol ** (1 / error_order))
        if self.breaks:
            end, meant = cut(self.breaks, t0, step)
            return end, (jnp.asarray(False), meant)
        return t0 + step, jnp.asarray(False)

    def adapt_step_size(
        self, t0, t1, y0, y1_candidate, args, y_error, error_order, controller_state
    ):
        error = jax.lax.stop_gradient(self.norm(y_error) / self.atol)
        keep = error < 1
        failed, meant = controller_state if self.breaks else (controller_state, 0)
        most = jnp.where(failed | ~keep, 1.0, GROW)
        factor = jnp.exp2(
            jnp.round(PARTS * (math.log2(SAFETY) - jnp.log2(error) / error_order)) / PARTS
        )
        factor = jnp.clip(factor, SHRINK, most)
        step = self._bounded((t1 - t0) * factor.astype(t1.dtype))
        start = jnp.where(keep, t1, t0)
        stuck = ~(start + step > start)
        result = diffrax.RESULTS.where(
            stuck, diffrax.RESULTS.dt_min_reached, diffrax.RESULTS.successful
        )
        if self.breaks:
            end, meant = cut(self.breaks, start, jnp.where(keep, jnp.maximum(step, meant), step))
            return keep, start, end, False, (~keep, meant), result
        return keep, start, start + step, False, ~keep, result

    def _bounded(self, step):
        return step if self.longest is None else jnp.minimum(step, self.longest)
