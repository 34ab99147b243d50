"""Collisions of solitary waves, and their reflection from walls."""

import jax
import jax.numpy as jnp
import matplotlib

matplotlib.use("Agg")

import numpy as np  # noqa: E402
import pytest  # noqa: E402

import granjax as gx  # noqa: E402
from granjax import plots  # noqa: E402
from granjax.travelling import collide, reflect, solitary_wave  # noqa: E402

K = 1.0, 0.5


def toda(k, way=1, law=None):
    return solitary_wave(gx.Toda() if law is None else law, speed=way * np.sinh(k) / k)


@pytest.fixture(scope="module")
def fast():
    return toda(1.0)


@pytest.mark.parametrize(("way", "shifts"), [
    pytest.param(1, (1.180269670641735, -2.360539341283469), marks=pytest.mark.study),
    pytest.param(-1, (0.2273362938026457, -0.4546725876052915), marks=pytest.mark.study)],
    ids=["overtaking", "head-on"])
def test_two_solitons_of_toda_are_shifted_as_the_closed_form_says(fast, way, shifts):
    slow = toda(0.5, way)
    found = collide(fast, slow)
    np.testing.assert_allclose(found.shifts, shifts, atol=1e-8, rtol=0)
    assert (np.abs(found.shifts - shifts) <= found.shift_errors).all() and found.shift_errors.max() < 1e-7
    np.testing.assert_allclose(found.toda_shifts, shifts, rtol=1e-12)
    # integrable: nothing is lost
    np.testing.assert_allclose(found.speeds_after, found.speeds, rtol=1e-9)
    np.testing.assert_allclose(found.amplitudes_after, found.amplitudes, rtol=1e-8)
    assert abs(found.radiated) <= max(found.radiated_error, 1e-9) and found.radiated_error < 1e-7
    if way > 0:
        # of the same speeds, which are 18 % and 4 % above that of sound
        np.testing.assert_allclose(found.kdv_shifts, shifts, rtol=0.15)
    else:
        assert np.isnan(found.kdv_shifts).all() and "KdV knows waves of one way alone" in found.outcome
    assert plots.space_time(found.run) is not None


@pytest.mark.study
def test_waves_to_the_left_are_mirror_images():
    for second, shifts in ((toda(0.5, -1), (-1.180269670641735, 2.360539341283469)),
                           (toda(0.5), (-0.2273362938026457, 0.4546725876052915))):
        np.testing.assert_allclose(collide(toda(1.0, -1), second, tolerance=1e-3).shifts, shifts, atol=1e-4)


@pytest.mark.study
def test_a_collision_in_steel_beads_is_that_in_scaled_numbers():
    chain = gx.scenes.beads("steel 316", 9.525e-3, 20.0, cells=12, boundary="free")
    sound = float(gx.linear.sound_speed(chain))
    of_beads = [solitary_wave(chain, speed=x * sound) for x in (1.5, 1.3)]
    scaled = [solitary_wave(gx.Hertz(1.0, 1.0), speed=x * 1.5**0.5) for x in (1.5, 1.3)]
    found, same = collide(*of_beads, tolerance=1e-3), collide(*scaled, tolerance=1e-3)
    np.testing.assert_allclose(found.shifts, same.shifts, rtol=1e-6)
    np.testing.assert_allclose(found.toda_shifts, same.toda_shifts, rtol=1e-9)
    assert found.units == "SI" and " J" in repr(found) and found.radiated > 5 * found.radiated_error
    assert found.radiated / found.energy == pytest.approx(same.radiated / same.energy, rel=1e-4)
    # not integrable: near what Toda says, and not that
    np.testing.assert_allclose(found.shifts, found.toda_shifts, rtol=0.2)
    assert (np.abs(found.shifts - found.toda_shifts) > 10 * found.shift_errors).all()


@pytest.mark.study
def test_a_stiffer_wall_sends_a_wave_back_earlier_towards_the_rigid_limit(fast):
    stiffness = np.array([50.0, 500.0])
    found, rigid = reflect(fast, gx.Linear(jnp.asarray(stiffness)), distance=58), reflect(fast, distance=58)
    # at a rigid end Toda's soliton meets its mirror image
    mirror = -np.log(np.cosh(1.0)) / np.sinh(1.0)
    assert float(rigid.delay) == pytest.approx(mirror, abs=1e-8) and abs(rigid.delay - mirror) <= rigid.delay_error
    assert float(rigid.amplitudes) == pytest.approx(rigid.amplitude, rel=1e-8)
    assert found.delay.shape == (2,) and (np.diff(found.delay) < -10 * found.delay_error[1:]).all()
    # as far from it as the wall gives way
    left = found.delay - float(rigid.delay)
    assert 0 < left[-1] < 1e-2 and left[-2] / left[-1] == pytest.approx(10.0, rel=0.05)
    assert found.energies[0] < found.energies[1] == pytest.approx(found.energy, rel=1e-8)
    assert "Came back" in found.outcome
    assert found.to_xarray().delay.dims == ("lane",)
    ax = plots.reflection(found, stiffness, rigid=rigid)
    assert ax.get_ylabel() == "delay (scaled)" and len(ax.child_axes) == 1
    with pytest.raises(ValueError, match=r"stiffness: expected one number per lane"):
        plots.reflection(found, stiffness[1:])


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
    assert plots.reflection(found, E, x_label="modulus").get_xlabel() == "modulus (GPa)"
    assert plots.reflection(found, E, x_label="modulus", units="us").get_ylabel() == "delay (µs)"


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
        (lambda: collide(fast, solitary_wave(gx.Toda(2.0), speed=2.0)), "second: expected a wave of the same law"),
        (lambda: collide(fast, toda(0.5), tolerance=0.5), "tolerance"),
        (lambda: collide(fast, toda(0.5), step=-1.0), "step"),
        (lambda: reflect(toda(1.0, -1)), "wave: expected one to the right"),
        (lambda: reflect(fast, gx.Hertz(jnp.ones((2, 2)))), "one row of lanes"),
        (lambda: reflect(fast, distance=0), "distance"),
        (lambda: jax.jit(lambda a: reflect(fast, gx.Hertz(a)).delay)(1.0), "wall: expected numbers that are known"),
    ]
    for call, why in calls:
        with pytest.raises(ValueError, match=why):
            call()
