r"""Jacobi's elliptic functions and Legendre's integrals, for a parameter m = k^2 in [0, 1].

    u = F(phi, m) = int_0^phi (1 - m sin^2)^{-1/2},   sn u = sin phi,   cn u = cos phi,   dn^2 u = 1 - m sn^2 u

Every function takes m, or in its place the complement `m1` = 1 - m: near m = 1, where solitons are, 1 - m written as a
floating number has lost its digits, and K(m) = ln(4/m1^{1/2}) + ... reads them. Elementwise in arrays that broadcast,
differentiable to any order and in both modes in every argument. Values are right to 1e-13, absolute or relative,
whichever is more; jacobi of a large |u| to |u| times the rounding of a number, which the reduction by its period costs.
An m1 below 1e-307, where numbers end, is zero.

Complete integrals by the arithmetic-geometric mean and by Carlson's duplication, incomplete ones by the latter; sn, cn
and dn by Landen's transformations.

Source: B. C. Carlson, Numer. Algorithms 10, 13 (1995); R. Bulirsch, Numer. Math. 7, 78 (1965); NIST Digital Library of
Mathematical Functions, chapters 19, 20, 22; for the derivatives in m section 19.4.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..checks import concrete, parameter, refuse, show, within
from ..printing import told
from ..types import Numbers, Parameter
from .elliptic_functions import _jacobi, _zeta
from .elliptic_integrals import _E, _F, _K, _complete, _complete_Pi

__all__ = ["E", "F", "Jacobi", "K", "Pi", "jacobi", "zeta"]


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
    """sn(u, m), cn(u, m), dn(u, m). At m = 0 sin u, cos u, 1; at m = 1 tanh u, sech u, sech u.

    **Arguments:** `u`: any real number; `m` in [0, 1], or `m1` = 1 - m. **Returns:** `Jacobi(sn, cn, dn)`.
    **Raises** ValueError for m outside [0, 1], values not finite, shapes that do not broadcast.

    **Example:**

    >>> sn, cn, dn = gx.theory.elliptic.jacobi(1.0, 1.0)
    >>> round(float(sn), 6), round(float(cn), 6)  # tanh 1, sech 1
    (0.761594, 0.648054)
    """
    (u,), m1 = _arguments(m, m1, u=u)
    return Jacobi(*_jacobi(_resolved(u, m1), m1))


def zeta(u: Parameter, m: Parameter | None = None, *, m1: Parameter | None = None) -> Numbers:
    """Jacobi's zeta function Z(u, m) = int_0^u dn^2 - u E/K, of period 2K. At m = 1 tanh u.

    **Arguments**, **Raises**: as `jacobi`.

    **Example:**

    >>> round(float(gx.theory.elliptic.zeta(1.0, 1.0)), 6)  # tanh 1
    0.761594
    """
    (u,), m1 = _arguments(m, m1, u=u)
    return _zeta(_resolved(u, m1), m1)


def K(m: Parameter | None = None, *, m1: Parameter | None = None) -> Numbers:
    """Complete integral of the first kind K(m) = F(pi/2, m): pi/2 at m = 0, infinite at m = 1.

    **Arguments:** `m` in [0, 1], or `m1` = 1 - m. **Raises** ValueError for others.

    **Example:**

    >>> round(float(gx.theory.elliptic.K(0.0)), 6), round(float(gx.theory.elliptic.K(0.5)), 6)
    (1.570796, 1.854075)
    """
    return _complete(_K, _arguments(m, m1)[1])


def E(m: Parameter | None = None, *, m1: Parameter | None = None) -> Numbers:
    """Complete integral of the second kind E(m) = int_0^{pi/2} (1 - m sin^2)^{1/2}: pi/2 at m = 0, 1 at m = 1.

    Its derivative is infinite at m = 1. **Arguments**, **Raises**: as `K`.

    **Example:**

    >>> round(float(gx.theory.elliptic.E(0.0)), 6), round(float(gx.theory.elliptic.E(1.0)), 6)  # pi/2, 1
    (1.570796, 1.0)
    """
    return _complete(_E, _arguments(m, m1)[1])


def Pi(n: Parameter, m: Parameter | None = None, *, m1: Parameter | None = None) -> Numbers:
    """Complete integral of the third kind Pi(n, m) = int_0^{pi/2} 1/((1 - n sin^2)(1 - m sin^2)^{1/2}).

    **Arguments:** `n` <= 1, the characteristic, of either sign; infinite at n = 1 and at m = 1. `m`, `m1`: as `K`.
    **Raises** ValueError for n > 1, where the integrand has a pole: no principal value is taken; and as `K`.

    **Example:**

    >>> round(float(gx.theory.elliptic.Pi(0.0, 0.5)), 6)  # K(1/2)
    1.854075
    """
    (n,), m1 = _arguments(m, m1, n=_characteristic(n))
    return _complete_Pi(n, m1)


def F(phi: Parameter, m: Parameter | None = None, *, m1: Parameter | None = None) -> Numbers:
    """Incomplete integral of the first kind, of the amplitude phi [rad]: F(phi, m), the inverse of phi = am u.

    **Arguments:** `phi`: any real number; F(phi + pi) = F(phi) + 2K. Where sin phi = z is known, phi = arcsin z. `m`,
    `m1`: as `K`. At m = 1 infinite for |phi| >= pi/2. **Raises** ValueError as `K`.

    **Example:**

    >>> round(float(gx.theory.elliptic.F(np.pi / 2, 0.5)), 6)  # K(1/2)
    1.854075
    """
    (phi,), m1 = _arguments(m, m1, phi=phi)
    return _F(phi, m1)


# ----------------------------------------------------------------------------------------------------------- arguments


def _arguments(m, m1, **others):
    """The other arguments as arrays, and m1."""
    if (m is None) == (m1 is None):
        refuse("m, m1", "one of the two", "both" if m1 is not None else "none", "m1 is 1 - m.")
    name, given = ("m", m) if m1 is None else ("m1", m1)
    given = within(
        name, given, 0, 1, remedy="The parameter is m = k^2; real solutions have it in [0, 1]."
    )
    return [parameter(key, x) for key, x in others.items()], 1 - given if m1 is None else given


def _resolved(u, m1):
    """u, whose rounding is a small part of a period."""
    value, other = concrete(u), concrete(m1)
    most = 0.1 / float(jnp.finfo(u.dtype).eps)
    if value is not None and other is not None and np.any((np.abs(value) > most) & (other > 0)):
        refuse(
            "u",
            f"numbers below {most:.3g} in size, but at m = 1",
            show(value),
            "Beyond, the rounding of u itself passes through periods. Take it modulo 4 K(m).",
        )
    return u


def _characteristic(n):
    n = parameter("n", n)
    value = concrete(n)
    if value is not None and not np.all(value <= 1):
        refuse(
            "n",
            "numbers not above 1",
            show(value),
            "Beyond 1 the integrand has a pole; no principal value.",
        )
    return n
