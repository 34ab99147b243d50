r"""Steps of a linear chain, m u_n'' = K (u_{n-1} - 2 u_n + u_{n+1}), as sums of Bessel functions.

With w = (K/m)^{1/2} the strain y_n = u_n - u_{n+1} is

    velocity step  v_n = -2c sign(n):      y_n(t) = 2c int_0^t [J_{2n}(2ws) + J_{2n+2}(2ws)] ds,
    strain step    y_n = c for n <= 0:     y_n(t) = c sum_{j >= n} J_{2j}(2wt).

The strain is zero ahead of |n| = w t and an Airy function at the front; behind the front it rings
with falling amplitude around the plateau 2c/w or c/2. The midpoint rule of M points, for Fourier
integrals of analytic periodic functions, errs by J_{2M - 2n}(2wt); M is chosen from t, with an
error of about 1e-14 of 2c/w or c.

    import numpy as np
    n = np.arange(-60, 60)
    y = gx.theory.linear_shock.velocity_step(n, 40.0, 0.5)

Source: E. Schroedinger, Ann. Phys. 44, 916 (1914); A. Mielke, C. Patz, Z. Anal. Anwend. 36, 441
(2017).
"""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from ..base.checks import concrete, known_value, non_negative, parameter, positive, refuse, show
from ..base.types import Numbers, Parameter

# J_{2n}(2wt) is below rounding from WIDTHS (w t)^{1/3} + MORE sites ahead of the front
WIDTHS = 8.0
# the constant part of that distance
MORE = 24
# the fewest points of the midpoint rule; their number is a power of two
LEAST = 64


def velocity_step(
    n: Parameter, t: Parameter, c: Parameter, K2: Parameter = 1.0, mass: Parameter = 1.0
) -> Numbers:
    """Return the strain of bond n at time t after v_n = -2c sign(n), sign(0) = 0.

    **Arguments:** `n`: whole numbers, bond n between the sites n and n + 1; `t` >= 0 [s];
    `c` [m/s]; `K2` > 0 [N/m]; `mass` > 0 [kg]: arrays that broadcast, `n[:, None]` and `t` for all
    pairs.

    **Returns:** y [m], differentiable in all but n; for c = K = m = 1 about 2 near n = 0 at late
    times.

    **Raises** ValueError for bonds that are not whole numbers, t < 0, and a t that `jax.jit` or
    `jax.vmap` traces, because it sets the number of points of the sum.

    **Example:**

    >>> y = gx.theory.linear_shock.velocity_step(np.arange(-50, 51), 20.0, 1.0)
    >>> round(float(y.max()), 4), abs(float(y[-1])) < 1e-12
    (2.4471, True)
    """
    n, c, w, mean = _given(n, t, c, K2, mass, 1)
    return 2 * c / w * mean


def strain_step(
    n: Parameter, t: Parameter, c: Parameter, K2: Parameter = 1.0, mass: Parameter = 1.0
) -> Numbers:
    """Return the strain of bond n at time t in a chain released at rest with y_n = c for n <= 0.

    Bonds n > 0 have no strain at first. **Arguments**, **Raises**: as `velocity_step`, `c` [m].

    **Returns:** y [m]; for c = 1 about 1/2 near n = 0 at late times, 1.27/2 at the first crest.

    **Example:**

    >>> y = gx.theory.linear_shock.strain_step(np.arange(-50, 51), 20.0, 1.0)
    >>> round(float(y[0]), 6), round(float(y[50]), 2), abs(float(y[-1])) < 1e-12
    (1.0, 0.5, True)
    """
    n, c, _, mean = _given(n, t, c, K2, mass, -1)
    return c * (jnp.where(n <= 0, 1.0, 0.0) + mean)


# `side`: 1 for a velocity step, -1 for a strain step
def _given(n, t, c, K2, mass, side):
    n = parameter("n", n)
    c = parameter("c", c)
    t = non_negative("t", t, "Before t = 0 the chain is at rest.")
    w = jnp.sqrt(positive("K2", K2) / positive("mass", mass))
    whole = concrete(n)
    known = known_value(w * t)
    if whole is None or not np.array_equal(whole, np.round(whole)):
        got = "traced ones" if whole is None else show(whole)
        refuse("n", "whole numbers, those of bonds, that are known", got)
    if known is None:
        refuse(
            "t",
            "times that are known, and K2 and mass",
            "ones that jax.jit or jax.vmap traces",
            "jax.grad and jax.jvp may go through it.",
        )
    most = known.max(initial=0.0)
    reach = most + WIDTHS * most ** (1 / 3) + MORE
    points = max(LEAST, 1 << int(np.ceil(np.log2(2 * reach))))
    return n, c, w, _mean(n, w * t, points, side)


# a mean over angles: int_0^x [J_{2n}(2s) + J_{2n+2}(2s)] ds, for side -1 int_0^x J_{2n-1}(2s) ds
@partial(jax.jit, static_argnums=(2, 3))
def _mean(n, x, points, side):
    odd = np.arange(1, points, 2)
    angle = np.pi * odd / (2 * points)
    sine = np.sin(angle)
    # the angles are reduced in integers, without rounding
    order = (2 * n + side).astype(int)[..., None]
    turn = jnp.mod(order * odd, 4 * points) * (np.pi / (2 * points))
    x = x[..., None]
    if side == 1:
        terms = jnp.cos(turn) * np.cos(angle) * jnp.sin(2 * x * sine) / sine
    else:
        terms = jnp.sin(turn) * jnp.sin(x * sine) ** 2 / sine
    return jnp.where(jnp.abs(n) < points // 2, 2 / points * terms.sum(-1), 0.0)
