"""Carlson's integrals by duplication, and Legendre's of m1 in terms of them; see `elliptic`."""

from functools import partial

import jax
import jax.numpy as jnp
from jax.custom_derivatives import SymbolicZero

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


# R_F(a^2, b^2, c^2); at most one of a, b, c >= 0 may be zero
def _RF(a, b, c):
    a, b, c = jnp.broadcast_arrays(a, b, c)
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
    return s * _RF(c, d, 1.0) + whole


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
