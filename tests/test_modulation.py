"""Modulations of periodic waves: Toda's Riemann invariants, the envelope equation, and the growth on a ring."""

import numpy as np
import pytest
from refusals import refused

import granjax as gx
from granjax.theory import toda


@pytest.mark.slow
@pytest.mark.parametrize("m", [0.2, 0.8])
def test_speeds_are_those_of_toda_s_modulation_equations(m):
    there = toda.modulation(m, 0.5)
    E = np.array([float(getattr(there, f"E{i}")) for i in range(1, 5)])
    numbers = toda.periodic_numbers(*(E - float(toda.periodic_numbers(*E).mean_velocity) / 2))
    wave = gx.travelling.periodic_wave(
        gx.Toda(),
        float(numbers.wavelength),
        speed=float(numbers.speed),
        mean=float(numbers.mean_strain),
    )
    found = gx.travelling.modulation(wave, [0.4, 1.3, 2.9])
    off = np.abs(found.speeds - float(there.speed))
    assert off.min() < 1e-8 and off.min() <= found.speed_errors[off.argmin()]
    assert found.verdict == "stable" and "real" in found.outcome


def test_small_waves_grow_as_the_envelope_equation_says():
    law = gx.Polynomial(1.0, 0.0, 1.0)
    k = 2.5
    a = 0.02
    wave = gx.travelling.periodic_wave(law, 2 * np.pi / k, amplitude=a)
    c = gx.theory.nls.coefficients(1.0, 1.0, 0.0, 1.0, k)
    # the fastest modulation of |Y|, the amplitude of the displacements in the envelope's own measure
    phases = np.linspace(0.002, 0.06, 30)
    found = gx.travelling.modulation(wave, phases)
    assert found.verdict == "unstable" and "complex" in found.outcome
    # the envelope's growth is a half ellipse in its square: nu2 Q^2 (s - nu2 Q^2), with one unknown s
    square = (found.growth / (abs(float(c.nu2)) * phases)) ** 2
    grows = found.growth > 0.2 * found.growth.max()
    slope, at_zero = np.polyfit(phases[grows] ** 2, square[grows], 1)
    assert slope == pytest.approx(-1.0, rel=0.05) and at_zero > 0


def test_no_phase_is_refused():
    wave = gx.travelling.periodic_wave(gx.Toda(), 6.0, amplitude=0.2)
    with refused("kappa: expected one phase or more, got none"):
        gx.travelling.modulation(wave, [])


@pytest.mark.slow
@pytest.mark.parametrize(
    "law, length, numbers",
    [
        (gx.Toda(), 4.0, dict(amplitude=2.0)),
        (gx.Toda(), 8.0, dict(amplitude=0.1)),
        # The harmonics of this wave's stiffness do not all find room in the matrix.
        (gx.Toda(), 18.0, dict(amplitude=2.0)),
        (gx.Hertz(9.8e9, 10.0), 6.0, dict(amplitude=5e-7, mass=0.028)),
    ],
)
def test_no_growth_is_told_where_the_symmetries_meet(law, length, numbers):
    wave = gx.travelling.periodic_wave(law, length, **numbers)
    k = 2 * np.pi / length
    near = np.array([0.0, 1e-12, 1e-9, 1e-7, 1e-5, 1e-3])
    found = gx.travelling.modulation(wave, np.concatenate([near, k * (1 - near), k * (2 + near)]))
    # Toda's waves are stable; four eigenvalues are known exactly at multiples of k.
    assert found.verdict == "stable"
    assert np.all(found.growth_error < 0.02 * k * float(wave.speed))


def test_growth_of_long_modulations_lies_within_the_error_at_any_distance():
    wave = gx.travelling.periodic_wave(gx.Polynomial(1.0, 0.0, 1.0), 3.0, amplitude=1.5)
    k = 2 * np.pi / 3
    near = 10.0 ** np.arange(-12, -3)
    found = gx.travelling.modulation(wave, k * (1 + near))
    expected = found.speeds.imag.max() * k * near
    assert np.all(np.abs(found.growth - expected) <= found.growth_error + 1e-3 * expected)
    assert np.all(found.growth[near > 1e-7] > found.growth_error[near > 1e-7])


@pytest.mark.slow
def test_growth_is_that_of_the_multipliers_on_a_ring():
    law = gx.Polynomial(1.0, 0.0, 1.0)
    length = 3.0
    sites = 12
    wave = gx.travelling.periodic_wave(law, length, amplitude=0.3)
    ring = gx.Lattice(1.0, gx.Bond(gx.Shift(1, "periodic"), law), sites=sites)
    known = gx.floquet.floquet(ring, wave.state(sites), float(length / wave.speed))
    found = gx.travelling.modulation(wave, 2 * np.pi * np.arange(1, sites) / sites)
    rate = np.log(np.abs(known.multipliers).max()) * float(wave.speed) / length
    assert found.growth.max() == pytest.approx(rate, rel=1e-6) and rate > 1e-3
