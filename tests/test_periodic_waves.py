"""Periodic waves for modulation theory, against the Stokes expansion, averages of families, Toda's in closed form."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import granjax as gx
from granjax.theory import toda
from granjax.travelling import periodic_wave

HERTZ = gx.Hertz(precompression=1.0)


def expansion(k, a, K2, K3, K4, m=1.0):
    """The strain y(theta), frequency, what the amplitude adds to it, and third harmonic, to the third order in a.

    G. B. Whitham, Linear and Nonlinear Waves (Wiley, 1974), chapter 13; for chains Y. A. Kosevich,
    Phys. Rev. B 47, 3138 (1993). F = K2 y + K3 y^2 + K4 y^3, no mean strain, a of the first harmonic.
    """
    D = 4 * np.sin(k / 2) ** 2
    second = K3 * a**2 / (2 * K2) / np.tan(k / 2) ** 2
    third = (K3 * a * second + K4 * a**3 / 4) * (3 - D) ** 2 / (K2 * D * (6 - D))
    omega = np.sqrt(D / m * (K2 + K3 * second + 0.75 * K4 * a**2))
    strain = lambda x: a * np.cos(x) + second * np.cos(2 * x) + third * np.cos(3 * x)
    return strain, omega, omega - np.sqrt(D * K2 / m), third


@pytest.mark.parametrize("k", [np.pi, 0.8])
def test_what_the_expansion_leaves_out_falls_with_the_fourth_power(k):
    mean = 0.2
    mass = 0.7
    K = np.array(gx.laws.taylor(HERTZ, mean))
    theta = np.linspace(0, 2 * np.pi, 17)
    gaps = []
    for a in (0.04, 0.02):
        strain, omega, shift, third = expansion(k, a, *K, mass)
        # half of crest less trough is the first harmonic with the third
        length = 2 * np.pi / k * (1 + 1e-12)
        crest = float(a + third)
        own = periodic_wave(HERTZ, length, amplitude=crest, mean=mean, mass=mass)
        left = np.abs(own.strain(theta / k) - mean - strain(theta)).max()
        gaps.append((k * float(own.speed) - omega, left))
        assert abs(gaps[-1][0]) < 0.1 * abs(shift)
    ratio = np.log2(np.abs(np.array(gaps[0]) / np.array(gaps[1])))
    assert ratio[0] == pytest.approx(4, abs=0.05) and ratio[1] > 3.9


@pytest.mark.slow
def test_the_error_covers_waves_whose_contacts_open(monkeypatch):
    """By chance, two grids agree here to a quarter of the error of the finer one."""
    make = lambda: periodic_wave(gx.Hertz(), 6.0, amplitude=0.55, mean=0.3)
    wave = make()
    monkeypatch.setattr("granjax.profiles.periodic.POINTS", (32, 128, 512, 2048))
    x = np.linspace(-3, 3, 401)
    off = np.abs(wave.strain(x) - make().strain(x)).max()
    assert 1e-9 < off < float(wave.error)


@pytest.mark.slow
@pytest.mark.parametrize("E", [(-1.2, 0.2, 0.7, 1.5), (-1.0, 0.5, 1.29, 1.3)])
def test_the_periodic_family_of_toda_is_that_of_the_closed_form(E):
    # a number added to all four takes the mean velocity away
    E = np.array(E) - float(toda.periodic_numbers(*E).mean_velocity) / 2
    numbers = toda.periodic_numbers(*E)
    length, speed, mean = map(float, (numbers.wavelength, numbers.speed, numbers.mean_strain))
    wave = periodic_wave(gx.Toda(), length, speed=speed, mean=mean)
    x = length / 64 * np.arange(64)
    exact = toda.periodic_wave(x, 0.0, *E)
    assert_allclose(wave.strain(x), exact.strain, atol=1e-12)
    assert_allclose(wave.velocity(x), exact.velocity, atol=1e-10)
    assert float(wave.error) < 1e-10
    again = periodic_wave(gx.Toda(), length, amplitude=wave.amplitude, mean=mean)
    assert_allclose(again.speed, speed, rtol=1e-12)
    state = wave.state(9, 3.3)
    there = toda.periodic_wave(np.arange(9) - 3.3, 0.0, *E)
    assert_allclose(-np.diff(state.u), there.strain[:8], atol=1e-12)
    found = wave.averages()
    force = jnp.expm1(exact.strain)
    kinetic = (exact.velocity**2).mean() / 2
    potential = (force - exact.strain).mean()
    assert_allclose(found.mean_force, force.mean(), atol=1e-10)
    assert_allclose(found.kinetic, kinetic, atol=1e-10)
    assert_allclose(found.energy, kinetic + potential, atol=1e-10)
    assert_allclose(found.mean_strain, mean, atol=1e-12)


@pytest.mark.slow
def test_a_periodic_wave_runs_around_a_ring():
    wave = periodic_wave(gx.Hertz(), 9.0, amplitude=0.3, mean=0.5)
    n = np.arange(18)
    u, v = wave.state(18)
    law = gx.laws.Strained(wave.law, wave.mean)
    ring = gx.Lattice(1.0, gx.Bond(gx.Shift(1, "periodic"), law), sites=18)
    end = 18 / float(wave.speed)
    run = gx.simulate(ring, (u + wave.mean * n, v), end, tolerance=1e-12)
    assert_allclose(run.final.v, v, atol=1e-8)


@pytest.mark.slow
def test_averages_are_derivatives_of_the_lagrangian():
    """dL/d omega is the action, dL/dk less its flux, dL/dy less the mean force."""

    def lagrangian(omega, k, mean):
        wave = periodic_wave(HERTZ, 2 * np.pi / k, speed=omega / k, mean=mean, mass=0.7)
        return float(wave.averages().lagrangian)

    found = periodic_wave(HERTZ, 7.0, amplitude=0.4, mean=0.1, mass=0.7).averages()
    x = np.array([float(found.omega), float(found.wavenumber), 0.1])
    h = 1e-4
    wanted = found.action, -found.energy_flux / found.omega, -found.mean_force
    for e, value in zip(np.eye(3), wanted):
        L = [lagrangian(*(x + s * h * e)) for s in (1, -1, 2, -2)]
        slope = (8 * (L[0] - L[1]) - (L[2] - L[3])) / (12 * h)
        assert_allclose(slope, value, rtol=1e-9)
    assert_allclose(found.action, 2 * found.kinetic / found.omega, rtol=1e-12)
    assert found.error < 1e-12


def test_the_averages_error_is_relative_to_the_energy_and_the_largest_force():
    a = 1e-5
    found = periodic_wave(gx.Toda(), 6.0, amplitude=a).averages()
    assert abs(found.lagrangian - a**4 / 16) < found.error * found.energy
    assert abs(found.mean_force - a**2 / 4) < found.error * a
    assert abs(found.mean_strain) < found.error * a
    told = type(found).__dataclass_fields__["error"].metadata
    assert "relative to `energy`" in str(told)


@pytest.mark.slow
def test_derivatives_of_periodic_waves_in_both_modes():
    """By all numbers and the law's parameters, of the wave and of its averages, against differences."""
    where = dict(A=1.0, F=0.4, length=7.3, amplitude=0.3, mean=0.1, mass=0.8)

    def found(p):
        law = gx.Hertz(p["A"], p["F"])
        own = {name: p[name] for name in ("amplitude", "mean", "mass")}
        wave = periodic_wave(law, p["length"], **own)
        means = wave.averages()
        places = wave.strain(1.3), wave.velocity(0.7), wave.displacement(2.1)
        return jnp.stack([wave.speed, wave.energy, *places, means.action, means.energy_flux])

    forward = jax.jacfwd(found)(where)
    reverse = jax.jacrev(found)(where)
    for name, x in where.items():
        either = [np.asarray(found({**where, name: x + h})) for h in (1e-4, -1e-4)]
        assert_allclose(forward[name], (either[0] - either[1]) / 2e-4, atol=1e-6)
        assert_allclose(reverse[name], forward[name], atol=1e-11)
    by_speed = lambda c: periodic_wave(gx.Toda(), 6.0, speed=c).amplitude
    slope = (by_speed(0.9701) - by_speed(0.9699)) / 2e-4
    assert_allclose(jax.grad(by_speed)(0.97), slope, rtol=1e-4)


@pytest.mark.slow
def test_a_long_wave_of_toda_has_one_crest_and_the_speed_of_the_closed_form():
    E = np.array((-1.0, 1.0, 1.02, 1.02 + 1e-11))
    E -= float(toda.periodic_numbers(*E).mean_velocity) / 2
    numbers = toda.periodic_numbers(*E)
    length, mean = float(numbers.wavelength), float(numbers.mean_strain)
    height = float(numbers.crest - numbers.trough) / 2
    wave = periodic_wave(gx.Toda(), length, amplitude=height, mean=mean)
    assert_allclose(wave.speed, numbers.speed, rtol=1e-12)
    x = length / 64 * np.arange(64)
    assert_allclose(wave.strain(x), toda.periodic_wave(x, 0.0, *E).strain, atol=1e-12)
