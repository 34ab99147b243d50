from functools import cache

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import ALL_LAWS, EPS, EXPONENTS, SAME_LAWS, assert_ulps, over, scaled_leaves

import granjax as gx
from granjax.laws import Scaled, plus_power, taylor
from granjax.laws.real_power import logarithm, real_power, root

OVERLAPS = np.array([1e-300, 1e-100, 1e-12, 1e-6, 1e-3, 0.1, 1.0, 7.3, 1e3, 1e6, 1e12])


def derivative(f, order):
    """The elementwise derivative of some order."""
    for _ in range(order):
        f = (lambda g: lambda x: jax.jvp(g, (x,), (jnp.ones_like(x),))[1])(f)
    return f


def falling(p, order):
    """p (p - 1) ... of some number of factors."""
    return float(np.prod([p - k for k in range(order)]))


@cache
def _facts(name):
    """Everything about one law from one compilation: at its compressions, both sides of touch, rest, 0.1 and NaN."""
    case = next(case for case in ALL_LAWS if case.name == name)

    @eqx.filter_jit
    def all_of(law, e):
        orders = [derivative(law.force, order)(e) for order in (1, 2, 3)]
        return dict(
            force=law.force(e),
            energy=law.energy(e),
            overlap=law.overlap(e),
            orders=orders,
            slope=derivative(law.energy, 1)(e),
            preload=jnp.asarray(law.preload),
        )

    return jax.tree.map(
        np.asarray, all_of(case.law, jnp.array(case.strains + (-1e-60, 1e-60, 0.0, 0.1, jnp.nan)))
    )


def facts(case):
    """All of them, and where the compressions of the case are."""
    return _facts(case.name), slice(0, len(case.strains))


def size_of(case):
    """The force scale of a case, with the preload that the law subtracts."""
    x, at = facts(case)
    return float(np.max(np.abs(x["force"][at])) + np.max(x["preload"]))


@pytest.mark.slow
@over(ALL_LAWS)
def test_nothing_at_equilibrium(case):
    x, _ = facts(case)
    ulps = 8 * EPS * float(np.max(x["preload"]))
    np.testing.assert_allclose(x["force"][-3], 0, atol=ulps)
    np.testing.assert_allclose(x["energy"][-3], 0, atol=ulps)


@over(ALL_LAWS)
def test_force_is_the_derivative_of_the_energy(case):
    x, at = facts(case)
    assert_ulps(x["slope"][at], x["force"][at], 64, size_of(case))


@pytest.mark.slow
@over(
    [
        c
        for c in ALL_LAWS
        if c.law.overlap(jnp.array(0.0)) is not None and not isinstance(c.law, gx.laws.Sum)
    ]
)
def test_a_contact_pushes_while_its_overlap_is_positive(case):
    x, at = facts(case)
    closed, opened = x["overlap"][at] > 0, x["overlap"][at] < 0
    total = (x["preload"] + x["force"])[at]
    assert np.all(total[closed] > 0)
    np.testing.assert_allclose(total[opened], 0, atol=4 * EPS * size_of(case))
    assert closed.any()


@pytest.mark.slow
@over(ALL_LAWS)
def test_nan_stays_nan(case):
    x, _ = facts(case)
    for got, constant in (
        (x["force"], False),
        (x["energy"], False),
        (x["orders"][0], isinstance(case.law, gx.Linear)),
    ):
        assert np.isfinite(got[-2])
        assert np.isnan(got[-1]) or constant


@pytest.mark.slow
@over(ALL_LAWS)
def test_no_derivative_is_nan(case):
    # touch, open contact and both sides of it included
    x, _ = facts(case)
    assert not np.isnan(np.stack(x["orders"])[:, :-1]).any()


