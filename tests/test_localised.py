"""A breather is localised or has a dip, and is found where the linear modes lead to waves."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest
from cases import ended
from known_orbits import dimer, hard, reference
from refusals import refused

import granjax as gx
from granjax.orbits import guesses as sites_module
from granjax.orbits.guesses import dark_guess
from granjax.orbits.localised import Localisation, checked_localised, localisation

single_site = gx.breathers.guesses.single_site
CUBIC = gx.OnSite(gx.Polynomial(1.0, 0.0, 1.0))


def springs(stiffness, offset=1, **how):
    return gx.Bond(gx.Shift(offset, "periodic", **how), gx.Linear(stiffness))


def soft(sites=8, coupling=0.1, boundary="periodic"):
    """u'' = -u + u^3 + C D2 u."""
    bonds = gx.Bond(gx.Shift(1, boundary), gx.Linear(coupling))
    return gx.Lattice(1.0, (bonds, gx.OnSite(gx.Polynomial(1.0, 0.0, -1.0))), sites=sites)


def still(u):
    return gx.State(jnp.asarray(u, float), jnp.zeros(len(u)))


def shared(lattice, u):
    """Participation number of the cells."""
    return localisation(lattice, still(u)).participation


@pytest.fixture(scope="module")
def on_a_ring():
    return gx.breathers.breather(soft(), 0.8)


@pytest.mark.slow
def test_a_ring_whose_uniform_mode_softens_has_a_breather_all_the_same(on_a_ring):
    found = localisation(soft(), on_a_ring.state)
    assert found.participation < 2 and found.bright and on_a_ring.converged
    assert f"{found.participation:.3g} of 8 cells share its energy." in on_a_ring.outcome
    u = np.asarray(on_a_ring.state.u)
    assert u[4] == u.max() > 0.8 and u[0] < 0.01


@pytest.mark.slow
def test_a_uniform_oscillation_is_no_breather():
    uniform = still(np.full(8, 0.685))
    said = "Not localised: 8 of 8 cells .*participation number; of the guess 8"
    with pytest.raises(RuntimeError, match=said):
        gx.breathers.breather(soft(), 0.8, uniform)
    wave = gx.breathers.breather(soft(), 0.8, uniform, throw=False)
    assert not wave.converged and "without the dip" in wave.outcome
    assert gx.breathers.breather(soft(), 0.8, uniform, check=False).converged


@pytest.mark.slow
def test_a_localised_guess_that_leads_to_a_wave_is_refused():
    # too short a ring for a breather this wide: it leaves the uniform oscillation at larger amplitudes alone
    short = soft(coupling=0.5)
    bump = still(0.4 * np.exp(-((np.arange(8) - 4) ** 2) / 2))
    assert localisation(short, bump).bright
    with pytest.raises(RuntimeError, match=r"Not localised: 8 of 8 cells .*of the guess [1-4]"):
        gx.breathers.breather(short, 0.98, bump)


@pytest.mark.slow
def test_where_there_is_no_breather_both_ways_are_named():
    way = "its frequency goes from 1.* at a linear mode to 0.* at the amplitude"
    said = f"did not reach omega = 1.3: {way} .* No breather about a site was found either"
    with pytest.raises(RuntimeError, match=said):
        gx.breathers.breather(soft(), 1.3)


@pytest.mark.slow
@pytest.mark.parametrize("omega, sites, signs", [(1.05, 5, None), (1.2, [5, 6], [1, -1])])
def test_newtons_cradle_has_breathers(omega, sites, signs):
    """Pendulums of frequency 1 with Hertz contacts, without precompression, turn after half a period of SciPy's."""
    terms = gx.Bond(gx.Shift(1, "free"), gx.Hertz()), gx.OnSite(gx.Linear(1.0))
    lattice = gx.Lattice(1.0, terms, sites=11)
    b = gx.breathers.breather(lattice, omega, single_site(lattice, omega, sites, amplitudes=signs))
    u = np.asarray(b.state.u)
    assert b.converged and np.argmax(np.abs(u)) == 5 and shared(lattice, u) < 4

    def field(t, y):
        s = np.maximum(y[:10] - y[1:11], 0) ** 1.5
        return np.concatenate([y[11:], np.append(0, s) - np.append(s, 0) - y[:11]])

    turned = ended(field, np.pi / omega, np.append(u, 0 * u))
    assert np.abs(turned[11:]).max() < 1e-5 * np.abs(u).max()


@pytest.mark.slow
def test_a_site_between_soft_ones_need_not_have_the_frequency_alone():
    # C = 1/2: alone between its neighbours it has sqrt 2 at most, and escapes before 0.8
    u = np.asarray(single_site(soft(21, 0.5), 0.8, 10).u)
    assert np.argmax(u) == 10 and shared(soft(21, 0.5), u) < 4 and u[0] < 1e-3


def test_a_site_of_an_uneven_potential_turns_where_its_energy_says():
    # V = u^2/2 - u^3/3 and two bonds: one harmonic about zero has the linear frequency at every amplitude
    uneven = gx.OnSite(gx.Polynomial(1.0, -1.0, 0.0))
    lattice = gx.Lattice(1.0, (springs(0.02), uneven), sites=8)
    up, down = (single_site(lattice, 0.8, 4, amplitudes=[a]) for a in (1, -1))
    beside, right = map(float, up.u[3:5])
    left = float(down.u[4])
    assert left < 0 < beside < right < 1 and right > -left
    energy = lambda u: u**2 / 2 - u**3 / 3 + 0.02 * (u - beside) ** 2
    assert energy(right) == pytest.approx(energy(left), rel=1e-9)


