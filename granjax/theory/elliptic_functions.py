"""sn, cn, dn, zeta and the logarithm of Theta, in m1 = 1 - m; `elliptic` is their face."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_derivatives import SymbolicZero

from .chain_wave import _sech
from .elliptic_integrals import _E, _K, _RD, MEANS, _positive, _second, _sloped

# terms of a series in a nome below exp(-pi)
TERMS = 5


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
    flat = _flat(d)
    s, c, d = jnp.where(flat, 0.0, s), jnp.where(flat, 1.0, c), jnp.where(flat, 1.0, d)
    second = jnp.where(flat, jnp.sign(r), _second(r, s, c, d, m1))
    share = jnp.where(m1 > 0, _E(_positive(m1)[0]) / _K(_positive(m1)[0]), 0.0)
    return second - r * share


@jax.custom_jvp
def _nome(m1):
    """exp(-pi K'/K), m/16 of small m."""
    return jnp.exp(-jnp.pi * _K(1 - m1) / _K(m1))


_sloped(
    _nome,
    lambda m1: (
        -((jnp.pi / (2 * _K(m1))) ** 2)
        / m1
        * jnp.where(m1 < 1, _nome(m1) / jnp.where(m1 < 1, 1 - m1, 1.0), 1 / 16)
    ),
)


def _log_theta(u, m1):
    """ln Theta(u)/Theta(0), whose derivative in u is zeta; at m = 1 ln cosh u."""
    r, _ = _period_left(u, m1)
    r, round_ = jnp.abs(r), m1 > 0.5
    K, other = _K(jnp.where(m1 > 0, m1, 1.0)), _K(jnp.where(round_, 0.5, 1 - m1))
    q, z = _nome(jnp.where(round_, m1, 1.0)), jnp.pi * r / jnp.where(round_, K, 1.0)
    by_cosines = jnp.log1p(
        sum(-4 * (-1) ** n * q ** (n * n) * jnp.sin(n * z / 2) ** 2 for n in range(1, TERMS))
        / (1 + sum(2 * (-1) ** n * q ** (n * n) for n in range(1, TERMS)))
    )
    other = jnp.where(round_, 1.0, other)
    x, log_q = jnp.pi * r / (2 * other), jnp.where(m1 > 0, -jnp.pi * K / other, -jnp.inf)
    log_q = jnp.where(round_, -1.0, log_q)
    series = (1 + jnp.exp(-2 * x)) / 2 + sum(
        jnp.exp((n * n + n) * log_q + 2 * n * x) * (1 + jnp.exp(-(4 * n + 2) * x)) / 2
        for n in range(1, TERMS)
    )
    at_0 = 1 + sum(jnp.exp((n * n + n) * log_q) for n in range(1, TERMS))
    square = jnp.where(m1 > 0, jnp.pi * r * r / (4 * K * other), 0.0)
    return jnp.where(round_, by_cosines, x - square + jnp.log(series / at_0))


@jax.custom_jvp
def _in_period(r, m1):
    """sn, cn, dn of |r| <= K: of |r| or K - |r|, whichever is less, and at m = 1 hyperbolic functions."""
    w, K = jnp.abs(r), _K(m1)
    far = w > K / 2
    w = jnp.where(far, K - w, w)
    whole = jnp.tanh(w), _sech(w), _sech(w)
    s, c, d = (jnp.where(m1 == 0, x, y) for x, y in zip(whole, _by_means(w, _positive(m1)[1])))
    root, safe = jnp.sqrt(m1), jnp.where(far, d, 1.0)
    s, c, d = (
        jnp.where(far, c / safe, s),
        jnp.where(far, root * s / safe, c),
        jnp.where(far, root / safe, d),
    )
    return jnp.sign(r) * s, c, d


def _by_means(w, root):
    """sn, cn, dn of 0 <= w <= K/2 by Landen's transformations, for the root of m1; Bulirsch's form, in cotangents."""
    means, a, b = [], jnp.ones_like(root), root
    for _ in range(MEANS):
        means.append((a, b))
        a, b = (a + b) / 2, jnp.sqrt(a * b)
    angle = a * jnp.where(w > 0, w, 1.0)
    ratio = jnp.cos(angle) / jnp.sin(angle)
    c, d = a * ratio, 1.0
    for a, b in reversed(means):
        ratio, c = c * ratio, c * d
        d = (b + ratio) / (a + ratio)
        ratio = c / a
    s = 1 / jnp.sqrt(1 + c * c)
    return jnp.where(w > 0, s, w), jnp.where(w > 0, c * s, 1.0), jnp.where(w > 0, d, 1.0)


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


def _flat(d):
    """Where dn is so small that its square is no number."""
    return d < 16 * np.sqrt(float(jnp.finfo(d.dtype).tiny))


def _slopes_in_m(s, c, d, m1):
    """Derivatives in m, from that of the amplitude, -dn int_0^u (sn/dn)^2/2."""
    flat = _flat(d)
    safe = jnp.where(flat, 1.0, d)
    turn = jnp.where(
        flat, -jnp.sign(s) / (4 * d), -safe * s**3 * _RD(jnp.where(flat, 1.0, c), 1.0, safe) / 6
    )
    # finite, so that a tangent that is zero stays so
    turn = jnp.clip(turn, -jnp.finfo(turn.dtype).max, jnp.finfo(turn.dtype).max)
    first = jnp.where(flat, -jnp.sign(s) / 4, c * jnp.where(flat, 0.0, turn))
    return first, -s * turn, jnp.where(flat, s * turn, (-s * s / 2 - (1 - m1) * s * first) / safe)
