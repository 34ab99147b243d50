"""Splines as laws, and sparse regression: known coefficients, their errors, and terms that are missing."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import EPS
from numpy.testing import assert_allclose, assert_array_equal
from refusals import refused
from scipy.integrate import solve_ivp
from scipy.interpolate import BSpline

import granjax as gx
from granjax import Drag, ViscousContact
from granjax.fit.identify import library, regression
from granjax.laws import Scaled, Spline

N = 8
WALLS = gx.Shift(1, "fixed")
LIBRARY = library(WALLS)
BEADS = np.ones(N)
TIMES = np.linspace(0.0, 30.0, 301)

# ----------------------------------------------------------------------------------------------------- laws of any form

# one compilation a law, instead of one an operation
force, energy = (jax.jit(lambda law, e, f=f: getattr(law, f)(e)) for f in ("force", "energy"))

KNOTS = [-1.0, -0.3, 0.2, 0.5, 1.0]
STIFFNESS = [0.0, 0.7, 1.3, 1.1, 2.0, 1.4]


@pytest.mark.parametrize("knots", [KNOTS, [0.0, 0.2, 0.5, 1.0, 1.5], [-1.0, -0.7, -0.4, -0.1, 0.0]])
def test_a_spline_is_the_integral_of_b_splines(knots):
    """It agrees with SciPy's, and is linear beyond the knots; equilibrium may be the first knot or the last."""
    clamped = np.r_[[knots[0]] * 2, knots, [knots[-1]] * 2]
    stiffness = BSpline(clamped, STIFFNESS, 2)
    law = Spline(knots, STIFFNESS)
    integral = stiffness.antiderivative()
    work = integral.antiderivative()
    e = np.append(np.linspace(knots[0], knots[-1], 41), knots)
    assert_allclose(force(law, e), integral(e) - integral(0.0), rtol=0, atol=8 * EPS)
    want = work(e) - work(0.0) - integral(0.0) * e
    assert_allclose(energy(law, e), want, rtol=0, atol=8 * EPS)
    slope = jax.jit(jax.vmap(jax.grad(law.force)))
    assert_allclose(slope(e), stiffness(e), rtol=0, atol=16 * EPS)
    beyond = np.array([-4.0, -1.5, 1.7, 6.0])
    end = np.clip(beyond, knots[0], knots[-1])
    assert_allclose(slope(beyond), stiffness(end), rtol=0, atol=16 * EPS)
    want = integral(end) - integral(0.0) + stiffness(end) * (beyond - end)
    assert_allclose(force(law, beyond), want, rtol=16 * EPS, atol=8 * EPS)
    assert_array_equal(law.stiffness, STIFFNESS)


@pytest.mark.slow
def test_derivatives_in_the_coefficients_are_splines_of_one_coefficient_each():
    """In both modes, at knots, at rest and beyond the ends."""
    e = jnp.asarray([[-2.0], [-0.3], [0.0], [0.2], [0.7], [3.0]])
    both = jax.jit(lambda law: jnp.stack([law.force(e[:, 0]), law.energy(e[:, 0])]))
    single = Spline(KNOTS, np.eye(6))
    want = np.stack([single.force(e), single.energy(e)])
    for mode in (jax.jacfwd, jax.jacrev):
        found = jax.jit(mode(lambda k: both(Spline(KNOTS, k))))(jnp.asarray(STIFFNESS))
        assert_allclose(found, want, rtol=0, atol=1e-14)


# --------------------------------------------------------------------------------------------------- sparse regression


def regress(data, offered=LIBRARY, **how):
    """The regression of (ts, us, vs), or (ts, us, vs, accelerations), of beads of mass 1."""
    return regression(BEADS, {name: LIBRARY[name] for name in offered}, *data, **how)


NONE = lambda x: 0 * x


