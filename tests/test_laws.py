from functools import cache

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import ALL_LAWS, EPS, EXPONENTS, assert_ulps, over, scaled_leaves
from numpy.testing import assert_allclose, assert_array_equal
from refusals import refused

import granjax as gx
from granjax import Hertz, Linear, PowerLaw, Toda
from granjax.laws import Scaled, plus_power, taylor
from granjax.laws.real_power import real_power, root

OVERLAPS = np.array([1e-300, 1e-100, 1e-12, 1e-6, 1e-3, 0.1, 1.0, 7.3, 1e3, 1e6, 1e12])
SIDES = pytest.mark.parametrize("kind", [float, jnp.asarray], ids=["static", "array"])


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
        return dict(
            force=law.force(e),
            energy=law.energy(e),
            overlap=law.overlap(e),
            orders=[derivative(law.force, order)(e) for order in (1, 2, 3)],
            slope=derivative(law.energy, 1)(e),
            preload=jnp.asarray(law.preload),
        )

    e = jnp.array(case.strains + (-1e-60, 1e-60, 0.0, 0.1, jnp.nan))
    return jax.tree.map(np.asarray, all_of(case.law, e))


def facts(case):
    """All of them, where the compressions of the case are, and the force scale with the preload."""
    x = _facts(case.name)
    at = slice(0, len(case.strains))
    return x, at, float(np.abs(x["force"][at]).max() + np.max(x["preload"]))


@over(ALL_LAWS)
def test_force_is_the_derivative_of_the_energy_and_both_vanish_at_rest(case):
    x, at, scale = facts(case)
    assert_ulps(x["slope"][at], x["force"][at], 64, scale)
    ulps = 8 * EPS * float(np.max(x["preload"]))
    assert_allclose(x["force"][-3], 0, atol=ulps)
    assert_allclose(x["energy"][-3], 0, atol=ulps)


@pytest.mark.slow
@over([case for case in ALL_LAWS if case.law.opens and not isinstance(case.law, gx.laws.Sum)])
def test_a_contact_pushes_while_its_overlap_is_positive(case):
    x, at, scale = facts(case)
    closed = x["overlap"][at] > 0
    opened = x["overlap"][at] < 0
    total = (x["preload"] + x["force"])[at]
    assert closed.any() and np.all(total[closed] > 0)
    assert_allclose(total[opened], 0, atol=4 * EPS * scale)


@pytest.mark.slow
@over(ALL_LAWS)
def test_only_nan_gives_nan_at_touch_in_open_contact_and_on_both_sides(case):
    x, _, _ = facts(case)
    constant = isinstance(case.law, Linear)
    assert np.isnan([x["force"][-1], x["energy"][-1]]).all()
    assert np.isnan(x["orders"][0][-1]) or constant
    assert np.isfinite([x["force"][-2], x["energy"][-2]]).all()
    assert not np.isnan(np.stack(x["orders"])[:, :-1]).any()


@pytest.mark.slow
@over(ALL_LAWS)
def test_batches_arrays_over_bonds_and_jit_are_loops(case):
    """Three laws at once, by parameters over bonds and by lanes: the same as one at a time."""
    x, at, scale = facts(case)
    E = jnp.array(case.strains)
    size = scale * np.abs(E).max()
    assert_ulps(
        (case.law.force(E), case.law.energy(E)), (x["force"][at], x["energy"][at]), 64, size
    )
    factors = (1.0, 1.1, 0.9)
    laws = [scaled_leaves(case.law, f) for f in factors]
    e = 0.8 * E
    loop = np.stack([law.force(e) for law in laws], -1)
    lanes = jax.vmap(lambda f: scaled_leaves(case.law, f), out_axes=-1)(jnp.array(factors))
    scale = float(np.max(np.abs(loop))) + float(jnp.max(jnp.asarray(case.law.preload)))
    together = jnp.stack([e] * 3, -1)
    assert_ulps(lanes.force(together), loop, 64, scale)
    # one bond of each kind: the parameters are arrays over bonds
    assert_ulps(lanes.force(jnp.broadcast_to(e[5], (3,))), loop[5], 64, scale)
    energies = np.stack([law.energy(e) for law in laws], -1)
    assert_ulps(lanes.energy(together), energies, 64, scale * float(jnp.max(jnp.abs(e))))