@pytest.mark.slow
def test_a_site_of_a_field_and_of_a_grid():
    bead = gx.OnSite(gx.Polynomial(1.0, 0.0, 1.0), field="bead")
    resonator = gx.OnSite(gx.Linear(2.0), field="resonator")
    within = springs(0.05, 0, fields=("bead", "resonator"))
    terms = springs(0.05, fields=("bead", "bead")), bead, resonator, within
    cells = gx.Lattice({"bead": np.ones(8), "resonator": np.full(8, 0.3)}, terms)
    found = single_site(cells, 1.6, 4, field="bead")
    spread = localisation(cells, found)
    assert np.argmax(found.u["bead"]) == 4 and spread.participation < 1.5 and spread.cells == 8
    # as for states, the field of the beads where none is named
    np.testing.assert_array_equal(single_site(cells, 1.6, 4).u["bead"], found.u["bead"])
    with refused("field: expected one of 'bead', 'resonator'"):
        single_site(cells, 1.6, 4, field="beads")
    grid = gx.Lattice(np.ones((4, 4)), (springs(0.02, (1, 0)), springs(0.02, (0, 1)), CUBIC))
    assert np.argmax(single_site(grid, 1.6, (1, 2)).u) == 6


@pytest.mark.parametrize(
    "call, words",
    [
        (lambda: gx.breathers.breather(soft(), 0.8, still(np.zeros(8))), "guess.u: .*not all zero"),
        (lambda: gx.breathers.breather(soft(), 0.8, still([np.nan] * 8)), "guess.u: .*finite"),
        (lambda: single_site(hard(), 1.4, [2, 4], amplitudes=[1]), "amplitudes"),
        (lambda: single_site(hard(), 1.4, [2, 4], amplitudes=[1, 0]), "amplitudes"),
    ],
)
def test_guesses_that_cannot_be_are_refused(call, words):
    with refused(words):
        call()


@pytest.mark.parametrize("boundary", ["fixed", "periodic"])
def test_what_is_bright_dark_or_a_wave(boundary):
    chain = gx.scenes.monomer(24, precompression=1.0, boundary=boundary)
    n = np.arange(24)
    staggered = 0.1 * (-1.0) ** n
    wave = localisation(chain, still(staggered))
    assert not wave.dark and not wave.bright and wave.dip > 0.9
    walls = localisation(chain, still(staggered * np.sin(np.pi * (n + 0.5) / 24)))
    assert not walls.dark and not walls.bright and 15 < walls.participation < 17
    dark = localisation(chain, dark_guess(chain, 0.97 * 6**0.5))
    assert dark.dark and dark.dip < 0.1
    bright = localisation(chain, still(staggered / np.cosh((n - 12) / 2)))
    assert bright.bright and not bright.dark and not bright.fills
    assert dark.why_not("dark", dark) is bright.why_not("bright", bright) is None
    assert "there is no background" in bright.why_not("dark", dark)
    assert "its least energy is" in wave.why_not("dark", dark)
    assert "Not localised" in wave.why_not("any", wave)
    assert "of the guess" in wave.why_not("bright", bright) and dark.why_not("any", wave) is None


def test_what_strays_far_from_a_localised_guess_is_refused():
    guess = Localisation(2.0, 40, 3.0)
    found = Localisation(22.0, 40, 3.0)
    assert found.bright and "22 of 40 cells" in found.why_not("bright", guess)
    assert found.why_not("any", guess) is found.why_not("bright", found) is None


def test_the_measure_counts_cells_and_no_shifts():
    u = reference("light_centred").u
    lattice = dimer(41)
    found = localisation(lattice, still(u))
    # displaced by a third on either side, at rest there: energy says where the breather is
    assert np.abs(u[[0, -1]]).min() > 0.3 and found.participation < 3 and found.cells == 21
    assert shared(lattice, u + 5.0) == pytest.approx(found.participation)


@pytest.mark.slow
def test_a_dark_word_that_leads_to_a_bright_orbit_is_refused(on_a_ring):
    orbit = dataclasses.replace(on_a_ring, remark="")
    with pytest.raises(RuntimeError, match="Not a dark breather: .* of 8 cells .* no background"):
        checked_localised(orbit, "dark", on_a_ring.state, None)
    assert checked_localised(orbit, "bright", on_a_ring.state, None).remark == on_a_ring.remark


@pytest.mark.slow
def test_of_few_cells_nothing_is_judged():
    # two coupled sites in phase
    few = gx.breathers.breather(soft(2, boundary="free"), 0.8, still(np.full(2, 0.685)))
    assert few.converged and "2 of 2 cells share its energy." in few.outcome


def test_sites_of_small_masses_are_told_apart(monkeypatch):
    asked = []
    note = lambda lattice, omega, site, field: asked.append(site)
    monkeypatch.setattr(sites_module, "single_site", note)
    terms = springs(1e-10), gx.OnSite(gx.Polynomial(1e-9, 0.0, 1e-9))
    list(sites_module.local_guesses(gx.Lattice([1e-9, 3e-9] * 4, terms), 1.5))
    assert asked == [4, 5]
