"""Carlson's symmetric integrals by duplication, and Legendre's by them, in m1 = 1 - m; `elliptic` is their face."""

from functools import partial

import jax
import jax.numpy as jnp
from jax.custom_derivatives import SymbolicZero

# duplications until the arguments of an integral agree to 1e-3, were they 1e300 apart; means until two numbers are one
DUPLICATIONS, MEANS = 18, 14
# where the series of atan ends, counted down from zero, and its terms
SMALL, SERIES = 0.1, 12


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

    (x, y, z), _, (total, factor) = _duplicated(
        a, b, c, step, (jnp.zeros_like(a), jnp.ones_like(a))
    )
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
    high = (
        45 * E2 * E2 * E3 / 272
        - 9 * (E3 * E4 + E2 * E5) / 68
        - E2**3 / 16
        + 3 * E3**2 / 40
        + 3 * E2 * E4 / 20
    )
    return (
        1
        - 3 * E2 / 14
        + E3 / 6
        + 9 * E2 * E2 / 88
        - 3 * E4 / 22
        - 9 * E2 * E3 / 52
        + 3 * E5 / 26
        + high
    )


def _arc(e):
    """R_C(1, 1 + e) = atan(e^{1/2})/e^{1/2}, -1 < e <= 1.

    Without XLA's atan, which jaxlib 0.10.2 gets wrong in arrays of 50 and more (jax issue 39352), nor its artanh, which
    is right to 3e-14.
    """
    near, factor = e > -SMALL, 1.0
    up, down = jnp.where(near, e, 0.0), jnp.where(near, -0.5, e)
    for _ in range(2):
        root = 1 + jnp.sqrt(1 + up)
        factor, up = 2 * factor / root, up / (root * root)
    sum_ = factor * sum((-up) ** k / (2 * k + 1) for k in range(SERIES))
    return jnp.where(near, sum_, jnp.arcsinh(jnp.sqrt(-down / (1 + down))) / jnp.sqrt(-down))


def _arctan(x):
    half = x / (1 + jnp.sqrt(1 + x * x))
    return 2 * half * _arc(half * half)


# ------------------------------------------------------------------------------------------------------------ integrals


def _sloped(function, slope):
    """Give a function of m1 a slope, which may be infinite where m1 = 0."""

    @partial(function.defjvp, symbolic_zeros=True)
    def _(primals, tangents):
        value, (change,) = function(*primals), tangents
        return value, jnp.zeros_like(value) if isinstance(change, SymbolicZero) else slope(
            *primals
        ) * change


def _positive(m1):
    """m1, with something else in place of zero, and its root."""
    m1 = jnp.where(m1 != 0, m1, 1.0)
    return m1, jnp.sqrt(m1)


@jax.custom_jvp
def _K(m1):
    a, b = jax.lax.fori_loop(
        0,
        MEANS,
        lambda i, ab: ((ab[0] + ab[1]) / 2, jnp.sqrt(ab[0] * ab[1])),
        (jnp.ones_like(m1), _positive(m1)[1]),
    )
    return jnp.where(m1 != 0, jnp.pi / (a + b), jnp.inf)


_sloped(_K, lambda m1: jnp.where(m1 != 0, -_RD(0.0, 1.0, _positive(m1)[1]) / 6, -jnp.inf))


@jax.custom_jvp
def _E(m1):
    safe, root = _positive(m1)
    return jnp.where(m1 != 0, safe * (_RD(0.0, root, 1.0) + _RD(0.0, 1.0, root)) / 3, 1.0)


_sloped(_E, lambda m1: jnp.where(m1 != 0, _RD(0.0, _positive(m1)[1], 1.0) / 6, jnp.inf))


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
    inside = (m1 != 0) & (n != 1)
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
    angle = _arctan(jnp.sqrt(-v * (m - v) / (1 - v)) * s * c / d)
    turned = (-v * m1 / (1 - v) * other + m * first) / (m - v) + jnp.sqrt(
        -v / ((m - v) * (1 - v))
    ) * angle
    return jnp.where(below, turned, other)
