"""sn, cn, dn, zeta and the logarithm of Theta, as functions of m1 = 1 - m; public in `elliptic`."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_derivatives import SymbolicZero

from .chain_wave import _sech
from .elliptic_integrals import _K, _RD, MEANS, _positive, _second, _share


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