@pytest.mark.slow
@over(ALL_LAWS)
def test_float32_stays_float32(case):
    x, at, scale = facts(case)
    law = jax.tree.map(lambda x: x.astype(jnp.float32), case.law)
    e = jnp.array(case.strains, jnp.float32)
    for f, want, size in (law.force, x["force"], scale), (law.energy, x["energy"], 50 * scale):
        assert f(e).dtype == jnp.float32
        # exponents and parameters round in float32 too: a hundred of its units
        assert_allclose(f(e), want[at], rtol=1e-5, atol=1e-5 * size)
    assert jax.eval_shape(derivative(law.force, 1), e).dtype == jnp.float32


@pytest.mark.slow
@pytest.mark.parametrize("p", EXPONENTS)
@SIDES
def test_derivatives_of_the_power_law_are_the_closed_form(p, kind):
    """A p (p - 1) ... s^(p - order) for every positive overlap, zero for the others."""
    law = PowerLaw(1.3, kind(p))
    tiny = np.finfo(float).tiny
    s = jnp.array([*OVERLAPS, 0.0, -0.0, -1e-300, -1e-12, -1.0, -1e12])
    for order, both in enumerate(
        jax.jit(lambda s: [derivative(law.force, k)(s) for k in range(4)])(s)
    ):
        got, off = np.split(np.asarray(both), [len(OVERLAPS)])
        factor = 1.3 * falling(p, order)
        with np.errstate(over="ignore", under="ignore"):
            want = factor * OVERLAPS ** (p - order) if factor else 0 * OVERLAPS
        # XLA flushes subnormal numbers to zero
        got, want = (np.where(np.abs(x) < tiny, 0, x) for x in (got, want))
        # beyond the largest float: its edge or infinity, with the sign, never NaN
        huge = np.isinf(want)
        assert np.all(np.abs(got[huge]) > 1e307) and np.all(np.sign(got) == np.sign(want))
        assert_allclose(got[~huge], want[~huge], rtol=16 * EPS)
        assert np.all(off == 0)


@pytest.mark.slow
@pytest.mark.parametrize(
    "law",
    [
        lambda p: Hertz(p),
        lambda p: PowerLaw(p, 1.37, 0.3),
        lambda p: PowerLaw(1.0, jnp.asarray(1.37) * p, 0.3),
        lambda p: gx.laws.Yielding(PowerLaw(1.0, 1.37, 0.3), p),
        lambda p: gx.laws.Yielding(gx.laws.Scaled(PowerLaw(1.0, 1.37, 0.3), 2), p),
    ],
    ids=["vacuum", "static", "traced", "yielding", "whole"],
)
def test_second_derivatives_in_a_loop_are_the_same_in_all_modes(law):
    # JAX drops the rules of `custom_jvp` when a scan is differentiated in reverse and once more.
    def energy(p):
        step = lambda e, _: (e + 0.1 * law(p).force(e) * e, None)
        e, _ = jax.lax.scan(step, jnp.array([0.0, -0.2, 0.3, 0.5]), None, length=3)
        return e.sum()

    true = jax.jit(jax.jacfwd(jax.jacfwd(energy)))(1.1)
    h = 1e-4
    assert_allclose((energy(1.1 + h) - 2 * energy(1.1) + energy(1.1 - h)) / h**2, true, rtol=1e-4)
    assert_allclose(jax.hessian(energy)(1.1), true, rtol=1e-12)
    assert_allclose(jax.jit(jax.grad(jax.grad(energy)))(1.1), true, rtol=1e-12)
    lanes = jax.jit(jax.vmap(jax.hessian(energy)))(jnp.array([1.1, 1.2]))
    assert_allclose(lanes[0], true, rtol=1e-12)


def test_powers_by_an_array_of_whole_numbers_keep_the_type():
    for dtype in (np.float32, np.float64):
        found = plus_power(jnp.asarray([4, 0, -1], dtype), jnp.asarray([2, 2, 3]))
        assert found.dtype == dtype
        assert_array_equal(found, [16, 0, 0])


