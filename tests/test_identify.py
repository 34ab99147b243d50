import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import EPS
from refusals import refused
from scipy.integrate import solve_ivp
from scipy.interpolate import BSpline
from scipy.optimize import nnls

import granjax as gx
from granjax import Drag, ViscousContact
from granjax.fit.identify import library, regression
from granjax.laws import Scaled, Spline

N = 8
WALLS = gx.Shift(1, "fixed")
LIBRARY = library(WALLS)

# ----------------------------------------------------------------------------------------------------- laws of any form

# one compilation a law, instead of one an operation
force, energy = (jax.jit(lambda law, e, f=f: getattr(law, f)(e)) for f in ("force", "energy"))

KNOTS = [-1.0, -0.3, 0.2, 0.5, 1.0]
STIFFNESS = [0.0, 0.7, 1.3, 1.1, 2.0, 1.4]


def test_spline_is_the_integral_of_b_splines():
    clamped = np.r_[[KNOTS[0]] * 2, KNOTS, [KNOTS[-1]] * 2]
    stiffness = BSpline(clamped, STIFFNESS, 2)
    integral, law = stiffness.antiderivative(), Spline(KNOTS, STIFFNESS)
    e = np.append(np.linspace(-1, 1, 41), KNOTS)
    np.testing.assert_allclose(force(law, e), integral(e) - integral(0.0), rtol=0, atol=8 * EPS)
    work = integral.antiderivative()
    np.testing.assert_allclose(
        energy(law, e), work(e) - work(0.0) - integral(0.0) * e, rtol=0, atol=8 * EPS
    )
    slope = jax.jit(jax.vmap(jax.grad(law.force)))
    np.testing.assert_allclose(slope(e), stiffness(e), rtol=0, atol=16 * EPS)
    beyond = np.array([-4.0, -1.5, 1.2, 6.0])
    np.testing.assert_allclose(slope(beyond), [0.0, 0.0, 1.4, 1.4], rtol=0, atol=16 * EPS)
    np.testing.assert_array_equal(law.stiffness, STIFFNESS)


@pytest.mark.parametrize("knots", [[0.0, 1.0, 2.0], [-2.0, -1.0, 0.0]])
def test_equilibrium_may_be_an_end_of_the_knots(knots):
    law = Spline(knots, [1.0, 2.0, 3.0, 4.0])
    inside, outside = (1, -1) if knots[0] == 0 else (-1, 1)
    np.testing.assert_allclose(
        force(law, 0.5 * outside), 0.5 * outside * (1.0 if outside < 0 else 4.0), rtol=4 * EPS
    )
    # the integral of every B-spline is a third of its knots' extent
    total = (1 * 1 + 2 * 2 + 3 * 2 + 4 * 1) / 3
    np.testing.assert_allclose(force(law, 2.0 * inside), inside * total, rtol=4 * EPS)


def test_spline_of_equal_coefficients_is_linear():
    e = jnp.linspace(-3, 3, 50)
    np.testing.assert_allclose(
        force(Spline(KNOTS, [1.3] * 6), e), gx.Linear(1.3).force(e), rtol=16 * EPS
    )
    np.testing.assert_allclose(
        energy(Spline(KNOTS, [1.3] * 6), e), gx.Linear(1.3).energy(e), rtol=16 * EPS
    )


def test_a_fitted_spline_is_hertz():
    """Nine knots follow a contact under load to 4e-4 of its largest force, and never fall."""
    law, e, knots = gx.Hertz(1.0, 1.0), np.linspace(-0.8, 1.5, 200), np.linspace(-0.8, 1.5, 9)
    columns = np.asarray(Spline(knots, np.eye(10)).force(jnp.asarray(e)[:, None]))
    fitted = lambda values: Spline(knots, nnls(columns, np.asarray(values))[0])
    found = fitted(force(law, e))
    assert np.abs(force(found, e) - force(law, e)).max() < 4e-4 * force(law, 1.5)
    noisy = force(law, e) + 0.3 * np.random.default_rng(0).normal(size=200)
    assert (np.diff(fitted(noisy).force(np.linspace(-2, 3, 400))) >= -EPS).all()


