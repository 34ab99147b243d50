r"""Jacobi's elliptic functions and Legendre's integrals, for a parameter m = k^2 in [0, 1].

    u = F(phi, m) = int_0^phi (1 - m sin^2)^{-1/2},   sn u = sin phi,   cn u = cos phi,   dn^2 u = 1 - m sn^2 u

Every function takes m, or in its place the complement `m1` = 1 - m: near m = 1, where solitons are, 1 - m written as a
floating number has lost its digits, and K(m) = ln(4/m1^{1/2}) + ... reads them. Elementwise in arrays that broadcast,
differentiable to any order and in both modes in every argument. Values are right to 1e-13, absolute or relative,
whichever is more; jacobi of a large |u| to |u| times the rounding of a number, which the reduction by its period costs.

Complete integrals by the arithmetic-geometric mean and by Carlson's duplication, incomplete ones by the latter; sn, cn
and dn by theta series in the nome or in its complement, whichever is below exp(-pi).

Source: B. C. Carlson, Numer. Algorithms 10, 13 (1995); NIST Digital Library of Mathematical Functions, chapters 19, 20,
22; for the derivatives in m section 19.4.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_derivatives import SymbolicZero

from ..checks import broadcast, concrete, parameter, refuse, show, within
from ..entry import checked
from ..printing import told
from ..types import Numbers, Parameter

__all__ = ["E", "F", "Jacobi", "K", "Pi", "incomplete_E", "incomplete_Pi", "jacobi", "zeta"]

# duplications until the arguments of an integral agree to 1e-3, were they 1e300 apart; means until two numbers are one
DUPLICATIONS, MEANS = 18, 14
# terms of a theta series in a nome below exp(-pi)
TERMS = 5
# dn^2 below which its square is no number
FLAT = 1e-150
# z for which atan(z)/z is summed, and the terms of the sum
SMALL, SERIES = 0.02, 10


class Jacobi(NamedTuple):
    """Jacobi's functions sn, cn, dn."""

    sn: jax.Array
    cn: jax.Array
    dn: jax.Array
    __repr__ = told


@checked
def jacobi(u: Parameter, m: Parameter | None = None, *, m1: Parameter | None = None) -> Jacobi:
    """sn(u, m), cn(u, m), dn(u, m). At m = 0 sin u, cos u, 1; at m = 1 tanh u, sech u, sech u.

    **Arguments:** `u`: any real number; `m` in [0, 1], or `m1` = 1 - m. **Returns:** `Jacobi(sn, cn, dn)`.
    **Raises** ValueError for m outside [0, 1], values not finite, shapes that do not broadcast.
    """
    (u,), m1 = _arguments(m, m1, u=u)
    return Jacobi(*_jacobi(u, m1))


@checked
def zeta(u: Parameter, m: Parameter | None = None, *, m1: Parameter | None = None) -> Numbers:
    """Jacobi's zeta function Z(u, m) = int_0^u dn^2 - u E/K, of period 2K. At m = 1 tanh u.

    **Arguments**, **Raises**: as `jacobi`.
    """
    (u,), m1 = _arguments(m, m1, u=u)
    return _zeta(u, m1)


@checked
def K(m: Parameter | None = None, *, m1: Parameter | None = None) -> Numbers:
    """Complete integral of the first kind K(m) = F(pi/2, m): pi/2 at m = 0, infinite at m = 1.

    **Arguments:** `m` in [0, 1], or `m1` = 1 - m. **Raises** ValueError for others.
    """
    return _complete(_K, _arguments(m, m1)[1])


@checked
def E(m: Parameter | None = None, *, m1: Parameter | None = None) -> Numbers:
    """Complete integral of the second kind E(m) = int_0^{pi/2} (1 - m sin^2)^{1/2}: pi/2 at m = 0, 1 at m = 1.

    Its derivative is infinite at m = 1. **Arguments**, **Raises**: as `K`.
    """
    return _complete(_E, _arguments(m, m1)[1])


