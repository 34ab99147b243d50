"""Backbone curves of normal modes against the orbits that leave them; breathers of the plane."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from refusals import refused

import granjax as gx
from granjax import scenes
from granjax.breathers import backbone, breather, localisation

pytestmark = pytest.mark.slow


def curved(k1=1.0, k2=2.0):
    """A chain of Su, Schrieffer and Heeger of which both kinds of bonds bend twice."""
    return scenes.ssh(10, law=[gx.Polynomial(k, 0.5 * k, 0.7 * k) for k in (k1, k2)])


@pytest.mark.parametrize("mode", [9, 10], ids=["odd", "even"])
def test_an_edge_mode_bends_as_its_breathers_do(mode):
    chain = curved()
    found = backbone(chain, mode)
    flat = lambda x: np.concatenate([x[name] for name in "ab"])
    shape = flat(found.shape)
    slopes = []
    for a in (0.05, 0.025):
        orbit = breather(chain, float(found.omega_at(a)), found.state(a), check=False)
        u = flat(orbit.state.u) - a * a * (flat(found.constant) + flat(found.second))
        first = shape @ u / (shape @ shape)
        slopes.append((float(orbit.omega) ** 2 - float(found.omega_squared)) / first**2)
    limit = (4 * slopes[1] - slopes[0]) / 3
    assert abs(limit / float(found.curvature) - 1) < 1e-5
    # second order in K3 counts
    assert abs(float(found.cubic)) > 0.3 * abs(float(found.quartic))


def test_compact_states_keep_to_one_site_s_curve_and_rings_to_the_closed_form():
    chain = scenes.diamond(8, ground=0.5, on_site=gx.Polynomial(0.0, 0.0, 0.4))
    found = backbone(chain, gx.linear.flat_bands(chain).state(chain))
    assert abs(float(found.curvature) - 0.75 * 0.4) < 1e-13 and np.isinf(found.limit)
    # the mode k = pi of a ring of cubic springs: each bond strains by 2u
    ring = gx.Lattice(1.0, gx.Bond(gx.Shift(1, "periodic"), gx.Polynomial(1.0, 0.0, 0.3)), sites=8)
    assert abs(float(backbone(ring, 7).curvature) - 0.75 * 0.3 * 16) < 1e-12
    one_site = gx.State(jnp.zeros(8).at[3].set(1.0), ring.zeros())
    for mode, words in ((0, "oscillates"), (one_site, "normal mode"), (8, "below 8")):
        with refused(words):
            backbone(ring, mode)


def test_a_curve_differentiates_and_its_second_harmonic_may_be_no_mode():
    curvature = lambda k: backbone(curved(1.0, k), 9).curvature
    want = (curvature(2.0 + 1e-4) - curvature(2.0 - 1e-4)) / 2e-4
    assert abs(jax.grad(curvature)(2.0) / want - 1) < 1e-6
    # two oscillators, the second of twice the frequency
    springs = gx.Polynomial(jnp.array([1.0, 4.0]), jnp.array([1.0, 0.0]), 0.0)
    bond = gx.Bond(gx.Shift(1, "free"), gx.Polynomial(0.0, 0.5, 0.0))
    with refused("second harmonic"):
        backbone(gx.Lattice(1.0, (gx.OnSite(springs), bond), sites=2), 0)


def test_a_breather_of_a_klein_gordon_square_has_its_symmetries():
    def scene(coupling):
        on_site = dict(ground=1.0, on_site=gx.Polynomial(0.0, 0.0, 1.0))
        law = gx.Linear(coupling)
        return scenes.square(5, law=law, out_of_plane=True, boundary="free", **on_site)

    branch = gx.breathers.anticontinuous(scene, 0.05, 1.6, (2, 2), points=12)
    crystal = scene(0.05)
    refined = breather(crystal, 1.6, branch.orbit(-1).state)
    assert float(refined.residual) < 1e-12
    assert float(localisation(crystal, refined.state).participation) < 1.5
    u = np.asarray(refined.state.u)
    assert np.abs(u - u.T).max() < 1e-9 and np.abs(u - u[::-1]).max() < 1e-9
    assert float(jnp.abs(refined.error.state.u).max()) < 1e-8 * np.abs(u).max()
    assert "Every multiplier is on the unit circle" in refined.floquet().outcome


def test_a_light_magnet_in_a_hexagon_holds_a_breather(optimised):
    mass = np.ones(19)
    mass[9] = 0.3
    crystal = scenes.hexagon(2, mass=mass, law=gx.PowerLaw(1.0, -4.0, 1.0))
    shape = np.asarray(gx.linear.normal_modes(crystal).modes)[..., -2:]
    # of two modes of one frequency the one along a row
    found = backbone(crystal, gx.State(jnp.asarray(shape @ shape[9, 0]), crystal.zeros()))
    orbit = breather(crystal, float(found.omega_at(0.05)), found.state(0.05), tolerance=1e-9)
    assert float(orbit.residual) < 1e-12
    assert float(localisation(crystal, orbit.state).participation) < 5
    u = np.abs(orbit.state.u)
    assert u[:, 1].max() < 0.2 * u[:, 0].max()
    # the row is not the way that it goes on
    assert "real multiplier" in orbit.floquet().outcome


def test_a_wave_between_walls_is_no_breather():
    square = scenes.square(12, out_of_plane=True, ground=100.0)
    chain = scenes.klein_gordon(12, boundary="fixed")
    for crystal in (square, chain, scenes.hexagon(3)):
        wave = gx.linear.normal_modes(crystal).modes[..., 0]
        found = localisation(crystal, gx.State(wave, crystal.zeros()))
        assert not found.bright
        # 12 sites within 13 spacings
        assert crystal is not square or abs(found.participation / 13**2 - 4 / 9) < 0.002
