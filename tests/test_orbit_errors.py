"""What an orbit says of its own error, against orbits that granjax did not compute."""

import jax.numpy as jnp
import numpy as np
import pytest
from cases import few
from known_orbits import LATTICES, reference

import granjax as gx
from granjax.driven import driven_chain
from granjax.forced import forced_branch, forced_orbit
from granjax.orbits.scales import nonlinear_length


def ask(known, **keywords):
    guess = gx.State(jnp.asarray(known.u), jnp.asarray(known.v))
    if known.lattice.reads_time:
        return forced_orbit(known.lattice, 2 * np.pi / known.omega, guess, **keywords)
    return gx.breathers.breather(known.lattice, known.omega, guess, check=False, **keywords)


def covers(orbit, known):
    """Every displacement, velocity and the energy lie within the stated error of the truth."""
    for x, error, truth in zip(orbit.state, orbit.error.state, (known.u, known.v)):
        assert np.all(np.abs(x - truth) <= error + 2 * known.error)
    assert abs(orbit.energy - known.energy) <= orbit.error.energy + known.energy_error


@pytest.mark.slow
@pytest.mark.parametrize("name", ("hard_pair", "light_centred", "forced_branch_upper"))
def test_the_stated_error_covers_the_truth_and_is_what_was_asked_for(name):
    known = reference(name)
    size = np.abs(known.u).max()
    for tolerance in (1e-8, 1e-4, 1e-6):
        orbit = ask(known, tolerance=tolerance)
        covers(orbit, known)
        assert orbit.error.state.u.max() <= tolerance * 3 * size and orbit.error.omega == 0
    # by steps of one's own: nothing is refined, the error is stated all the same
    orbit = ask(known, steps=64)
    covers(orbit, known)
    assert orbit.flow.steps == 64 and (orbit.error.state.u.max() > 1e-7 * size) == known.opened


@pytest.mark.study
@pytest.mark.parametrize(
    "name", few([n for n in LATTICES if n not in ("light_centred", "hard_pair")], 0, -1)
)
def test_other_orbits_too(name):
    known = reference(name)
    for keywords in (
        {},
        {"tolerance": 1e-5},
        {"tolerance": 1e-10},
        {"steps": 48},
        {"steps": 64},
        {"steps": 200},
    ):
        covers(ask(known, **keywords), known)


@pytest.mark.study
def test_the_light_centred_breather_from_its_family():
    known = reference("light_centred")
    family = gx.breathers.family(known.lattice, until=known.omega, stability=False)
    at_the_end = family.orbit(-1)
    covers(at_the_end, known)
    assert family.energy[-1] == pytest.approx(2.341574, abs=1e-6) and family.energy_error[-1] < 1e-6
    # what starts from the family is no coarser than it
    covers(gx.breathers.breather(known.lattice, known.omega, at_the_end, check=False), known)


@pytest.mark.study
def test_a_branch_of_forced_orbits_states_its_error():
    known, chain = reference("forced_branch_upper"), gx.scenes.monomer(3, precompression=1.0)
    branch = forced_branch(
        lambda w: driven_chain(chain, 0.03, w, damping=0.02, phase=(0.0, np.pi)),
        known.omega,
        1.685,
        period=lambda w: 2 * jnp.pi / w,
        guess=gx.State(jnp.asarray(known.u), jnp.asarray(known.v)),
        points=4,
    )
    covers(branch.orbit(0), known)
    assert np.all(branch.state_error.u < 1e-6) and np.all(branch.energy_error < 1e-5)
    true = np.sqrt(np.mean(branch.orbit(0).rms_velocity ** 2))
    assert abs(branch.response[0] - true) <= branch.response_error[0] < 1e-6


@pytest.mark.slow
def test_at_a_given_energy_the_frequency_has_an_error():
    known = reference("family")
    guess = gx.State(jnp.asarray(known.u), jnp.asarray(known.v))
    orbit = gx.breathers.breather(
        known.lattice, 1.001 * known.omega, guess, energy=known.energy, check=False
    )
    assert abs(orbit.omega - known.omega) <= orbit.error.omega < 1e-7
    assert float(orbit.error.period) == pytest.approx(
        2 * np.pi / known.omega**2 * float(orbit.error.omega), rel=1e-6
    )


# units ---------------------------------------------------------------------------------------------------------------


def test_the_length_at_which_a_lattice_is_no_longer_linear():
    zigzag = jnp.asarray([1.0, -1.0] * 3)
    chain = lambda law: gx.Lattice(np.ones(6), (gx.Bond(gx.Shift(1, "periodic"), law),))
    # F' = 1.5 sqrt(1 + e) halves at e = -3/4, with e = 2 u
    assert nonlinear_length(chain(gx.Hertz(1.0, 1.0)), zigzag) == pytest.approx(0.375, rel=1e-9)
    # F' = 1 + 3 e^2 is half as much again at e = 1/sqrt6
    assert nonlinear_length(chain(gx.Polynomial(1.0, 0.0, 1.0)), zigzag) == pytest.approx(
        6**-0.5 / 2, rel=1e-9
    )
    assert nonlinear_length(chain(gx.Linear()), zigzag) == np.inf
    assert nonlinear_length(chain(gx.Hertz(1.0)), zigzag) == 0


@pytest.mark.study
def test_errors_of_forced_branches_cover_what_opening_contacts_make_uneven():
    def make(amplitude):
        chain = gx.scenes.monomer(4, precompression=0.05**1.5)
        return driven_chain(chain, amplitude, 1.2, damping=0.15, ends="left")

    period = 2 * np.pi / 1.2
    for keywords in ({"steps": 24}, {"tolerance": 1e-3}):
        branch = forced_branch(make, 0.055, 0.075, period=period, **keywords)
        for i in range(len(branch)):
            mine = branch.orbit(i)
            truth = forced_orbit(make(float(branch.p[i])), period, mine.state, steps=2048)
            for x, error, y in zip(mine.state, mine.error.state, truth.state):
                assert np.all(np.abs(x - y) <= error)
            assert (
                abs(branch.response[i] - np.sqrt(np.mean(truth.rms_velocity**2)))
                <= branch.response_error[i]
            )


def test_tolerances_that_a_floating_type_cannot_hold_are_refused():
    chain = gx.scenes.fput(5, alpha=0.0, beta=1.0)
    with pytest.raises(
        ValueError, match="tolerance: expected at least 1.1e-14, what float64 can hold"
    ):
        gx.breathers.family(chain, points=2, tolerance=1e-15)
