"""Elliptic integrals, sn, cn, dn, zeta and ln Theta, as functions of m1 = 1 - m; see `elliptic`."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_derivatives import SymbolicZero

from .chain_wave import _sech

# Duplications after which the arguments of an integral agree to 2e-6, even from 1e300 apart: of
# Carlson's series in their differences the second order is enough.
DUPLICATIONS = 18
# Steps after which the arithmetic-geometric mean has converged.
MEANS = 14


# ------------------------------------------------------------------------------------- Carlson's integrals, of squares


# The roots a, b, c of Carlson's arguments are given, so that an argument that passes zero, such as
# cos^2 phi, has a derivative there. `step` accumulates terms of the duplications.
def _duplicated(a, b, c, step, start):
    def once(i, carry):
        (x, y, z), (a, b, c), gathered = carry
        shift = a * b + b * c + c * a
        gathered = step(gathered, (a, b, c), z, shift)
        x, y, z = ((value + shift) / 4 for value in (x, y, z))
        return (x, y, z), (jnp.sqrt(x), jnp.sqrt(y), jnp.sqrt(z)), gathered

    carry = once(0, ((a * a, b * b, c * c), (a, b, c), start))
    return jax.lax.fori_loop(1, DUPLICATIONS, once, carry)


# R_F(a^2, b^2, 1); at most one of a, b >= 0 may be zero
def _RF(a, b):
    a, b, c = jnp.broadcast_arrays(a, b, 1.0)
    (x, y, z), _, _ = _duplicated(a, b, c, lambda gathered, *_: gathered, ())
    mean = (x + y + z) / 3
    X = 1 - x / mean
    Y = 1 - y / mean
    E2 = X * Y - (X + Y) ** 2
    return (1 - E2 / 10) / jnp.sqrt(mean)


# R_D(a^2, b^2, c^2), symmetric in a and b; c > 0 and one of a, b > 0
def _RD(a, b, c):
    a, b, c = jnp.broadcast_arrays(a, b, c)

    def step(gathered, roots, z, shift):
        total, factor = gathered
        return total + factor / (roots[2] * (z + shift)), factor / 4

    (x, y, z), _, (total, factor) = _duplicated(
        a, b, c, step, (jnp.zeros_like(a), jnp.ones_like(a))
    )
    mean = (x + y + 3 * z) / 5
    X = 1 - x / mean
    Y = 1 - y / mean
    E2 = X * Y - 2 / 3 * (X + Y) ** 2
    return factor * (1 - 3 * E2 / 14) / (mean * jnp.sqrt(mean)) + 3 * total


# ------------------------------------------------------------------------------------------------------------ integrals


# gives a function of m1 its derivative, which may be infinite at m1 = 0
def _sloped(function, slope):
    @partial(function.defjvp, symbolic_zeros=True)
    def _(primals, tangents):
        value = function(*primals)
        (change,) = tangents
        return value, jnp.zeros_like(value) if isinstance(change, SymbolicZero) else slope(
            *primals
        ) * change


def _positive(m1):
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


# E/K, zero at m1 = 0
def _share(m1):
    safe, _ = _positive(m1)
    return jnp.where(m1 != 0, _E(safe) / _K(safe), 0.0)


@partial(jax.jit, static_argnums=0)
def _complete(integral, m1):
    return integral(m1)


@jax.jit
def _F(phi, m1):
    # the part j pi of phi contributes 2 j K
    j = jnp.round(phi / jnp.pi)
    r = phi - j * jnp.pi
    s = jnp.sin(r)
    c = jnp.abs(jnp.cos(r))
    d = jnp.sqrt(c * c + m1 * s * s)
    whole = jnp.where(j == 0, 0.0, 2 * j * _K(jnp.where(j == 0, 1.0, m1)))
    return s * _RF(c, d) + whole


# E(am u, m) for |u| <= K, from sn, cn and dn of u, as a sum of positive terms
def _second(u, s, c, d, m1):
    m = 1 - m1
    return m1 * (u + m / 3 * s**3 * _RD(c, 1.0, d)) + m * s * c / d


# Bulirsch's means, whose terms are all positive for n < 1
@jax.jit
def _complete_Pi(n, m1):
    inside = (m1 != 0) & (n != 1)
    n = jnp.where(inside, n, 0.0)
    m1 = jnp.where(inside, m1, 1.0)
    p = jnp.sqrt(1 - n)
    one = jnp.ones_like(m1)

    def once(_, x):
        a, b, p, mean, root = x
        share = root * mean / p
        a, b, p = a + b / p, 2 * (b + a * share), p + share
        return a, b, p, mean + root, 2 * jnp.sqrt(root * mean)

    a, b, p, mean, _ = jax.lax.fori_loop(0, MEANS, once, (one, 1 / p, p, one, jnp.sqrt(m1)))
    found = jnp.pi / 2 * (b + a * mean) / (mean * (mean + p))
    return jnp.where(inside, found, jnp.inf)


# ------------------------------------------------------------------------------------------------------------ functions


# r and j of u = r + 2 j K with |r| <= K
def _period_left(u, m1):
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
    flat = _flat(d)
    s = jnp.where(flat, 0.0, s)
    c = jnp.where(flat, 1.0, c)
    d = jnp.where(flat, 1.0, d)
    second = jnp.where(flat, jnp.sign(r), _second(r, s, c, d, m1))
    return second - r * _share(m1)


# ln Theta(u)/Theta(0), the integral of zeta; ln cosh u at m = 1
def _log_theta(u, m1):
    r, _ = _period_left(u, m1)
    safe, root = _positive(m1)
    w, far = _nearer(r, safe)
    *_, d, log = _by_means(w, root)
    # by Theta(K - w)/Theta(w) = dn(w)/m1^{1/4}
    log = log + jnp.where(far, jnp.log(d) - jnp.log(safe) / 4, 0.0)
    return jnp.where(m1 == 0, jnp.logaddexp(r, -r) - np.log(2), log)


# the smaller of |r| and K - |r|, and whether it is the latter
def _nearer(r, m1):
    w = jnp.abs(r)
    K = _K(m1)
    far = w > K / 2
    return jnp.where(far, K - w, w), far


# sn, cn, dn for |r| <= K, from the smaller of |r| and K - |r|; hyperbolic functions at m = 1
@jax.custom_jvp
def _in_period(r, m1):
    w, far = _nearer(r, m1)
    whole = jnp.tanh(w), _sech(w), _sech(w)
    s, c, d = (jnp.where(m1 == 0, x, y) for x, y in zip(whole, _by_means(w, _positive(m1)[1])))
    root = jnp.sqrt(m1)
    safe = jnp.where(far, d, 1.0)
    s, c, d = (
        jnp.where(far, c / safe, s),
        jnp.where(far, root * s / safe, c),
        jnp.where(far, root / safe, d),
    )
    return jnp.sign(r) * s, c, d


# sn, cn, dn and ln Theta(w)/Theta(0) for 0 <= w <= K/2, by Landen's transformations. `root` is that
# of m1. The levels begin where m is zero; t is sn/cn. Theta/Theta(0) is twice its square one level
# below, over 1 + dn.
def _by_means(w, root):
    means = [(jnp.ones_like(root), root, 1 - root)]
    for _ in range(MEANS):
        a, b, apart = means[-1]
        a, b = (a + b) / 2, jnp.sqrt(a * b)
        # a - b without cancellation, because `log` doubles its error at every level
        means.append((a, b, apart**2 / (4 * (a + b))))
    (mean, *_), *levels = reversed(means)
    t = jnp.tan(mean * w) / mean
    d = 1.0
    log = 0.0
    for a, b, apart in levels:
        square = mean * t * t
        whole = 1 + a * square
        t = t / d
        d = (1 + b * square) / whole
        mean = a
        log = 2 * log - jnp.log1p(-apart * square / (2 * whole))
    c = 1 / jnp.sqrt(1 + t * t)
    return t * c, c, d, log


@partial(_in_period.defjvp, symbolic_zeros=True)
def _(primals, tangents):
    r, m1 = primals
    dr, dm1 = tangents
    s, c, d = _in_period(r, m1)
    change = [jnp.zeros_like(s)] * 3
    if not isinstance(dr, SymbolicZero):
        change = [x + y * dr for x, y in zip(change, (c * d, -s * d, -(1 - m1) * s * c))]
    if not isinstance(dm1, SymbolicZero):
        change = [x - y * dm1 for x, y in zip(change, _slopes_in_m(s, c, d, m1))]
    return (s, c, d), tuple(change)


# where dn^2 underflows
def _flat(d):
    return d < 16 * np.sqrt(float(jnp.finfo(d.dtype).tiny))


# derivatives in m, from that of the amplitude, -dn int_0^u (sn/dn)^2/2
def _slopes_in_m(s, c, d, m1):
    flat = _flat(d)
    safe = jnp.where(flat, 1.0, d)
    turn = jnp.where(
        flat, -jnp.sign(s) / (4 * d), -safe * s**3 * _RD(jnp.where(flat, 1.0, c), 1.0, safe) / 6
    )
    # finite, so that its product with a zero tangent is zero
    turn = jnp.clip(turn, -jnp.finfo(turn.dtype).max, jnp.finfo(turn.dtype).max)
    first = jnp.where(flat, -jnp.sign(s) / 4, c * jnp.where(flat, 0.0, turn))
    return first, -s * turn, jnp.where(flat, s * turn, (-s * s / 2 - (1 - m1) * s * first) / safe)
