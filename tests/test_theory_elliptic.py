"""Elliptic functions and integrals against mpmath in 50 digits, from m = 0 to where 1 - m is 1e-300, and at m = 1."""

import jax
import jax.numpy as jnp
import mpmath as mp
import numpy as np
import pytest
from refusals import refused

import granjax as gx
from granjax.theory import elliptic

M1 = np.array([1.0, 0.9, 0.5, 0.1, 1e-3, 1e-8, 1e-15, 1e-40, 0.0])
U = np.array([0.0, 1e-9, 0.3, 1.0, 2.0, -3.3, 17.0, 100.0])
KINDS = ("sn", "cn", "dn")
# of the incomplete integral; beyond pi/2 and negative ones
PHI = np.array([0.3, 1.5, -1.57, 3.0, 7.0])
N = np.array([-1e8, -3.0, -1e-12, 0.0, 0.3, 0.999])


@pytest.fixture(autouse=True)
def digits():
    with mp.workdps(50):
        yield


def exact(function, *arguments):
    """A function of mpmath's of m, the last argument 1 - m; m = 1 to 300 digits where it rounds to that."""
    *others, m1 = (mp.mpf(float(x)) for x in arguments)
    with mp.workdps(50 if m1 == 0 or m1 > 1e-20 else 120):
        return function(*others, 1 - m1)


def values(function, *grids):
    return np.vectorize(lambda *x: float(exact(function, *x)), otypes=[float])(*grids)


def ellipfun(kind):
    limits = {"sn": mp.tanh, "cn": mp.sech, "dn": mp.sech}
    return lambda u, m: limits[kind](u) if m == 1 else mp.ellipfun(kind, u, m=m)


def close(got, want, size=1.0):
    """To 1e-14, absolute or relative, times the size of the argument."""
    np.testing.assert_array_less(
        np.abs(np.asarray(got) - want), 1e-14 * size * np.maximum(1, np.abs(want))
    )


@pytest.mark.parametrize("kind", KINDS)
def test_jacobi(kind):
    u, m1 = np.meshgrid(U, M1, indexing="ij")
    got, want = getattr(elliptic.jacobi(u, m1=m1), kind), values(ellipfun(kind), u, m1)
    close(got, want, np.maximum(1, np.abs(u)))
    # the tail of a soliton keeps its digits
    some = (np.abs(want) > 1e-50) & (np.abs(u) <= 17)
    np.testing.assert_allclose(np.asarray(got)[some], want[some], rtol=2e-13)


def test_m_serves_as_well_where_it_is_accurate():
    for x, y in zip(elliptic.jacobi(0.7, 0.3), elliptic.jacobi(0.7, m1=0.7)):
        assert x == pytest.approx(float(y), abs=1e-16)
    assert elliptic.K(0.5) == elliptic.K(m1=0.5)
    s, c, d = elliptic.jacobi(0.8, 0.0)
    np.testing.assert_allclose([s, c, d], [np.sin(0.8), np.cos(0.8), 1], rtol=1e-15)
    s, c, d = elliptic.jacobi(np.array([0.8, 800.0]), 1.0)
    np.testing.assert_allclose(s, np.tanh([0.8, 800.0]), rtol=1e-15)
    np.testing.assert_allclose(c, [1 / np.cosh(0.8), 0.0], rtol=1e-15)
    assert "sn" in repr(elliptic.jacobi(0.7, 0.3)) and gx.theory.elliptic is elliptic


@pytest.mark.slow
def test_complete_integrals():
    close(elliptic.K(m1=M1[:-1]), values(mp.ellipk, M1[:-1]))
    close(elliptic.E(m1=M1), values(mp.ellipe, M1))
    n, m1 = np.meshgrid(N, M1[:-1], indexing="ij")
    close(elliptic.Pi(n, m1=m1), values(lambda n, m: mp.ellippi(n, m), n, m1))
    # in an array so long that processors take eight at a time, which one XLA does wrongly with its own atan
    n, m1 = np.linspace(-3, 0.999, 200), np.linspace(0.999, 0.01, 200)
    np.testing.assert_allclose(elliptic.Pi(n, m1=m1), values(mp.ellippi, n, m1), rtol=5e-15)
    assert elliptic.K(1.0) == np.inf and elliptic.E(1.0) == 1.0
    assert elliptic.Pi(0.3, 1.0) == np.inf and elliptic.Pi(1.0, 0.3) == np.inf
    assert elliptic.K(m1=1e-300) == pytest.approx(np.log(4) + 150 * np.log(10), rel=1e-15)


@pytest.mark.slow
def test_the_incomplete_integral():
    phi, m1 = np.meshgrid(PHI, M1[:6], indexing="ij")
    close(elliptic.F(phi, m1=m1), values(mp.ellipf, phi, m1))
    assert elliptic.F(2.0, 1.0) == np.inf and elliptic.F(1.2, 1.0) == pytest.approx(
        np.arctanh(np.sin(1.2)), rel=1e-14
    )


def zeta(u, m):
    if m == 1:
        return mp.tanh(u)
    K, E = mp.ellipk(m), mp.ellipe(m)
    r = u - 2 * K * mp.nint(u / (2 * K))
    return mp.ellipe(mp.asin(mp.ellipfun("sn", r, m=m)), m) - r * E / K