@pytest.mark.parametrize(
    "make, word",
    [
        (lambda: Spline([0.1, 1.0], [1, 1, 1]), "knots"),
        (lambda: Spline([-1, -1, 1], [1] * 4), "knots"),
        (lambda: Spline([-1, 1], [1, 1]), "3 numbers"),
        (lambda: Spline([-1, 1], [1, -1, 1]), "stiffness"),
    ],
)
def test_laws_that_cannot_be_are_refused(make, word):
    with refused(word):
        make()


@pytest.mark.slow
def test_derivatives_in_the_parameters():
    """Both modes, at knots, at rest and beyond the ends, against differences."""
    e, h = jnp.asarray([-2.0, -0.3, 0.0, 0.2, 0.7, 3.0]), 1e-6
    start = jnp.asarray(STIFFNESS[1:] + [1.0])
    make = lambda k: Spline(KNOTS, k)
    both = jax.jit(lambda p: jnp.stack([make(p).force(e), make(p).energy(e)]))
    forward, reverse = jax.jit(jax.jacfwd(both))(start), jax.jit(jax.jacrev(both))(start)
    np.testing.assert_allclose(forward, reverse, rtol=0, atol=1e-14)
    differences = [
        (both(start + h * i) - both(start - h * i)) / (2 * h) for i in np.eye(len(start))
    ]
    np.testing.assert_allclose(forward, np.stack(differences, -1), rtol=0, atol=1e-8)


@pytest.mark.study
def test_a_chain_of_them_runs_and_has_modes():
    law = Spline(KNOTS, STIFFNESS)
    chain = gx.Lattice(np.ones(N), (gx.Bond(WALLS, law),))
    run = gx.simulate(chain, gx.states.impact(chain, velocity=0.3), 20.0)
    assert run.completed and float(run.energy_error) < 1e-5
    k = float(jax.grad(law.force)(0.0))
    want = 2 * np.sqrt(k) * np.sin(np.pi * np.arange(1, N + 1) / (2 * N + 2))
    np.testing.assert_allclose(gx.linear.normal_modes(chain).omega, want, rtol=1e-12)


# --------------------------------------------------------------------------------------------------- sparse regression


def _record(*terms, u=0.0, v=0.0):
    """The run of a chain from a random state, and its accelerations."""
    chain = gx.Lattice(np.ones(N), terms)
    rng = np.random.default_rng(3)
    state = gx.State(jnp.asarray(u * rng.normal(size=N)), jnp.asarray(v * rng.normal(size=N)))
    run = gx.simulate(chain, state, 30.0, save_at=301, step=0.01)
    return run, np.asarray(jax.vmap(chain.acceleration)(run.ts, run.us, run.vs))


def _states(*terms, u=0.3, v=0.3, mass=np.ones(N)):
    """Random states (ts, us, vs) instead of a run, and the accelerations in them: a regression asks for no more."""
    rng = np.random.default_rng(3)
    states = np.arange(200) / 20, u * rng.normal(size=(200, N)), v * rng.normal(size=(200, N))
    return states, np.asarray(jax.vmap(gx.Lattice(mass, terms).acceleration)(*states))


def _noisy(a, size, seed=0):
    return a + size * np.sqrt(np.mean(a**2)) * np.random.default_rng(seed).normal(size=a.shape)


@pytest.fixture(scope="module")
def fput():
    return _record(gx.Bond(WALLS, gx.Polynomial(1.0, 0.25, 0.6)), u=0.5)


@pytest.fixture(scope="module")
def hertz():
    return _record(gx.Bond(WALLS, gx.Hertz(1.3)), gx.Damping(0.05), v=1.0)


def values(found):
    return {name: c.value for name, c in found.coefficients.items()}


