"""Collisions of solitary waves, and their reflection from walls."""

from functools import cache

import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose
from refusals import refused
from scipy.integrate import solve_ivp

import granjax as gx
from granjax.travelling import collide, reflect, solitary_wave

pytestmark = pytest.mark.slow
ALPHA = gx.Polynomial(1.0, 0.25, 0.0)


@cache
def toda(k, way=1):
    return solitary_wave(gx.Toda(), speed=way * np.sinh(k) / k)


@pytest.mark.parametrize(("way", "ratio"), [(1, np.sinh), (-1, np.cosh)])
def test_two_solitons_of_toda_are_shifted_as_the_closed_form_says(way, ratio):
    """Toda: ln[sinh((k1 + k2)/2)/sinh((k1 - k2)/2)]/k, head-on with cosh; of waves to the left the mirror image."""
    found = collide(toda(2.0, way), toda(1.0))
    shifts = way * np.log(ratio(1.5) / ratio(0.5)) / np.array([2.0, -1.0])
    assert_allclose(found.shifts, shifts, atol=1e-8, rtol=0)
    assert (np.abs(found.shifts - shifts) <= found.shift_errors).all()
    assert found.shift_errors.max() < 1e-7
    # integrable: nothing is lost
    assert_allclose(found.speeds_after, found.speeds, rtol=1e-9)
    assert_allclose(found.amplitudes_after, found.amplitudes, rtol=1e-8)
    assert abs(found.radiated) <= max(found.radiated_error, 1e-9) and found.radiated_error < 1e-7


def met(waves, places, end, sites):
    """(times, strains) of two waves of FPUT's alpha chain that start at `places`, by DOP853."""
    parts = [wave.state(sites, place) for wave, place in zip(waves, places)]
    y = np.concatenate([np.asarray(sum(part[i] for part in parts)) for i in (0, 1)])

    def field(t, y):
        u, v = np.split(y, 2)
        strain = u[:-1] - u[1:]
        push = np.pad(strain + 0.25 * strain**2, 1)
        return np.concatenate([v, push[:-1] - push[1:]])

    ts = np.linspace(end - 4, end, 41)
    u = solve_ivp(field, (0, end), y, "DOP853", ts, rtol=1e-11, atol=1e-12).y[:sites]
    return ts, u[:-1] - u[1:]


def test_waves_meet_at_the_phase_that_is_asked_for():
    """Where they leave, by DOP853, of waves that begin farther apart than those of `collide`."""
    waves = [solitary_wave(ALPHA, speed=c) for c in (1.2, -1.3)]
    found = collide(*waves, phase=1.3, tolerance=2e-2)
    assert_allclose([found.phase, found.meeting_place % 1], 0.3, rtol=1e-12)
    before = 14.0
    after = 26.0
    meeting = 45.3
    places = [meeting - float(wave.speed) * before for wave in waves]
    ts, strains = met(waves, places, before + after, 90)
    for wave, shift, speed in zip(waves, found.shifts, found.speeds_after):
        line = meeting + shift + speed * (ts - before)
        window = np.rint(line).astype(int) + np.arange(-3, 4)[:, None]
        around = strains[window, np.arange(len(ts))]
        own = solitary_wave(ALPHA, speed=float(speed))
        off = [np.abs(around - own.strain(window - line - d)).max() for d in (0, -0.1, 0.1)]
        assert off[0] < 0.03 * float(wave.amplitude) and off[0] < min(off[1:]) / 2


def test_steel_beads_at_a_wall_of_beads():
    chain = gx.scenes.beads("steel 316", 9.525e-3, 0.0, cells=12, boundary="free")
    wave = solitary_wave(chain, speed=500.0 / 19.05e-3)
    wall = gx.Hertz(chain.terms[0].law.stiffness * jnp.array([1.0, 1e3, 1e5]))
    found = reflect(wave, wall)
    rigid = reflect(wave)
    assert (np.diff(found.delay) < -10 * found.delay_error[1:]).all()
    # an indentation is A^(-2/3) of that of a bead
    left = (found.delay - rigid.delay) * float(wave.speed)
    assert left[2] < 2e-3
    assert_allclose(left[1] / left[2], 100 ** (2 / 3), rtol=0.05)
    # a wall like a bead is a rigid one of one bead more
    assert_allclose(left[0], 1 + wave.speed / found.speeds[0], rtol=0, atol=1e-6)
    assert (found.energies < found.energy).all()


def test_what_has_not_come_back_has_no_delay():
    found = reflect(solitary_wave(gx.Hertz(), speed=1.0), gx.Linear(1e-4), distance=4)
    assert np.isnan(found.delay) and "nothing is known" in found.outcome


def test_several_phases_are_lanes_of_one_program():
    """Each Toda collision has the shifts of the closed form, whatever its phase."""
    found = collide(toda(2.0, -1), toda(1.0), phase=[0.0, 0.3], tolerance=1e-3)
    shifts = np.log(np.cosh(1.5) / np.cosh(0.5)) / np.array([-2.0, 1.0])
    assert_allclose(found.shifts, np.stack([shifts, shifts], -1), atol=1e-8, rtol=0)
    assert_allclose(found.meeting_place % 1, [0.0, 0.3], atol=1e-12)
    assert found.radiated.shape == (2,) and "At 2 of 2 phases" in found.outcome


@pytest.mark.parametrize(
    ("call", "why"),
    [
        (lambda: collide(toda(1.0), toda(1.0)), "second: expected a speed other than the first's"),
        (lambda: collide(toda(1.0), solitary_wave(ALPHA, speed=2.0)), "wave of the same law"),
        (lambda: reflect(toda(2.0, -1)), "wave: expected one to the right"),
        (
            lambda: reflect(toda(2.0), gx.Linear(jnp.ones((2, 2)))),
            "wall: expected one axis of lanes",
        ),
    ],
)
def test_waves_that_do_not_meet_are_refused(call, why):
    with refused(why):
        call()
