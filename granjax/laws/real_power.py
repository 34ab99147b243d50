"""Powers and logarithms of positive numbers that vectorise on a CPU.

XLA calls a scalar function for every float64 `pow` and `log`. Here x = 2^e m is split by its bits,
sqrt(1/2) <= m < sqrt(2), and recombined by XLA's vectorised `exp`:

    log x = e log 2 + log m,     x^p = 2^n exp((p e - n) log 2 + p log m),     n = round(p e),

with p e exact to twice the digits: the relative error is about (2 + |p|) units in the last place.
log m is fdlibm's series (K. C. Ng, Sun Microsystems, 1993).

On some processors sqrt is slow too (`granjax.base.tuning.root_by_products`). There 1/sqrt(x) starts from
the halved exponent, accurate to 3 %, and two steps of fourth order leave 1.4 units in the last
place: y <- y (1 + h/2 + 3h^2/8 + 5h^3/16), h = 1 - x y^2.
"""

import jax.numpy as jnp
import numpy as np
from jax import lax

from ..base.tuning import root_by_products

_LOG2 = 0.6931471805599453
# log 2 in two parts. The last 21 bits of the first are zero, so its product with e is exact.
_LOG2_HIGH = 6.93147180369123816490e-01
_LOG2_LOW = 1.90821492927058770002e-10  # the second part
_SERIES = (
    6.666666666666735130e-01,
    3.999999999940941908e-01,
    2.857142874366239149e-01,
    2.222219843214978396e-01,
    1.818357216161805012e-01,
    1.531383769920937332e-01,
    1.479819860511658591e-01,
)
# The bits of sqrt(1/2), the least m.
_ROOT_HALF = int(np.float64(np.sqrt(0.5)).view(np.int64))
# Bits of 2^52 + 2048: adding an integer to them gives the float of that integer plus this offset,
# without a conversion.
_WHOLE = int(np.float64(2.0**52 + 2048).view(np.int64))
_OFFSET = 2.0**52 + 2048  # the offset as a float, which is subtracted again
# The mask that keeps the upper half of the digits of p, whose product with e is exact.
_HIGH_HALF = ~((1 << 27) - 1)
_TINY = float(np.finfo(float).tiny)
_HUGE = float(np.finfo(float).max)
# C. Lomont, Fast inverse square root (2003), for float64
_HALVED = 0x5FE6EB50C7B537A9


def real_power(x, p):
    """Return x^p for x >= 0 and p != 0, elementwise; NaN stays NaN, zero and infinity are exact.

    `x`: any floating type, fast for float64. `p`: a number or an array. Below the smallest normal
    number p counts as 1 or -1.
    """
    if x.dtype != jnp.float64:
        return x**p
    e, m = _split(x)
    p = jnp.asarray(p, x.dtype)
    high = lax.bitcast_convert_type(lax.bitcast_convert_type(p, jnp.int64) & _HIGH_HALF, x.dtype)
    whole = high * e
    n = jnp.clip(lax.round(whole, lax.RoundingMethod.TO_NEAREST_EVEN), -1022.0, 1023.0)
    scale = lax.bitcast_convert_type((n.astype(jnp.int64) + 1023) << 52, x.dtype)
    power = jnp.exp(((whole - n) + (p - high) * e) * _LOG2 + p * _log_near_one(m)) * scale
    return jnp.where((x >= _TINY) & (x < jnp.inf), power, jnp.where(p > 0, x, 1 / x))


def root(x):
    """Return sqrt(x) for x >= 0, elementwise, by the faster method on this processor.

    Zero, infinity and NaN stay as they are.
    """
    return _root_by_products(x) if x.dtype == jnp.float64 and root_by_products() else jnp.sqrt(x)


def _root_by_products(x):
    known = jnp.minimum(x, _HUGE)
    bits = lax.shift_right_logical(lax.bitcast_convert_type(known, jnp.int64), 1)
    y = lax.bitcast_convert_type(_HALVED - bits, x.dtype)
    for _ in range(2):
        h = 1 - known * y * y
        y = y + y * h * (0.5 + h * (0.375 + h * 0.3125))
    return x * y


def cube_root(x):
    """Return the cube root of x >= 0, elementwise, exact for factors of eight.

    XLA's x^(1/3) loses digits far from 1.
    """
    if x.dtype != jnp.float64:
        return jnp.cbrt(x)
    exponent = (lax.bitcast_convert_type(x, jnp.int64) >> 52) - 1023
    n = jnp.clip(exponent // 3, -340, 340)
    scale = [lax.bitcast_convert_type((power + 1023) << 52, x.dtype) for power in (-3 * n, n)]
    return jnp.cbrt(x * scale[0]) * scale[1]


def logarithm(x):
    """Return log x for x > 0, elementwise; NaN stays NaN.

    x is clipped at the smallest normal number.
    """
    if x.dtype != jnp.float64:
        return jnp.log(x)
    e, m = _split(jnp.maximum(x, _TINY))
    return jnp.where(x < jnp.inf, e * _LOG2_HIGH + (e * _LOG2_LOW + _log_near_one(m)), x)


def _split(x):
    # Return e, a whole number as a float, and m in [sqrt(1/2), sqrt(2)) with x = 2^e m.
    bits = lax.bitcast_convert_type(x, jnp.int64)
    e = (bits - _ROOT_HALF) >> 52
    return lax.bitcast_convert_type(e + _WHOLE, x.dtype) - _OFFSET, lax.bitcast_convert_type(
        bits - (e << 52), x.dtype
    )


def _log_near_one(m):
    f = m - 1
    s = f / (2 + f)
    z = s * s
    series = _SERIES[-1]
    for coefficient in _SERIES[-2::-1]:
        series = series * z + coefficient
    half = 0.5 * f * f
    return f - (half - s * (half + series * z))
