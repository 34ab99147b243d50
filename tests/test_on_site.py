"""Chains with a force on every site, against the closed forms of the continuum and of single oscillators."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from refusals import refused
from scipy.integrate import solve_ivp
from scipy.optimize import root

import granjax as gx

RNG = np.random.default_rng(5)


def test_the_equations_of_motion():
    u = RNG.standard_normal(6)
    left, right = np.diff(u, prepend=u[0]), np.diff(u, append=u[-1])
    n = np.arange(1.0, 7.0)
    k, L = 0.3 + 0.1 * n, 2.0 + 0.1 * n

    def force(lattice):
        return lattice.force(0.0, jnp.asarray(u), jnp.zeros(6))

    contacts = np.maximum(-left, 0) ** 1.5 - np.maximum(-right, 0) ** 1.5
    np.testing.assert_allclose(force(gx.scenes.cradle(6, pendulum=k)), contacts - k * u, atol=1e-14)
    np.testing.assert_allclose(
        force(gx.scenes.cradle(6, pendulum=k, length=L)),
        contacts - k * L * np.sin(u / L),
        atol=1e-14,
    )
    np.testing.assert_allclose(
        force(gx.scenes.klein_gordon(6, 0.3)), 0.3 * (right - left) - u - u**3, atol=1e-14
    )
    own = gx.scenes.klein_gordon(6, 0.3, law=gx.Toda(0.5, 2.0))
    np.testing.assert_allclose(force(own), 0.3 * (right - left) - 0.5 * np.expm1(2 * u), atol=1e-14)
    np.testing.assert_allclose(
        force(gx.scenes.sine_gordon(6, 0.3, wavenumber=2.0)),
        0.3 * (right - left) - np.sin(2 * u) / 2,
        atol=1e-14,
    )


def test_bands():
    k = np.linspace(-np.pi, np.pi, 7)
    for lattice in (
        gx.scenes.klein_gordon(9, 0.2, stiffness=1.3),
        gx.scenes.sine_gordon(9, 0.2, stiffness=1.3),
    ):
        omega = gx.linear.dispersion(lattice, k).omega[:, 0]
        np.testing.assert_allclose(omega**2, 1.3 + 0.8 * np.sin(k / 2) ** 2, rtol=1e-14)
    flat = gx.linear.dispersion(gx.scenes.cradle(9, pendulum=1.7), k).omega[:, 0]
    np.testing.assert_allclose(flat**2, 1.7, rtol=1e-15)


def test_numbers_of_sites_and_springs_are_lanes_and_are_refused():
    batch = jax.vmap(lambda c: gx.scenes.klein_gordon(5, c), out_axes=-1)(jnp.linspace(0.0, 1.0, 3))
    u = jnp.asarray(RNG.standard_normal(5))
    lanes = jnp.tile(u[:, None], 3)
    together = batch.force(0.0, lanes, 0 * lanes)
    for i, c in enumerate((0.0, 0.5, 1.0)):
        one = gx.scenes.klein_gordon(5, c).force(0.0, u, 0 * u)
        np.testing.assert_allclose(together[:, i], one, rtol=1e-14, atol=1e-15)
    for make, words in (
        (lambda: gx.scenes.klein_gordon(7, beta=np.ones(6)), r"K4: .*one per site, shape \(7,\)"),
        (lambda: gx.scenes.klein_gordon(7, alpha=1.0, law=gx.Sine()), "law"),
        (
            lambda: gx.scenes.sine_gordon(5, np.ones(5)),
            r"stiffness: .*one per contact, shape \(4,\)",
        ),
    ):
        with refused(words):
            make()


def sites_at(h, half):
    return h * np.arange(-round(half / h), round(half / h) + 1)


def test_a_sine_gordon_kink_has_the_energy_8():
    def excess(h, speed=0.6):
        x, g = sites_at(h, 20.0), (1 - speed**2) ** -0.5
        lattice = gx.scenes.sine_gordon(len(x), 1 / h**2)
        u, v = 4 * np.arctan(np.exp(g * x)), -2 * speed * g / np.cosh(g * x)
        return float(lattice.energy(0.0, jnp.asarray(u), jnp.asarray(v))) * h - 8 * g

    coarse, fine = excess(0.2), excess(0.1)
    assert abs(fine) < 0.01 and coarse / fine == pytest.approx(4, rel=0.03)


def breather_after_50_periods(h, w=0.9):
    x, s = sites_at(h, 45.0), np.sqrt(1 - w * w)
    lattice = gx.scenes.sine_gordon(len(x), 1 / h**2)

    def exact(t):
        return 4 * np.arctan(s / w * np.cos(w * t) / np.cosh(s * x))

    # a quarter of a period later: a phase that is late shows in first order
    t1 = 50.25 * 2 * np.pi / w
    run = gx.simulate(lattice, gx.State(jnp.asarray(exact(0.0)), jnp.zeros(len(x))), t1)
    return float(np.max(np.abs(run.final.u - exact(t1))))


@pytest.mark.study
def test_a_sine_gordon_breather_after_50_periods_is_off_by_h_squared():
    errors = [breather_after_50_periods(h) for h in (0.2, 0.1, 0.05)]
    assert errors[0] < 0.1
    np.testing.assert_allclose(np.divide(errors[:-1], errors[1:]), 4, rtol=0.01)


OMEGA = 1.4


def hard(c):
    return gx.scenes.klein_gordon(9, c)


@pytest.fixture(scope="module")
def over_coupling():
    return gx.breathers.anticontinuous(hard, 0.1, OMEGA)


def shot(c, u, omega=OMEGA):
    """Displacements at rest of the phi^4 chain's orbit, by SciPy alone, half a period at a time."""
    n = len(u)

    def rates(t, y):
        x = y[:n]
        ends = np.pad(x, 1, mode="edge")
        return np.concatenate([y[n:], c * (ends[2:] - 2 * x + ends[:-2]) - x - x**3])

    def later(u):
        half = solve_ivp(
            rates, (0, np.pi / omega), np.concatenate([u, 0 * u]), "DOP853", rtol=1e-13, atol=1e-14
        )
        return half.y[n:, -1]

    return root(later, u, tol=1e-13).x