def test_fput_from_clean_accelerations(fput):
    run, a = fput
    found = regression(np.ones(N), LIBRARY, run.ts, run.us, run.vs, a, threshold=0.01)
    assert list(found.coefficients) == ["e", "e^2", "e^3"]
    np.testing.assert_allclose(list(values(found).values()), [1.0, 0.25, 0.6], rtol=0, atol=1e-12)
    assert (
        set(found.dropped) == set(LIBRARY) - set(found.coefficients) and found.r_squared > 1 - 1e-12
    )
    np.testing.assert_allclose(
        found.lattice.acceleration(0.0, run.us[7], run.vs[7]), a[7], rtol=0, atol=1e-11
    )


def test_fput_from_velocities_alone(fput):
    """What is left is the error of the spline, at fifteen frames a period; and with a thousandth of noise."""
    run, _ = fput
    found = regression(np.ones(N), LIBRARY, run.ts, run.us, run.vs, threshold=0.01)
    np.testing.assert_allclose(list(values(found).values()), [1.0, 0.25, 0.6], rtol=0, atol=2e-4)
    noise = 1e-3 * float(jnp.std(run.vs))
    seen = run.vs + noise * np.random.default_rng(0).normal(size=run.vs.shape)
    found = regression(np.ones(N), LIBRARY, run.ts, run.us, seen, noise=noise)
    np.testing.assert_allclose(list(values(found).values()), [1.0, 0.25, 0.6], rtol=0, atol=1e-3)


def test_hertz_and_damping_under_one_percent_of_noise(hertz):
    """Coefficients within three of their standard errors, which are below 4e-4."""
    run, a = hertz
    for seed in range(3):
        found = regression(np.ones(N), LIBRARY, run.ts, run.us, run.vs, _noisy(a, 0.01, seed))
        assert list(found.coefficients) == ["[e]_+^1.5", "v"], found.outcome
        for (value, error, _), true in zip(found.coefficients.values(), (1.3, 0.05)):
            assert abs(value - true) < 3 * error
        errors = [c.error for c in found.coefficients.values()]
        np.testing.assert_allclose(errors, np.sqrt(np.diag(found.covariance)), rtol=1e-12)
        assert errors[0] < 4e-4 and errors[1] < 4e-4
        assert found.to_xarray().attrs["coefficients_v_value"] == found.coefficients["v"].value
        np.testing.assert_allclose(found.noise, 0.01 * np.sqrt(np.mean(a**2)), rtol=0.05)


def _exact(times, force, on_site, drag):
    """Times, displacements, velocities and accelerations of a chain between walls by DOP853."""

    def acceleration(u, v):
        u = np.concatenate([[0.0], u, [0.0]])
        bonds = force(u[:-1] - u[1:])
        return bonds[:-1] - bonds[1:] - on_site(u[1:-1]) - drag(v)

    rate = lambda t, y: np.concatenate([y[N:], acceleration(y[:N], y[N:])])
    start = 0.5 * np.random.default_rng(3).normal(size=2 * N)
    y = solve_ivp(rate, (0, times[-1]), start, "DOP853", times, rtol=1e-10, atol=1e-12).y.T
    return times, y[:, :N], y[:, N:], np.array([acceleration(x[:N], x[N:]) for x in y])


NONE = lambda x: 0 * x
# the chain and what is offered for it: with the last candidates the library is right, without them it lacks a term
MISSING = {
    "cubic": ((lambda e: e + 0.25 * e**2 + 0.6 * e**3, NONE, NONE), ("e", "e^2"), ("e^3",)),
    "quadratic": ((lambda e: e + 0.1 * e**2, NONE, NONE), ("e", "e^3", "u", "v"), ("e^2",)),
    "odd potential": ((lambda e: e + 0.3 * e**3, NONE, NONE), ("e", "e^2", "v"), ("e^3",)),
    "contact": (
        (lambda e: np.maximum(e, 0) ** 1.5, NONE, NONE),
        ("e", "e^2", "e^3"),
        ("[e]_+^1.5",),
    ),
    "on site": ((lambda e: e, lambda u: 0.3 * u + 0.5 * u**3, NONE), ("e", "u"), ("u^3",)),
    "drag": ((lambda e: e, NONE, lambda v: 0.1 * v * np.abs(v)), ("e", "v"), ("v|v|",)),
}