@pytest.mark.slow
@pytest.mark.parametrize("p", [1.5, 1.0, 1.37, -3.0])
def test_derivatives_in_the_exponent_are_the_closed_form(p):
    """d/dp s^p = s^p log s, and the mixed derivatives of second order."""
    s = OVERLAPS[2:-2]
    log = np.log(s)
    slopes = jax.grad(plus_power, (0, 1))
    one = jax.vmap(slopes, (0, None))(jnp.array(s), p)
    two = jax.vmap(jax.jacfwd(slopes, (0, 1)), (0, None))(jnp.array(s), p)
    assert_allclose(one[0], p * s ** (p - 1), rtol=32 * EPS)
    assert_allclose(one[1], s**p * log, rtol=32 * EPS)
    assert_allclose(two[0][0], p * (p - 1) * s ** (p - 2), rtol=32 * EPS)
    assert_allclose(two[1][1], s**p * log**2, rtol=32 * EPS)
    cancelling = s ** (p - 1) * (1 + np.abs(p * log))
    for mixed in two[0][1], two[1][0]:
        assert np.all(np.abs(mixed - s ** (p - 1) * (1 + p * log)) <= 32 * EPS * cancelling)
    off = jax.vmap(slopes, (0, None))(jnp.array([0.0, -1.0, -1e12]), p)
    assert_array_equal(off, 0 * np.array(off))


@pytest.mark.slow
@pytest.mark.parametrize("p", [1.37, 0.5, -3.0, -1.0, -2.5])
def test_an_exponent_may_be_traced(p):
    """Exponents are swept and differentiated; magnets stay magnets there."""

    def force(p):
        return PowerLaw(1.3, p, 0.7).force(0.2)

    got, slope = jax.value_and_grad(force)(p)
    h = 1e-5
    assert_allclose(slope, (force(p + h) - force(p - h)) / (2 * h), rtol=1e-7)
    # the last is built of Python numbers inside a traced function
    traced = jax.jit(force)(p), jax.vmap(force)(jnp.array([p]))[0], jax.jit(lambda: force(p))()
    d0 = (0.7 / 1.3) ** (1 / p)
    want = 1.3 * (d0 + np.sign(p) * 0.2) ** p - 0.7
    assert_allclose([force(p), got, *traced], want, rtol=64 * EPS)


def test_python_numbers_are_checked_while_tracing():
    with refused("stiffness: expected numbers above zero"):
        jax.jit(lambda e: Hertz(-1.0).force(e))(0.1)


@pytest.mark.slow
@pytest.mark.parametrize("exponent", [-3.0, jnp.asarray(-1.0)])
def test_magnets_that_met_are_nan(exponent):
    law = PowerLaw(2.0, exponent, 2.0)  # d0 = 1
    e = jnp.array([0.999, 1.0, 1.5, 1e6])
    for got in law.force(e), law.energy(e):
        assert np.isfinite(got[0]) and np.isnan(got[1:]).all()
    assert_allclose(law.overlap(e), 1 - e)


@pytest.mark.slow
@pytest.mark.parametrize("p", [1.5, 3.0, 0.5, 1.37, -3.0])
@SIDES
def test_taylor_of_the_power_law(p, kind):
    A = 1.3
    d0 = 0.8
    sign = np.sign(p)
    want = [A * falling(p, k) * sign**k * d0 ** (p - k) / n for k, n in ((1, 1), (2, 2), (3, 6))]
    got = taylor(PowerLaw(A, kind(p), A * d0**p))
    assert_allclose(np.array(got), want, rtol=64 * EPS)


@pytest.mark.slow
def test_taylor_elsewhere_and_of_other_laws():
    e = 0.7
    slopes = np.array([1.5 * e**0.5, 0.75 * e**-0.5 / 2, -0.375 * e**-1.5 / 6])
    for got, want in (
        (taylor(Hertz(1.0, 1.0)), [1.5, 0.375, -0.0625]),
        (taylor(gx.Polynomial(1.1, -0.4, 0.3)), [1.1, -0.4, 0.3]),
        (taylor(Toda(2.0, 3.0)), [6, 9, 9]),
        (taylor(gx.Sine(2.0, 3.0)), [2, 0, -3]),
        (taylor(Hertz()), [0, 0, 0]),
        (taylor(Hertz(), e), slopes),
        (taylor(Hertz(np.array([1.0, 4.0])), e), slopes[:, None] * [1, 4]),
        # a spring k behind a contact of slope K: K k/(K + k)
        (taylor(gx.Yielding(Hertz(1.0, 1.0), 2.0)).K2, 1.5 * 2 / 3.5),
    ):
        assert_allclose(np.array(got), want, rtol=8 * EPS, atol=1e-300)