def phi4_energy(c, u):
    return np.sum(u**2 / 2 + u**4 / 4) + c / 2 * np.sum(np.diff(u) ** 2)


@pytest.mark.study
def test_breathers_from_no_coupling_to_a_tenth(over_coupling):
    br = over_coupling
    assert br.outcome == "p reached 0.1." and br.p[0] == 0 and br.p[-1] == 0.1 and len(br) > 4
    np.testing.assert_allclose(br.omega, OMEGA, rtol=1e-15)
    u = np.zeros(9)
    u[4] = br.u[0, 4]
    for c in (0.0, 0.05, 0.1):
        u = shot(c, u)
        if c == 0:
            np.testing.assert_allclose(br.u[0], u, atol=1e-9)
    np.testing.assert_allclose(br.u[-1], u, atol=1e-9)
    assert abs(br.energy[-1] - phi4_energy(0.1, u)) < 1e-9 and br.energy_error[-1] < 1e-9
    # tails alternate as the wave above the band does
    assert np.all(br.verdict == "stable") and np.all(np.diff(np.sign(br.u[-1])) != 0)
    assert gx.breathers.localisation(hard(0.1), br.orbit(-1).state).participation < 1.3


@pytest.mark.slow
def test_and_at_the_energy_that_it_had_without(over_coupling):
    br = over_coupling
    found = gx.breathers.breather(hard(0.1), OMEGA, br.orbit(-1), energy=br.energy[0])
    u = shot(0.1, np.asarray(found.state.u), float(found.omega))
    np.testing.assert_allclose(found.state.u, u, atol=1e-9)
    assert abs(phi4_energy(0.1, u) - br.energy[0]) < 1e-9 and found.omega > OMEGA + 0.01


@pytest.mark.slow
def test_what_is_no_breather_is_not_on_the_branch():
    uneven = lambda c: gx.scenes.klein_gordon(9, c, law=gx.Polynomial(1.0, -0.1, -1.0))
    br = gx.breathers.anticontinuous(uneven, 1.0, 0.8, stability=False)
    # 2 omega enters the band, 1 <= omega^2 <= 1 + 4 c, at c = (4 omega^2 - 1)/4
    assert 0.38 < br.p[-1] < 0.39 and br.outcome.startswith(
        "Ended: beyond its last point 2 omega = 1.6 meets"
    )
    assert gx.breathers.localisation(uneven(br.p[-1]), br.orbit(-1).state).bright
    # an odd force makes no second harmonic
    soft = lambda c: gx.scenes.klein_gordon(9, c, beta=-1.0)
    br = gx.breathers.anticontinuous(soft, 0.45, 0.8, stability=False)
    assert (
        br.p[-1] == pytest.approx(0.45)
        and gx.breathers.localisation(soft(br.p[-1]), br.orbit(-1).state).bright
    )
    two = gx.breathers.anticontinuous(soft, 0.02, 0.8, [4, 5], amplitudes=[1, -1])
    assert two.u[0, 4] == -two.u[0, 5] and two.verdict[-1] == "stable"
    same = gx.breathers.anticontinuous(soft, 0.02, 0.8, [4, 5])
    # Archilla, Cuevas, Sanchez-Rey, Alvarez, Physica D 180, 235 (2003): soft, attracting, in phase
    assert same.verdict[-1] == "unstable" and same.bifurcations == ()


def test_what_has_no_such_limit_is_refused():
    for scene, coupling, omega, words in (
        (hard, 0.1, 0.9, "omega"),
        (hard, 0.0, OMEGA, "coupling"),
        (lambda c: gx.scenes.klein_gordon(9, 0.1 + c), 0.1, OMEGA, "do not feel each other"),
        (lambda c: gx.scenes.klein_gordon(9, c, beta=-1.0), 0.1, 1.0, "omega"),
    ):
        with refused(words):
            gx.breathers.anticontinuous(scene, coupling, omega)


