"""Elliptic functions and integrals against mpmath in 50 digits, from m = 0 to where 1 - m is 1e-300, and at m = 1."""

import jax
import jax.numpy as jnp
import mpmath as mp
import numpy as np
import pytest
from numpy.testing import assert_allclose
from pytest import mark
from refusals import refused

from granjax.theory import elliptic

M1 = np.array([1.0, 0.9, 0.5, 0.1, 1e-3, 1e-8, 1e-15, 1e-40, 0.0])
U = np.array([0.0, 1e-9, 0.3, 1.0, 2.0, -3.3, 17.0, 100.0])
KINDS = ("sn", "cn", "dn")


@pytest.fixture(autouse=True)
def digits():
    with mp.workdps(50):
        yield


def values(function, *grids):
    """A function of mpmath's of m on grids, the last of 1 - m; m = 1 to 300 digits where it rounds to that."""

    def exact(*arguments):
        *others, m1 = (mp.mpf(float(x)) for x in arguments)
        with mp.workdps(50 if m1 == 0 or m1 > 1e-20 else 120):
            return float(function(*others, 1 - m1))

    return np.vectorize(exact, otypes=[float])(*grids)


def ellipfun(kind):
    limits = {"sn": mp.tanh, "cn": mp.sech, "dn": mp.sech}
    return lambda u, m: limits[kind](u) if m == 1 else mp.ellipfun(kind, u, m=m)


def zeta(u, m):
    if m == 1:
        return mp.tanh(u)
    K = mp.ellipk(m)
    E = mp.ellipe(m)
    r = u - 2 * K * mp.nint(u / (2 * K))
    return mp.ellipe(mp.asin(mp.ellipfun("sn", r, m=m)), m) - r * E / K


def close(got, want, size=1.0):
    """To 1e-14, absolute or relative, times the size of the argument."""
    np.testing.assert_array_less(
        np.abs(np.asarray(got) - want), 1e-14 * size * np.maximum(1, np.abs(want))
    )


@mark.parametrize("kind", [*KINDS, "zeta"])
def test_functions(kind):
    u, m1 = np.meshgrid(U, M1, indexing="ij")
    got = elliptic.zeta(u, m1=m1) if kind == "zeta" else getattr(elliptic.jacobi(u, m1=m1), kind)
    want = values(zeta if kind == "zeta" else ellipfun(kind), u, m1)
    close(got, want, np.maximum(1, np.abs(u)))
    # the tail of a soliton keeps its digits
    some = (np.abs(want) > 1e-50) & (np.abs(u) <= 17) & (kind != "zeta")
    assert_allclose(np.asarray(got)[some], want[some], rtol=2e-13)


def test_m_serves_as_well_where_it_is_accurate():
    assert_allclose(elliptic.jacobi(0.7, 0.3), elliptic.jacobi(0.7, m1=0.7), rtol=0, atol=1e-16)
    assert elliptic.K(0.5) == elliptic.K(m1=0.5)
    assert_allclose(elliptic.jacobi(0.8, 0.0), [np.sin(0.8), np.cos(0.8), 1], rtol=1e-15)
    s, c, d = elliptic.jacobi(np.array([0.8, 800.0]), 1.0)
    assert_allclose(s, np.tanh([0.8, 800.0]), rtol=1e-15)
    assert_allclose([c, d], [[1 / np.cosh(0.8), 0.0]] * 2, rtol=1e-15)


@mark.slow
def test_integrals():
    inside = M1[:-1]
    close(elliptic.K(m1=inside), values(mp.ellipk, inside))
    close(elliptic.E(m1=M1), values(mp.ellipe, M1))
    n, m1 = np.meshgrid([-1e8, -3.0, -1e-12, 0.0, 0.3, 0.999], inside, indexing="ij")
    close(elliptic.Pi(n, m1=m1), values(mp.ellippi, n, m1))
    # in an array so long that processors take eight at a time, which one XLA does wrongly with its own atan
    n = np.linspace(-3, 0.999, 200)
    m1 = np.linspace(0.999, 0.01, 200)
    assert_allclose(elliptic.Pi(n, m1=m1), values(mp.ellippi, n, m1), rtol=5e-15)
    # beyond pi/2 and negative ones
    phi, m1 = np.meshgrid([0.3, 1.5, -1.57, 3.0, 7.0], M1[:6], indexing="ij")
    close(elliptic.F(phi, m1=m1), values(mp.ellipf, phi, m1))
    assert_allclose(elliptic.F(1.2, 1.0), np.arctanh(np.sin(1.2)), rtol=1e-14)
    assert_allclose(elliptic.K(m1=1e-300), np.log(4) + 150 * np.log(10), rtol=1e-15)
    infinite = elliptic.K(1.0), elliptic.Pi(0.3, 1.0), elliptic.Pi(1.0, 0.3), elliptic.F(2.0, 1.0)
    assert np.all(np.isposinf(infinite)) and elliptic.E(1.0) == 1.0