def test_taylor_takes_the_force_alone():
    class Table(gx.Law):
        def force(self, e):
            return 2 * jnp.tanh(e)

        def energy(self, e):
            return 2 * jnp.log(jnp.cosh(e))

        def derivative(self, e):
            return np.interp(e, [-1, 0, 1], [0.84, 2.0, 0.84])

    assert_allclose(np.array(taylor(Table(), 0.0)), [2, 0, -2 / 3], atol=1e-15)


def test_the_overlap_at_rest_loses_no_digit_in_another_unit():
    # XLA's cube root, x^(1/3), is off by five units in the last place at the one end and by one at the other
    F0 = np.linspace(0.3, 3.0, 12)
    powers = 64.0 ** np.arange(-30, 31, 10)
    at = [np.asarray(Hertz(1.0, F0 * unit).rest_overlap) for unit in powers]
    assert_array_equal(at, [16.0**k * at[3] for k in range(-30, 31, 10)])
    assert_allclose(at[3], np.cbrt(F0) ** 2, rtol=8e-16)


def test_closed_forms_of_the_smooth_laws():
    e = np.array([-30.0, -2.0, -1e-9, 1e-12, 0.3, 4.0])
    for got, want in (
        (Toda(0.8, 1.3).force, 0.8 * np.expm1(1.3 * e)),
        (gx.Sine(0.9, 1.7).force, 0.9 / 1.7 * np.sin(1.7 * e)),
        (gx.Polynomial(1.1, -0.4, 0.3).force, 1.1 * e - 0.4 * e**2 + 0.3 * e**3),
        (Linear(1.3).energy, 0.65 * e**2),
    ):
        assert_allclose(got(jnp.array(e)), want, rtol=4 * EPS)


def test_toda_energy_keeps_its_digits_near_rest():
    # (e^x - 1 - x), by its series; both sides of any switch of formula
    for x in 1e-9, -1e-6, 1e-3, 0.0199, 0.0201, -0.0199, -0.0201, 0.1:
        terms = np.cumprod(x / np.arange(1.0, 30))[1:]
        assert_allclose(Toda().energy(jnp.array(x)), sum(terms[::-1]), rtol=3e-14)


@pytest.mark.parametrize("exponent", [1.5, 1.37, 3.0, -3.0])
def test_energy_under_load_keeps_its_digits_near_rest(exponent):
    """A small wave on a precompressed chain: energy K2 e^2/2 + K3 e^3/3, force K2 e + K3 e^2."""
    law = PowerLaw(1.0, exponent, 1.0)
    K2, K3, _ = taylor(law)
    e = jnp.array([1e-4, -1e-5, 1e-6, 1e-7])
    assert_allclose(law.force(e), K2 * e + K3 * e * e, rtol=1e-7)
    assert_allclose(law.energy(e), K2 * e * e / 2 + K3 * e**3 / 3, rtol=1e-7)


@pytest.mark.parametrize("q", [0.0, 1e-13, -1e-10, 1e-7, 1e-3])
@SIDES
def test_the_energy_of_magnets_keeps_its_digits_near_the_inverse_law(q, kind):
    # work (d^-q - 1)/q over the gap d = 0.6 is -log(d) plus powers of q
    x = -np.log(0.6)
    want = x + q * x**2 / 2 + q**2 * x**3 / 6 + q**3 * x**4 / 24 - 0.4
    assert_allclose(
        PowerLaw(1.0, kind(-1 - q), 1.0).energy(0.4), want, rtol=1e-14, atol=abs(q) ** 4
    )


@pytest.mark.slow
def test_the_energy_of_magnets_differentiates_by_the_exponent_at_the_inverse_law():
    slope = lambda p: PowerLaw(1.0, p, 1.0).energy(0.4)
    for n in 1, 2, 3:
        slope = jax.grad(slope)
        want = (-1) ** n * (-np.log(0.6)) ** (n + 1) / (n + 1)
        assert_allclose([slope(-1.0), jax.jit(slope)(-1.0)], want, rtol=1e-14)
    # an open contact, whose exponent's sign is not known while traced
    open_too = jax.jit(jax.grad(lambda p: PowerLaw(1.0, p, 1.0).energy(-2.0)))
    assert_allclose(open_too(1.5), 1 / 2.5**2, rtol=1e-14)


