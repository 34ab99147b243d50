"""Transmission of dimer chains, its extrema, and the asymptotic anti-resonances."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest
from refusals import refused

import granjax as gx
from granjax.sweeps.function import program

# A = m = v = 1, peak contact force far down a struck monomer chain
MONOMER_FORCE = 0.63955423


def wall_force(t, y, lattice):
    return gx.measures.contact_force(lattice, y)[-1]


def one_by_one(ratio, beads, t1, **method):
    chain = gx.scenes.dimer(beads, ratio)
    run = gx.simulate(
        chain, gx.states.impact(chain), t1, record={"wall": gx.Peak(wall_force)}, **method
    )
    return float(run.recorded["wall"])


def python(code, **environment):
    """The last line that Python code prints in a fresh process."""
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        env={**os.environ, **environment},
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()[-1]


@pytest.mark.study
def test_a_sweep_is_what_single_runs_give():
    # more than one chunk, not sorted; each chunk has its own step, whose error is below 1e-6
    ratios = np.array([0.7, 0.05, 1.0, 0.3, 0.59, 0.9, 0.1, 0.45, 0.2, 0.8, 0.5, 0.6])
    sweep = gx.resonance.transmission(ratios, 21)
    expected = np.array([one_by_one(ratio, 21, sweep.run_time, step=0.02) for ratio in ratios])
    np.testing.assert_allclose(sweep.peak_force, expected, rtol=3e-6)
    np.testing.assert_allclose(sweep.transmission, expected / expected[2], rtol=3e-6)
    assert sweep.transmission[2] == 1.0
    assert sweep.run_time == 41.5


@pytest.mark.slow
def test_the_monomer_is_computed_where_it_is_not_asked_for():
    sweep = gx.resonance.transmission([0.5], 21)
    with_it = gx.resonance.transmission([0.5, 1.0], 21)
    assert sweep.reference == pytest.approx(with_it.peak_force[1], rel=1e-6)
    assert sweep.transmission.shape == (1,)
    assert sweep.transmission[0] == pytest.approx(with_it.transmission[0], rel=1e-6)


@pytest.mark.slow
def test_deepest_minimum_of_101_beads():
    # 0.2096 at 0.595; SciPy's DOP853 at tolerance 1e-10: cusp at 0.5944 with 0.208678
    sweep = gx.resonance.transmission(np.append(np.linspace(0.575, 0.615, 9), 1.0))
    assert sweep.transmission[4] == pytest.approx(0.2096, abs=5e-5)
    found = gx.resonance.refine(sweep, accuracy=1e-5)
    lowest = found.resonance_transmission.argmin()
    assert found.resonances[lowest] == pytest.approx(0.5944, abs=5e-5)
    assert found.resonance_transmission[lowest] == pytest.approx(0.208678, abs=2e-5)


@pytest.mark.study
def test_the_default_step_is_accurate_enough():
    # an eighth of the step; over 200 ratios the largest error is 5.5e-6, at 0.587
    for ratio in (0.05, 0.587):
        sweep = gx.resonance.transmission([ratio], 101)
        chain = gx.scenes.dimer(101, ratio)
        state = gx.states.impact(chain)
        step = 0.0625 / float(gx.flow.frequency_bound(chain, state, 0.0, sweep.run_time))
        assert sweep.peak_force[0] == pytest.approx(
            one_by_one(ratio, 101, sweep.run_time, step=step), rel=6e-6
        )


@pytest.mark.slow
def test_a_longer_run_meets_no_larger_force():
    ratios = np.linspace(0.05, 1, 8)
    usual = gx.resonance.transmission(ratios, 101)
    longer = gx.resonance.transmission(ratios, 101, run_time=2.5 * usual.run_time)
    np.testing.assert_allclose(longer.transmission, usual.transmission, rtol=2e-6)


@pytest.mark.study
def test_refined_extrema_are_extrema():
    sweep = gx.resonance.transmission(np.linspace(0.1, 1, 46), 31)
    found = gx.resonance.refine(sweep, accuracy=1e-4)
    for places, values, sign in (
        (found.resonances, found.resonance_transmission, -1),
        (found.anti_resonances, found.anti_resonance_transmission, 1),
    ):
        assert len(places)
        assert np.all(np.diff(places) > 0)
        inner = places < 1
        around = np.concatenate([places[inner] - 2e-3, places[inner] + 2e-3])
        beside = gx.resonance.transmission(around, 31).transmission
        assert np.all(sign * (np.tile(values[inner], 2) - beside) > 0)
    # better than the grid's own points
    assert found.resonance_transmission.min() <= sweep.transmission.min() + 1e-6


def test_refinement_finds_a_known_place():
    def force(x):
        # stands for the simulation: a minimum at 0.4321 and a cusp upwards at 0.7123
        return np.where(x < 0.6, 2 + (x - 0.4321) ** 2, 2.2 - np.abs(x - 0.7123))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(gx.resonance.finite, "peak_forces", lambda x, *_: force(x)[None])
        ratios = np.linspace(0.1, 0.95, 18)
        # one ratio twice, which differs by rounding, as what is computed there does
        ratios = np.append(ratios, ratios[4] * (1 + 1e-15))
        forces = force(ratios) + 1e-13 * (np.arange(19) == 18)
        sweep = gx.resonance.Transmission(ratios, forces, forces / 2, 2.0, 3, 1.0)
        # a pulse that loses nothing at 0.7123 and 0.9
        patch.setattr(
            gx.resonance.finite, "decay_rate", lambda x, *_, **__: ((x - 0.7123) * (x - 0.9)) ** 2
        )
        found = gx.resonance.refine(sweep, accuracy=1e-5)
    np.testing.assert_allclose(found.resonances, [0.4321], atol=1e-5)
    np.testing.assert_allclose(found.resonance_transmission, [1.0], atol=1e-9)
    np.testing.assert_allclose(found.anti_resonances, [0.7123], atol=1e-5)
    assert not len(found.local_extrema)
    np.testing.assert_allclose(found.anti_resonance_transmission, [1.1], atol=1e-5)


# transmissions over the mass ratio, made of cosines; places of anti-resonances; which extrema are what
SHAPES = {
    "a split minimum": (
        lambda x: np.cos(10 * np.pi * x) + 0.3 * np.cos(40 * np.pi * x),
        [0.2, 0.4, 0.6, 0.8],
        None,
    ),
    "ripples": (
        lambda x: np.cos(10 * np.pi * x) + 0.4 * np.cos(70 * np.pi * x),
        [0.2, 0.4, 0.6, 0.8],
        None,
    ),
    "a maximum without a zero": (lambda x: np.cos(10 * np.pi * x), [0.2, 0.6, 0.8], 0.4),
    "one beside a zero": (lambda x: np.cos(10 * np.pi * (x - 0.004)), [0.2, 0.4, 0.6, 0.8], None),
}


@pytest.mark.parametrize("shape", SHAPES)
def test_resonances_are_between_anti_resonances(shape):
    """Where the decay has zeros there are anti-resonances, and between two of them one resonance, the deepest."""
    force, zeros, none = SHAPES[shape]
    ratios = np.linspace(0.12, 0.92, 161)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(gx.resonance.finite, "peak_forces", lambda x, *_: (3 + force(x))[None])
        patch.setattr(
            gx.resonance.finite,
            "decay_rate",
            lambda x, *_, **__: np.min([(x - zero) ** 2 for zero in zeros], axis=0),
        )
        forces = 3 + force(ratios)
        sweep = gx.resonance.Transmission(ratios, forces, forces, 1.0, 3, 1.0)
        found = gx.resonance.refine(sweep, accuracy=1e-4)
    assert len(found.anti_resonances) == len(zeros)
    assert np.abs(found.anti_resonances - zeros).max() < 0.03
    fine = np.linspace(0.12, 0.92, 80001)
    for low, high in zip(zeros, zeros[1:]):
        here = fine[(fine > low) & (fine < high)]
        (own,) = found.resonances[(found.resonances > low) & (found.resonances < high)]
        assert force(own) == pytest.approx(force(here).min(), abs=1e-5)
    assert none is None or np.abs(found.local_extrema - none).min() < 1e-3
    # nothing is lost
    values = force(ratios)
    count = np.count_nonzero((values[1:-1] - values[:-2]) * (values[2:] - values[1:-1]) < 0)
    assert len(found.resonances) + len(found.anti_resonances) + len(found.local_extrema) == count


@pytest.mark.slow
def test_a_split_minimum_is_one_resonance():
    """0.5608, 0.5811, 0.5944 of 101 beads: the pulse decays at all three, so that none is an anti-resonance."""
    ratios = np.append(np.linspace(0.24, 0.36, 7), np.linspace(0.5, 0.66, 33))
    found = gx.resonance.refine(
        gx.resonance.transmission(np.append(ratios, [0.8, 0.9, 0.95, 1.0])), accuracy=2e-4
    )
    np.testing.assert_allclose(found.resonances, [0.5944], atol=4e-4)
    np.testing.assert_allclose(found.local_extrema, [0.5608, 0.5811], atol=4e-4)
    np.testing.assert_allclose(found.anti_resonances[0], 0.3156, atol=4e-4)
    assert "resonances: 1, anti-resonances:" in found.outcome and found.outcome.endswith(
        "other local extrema: 2."
    )


@pytest.mark.slow
def test_contact_forces_down_the_chain():
    # converged with the step: 0.3019048, 0.2574079, 0.2309435 (at a coarser sampling in time 0.301903, ...)
    forces = gx.resonance.contact_forces([0.5, 1.0], (20, 40, 60))
    np.testing.assert_allclose(forces[:, 0], [0.301903, 0.257407, 0.230943], rtol=1e-5)
    np.testing.assert_allclose(forces[:, 0], [0.3019048, 0.2574079, 0.2309435], rtol=1e-6)
    np.testing.assert_allclose(forces[:, 1], MONOMER_FORCE, rtol=3e-6)


@pytest.mark.study
def test_decay_is_fastest_at_the_second_and_third_resonance():
    # contacts 100 -> 200: 0.2399, 0.1225
    for centre in (0.2399, 0.1225):
        ratios = np.linspace(0.93 * centre, 1.07 * centre, 8)
        rates = gx.resonance.decay_rate(ratios, (100, 200))
        assert np.all(rates > 0)
        fit = np.polynomial.Polynomial.fit(ratios, rates, 4)
        tops = fit.deriv().roots()
        tops = tops[np.abs(tops.imag) < 1e-12].real
        assert tops[np.argmin(np.abs(tops - centre))] == pytest.approx(centre, abs=1e-4)


@pytest.mark.study
def test_anti_resonance_of_a_shorter_chain():
    # between contacts 40 and 120 the zero is already within 1e-5 of the asymptotic 0.342846
    assert gx.resonance.anti_resonance(0.32, 0.37, contacts=(40, 120)) == pytest.approx(
        0.342846, abs=1e-5
    )


@pytest.mark.study
@pytest.mark.parametrize(
    "contacts",
    [
        pytest.param((60, 160), marks=pytest.mark.slow),
        pytest.param((200, 600), marks=pytest.mark.study),
    ],
    ids=["60 to 160", "200 to 600"],
)
@pytest.mark.parametrize(
    "low, high, expected", [(0.3, 0.4, 0.342846), (0.12, 0.18, 0.154751), (0.08, 0.1, 0.090128)]
)
def test_anti_resonances(low, high, expected, contacts):
    # literature: 0.3428, 0.1548, 0.0901
    assert gx.resonance.anti_resonance(low, high, contacts=contacts) == pytest.approx(
        expected, abs=3e-6
    )


@pytest.mark.slow
def test_the_monomer_is_an_anti_resonance():
    assert gx.resonance.anti_resonance(0.9, 1.0, contacts=(40, 80)) == 1.0


@pytest.mark.slow
def test_an_interval_without_anti_resonance():
    with pytest.raises(RuntimeError, match="no minimum inside"):
        gx.resonance.anti_resonance(0.4, 0.5, contacts=(40, 80))


@pytest.mark.slow
def test_light_beads_swing_once_more_at_each_anti_resonance():
    found = gx.resonance.oscillations([1.0, 0.342846, 0.154751, 0.090128, 0.0615, 0.6, 0.25])
    assert found.count[:5].tolist() == [1, 2, 3, 4, 5]
    # at resonances half a swing stands between
    assert found.count[5] == 1.5 and found.count[6] == 2.5
    assert "1 to 5 times" in found.outcome


@pytest.mark.slow
def test_swings_of_exact_waves_are_those_of_simulations():
    xi = np.linspace(-9, 9, 3000)
    for count, ratio in ((2, 0.342845781150), (3, 0.154751513885), (4, 0.090127769139)):
        wave = gx.travelling.cell_wave(gx.Hertz(), [1.0, ratio], speed=1.0)
        left, right = wave.strain(-xi, 0), wave.strain(1 - xi, 1)
        assert gx.resonance.squeeze_count(left, right) == count
        # in any units, however finely sampled
        assert gx.resonance.squeeze_count(1e-7 * left[::9], 1e-7 * right[::9]) == count
    assert np.isnan(gx.resonance.squeeze_count(np.zeros(9), np.zeros(9)))


@pytest.mark.slow
def test_a_map_of_dimers_is_their_decay_rate():
    found = gx.resonance.resonance_map("1:1", [0.342846, 0.24, 0.7, 1.0], [1.0], cells=(30, 60))
    rates = gx.resonance.decay_rate([0.342846, 0.24, 0.7], (60, 120))
    np.testing.assert_allclose(found.rate[:3, 0], rates, atol=1e-7)
    assert found.rate[3, 0] == pytest.approx(0, abs=1e-9)
    assert found.force[3, 0] == pytest.approx(MONOMER_FORCE, rel=3e-6)


@pytest.mark.study
def test_maps_of_larger_cells():
    ratios, stiffness = np.array([0.4, 1.0]), np.array([0.5, 0.8, 1.0])
    found = gx.resonance.resonance_map("2:1", ratios, stiffness, cells=(2, 6))
    assert found.rate.shape == (2, 3) and found.rate[1, 2] == pytest.approx(0, abs=2e-3)
    # one by one, and by a function of the user's own, in units of twice the mass and three times the stiffness
    lattice = gx.Lattice(
        np.resize([1.0, 1.0, 0.4], 33),
        gx.Bond(gx.Shift(1, "free"), gx.Hertz(np.resize([1.0, 0.8, 0.8], 32))),
    )
    record = {"peak": gx.Peak(lambda t, y, lattice: gx.measures.contact_force(lattice, y)[18])}
    run = gx.simulate(lattice, gx.states.impact(lattice), 1.4 * 18 + 6, record=record, step=0.02)
    assert found.force[0, 1] == pytest.approx(float(run.recorded["peak"]), rel=1e-5)

    def cell(ratio, k):
        return [2.0, 2.0, 2 * ratio], [3.0, 3 * k, 3 * k]

    scaled = gx.resonance.resonance_map(cell, ratios, stiffness, cells=(2, 6))
    np.testing.assert_allclose(scaled.force, found.force * 3**0.4 * 2**0.6, rtol=1e-6)
    data = scaled.to_xarray()
    assert (
        data.rate.dims == ("first", "second")
        and data.first.values.tolist() == [0.4, 1.0]
        and data.force.units
    )


@pytest.mark.slow
def test_trimers_with_two_equal_masses_are_chains_of_two_to_one():
    # second and third alike: one heavy bead and two light ones, hit at the heavy one
    found = gx.resonance.resonance_map("trimer", [0.5, 1.0], [0.5, 1.0], cells=(2, 6))
    assert found.rate[1, 1] == pytest.approx(0, abs=2e-3)
    assert found.rate[0, 0] != found.rate[0, 1]


@pytest.mark.study
@pytest.mark.parametrize("kind", ["2:1", "3:1", "4:1", "5:1", "trimer"])
def test_whole_maps(kind):
    found = gx.resonance.resonance_map(kind, np.linspace(0.08, 1, 24), np.linspace(0.08, 1, 24))
    assert np.isfinite(found.rate).all() and found.rate[-1, -1] == pytest.approx(0, abs=1e-4)
    # a ridge where the pulse loses several percent a cell, and valleys beside it
    assert found.rate.max() > 0.03 and np.mean(np.abs(found.rate) < 3e-3) > 0.03


@pytest.mark.slow
@pytest.mark.parametrize(
    "call, message",
    [
        (lambda: gx.resonance.transmission([0.5, 1.2]), "ratios: expected numbers in"),
        (
            lambda: gx.resonance.refine(gx.resonance.transmission([0.5, 1.0], 21)),
            "sweep: expected at least three",
        ),
        (lambda: gx.resonance.decay_rate([0.5], (600, 200)), "contacts: expected two contacts"),
        (lambda: gx.resonance.oscillations([0.5], bead=40), "bead: expected a light one"),
        (
            lambda: gx.resonance.resonance_map("2:1", [0.5], [1.0], cells=(5, 5)),
            "cells: expected two cells",
        ),
        (
            lambda: gx.resonance.resonance_map(lambda p, q: ([p, q], [1.0]), [0.5], [1.0]),
            "as many stiffnesses",
        ),
        (lambda: gx.resonance.anti_resonance(0.4, 0.3), "high: expected a mass ratio above low"),
    ],
)
def test_bad_input_is_refused(call, message):
    with refused(message):
        call()


@pytest.mark.slow
def test_nan_is_not_refined():
    sweep = gx.resonance.transmission([0.4, 0.5, 0.6, 1.0], 21)
    broken = gx.resonance.Transmission(
        sweep.mass_ratio,
        sweep.peak_force,
        np.array([0.5, np.nan, 0.5, 1.0]),
        sweep.reference,
        21,
        sweep.run_time,
    )
    with refused("1 that are NaN"):
        gx.resonance.refine(broken)


def test_another_step_count_compiles_nothing():
    gx.resonance.transmission([0.9], 21)
    before = program.cache_info().misses
    gx.resonance.transmission([0.06], 21, run_time=60.0)
    assert program.cache_info().misses == before


@pytest.mark.study
def test_several_devices_change_nothing():
    code = """
import json
import jax
jax.config.update("jax_num_cpu_devices", 2)
import granjax as gx, numpy as np
sweep = gx.resonance.transmission(np.linspace(0.1, 1, 12), 21)
few = gx.resonance.contact_forces([0.3, 0.5], (8,))
print(json.dumps([sweep.transmission.tolist(), few.tolist()]))
"""
    transmission, few = json.loads(python(code))
    alone = gx.resonance.transmission(np.linspace(0.1, 1, 12), 21)
    np.testing.assert_allclose(transmission, alone.transmission, rtol=1e-12)
    np.testing.assert_allclose(few, gx.resonance.contact_forces([0.3, 0.5], (8,)), rtol=1e-12)