@jax.jit
def both_modes(x):
    """Derivatives in (u, m1) of sn, cn, dn and zeta."""
    f = lambda x: jnp.stack([*elliptic.jacobi(x[0], m1=x[1]), elliptic.zeta(x[0], m1=x[1])])
    return jax.jacfwd(f)(x), jax.jacrev(f)(x), jax.jacfwd(jax.jacrev(f))(x)


@mark.slow
def test_slopes_at_the_ends():
    """The first terms of series in m and in m1 (Abramowitz and Stegun 16.13, 16.15); what is infinite says so."""
    u = 0.9
    slope = lambda u, m1: -both_modes(jnp.array([u, m1]))[0][:3, 1]
    turn = (u - np.sin(u) * np.cos(u)) / 4
    sound = [-turn * np.cos(u), turn * np.sin(u), -(np.sin(u) ** 2) / 2]
    assert_allclose(slope(u, 1.0), sound, rtol=1e-14)
    turn = (np.sinh(u) * np.cosh(u) - u) / 4
    sech = 1 / np.cosh(u)
    other = -(np.sinh(u) * np.cosh(u) + u) / 4
    soliton = np.array([-turn * sech, turn * np.tanh(u), other * np.tanh(u)]) * sech
    assert_allclose(slope(u, 0.0), soliton, rtol=1e-14)
    # far out on a soliton nothing becomes NaN
    assert np.isfinite(both_modes(jnp.array([800.0, 0.0]))[0]).all()
    for integral, at_0, at_1 in (
        (elliptic.K, np.pi / 8, np.inf),
        (elliptic.E, -np.pi / 8, -np.inf),
    ):
        assert_allclose([jax.grad(integral)(m) for m in (0.0, 1.0)], [at_0, at_1])


@mark.slow
def test_derivatives_of_the_functions():
    for u in (0.0, 0.7, 5.0):
        for m1 in (0.6, 1e-3):
            first, reverse, second = both_modes(jnp.array([u, m1]))
            assert_allclose(first, reverse, rtol=1e-12, atol=1e-15)
            for i, f in enumerate([*map(ellipfun, KINDS), zeta]):
                g = lambda u, m1: f(u, 1 - m1)
                want = [mp.diff(g, (u, m1), order) for order in ((1, 0), (0, 1), (0, 2))]
                assert_allclose(first[i], np.array(want[:2], float), rtol=1e-12, atol=1e-13)
                assert_allclose(second[i, 1, 1], float(want[2]), rtol=1e-8, atol=1e-9)


@mark.slow
def test_derivatives_of_the_integrals():
    """In every argument, in both modes."""
    pairs = (
        (lambda n, phi, q: elliptic.F(phi, m1=q), lambda n, phi, q: mp.ellipf(phi, 1 - q)),
        (
            lambda n, phi, q: elliptic.Pi(n, m1=q) * elliptic.K(m1=q) * elliptic.E(m1=q),
            lambda n, phi, q: mp.ellippi(n, 1 - q) * mp.ellipk(1 - q) * mp.ellipe(1 - q),
        ),
    )
    for f, g in pairs:
        modes = jax.jit(lambda *x: [mode(f, (0, 1, 2))(*x) for mode in (jax.jacfwd, jax.jacrev)])
        for n in (-0.7, 0.4):
            x = n, 2.1, 0.2
            want = [float(mp.diff(g, x, tuple(row))) for row in np.eye(3, dtype=int).tolist()]
            for got in modes(*x):
                assert_allclose(got, want, rtol=1e-12, atol=1e-13)


@mark.parametrize(
    "call, said",
    [
        (lambda: elliptic.K(-1e-9), r"^m: expected .*\[0, 1\]"),
        (lambda: elliptic.E(1.0000001), r"^m: expected .*\[0, 1\]"),
        (lambda: elliptic.jacobi(0.3, np.nan), "^m: expected .*finite"),
        (lambda: elliptic.F(0.3, [0.2, -1e-9]), r"^m: expected .*\[0, 1\]"),
        (lambda: elliptic.zeta(0.3, m1=1.0000001), "^m1: expected"),
        (lambda: elliptic.Pi(1.2, 0.5), "^n: expected numbers not above 1"),
        (lambda: elliptic.K(0.5, m1=0.5), "^m, m1: expected one of the two, got both"),
        (lambda: elliptic.jacobi(0.5), "^m, m1: expected one of the two, got none"),
        (lambda: elliptic.jacobi(1e300, 0.5), "^u: expected numbers below 4.5e.14"),
    ],
)
def test_arguments_outside_are_refused(call, said):
    with refused(said):
        call()


def test_what_is_traced_and_lies_outside_is_nan():
    assert np.isnan([jax.jit(elliptic.K)(2.0), *jax.jit(elliptic.jacobi)(0.3, 2.0)]).all()
    assert np.isnan(jax.jit(elliptic.E)(2.0)) and elliptic.jacobi(1e300, 1.0).sn == 1.0