@pytest.mark.parametrize("case", MISSING)
def test_a_residue_beyond_noise_is_said(case):
    """Of exact data, under 1 % of noise, and from velocities alone; never where nothing is missing."""
    made, offered, rest = MISSING[case]
    ts, us, vs, a = _exact(np.linspace(0.0, 30.0, 301), *made)
    wrong, right = ({name: LIBRARY[name] for name in names} for names in (offered, offered + rest))
    for seen in (a, _noisy(a, 0.01), None) if case != "contact" else (a, _noisy(a, 0.01)):
        found = regression(np.ones(N), wrong, ts, us, vs, seen, threshold=0.002)
        assert "A residue beyond noise is left" in found.outcome
        said = float(found.outcome.split("is left, ")[1].split(" %")[0]) / 100
        if seen is a:
            # of exact data it is all that is left
            left = found.noise / np.sqrt(np.mean(a**2))
            assert 0.7 * left < said < 1.02 * left
        found = regression(np.ones(N), right, ts, us, vs, seen, threshold=0.002)
        assert "residue" not in found.outcome, found.outcome


def test_a_residue_in_random_states_is_said():
    """What follows no time: states that are alike have alike residues."""
    for missing, offered in (
        (gx.OnSite(gx.Polynomial(0.3, 0.0, 0.5)), ("e", "u")),
        (Drag(0.1), ("e", "v")),
    ):
        states, a = _states(gx.Bond(WALLS, gx.Linear()), missing)
        found = regression(np.ones(N), {name: LIBRARY[name] for name in offered}, *states, a)
        assert "A residue beyond noise" in found.outcome
        found = regression(
            np.ones(N), {name: LIBRARY[name] for name in (*offered, "u^3", "v|v|")}, *states, a
        )
        assert "residue" not in found.outcome


@pytest.mark.slow
def test_noise_alone_is_no_residue(fput):
    run, a = fput
    said = [
        regression(np.ones(N), LIBRARY, run.ts, run.us, run.vs, _noisy(a, size, seed)).outcome
        for seed in range(15)
        for size in (1e-6, 0.1)
    ]
    assert not any("residue" in outcome for outcome in said)
    # smoothed velocities have errors that are alike, and displacements errors of their own
    rng = np.random.default_rng(0)
    for share in (1e-3, 1e-2):
        noise = share * float(jnp.std(run.vs))
        seen = run.vs + noise * rng.normal(size=run.vs.shape)
        places = run.us + share * float(jnp.std(run.us)) * rng.normal(size=run.us.shape)
        assert (
            "residue"
            not in regression(np.ones(N), LIBRARY, run.ts, run.us, seen, noise=noise).outcome
        )
        assert "residue" not in regression(np.ones(N), LIBRARY, run.ts, places, run.vs, a).outcome


def test_error_bars_are_those_of_repeated_noise(hertz):
    run, a = hertz
    two = {name: LIBRARY[name] for name in ("[e]_+^1.5", "v")}
    found = [
        regression(
            np.ones(N), two, run.ts[:40], run.us[:40], run.vs[:40], _noisy(a[:40], 0.01, seed)
        )
        for seed in range(60)
    ]
    spread = np.std([list(values(f).values()) for f in found], axis=0)
    # of sixty draws the standard deviation is known to 9 %
    np.testing.assert_allclose([c.error for c in found[0].coefficients.values()], spread, rtol=0.3)