@pytest.mark.slow
@pytest.mark.parametrize("p", EXPONENTS)
@pytest.mark.parametrize("kind", ["static", "array"])
@pytest.mark.parametrize("order", [0, 1, 2, 3])
def test_derivatives_of_the_power_law_are_the_closed_form(p, kind, order):
    """A p (p - 1) ... s^(p - order) for every positive overlap, zero for the others."""
    law = gx.PowerLaw(1.3, p if kind == "static" else jnp.asarray(p))
    got = np.asarray(derivative(law.force, order)(jnp.array(OVERLAPS)))
    factor = 1.3 * falling(p, order)
    with np.errstate(over="ignore", under="ignore"):
        want = np.zeros_like(OVERLAPS) if factor == 0 else factor * OVERLAPS ** (p - order)
    want[np.abs(want) < np.finfo(float).tiny] = 0  # XLA flushes subnormal numbers to zero
    got = np.where(np.abs(got) < np.finfo(float).tiny, 0, got)
    over = np.isinf(
        want
    )  # beyond the largest float: its edge or infinity, with the sign, never NaN
    assert np.all(np.abs(got[over]) > 1e307) and np.all(np.sign(got[over]) == np.sign(want[over]))
    np.testing.assert_allclose(got[~over], want[~over], rtol=16 * EPS)
    off = np.asarray(
        derivative(law.force, order)(jnp.array([0.0, -0.0, -1e-300, -1e-12, -1.0, -1e12]))
    )
    assert np.all(off == 0)


@pytest.mark.parametrize("order", [0, 1, 2, 3])
def test_derivatives_of_hertz_under_load_are_the_closed_form(order):
    law = gx.Hertz(1.7, 0.9)
    d0 = (0.9 / 1.7) ** (2 / 3)
    e = np.array([-0.999 * d0, -0.5, -1e-3, 0.0, 1e-3, 1.0, 1e6, 1e12])
    want = 1.7 * falling(1.5, order) * (d0 + e) ** (1.5 - order) - (0.9 if order == 0 else 0)
    got = np.asarray(derivative(law.force, order)(jnp.array(e)))
    # d0 + e near opening cancels three digits
    np.testing.assert_allclose(got, want, rtol=1e-11, atol=16 * EPS)
    opened = np.asarray(derivative(law.force, order)(jnp.array([-1.0001 * d0, -5.0, -1e12])))
    np.testing.assert_allclose(opened, -0.9 if order == 0 else 0.0, rtol=4 * EPS)


@pytest.mark.slow
@pytest.mark.parametrize("p", [1.5, 2.0, 0.5, 1.0, 1.37, -3.0])
def test_derivatives_in_the_exponent_are_the_closed_form(p):
    """d/dp s^p = s^p log s, and the mixed derivatives of second order."""
    s = OVERLAPS[2:-2]
    log = np.log(s)

    def f(s, p):
        return jnp.sum(plus_power(s, p))

    S = jnp.array(s)
    one = jax.vmap(jax.grad(f, (0, 1)), (0, None))(S, p)
    two = jax.vmap(jax.jacfwd(jax.grad(f, (0, 1)), (0, 1)), (0, None))(S, p)
    np.testing.assert_allclose(one[0], p * s ** (p - 1), rtol=32 * EPS)
    np.testing.assert_allclose(one[1], s**p * log, rtol=32 * EPS)
    np.testing.assert_allclose(two[0][0], p * (p - 1) * s ** (p - 2), rtol=32 * EPS)
    np.testing.assert_allclose(two[1][1], s**p * log**2, rtol=32 * EPS)
    cancelling = s ** (p - 1) * (1 + np.abs(p * log))
    for mixed in (two[0][1], two[1][0]):
        assert np.all(np.abs(mixed - s ** (p - 1) * (1 + p * log)) <= 32 * EPS * cancelling)
    off = jnp.array([0.0, -1.0, -1e12])
    for g in jax.vmap(jax.grad(f, (0, 1)), (0, None))(off, p):
        assert np.all(np.asarray(g) == 0)


# magnets have no equilibrium without a static force
@pytest.mark.slow
@pytest.mark.parametrize(
    "p, F0", [(p, F0) for p in (*EXPONENTS, -3.0, -1.0, -2.5) for F0 in (0.0, 0.7) if p > 0 or F0]
)
def test_array_exponent_equals_static_exponent(p, F0):
    e = jnp.array([-0.4, -1e-3, 0.0, 1e-3, 0.3])
    static, free = gx.PowerLaw(1.3, p, F0), gx.PowerLaw(1.3, jnp.asarray(p), F0)
    for order in range(4):
        assert_ulps(derivative(free.force, order)(e), derivative(static.force, order)(e), 64)
    assert_ulps(
        free.energy(e), static.energy(e), 64, float(jnp.max(jnp.abs(static.energy(e)))) + F0
    )


