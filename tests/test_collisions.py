"""Collisions of solitary waves, and their reflection from walls."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import granjax as gx
from granjax import plots
from granjax.travelling import collide, reflect, solitary_wave


def toda(k, way=1, law=None):
    return solitary_wave(gx.Toda() if law is None else law, speed=way * np.sinh(k) / k)


@pytest.fixture(scope="module")
def fast():
    return toda(1.0)


@pytest.mark.parametrize(
    ("way", "shifts"),
    [
        pytest.param(1, (1.180269670641735, -2.360539341283469), marks=pytest.mark.study),
        pytest.param(-1, (0.2273362938026457, -0.4546725876052915), marks=pytest.mark.study),
    ],
    ids=["overtaking", "head-on"],
)
def test_two_solitons_of_toda_are_shifted_as_the_closed_form_says(fast, way, shifts):
    slow = toda(0.5, way)
    found = collide(fast, slow)
    np.testing.assert_allclose(found.shifts, shifts, atol=1e-8, rtol=0)
    assert (
        np.abs(found.shifts - shifts) <= found.shift_errors
    ).all() and found.shift_errors.max() < 1e-7
    # integrable: nothing is lost
    np.testing.assert_allclose(found.speeds_after, found.speeds, rtol=1e-9)
    np.testing.assert_allclose(found.amplitudes_after, found.amplitudes, rtol=1e-8)
    assert abs(found.radiated) <= max(found.radiated_error, 1e-9) and found.radiated_error < 1e-7
    assert plots.space_time(found.run) is not None


def met(force, waves, places, end, sites):
    """(times, strains) of two waves that start at `places`, by DOP853."""
    parts = [wave.state(sites, place) for wave, place in zip(waves, places)]
    y = np.concatenate([np.asarray(sum(part[i] for part in parts)) for i in (0, 1)])

    def field(t, y):
        u, v = np.split(y, 2)
        push = np.pad(force(u[:-1] - u[1:]), 1)
        return np.concatenate([v, push[:-1] - push[1:]])

    ts = np.linspace(end - 4, end, 41)
    u = solve_ivp(field, (0, end), y, "DOP853", ts, rtol=1e-11, atol=1e-12).y[:sites]
    return ts, u[:-1] - u[1:]


class Sinh(gx.Law):
    """F(e) = sinh(e) + e^2/2, as a user writes it: it pulls without end in tension."""

    def force(self, e):
        return jnp.sinh(e) + e**2 / 2

    def energy(self, e):
        return jnp.cosh(e) - 1 + e**3 / 6


MET = [
    pytest.param(
        gx.Polynomial(1.0, 0.25, 0.0), lambda e: e + 0.25 * e**2, (1.2, -1.3), 0.3, id="fput-alpha"
    ),
    *(
        pytest.param(*case, marks=pytest.mark.study)
        for case in (
            (gx.Hertz(), lambda e: np.maximum(e, 0) ** 1.5, (1.0, -1.1), 0.0),
            (gx.Hertz(), lambda e: np.maximum(e, 0) ** 1.5, (1.0, -1.1), 0.5),
            (Sinh(), lambda e: np.sinh(e) + e**2 / 2, (1.3, -1.2), 0.75),
            (gx.Polynomial(1.0, 0.0, 1.0), lambda e: e + e**3, (1.3, -1.2), 1.25),
        )
    ),
]


@pytest.mark.slow
@pytest.mark.parametrize(("law", "force", "speeds", "phase"), MET)
def test_waves_meet_at_the_phase_that_is_asked_for(law, force, speeds, phase):
    """Where they leave, by DOP853, of waves that begin farther apart than those of `collide`."""
    waves = [solitary_wave(law, speed=c) for c in speeds]
    found = collide(*waves, phase=phase, tolerance=2e-2)
    assert found.phase == phase % 1 and found.meeting_place % 1 == pytest.approx(
        phase % 1, abs=1e-12
    )
    before, after, sites = 14.0, 26.0, 90
    places = [45 + phase % 1 - c * before for c in speeds]
    ts, strains = met(force, waves, places, before + after, sites)
    for k, wave in enumerate(waves):
        line = 45 + phase % 1 + found.shifts[k] + found.speeds_after[k] * (ts - before)
        middle = np.rint(line).astype(int)
        window = middle + np.arange(-3, 4)[:, None]
        around = strains[window, np.arange(len(ts))]
        own = solitary_wave(law, speed=float(found.speeds_after[k]))
        off = np.array(
            [
                np.abs(around - np.asarray(own.strain(window - line - d))).max()
                for d in (0, -0.1, 0.1)
            ]
        )
        assert off[0] < 0.03 * float(wave.amplitude) and off[0] < off[1:].min() / 2


@pytest.mark.slow
def test_calls_with_other_numerical_options_agree_within_their_errors():
    one, two = (solitary_wave(gx.Polynomial(1.0, 0.25, 0.0), speed=c) for c in (1.4, -1.5))
    calls = [{"tolerance": 1e-2}, {"tolerance": 1e-3}, {"tolerance": 1e-2, "step": 0.03}]
    first, *others = (collide(one, two, **keywords) for keywords in calls)
    for other in others:
        assert other.phase == first.phase == 0.0
        assert (
            np.abs(other.shifts - first.shifts) <= first.shift_errors + other.shift_errors
        ).all()
    # the range over phases, as lanes, and one of them by itself
    several = collide(one, two, phase=np.array([0.0, 0.5]), tolerance=1e-2)
    assert (
        several.shifts.shape == (2, 2)
        and several.run.us.shape[2:] == (2,)
        and "At 2 of 2 phases" in several.outcome
    )
    np.testing.assert_allclose(several.shifts[:, 0], first.shifts, atol=1e-9)
    np.testing.assert_allclose(several.radiated[0], first.radiated, atol=1e-9)
    data = several.to_xarray()
    assert data.shifts.dims == ("wave", "lane") and data.places.dims == ("wave", "found", "lane")
    assert data.times.dims == ("found", "lane") and data.phase.values.tolist() == [0.0, 0.5]


@pytest.mark.slow
def test_the_errors_cover_what_waves_shed_for_long():
    """Against a run that follows the waves four times as far, whose shift is known to 2e-6."""
    waves = (solitary_wave(gx.Polynomial(1.0, 0.25, 0.0), speed=c) for c in (1.3, -1.4))
    found = collide(*waves, tolerance=1e-2)
    assert (np.abs(found.shifts - [0.4532925, -0.3439571]) <= found.shift_errors + 2e-6).all()
    assert found.shift_errors.max() < 1e-2


@pytest.mark.study
def test_waves_to_the_left_are_mirror_images():
    for second, shifts in (
        (toda(0.5, -1), (-1.180269670641735, 2.360539341283469)),
        (toda(0.5), (-0.2273362938026457, 0.4546725876052915)),
    ):
        np.testing.assert_allclose(
            collide(toda(1.0, -1), second, tolerance=1e-3).shifts, shifts, atol=1e-4
        )


@pytest.mark.study
def test_a_stiffer_wall_sends_a_wave_back_earlier_towards_the_rigid_limit(fast):
    stiffness = np.array([50.0, 500.0])
    found, rigid = (
        reflect(fast, gx.Linear(jnp.asarray(stiffness)), distance=58),
        reflect(fast, distance=58),
    )
    # at a rigid end Toda's soliton meets its mirror image
    mirror = -np.log(np.cosh(1.0)) / np.sinh(1.0)
    assert (
        float(rigid.delay) == pytest.approx(mirror, abs=1e-8)
        and abs(rigid.delay - mirror) <= rigid.delay_error
    )
    assert float(rigid.amplitudes) == pytest.approx(rigid.amplitude, rel=1e-8)
    assert found.delay.shape == (2,) and (np.diff(found.delay) < -10 * found.delay_error[1:]).all()
    # as far from it as the wall gives way
    left = found.delay - float(rigid.delay)
    assert 0 < left[-1] < 1e-2 and left[-2] / left[-1] == pytest.approx(10.0, rel=0.05)
    assert found.energies[0] < found.energies[1] == pytest.approx(found.energy, rel=1e-8)
    assert "Came back" in found.outcome
    assert found.to_xarray().delay.dims == ("lane",)


@pytest.mark.study
def test_beads_at_a_wall_of_beads():
    wave = solitary_wave(gx.Hertz(), speed=1.0)
    stiffness = np.array([0.1, 1.0, 10.0, 1e3, 1e5])
    found, rigid = reflect(wave, gx.Hertz(jnp.asarray(stiffness))), reflect(wave)
    assert found.delay.shape == (5,) and (np.diff(found.delay) < -10 * found.delay_error[1:]).all()
    # an indentation is A^(-2/3) of that of a bead
    left = np.asarray(found.delay - rigid.delay)
    assert left[-1] < 2e-3 and left[-2] / left[-1] == pytest.approx(100 ** (2 / 3), rel=0.05)
    # a wall like a bead is a rigid one of one bead more
    assert left[1] == pytest.approx(1 + 1 / float(found.speeds[1]), abs=1e-6)
    assert (found.energies < found.energy).all()


@pytest.mark.study
def test_a_wall_of_young_s_modulus_in_si():
    chain = gx.scenes.beads("steel 316", 9.525e-3, 0.0, cells=12, boundary="free")
    wave, E = solitary_wave(chain, speed=500.0 / 19.05e-3), np.geomspace(2e9, 2e12, 4)
    law = chain.terms[0].law
    wall = gx.materials.Material("wall", E, 0.3, 1.0)
    A = gx.materials.hertz_coefficient("steel 316", 9.525e-3, wall, np.inf)
    found = reflect(wave, gx.Hertz(A))
    one = reflect(solitary_wave(gx.Hertz(), speed=1.0), gx.Hertz(A / law.stiffness))
    np.testing.assert_allclose(found.delay * wave.speed, one.delay, rtol=1e-5, atol=1e-6)


@pytest.mark.study
def test_what_has_not_parted_has_no_shift():
    # what two Hertz waves shed stays about them for long; the fits of a short run say so
    one, two = (solitary_wave(gx.Hertz(), speed=c) for c in (1.0, -1.1))
    found = collide(one, two)
    assert (np.isnan(found.shifts) | (found.shift_errors < 1e-4)).all()
    soft = reflect(one, gx.Linear(1e-4), distance=4)
    assert np.isnan(soft.delay) and "nothing is known" in soft.outcome


@pytest.mark.slow
def test_refused_with_the_reason(fast):
    calls = [
        (lambda: collide(fast, fast), "second: expected a speed other than the first's"),
        (
            lambda: collide(fast, solitary_wave(gx.Toda(2.0), speed=2.0)),
            "second: expected a wave of the same law",
        ),
        (lambda: reflect(toda(1.0, -1)), "wave: expected one to the right"),
    ]
    for call, why in calls:
        with pytest.raises(ValueError, match=why):
            call()