@pytest.mark.slow
def test_branches_over_the_coupling_that_turn_back_and_that_change(over_coupling):
    soft = lambda c: gx.scenes.klein_gordon(9, c, beta=-1.0)
    apart = gx.breathers.anticontinuous(soft, 0.3, 0.8, [3, 4], amplitudes=[1, -1], stability=False)
    # two sites meet more of them at a fold
    assert (
        "turned back at the coupling 0.26" in apart.outcome
        and len(apart.folds)
        and apart.p[-1] == 0
    )
    sizes = np.abs(apart.u[-1] / apart.u[0, 3])
    np.testing.assert_allclose(sizes, np.round(sizes), atol=1e-9)
    assert 2 < sizes.sum() < 5
    dark = gx.breathers.anticontinuous(
        soft, 0.02, 0.8, [0, 1, 2, 3, 5, 6, 7, 8], amplitudes=[1, -1, 1, -1] * 2, stability=False
    )
    assert dark.p[-1] == 0.02 and gx.breathers.localisation(soft(0.02), dark.orbit(-1).state).dark
    # near the barrier of the soft force, where the third harmonic meets the band
    near = gx.breathers.anticontinuous(soft, 0.4, 0.45, stability=False)
    assert (
        near.p[-1] == pytest.approx((1.35**2 - 1) / 4, rel=1e-3)
        and "3 omega = 1.35 meets" in near.outcome
    )
    assert gx.breathers.bifurcations(over_coupling) == []


@pytest.mark.slow
def test_a_breather_of_the_cradle_falls_off_faster_than_exponentially():
    branch = gx.breathers.anticontinuous(
        lambda A: gx.scenes.cradle(9, stiffness=A, length=1.0),
        0.02,
        0.9,
        stability=False,
        points=12,
        steps=64,
    )
    decay = np.diff(np.log(np.abs(branch.u[-1][4:9])))
    assert branch.p[-1] == 0.02 and np.all(decay[1:] < 1.3 * decay[:-1])


@pytest.mark.study
def test_a_boomeron_turns_back_by_itself():
    # James, Kevrekidis, Cuevas, Physica D 251, 39 (2013): an impact, Hertz contacts, a hard force on the beads
    n, times = 20, np.linspace(0.0, 300.0, 61)
    lattice = gx.scenes.cradle(n, law=gx.Polynomial(1.0, 0.0, 2.0))
    run = gx.simulate(lattice, gx.states.impact(lattice, velocity=1.2), 300.0, save_at=times)
    places = np.asarray(gx.measures.along(gx.measures.site_energy, lattice, run)).argmax(1)

    def slope(t, y):
        u = y[:n]
        push = np.pad(np.maximum(u[:-1] - u[1:], 0) ** 1.5, 1)
        return np.concatenate([y[n:], push[:-1] - push[1:] - u - 2 * u**3])

    y0 = np.zeros(2 * n)
    y0[n] = 1.2
    ys = solve_ivp(slope, (0, 300), y0, method="DOP853", rtol=1e-8, atol=1e-11, t_eval=times).y
    own = ys[n:] ** 2 / 2 + ys[:n] ** 2 / 2 + ys[:n] ** 4 / 2
    alone = own.argmax(0)
    assert np.all(np.abs(places - alone) <= 1)
    assert 10 <= places.max() <= 12 and 20 < places.argmax() < 50 and places[-1] <= places.max() - 2


@pytest.mark.slow
def test_a_breather_that_travels_on_the_chain():
    # the moving breather of the continuum is the guess of one that reappears four sites further on after its period
    h, w, n, cells = 0.6, 0.7, 40, 4
    speed = 0.0
    for _ in range(60):
        stretch = (1 - speed**2) ** -0.5
        period = 2 * np.pi * stretch / w
        speed = h * cells / period
    x, s = h * (np.arange(n) - n // 2), np.sqrt(1 - w * w)

    def continuum(t):
        turning = jnp.cos(w * stretch * (t - speed * x))
        return 4 * jnp.arctan(s / w * turning / jnp.cosh(s * stretch * (x - speed * t)))

    ring = gx.scenes.sine_gordon(n, 1 / h**2, boundary="periodic")
    guess = gx.State(*jax.jvp(continuum, (0.0,), (1.0,)))
    orbit = gx.orbits.orbit(ring, guess, period, symmetry=gx.orbits.Translation(cells), steps=216)
    assert orbit.converged and float(jnp.max(jnp.abs(orbit.state.u - guess.u))) < 0.1
    run = gx.simulate(ring, orbit.state, 5 * period)
    np.testing.assert_allclose(run.final.u, np.roll(orbit.state.u, 5 * cells), atol=1e-5)