@pytest.mark.slow
@pytest.mark.parametrize("p", [1.5, 0.5, -3.0, -1.0])
@pytest.mark.parametrize("build", ["jit", "vmap", "grad"])
def test_a_law_built_from_traced_numbers_is_the_same_law(p, build):
    """Exponents are swept and differentiated; magnets stay magnets there."""
    e = 0.2
    want = gx.PowerLaw(1.3, p, 0.7).force(e)
    d0 = (0.7 / 1.3) ** (1 / p)
    np.testing.assert_allclose(want, 1.3 * (d0 + np.sign(p) * e) ** p - 0.7, rtol=64 * EPS)

    def force(p):
        return gx.PowerLaw(1.3, p, 0.7).force(e)

    if build == "jit":
        got = jax.jit(force)(p)
    elif build == "vmap":
        got = jax.vmap(force)(jnp.array([p]))[0]
    else:
        got, slope = jax.value_and_grad(force)(p)
        h = 1e-5
        np.testing.assert_allclose(slope, (force(p + h) - force(p - h)) / (2 * h), rtol=1e-7)
    np.testing.assert_allclose(got, want, rtol=64 * EPS)


@pytest.mark.parametrize("p", [-3.0, -1.0])
def test_a_static_exponent_stays_known_while_tracing(p):
    """A law of Python numbers that is built inside a traced function is the law that is built outside."""
    got = jax.jit(lambda e: gx.PowerLaw(1.3, p, 0.7).force(e))(0.2)
    np.testing.assert_allclose(got, gx.PowerLaw(1.3, p, 0.7).force(0.2), rtol=64 * EPS)


def test_python_numbers_are_checked_while_tracing():
    with pytest.raises(ValueError, match="stiffness: expected numbers above zero"):
        jax.jit(lambda e: gx.Hertz(-1.0).force(e))(0.1)


@pytest.mark.slow
@pytest.mark.parametrize("exponent", [-3.0, jnp.asarray(-3.0), -1.0, jnp.asarray(-1.0)])
def test_magnets_that_met_are_nan(exponent):
    law = gx.PowerLaw(2.0, exponent, 2.0)  # d0 = 1
    e = jnp.array([0.999, 1.0, 1.5, 1e6])
    for f in (law.force, law.energy):
        got = np.asarray(f(e))
        assert np.isfinite(got[0]) and np.isnan(got[1:]).all()
    np.testing.assert_allclose(law.overlap(e), 1 - np.asarray(e))


def test_taylor_of_hertz():
    # A = d0 = 1: K2, K3, K4 = 3/2, 3/8, -1/16
    assert_ulps(
        tuple(taylor(gx.Hertz(1.0, 1.0))), (np.array(1.5), np.array(0.375), np.array(-0.0625)), 8
    )


@pytest.mark.slow
@pytest.mark.parametrize("p", EXPONENTS)
@pytest.mark.parametrize("kind", ["static", "array"])
def test_taylor_of_the_power_law(p, kind):
    A, d0 = 1.3, 0.8
    law = gx.PowerLaw(A, p if kind == "static" else jnp.asarray(p), A * d0**p)
    want = [A * falling(p, k) * d0 ** (p - k) / fact for k, fact in ((1, 1), (2, 2), (3, 6))]
    np.testing.assert_allclose(np.array(taylor(law)), want, rtol=64 * EPS, atol=0)


@pytest.mark.parametrize("exponent", [-3.0, jnp.asarray(-3.0)])
def test_taylor_of_magnets(exponent):
    # A [d0 - e]^-3 with A = d0 = 1: 3, 6, 10
    np.testing.assert_allclose(
        np.array(taylor(gx.PowerLaw(1.0, exponent, 1.0))), [3, 6, 10], rtol=32 * EPS
    )


