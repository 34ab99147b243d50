"""Collisions of solitary waves whose radiation takes long; run by hand: pytest benchmarks/long."""

import jax.numpy as jnp
import numpy as np
from numpy.testing import assert_allclose
from test_collisions import ALPHA, toda

import granjax as gx
from granjax.travelling import collide, reflect, solitary_wave


def test_another_step_and_several_phases_as_lanes_agree_within_the_errors():
    one, two = (solitary_wave(ALPHA, speed=c) for c in (1.4, -1.5))
    first, other = (collide(one, two, tolerance=1e-2, step=h) for h in (None, 0.03))
    apart = np.abs(other.shifts - first.shifts)
    assert (apart <= first.shift_errors + other.shift_errors).all()
    # the range over phases, as lanes, and one of them by itself
    several = collide(one, two, phase=np.array([0.0, 0.5]), tolerance=1e-2)
    assert several.shifts.shape == (2, 2) and several.run.us.shape[2:] == (2,)
    assert "At 2 of 2 phases" in several.outcome
    assert_allclose(several.shifts[:, 0], first.shifts, atol=1e-9)
    assert_allclose(several.radiated[0], first.radiated, atol=1e-9)
    data = several.to_xarray()
    assert data.shifts.dims == ("wave", "lane") and data.places.dims == ("wave", "found", "lane")
    assert data.times.dims == ("found", "lane") and data.phase.values.tolist() == [0.0, 0.5]


def test_the_errors_cover_what_waves_shed_for_long():
    """Against a run that follows the waves four times as far, whose shift is known to 2e-6."""
    waves = (solitary_wave(ALPHA, speed=c) for c in (1.3, -1.4))
    found = collide(*waves, tolerance=1e-2)
    assert (np.abs(found.shifts - [0.4532925, -0.3439571]) <= found.shift_errors + 2e-6).all()
    assert found.shift_errors.max() < 1e-2


def test_a_stiffer_wall_sends_a_wave_back_earlier_towards_the_rigid_limit():
    fast = toda(1.0)
    wall = gx.Linear(jnp.array([50.0, 500.0]))
    found, rigid = (reflect(fast, wall, distance=58) for wall in (wall, None))
    # at a rigid end Toda's soliton meets its mirror image
    mirror = -np.log(np.cosh(1.0)) / np.sinh(1.0)
    assert abs(rigid.delay - mirror) <= min(rigid.delay_error, 1e-8)
    assert_allclose(rigid.amplitudes, rigid.amplitude, rtol=1e-8)
    assert found.delay.shape == (2,) and (np.diff(found.delay) < -10 * found.delay_error[1:]).all()
    # as far from it as the wall gives way
    left = found.delay - rigid.delay
    assert 0 < left[1] < 1e-2
    assert_allclose(left[0] / left[1], 10.0, rtol=0.05)
    assert_allclose(found.energies[1], found.energy, rtol=1e-8)
    assert found.energies[0] < found.energies[1]
    assert "Came back" in found.outcome and found.to_xarray().delay.dims == ("lane",)
