import jax.numpy as jnp
import numpy as np
import pytest
from cases import ALL_TERMS, EPS, assert_ulps, over, random_like

import granjax as gx

MASS = np.array([1.0, 0.5, 1.0, 0.7, 1.2, 0.9])


def force(*terms, u, v=None, t=0.3, mass=MASS, **how):
    lattice = gx.Lattice(mass, terms, **how)
    return lattice.force(t, u, jnp.zeros_like(u) if v is None else v)


@pytest.mark.slow
@over([case for case in ALL_TERMS if case.lattice.reads_velocity])
def test_friction_never_does_positive_work(case):
    u, v = random_like(case.lattice.template(), 0), random_like(case.lattice.template(), 1)
    work = np.asarray(v * case.lattice.force(0.3, u, v)).sum()
    assert work < 0
    assert_ulps(case.lattice.force(0.3, u, jnp.zeros_like(v)), jnp.zeros_like(v), 0, 1.0)
    assert not case.lattice.conserves


def test_damping_and_dashpot_by_hand():
    u, v = jnp.zeros(3), jnp.array([1.0, 3.0, -2.0])
    mass = np.array([1.0, 2.0, 4.0])
    assert_ulps(force(gx.Damping(0.5), u=u, v=v, mass=mass), np.array([-0.5, -3.0, 4.0]), 2)
    # rates of compression -2 and 5
    got = force(gx.Dashpot(gx.Shift(1, "free"), np.array([0.1, 1.0])), u=u, v=v, mass=mass)
    assert_ulps(got, np.array([0.2, -5.2, 5.0]), 4)


@pytest.mark.slow
def test_dashpot_damps_along_the_bond_alone():
    dashpot = gx.Dashpot(gx.Stretch(gx.Shift(1, "free"), [0.0, 2.0]), 0.5)
    u = jnp.zeros((2, 2))
    across, along = jnp.array([[1.0, 0.0], [0.0, 0.0]]), jnp.array([[0.0, 1.0], [0.0, 0.0]])
    how = dict(u=u, mass=np.ones(2), dimension=2)
    assert_ulps(force(dashpot, v=across, **how), np.zeros((2, 2)), 2, 1.0)
    assert_ulps(force(dashpot, v=along, **how), np.array([[0, -0.5], [0, 0.5]]), 4)


@pytest.mark.parametrize("sites", [2, 3])
def test_rates_and_stiffnesses_per_site_hold_in_the_plane(sites):
    """One rate per site means that site's vector, also where there are as many sites as directions."""
    rate = np.arange(1.0, sites + 1)
    v = jnp.ones((sites, 2))
    how = dict(u=v, v=v, mass=np.ones(sites), dimension=2)
    want = -np.repeat(rate[:, None], 2, 1)
    assert_ulps(force(gx.Damping(rate), **how), want, 2)
    assert_ulps(force(gx.OnSite(gx.Linear(rate)), **how), want, 2)


@pytest.mark.slow
@pytest.mark.parametrize("law", [gx.Hertz(), gx.Hertz(1.2, 0.8), gx.PowerLaw(1.0, -3.0, 1.0)])
@pytest.mark.parametrize("support", [None, 3.0])
def test_left_and_right_walls_are_mirror_images(law, support):
    u = random_like((6,), 2, 0.3)
    move = gx.Harmonic(0.3, 1.7, 0.4)
    mirrored = gx.Harmonic(-0.3, 1.7, 0.4)
    left, right = gx.Wall(law, "left", move, support), gx.Wall(law, "right", mirrored, support)
    assert_ulps(force(left, u=u), -force(right, u=-u[::-1])[::-1], 4)
    assert_ulps(left.energy(0.3, u), right.energy(0.3, -u[::-1]), 4)


