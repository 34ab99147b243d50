"""Chains with a force on every site, against the closed forms of the continuum and of single oscillators."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import ended
from numpy.testing import assert_allclose
from refusals import refused
from scipy.optimize import root
from scipy.special import ellipk

import granjax as gx
from granjax.breathers import anticontinuous, localisation
from granjax.scenes import cradle, klein_gordon, sine_gordon

U = np.random.default_rng(5).standard_normal(6)


def test_the_equations_of_motion():
    left = np.diff(U, prepend=U[0])
    right = np.diff(U, append=U[-1])
    n = np.arange(1.0, 7.0)
    k = 0.3 + 0.1 * n
    L = 2.0 + 0.1 * n
    contacts = np.maximum(-left, 0) ** 1.5 - np.maximum(-right, 0) ** 1.5
    springs = 0.3 * (right - left)
    for lattice, force in (
        (cradle(6, pendulum=k), contacts - k * U),
        (cradle(6, pendulum=k, length=L), contacts - k * L * np.sin(U / L)),
        (klein_gordon(6, 0.3), springs - U - U**3),
        (klein_gordon(6, 0.3, law=gx.Toda(0.5, 2.0)), springs - 0.5 * np.expm1(2 * U)),
        (sine_gordon(6, 0.3, wavenumber=2.0), springs - np.sin(2 * U) / 2),
    ):
        assert_allclose(lattice.force(0.0, U, 0 * U), force, atol=1e-14)


def test_bands():
    k = np.linspace(-np.pi, np.pi, 7)
    for lattice, c, squared in (
        (klein_gordon(9, 0.2, stiffness=1.3), 0.2, 1.3),
        (sine_gordon(9, 0.2, stiffness=1.3), 0.2, 1.3),
        (cradle(9, pendulum=1.7), 0.0, 1.7),
    ):
        omega = gx.linear.dispersion(lattice, k).omega[:, 0]
        assert_allclose(omega**2, squared + 4 * c * np.sin(k / 2) ** 2, rtol=1e-14)


def test_numbers_of_sites_and_springs_are_refused():
    for scene, numbers, words in (
        (klein_gordon, dict(beta=np.ones(6)), r"K4: .*one per site, shape \(7,\)"),
        (klein_gordon, dict(alpha=1.0, law=gx.Sine()), "law"),
        (sine_gordon, dict(coupling=np.ones(5)), r"stiffness: .*one per contact, shape \(6,\)"),
    ):
        with refused(words):
            scene(7, **numbers)


def opposite(m):
    """Frequency, coupling and amplitude of two sites in opposite phase, u = A cn(beta t, m), h = 1 + m below."""
    beta = 1 / np.sqrt(1 - 5 * m)
    return np.pi * beta / (2 * ellipk(m)), 1.5 * m * beta**2, np.sqrt(2 * m) * beta


@pytest.mark.slow
def test_every_site_may_oscillate_in_the_limit_of_no_coupling():
    """In opposite phase both sites are oscillators of stiffness 1 + 2 C."""
    omega, coupling, amplitude = opposite(0.1)
    scene = lambda c: klein_gordon(2, c)
    branch = anticontinuous(scene, coupling, omega, "+-", points=12, stability=False)
    assert_allclose(branch.u[-1], [amplitude, -amplitude], rtol=1e-8)


@pytest.mark.slow
def test_two_sites_in_opposite_phase_become_stable_where_lames_equation_says():
    """A difference delta of the sites obeys delta_xx + (h - 6 m sn(x, m)^2) delta = 0, h = 1 + 4 m - 2 C/beta^2.

    From the limit of no coupling, h = 1 + 4 m, to the other edge of the gap, h = 1 + m, it grows. In
    phase, h = 1 + 4 m + 2 C/beta^2 begins a band.
    """
    omega, coupling, _ = opposite(0.1)
    scene = lambda c: klein_gordon(2, c)
    both, apart = (anticontinuous(scene, 1.1 * coupling, omega, code) for code in ("++", "+-"))
    assert gx.breathers.bifurcations(both, ["real pair at +1"]) == []
    assert gx.breathers.bifurcations(both, "real pair at +1") == []
    (event,) = gx.breathers.bifurcations(apart)
    assert event.kind == "real pair at +1" and (event.before, event.behind) == (1, 0)
    assert event.p == pytest.approx(coupling, rel=1e-8)


@pytest.mark.slow
def test_a_sine_gordon_breather_after_50_periods_is_off_by_h_squared():
    w = 0.9
    s = np.sqrt(1 - w * w)
    t1 = 50.25 * 2 * np.pi / w
    errors = []
    for h in 0.2, 0.1:
        x = h * np.arange(-round(45 / h), round(45 / h) + 1)
        # a quarter of a period later: a phase that is late shows in first order
        start, exact = (4 * np.arctan(s / w * np.cos(w * t) / np.cosh(s * x)) for t in (0.0, t1))
        run = gx.simulate(sine_gordon(len(x), 1 / h**2), gx.State(start, 0 * x), t1)
        errors.append(float(np.max(np.abs(run.final.u - exact))))
    assert errors[0] < 0.1
    assert_allclose(errors[0] / errors[1], 4, rtol=0.01)


OMEGA = 1.4


def hard(c):
    return klein_gordon(9, c)


def soft(c):
    return klein_gordon(9, c, beta=-1.0)


def kind(scene, branch):
    return localisation(scene(branch.p[-1]), branch.orbit(-1).state)


def shot(c, u, omega=OMEGA):
    """Displacements at rest of the phi^4 chain's orbit, by SciPy alone, half a period at a time."""

    def rates(t, y):
        x, v = np.split(y, 2)
        ends = np.pad(x, 1, mode="edge")
        return np.concatenate([v, c * (ends[2:] - 2 * x + ends[:-2]) - x - x**3])

    def later(u):
        return ended(rates, np.pi / omega, np.append(u, 0 * u))[len(u) :]

    return root(later, u, tol=1e-13).x