def test_zeta():
    u, m1 = np.meshgrid(U, M1, indexing="ij")
    close(elliptic.zeta(u, m1=m1), values(zeta, u, m1), np.maximum(1, np.abs(u)))


def test_slopes_at_the_ends():
    """The first terms of series in m and in m1 (Abramowitz and Stegun 16.13, 16.15); what is infinite says so."""
    slope = jax.jit(
        lambda u, m1: jax.jvp(lambda m1: elliptic.jacobi(u, m1=m1), (m1,), (-jnp.ones_like(m1),))[1]
    )
    u = 0.9
    s, c, d = slope(u, 1.0)
    turn = (u - np.sin(u) * np.cos(u)) / 4
    np.testing.assert_allclose(
        [s, c, d], [-turn * np.cos(u), turn * np.sin(u), -(np.sin(u) ** 2) / 2], rtol=1e-14
    )
    s, c, d = slope(u, 0.0)
    turn, sech = (np.sinh(u) * np.cosh(u) - u) / 4, 1 / np.cosh(u)
    other = -(np.sinh(u) * np.cosh(u) + u) / 4
    np.testing.assert_allclose(
        [s, c, d],
        np.array([-turn * sech, turn * np.tanh(u), other * np.tanh(u)]) * sech,
        rtol=1e-14,
    )
    assert np.isfinite(slope(800.0, 0.0)).all()
    for integral, at_0, at_1 in (
        (elliptic.K, np.pi / 8, np.inf),
        (elliptic.E, -np.pi / 8, -np.inf),
    ):
        assert jax.grad(integral)(0.0) == pytest.approx(at_0) and jax.grad(integral)(1.0) == at_1


@jax.jit
def both_modes(x):
    """Derivatives in (u, m1) of sn, cn, dn and zeta."""
    f = lambda x: jnp.stack([*elliptic.jacobi(x[0], m1=x[1]), elliptic.zeta(x[0], m1=x[1])])
    return jax.jacfwd(f)(x), jax.jacrev(f)(x), jax.jacfwd(jax.jacrev(f))(x)


@pytest.mark.slow
def test_derivatives_of_jacobi():
    functions = [*map(ellipfun, KINDS), zeta]
    for u in (0.0, 0.7, 5.0):
        for m1 in (1.0, 0.6, 1e-3, 0.0):
            first, reverse, second = both_modes(jnp.array([u, m1]))
            np.testing.assert_allclose(first, reverse, rtol=1e-12, atol=1e-15)
            for i, f in enumerate(functions[:3] if m1 in (0.0, 1.0) else functions):
                g = lambda u, m1: f(u, 1 - m1) if m1 else f(u, mp.mpf(1))
                # mpmath takes a difference from inside the interval
                inwards = dict(
                    direction=1 if m1 == 0 else -1 if m1 == 1 else 0, h=mp.mpf(10) ** -15
                )
                along = [mp.diff(lambda x: g(mp.mpf(u), x), m1, k, **inwards) for k in (1, 2)]
                size = 1e-10 if m1 in (0.0, 1.0) else 1e-12
                assert first[i, 1] == pytest.approx(float(along[0]), rel=size, abs=size), (u, m1, i)
                assert first[i, 0] == pytest.approx(
                    float(mp.diff(lambda x: g(x, m1), u)), rel=1e-12, abs=1e-13
                )
                if 0 < m1 < 1:
                    assert second[i, 1, 1] == pytest.approx(float(along[1]), rel=1e-8, abs=1e-9), (
                        u,
                        m1,
                        i,
                    )
    # far out on a soliton nothing becomes NaN
    assert np.isfinite(both_modes(jnp.array([800.0, 0.0]))[0]).all()


@pytest.mark.study
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
            want = [float(mp.diff(g, x, tuple(int(i == k) for i in range(3)))) for k in range(3)]
            for got in modes(*x):
                np.testing.assert_allclose(got, want, rtol=1e-12, atol=1e-13)


@pytest.mark.parametrize("m", [-1e-9, 1.0000001])
def test_a_parameter_outside_is_refused(m):
    for f in (
        elliptic.K,
        elliptic.E,
        lambda m: elliptic.jacobi(0.3, m),
        lambda m: elliptic.F(0.3, [0.2, m]),
    ):
        with refused(r"^m: expected .*(\[0, 1\]|finite)"):
            f(m)
    with refused(r"^m1: expected"):
        elliptic.zeta(0.3, m1=m)


def test_what_else_is_refused():
    with refused("^n: expected numbers not above 1"):
        elliptic.Pi(1.2, 0.5)
    with refused("^m, m1: expected one of the two, got both"):
        elliptic.K(0.5, m1=0.5)
    with refused("^m, m1: expected one of the two, got none"):
        elliptic.jacobi(0.5)
    # of what is traced nobody knows that it lies outside
    assert np.isnan(jax.jit(elliptic.K)(2.0)) and np.isnan(jax.jit(elliptic.E)(2.0))
    assert np.isnan(jax.jit(elliptic.jacobi)(0.3, 2.0)).all()
    with refused("^u: expected numbers below 4.5e.14"):
        elliptic.jacobi(1e300, 0.5)
    assert elliptic.jacobi(1e300, 1.0).sn == 1.0