@checked
def Pi(n: Parameter, m: Parameter | None = None, *, m1: Parameter | None = None) -> Numbers:
    """Complete integral of the third kind Pi(n, m) = int_0^{pi/2} 1/((1 - n sin^2)(1 - m sin^2)^{1/2}).

    **Arguments:** `n` <= 1, the characteristic, of either sign; infinite at n = 1 and at m = 1. `m`, `m1`: as `K`.
    **Raises** ValueError for n > 1, where the integrand has a pole: no principal value is taken; and as `K`.
    """
    (n,), m1 = _arguments(m, m1, n=_characteristic(n))
    return _complete_Pi(n, m1)


@checked
def F(phi: Parameter, m: Parameter | None = None, *, m1: Parameter | None = None) -> Numbers:
    """Incomplete integral of the first kind, of the amplitude phi [rad]: F(phi, m), the inverse of phi = am u.

    **Arguments:** `phi`: any real number; F(phi + pi) = F(phi) + 2K. Where sin phi = z is known, phi = arcsin z. `m`,
    `m1`: as `K`. At m = 1 infinite for |phi| >= pi/2. **Raises** ValueError as `K`.
    """
    (phi,), m1 = _arguments(m, m1, phi=phi)
    return _F(phi, m1)


@checked
def incomplete_E(phi: Parameter, m: Parameter | None = None, *, m1: Parameter | None = None) -> Numbers:
    """Incomplete integral of the second kind E(phi, m) = int_0^phi (1 - m sin^2)^{1/2}. As `F`, but always finite."""
    (phi,), m1 = _arguments(m, m1, phi=phi)
    return _incomplete_E(phi, m1)


@checked
def incomplete_Pi(
    n: Parameter, phi: Parameter, m: Parameter | None = None, *, m1: Parameter | None = None
) -> Numbers:
    """Incomplete integral of the third kind Pi(n; phi, m) = int_0^phi 1/((1 - n sin^2)(1 - m sin^2)^{1/2}).

    **Arguments:** as `F` and `Pi`; infinite for |phi| >= pi/2 at n = 1 and at m = 1. **Raises** ValueError as `Pi`.
    """
    (n, phi), m1 = _arguments(m, m1, n=_characteristic(n), phi=phi)
    return _incomplete_Pi(n, phi, m1)


# ----------------------------------------------------------------------------------------------------------- arguments


def _arguments(m, m1, **others):
    """The other arguments as arrays, and m1."""
    if (m is None) == (m1 is None):
        refuse("m, m1", "one of the two", "both" if m1 is not None else "none", "m1 is 1 - m.")
    name, given = ("m", m) if m1 is None else ("m1", m1)
    given = within(name, given, 0, 1, remedy="The parameter is m = k^2; real solutions have it in [0, 1].")
    others = {key: parameter(key, x) for key, x in others.items()}
    broadcast(**others, **{name: given})
    arrays = jnp.broadcast_arrays(*others.values(), given)
    return arrays[:-1], 1 - arrays[-1] if m1 is None else arrays[-1]


def _characteristic(n):
    n = parameter("n", n)
    value = concrete(n)
    if value is not None and not np.all(value <= 1):
        refuse("n", "numbers not above 1", show(value), "Beyond 1 the integrand has a pole; no principal value.")
    return n


# ------------------------------------------------------------------------------------- Carlson's integrals, of squares


def _duplicated(a, b, c, step, start):
    """The arguments a^2, b^2, c^2 after the duplications, and what `step` has gathered.

    Roots are what is given: an argument that passes zero, such as cos^2 phi, then has a derivative there.
    """
    def once(i, carry):
        (x, y, z), (a, b, c), gathered = carry
        shift = a * b + b * c + c * a
        gathered = step(gathered, (a, b, c), z, shift)
        x, y, z = ((value + shift) / 4 for value in (x, y, z))
        return (x, y, z), (jnp.sqrt(x), jnp.sqrt(y), jnp.sqrt(z)), gathered

    carry = once(0, ((a * a, b * b, c * c), (a, b, c), start))
    return jax.lax.fori_loop(1, DUPLICATIONS, once, carry)


