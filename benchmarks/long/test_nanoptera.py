"""Nanoptera whose printed error is to be below 1e-11 of the peak; 3.3e-11 is reached."""

import numpy as np
import pytest
from test_cell_waves import optical

import granjax as gx
from granjax.travelling import cell_wave


@pytest.mark.parametrize(
    "law",
    [gx.Toda(1.0, 1.0), gx.Polynomial(1.0, 0.25, 0.0), gx.Hertz(1.0, 1.0)],
    ids=["toda", "fput", "hertz"],
)
def test_nanoptera_ride_on_the_optical_wave_of_their_speed(law):
    masses = [1.0, 0.5]
    K2 = float(gx.laws.taylor(law).K2)
    speed = 1.02 * np.sqrt(K2 / np.mean(masses))
    wave = cell_wave(law, masses, speed=speed)
    assert wave.linear_wavenumber == pytest.approx(optical(masses, speed, K2), abs=1e-10)
    assert wave.wavenumber == pytest.approx(wave.linear_wavenumber, abs=1e-6)
    assert 1e-6 < wave.ripple / wave.amplitude < 0.02
    assert wave.error / wave.amplitude < 1e-11
    assert "ripple" in wave.outcome and np.isnan(wave.energy)