@pytest.mark.parametrize(
    "name, term",
    [
        ("v", gx.Damping(0.03)),
        ("de/dt", gx.Dashpot(WALLS, 0.03)),
        ("v|v|", Drag(0.1)),
        ("[e]_+^0.5 de/dt", ViscousContact(WALLS, 0.03, overlap=1.0)),
    ],
    ids=["damping", "dashpot", "drag", "viscous_contact"],
)
def test_one_kind_of_dissipation_is_told_from_the_others(name, term):
    states, a = _states(gx.Bond(WALLS, gx.Hertz(1.0, 1.0)), term)
    offered = library(WALLS, powers=(), overlap=1.0)
    found = regression(np.ones(N), offered, *states, _noisy(a, 0.001), threshold=0.005)
    assert list(found.coefficients) == ["[e]_+^1.5", name], found.outcome
    value, error, _ = found.coefficients[name]
    true = getattr(term, "rate", getattr(term, "coefficient", None))
    assert abs(value - true) < 4 * error < 0.05 * true


def test_masses_and_known_terms():
    mass = np.linspace(0.5, 1.5, N)
    drive = gx.Drive(gx.Harmonic(0.2, 1.1), 2)
    states, a = _states(gx.Bond(WALLS, gx.Toda()), gx.OnSite(gx.Linear(0.4)), drive, mass=mass)
    offered = {"toda": lambda k: gx.Bond(WALLS, Scaled(gx.Toda(), k))} | library(WALLS, powers=())
    found = regression(mass, offered, *states, a, known=drive)
    assert list(found.coefficients) == ["toda", "u"], found.outcome
    np.testing.assert_allclose(list(values(found).values()), [1.0, 0.4], rtol=0, atol=1e-12)
    assert found.lattice.terms[-1] is drive


def test_a_sign_that_a_term_refuses_is_said():
    states, a = _states(gx.Bond(WALLS, gx.Linear()))
    found = regression(np.ones(N), LIBRARY, *states, a + 0.2 * states[2])
    np.testing.assert_allclose(found.coefficients["v"].value, -0.2, rtol=1e-10)
    assert found.lattice is None and "The sign found for v" in found.outcome


def test_terms_that_stand_for_each_other_are_said():
    states, a = _states(gx.Bond(WALLS, gx.Polynomial(1.0, 5e-9)))
    twins = {
        "one": LIBRARY["e"],
        "other": lambda k: gx.Bond(WALLS, Scaled(gx.Polynomial(1.0, 1e-8), k)),
    }
    found = regression(np.ones(N), twins, *states, a)
    assert found.condition > 1e6 and "stand for each other" in found.outcome


def test_agrees_with_pysindy(hertz):
    ps = pytest.importorskip("pysindy")
    run, a = hertz
    noisy = _noisy(a, 0.01)
    columns = np.stack(
        [
            np.asarray(
                jax.vmap(gx.Lattice(np.ones(N), (make(1.0),)).acceleration)(run.ts, run.us, run.vs)
            ).ravel()
            for make in LIBRARY.values()
        ],
        -1,
    )
    for threshold, ridge in ((0.02, 0.0), (0.02, 0.05), (0.2, 0.01)):
        theirs = ps.STLSQ(threshold * np.linalg.norm(noisy), alpha=ridge, normalize_columns=True)
        theirs.fit(columns, noisy.ravel())
        found = regression(
            np.ones(N), LIBRARY, run.ts, run.us, run.vs, noisy, threshold=threshold, ridge=ridge
        )
        ours = [values(found).get(name, 0.0) for name in LIBRARY]
        np.testing.assert_allclose(ours, theirs.coef_[0], rtol=0, atol=1e-10)


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
def test_bad_input_is_refused(bad, word):
    x = np.random.default_rng(0).normal(size=(5, N))
    good = dict(
        mass=np.ones(N),
        candidates={"e": LIBRARY["e"]},
        ts=np.arange(5.0),
        us=x,
        vs=x,
        accelerations=x,
    )
    with refused(word):
        regression(**(good | bad))


def test_a_library_refuses_what_it_does_not_hold():
    with refused("powers"):
        library(WALLS, powers=(4,))
    with refused("dissipation"):
        library(WALLS, dissipation=("w",))