def test_driven_wall_by_hand():
    u = jnp.array([0.1, 0.0, -0.2])
    how = dict(u=u, mass=np.ones(3), t=2.0)
    # the left wall stands at 0.5 and presses the first site by 0.4; the right one at -0.6 the last by 0.4
    got = force(gx.Wall(gx.Hertz(), "left", lambda t: 0.25 * t), **how)
    assert_ulps(got, np.array([0.4**1.5, 0, 0]), 8)
    got = force(gx.Wall(gx.Hertz(), "right", lambda t: -0.3 * t), **how)
    assert_ulps(got, np.array([0, 0, -(0.4**1.5)]), 8)
    away = force(gx.Wall(gx.Hertz(), "left", lambda t: -0.25 * t), **how)
    assert np.all(np.asarray(away) == 0)


@pytest.mark.parametrize("support", [1e9, 1e12, 1e15])
def test_a_yielding_wall_with_a_huge_support_is_rigid(support):
    u = jnp.array([0.0, 0.0, 0.3])
    how = dict(u=u, mass=np.ones(3))
    got = force(gx.Wall(gx.Hertz(), "right", support=support), **how)
    np.testing.assert_allclose(
        got, force(gx.Wall(gx.Hertz(), "right"), **how), rtol=2 / support + 16 * EPS
    )


def test_free_chain_with_walls_is_the_fixed_chain():
    u = random_like((6,), 3, 0.4)
    law = gx.Hertz(1.2, 0.8)
    walls = gx.Wall(law, "left"), gx.Wall(law, "right")
    walled, fixed = gx.Bond(gx.Shift(1, "free"), law), gx.Bond(gx.Shift(1, "fixed"), law)
    assert_ulps(force(walled, *walls, u=u), force(fixed, u=u), 8)


@pytest.mark.parametrize(
    "term", [gx.Bond(gx.Shift(1, "fixed"), gx.Hertz(1.2, 0.8)), gx.OnSite(gx.Sine())]
)
def test_modulation_by_one_is_the_bare_term(term):
    u = random_like((6,), 4)
    modulated = gx.Modulated(term, lambda t: 1.0)
    assert_ulps(force(modulated, u=u), force(term, u=u), 4)
    assert_ulps(modulated.energy(0.3, u), term.energy(0.3, u), 4)
    twice = gx.Modulated(term, lambda t: 2 * t)
    assert_ulps(force(twice, u=u, t=1.0), 2 * force(term, u=u), 4)
    assert not gx.Lattice(MASS, twice).conserves and gx.Lattice(MASS, term).conserves


@pytest.mark.parametrize("site, where", [(0, 0), (2, 2), (-1, 5), ((3,), 3)])
def test_a_drive_acts_on_its_site(site, where):
    got = np.asarray(
        force(gx.Drive(gx.Harmonic(2.0, 3.0, 0.5, mean=0.1), site), u=jnp.zeros(6), t=0.7)
    )
    want = np.zeros(6)
    want[where] = 0.1 + 2 * np.cos(3 * 0.7 + 0.5)
    np.testing.assert_allclose(got, want, rtol=8 * EPS)


def test_a_drive_of_a_site_on_a_grid_is_a_vector():
    drive = gx.Drive(lambda t: jnp.array([t, -t]), (1, 2))
    got = force(drive, u=jnp.zeros((2, 3, 2)), t=0.5, mass=np.ones((2, 3)), dimension=2)
    assert np.array_equal(got[1, 2], [0.5, -0.5]) and float(jnp.abs(got).sum()) == 1.0


def test_very_heavy_resonators_are_a_tie_to_the_rest_position():
    u = random_like((6,), 5)
    chain = gx.Bond(gx.Shift(1, "fixed", "bead"), gx.Hertz())
    cell = gx.Lattice(
        {"bead": MASS, "resonator": np.full(6, 1e300)},
        (chain, gx.Bond(gx.Shift(0, "free", ("bead", "resonator")), gx.Linear(0.7))),
    )
    tied = gx.Lattice(MASS, (gx.Bond(gx.Shift(1, "fixed"), gx.Hertz()), gx.OnSite(gx.Linear(0.7))))
    both = {"bead": u, "resonator": jnp.zeros(6)}
    a = cell.acceleration(0.0, both, cell.zeros())
    assert_ulps(a["bead"], tied.acceleration(0.0, u, jnp.zeros(6)), 8)
    assert float(jnp.abs(a["resonator"]).max()) < 1e-299
