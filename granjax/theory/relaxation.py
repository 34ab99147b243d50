"""The Mittag-Leffler function, the counterpart of the exponential for fractional relaxation."""

import jax.numpy as jnp
import numpy as np

from ..base.checks import parameter, require, within
from ..base.programs import compiled
from ..base.types import Number, Parameter

# nodes on the parabola of Weideman and Trefethen: the error of the rule falls as 2.85^-NODES, and
# that of rounding grows as exp(0.13 NODES)
NODES = 32


def mittag_leffler(z: Parameter, order: Parameter, second: Parameter = 1.0) -> Number:
    r"""Return the Mittag-Leffler function E_{a,b}(z) for z <= 0 and 0 < a <= 1.

        E_{a,b}(z) = sum over k of z^k/Gamma(a k + b)

    E_a(-t^a) solves D^a y = -y, y(0) = 1, with Caputo's derivative D^a. It falls as
    1 - t^a/Gamma(1 + a) at early times and as t^{-a}/Gamma(1 - a) at late times. E_1(z) = exp(z),
    E_{1/2}(-x) = exp(x^2) erfc(x).

    It is the inverse Laplace transform, (1/2 pi i) times the integral of e^s s^{a-b}/(s^a - z),
    along a parabola around the negative axis. The error is below 2e-14 for b <= 1, 1e-12 for b = 2
    and 2e-11 for b = 3.

    **Arguments:** `z` <= 0; `order`: a in (0, 1]; `second`: b in (0, 3]. They broadcast;
    differentiable in all.

    **Raises** ValueError for other arguments: z > 0, where it grows as exp(z^{1/a})/a, and a > 1,
    where it oscillates, need the poles, which are not included.

    Source: J. A. C. Weideman, L. N. Trefethen, Math. Comput. 76, 1341 (2007); R. Garrappa, SIAM J.
    Numer. Anal. 53, 1350 (2015).

    **Example:**

    >>> round(float(gx.theory.mittag_leffler(-1.0, 1.0)), 6)  # exp(-1)
    0.367879
    >>> round(float(gx.theory.mittag_leffler(-1.0, 0.5)), 6)  # e erfc(1)
    0.427584
    """
    z = parameter("z", z)
    second = within(
        "second", second, 0, 3, open_low=True, remedy="The contour is too coarse for larger b."
    )
    order = within("order", order, 0, 1, open_low=True, remedy="Relaxation has orders up to 1.")
    require("z", z, lambda z: z <= 0, "z <= 0", "E_a(-t^a) is what decays.")
    return _by_contour(z, order, second)


@compiled
def _by_contour(z, order, second):
    theta = (2 * np.arange(NODES // 2) + 1) * np.pi / NODES
    s = jnp.asarray(NODES * (0.1309 - 0.1194 * theta**2 + 0.25j * theta))
    weight = jnp.exp(s) * NODES * (-0.2388 * theta + 0.25j) * (2 / NODES)
    z, order, second = (x[..., None] for x in jnp.broadcast_arrays(z, order, second))
    log = jnp.log(s)
    # the other half of the parabola is the mirror image, so the imaginary part gives the whole
    found = jnp.imag(weight * jnp.exp((order - second) * log) / (jnp.exp(order * log) - z)).sum(-1)
    return found.astype(z.dtype)
