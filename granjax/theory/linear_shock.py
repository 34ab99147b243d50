r"""Steps of a linear chain, m u_n'' = K (u_{n-1} - 2 u_n + u_{n+1}), by sums of Bessel functions.

With w = (K/m)^{1/2} the strain y_n = u_n - u_{n+1} is

    velocity step  v_n = -2c sign(n):      y_n(t) = 2c int_0^t [J_{2n}(2ws) + J_{2n+2}(2ws)] ds,
    strain step    y_n = c for n <= 0:     y_n(t) = c sum_{j >= n} J_{2j}(2wt).

Ahead of |n| = w t there is nothing, at the front an Airy function, behind it the plateau 2c/w or c/2 with a ringing
that fades. Both are Fourier integrals of something analytic and periodic: the midpoint rule of M points, chosen from
t, errs by J_{2M - 2n}(2wt), right to 1e-14 or so of 2c/w and c.

    import numpy as np
    n = np.arange(-60, 60)
    y = gx.theory.linear_shock.velocity_step(n, 40.0, 0.5)

Source: E. Schroedinger, Ann. Phys. 44, 916 (1914); A. Mielke, C. Patz, Z. Anal. Anwend. 36, 441 (2017).
"""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from ..checks import concrete, non_negative, parameter, positive, refuse, show
from ..types import Numbers, Parameter

__all__ = ["strain_step", "velocity_step"]

# sites beyond the front, of its widths w t^{1/3} and alone, where J_{2n}(2wt) is below rounding
WIDTHS, MORE = 8.0, 24
LEAST = 64


def velocity_step(
    n: Parameter, t: Parameter, c: Parameter, K2: Parameter = 1.0, mass: Parameter = 1.0
) -> Numbers:
    """Strain of bond n, between the sites n and n + 1, at time t after v_n = -2c sign(n), sign(0) = 0.

    **Arguments:** `n`: whole numbers; `t` >= 0 [s]; `c` [m/s]; `K2` > 0 [N/m]; `mass` > 0 [kg]: arrays that broadcast,
    `n[:, None]` and `t` for all of both. **Returns:** y [m], differentiable in all but n. **Raises** ValueError for
    bonds that are no whole numbers, t < 0, and a t that is traced by `jax.jit` or `jax.vmap`: it says how many points
    the sum has. Typical: c = K = m = 1: 2 near n = 0 at late times.

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
    """Strain of bond n at time t after y_n = c for n <= 0, zero for n > 0, of a chain at rest.

    **Arguments**, **Raises**: as `velocity_step`, `c` [m]. **Returns:** y [m]. Typical: c = 1: 1/2 near n = 0 at late
    times, 1.27/2 at the first crest.

    **Example:**

    >>> y = gx.theory.linear_shock.strain_step(np.arange(-50, 51), 20.0, 1.0)
    >>> round(float(y[0]), 6), round(float(y[50]), 2), abs(float(y[-1])) < 1e-12
    (1.0, 0.5, True)
    """
    n, c, _, mean = _given(n, t, c, K2, mass, -1)
    return c * (jnp.where(n <= 0, 1.0, 0.0) + mean)


def _given(n, t, c, K2, mass, side):
    """n, c and w = (K2/m)^{1/2} as arrays, and the `_mean` of a velocity step, `side` 1, or of a strain step, -1."""
    n, c = parameter("n", n), parameter("c", c)
    t = non_negative("t", t, "Before t = 0 the chain is at rest.")
    w = jnp.sqrt(positive("K2", K2) / positive("mass", mass))
    whole, known = concrete(n), concrete(jax.lax.stop_gradient(w * t))
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


@partial(jax.jit, static_argnums=(2, 3))
def _mean(n, x, points, side):
    """int_0^x [J_{2n}(2s) + J_{2n+2}(2s)] ds, or of side -1 int_0^x J_{2n-1}(2s) ds, as a mean over angles."""
    odd = np.arange(1, points, 2)
    angle = np.pi * odd / (2 * points)
    sine = np.sin(angle)
    # whole numbers turn by whole parts of a circle, without rounding
    order = (2 * n + side).astype(int)[..., None]
    turn = jnp.mod(order * odd, 4 * points) * (np.pi / (2 * points))
    x = x[..., None]
    if side == 1:
        terms = jnp.cos(turn) * np.cos(angle) * jnp.sin(2 * x * sine) / sine
    else:
        terms = jnp.sin(turn) * jnp.sin(x * sine) ** 2 / sine
    return jnp.where(jnp.abs(n) < points // 2, 2 / points * terms.sum(-1), 0.0)
