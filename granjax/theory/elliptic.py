r"""Jacobi's elliptic functions and Legendre's integrals, for a parameter m = k^2 in [0, 1].

    u = F(phi, m) = int_0^phi (1 - m sin^2)^{-1/2},   sn u = sin phi,   cn u = cos phi,   dn^2 u = 1 - m sn^2 u

Every function takes m or its complement `m1` = 1 - m. Near m = 1, where solitons are, a
floating-point m has lost the digits of 1 - m, and K(m) = ln(4/m1^{1/2}) + ... needs them. All
functions act elementwise on arrays that broadcast, and are differentiable to any order, in both
modes, in every argument. The error is 1e-13, absolute or relative, whichever is larger; for large
|u| that of `jacobi` is |u| times the rounding unit, because of the reduction by the period. An m1
below 1e-307 counts as zero.

Methods: the arithmetic-geometric mean and Carlson's duplication for complete integrals, the latter
for incomplete ones, Landen's transformations for sn, cn, dn.

Source: B. C. Carlson, Numer. Algorithms 10, 13 (1995); R. Bulirsch, Numer. Math. 7, 78 (1965); NIST
Digital Library of Mathematical Functions, chapters 19, 20, 22; derivatives in m: section 19.4.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..base.checks import concrete, parameter, refuse, require, show, within
from ..base.printing import told
from ..base.types import Numbers, Parameter
from .elliptic_functions import _E, _F, _K, _complete, _complete_Pi, _jacobi, _zeta


class Jacobi(NamedTuple):
    """Jacobi's functions sn, cn, dn.

    **Example:**

    >>> values = gx.theory.elliptic.jacobi(1.0, 0.0)
    >>> round(float(values.sn), 6), round(float(values.dn), 6)  # sin 1 and 1
    (0.841471, 1.0)
    """

    sn: jax.Array
    cn: jax.Array
    dn: jax.Array
    __repr__ = told


def jacobi(u: Parameter, m: Parameter | None = None, *, m1: Parameter | None = None) -> Jacobi:
    """Return sn(u, m), cn(u, m), dn(u, m).

    They are sin u, cos u, 1 at m = 0 and tanh u, sech u, sech u at m = 1.

    **Arguments:** `u`: real; `m` in [0, 1], or `m1` = 1 - m. **Returns:** `Jacobi(sn, cn, dn)`.

    **Raises** ValueError for m outside [0, 1], values that are not finite, shapes that do not
    broadcast.

    **Example:**

    >>> sn, cn, dn = gx.theory.elliptic.jacobi(1.0, 1.0)
    >>> round(float(sn), 6), round(float(cn), 6)  # tanh 1, sech 1
    (0.761594, 0.648054)
    """
    (u,), m1 = _arguments(m, m1, u=u)
    return Jacobi(*_jacobi(_resolved(u, m1), m1))


def zeta(u: Parameter, m: Parameter | None = None, *, m1: Parameter | None = None) -> Numbers:
    """Return Jacobi's zeta function Z(u, m) = int_0^u dn^2 - u E/K.

    Its period is 2K; at m = 1 it is tanh u, and its slope in m infinite. **Arguments**,
    **Raises**: as `jacobi`.

    **Example:**

    >>> round(float(gx.theory.elliptic.zeta(1.0, 1.0)), 6)  # tanh 1
    0.761594
    """
    (u,), m1 = _arguments(m, m1, u=u)
    return _zeta(_resolved(u, m1), m1)


def K(m: Parameter | None = None, *, m1: Parameter | None = None) -> Numbers:
    """Return the complete integral of the first kind, K(m) = F(pi/2, m).

    It is pi/2 at m = 0 and infinite at m = 1.

    **Arguments:** `m` in [0, 1], or `m1` = 1 - m. **Raises** ValueError for others.

    **Example:**

    >>> round(float(gx.theory.elliptic.K(0.0)), 6), round(float(gx.theory.elliptic.K(0.5)), 6)
    (1.570796, 1.854075)
    """
    return _complete(_K, _arguments(m, m1)[1])


def E(m: Parameter | None = None, *, m1: Parameter | None = None) -> Numbers:
    """Return the complete integral of the second kind, E(m) = int_0^{pi/2} (1 - m sin^2)^{1/2}.

    It is pi/2 at m = 0 and 1 at m = 1, where its derivative is infinite.

    **Arguments**, **Raises**: as `K`.

    **Example:**

    >>> round(float(gx.theory.elliptic.E(0.0)), 6), round(float(gx.theory.elliptic.E(1.0)), 6)  # pi/2, 1
    (1.570796, 1.0)
    """
    return _complete(_E, _arguments(m, m1)[1])


def Pi(n: Parameter, m: Parameter | None = None, *, m1: Parameter | None = None) -> Numbers:
    """Return the complete integral of the third kind.

        Pi(n, m) = int_0^{pi/2} 1/((1 - n sin^2)(1 - m sin^2)^{1/2})

    **Arguments:** `n` <= 1: the characteristic; `m`, `m1`: as `K`. Pi is infinite at n = 1 and at
    m = 1.

    **Raises** ValueError as `K`, and for n > 1, where the integrand has a pole: the principal value
    is not computed.

    **Example:**

    >>> round(float(gx.theory.elliptic.Pi(0.0, 0.5)), 6)  # K(1/2)
    1.854075
    """
    remedy = "Beyond 1 the integrand has a pole, and no principal value is taken."
    n = require("n", parameter("n", n), lambda n: n <= 1, "numbers not above 1", remedy)
    (n,), m1 = _arguments(m, m1, n=n)
    return _complete_Pi(n, m1)


def F(phi: Parameter, m: Parameter | None = None, *, m1: Parameter | None = None) -> Numbers:
    """Return the incomplete integral of the first kind F(phi, m), the inverse of phi = am u.

    **Arguments:** `phi`: real amplitude [rad], F(phi + pi) = F(phi) + 2K; `m`, `m1`: as `K`. If
    sin phi = z is known, pass phi = arcsin z. F is infinite at m = 1 for |phi| >= pi/2.

    **Raises** ValueError as `K`.

    **Example:**

    >>> round(float(gx.theory.elliptic.F(np.pi / 2, 0.5)), 6)  # K(1/2)
    1.854075
    """
    (phi,), m1 = _arguments(m, m1, phi=phi)
    return _F(phi, m1)


# ----------------------------------------------------------------------------------------------------------- arguments


def _arguments(m, m1, **others):
    if (m is None) == (m1 is None):
        refuse("m, m1", "one of the two", "both" if m1 is not None else "none", "m1 is 1 - m.")
    name, given = ("m", m) if m1 is None else ("m1", m1)
    given = within(
        name, given, 0, 1, remedy="The parameter is m = k^2; real solutions have it in [0, 1]."
    )
    return [parameter(key, x) for key, x in others.items()], 1 - given if m1 is None else given


# u, refused where its own rounding is a large part of a period
def _resolved(u, m1):
    value = concrete(u)
    other = concrete(m1)
    most = 0.1 / float(jnp.finfo(u.dtype).eps)
    if value is not None and other is not None and np.any((np.abs(value) > most) & (other > 0)):
        refuse(
            "u",
            f"numbers below {most:.3g} in size, but at m = 1",
            show(value),
            "For larger u its rounding exceeds a period. Take it modulo 4 K(m).",
        )
    return u
