"""What is measured of dispersive shocks, against Whitham's theory and in other units."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import Mirrored, few
from refusals import refused
from scipy.integrate import solve_ivp

import granjax as gx


def piston(law, c, sites, mass=1.0):
    chain = gx.Lattice(mass, (gx.Bond(gx.Shift(1, "free"), law),), sites=sites)
    return gx.shocks.piston(chain, 2 * c)


@pytest.fixture(scope="module")
def toda():
    """A Toda chain struck by a piston, c = 0.3, and what is measured."""
    run = piston(gx.Toda(1.0, 1.0), 0.3, 330).run(200.0)
    return run, gx.shocks.measure(run)


@pytest.mark.slow
def test_a_toda_shock_is_that_of_the_theory(toda):
    theory, shock = (
        gx.theory.toda.ShockEdges(*map(float, gx.theory.toda.velocity_shock(0.3))),
        toda[1],
    )
    assert shock.mean == pytest.approx(theory.mean, abs=1e-5)
    assert abs(shock.mean - theory.mean) < 10 * shock.mean_error
    assert shock.c == pytest.approx(0.3, abs=1e-5)
    # the crest is below s_+ and rises to it
    assert 0 < theory.leading_speed - shock.leading_speed < 5e-3
    assert 0 < theory.amplitude - shock.amplitude < 2e-2
    assert abs(shock.trailing_speed - theory.trailing_speed) < shock.trailing_speed_error < 0.05
    assert np.all(np.abs(shock.speeds_of_m - shock.s)[1:] < 0.01) and np.all(shock.m_errors < 0.02)
    known = gx.theory.toda.modulation(gx.theory.toda.modulus(shock.s, 0.3), 0.3)
    np.testing.assert_allclose(shock.amplitudes, known.amplitude, atol=0.03)
    np.testing.assert_allclose(shock.means, known.mean, atol=0.01)
    np.testing.assert_allclose(shock.wavelengths, known.wavelength, rtol=0.02)


@pytest.mark.study
def test_a_shock_of_a_bare_run_is_recognised(toda):
    shock = toda[1]
    chain = gx.scenes.toda(661)
    both = gx.simulate(chain, gx.states.velocity_step(chain, 0.3), 200.0)
    # walls send waves of their own, which stay beyond quiet bonds
    walls = gx.scenes.toda(1101, boundary="fixed")
    held = gx.simulate(walls, gx.states.velocity_step(walls, 0.3), 200.0)
    for run, side, sign in ((both, "right", 1), (both, "left", -1), (held, "right", 1)):
        found = gx.shocks.measure(run, side=side)
        assert found.mean == pytest.approx(shock.mean, abs=1e-9)
        assert found.leading_speed == pytest.approx(sign * shock.leading_speed, rel=1e-9)
        np.testing.assert_allclose(found.s, sign * shock.s, rtol=1e-12)
        np.testing.assert_allclose(found.m, shock.m, atol=1e-5)


@pytest.mark.study
def test_a_rarefaction_shock_is_measured_upside_down(toda):
    # the Toda chain of negative constants is the mirror image: F(e) = -a (exp(-b e) - 1)
    shock = toda[1]
    mirrored = gx.shocks.measure(piston(Mirrored(gx.Toda(1.0, 1.0)), -0.3, 330).run(200.0))
    for name in ("mean", "means", "c"):
        np.testing.assert_allclose(getattr(mirrored, name), -getattr(shock, name), rtol=1e-6)
    for name in ("leading_speed", "amplitude", "trailing_speed", "m", "wavelengths"):
        np.testing.assert_allclose(getattr(mirrored, name), getattr(shock, name), rtol=1e-5)
    assert "rarefaction" in mirrored.outcome


@pytest.mark.study
def test_what_is_no_shock_is_refused(toda):
    for c, law, found in (
        (-0.3, gx.Toda(1.0, 1.0), "a rarefaction"),
        (0.3, gx.Linear(1.0), "a linear chain"),
    ):
        with refused(f"faster sound behind than ahead.*{found}"):
            gx.shocks.measure(piston(law, c, 330).run(200.0))
    with refused("quiet bonds before it"):
        gx.shocks.measure(piston(gx.Toda(1.0, 1.0), 0.3, 330).run(330.0))
    chain = gx.scenes.dimer(330, precompression=1.0, boundary="free")
    with refused("masses"):
        gx.shocks.measure(gx.shocks.velocity_shock(chain, 0.1).run(60.0))
    with refused("a batch of shape"):
        chains = jax.vmap(lambda a: gx.scenes.toda(60, strength=a), out_axes=-1)(
            np.array([1.0, 2.0])
        )
        gx.shocks.measure(gx.shocks.velocity_shock(chains, 0.1).run(5.0))
    with refused("begins with a step"):
        chain = gx.scenes.toda(60)
        gx.shocks.measure(gx.simulate(chain, gx.states.impact(chain, velocity=0.1), 5.0))


@pytest.mark.study
@pytest.mark.parametrize(
    "c, early, late", few([(0.1, 1000.0, 4000.0), (0.5, 500.0, 2000.0), (0.9, 500.0, 2000.0)], 1)
)
def test_toda_shocks_converge_to_the_theory(c, early, late):
    theory = gx.theory.toda.ShockEdges(*map(float, gx.theory.toda.velocity_shock(c)))
    problem = piston(gx.Toda(1.0, 1.0), c, int(late * theory.leading_speed) + 80)
    early, late = (gx.shocks.measure(problem.run(t)) for t in (early, late))
    assert late.mean == pytest.approx(theory.mean, abs=1e-5)
    assert np.all(np.abs(late.speeds_of_m - late.s) < 2e-3)
    for shock in (early, late):
        assert abs(shock.trailing_speed - theory.trailing_speed) < shock.trailing_speed_error
    known = gx.theory.toda.modulation(gx.theory.toda.modulus(late.s, c), c).phase
    assert np.abs(np.angle(np.exp(1j * (late.phases - np.asarray(known)))))[1:].max() < 0.03
    # the leading crest rises to s_+; what remains of the core after the fit of the phase falls like 1/t
    left = [theory.leading_speed - x.leading_speed for x in (early, late)]
    assert 0 < left[1] < left[0] / 3
    core = slice(2, 8)
    falls = np.log(early.theory_errors[core].mean() / late.theory_errors[core].mean()) / np.log(4)
    assert falls == pytest.approx(1.0, abs=0.25)


@pytest.mark.study
def test_granular_shocks_have_their_plateaus():
    A = 2 * 2**0.5 / 3
    law = gx.Hertz(A, A * 0.5**1.5)
    for c, mean in ((0.1, 0.19157239), (0.3, 0.54047944), (0.5, 0.86141893)):
        edges = gx.theory.shock_edges(law, c)
        shock = gx.shocks.measure(piston(law, c, 2480).run(2000.0))
        assert shock.mean == pytest.approx(mean, abs=1e-6)
        assert shock.leading_speed == pytest.approx(float(edges.leading_speed), rel=0.01)
        # the trailing edge moves with the group velocity of linear waves on the plateau; fitting finds it for small c
        k = np.polyfit(shock.amplitudes[1:6], 2 * np.pi / shock.wavelengths[1:6], 2)[-1]
        group = (2 * (0.5 + mean)) ** 0.25 * np.cos(k / 2)
        assert shock.trailing_speed == pytest.approx(group, abs=0.01)
        assert abs(shock.trailing_speed - float(edges.trailing_speed)) < (
            0.01 if c == 0.1 else 0.08
        )


@pytest.mark.slow
def test_a_shock_into_a_sonic_vacuum():
    shock = gx.shocks.measure(piston(gx.Hertz(), 0.5, 1080).run(1000.0))
    # twice the velocity behind, as in a hard collision, to a per mille
    edges = gx.theory.shock_edges(gx.Hertz(), 0.5)
    assert shock.leading_speed == pytest.approx(float(edges.leading_speed), rel=2e-3)
    assert shock.mean == pytest.approx(float(edges.mean), rel=0.02) and np.isnan(shock.c)
    assert "no sound" in shock.outcome and 0.2 < shock.trailing_speed < 0.45


class Steepening(gx.Law):
    """F(e) = exp(e) - 1 + K e^2/2, as a user writes it: its energy falls without bound in tension."""

    curvature: float

    def force(self, e):
        return jnp.expm1(e) + self.curvature * e**2 / 2

    def energy(self, e):
        return jnp.expm1(e) - e + self.curvature * e**3 / 6


FALLING = [
    pytest.param(gx.Polynomial(1.0, 0.25, 0.0), lambda e: e + 0.25 * e**2, {}, id="fput-alpha"),
    pytest.param(
        Steepening(0.2),
        lambda e: np.expm1(e) + 0.1 * e**2,
        {},
        id="steepening",
        marks=pytest.mark.study,
    ),
    pytest.param(
        Steepening(0.5),
        lambda e: np.expm1(e) + 0.25 * e**2,
        {"tolerance": 1e-8},
        id="adaptive",
        marks=pytest.mark.study,
    ),
    pytest.param(
        gx.Polynomial(1.0, 1.0, 0.1), lambda e: e + e**2 + 0.1 * e**3, {"step": 0.05}, id="stiff"
    ),
]


@pytest.mark.slow
@pytest.mark.parametrize(("law", "force", "keywords"), FALLING)
def test_the_windows_take_steps_like_those_of_the_run(law, force, keywords):
    """By DOP853: when contacts near the leading crest peak after the run has ended."""
    problem = piston(law, 0.5, 141)
    shock = gx.shocks.measure(problem.run(60.0, **keywords), points=3)

    def field(t, y):
        u, v = np.split(y, 2)
        push = force(np.append(t - u[0], u[:-1] - u[1:]))
        return np.concatenate([v, push - np.append(push[1:], 0.0)])

    ts = np.linspace(60.0, 60.0 + 9 / shock.leading_speed, 1201)
    u = solve_ivp(field, (0, ts[-1]), np.zeros(282), "DOP853", ts, rtol=1e-11, atol=1e-11).y[:141]
    strains = (u[:-1] - u[1:])[
        np.rint(shock.leading_place + problem.centre).astype(int) + np.arange(1, 7)
    ]
    crests = ts[np.argmax(strains, 1)]
    assert shock.leading_speed == pytest.approx(5 / (crests[-1] - crests[0]), rel=4e-3)
    assert shock.amplitude == pytest.approx(strains.max(1).mean(), rel=5e-3)