def motion(force, on_site=NONE, drag=NONE, u=0.5, v=0.5):
    """Times, displacements, velocities and accelerations of a chain between walls by DOP853."""

    def acceleration(y):
        u = np.concatenate([[0.0], y[:N], [0.0]])
        bonds = force(u[:-1] - u[1:])
        return bonds[:-1] - bonds[1:] - on_site(u[1:-1]) - drag(y[N:])

    rate = lambda t, y: np.concatenate([y[N:], acceleration(y)])
    start = np.repeat([u, v], N) * np.random.default_rng(3).normal(size=2 * N)
    ts = TIMES
    y = solve_ivp(rate, (0, 30.0), start, "DOP853", ts, rtol=1e-10, atol=1e-12).y.T
    return ts, y[:, :N], y[:, N:], np.array([acceleration(x) for x in y])


def _states(*terms, mass=BEADS):
    """Random states instead of a run, and the accelerations in them: a regression asks for no more."""
    u, v = 0.3 * np.random.default_rng(3).normal(size=(2, 200, N))
    states = np.arange(200) / 20, u, v
    return *states, np.asarray(jax.vmap(gx.Lattice(mass, terms).acceleration)(*states))


def _noisy(data, size, seed=0):
    """The same data with noise of a share of the rms acceleration."""
    *states, a = data
    noise = np.random.default_rng(seed).normal(size=a.shape)
    return *states, a + size * np.sqrt(np.mean(a**2)) * noise


@pytest.fixture(scope="module")
def fput():
    return motion(lambda e: e + 0.25 * e**2 + 0.6 * e**3, v=0.0)


@pytest.fixture(scope="module")
def hertz():
    return motion(lambda e: 1.3 * np.maximum(e, 0) ** 1.5, drag=lambda v: 0.05 * v, u=0.0, v=1.0)


def values(found):
    return [c.value for c in found.coefficients.values()]


def test_fput_from_clean_accelerations(fput):
    *_, us, vs, a = fput
    found = regress(fput, threshold=0.01)
    assert list(found.coefficients) == ["e", "e^2", "e^3"]
    assert_allclose(values(found), [1.0, 0.25, 0.6], rtol=0, atol=1e-12)
    assert set(found.dropped) == set(LIBRARY) - set(found.coefficients)
    assert found.r_squared > 1 - 1e-12
    assert_allclose(found.lattice.acceleration(0.0, us[7], vs[7]), a[7], rtol=0, atol=1e-11)


def test_fput_from_velocities_alone(fput):
    """What is left is the error of the spline, at fifteen frames a period; and with a thousandth of noise."""
    ts, us, vs, _ = fput
    found = regress((ts, us, vs), threshold=0.01)
    assert_allclose(values(found), [1.0, 0.25, 0.6], rtol=0, atol=2e-4)
    noise = 1e-3 * float(jnp.std(vs))
    seen = vs + noise * np.random.default_rng(0).normal(size=vs.shape)
    found = regress((ts, us, seen), noise=noise)
    assert_allclose(values(found), [1.0, 0.25, 0.6], rtol=0, atol=1e-3)


def test_hertz_and_damping_under_one_percent_of_noise(hertz):
    """Coefficients are within three of their standard errors, which are below 4e-4."""
    size = 0.01 * np.sqrt(np.mean(hertz[-1] ** 2))
    for seed in range(3):
        found = regress(_noisy(hertz, 0.01, seed))
        assert list(found.coefficients) == ["[e]_+^1.5", "v"], found.outcome
        errors = np.array([c.error for c in found.coefficients.values()])
        assert (np.abs(np.subtract(values(found), (1.3, 0.05))) < 3 * errors).all()
        assert (errors < 4e-4).all()
        assert_allclose(errors, np.sqrt(np.diag(found.covariance)), rtol=1e-12)
        assert found.to_xarray().attrs["coefficients_v_value"] == found.coefficients["v"].value
        assert_allclose(found.noise, size, rtol=0.05)


# the chain and what is offered for it: with the last candidate the library is right, without it it lacks a term
MISSING = {
    "odd potential": ([lambda e: e + 0.3 * e**3], ("e", "e^2", "v"), "e^3"),
    "contact": ([lambda e: np.maximum(e, 0) ** 1.5], ("e", "e^2", "e^3"), "[e]_+^1.5"),
    "on site": ([lambda e: e, lambda u: 0.3 * u + 0.5 * u**3], ("e", "u"), "u^3"),
    "drag": ([lambda e: e, NONE, lambda v: 0.1 * v * np.abs(v)], ("e", "v"), "v|v|"),
}


