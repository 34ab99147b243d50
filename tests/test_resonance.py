"""Transmission of dimer chains, its extrema, and the asymptotic anti-resonances."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from pytest import mark
from refusals import refused

import granjax as gx
from granjax.resonance import (
    Transmission,
    anti_resonance,
    contact_forces,
    decay_rate,
    oscillations,
    refine,
    resonance_map,
    squeeze_count,
    transmission,
)
from granjax.sweeps.function import program

# A = m = v = 1, peak contact force far down a struck monomer chain
MONOMER_FORCE = 0.63955423


def one_by_one(ratio, beads, t1, step):
    """The largest force on the wall, by a run of its own."""
    chain = gx.scenes.dimer(beads, ratio)
    wall = gx.Peak(lambda t, y, lattice: gx.measures.contact_force(lattice, y)[-1])
    run = gx.simulate(chain, gx.states.impact(chain), t1, record={"wall": wall}, step=step)
    return run.recorded["wall"]


@mark.slow
def test_a_sweep_is_what_single_runs_give():
    # more than one chunk, not sorted, without the monomer; each chunk has its own step, whose error is below 1e-6
    ratios = np.array([0.7, 0.05, 0.3, 0.59, 0.9, 0.1, 0.45, 0.2, 0.8, 0.5])
    sweep = transmission(ratios, 21)
    assert sweep.run_time == 41.5
    assert sweep.to_xarray().attrs["run_time_units"] == "(m^2/(A^2 v))^(1/5)"
    places = [0, 1, 9]
    found = [one_by_one(ratio, 21, 41.5, 0.02) for ratio in (*ratios[places], 1.0)]
    assert_allclose([*sweep.peak_force[places], sweep.reference], found, rtol=3e-6)
    assert_allclose(sweep.transmission, sweep.peak_force / sweep.reference, rtol=1e-15)


@mark.slow
def test_deepest_minimum_of_101_beads():
    # 0.2096 at 0.595; SciPy's DOP853 at tolerance 1e-10: cusp at 0.5944 with 0.208678
    sweep = transmission(np.append(np.linspace(0.575, 0.615, 9), 1.0))
    assert sweep.transmission[-1] == 1.0
    assert_allclose(sweep.transmission[4], 0.2096, rtol=0, atol=5e-5)
    found = refine(sweep, accuracy=1e-5)
    lowest = found.resonance_transmission.argmin()
    assert_allclose(found.resonances[lowest], 0.5944, rtol=0, atol=5e-5)
    assert_allclose(found.resonance_transmission[lowest], 0.208678, rtol=0, atol=2e-5)


@mark.slow
def test_the_default_step_is_accurate_enough():
    """Beside an eighth of it; over 200 ratios the largest error is 5.5e-6, at 0.587."""
    sweep = transmission([0.587], 101)
    chain = gx.scenes.dimer(101, 0.587)
    highest = gx.flow.frequency_bound(chain, gx.states.impact(chain), 0.0, sweep.run_time)
    fine = one_by_one(0.587, 101, sweep.run_time, 0.0625 / float(highest))
    assert_allclose(sweep.peak_force[0], fine, rtol=6e-6)


@mark.slow
def test_a_longer_run_meets_no_larger_force():
    ratios = np.linspace(0.05, 1, 8)
    usual = transmission(ratios, 101)
    longer = transmission(ratios, 101, run_time=2.5 * usual.run_time)
    assert_allclose(longer.transmission, usual.transmission, rtol=2e-6)


def refined(monkeypatch, ratios, forces, force, decay, accuracy):
    """`refine` where these functions of the mass ratio stand for the simulations."""
    monkeypatch.setattr(gx.resonance.finite, "peak_forces", lambda x, *_: force(x)[None])
    monkeypatch.setattr(gx.resonance.finite, "decay_rate", lambda x, *_: decay(x))
    sweep = Transmission(ratios, forces, forces / 2, 2.0, 3, 1.0)
    return refine(sweep, accuracy=accuracy)


def test_refinement_finds_a_minimum_and_a_cusp_of_known_places(monkeypatch):
    force = lambda x: np.where(x < 0.6, 2 + (x - 0.4321) ** 2, 2.2 - np.abs(x - 0.7123))
    # a pulse that loses nothing at 0.7123 and 0.9
    decay = lambda x: ((x - 0.7123) * (x - 0.9)) ** 2
    ratios = np.linspace(0.1, 0.95, 18)
    # one ratio twice, which differs by rounding, as what is computed there does
    ratios = np.append(ratios, ratios[4] * (1 + 1e-15))
    forces = force(ratios) + 1e-13 * (np.arange(19) == 18)
    found = refined(monkeypatch, ratios, forces, force, decay, 1e-5)
    assert_allclose(found.resonances, [0.4321], atol=1e-5)
    assert_allclose(found.resonance_transmission, [1.0], atol=1e-9)
    assert_allclose(found.anti_resonances, [0.7123], atol=1e-5)
    assert not len(found.local_extrema)
    assert_allclose(found.anti_resonance_transmission, [1.1], atol=1e-5)


def test_the_monomer_is_an_anti_resonance_where_the_transmission_rises_to_it(monkeypatch):
    ratios = np.linspace(0.1, 1.0, 19)
    for rises in (1, -1):
        force = lambda x: 2 + rises * (x - 0.4321) ** 2
        found = refined(monkeypatch, ratios, force(ratios), force, lambda x: (x - 0.4) ** 2, 1e-5)
        assert (1.0 in found.anti_resonances) == (rises > 0)


# transmissions over the mass ratio, made of cosines; places of anti-resonances; an extremum that is neither
SHAPES = {
    "ripples": (
        lambda x: np.cos(10 * np.pi * x) + 0.4 * np.cos(70 * np.pi * x),
        [0.2, 0.4, 0.6, 0.8],
        None,
    ),
    "a maximum without a zero": (lambda x: np.cos(10 * np.pi * x), [0.2, 0.6, 0.8], 0.4),
    "one beside a zero": (lambda x: np.cos(10 * np.pi * (x - 0.004)), [0.2, 0.4, 0.6, 0.8], None),
}


@mark.parametrize("shape", SHAPES)
def test_resonances_are_between_anti_resonances(shape, monkeypatch):
    """Where the decay has zeros there are anti-resonances, and between two of them one resonance, the deepest."""
    force, zeros, neither = SHAPES[shape]
    ratios, fine = (np.linspace(0.12, 0.92, count) for count in (161, 80001))
    decay = lambda x: np.min([(x - zero) ** 2 for zero in zeros], axis=0)
    found = refined(monkeypatch, ratios, force(ratios), force, decay, 1e-4)
    assert len(found.anti_resonances) == len(zeros)
    assert np.abs(found.anti_resonances - zeros).max() < 0.03
    for low, high in zip(zeros, zeros[1:]):
        here = fine[(fine > low) & (fine < high)]
        (own,) = found.resonances[(found.resonances > low) & (found.resonances < high)]
        assert_allclose(force(own), force(here).min(), rtol=0, atol=1e-5)
    assert neither is None or np.abs(found.local_extrema - neither).min() < 1e-3
    # nothing is lost
    rises = np.diff(force(ratios)) > 0
    count = np.count_nonzero(rises[1:] != rises[:-1])
    assert len(found.resonances) + len(found.anti_resonances) + len(found.local_extrema) == count


@mark.slow
def test_a_split_minimum_is_one_resonance():
    """0.5608, 0.5811, 0.5944 of 101 beads: the pulse decays at all three, so that none is an anti-resonance."""
    ratios = np.append(np.linspace(0.24, 0.36, 7), np.linspace(0.5, 0.66, 33))
    sweep = transmission(np.append(ratios, [0.8, 0.9, 0.95, 1.0]))
    found = refine(sweep, accuracy=2e-4)
    assert_allclose(found.resonances, [0.5944], atol=4e-4)
    assert_allclose(found.local_extrema, [0.5608, 0.5811], atol=4e-4)
    assert_allclose(found.anti_resonances[0], 0.3156, atol=4e-4)
    assert "resonances: 1, " in found.outcome and "local extrema: 2." in found.outcome


@mark.slow
def test_contact_forces_down_the_chain():
    forces = contact_forces([0.5, 1.0], (20, 40, 60))
    assert_allclose(forces[:, 0], [0.3019048, 0.2574079, 0.2309435], rtol=1e-6)
    assert_allclose(forces[:, 1], MONOMER_FORCE, rtol=3e-6)


@mark.slow
@mark.parametrize("centre", [0.2399, 0.1225])
def test_decay_is_fastest_at_the_second_and_third_resonance(centre):
    ratios = np.linspace(0.93 * centre, 1.07 * centre, 8)
    rates = decay_rate(ratios, (100, 200))
    assert np.all(rates > 0)
    tops = np.polynomial.Polynomial.fit(ratios, rates, 4).deriv().roots()
    tops = tops[np.abs(tops.imag) < 1e-12].real
    assert np.abs(tops - centre).min() < 1e-4


@mark.slow
@mark.parametrize(
    "low, high, expected", [(0.3, 0.4, 0.342846), (0.12, 0.18, 0.154751), (0.08, 0.1, 0.090128)]
)
def test_anti_resonances(low, high, expected):
    # literature: 0.3428, 0.1548, 0.0901
    found = anti_resonance(low, high, contacts=(60, 160))
    assert_allclose(found, expected, rtol=0, atol=3e-6)


@mark.slow
def test_the_monomer_is_an_anti_resonance_and_between_two_there_is_none():
    assert anti_resonance(0.9, 1.0, contacts=(40, 80)) == 1.0
    with pytest.raises(RuntimeError, match="no minimum inside"):
        anti_resonance(0.4, 0.5, contacts=(40, 80))


@mark.slow
def test_light_beads_swing_once_more_at_each_anti_resonance():
    found = oscillations([1.0, 0.342846, 0.154751, 0.090128, 0.0615, 0.6, 0.25])
    # at resonances half a swing stands between
    assert found.count.tolist() == [1, 2, 3, 4, 5, 1.5, 2.5]
    assert "1 to 5 times" in found.outcome


@mark.slow
def test_swings_of_exact_waves_are_those_of_simulations():
    xi = np.linspace(-9, 9, 3000)
    for count, ratio in ((2, 0.342845781150), (4, 0.090127769139)):
        wave = gx.travelling.cell_wave(gx.Hertz(), [1.0, ratio], speed=1.0)
        left = wave.strain(-xi, 0)
        right = wave.strain(1 - xi, 1)
        assert squeeze_count(left, right) == count
        # in any units, however finely sampled
        assert squeeze_count(1e-7 * left[::9], 1e-7 * right[::9]) == count
    assert np.isnan(squeeze_count(np.zeros(9), np.zeros(9)))


@mark.slow
def test_a_map_of_dimers_is_their_decay_rate():
    found = resonance_map("1:1", [0.342846, 0.24, 0.7, 1.0], [1.0], cells=(30, 60))
    rates = decay_rate([0.342846, 0.24, 0.7, 1.0], (60, 120))
    assert_allclose(found.rate[:, 0], rates, atol=1e-7)
    assert_allclose(found.rate[3, 0], 0, atol=1e-9)
    assert_allclose(found.force[3, 0], MONOMER_FORCE, rtol=3e-6)


@mark.slow
def test_maps_of_larger_cells():
    ratios = np.array([0.4, 1.0])
    stiffness = np.array([0.5, 0.8, 1.0])
    found = resonance_map("2:1", ratios, stiffness, cells=(2, 6))
    assert found.rate.shape == (2, 3)
    # one by one, and by a function of the user's own, in units of twice the mass and three times the stiffness
    lattice = gx.Lattice(
        np.resize([1.0, 1.0, 0.4], 33),
        gx.Bond(gx.Shift(1, "free"), gx.Hertz(np.resize([1.0, 0.8, 0.8], 32))),
    )
    record = {"peak": gx.Peak(lambda t, y, lattice: gx.measures.contact_force(lattice, y)[18])}
    run = gx.simulate(lattice, gx.states.impact(lattice), 1.4 * 18 + 6, record=record, step=0.02)
    assert_allclose(found.force[0, 1], run.recorded["peak"], rtol=1e-5)

    def cell(ratio, k):
        return [2.0, 2.0, 2 * ratio], [3.0, 3 * k, 3 * k]

    scaled = resonance_map(cell, ratios, stiffness, cells=(2, 6))
    assert_allclose(scaled.force, found.force * 3**0.4 * 2**0.6, rtol=1e-6)
    data = scaled.to_xarray()
    assert data.rate.dims == ("first", "second") and data.force.units
    assert data.first.values.tolist() == [0.4, 1.0]
    # the first bead is heavy: second and third alike are a chain of one to two
    trimers = resonance_map("trimer", [0.5, 1.0], [0.5, 1.0], cells=(2, 6))
    assert trimers.rate[0, 0] != trimers.rate[0, 1]
    for rate in (found.rate[1, 2], trimers.rate[1, 1]):
        assert_allclose(rate, 0, atol=2e-3)


@mark.slow
def test_a_map_has_a_ridge_and_valleys_and_loses_nothing_in_the_monomer():
    values = np.linspace(0.08, 1, 8)
    found = resonance_map("5:1", values, values)
    assert np.isfinite(found.rate).all()
    assert_allclose(found.rate[-1, -1], 0, atol=1e-4)
    assert found.rate.max() > 0.03 and np.mean(np.abs(found.rate) < 3e-3) > 0.03


def seen(*transmissions):
    ratios = np.linspace(0.4, 1.0, len(transmissions))
    return Transmission(ratios, ratios, np.array(transmissions), 1.0, 21, 41.5)


@mark.parametrize(
    "call, said",
    [
        (lambda: transmission([0.5, 1.2]), "ratios: expected numbers in"),
        (lambda: transmission([0.5], 21, run_time=9.0), "run_time: expected at least"),
        (lambda: refine(seen(0.5, 1.0)), "sweep: expected at least three"),
        (lambda: refine(seen(0.5, np.nan, 1.0)), "1 that are NaN"),
        (lambda: decay_rate([0.5], (600, 200)), "contacts: expected two contacts"),
        (lambda: oscillations([0.5], bead=40), "bead: expected a light bead"),
        (
            lambda: resonance_map("2:1", [0.5], [1.0], cells=(5, 5)),
            "cells: expected two cells",
        ),
        (
            lambda: resonance_map(lambda p, q: ([p, q], [1.0]), [0.5], [1.0]),
            "as many stiffnesses",
        ),
        (lambda: anti_resonance(0.4, 0.3), "high: expected a mass ratio above low"),
    ],
)
def test_bad_input_is_refused(call, said):
    with refused(said):
        call()


@mark.slow
def test_another_step_count_compiles_nothing():
    transmission([0.9], 21)
    before = program.cache_info().misses
    transmission([0.06], 21, run_time=60.0)
    assert program.cache_info().misses == before
