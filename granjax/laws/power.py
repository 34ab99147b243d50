"""The plus power [s]_+^p, differentiable to any order and fast for static p.

An open contact has no force and no stiffness. At every order,

    [s]_+^p = s^p,   d/ds [s]_+^p = p [s]_+^(p-1)   for s > 0,   and zero for s <= 0.

At s = 0 some one-sided limits of the derivatives are infinite (from the second on for p = 3/2);
granjax returns zero there, so that an open or touching contact never gives NaN. A NaN overlap stays
NaN.
"""

from functools import cache, partial

import jax.numpy as jnp

from ..base.derivatives import with_rule
from ..base.types import Number, Numbers
from .real_power import logarithm, real_power, root


def plus_power(s: Number, p: Number) -> Numbers:
    """Return [s]_+^p, elementwise.

    **Arguments:** `s`: overlap, any shape. `p`: exponent of any sign; a Python number is static,
    and a multiple of one half then costs only multiplications and one square root; an array may be
    traced and is differentiable. **Returns:** an array of the broadcast shape of `s` and `p`; zero
    where `s <= 0`, NaN where `s` is NaN.

    **Example:**

    >>> gx.laws.plus_power(jnp.array([-1.0, 4.0]), 1.5)
    Array([0., 8.], dtype=float64)
    """
    if isinstance(p, (int, float)):
        return _static_power(s, float(p))
    # A whole number takes the type of s.
    return _free_power(s, jnp.asarray(p, jnp.result_type(s, p, float)), 0)


def _static_power(s, p):
    def rule(arrays, changes):
        (s,), (ds,) = arrays, changes
        if p == 0.0:
            return _static_power(s, p), jnp.zeros_like(s * ds)
        return _static_power(s, p), p * _static_power(s, p - 1.0) * ds

    return with_rule(_with_exponent(p), rule, s)


# One function an exponent, and one a k, for each to be traced once.
@cache
def _with_exponent(p):
    return partial(_power, p=p)


def _power(s, p):
    if p == 0.0:
        return jnp.where(s <= 0, 0.0, jnp.where(jnp.isnan(s), s, 1.0)).astype(jnp.result_type(s))
    if p > 0.0:
        return _power_of_positive(jnp.maximum(s, 0), p)
    is_open = s <= 0
    return jnp.where(is_open, 0, _power_of_positive(jnp.where(is_open, 1, s), p))


def _power_of_positive(x, p):
    twice = 2 * abs(p)
    if twice > 16 or twice != int(twice):
        return real_power(x, p)
    whole, half = divmod(int(twice), 2)
    factors = [x] * whole + ([root(x)] if half else [])
    power = factors[0]
    for factor in factors[1:]:
        power = power * factor
    return power if p > 0 else 1 / power


def _free_power(s, p, k):
    # s^p log(s)^k for s > 0, else zero: closed under differentiation in s and in p.
    def rule(arrays, changes):
        s, p = arrays
        ds, dp = changes
        value = _free_power(s, p, k)
        # A derivative that is not needed is left out: where it overflows, zero times it would be NaN.
        change = jnp.zeros_like(value)
        if ds is not None:
            slope = p * _free_power(s, p - 1, k)
            if k:
                slope = slope + k * _free_power(s, p - 1, k - 1)
            change = change + slope * ds
        if dp is not None:
            change = change + _free_power(s, p, k + 1) * dp
        return value, change

    return with_rule(_with_logarithms(k), rule, s, p)


@cache
def _with_logarithms(k):
    def power(s, p):
        is_open = s <= 0
        x = jnp.where(is_open, 1, s)
        value = real_power(x, p)
        if k:
            value = value * logarithm(x) ** k
        # Finite, so that a factor p - 1 = 0 in front of it gives zero.
        most = jnp.finfo(value.dtype).max
        return jnp.where(is_open, 0, jnp.clip(value, -most, most))

    return power
