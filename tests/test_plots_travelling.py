"""Pictures of travelling waves, and how far closed forms are from them."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

import granjax as gx
from granjax import plots
from granjax.travelling import solitary_wave


@pytest.fixture(scope="module")
def toda():
    return solitary_wave(gx.Toda(), speed=np.sinh(1.0))


@pytest.mark.slow
def test_a_wave_its_slope_and_its_contacts(toda):
    other = gx.theory.toda.soliton(toda.xi, 0.0, 1.0).strain
    ax = plots.wave(toda, beside={"Toda": other})
    strain, slope, beside, nodes = ax.lines
    assert_allclose(strain.get_ydata(), beside.get_ydata(), atol=1e-12)
    numeric = np.gradient(strain.get_ydata(), strain.get_xdata())
    assert_allclose(slope.get_ydata(), numeric, atol=2e-2)
    assert_allclose(nodes.get_ydata(), toda.strain(nodes.get_xdata()), rtol=1e-12)
    assert set(np.diff(nodes.get_xdata())) == {1.0} and ax.get_ylabel().startswith("strain")


@pytest.mark.study
def test_a_wave_of_steel_beads_has_units():
    chain = gx.scenes.beads(
        "steel 316", 9.525e-3, 20.0, cells=12
    )  # whose walls are stiffer contacts
    wave = solitary_wave(chain, speed=1.1 * float(gx.linear.sound_speed(chain)))
    assert wave.units == "SI" and plots.wave(wave).get_ylabel() == "strain (µm)"
    ax = plots.wave(wave)
    assert_allclose(ax.lines[0].get_ydata().max(), 1e6 * float(wave.amplitude), rtol=1e-6)


@pytest.mark.slow
def test_the_soliton_of_toda_is_the_wave_of_its_law():
    speed = np.sinh(1.0)
    wave = solitary_wave(gx.Toda(), speed=speed)
    x = np.linspace(0, 8, 129)
    k = gx.theory.toda.wavenumber(speed=speed)
    own = gx.theory.toda.soliton(x, 0.0, k).strain
    other = gx.theory.kdv.soliton(x, 0.0, 1.0, 0.5, speed=speed).strain
    peak = float(wave.amplitude)
    assert_allclose(wave.strain(x), own, atol=1e-12 * peak)
    assert np.abs(other - own).max() > 1e-2 * peak
