import jax.numpy as jnp
import numpy as np
import pytest
from cases import ALL_TERMS, EPS, assert_ulps, over, random_like
from numpy.testing import assert_allclose

import granjax as gx
from granjax import Bond, Harmonic, Hertz, Lattice, Shift, Wall

MASS = np.array([1.0, 0.5, 1.0, 0.7, 1.2, 0.9])


def force(*terms, u, v=None, t=0.3, mass=MASS, **how):
    lattice = Lattice(mass, terms, **how)
    return lattice.force(t, u, jnp.zeros_like(u) if v is None else v)


@pytest.mark.slow
@over([case for case in ALL_TERMS if case.lattice.reads_velocity])
def test_friction_never_does_positive_work(case):
    lattice = case.lattice
    u = random_like(lattice.template(), 0)
    v = random_like(lattice.template(), 1)
    assert float(jnp.sum(v * lattice.force(0.3, u, v))) < 0
    assert not np.any(lattice.force(0.3, u, 0 * v)) and not lattice.conserves


def test_damping_and_dashpot_by_hand():
    how = dict(u=jnp.zeros(3), v=jnp.array([1.0, 3.0, -2.0]), mass=np.array([1.0, 2.0, 4.0]))
    assert_ulps(force(gx.Damping(0.5), **how), np.array([-0.5, -3.0, 4.0]), 2)
    # rates of compression -2 and 5
    got = force(gx.Dashpot(Shift(1, "free"), np.array([0.1, 1.0])), **how)
    assert_ulps(got, np.array([0.2, -5.2, 5.0]), 4)


def test_dashpot_damps_along_the_bond_alone():
    dashpot = gx.Dashpot(gx.Stretch(Shift(1, "free"), [0.0, 2.0]), 0.5)
    v = jnp.array([[3.0, 1.0], [0.0, 0.0]])
    got = force(dashpot, u=0 * v, v=v, mass=np.ones(2), dimension=2)
    assert_ulps(got, np.array([[0, -0.5], [0, 0.5]]), 4)


@pytest.mark.parametrize("sites", [2, 3])
def test_rates_and_stiffnesses_per_site_hold_in_the_plane(sites):
    """One rate per site means that site's vector, also where there are as many sites as directions."""
    rate = np.arange(1.0, sites + 1)
    v = jnp.ones((sites, 2))
    for term in gx.Damping(rate), gx.OnSite(gx.Linear(rate)):
        got = force(term, u=v, v=v, mass=np.ones(sites), dimension=2)
        assert_ulps(got, -np.repeat(rate[:, None], 2, 1), 2)


@pytest.mark.slow
@pytest.mark.parametrize("law", [Hertz(1.2, 0.8), gx.PowerLaw(1.0, -3.0, 1.0)])
@pytest.mark.parametrize("support", [None, 3.0])
def test_left_and_right_walls_are_mirror_images(law, support):
    u = random_like((6,), 2, 0.3)
    left = Wall(law, "left", Harmonic(0.3, 1.7, 0.4), support)
    right = Wall(law, "right", Harmonic(-0.3, 1.7, 0.4), support)
    assert_ulps(force(left, u=u), -force(right, u=-u[::-1])[::-1], 4)
    assert_ulps(left.energy(0.3, u), right.energy(0.3, -u[::-1]), 4)


@pytest.mark.parametrize(
    "side, speed, want",
    [
        # the wall stands at 0.5 and presses the first site by 0.4
        ("left", 0.25, [0.4**1.5, 0, 0]),
        # at -0.6 it presses the last by 0.4
        ("right", -0.3, [0, 0, -(0.4**1.5)]),
        ("left", -0.25, [0, 0, 0]),
    ],
)
def test_driven_wall_by_hand(side, speed, want):
    wall = Wall(Hertz(), side, lambda t: speed * t)
    got = force(wall, u=jnp.array([0.1, 0.0, -0.2]), mass=np.ones(3), t=2.0)
    assert_ulps(got, np.array(want), 8)


@pytest.mark.parametrize("term", [Bond(Shift(1, "fixed"), Hertz(1.2, 0.8)), gx.OnSite(gx.Sine())])
def test_modulation_is_a_factor_of_force_and_energy(term):
    u = random_like((6,), 4)
    modulated = gx.Modulated(term, lambda t: 10 * t)
    assert_ulps(force(modulated, u=u), 3 * force(term, u=u), 4)
    assert_ulps(modulated.energy(0.3, u), 3 * term.energy(0.3, u), 4)
    assert not Lattice(MASS, modulated).conserves and Lattice(MASS, term).conserves


@pytest.mark.parametrize("site, where", [(2, 2), (-1, 5), ((3,), 3)])
def test_a_drive_acts_on_its_site(site, where):
    drive = gx.Drive(Harmonic(2.0, 3.0, 0.5, mean=0.1), site)
    want = np.zeros(6)
    want[where] = 0.1 + 2 * np.cos(3 * 0.7 + 0.5)
    assert_allclose(force(drive, u=jnp.zeros(6), t=0.7), want, rtol=8 * EPS)


def test_a_drive_of_a_site_on_a_grid_is_a_vector():
    drive = gx.Drive(lambda t: jnp.array([t, -t]), (1, 2))
    got = force(drive, u=jnp.zeros((2, 3, 2)), t=0.5, mass=1.0, sites=(2, 3), dimension=2)
    assert np.array_equal(got[1, 2], [0.5, -0.5]) and float(jnp.abs(got).sum()) == 1.0
