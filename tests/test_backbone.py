"""Backbone curves of normal modes against the orbits that leave them; breathers of the plane."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from refusals import refused

import granjax as gx
from granjax import scenes
from granjax.breathers import backbone, breather


def curved(k1=1.0, k2=2.0):
    """A chain of Su, Schrieffer and Heeger of which both kinds of bonds bend twice."""
    return scenes.ssh(10, law=[gx.Polynomial(k, 0.5 * k, 0.7 * k) for k in (k1, k2)])


@pytest.mark.slow
@pytest.mark.parametrize("mode", [9, 10], ids=["odd", "even"])
def test_an_edge_mode_bends_as_its_breathers_do(mode):
    chain = curved()
    found = backbone(chain, mode)
    shape, corrections = (
        np.concatenate(list(map(np.asarray, x)))
        for x in (
            found.shape.values(),
            [found.constant[name] + found.second[name] for name in "ab"],
        )
    )
    slopes = []
    for a in (0.05, 0.025):
        orbit = breather(chain, float(found.omega_at(a)), found.state(a), check=False)
        u = np.concatenate([np.asarray(orbit.state.u[name]) for name in "ab"])
        first = shape @ (u - a * a * corrections) / (shape @ shape)
        slopes.append((float(orbit.omega) ** 2 - float(found.omega_squared)) / first**2)
    limit = (4 * slopes[1] - slopes[0]) / 3
    assert abs(limit / float(found.curvature) - 1) < 1e-5
    # second order in K3 counts
    assert abs(float(found.cubic)) > 0.3 * abs(float(found.quartic))


def test_compact_states_keep_to_one_site_s_curve_and_rings_to_the_closed_form():
    chain = scenes.diamond(8, ground=0.5, on_site=gx.Polynomial(0.0, 0.0, 0.4))
    flat = gx.linear.flat_bands(chain)
    found = backbone(chain, flat.state(chain))
    assert abs(float(found.curvature) - 0.75 * 0.4) < 1e-13 and np.isinf(found.limit)
    # the mode k = pi of a ring of cubic springs: each bond strains by 2u
    ring = gx.Lattice(1.0, gx.Bond(gx.Shift(1, "periodic"), gx.Polynomial(1.0, 0.0, 0.3)), sites=8)
    assert abs(float(backbone(ring, 7).curvature) - 0.75 * 0.3 * 16) < 1e-12
    with refused("oscillates"):
        backbone(ring, 0)
    with refused("normal mode"):
        backbone(ring, gx.State(jnp.zeros(8).at[3].set(1.0), ring.zeros()))
    with refused("below 8"):
        backbone(ring, 8)


@pytest.mark.slow
def test_a_curve_differentiates_and_its_second_harmonic_may_be_no_mode():
    def curvature(k):
        return backbone(curved(1.0, k), 9).curvature

    step = 1e-4
    want = (curvature(2.0 + step) - curvature(2.0 - step)) / (2 * step)
    assert abs(jax.grad(curvature)(2.0) / want - 1) < 1e-6
    # two oscillators, the second of twice the frequency
    springs = gx.Polynomial(jnp.array([1.0, 4.0]), jnp.array([1.0, 0.0]), 0.0)
    pair = gx.Lattice(
        1.0,
        (gx.OnSite(springs), gx.Bond(gx.Shift(1, "free"), gx.Polynomial(0.0, 0.5, 0.0))),
        sites=2,
    )
    with refused("second harmonic"):
        backbone(pair, 0)


@pytest.mark.slow
def test_a_breather_of_a_klein_gordon_square():
    scene = lambda c: scenes.square(
        5,
        law=gx.Linear(c),
        out_of_plane=True,
        boundary="free",
        ground=1.0,
        on_site=gx.Polynomial(0.0, 0.0, 1.0),
    )
    branch = gx.breathers.anticontinuous(scene, 0.05, 1.6, (2, 2), points=12)
    orbit = branch.orbit(-1)
    crystal = scene(0.05)
    refined = breather(crystal, 1.6, orbit.state)
    assert float(refined.residual) < 1e-12
    assert float(gx.breathers.localisation(crystal, refined.state).participation) < 1.5
    u = np.asarray(refined.state.u)
    assert np.abs(u - u.T).max() < 1e-9 and np.abs(u - u[::-1]).max() < 1e-9
    assert float(jnp.abs(refined.error.state.u).max()) < 1e-8 * np.abs(u).max()
    assert "Every multiplier is on the unit circle" in refined.floquet().outcome


@pytest.mark.slow
def test_a_light_magnet_in_a_hexagon_holds_a_breather():
    mass = np.ones(19)
    mass[9] = 0.3
    crystal = scenes.hexagon(2, mass=mass, law=gx.PowerLaw(1.0, -4.0, 1.0))
    top = gx.linear.normal_modes(crystal)
    shape = np.asarray(top.modes)[..., -2:]
    # of two modes of one frequency the one along a row
    along = gx.State(jnp.asarray(shape @ shape[9, 0]), crystal.zeros())
    found = backbone(crystal, along)
    orbit = breather(crystal, float(found.omega_at(0.05)), found.state(0.05), tolerance=1e-9)
    assert float(orbit.residual) < 1e-12
    assert float(gx.breathers.localisation(crystal, orbit.state).participation) < 5
    u = np.asarray(orbit.state.u)
    assert np.abs(u[:, 1]).max() < 0.2 * np.abs(u[:, 0]).max()
    # the row is not the way that it goes on
    assert "real multiplier" in orbit.floquet().outcome


@pytest.mark.slow
def test_a_wave_between_the_walls_of_a_plane_is_no_breather():
    square = scenes.square(12, out_of_plane=True, ground=100.0)
    wave = np.asarray(gx.linear.normal_modes(square).modes)[..., 0]
    found = gx.breathers.localisation(square, gx.State(jnp.asarray(wave), square.zeros()))
    # 12 sites within 13 spacings
    assert abs(found.participation / 13**2 - 4 / 9) < 0.002 and not found.bright
    chain = scenes.klein_gordon(12, boundary="fixed")
    wave = np.asarray(gx.linear.normal_modes(chain).modes)[:, 0]
    assert not gx.breathers.localisation(chain, gx.State(jnp.asarray(wave), chain.zeros())).bright
    hexagon = scenes.hexagon(3)
    wave = np.asarray(gx.linear.normal_modes(hexagon).modes)[..., 0]
    assert not gx.breathers.localisation(
        hexagon, gx.State(jnp.asarray(wave), hexagon.zeros())
    ).bright