@pytest.mark.slow
def test_taylor_elsewhere_and_of_other_laws():
    np.testing.assert_allclose(
        np.array(taylor(gx.Polynomial(1.1, -0.4, 0.3))), [1.1, -0.4, 0.3], rtol=8 * EPS
    )
    np.testing.assert_allclose(np.array(taylor(gx.Toda(2.0, 3.0))), [6, 9, 9], rtol=8 * EPS)
    np.testing.assert_allclose(
        np.array(taylor(gx.Sine(2.0, 3.0))), [2, 0, -3], rtol=8 * EPS, atol=1e-300
    )
    np.testing.assert_allclose(np.array(taylor(gx.Hertz())), [0, 0, 0], atol=0)
    e = 0.7
    want = [1.5 * e**0.5, 0.75 * e**-0.5 / 2, -0.375 * e**-1.5 / 6]
    np.testing.assert_allclose(np.array(taylor(gx.Hertz(), e)), want, rtol=8 * EPS)
    disordered = taylor(gx.Hertz(np.array([1.0, 2.0, 4.0])), e)
    np.testing.assert_allclose(disordered.K2, np.array([1, 2, 4]) * want[0], rtol=8 * EPS)
    # a spring k behind a contact of slope K: K k/(K + k)
    slope = taylor(gx.Yielding(gx.Hertz(1.0, 1.0), 2.0)).K2
    np.testing.assert_allclose(slope, 1.5 * 2 / 3.5, rtol=8 * EPS)


def test_the_overlap_at_rest_loses_no_digit_in_another_unit():
    # XLA's cube root, x^(1/3), is off by five units in the last place at the one end and by one at the other
    F0, powers = np.linspace(0.3, 3.0, 12), 64.0 ** np.arange(-30, 31, 10)
    at = [np.asarray(gx.Hertz(1.0, F0 * unit).rest_overlap) for unit in powers]
    np.testing.assert_array_equal(at, [16.0**k * at[3] for k in range(-30, 31, 10)])
    np.testing.assert_allclose(at[3], np.cbrt(F0) ** 2, rtol=8e-16)


@pytest.mark.parametrize("F0", [0.0, 0.3, 0.7, 5.0])
def test_hertz_is_the_power_law_of_three_halves(F0):
    e = jnp.array([-2.0, -0.1, 0.0, 1e-9, 0.4, 30.0])
    hertz, power = gx.Hertz(1.7, F0), gx.PowerLaw(1.7, 1.5, F0)
    assert np.array_equal(hertz.force(e), power.force(e))
    assert np.array_equal(hertz.energy(e), power.energy(e))
    assert np.array_equal(hertz.overlap(e), power.overlap(e))


def test_closed_forms_of_the_smooth_laws():
    e = np.array([-30.0, -2.0, -1e-9, 1e-12, 0.3, 4.0])
    E = jnp.array(e)
    np.testing.assert_allclose(gx.Toda(0.8, 1.3).force(E), 0.8 * np.expm1(1.3 * e), rtol=4 * EPS)
    np.testing.assert_allclose(
        gx.Sine(0.9, 1.7).force(E), 0.9 / 1.7 * np.sin(1.7 * e), rtol=4 * EPS
    )
    np.testing.assert_allclose(
        gx.Polynomial(1.1, -0.4, 0.3).force(E), 1.1 * e - 0.4 * e**2 + 0.3 * e**3, rtol=8 * EPS
    )
    np.testing.assert_allclose(gx.Linear(1.3).energy(E), 0.65 * e**2, rtol=4 * EPS)


def test_toda_energy_keeps_its_digits_near_rest():
    # (e^x - 1 - x), by its series in exact rational steps; both sides of any switch of formula
    for x in (1e-9, -1e-6, 1e-3, 0.0199, 0.0201, -0.0199, -0.0201, 0.1):
        exact, term = 0.0, x
        terms = []
        for k in range(2, 30):
            term *= x / k
            terms.append(term)
        exact = sum(reversed(terms))
        np.testing.assert_allclose(gx.Toda().energy(jnp.array(x)), exact, rtol=3e-14)