@pytest.mark.parametrize("case", MISSING)
def test_a_residue_beyond_noise_is_said(case):
    """Of exact data, under 1 % of noise, and from velocities alone; never where nothing is missing."""
    forces, offered, last = MISSING[case]
    exact = motion(*forces)
    for seen in (exact, _noisy(exact, 0.01), exact[:3])[: 2 if case == "contact" else 3]:
        found = regress(seen, offered, threshold=0.002)
        assert "A residue beyond noise is left" in found.outcome
        said = float(found.outcome.split("is left, ")[1].split(" %")[0]) / 100
        if seen is exact:
            # of exact data it is all that is left
            left = found.noise / np.sqrt(np.mean(exact[-1] ** 2))
            assert 0.7 * left < said < 1.02 * left
        found = regress(seen, (*offered, last), threshold=0.002)
        assert "residue" not in found.outcome, found.outcome


@pytest.mark.parametrize(
    "missing, offered", [(gx.OnSite(gx.Polynomial(0.3, 0.0, 0.5)), "eu"), (Drag(0.1), "ev")]
)
def test_a_residue_in_random_states_is_said(missing, offered):
    """What follows no time: states that are alike have alike residues."""
    data = _states(gx.Bond(WALLS, gx.Linear()), missing)
    assert "A residue beyond noise" in regress(data, offered).outcome
    assert "residue" not in regress(data, (*offered, "u^3", "v|v|")).outcome


@pytest.mark.slow
def test_noise_alone_is_no_residue(fput):
    ts, us, vs, a = fput
    seen = [_noisy(fput, size, seed) for seed in range(5) for size in (1e-6, 0.1)]
    assert not any("residue" in regress(data).outcome for data in seen)
    # smoothed velocities have errors that are alike, and displacements errors of their own
    rng = np.random.default_rng(0)
    for share in (1e-3, 1e-2):
        noise = share * float(jnp.std(vs))
        velocities = vs + noise * rng.normal(size=vs.shape)
        places = us + share * float(jnp.std(us)) * rng.normal(size=us.shape)
        assert "residue" not in regress((ts, us, velocities), noise=noise).outcome
        assert "residue" not in regress((ts, places, vs, a)).outcome


def test_error_bars_are_those_of_repeated_noise(hertz):
    short = [x[:40] for x in hertz]
    two = ("[e]_+^1.5", "v")
    found = [regress(_noisy(short, 0.01, seed), two) for seed in range(60)]
    spread = np.std([values(f) for f in found], axis=0)
    # of sixty draws the standard deviation is known to 9 %
    assert_allclose([c.error for c in found[0].coefficients.values()], spread, rtol=0.3)


@pytest.mark.parametrize(
    "name, true, term",
    [
        ("v", 0.03, gx.Damping(0.03)),
        ("de/dt", 0.03, gx.Dashpot(WALLS, 0.03)),
        ("v|v|", 0.1, Drag(0.1)),
        ("[e]_+^0.5 de/dt", 0.03, ViscousContact(WALLS, 0.03, overlap=1.0)),
    ],
)
def test_one_kind_of_dissipation_is_told_from_the_others(name, true, term):
    data = _noisy(_states(gx.Bond(WALLS, gx.Hertz(1.0, 1.0)), term), 0.001)
    offered = library(WALLS, powers=(), overlap=1.0)
    found = regression(BEADS, offered, *data, threshold=0.005)
    assert list(found.coefficients) == ["[e]_+^1.5", name], found.outcome
    value, error, _ = found.coefficients[name]
    assert abs(value - true) < 4 * error < 0.05 * true


def test_a_file_names_the_terms_in_the_order_of_their_covariance(hertz):
    offered = {"stiffness": LIBRARY["[e]_+^1.5"], "damping": LIBRARY["v"]}
    found = regression(BEADS, offered, *_noisy(hertz, 0.01))
    data = found.to_xarray()
    assert data.term.values.tolist() == ["stiffness", "damping"]
    assert "(stiffness, damping)" in found.outcome
    for name, width in zip(data.term.values, np.sqrt(np.diag(data.covariance))):
        assert_allclose(width, data.attrs[f"coefficients_{name}_error"], rtol=1e-12)