def _RF(a, b, c):
    """R_F(a^2, b^2, c^2); at most one of a, b, c >= 0 may vanish."""
    a, b, c = jnp.broadcast_arrays(a, b, c)
    (x, y, z), _, _ = _duplicated(a, b, c, lambda gathered, *_: gathered, ())
    mean = (x + y + z) / 3
    X, Y = 1 - x / mean, 1 - y / mean
    Z = -X - Y
    E2, E3 = X * Y - Z * Z, X * Y * Z
    high = 3 * E3**2 / 104 - 5 * E2**3 / 208
    return (1 - E2 / 10 + E3 / 14 + E2 * E2 / 24 - 3 * E2 * E3 / 44 + high) / jnp.sqrt(mean)


def _RD(a, b, c):
    """R_D(a^2, b^2, c^2), symmetric in a and b; c > 0 and one of a, b > 0."""
    a, b, c = jnp.broadcast_arrays(a, b, c)

    def step(gathered, roots, z, shift):
        total, factor = gathered
        return total + factor / (roots[2] * (z + shift)), factor / 4

    (x, y, z), _, (total, factor) = _duplicated(a, b, c, step, (jnp.zeros_like(a), jnp.ones_like(a)))
    mean = (x + y + 3 * z) / 5
    X, Y = 1 - x / mean, 1 - y / mean
    return factor * _fifth(X, Y, -(X + Y) / 3) / (mean * jnp.sqrt(mean)) + 3 * total


def _RJ(a, b, c, d):
    """R_J(a^2, b^2, c^2, d^2); d > 0 and at most one of the others may vanish."""
    a, b, c, d = jnp.broadcast_arrays(a, b, c, d)
    difference = (d * d - a * a) * (d * d - b * b) * (d * d - c * c)

    def step(gathered, roots, z, shift):
        total, factor, w, d = gathered
        D = (d + roots[0]) * (d + roots[1]) * (d + roots[2])
        total = total + factor / D * _arc(factor**3 * difference / (D * D))
        w = (w + shift) / 4
        return total, factor / 4, w, jnp.sqrt(w)

    start = jnp.zeros_like(a), jnp.ones_like(a), d * d, d
    (x, y, z), _, (total, factor, w, _) = _duplicated(a, b, c, step, start)
    mean = (x + y + z + 2 * w) / 5
    X, Y, Z = (1 - value / mean for value in (x, y, z))
    W = -(X + Y + Z) / 2
    E2 = X * Y + X * Z + Y * Z - 3 * W * W
    E3 = X * Y * Z + 2 * E2 * W + 4 * W**3
    E4 = (2 * X * Y * Z + E2 * W + 3 * W**3) * W
    return factor * _series(E2, E3, E4, X * Y * Z * W * W) / (mean * jnp.sqrt(mean)) + 6 * total


def _fifth(X, Y, Z):
    XY, ZZ = X * Y, Z * Z
    return _series(XY - 6 * ZZ, (3 * XY - 8 * ZZ) * Z, 3 * (XY - ZZ) * ZZ, XY * ZZ * Z)


def _series(E2, E3, E4, E5):
    high = 45 * E2 * E2 * E3 / 272 - 9 * (E3 * E4 + E2 * E5) / 68 - E2**3 / 16 + 3 * E3**2 / 40 + 3 * E2 * E4 / 20
    return 1 - 3 * E2 / 14 + E3 / 6 + 9 * E2 * E2 / 88 - 3 * E4 / 22 - 9 * E2 * E3 / 52 + 3 * E5 / 26 + high


def _arc(e):
    """R_C(1, 1 + e) = atan(e^{1/2})/e^{1/2}, e > -1."""
    near = jnp.abs(e) < SMALL
    sum_ = sum((-e) ** k / (2 * k + 1) for k in range(SERIES))
    up, down = jnp.where(near | (e < 0), 1.0, e), jnp.where(near | (e > 0), -0.5, e)
    up, down = jnp.sqrt(up), jnp.sqrt(-down)
    return jnp.where(near, sum_, jnp.where(e > 0, jnp.arctan(up) / up, jnp.arctanh(down) / down))