@pytest.mark.parametrize("exponent", [1.5, 1.37, 3.0, -3.0])
def test_energy_under_load_keeps_its_digits_near_rest(exponent):
    """A small wave on a precompressed chain: energy K2 e^2/2 + K3 e^3/3, force K2 e + K3 e^2."""
    law = gx.PowerLaw(1.0, exponent, 1.0)
    K2, K3, _ = taylor(law)
    for e in (1e-4, -1e-5, 1e-6, 1e-7):
        np.testing.assert_allclose(law.force(e), K2 * e + K3 * e * e, rtol=1e-7)
        np.testing.assert_allclose(law.energy(e), K2 * e * e / 2 + K3 * e**3 / 3, rtol=1e-7)


@pytest.mark.slow
@over(ALL_LAWS, SAME_LAWS)
def test_jit_is_eager(case):
    e = jnp.array(case.strains)

    def both(law, e):
        return law.force(e), law.energy(e)

    scale = size_of(case) * max(map(abs, case.strains))
    assert_ulps(jax.jit(both)(case.law, e), both(case.law, e), 64, scale)


@pytest.mark.slow
@over(ALL_LAWS, SAME_LAWS)
def test_batches_and_arrays_over_bonds_are_loops(case):
    """Three laws at once, by parameters over bonds, by lanes, and by vmap: the same as one at a time."""
    factors = (1.0, 1.1, 0.9)
    laws = [scaled_leaves(case.law, f) for f in factors]
    e = jnp.array(case.strains) * 0.8
    loop = np.stack([law.force(e) for law in laws], -1)
    lanes = jax.vmap(lambda f: scaled_leaves(case.law, f), out_axes=-1)(jnp.array(factors))
    scale = float(np.max(np.abs(loop))) + float(jnp.max(jnp.asarray(case.law.preload)))
    assert_ulps(lanes.force(jnp.stack([e] * 3, -1)), loop, 64, scale)
    assert_ulps(jax.vmap(lambda law: law.force(e), out_axes=-1)(lanes), loop, 64, scale)
    # one bond of each kind: the parameters are arrays over bonds
    assert_ulps(lanes.force(jnp.broadcast_to(e[5], (3,))), loop[5], 64, scale)
    energies = np.stack([law.energy(e) for law in laws], -1)
    assert_ulps(
        lanes.energy(jnp.stack([e] * 3, -1)), energies, 64, scale * float(jnp.max(jnp.abs(e)))
    )


@pytest.mark.slow
@over(ALL_LAWS, SAME_LAWS)
def test_float32_stays_float32(case):
    law = jax.tree.map(lambda x: x.astype(jnp.float32), case.law)
    e = jnp.array(case.strains, jnp.float32)
    scale = size_of(case)
    for f, g, size in (
        (law.force, case.law.force, scale),
        (law.energy, case.law.energy, 50 * scale),
    ):
        assert f(e).dtype == jnp.float32
        # exponents and parameters round in float32 too: a hundred of its units
        np.testing.assert_allclose(f(e), g(jnp.array(case.strains)), rtol=1e-5, atol=1e-5 * size)
    assert derivative(law.force, 1)(e).dtype == jnp.float32


def test_sum_and_scaled():
    a, b, c = gx.Hertz(1.0, 0.3), gx.PowerLaw(0.2, 2.5), gx.Linear(0.4)
    e = jnp.array([-1.0, 0.0, 0.7])
    total = a + b + c
    assert len(total.parts) == 3
    assert_ulps(total.force(e), a.force(e) + b.force(e) + c.force(e), 4)
    assert_ulps(total.energy(e), a.energy(e) + b.energy(e) + c.energy(e), 4)
    assert float(total.preload) == 0.3
    assert np.array_equal(total.overlap(e), np.minimum(a.overlap(e), b.overlap(e)))
    assert (c + c).overlap(e) is None
    twice = Scaled(a, 2.0)
    assert_ulps(twice.force(e), 2 * a.force(e), 2)
    assert float(twice.preload) == 0.6


