"""Several solutions from one guess, q-breathers, codes, and the same multipliers from any number of segments."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose
from refusals import refused

import granjax as gx
from granjax.orbits import find_all, problem


def pair(*more, well=-1.0, coupling=0.1):
    wells = gx.OnSite(gx.Polynomial(well, 0.0, 1.0))
    spring = gx.Linear(coupling)
    return gx.Lattice(1.0, (wells, gx.Bond(gx.Shift(1, "free"), spring), *more), sites=2)


def still(*u):
    return gx.State(jnp.array(u), jnp.zeros(len(u)))


@pytest.mark.slow
def test_two_coupled_double_wells_rest_in_nine_ways():
    found = find_all(problem(pair()), [still(0.3, 0.1), still(0.9, -0.8), still(0.1, -0.5)])
    # 0, +-(1, 1), +-(a, -a) with a^2 = 1 - 2 c, and (x, y) with x y = -c, x^2 + y^2 = 1 - c and its three images
    forms = {(0.0, 0.0): 1, (1.0, 1.0): 2, (0.8**0.5, 0.8**0.5): 2}
    root = 0.77**0.5
    forms[((0.9 + root) / 2) ** 0.5, ((0.9 - root) / 2) ** 0.5] = 4
    got = {}
    for rest, copies in zip(found.solutions, found.copies):
        x = np.sort(np.abs(np.asarray(rest.state.u)))[::-1]
        got[next(f for f in forms if np.allclose(f, x, atol=1e-9))] = 1 + len(copies)
    assert got == forms and found.outcome == "4 solutions, 9 with symmetric copies."
    verdicts = [rest.verdict for rest in found.solutions]
    assert sorted(verdicts) == ["stable", "stable", "unstable", "unstable"]


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 7])
def test_six_guesses_find_all_nine(seed):
    """u = v = 0, +-1; u = -v = +-(1 - 2c)^(1/2); u v = -c with u^2 + v^2 = 1 - c."""
    c = 0.31
    wells = gx.OnSite(gx.Polynomial(-1.0, 0.0, 1.0))
    bond = gx.Bond(gx.Shift(1, "free"), gx.Linear(c))
    sought = gx.orbits.problem(gx.Lattice(1.0, (wells, bond), sites=2))
    guesses = np.random.default_rng(seed).uniform(-1.3, 1.3, (6, 2))
    guesses = [gx.State(jnp.asarray(u), jnp.zeros(2)) for u in guesses]
    found = gx.orbits.find_all(sought, guesses)
    energy = [np.sum(u**2) for u in found.states.u]
    assert_allclose(np.sort(energy), [0, 1 - c, 2 - 4 * c, 2], atol=1e-9)
    assert sorted(map(len, found.copies)) == [0, 1, 1, 3]


@pytest.mark.slow
def test_a_chain_whose_preloads_do_not_balance_rests_where_the_problem_says():
    bonds = [
        gx.Bond(gx.Shift(n, "free"), gx.PowerLaw(1.0, -3.0, force))
        for n, force in ((1, 1.0), (2, 0.3))
    ]
    sought = problem(gx.Lattice(1.0, bonds, sites=6))
    found = find_all(sought, [still(*0.01 * np.arange(6.0) ** 2)])
    (rest,) = found.solutions
    assert np.abs(rest.state.u).max() > 0.1
    assert_allclose(sought.residual(sought.unknowns(rest.state), 0.0), 0, atol=1e-13)


def test_a_solution_far_from_the_guess_is_found():
    """Springs to places c = +-12, joined by one of stiffness 0.1: u = +-12/1.2."""
    places = gx.OnSite(Place(np.array([12.0, -12.0])))
    lattice = gx.Lattice(1.0, (places, gx.Bond(gx.Shift(1, "free"), gx.Linear(0.1))), sites=2)
    guess = gx.State(jnp.ones(2), jnp.zeros(2))
    found = gx.orbits.find_all(gx.orbits.problem(lattice), [guess])
    assert_allclose(found.states.u, [[10.0, -10.0]], rtol=1e-9)


class Place(gx.Law):
    """A spring to a place c: F = e - c."""

    c: np.ndarray

    def force(self, e):
        return e - self.c

    def energy(self, e):
        return (e - self.c) ** 2 / 2


@pytest.mark.slow
def test_forced_orbits_have_the_amplitudes_of_duffing():
    both = [gx.Drive(gx.Harmonic(0.3, 1.6), site) for site in (0, 1)]
    driven = pair(gx.Damping(0.1), *both, well=1.0, coupling=0.05)
    found = find_all(problem(driven, period=2 * np.pi / 1.6), [still(0.1, 0.1), still(-1.0, -1.0)])
    amplitudes = [np.asarray(orbit.amplitude) for orbit in found.solutions]
    alike = sorted(a[0] for a in amplitudes if np.ptp(a) < 1e-9)
    # ((1 - omega^2 + 3 a^2/4)^2 + (gamma omega)^2) a^2 = f^2, but for third harmonics
    squares = np.roots([0.75**2, -2 * 1.56 * 0.75, 1.56**2 + 0.16**2, -0.09])
    np.testing.assert_allclose(alike, np.sort(np.sqrt(squares.real)), rtol=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("asked", [{}, {"omega": 1.1}])
def test_the_residual_of_a_problem_has_derivatives(asked):
    made = lambda c: problem(gx.scenes.klein_gordon(3, c), **asked)
    z = 0.1 * jnp.arange(1.0, made(0.02).residual(jnp.zeros(3), 0.0).size + 1)
    residual = lambda c: made(c).residual(z, 0.0)
    slope = (residual(0.021) - residual(0.019)) / 0.002
    np.testing.assert_allclose(jax.jacfwd(residual)(0.02), slope, rtol=0, atol=1e-6)


@pytest.mark.slow
def test_a_guess_that_is_a_solution_is_found_once():
    found = find_all(problem(pair()), [still(1.0, 1.0), still(0.0, 0.0), still(1.0, 1.0)])
    states = np.abs(np.round(found.states.u, 6))
    assert len(np.unique(states, axis=0)) == len(states) >= 2


@pytest.mark.parametrize(
    ("call", "why"),
    [
        (lambda: find_all(problem(pair()), [still(0.0, 0.0)]), "guesses: expected states that"),
        (lambda: problem(pair(), omega=1.0, period=1.0), "period: expected a period or a freq"),
        (
            lambda: gx.breathers.guesses.single_site(gx.scenes.klein_gordon(5, 0.02), 1.4, "+x"),
            "sites: expected a code",
        ),
    ],
)
def test_what_find_all_does_not_take_is_refused(call, why):
    with refused(why):
        call()


@pytest.mark.slow
def test_q_breathers_fall_off_as_flach_ivanchenko_and_kanakov_say():
    chain = gx.scenes.fput(32, alpha=0.0, beta=0.1)
    found = gx.breathers.q_breather(chain, 2, 0.02, stability=False)
    assert abs(float(found.orbit.energy) / 0.02 - 1) < 1e-12
    # E_9/E_3 = (3 beta E (N + 1)/(8 pi^2 q^2))^2, long waves
    share = found.modal_energy[8] / found.modal_energy[2]
    assert abs(share / (3 * 0.1 * 0.02 * 33 / (72 * np.pi**2)) ** 2 - 1) < 0.03
    assert found.along.shape == (len(found.branch), 32)


@pytest.mark.slow
def test_a_code_is_a_multibreather():
    scene = lambda coupling: gx.scenes.klein_gordon(10, coupling)
    branch = gx.breathers.anticontinuous(scene, 0.02, 1.4, "+-0+", stability=False)
    large = np.abs(branch.u[-1]) > 0.5
    assert np.flatnonzero(large).tolist() == [3, 4, 6]
    assert np.sign(branch.u[-1][large]).tolist() == [1, -1, 1]


@pytest.mark.slow
def test_the_verdict_of_a_forced_orbit_is_the_same_from_any_number_of_segments():
    scene = gx.scenes.monomer(8, precompression=1.0)
    driven = gx.driven.driven_chain(scene, 0.3, 2.0, damping=0.05, ends="left")
    forced = gx.forced.forced_orbit(driven, np.pi, steps=128)
    one, *others = (forced.floquet(segments=m, steps=128) for m in (1, 4, 16))
    for other in others:
        assert other.verdict == one.verdict
        away = np.abs(other.multipliers[:, None] - one.multipliers)
        assert np.all(away.min(1) <= other.error + one.error[away.argmin(1)])
        assert np.all(away.min(0) <= one.error + other.error[away.argmin(0)])
