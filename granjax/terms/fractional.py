"""The discrete fractional Laplacian: its kernel and its symbol, on an infinite chain and a ring."""

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import gammaln

from ..base.arrays import trailing
from ..base.checks import whole, within
from ..base.programs import by_rows
from ..base.types import Count, Numbers, Parameter
from ..laws import plus_power

__all__ = ["kernel", "symbol", "total"]


def checked_order(order: Parameter) -> jax.Array:
    """Return the order s of a fractional Laplacian, in (0, 1]."""
    return within(
        "order",
        order,
        0,
        1,
        open_low=True,
        remedy="s = 1 is next neighbours; above 1 the weights change sign, at 0 nothing is coupled.",
    )


def kernel(order: Parameter, offsets: Count) -> Numbers:
    r"""Return the weights K(1), ..., K(M) of the discrete fractional Laplacian.

    ((-Delta)^s u)_n = sum_{m != 0} K(m) (u_n - u_{n+m}),
    K(m) = 4^s Gamma(1/2 + s)/(sqrt(pi) |Gamma(-s)|) Gamma(|m| - s)/Gamma(|m| + 1 + s),

    on the infinite chain; its symbol is (4 sin^2(k/2))^s. K(1) = Gamma(1 + 2s) s/((1 + s)
    Gamma(1 + s)^2) and K(m + 1) = K(m) (m - s)/(m + 1 + s), without large numbers, and without 0/0
    at s = 1: K = 1, 0, 0, ...

    **Arguments:** `order`: s in (0, 1], a number, or one per lane (*lanes), possibly traced;
    differentiable. `offsets`: M >= 1. **Returns:** (M, *lanes), positive for s < 1, with the
    tail ~ m^{-1-2s}; rounding below 1e-14 sqrt(M) of each. **Raises** ValueError for s outside
    (0, 1]. Source: Ciaurri et al., Adv. Math. 330, 688 (2018).
    """
    s = checked_order(order)
    count = whole("offsets", offsets, 1)
    m = trailing(jnp.arange(1, count, dtype=s.dtype), 1 + s.ndim)
    first = s / (1 + s) * total(s)
    return jnp.concatenate([first[None], first * jnp.cumprod((m - s) / (m + 1 + s), axis=0)])


def total(order: Parameter) -> Numbers:
    """Return the sum of all weights, Gamma(1 + 2s)/Gamma(1 + s)^2: a site's stiffness."""
    s = jnp.asarray(order)
    return jnp.exp(gammaln(1 + 2 * s) - 2 * gammaln(1 + s))


def symbol(order: Parameter, k: Parameter) -> Numbers:
    """Return (4 sin^2(k/2))^s at wave numbers k of any shape; the lanes of the order come last."""
    s = checked_order(order)
    k = jnp.asarray(k, s.dtype)
    return plus_power(4 * jnp.sin(trailing(k, k.ndim + s.ndim) / 2) ** 2, s)


def wave_numbers(sites: Count) -> np.ndarray:
    """Return the wave numbers 2 pi j/N of a ring, j = 0 ... N-1, those above pi reflected."""
    j = np.arange(sites)
    return 2 * np.pi * np.minimum(j, sites - j) / sites


def ring_kernel(order: Parameter, sites: Count) -> Numbers:
    """Return the weights of the offsets 1, ..., N-1 on a ring: `kernel` summed over images.

    The inverse Fourier transform of the symbol: omega^2 = (4 sin^2(k/2))^s at the ring's wave
    numbers. Shape (N-1, *lanes), symmetric in m and N-m.
    """
    sites = whole("sites", sites, 2)
    values = symbol(order, wave_numbers(sites))
    return -by_rows(jnp.fft.fft, values, axis=0).real[1:] / sites


# Number of images of a ring that are summed directly; the rest is an Euler-Maclaurin series.
IMAGES = 16


def to_the_right(order: Parameter, sites: Count) -> Numbers:
    """Return the rightward part of `ring_kernel`, sum_{j >= 0} K(m + j N), m = 1, ..., N-1.

    The rest is that of N - m. Laws without left-right symmetry, such as alpha e^2, need it.
    """
    s = checked_order(order)
    sites = whole("sites", sites, 2)
    both = ring_kernel(s, sites)
    near = jnp.concatenate([jnp.zeros((1, *s.shape), s.dtype), kernel(s, IMAGES * sites - 1)])
    near = jnp.sum(near.reshape(IMAGES, sites, *s.shape), axis=0)[1:]
    far = trailing(jnp.arange(1, sites, dtype=s.dtype), 1 + s.ndim) + IMAGES * sites
    right = near + _beyond(s, far, sites)
    return (both + right - right[::-1]) / 2


def _beyond(s, z, spacing):
    # sum_{j >= 0} K(z + j N) for large z, by K = C z^{-1-2s} exp(a/z^2 + b/z^4 + ...).
    a = s * (s + 1) * (2 * s + 1) / 6
    b = (s**5 + 2.5 * s**4 + 5 / 3 * s**3 - s / 6) / 10
    parts = ((1.0, 1 + 2 * s), (a, 3 + 2 * s), (b + a * a / 2, 5 + 2 * s))
    x = spacing / z

    def tail(q):  # over z^{-q}
        rising = q * (q + 1) * (q + 2)
        return (
            1 / (x * (q - 1))
            + 0.5
            + q * x / 12
            - rising * x**3 / 720
            + rising * (q + 3) * (q + 4) * x**5 / 30240
        )

    scale = jnp.exp(gammaln(1 + 2 * s)) * jnp.sin(jnp.pi * s) / jnp.pi
    return scale * sum(weight * z**-q * tail(q) for weight, q in parts)