# ------------------------------------------------------------------------------------------------------------ integrals


def _sloped(function, slope):
    """Give a function of m1 a slope, which may be infinite where m1 = 0."""
    @partial(function.defjvp, symbolic_zeros=True)
    def _(primals, tangents):
        value, (change,) = function(*primals), tangents
        return value, jnp.zeros_like(value) if isinstance(change, SymbolicZero) else slope(*primals) * change


def _positive(m1):
    """m1, with something else in place of zero, and its root."""
    m1 = jnp.where(m1 > 0, m1, 1.0)
    return m1, jnp.sqrt(m1)


@jax.custom_jvp
def _K(m1):
    a, b = jax.lax.fori_loop(0, MEANS, lambda i, ab: ((ab[0] + ab[1]) / 2, jnp.sqrt(ab[0] * ab[1])),
                             (jnp.ones_like(m1), _positive(m1)[1]))
    return jnp.where(m1 > 0, jnp.pi / (a + b), jnp.inf)


_sloped(_K, lambda m1: jnp.where(m1 > 0, -_RD(0.0, 1.0, _positive(m1)[1]) / 6, -jnp.inf))


@jax.custom_jvp
def _E(m1):
    safe, root = _positive(m1)
    return jnp.where(m1 > 0, safe * (_RD(0.0, root, 1.0) + _RD(0.0, 1.0, root)) / 3, 1.0)


_sloped(_E, lambda m1: jnp.where(m1 > 0, _RD(0.0, _positive(m1)[1], 1.0) / 6, jnp.inf))


@partial(jax.jit, static_argnums=0)
def _complete(integral, m1):
    return integral(m1)


def _reduced(phi, m1, complete):
    """phi less a multiple j of pi, its sine and cosine, dn, and 2 j times a complete integral, none where j = 0."""
    j = jnp.round(phi / jnp.pi)
    r = phi - j * jnp.pi
    s, c = jnp.sin(r), jnp.abs(jnp.cos(r))
    whole = jnp.where(j == 0, 0.0, 2 * j * complete(jnp.where(j == 0, 1.0, m1)))
    return s, c, jnp.sqrt(c * c + m1 * s * s), whole


@jax.jit
def _F(phi, m1):
    s, c, d, whole = _reduced(phi, m1, _K)
    return s * _RF(c, d, 1.0) + whole


@jax.jit
def _incomplete_E(phi, m1):
    s, c, d, whole = _reduced(phi, m1, _E)
    return _second(s * _RF(c, d, 1.0), s, c, d, m1) + whole


def _second(u, s, c, d, m1):
    """E(am u, m) of |u| <= K, from sn, cn and dn of it: a sum of positive terms."""
    m = 1 - m1
    return m1 * (u + m / 3 * s**3 * _RD(c, 1.0, d)) + m * s * c / d


@jax.jit
def _complete_Pi(n, m1):
    inside = (m1 > 0) & (n < 1)
    n, m1 = jnp.where(inside, n, 0.0), jnp.where(inside, m1, 1.0)
    return jnp.where(inside, _third(n, 1.0, 0.0, jnp.sqrt(m1), m1), jnp.inf)


@jax.jit
def _incomplete_Pi(n, phi, m1):
    s, c, d, whole = _reduced(phi, m1, partial(_complete_Pi, n))
    return _third(n, s, c, d, m1) + whole


def _third(n, s, c, d, m1):
    """Pi(n; phi, m) within a quarter of a period; of n < 0 by that of (m - n)/(1 - n), a sum of positive terms."""
    m, below = 1 - m1, n < 0
    v = jnp.where(below, n, -1.0)
    first = s * _RF(c, d, 1.0)
    p = jnp.sqrt(c * c + jnp.where(below, m1 / (1 - v), 1 - n) * s * s)
    other = first + jnp.where(below, (m - v) / (1 - v), n) / 3 * s**3 * _RJ(c, d, 1.0, p)
    angle = jnp.arctan(jnp.sqrt(-v * (m - v) / (1 - v)) * s * c / d)
    turned = (-v * m1 / (1 - v) * other + m * first) / (m - v) + jnp.sqrt(-v / ((m - v) * (1 - v))) * angle
    return jnp.where(below, turned, other)


