"""What is measured of dispersive shocks, against Whitham's theory and in other units."""

from dataclasses import replace

import jax
import numpy as np
import pytest
from cases import Mirrored
from numpy.testing import assert_allclose
from refusals import refused
from scipy.integrate import solve_ivp

import granjax as gx

pytestmark = pytest.mark.slow


def piston(law, c, sites):
    chain = gx.Lattice(1.0, gx.Bond(gx.Shift(1, "free"), law), sites=sites)
    return gx.shocks.piston(chain, 2 * c)


@pytest.fixture(scope="module")
def shock():
    """What is measured of a Toda chain struck by a piston, c = 0.3."""
    return gx.shocks.measure(piston(gx.Toda(), 0.3, 330).run(200.0))


def test_a_toda_shock_is_that_of_the_theory(shock):
    theory = gx.theory.toda.ShockEdges(*map(float, gx.theory.toda.velocity_shock(0.3)))
    assert abs(shock.mean - theory.mean) < min(10 * shock.mean_error, 1e-5)
    assert shock.c == pytest.approx(0.3, abs=1e-5)
    # the crest is below s_+ and rises to it
    assert 0 < theory.leading_speed - shock.leading_speed < 5e-3
    assert 0 < theory.amplitude - shock.amplitude < 2e-2
    assert abs(shock.trailing_speed - theory.trailing_speed) < shock.trailing_speed_error < 0.05
    assert np.all(np.abs(shock.speeds_of_m - shock.s)[1:] < 0.01) and np.all(shock.m_errors < 0.02)
    known = gx.theory.toda.modulation(gx.theory.toda.modulus(shock.s, 0.3), 0.3)
    assert_allclose(shock.amplitudes, known.amplitude, atol=0.03)
    assert_allclose(shock.means, known.mean, atol=0.01)
    assert_allclose(shock.wavelengths, known.wavelength, rtol=0.02)


def test_a_shock_of_a_bare_run_between_walls_is_recognised_on_both_sides(shock):
    # walls send waves of their own, which stay beyond quiet bonds
    chain = gx.scenes.toda(1101, boundary="fixed")
    run = gx.simulate(chain, gx.states.velocity_step(chain, 0.3), 200.0)
    for side, sign in (("right", 1), ("left", -1)):
        found = gx.shocks.measure(run, side=side)
        assert_allclose(found.mean, shock.mean, rtol=1e-9)
        assert_allclose(found.leading_speed, sign * shock.leading_speed, rtol=1e-9)
        assert_allclose(found.s, sign * shock.s, rtol=1e-12)
        assert_allclose(found.m, shock.m, atol=1e-5)


def test_a_rarefaction_shock_is_measured_upside_down(shock):
    # the Toda chain of negative constants is the mirror image: F(e) = -a (exp(-b e) - 1)
    mirrored = gx.shocks.measure(piston(Mirrored(gx.Toda()), -0.3, 330).run(200.0))
    for name in ("mean", "means", "c"):
        assert_allclose(getattr(mirrored, name), -getattr(shock, name), rtol=1e-6)
    for name in ("leading_speed", "amplitude", "trailing_speed", "m", "wavelengths"):
        assert_allclose(getattr(mirrored, name), getattr(shock, name), rtol=1e-5)
    assert "rarefaction" in mirrored.outcome


def several():
    make = jax.vmap(lambda a: gx.scenes.toda(60, strength=a), out_axes=-1)
    return gx.shocks.velocity_shock(make(np.array([1.0, 2.0])), 0.1).run(5.0)


def alternating():
    chain = gx.scenes.dimer(330, precompression=1.0, boundary="free")
    return gx.shocks.velocity_shock(chain, 0.1).run(60.0)


def rounded():
    # a run of float32 whose far displacements differ by some of their last digits, as in long runs
    run = gx.shocks.velocity_shock(gx.scenes.toda(120).astype(np.float32), 0.5).run(9.0, step=0.1)
    u = np.array(run.final.u)
    u[::2] += 8 * np.spacing(u[::2])
    return replace(run, final=gx.State(u, run.final.v))


def struck():
    chain = gx.scenes.toda(60)
    return gx.simulate(chain, gx.states.impact(chain, velocity=0.1), 5.0)


@pytest.mark.parametrize(
    ("run", "why"),
    [
        (lambda: piston(gx.Toda(), -0.3, 150).run(60.0), "than ahead.*a rarefaction"),
        (lambda: piston(gx.Linear(), 0.3, 150).run(60.0), "than ahead.*a linear chain"),
        (lambda: piston(gx.Toda(), 0.3, 60).run(60.0), "quiet bonds before it"),
        (rounded, "Rounding in float32 alone can disturb them: run it in float64"),
        (alternating, "masses"),
        (several, "a batch of shape"),
        (struck, "begins with a step"),
    ],
)
def test_what_is_no_shock_is_refused(run, why):
    with refused(why):
        gx.shocks.measure(run())


def test_a_shock_into_a_sonic_vacuum():
    shock = gx.shocks.measure(piston(gx.Hertz(), 0.5, 1080).run(1000.0))
    # twice the velocity behind, as in a hard collision, to a per mille
    edges = gx.theory.shock_edges(gx.Hertz(), 0.5)
    assert_allclose(shock.leading_speed, edges.leading_speed, rtol=2e-3)
    assert_allclose(shock.mean, edges.mean, rtol=0.02)
    assert np.isnan(shock.c) and "no sound" in shock.outcome and 0.2 < shock.trailing_speed < 0.45


@pytest.mark.parametrize(
    ("K3", "K4", "how"), [(0.25, 0.0, {"tolerance": 1e-8}), (1.0, 0.1, {"step": 0.05})]
)
def test_the_windows_take_steps_like_those_of_the_run(K3, K4, how):
    """By DOP853: when contacts near the leading crest peak after the run has ended."""
    problem = piston(gx.Polynomial(1.0, K3, K4), 0.5, 141)
    shock = gx.shocks.measure(problem.run(60.0, **how), points=3)

    def field(t, y):
        u, v = np.split(y, 2)
        strain = np.append(t - u[0], u[:-1] - u[1:])
        push = strain + K3 * strain**2 + K4 * strain**3
        return np.concatenate([v, push - np.append(push[1:], 0.0)])

    ts = np.linspace(60.0, 60.0 + 9 / shock.leading_speed, 1201)
    u = solve_ivp(field, (0, ts[-1]), np.zeros(282), "DOP853", ts, rtol=1e-11, atol=1e-11).y[:141]
    first = int(np.rint(shock.leading_place + problem.centre)) + 1
    strains = (u[:-1] - u[1:])[first : first + 6]
    crests = ts[np.argmax(strains, 1)]
    assert_allclose(shock.leading_speed, 5 / (crests[-1] - crests[0]), rtol=4e-3)
    assert_allclose(shock.amplitude, strains.max(1).mean(), rtol=5e-3)
