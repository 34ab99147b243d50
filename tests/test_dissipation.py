"""Energy to the last joule, viscoelastic restitution, fronts of viscoelastic contacts."""

import numpy as np
import pytest
from refusals import refused

import granjax as gx

FREE = gx.Shift(1, "free")
WALLS = gx.Shift(1, "fixed")


@pytest.mark.slow
def test_the_energy_of_every_loss_and_drive_balances():
    terms = (
        gx.BrilliantovContact(WALLS, 1.0, 0.1, 0.2),
        gx.Damping(0.05),
        gx.Drive(gx.Harmonic(0.1, 0.8), 1),
        gx.Modulated(gx.OnSite(gx.Linear(0.3)), gx.Harmonic(0.2, 1.1, mean=1.0)),
        gx.Dashpot(WALLS, 0.02),
        gx.ViscousContact(WALLS, 0.1, overlap=0.1),
        gx.Drag(0.1),
        gx.Wall(gx.Hertz(1.2, 0.2), "left", motion=gx.Harmonic(0.05, 1.7)),
    )
    lattice = gx.Lattice(1.0, terms, sites=5)
    start = gx.states.impact(lattice, velocity=0.4)
    power = gx.Integral(lambda t, y, lattice: gx.measures.power(lattice, y, t))
    run = gx.simulate(lattice, start, 6.0, tolerance=1e-11, record={"work": power})
    gained = gx.measures.energy(lattice, run.final, 6.0) - gx.measures.energy(lattice, start)
    assert abs(gained - run.recorded["work"]) < 1e-9 * abs(gained) and abs(gained) > 1e-3


def restitution(terms, speed):
    lattice = gx.Lattice(1.0, terms, sites=2)
    run = gx.simulate(lattice, gx.State(np.zeros(2), np.array([speed, 0.0])), 8.0, tolerance=1e-11)
    return float(run.final.v[1] - run.final.v[0]) / speed


@pytest.mark.slow
@pytest.mark.parametrize(("time", "speed"), [(0.01, 0.7), (0.03, 0.5)])
def test_restitution_of_viscoelastic_spheres(time, speed):
    wanted = float(gx.theory.restitution.viscoelastic(speed, 1.3, time))
    x = 1.5 * time * (1.3 / 0.5) ** 0.4 * speed**0.2
    dashpot = gx.ViscousContact(FREE, 1.95 * time)
    kono = restitution((gx.Bond(FREE, gx.Hertz(1.3)), dashpot), speed)
    assert 0.4 < (wanted - kono) / x**3 < 0.6
    brilliantov = restitution((gx.BrilliantovContact(FREE, 1.3, time),), speed)
    # what does not pull gives a little more back
    assert brilliantov > kono and abs(brilliantov - wanted) < 0.03 * x**2


def test_a_viscoelastic_contact_never_pulls_and_rests_under_its_load():
    lattice = gx.Lattice(1.0, gx.BrilliantovContact(FREE, 1.0, 0.5), sites=2)
    u = np.array([0.01, 0.0])
    v = np.array([-1.0, 1.0])
    pushes = lattice.force(0.0, u, -v)
    assert np.all(lattice.force(0.0, u, v) == 0) and np.all(pushes == [-1, 1] * np.abs(pushes))
    held = gx.Lattice(1.0, gx.BrilliantovContact(WALLS, 1.0, 0.5, 0.3), sites=3)
    assert np.abs(held.force(0.0, held.zeros(), held.zeros())).max() < 1e-16
    dashpot = gx.ViscousContact(WALLS, 0.75, overlap=0.3 ** (2 / 3))
    alone = gx.Lattice(1.0, (gx.Bond(WALLS, gx.Hertz(1.0, 0.3)), dashpot), sites=3)
    u = np.array([0.01, -0.02, 0.03])
    v = np.array([0.02, 0.01, -0.02])
    assert np.allclose(held.force(0.0, u, v), alone.force(0.0, u, v), rtol=1e-13)
    with refused("dissipative_time"):
        gx.BrilliantovContact(FREE, 1.0, -1.0)


@pytest.mark.slow
@pytest.mark.parametrize("part", [0.4, 2.0])
def test_a_viscoelastic_front_oscillates_below_the_critical_dashpot_of_its_linearisation(part):
    """Behind the front contacts of overlap y act as dashpots c y^{1/2}: the front of these says which is critical."""
    critical = float(gx.shocks.dissipative_front(gx.Hertz(), 1.0, dashpot=1.0).critical)
    piston = gx.Wall(gx.Hertz(), "left", motion=gx.terms.Function(lambda t: t))
    terms = gx.Bond(FREE, gx.Hertz()), gx.ViscousContact(FREE, part * critical), piston
    chain = gx.Lattice(1.0, terms, sites=70)
    run = gx.simulate(chain, gx.State(chain.zeros(), chain.zeros()), 50.0, tolerance=1e-8)
    strain = np.asarray(gx.measures.strain(chain, run.final, 50.0))
    highest = strain[25:].max()
    assert highest > 1.05 if part < 1 else highest < 1 + 1e-3
    # momentum: s = v/y and F(y) = s v for a piston of speed 1
    assert abs(np.interp(-0.5, -strain[40:60], np.arange(40, 60)) - 50) < 2


def test_a_chain_that_yields_by_its_materials():
    steel = "steel 316"
    size = gx.materials.yield_overlap(1.6e9, steel, 1e-2)
    modulus = 193e9 / (2 * (1 - 0.3**2))
    assert abs(size / ((np.pi * 1.6e9 / (2 * modulus)) ** 2 * 5e-3) - 1) < 1e-12
    for F0 in (0.0, 1e-3, 0.1):
        chain = gx.scenes.plastic(4, precompression=F0)
        law = chain.terms[0].law
        assert abs(law.preload - F0) < 1e-15
        assert np.abs(gx.Lattice.unbalanced(chain)[1:-1]).max() < 1e-15
        # as pressed, not as overlapping: the tangent goes on from Hertz
        assert (law.rest > 0.02) == (F0 > 0.02**1.5)
    with refused("yield_overlap"):
        gx.scenes.plastic(4, yield_overlap=np.ones(7))
