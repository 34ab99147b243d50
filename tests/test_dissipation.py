"""Energy to the last joule, viscoelastic restitution, fronts of viscoelastic contacts."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose
from refusals import refused

import granjax as gx
from granjax.terms.base import InOtherUnits

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


A = np.array([1.0, 1.3, 0.8, 1.1])
TIME = 0.4
F0 = 0.2
# One contact is pressed, one opens while it is still overlapping, one does not touch.
PLACES = np.array([0.1, -0.3, 0.4])
SPEEDS = np.array([-0.2, 1.5, 3.0])


def on_contacts(u, v, factor=1.0):
    s = (F0 / A) ** (2 / 3) - np.diff(u, prepend=0, append=0)
    rate = -np.diff(v, prepend=0, append=0)
    root = np.sqrt(np.maximum(s, 0))
    return factor * np.maximum(A * (root**3 + 1.5 * TIME * root * rate), 0)


def test_the_force_of_a_viscoelastic_contact_is_the_one_on_its_ends():
    contact = gx.BrilliantovContact(WALLS, A, TIME, F0)
    wanted = on_contacts(PLACES, SPEEDS)
    assert (wanted > 0).sum() == 2
    state = gx.State(jnp.asarray(PLACES), jnp.asarray(SPEEDS))
    double = gx.Modulated(contact, lambda t: 2.0 + 0 * t)
    for term, factor in (contact, 1.0), (double, 2.0):
        lattice = gx.Lattice(1.0, term, sites=3)
        force = gx.measures.contact_force(lattice, state)
        assert_allclose(force, factor * wanted, rtol=1e-13)
        assert_allclose(force[:-1] - force[1:], lattice.force(0.0, *state), atol=1e-14)
        read = gx.measures.sensor_force(lattice, state)
        assert_allclose(read, factor * (wanted[:-1] + wanted[1:]) / 2, rtol=1e-13)
    units = gx.Units(2.0, 0.01, 1e-3)
    for term in contact.in_units(units), InOtherUnits(double, units):
        factor = 2.0 if isinstance(term, InOtherUnits) else 1.0
        scaled = gx.State(state.u / units.length, state.v / units.velocity)
        force = gx.measures.contact_force(gx.Lattice(1.0, term, sites=3), scaled)
        assert_allclose(force, factor * wanted / units.force, rtol=1e-12)


@pytest.mark.slow
def test_the_force_of_a_viscoelastic_contact_in_lanes_its_derivatives_and_about_an_equilibrium():
    def lattice(time):
        return gx.Lattice(1.0, gx.BrilliantovContact(WALLS, A, time, F0), sites=3)

    one = lattice(TIME)
    batch = jax.vmap(lattice, out_axes=-1)(jnp.array([0.0, TIME]))
    state = gx.State(jnp.asarray(PLACES), jnp.asarray(SPEEDS))
    both = jax.tree.map(lambda x: jnp.stack([x, x], -1), state)
    force = gx.measures.contact_force(batch, both)
    assert_allclose(force[:, 1], on_contacts(*state), rtol=1e-13)
    assert_allclose(
        force[:, 0],
        A
        * jnp.maximum(one.terms[0].law.overlap(one.terms[0].strain_map.strain(state.u)), 0) ** 1.5,
    )

    def found(x):
        return gx.measures.contact_force(one, gx.State(x[:3], x[3:]))

    x = np.concatenate(state)
    by_differences = np.stack(
        [
            (on_contacts(*np.split(x + h, 2)) - on_contacts(*np.split(x - h, 2))) / 2e-6
            for h in 1e-6 * np.eye(6)
        ],
        -1,
    )
    for jacobian in jax.jacfwd(found)(x), jax.jacrev(found)(x):
        assert_allclose(jacobian, by_differences, atol=1e-8)
    pressed = gx.equilibrium(one, loads=jnp.array([0.1, 0.0, -0.2]))
    moved = gx.State(pressed.state.u + state.u, state.v)
    assert_allclose(
        gx.measures.contact_force(pressed.lattice, state), on_contacts(*moved), rtol=1e-12
    )


@pytest.mark.slow
def test_the_impulse_of_a_viscoelastic_contact_is_the_momentum_that_it_gives():
    lattice = gx.Lattice(1.0, gx.BrilliantovContact(FREE, 1.0, 0.3), sites=2)
    start = gx.State(np.zeros(2), np.array([1.0, 0.0]))
    record = {"impulse": gx.Integral(gx.measures.contact_force)}
    run = gx.simulate(lattice, start, 8.0, tolerance=1e-10, record=record)
    assert_allclose(run.recorded["impulse"][0], run.final.v[1], rtol=1e-7)


@pytest.mark.slow
def test_a_viscoelastic_contact_is_found_from_forces_at_sensor_beads():
    def scene(p):
        return gx.Lattice(1.0, gx.BrilliantovContact(FREE, p["stiffness"], p["time"]), sites=3)

    true = {"stiffness": 1.3, "time": 0.15}
    start = gx.State(np.zeros(3), np.array([1.0, 0.0, 0.0]))
    run = gx.simulate(scene(true), start, 6.0, tolerance=1e-10, save_at=61)
    s = -np.diff(run.us, axis=1)
    root = np.sqrt(np.maximum(s, 0))
    force = np.maximum(1.3 * (root**3 + 0.225 * root * -np.diff(run.vs, axis=1)), 0)
    read = (np.pad(force, ((0, 0), (1, 0))) + np.pad(force, ((0, 0), (0, 1)))) / 2
    noise = 1e-3 * np.random.default_rng(0).normal(size=read.shape)
    traces = gx.Traces(run.ts, force=read + noise, sites=[0, 1, 2], sigma=1e-3)
    found = gx.fit(scene, {"stiffness": 1.0, "time": 0.1}, traces, state=start)
    for name, value in true.items():
        assert abs(found.parameters[name] - value) < 3 * found.deviations[name]
        assert found.deviations[name] < 0.01 * value


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