# ----------------------------------------------------------------------------------------------------- sn, cn, dn, zeta


def _period_left(u, m1):
    """u = r + 2 j K with |r| <= K, and j."""
    j = jax.lax.stop_gradient(jnp.where(m1 > 0, jnp.round(u / (2 * _K(_positive(m1)[0]))), 0.0))
    return jnp.where(j == 0, u, u - 2 * j * _K(jnp.where(j == 0, 1.0, m1))), j


@jax.jit
def _jacobi(u, m1):
    r, j = _period_left(u, m1)
    s, c, d = _in_period(r, m1)
    sign = 1 - 2 * jnp.mod(j, 2)
    return sign * s, sign * c, d


@jax.jit
def _zeta(u, m1):
    r, _ = _period_left(u, m1)
    s, c, d = _in_period(r, m1)
    flat = d < FLAT
    s, c, d = jnp.where(flat, 0.0, s), jnp.where(flat, 1.0, c), jnp.where(flat, 1.0, d)
    second = jnp.where(flat, jnp.sign(r), _second(r, s, c, d, m1))
    share = jnp.where(m1 > 0, _E(_positive(m1)[0]) / _K(_positive(m1)[0]), 0.0)
    return second - r * share


def _log_theta(u, m1):
    """ln Theta(u)/Theta(0), whose derivative in u is zeta; at m = 1 ln cosh u."""
    r, _ = _period_left(u, m1)
    K, other = _K(jnp.where(m1 > 0, m1, 1.0)), _K(1 - m1)
    r, round_ = jnp.abs(r), m1 > 0.5
    q, z = jnp.exp(-jnp.pi * jnp.where(round_, other / K, 1.0)), jnp.pi * r / jnp.where(round_, K, 1.0)
    by_cosines = jnp.log1p(
        sum(2 * (-1) ** n * q ** (n * n) * (jnp.cos(n * z) - 1) for n in range(1, TERMS))
        / (1 + sum(2 * (-1) ** n * q ** (n * n) for n in range(1, TERMS))))
    other = jnp.where(round_, 1.0, other)
    x, log_q = jnp.pi * r / (2 * other), jnp.where(m1 > 0, -jnp.pi * K / other, -jnp.inf)
    log_q = jnp.where(round_, -1.0, log_q)
    series = (1 + jnp.exp(-2 * x)) / 2 + sum(
        jnp.exp((n * n + n) * log_q + 2 * n * x) * (1 + jnp.exp(-(4 * n + 2) * x)) / 2 for n in range(1, TERMS))
    at_0 = 1 + sum(jnp.exp((n * n + n) * log_q) for n in range(1, TERMS))
    square = jnp.where(m1 > 0, jnp.pi * r * r / (4 * K * other), 0.0)
    return jnp.where(round_, by_cosines, x - square + jnp.log(series / at_0))


@jax.custom_jvp
def _in_period(r, m1):
    """sn, cn, dn of |r| <= K: of |r| or K - |r|, whichever is less, by the series in the smaller nome."""
    K, other = _K(m1), _K(1 - m1)
    w = jnp.abs(r)
    far = w > K / 2
    w = jnp.where(far, K - w, w)
    round_ = m1 > 0.5
    s, c, d = (jnp.where(round_, x, y) for x, y in zip(
        _by_sines(w, jnp.where(round_, K, 1.0), jnp.where(round_, other, 1.0)),
        _by_exponentials(w, jnp.where(round_, 1.0, K), jnp.where(round_, 1.0, other))))
    root, safe = jnp.sqrt(m1), jnp.where(far, d, 1.0)
    s, c, d = jnp.where(far, c / safe, s), jnp.where(far, root * s / safe, c), jnp.where(far, root / safe, d)
    return jnp.sign(r) * s, c, d