@pytest.mark.slow
@pytest.mark.parametrize(
    "law",
    [gx.Hertz(), gx.Hertz(1.7, 0.9), gx.PowerLaw(1.0, 0.5), gx.PowerLaw(1.0, -3.0, 1.0)],
    ids=["hertz", "hertz_F0", "softening", "magnets"],
)
def test_yielding_solves_its_equation(law):
    """x + F(x)/k = e: the bond's force is the contact's and the spring's, for supports soft and stiff."""
    supports, e = np.array([1e-9, 1e-3, 0.1, 1.0, 1e3, 1e9, 1e15]), np.array([-0.4, 0.05, 0.5, 1.5])
    force, yielding = (
        jax.jit(lambda x: law.force(x)),
        eqx.filter_jit(lambda bond: bond.force(jnp.array(e))),
    )
    expected = force(_bisect(force, supports[:, None], e[None, :]))
    for support, want in zip(supports, expected):
        # F0 is subtracted: its rounding stays
        atol = 1e-10 * support / (1 + support) + 16 * EPS * float(law.preload)
        got = yielding(gx.Yielding(law, jnp.asarray(support)))
        np.testing.assert_allclose(got, want, rtol=1e-10, atol=atol, err_msg=f"support {support}")


def _bisect(force, support, e):
    """Solve by bisection; a meeting of magnets counts as an infinite force."""
    low, high = np.minimum(e, 0.0), np.maximum(e, 0.0)
    low = low - 1e-12
    for _ in range(200):
        middle = (low + high) / 2
        over = ~((middle + np.asarray(force(middle)) / support - e) < 0)
        low, high = np.where(over, low, middle), np.where(over, middle, high)
    return (low + high) / 2


@pytest.mark.parametrize("p", [1.4, 0.5, 3.7, -3.2, 9.3, 1e-3])
def test_real_power_is_true_to_a_few_ulps_over_sixty_decades(p):
    x = 10 ** np.random.default_rng(1).uniform(-30, 30, 500)
    exact = x.astype(np.longdouble) ** np.longdouble(p)
    for exponent in (p, jnp.asarray(p)):
        error = np.abs(np.asarray(real_power(jnp.asarray(x), exponent)) / exact - 1).max()
        assert error < (2 + abs(p)) * EPS


def test_logarithm_is_true_to_an_ulp():
    x = np.append(
        10 ** np.random.default_rng(2).uniform(-30, 30, 500), 1 + np.linspace(-1e-3, 1e-3, 101)
    )
    exact = np.log(x.astype(np.longdouble))
    error = np.abs(np.asarray(logarithm(jnp.asarray(x))) - exact)
    assert (error <= 2 * EPS * np.abs(exact)).all()


@pytest.mark.parametrize("p", [1.4, 0.3, -2.3])
def test_real_power_at_the_ends(p):
    ends = jnp.asarray([0.0, jnp.inf, jnp.nan, 1.0, 1e300])
    with np.errstate(all="ignore"):
        np.testing.assert_allclose(real_power(ends, p), np.asarray(ends) ** p, rtol=1e-14)
    assert float(logarithm(jnp.asarray(jnp.inf))) == np.inf and np.isnan(
        logarithm(jnp.asarray(jnp.nan))
    )
    assert np.isfinite(logarithm(jnp.asarray(0.0)))


@pytest.mark.parametrize("form", ["products", "instruction"])
def test_root_is_true_to_an_ulp_and_a_half(form, monkeypatch):
    monkeypatch.setattr("granjax.laws.real_power.root_by_products", lambda: form == "products")
    x = 10 ** np.random.default_rng(3).uniform(-300, 300, 2000)
    error = np.abs(
        np.asarray(jax.jit(lambda x: root(x))(jnp.asarray(x))) / np.sqrt(x.astype(np.longdouble))
        - 1
    )
    assert error.max() < 1.5 * EPS
    ends = jnp.asarray([0.0, jnp.inf, jnp.nan, 1.0])
    np.testing.assert_array_equal(root(ends), jnp.sqrt(ends))
    assert root(jnp.ones(3, jnp.float32)).dtype == jnp.float32
