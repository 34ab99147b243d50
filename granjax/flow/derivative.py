"""The derivative of the result of a run, with its error."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..base.arrays import trailing
from ..base.checks import parameter, positive, traced
from ..base.programs import compiled
from ..base.types import Numbers, Pytree, Scalar
from ..results import Result, array

# The steps, relative to the given one. The derivative at the last one is returned.
LADDER = (1.0, 0.9, 0.8, 0.7, 0.6, 0.5)
# The factor on the largest difference. With it the error covered all of 36 derivatives of two
# kinked chains, without it 35.
COVER = 2
# `simulate` shortens steps to fit the saved times, so several steps of the ladder may be one. The
# steps are halved until the slopes have this many values, ...
DISTINCT = 4
# ... but not more often than this, as an exact slope is the same at all steps.
HALVINGS = 5
# A part of a derivative that is smaller than this part of the largest is zero but for rounding.
ROUNDED = 1e-12
# From this relative error on, the outcome says that the derivative depends on the steps.
UNSETTLED = 1e-3


class Derivative(Result):
    """A derivative and its error."""

    value: Pytree = array("The derivative at the last step, structured as `jax.jacfwd` gives it.")
    error: Pytree = array(
        "The estimated distance of the derivative from that of the true motion, of the same "
        "structure."
    )
    slopes: Pytree = array("The derivative at each step of `ladder`.")
    ladder: Numbers = array("The steps.", "s", "step")

    @property
    def relative(self) -> float:
        # Each leaf is relative to its own size, and one that is zero but for rounding to that of
        # all. NumPy's maximum keeps a NaN.
        largest = lambda x: np.abs(x).max()
        errors, sizes = (
            np.array([*map(largest, jax.tree.leaves(tree))]) for tree in (self.error, self.value)
        )
        sizes = np.maximum(sizes, ROUNDED * sizes.max())
        return float(np.max(errors / np.where(sizes > 0, sizes, 1)))

    @property
    def outcome(self) -> str:
        if not self.relative < np.inf:
            return "The derivative is not finite."
        if self.relative == 0:
            return f"The derivative is the same at all steps, down to {self.ladder[-1]:.3g}."
        known = f"The derivative is known to {self.relative:.1g} of its size."
        if self.relative <= UNSETTLED:
            return known
        return (
            f"{known} It hangs on where the steps lie, as with a force whose slope jumps (a kink): shorten the "
            "step, or take differences of runs at one step, whose error is of second order."
        )


def derivative(function: Callable[[Any, Any], Any], x: Pytree, step: Scalar) -> Derivative:
    """Return df/dx of a function of runs, and its error due to the time steps.

    The derivative of a run is that of its discrete steps. Where the slope of a force jumps (a
    bilinear spring, `PowerLaw` with exponent 1), the run converges with the second power of the
    step, its derivative erratically with the first. At the default step it may be wrong by
    tens of per cent. This function takes the derivative at several steps. The error is twice the
    largest difference from that at the shortest step, each scaled by the ratio of the steps.

    **Arguments:** `function(x, step)`: arrays from a `simulate(..., step=step)`; each new function
    compiles anew. `x`: parameters, a tree of floating numbers.
    `step` [s]: the longest, e.g. `run.stats["step"]` of a run at the default step; the shortest is
    half of it, or down to a 64th where saved times shorten the steps or a part is the same at
    all of them.

    **Returns:** `Derivative`. **Raises** ValueError for a step <= 0 or complex numbers.

    **Example:**

    >>> def end(stiffness, step):
    ...     chain = gx.Lattice(1.0, gx.Bond(gx.Shift(1, "fixed"), gx.Linear(stiffness)), sites=2)
    ...     return gx.simulate(chain, gx.states.impact(chain), 1.0, step=step).final.u[0]
    >>> slope = gx.derivative(end, 1.0, 0.05)
    >>> round(float(slope.value), 4), bool(slope.error < 1e-9)
    (-0.2579, True)
    """
    ladder = float(positive("step", step)) * np.asarray(LADDER)
    x = jax.tree.map(lambda a: parameter("x", a), x)
    slopes = _slopes(function, x, jnp.asarray(ladder))
    for _ in range(HALVINGS):
        if traced(slopes) or all(map(_settled, jax.tree.leaves(slopes))):
            break
        ladder = ladder / 2
        slopes = _slopes(function, x, jnp.asarray(ladder))
    value = jax.tree.map(lambda s: s[-1], slopes)

    def error(s):
        shares = LADDER[-1] / np.asarray(LADDER[:-1])
        apart = jnp.abs(s[:-1] - s[-1]) * trailing(shares, s.ndim)
        error = COVER * jnp.max(apart, axis=0)
        # Within jax.jit the steps are not halved.
        return jnp.where(_settled(s), error, jnp.inf) if traced(s) else error

    return Derivative(value, jax.tree.map(error, slopes), slopes, ladder)


def _settled(s):
    # Whether the slopes (ladder, ...) of a leaf have enough different values, or all are zero. Equal
    # ones are neighbours.
    rows = s.reshape(len(LADDER), -1)
    return (jnp.sum((rows[1:] != rows[:-1]).any(1)) >= DISTINCT - 1) | ~rows.any()


@compiled
def _slopes(function, x, ladder):
    return jax.lax.map(lambda step: jax.jacfwd(function)(x, step), ladder)