def phi4_energy(c, u):
    return np.sum(u**2 / 2 + u**4 / 4) + c / 2 * np.sum(np.diff(u) ** 2)


@pytest.mark.slow
def test_breathers_from_no_coupling_to_a_tenth():
    br = anticontinuous(hard, 0.1, OMEGA)
    assert br.outcome == "p reached 0.1." and br.p[0] == 0 and br.p[-1] == 0.1 and len(br) > 4
    assert_allclose(br.omega, OMEGA, rtol=1e-15)
    alone = shot(0.0, np.where(np.arange(9) == 4, br.u[0, 4], 0))
    assert_allclose(br.u[0], alone, atol=1e-9)
    u = shot(0.1, br.u[-1])
    assert_allclose(br.u[-1], u, atol=1e-9)
    assert abs(br.energy[-1] - phi4_energy(0.1, u)) < 1e-9 and br.energy_error[-1] < 1e-9
    # tails alternate as the wave above the band does
    assert np.all(br.verdict == "stable") and np.all(np.diff(np.sign(br.u[-1])) != 0)
    assert kind(hard, br).participation < 1.3
    assert gx.breathers.bifurcations(br) == []
    # and at the energy that it had without coupling
    found = gx.breathers.breather(hard(0.1), OMEGA, br.orbit(-1), energy=br.energy[0])
    u = shot(0.1, np.asarray(found.state.u), float(found.omega))
    assert_allclose(found.state.u, u, atol=1e-9)
    assert abs(phi4_energy(0.1, u) - br.energy[0]) < 1e-9 and found.omega > OMEGA + 0.01


@pytest.mark.slow
def test_a_branch_ends_where_a_harmonic_meets_the_band():
    uneven = lambda c: klein_gordon(9, c, law=gx.Polynomial(1.0, -0.1, -1.0))
    br = anticontinuous(uneven, 1.0, 0.8, stability=False)
    # 2 omega enters the band, 1 <= omega^2 <= 1 + 4 c, at c = (4 omega^2 - 1)/4
    assert 0.38 < br.p[-1] < 0.39 and kind(uneven, br).bright
    assert br.outcome.startswith("Ended: beyond its last point 2 omega = 1.6 meets")
    # an odd force makes no second harmonic
    br = anticontinuous(soft, 0.45, 0.8, stability=False)
    assert br.p[-1] == pytest.approx(0.45) and kind(soft, br).bright
    # near the barrier of the soft force, where the third harmonic meets the band
    near = anticontinuous(soft, 0.4, 0.45, stability=False)
    assert near.p[-1] == pytest.approx((1.35**2 - 1) / 4, rel=1e-3)
    assert "3 omega = 1.35 meets" in near.outcome


