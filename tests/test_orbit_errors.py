"""What an orbit says of its own error, against orbits that granjax did not compute."""

import jax.numpy as jnp
import numpy as np
import pytest
from known_orbits import covers, period_of, reference, shaken

import granjax as gx
from granjax.driven import driven_chain
from granjax.forced import forced_branch, forced_orbit
from granjax.orbits.scales import nonlinear_length

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("name", ("hard_pair", "light_centred", "forced_branch_upper"))
def test_the_stated_error_covers_the_truth_and_is_what_was_asked_for(name):
    known = reference(name)
    size = np.abs(known.u).max()
    for tolerance in (1e-8, 1e-4, 1e-10):
        orbit = known.ask(tolerance=tolerance)
        covers(orbit, known)
        assert orbit.error.state.u.max() <= tolerance * 3 * size and orbit.error.omega == 0
    # by steps of one's own: nothing is refined, the error is stated all the same
    orbit = known.ask(steps=64)
    covers(orbit, known)
    assert orbit.flow.steps == 64 and (orbit.error.state.u.max() > 1e-7 * size) == known.opened


@pytest.mark.parametrize("name", ("defect", "forced_opening"))
def test_the_stated_error_covers_the_truth_where_contacts_open(name):
    known = reference(name)
    for keywords in ({}, {"steps": 48}, {"steps": 200}):
        covers(known.ask(**keywords), known)


def test_a_branch_of_forced_orbits_states_its_error():
    known = reference("forced_branch_upper")
    branch = forced_branch(
        lambda w: shaken(3, 0.03, w, 0.02, phase=(0.0, np.pi)),
        known.omega,
        1.685,
        period=period_of,
        guess=known.state,
        points=4,
    )
    covers(branch.orbit(0), known)
    assert np.all(branch.state_error.u < 1e-6) and np.all(branch.energy_error < 1e-5)
    true = np.sqrt(np.mean(branch.orbit(0).rms_velocity ** 2))
    assert abs(branch.response[0] - true) <= branch.response_error[0] < 1e-6


def test_errors_of_forced_branches_cover_what_opening_contacts_make_uneven():
    def make(amplitude):
        chain = gx.scenes.monomer(4, precompression=0.05**1.5)
        return driven_chain(chain, amplitude, 1.2, damping=0.15, ends="left")

    period = 2 * np.pi / 1.2
    branch = forced_branch(make, 0.055, 0.075, period=period, steps=24)
    for i in range(len(branch)):
        mine = branch.orbit(i)
        truth = forced_orbit(make(float(branch.p[i])), period, mine.state, steps=1024)
        for x, error, y in zip(mine.state, mine.error.state, truth.state):
            assert np.all(np.abs(x - y) <= error)
        response = np.sqrt(np.mean(truth.rms_velocity**2))
        assert abs(branch.response[i] - response) <= branch.response_error[i]


def test_at_a_given_energy_the_frequency_has_an_error():
    known = reference("family")
    orbit = gx.breathers.breather(
        known.lattice, 1.001 * known.omega, known.state, energy=known.energy, check=False
    )
    assert abs(orbit.omega - known.omega) <= orbit.error.omega < 1e-7
    in_period = known.period / known.omega * float(orbit.error.omega)
    assert float(orbit.error.period) == pytest.approx(in_period, rel=1e-6)


@pytest.mark.parametrize(
    "law, length",
    [
        # F' = 1.5 sqrt(1 + e) halves at e = -3/4, with e = 2 u
        (gx.Hertz(1.0, 1.0), 0.375),
        # F' = 1 + 3 e^2 is half as much again at e = 1/sqrt6
        (gx.Polynomial(1.0, 0.0, 1.0), 6**-0.5 / 2),
        # just above a power of two
        (gx.Polynomial(1.0, 0.0, 0.505**-2 / 6), 0.2525),
        (gx.Linear(), np.inf),
        (gx.Hertz(1.0), 0.0),
    ],
)
def test_the_length_at_which_a_lattice_is_no_longer_linear(law, length):
    chain = gx.Lattice(np.ones(6), (gx.Bond(gx.Shift(1, "periodic"), law),))
    zigzag = jnp.asarray([1.0, -1.0] * 3)
    assert nonlinear_length(chain, zigzag) == pytest.approx(length, rel=1e-9, abs=0)