def test_sum_and_scaled():
    a = Hertz(1.0, 0.3)
    b = PowerLaw(0.2, 2.5)
    c = Linear(0.4)
    e = jnp.array([-1.0, 0.0, 0.7])
    total = a + b + c
    twice = Scaled(a, 2.0)
    assert len(total.parts) == 3
    for law in (Scaled(total, 2.0, 3.0), gx.laws.Strained(total, 0.1)):
        assert len(law.parts) == 3 and len(gx.Yielding(law, 5.0).parts) == 1
        assert_ulps(sum(part.force(e) for part in law.parts), law.force(e), 8)
    assert_ulps(total.force(e), a.force(e) + b.force(e) + c.force(e), 4)
    assert_array_equal(total.overlap(e), np.minimum(a.overlap(e), b.overlap(e)))
    assert (c + c).overlap(e) is None
    assert_ulps(twice.force(e), 2 * a.force(e), 2)
    assert float(total.preload) == 0.3 and float(twice.preload) == 0.6


@pytest.mark.slow
@pytest.mark.parametrize(
    "law",
    [Hertz(1.7, 0.9), PowerLaw(1.0, 0.5), PowerLaw(1.0, -3.0, 1.0)],
    ids=["hertz", "softening", "magnets"],
)
def test_yielding_solves_its_equation(law):
    """x + F(x)/k = e: the bond's force is the contact's and the spring's, for supports soft and stiff."""
    e = np.array([-0.4, 0.05, 0.5, 1.5])
    A = float(law.stiffness)
    p = law.exponent
    F0 = float(law.preload)
    d0 = (F0 / A) ** (1 / p)
    yielding = eqx.filter_jit(lambda bond: bond.force(jnp.array(e)))
    for support in 1e-9, 1e-3, 0.1, 1.0, 1e3, 1e9, 1e15:
        f = np.asarray(yielding(gx.Yielding(law, jnp.asarray(support))))
        opened = f == -F0
        assert np.all(np.sign(p) * (e + F0 / support)[opened] <= -d0)
        x = np.sign(p) * (((f + F0) / A) ** (1 / p) - d0)
        # F0 is subtracted: its rounding stays
        atol = 16 * EPS * F0 / support
        assert_allclose((x + f / support)[~opened], e[~opened], rtol=1e-10, atol=atol)

    def force(support):
        return gx.Yielding(law, support).force(0.5)

    # dF/dk = F' F/(k^2 + k F') at the contact's own compression
    f, slope = jax.value_and_grad(force)(2.0)
    stiffness = jax.grad(law.force)(0.5 - f / 2)
    assert_allclose(slope, stiffness * f / (4 + 2 * stiffness), rtol=1e-12)


@pytest.mark.parametrize("p", [1.4, -2.3, 9.3, 1e-3])
def test_real_power_is_true_to_a_few_ulps_over_sixty_decades_and_at_the_ends(p):
    x = 10 ** np.random.default_rng(1).uniform(-30, 30, 500)
    exact = x.astype(np.longdouble) ** np.longdouble(p)
    error = np.abs(np.asarray(real_power(jnp.array(x), p)) / exact - 1).max()
    assert error < (2 + abs(p)) * EPS
    ends = np.array([0.0, np.inf, np.nan, 1.0, 1e300])
    with np.errstate(all="ignore"):
        assert_allclose(real_power(jnp.array(ends), p), ends**p, rtol=1e-14)


@pytest.mark.parametrize("by_products", [True, False])
def test_root_is_true_to_an_ulp_and_a_half(by_products, monkeypatch):
    monkeypatch.setattr("granjax.laws.real_power.root_by_products", lambda: by_products)
    x = 10 ** np.random.default_rng(3).uniform(-300, 300, 2000)
    exact = np.sqrt(x.astype(np.longdouble))
    error = np.abs(np.asarray(jax.jit(lambda x: root(x))(jnp.asarray(x))) / exact - 1)
    assert error.max() < 1.5 * EPS
    ends = jnp.asarray([0.0, jnp.inf, jnp.nan, 1.0])
    assert_array_equal(root(ends), jnp.sqrt(ends))
    assert root(jnp.ones(3, jnp.float32)).dtype == jnp.float32