@pytest.mark.slow
def test_signs_of_sites_decide_on_stability():
    two = anticontinuous(soft, 0.02, 0.8, [4, 5], amplitudes=[1, -1])
    assert two.u[0, 4] == -two.u[0, 5] and two.verdict[-1] == "stable"
    same = anticontinuous(soft, 0.02, 0.8, [4, 5])
    # Archilla, Cuevas, Sanchez-Rey, Alvarez, Physica D 180, 235 (2003): soft, attracting, in phase
    assert same.verdict[-1] == "unstable" and same.bifurcations == ()


@pytest.mark.slow
def test_what_has_no_such_limit_is_refused():
    for scene, coupling, omega, words in (
        (hard, 0.1, 0.9, "omega"),
        (hard, 0.0, OMEGA, "coupling"),
        (lambda c: hard(0.1 + c), 0.1, OMEGA, "on which no neighbour acts"),
        (soft, 0.1, 1.0, "omega"),
    ):
        with refused(words):
            anticontinuous(scene, coupling, omega)


@pytest.mark.slow
def test_branches_over_the_coupling_turn_back_and_may_be_dark():
    apart = anticontinuous(soft, 0.3, 0.8, [3, 4], amplitudes=[1, -1], stability=False)
    # two sites meet more of them at a fold
    assert "turned back at the coupling 0.26" in apart.outcome
    assert len(apart.folds) and apart.p[-1] == 0
    sizes = np.abs(apart.u[-1] / apart.u[0, 3])
    assert_allclose(sizes, np.round(sizes), atol=1e-9)
    assert 2 < sizes.sum() < 5
    sites = [0, 1, 2, 3, 5, 6, 7, 8]
    signs = [1, -1, 1, -1] * 2
    dark = anticontinuous(soft, 0.02, 0.8, sites, amplitudes=signs, stability=False)
    assert dark.p[-1] == 0.02 and kind(soft, dark).dark


@pytest.mark.slow
def test_a_breather_of_the_cradle_falls_off_faster_than_exponentially():
    scene = lambda A: cradle(9, stiffness=A, length=1.0)
    branch = anticontinuous(scene, 0.02, 0.9, stability=False, points=12, steps=64)
    decay = np.diff(np.log(np.abs(branch.u[-1][4:9])))
    assert branch.p[-1] == 0.02 and np.all(decay[1:] < 1.3 * decay[:-1])


@pytest.mark.slow
def test_a_boomeron_turns_back_by_itself():
    # James, Kevrekidis, Cuevas, Physica D 251, 39 (2013): an impact, Hertz contacts, a hard force on the beads
    n = 20
    times = np.linspace(0.0, 300.0, 61)
    lattice = cradle(n, law=gx.Polynomial(1.0, 0.0, 2.0))
    run = gx.simulate(lattice, gx.states.impact(lattice, velocity=1.2), 300.0, save_at=times)
    places = np.asarray(gx.measures.along(gx.measures.site_energy, lattice, run)).argmax(1)

    assert 10 <= places.max() <= 12 and 20 < places.argmax() < 50 and places[-1] <= places.max() - 2


@pytest.mark.slow
def test_a_breather_that_travels_on_the_chain(optimised):
    # the moving breather of the continuum is the guess of one that reappears four sites further on after its period
    h = 0.6
    w = 0.7
    n = 40
    cells = 4
    speed = 0.0
    for _ in range(60):
        stretch = (1 - speed**2) ** -0.5
        period = 2 * np.pi * stretch / w
        speed = h * cells / period
    x = h * (np.arange(n) - n // 2)
    s = np.sqrt(1 - w * w)

    def continuum(t):
        turning = jnp.cos(w * stretch * (t - speed * x))
        return 4 * jnp.arctan(s / w * turning / jnp.cosh(s * stretch * (x - speed * t)))

    ring = sine_gordon(n, 1 / h**2, boundary="periodic")
    guess = gx.State(*jax.jvp(continuum, (0.0,), (1.0,)))
    orbit = gx.orbits.orbit(ring, guess, period, symmetry=gx.orbits.Translation(cells), steps=216)
    assert orbit.converged and float(jnp.max(jnp.abs(orbit.state.u - guess.u))) < 0.1
    run = gx.simulate(ring, orbit.state, 5 * period)
    assert_allclose(run.final.u, np.roll(orbit.state.u, 5 * cells), atol=1e-5)