def _by_sines(w, K, other):
    """Theta series in the nome exp(-pi K'/K)."""
    q, z = jnp.exp(-jnp.pi * other / K), jnp.pi * w / (2 * K)
    odd = [((-1) ** n, q ** (n * n + n), 2 * n + 1) for n in range(TERMS)]
    even = [((-1) ** n, 2 * q ** (n * n), 2 * n) for n in range(1, TERMS)]
    one, two = sum(s * a * jnp.sin(k * z) for s, a, k in odd), sum(a * jnp.cos(k * z) for _, a, k in odd)
    three, four = 1 + sum(a * jnp.cos(k * z) for _, a, k in even), 1 + sum(s * a * jnp.cos(k * z) for s, a, k in even)
    two_0, three_0 = sum(a for _, a, _ in odd), 1 + sum(a for _, a, _ in even)
    four_0 = 1 + sum(s * a for s, a, _ in even)
    return three_0 * one / (two_0 * four), four_0 * two / (two_0 * four), four_0 * three / (three_0 * four)


def _by_exponentials(w, K, other):
    """Theta series in the complementary nome exp(-pi K/K') of imaginary arguments, times exp(-x)."""
    x, log_q = jnp.pi * w / (2 * other), -jnp.pi * K / other
    term = lambda power, k, sign: jnp.exp(power * log_q + (k - 1) * x) * (1 + sign * jnp.exp(-2 * k * x)) / 2
    odd = [(n * n + n, 2 * n + 1) for n in range(TERMS)]
    even = [(n * n, 2 * n) for n in range(1, TERMS)]
    one = -jnp.expm1(-2 * x) / 2 - sum(
        (-1) ** n * jnp.exp((n * n + n) * log_q + 2 * n * x) * jnp.expm1(-(4 * n + 2) * x) / 2 for n in range(1, TERMS))
    two = (1 + jnp.exp(-2 * x)) / 2 + sum(term(*pair, 1) for pair in odd[1:])
    three = jnp.exp(-x) + 2 * sum(term(*pair, 1) for pair in even)
    four = jnp.exp(-x) + 2 * sum((-1) ** n * term(*pair, 1) for n, pair in enumerate(even, 1))
    q = jnp.exp(log_q)
    two_0 = sum(q ** (n * n + n) for n in range(TERMS))
    three_0 = 1 + 2 * sum(q ** (n * n) for n in range(1, TERMS))
    four_0 = 1 + 2 * sum((-1) ** n * q ** (n * n) for n in range(1, TERMS))
    return three_0 * one / (four_0 * two), two_0 * four / (four_0 * two), two_0 * three / (three_0 * two)


@partial(_in_period.defjvp, symbolic_zeros=True)
def _(primals, tangents):
    (r, m1), (dr, dm1) = primals, tangents
    s, c, d = _in_period(r, m1)
    change = [jnp.zeros_like(s)] * 3
    if not isinstance(dr, SymbolicZero):
        change = [x + y * dr for x, y in zip(change, (c * d, -s * d, -(1 - m1) * s * c))]
    if not isinstance(dm1, SymbolicZero):
        change = [x - y * dm1 for x, y in zip(change, _slopes_in_m(s, c, d, m1))]
    return (s, c, d), tuple(change)


def _slopes_in_m(s, c, d, m1):
    """Derivatives in m, from that of the amplitude, -dn int_0^u (sn/dn)^2/2."""
    flat = d < FLAT
    safe = jnp.where(flat, 1.0, d)
    turn = jnp.where(flat, -jnp.sign(s) / (4 * d), -safe * s**3 * _RD(jnp.where(flat, 1.0, c), 1.0, safe) / 6)
    # finite, so that a tangent that is zero stays so
    turn = jnp.clip(turn, -jnp.finfo(turn.dtype).max, jnp.finfo(turn.dtype).max)
    first = jnp.where(flat, -jnp.sign(s) / 4, c * jnp.where(flat, 0.0, turn))
    return first, -s * turn, jnp.where(flat, s * turn, (-s * s / 2 - (1 - m1) * s * first) / safe)