def test_masses_and_known_terms():
    mass = np.linspace(0.5, 1.5, N)
    drive = gx.Drive(gx.Harmonic(0.2, 1.1), 2)
    data = _states(gx.Bond(WALLS, gx.Toda()), gx.OnSite(gx.Linear(0.4)), drive, mass=mass)
    offered = {"toda": lambda k: gx.Bond(WALLS, Scaled(gx.Toda(), k))} | library(WALLS, powers=())
    found = regression(mass, offered, *data, known=drive)
    assert list(found.coefficients) == ["toda", "u"], found.outcome
    assert_allclose(values(found), [1.0, 0.4], rtol=0, atol=1e-12)
    assert found.lattice.terms[-1] is drive


def test_a_sign_that_a_term_refuses_is_said():
    ts, u, v, a = _states(gx.Bond(WALLS, gx.Linear()))
    found = regress((ts, u, v, a + 0.2 * v))
    assert_allclose(found.coefficients["v"].value, -0.2, rtol=1e-10)
    assert found.lattice is None and "The sign found for v" in found.outcome


def test_terms_that_stand_for_each_other_are_said():
    data = _states(gx.Bond(WALLS, gx.Polynomial(1.0, 5e-9)))
    other = lambda k: gx.Bond(WALLS, Scaled(gx.Polynomial(1.0, 1e-8), k))
    found = regression(BEADS, {"one": LIBRARY["e"], "other": other}, *data)
    assert found.condition > 1e6 and "stand for each other" in found.outcome


@pytest.mark.slow
def test_one_mass_is_that_of_all_sites(fput):
    ones = regress(fput, threshold=0.01)
    found = regression(1.0, LIBRARY, *fput, threshold=0.01)
    assert_allclose(values(found), values(ones), rtol=1e-12)
    assert found.lattice.shape == (N,)


def test_a_regression_agrees_with_pysindy(hertz):
    ps = pytest.importorskip("pysindy")
    *states, a = data = _noisy(hertz, 0.01)
    alone = [gx.Lattice(BEADS, make(1.0)).acceleration for make in LIBRARY.values()]
    columns = np.stack([np.ravel(jax.vmap(each)(*states)) for each in alone], -1)
    for threshold, ridge in ((0.02, 0.0), (0.02, 0.05), (0.2, 0.01)):
        theirs = ps.STLSQ(threshold * np.linalg.norm(a), alpha=ridge, normalize_columns=True)
        theirs.fit(columns, a.ravel())
        found = regress(data, threshold=threshold, ridge=ridge).coefficients
        ours = [found[name].value if name in found else 0.0 for name in LIBRARY]
        assert_allclose(ours, theirs.coef_[0], rtol=0, atol=1e-10)


@pytest.mark.parametrize(
    "bad, word",
    [
        (dict(threshold=0.999), "Lower it"),
        (dict(threshold=-1.0), "threshold"),
        (dict(accelerations=np.zeros((5, N))), "accelerations"),
        (dict(accelerations=None), "twelve times"),
        (dict(candidates={"v": LIBRARY["v"]}, vs=np.zeros((5, N))), "Leave it out"),
    ],
)
def test_a_regression_refuses_bad_input(bad, word):
    x = np.random.default_rng(0).normal(size=(5, N))
    data = dict(ts=np.arange(5.0), us=x, vs=x, accelerations=x)
    good = dict(mass=BEADS, candidates={"e": LIBRARY["e"]}, **data)
    with refused(word):
        regression(**(good | bad))


@pytest.mark.parametrize(
    "make, word",
    [
        (lambda: Spline([0.1, 1.0], [1, 1, 1]), "knots"),
        (lambda: Spline([-1, -1, 1], [1] * 4), "knots"),
        (lambda: Spline([-1, 1], [1, 1]), "3 numbers"),
        (lambda: Spline([-1, 1], [1, -1, 1]), "stiffness"),
        (lambda: library(WALLS, powers=(4,)), "powers"),
        (lambda: library(WALLS, dissipation=("w",)), "dissipation"),
    ],
)
def test_what_cannot_be_is_refused(make, word):
    with refused(word):
        make()
