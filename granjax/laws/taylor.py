"""Taylor coefficients of any law."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from ..printing import told
from ..types import Number
from .base import Law


class Taylor(NamedTuple):
    """F(e) = K2 e + K3 e^2 + K4 e^3 + ...

    **Example:**

    >>> K2, K3, K4 = gx.laws.taylor(gx.Toda())
    >>> round(float(K3), 4)
    0.5
    """

    K2: jax.Array
    K3: jax.Array
    K4: jax.Array
    __repr__ = told


def taylor(law: Law, e: Number = 0.0) -> Taylor:
    """Taylor coefficients of a law about a compression, by nested derivatives.

    K2 = F'(e), K3 = F''(e)/2, K4 = F'''(e)/6. For Hertz with d0 = A = 1: 3/2, 3/8, -1/16.

    **Arguments:** `law`; `e`: compression about which to expand, 0 is equilibrium.
    **Returns:** `Taylor(K2, K3, K4)`, arrays of the shape of the law's parameters. In a sonic vacuum (Hertz without
    precompression) all three are zero: such a contact has no linear limit.

    **Example:**

    >>> gx.laws.taylor(gx.Hertz(precompression=1.0))
    Taylor(K2=1.5, K3=0.375, K4=-0.0625)
    """
    return _taylor(law, jnp.asarray(e, float))


@eqx.filter_jit
def _taylor(law, e):
    at = jnp.zeros(jax.eval_shape(law.force, e).shape) + e

    def slope(f):
        return lambda x: jax.jvp(f, (x,), (jnp.ones_like(x),))[1]

    first = slope(law.force)
    second = slope(first)
    third = slope(second)
    return Taylor(first(at), second(at) / 2, third(at) / 6)
