"""Periodic waves for modulation theory: the Stokes expansion, averages of families, Toda's in closed form."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose
from refusals import refused

import granjax as gx
from granjax.theory import stokes, toda

HERTZ = gx.Hertz(precompression=1.0)


def test_the_frequency_at_the_edge_of_the_band():
    K = gx.laws.taylor(HERTZ)
    for constraint, value in (("length", -0.153093), ("force", -0.459279)):
        found = stokes.wave(np.pi, np.array([1e-3, 1e-6]), *K, constraint=constraint)
        assert_allclose(found.shift / (found.first**2 / 4), value, rtol=5e-6)
    # B = (3 K2 K4 - 4 K3^2)/K2^{3/2} of softening contacts and of magnets
    for p, B in ((0.5, 0.0883883), (-3.0, -10.3923048)):
        K = gx.laws.taylor(gx.PowerLaw(1.0, p, 1.0))
        assert stokes.wave(np.pi, 1e-5, *K, constraint="force").shift / 0.25e-10 == pytest.approx(
            B, rel=1e-6
        )


@pytest.mark.parametrize("k", [np.pi, 2.0, 0.8])
def test_what_the_expansion_leaves_out_falls_with_the_fourth_power(k):
    mean, mass, amplitudes = 0.2, 0.7, np.array([0.04, 0.02])
    found = stokes.wave(k, amplitudes, *gx.laws.taylor(HERTZ, mean), mass)
    theta, gaps = np.linspace(0, 2 * np.pi, 17), []
    for i, a in enumerate(amplitudes):
        # half of crest less trough is the first harmonic with the third
        own = gx.travelling.periodic_wave(
            HERTZ,
            2 * np.pi / k * (1 + 1e-12),
            amplitude=float(a + found.third[i]),
            mean=mean,
            mass=mass,
        )
        one = stokes.wave(k, a, *gx.laws.taylor(HERTZ, mean), mass)
        gaps.append(
            (
                k * float(own.speed) - one.omega,
                np.abs(own.strain(theta / k) - mean - one.strain(theta)).max(),
            )
        )
        assert abs(gaps[-1][0] / one.shift) < one.error
    ratio = np.log2(np.abs(np.array(gaps[0]) / np.array(gaps[1])))
    assert ratio[0] == pytest.approx(4, abs=0.05) and ratio[1] > 3.9


def test_the_force_or_the_length_is_held():
    K2, K3, K4 = gx.laws.taylor(HERTZ)
    length, force = (stokes.wave(1.0, 0.01, K2, K3, K4, constraint=x) for x in ("length", "force"))
    theta = np.linspace(0, 2 * np.pi, 64, endpoint=False)
    for found, strain, mean_force in ((length, 0.0, K3 * 0.5e-4), (force, -K3 * 0.5e-4 / K2, 0.0)):
        y = found.strain(theta)
        assert y.mean() == pytest.approx(float(strain), abs=1e-17)
        assert HERTZ.force(y).mean() == pytest.approx(float(mean_force), abs=1e-8)
        assert found.mean_force == pytest.approx(float(mean_force), abs=1e-17)


def test_the_expansion_differentiates_and_compiles():
    def shift(x):
        return stokes.wave(*x).shift

    x, h = jnp.array([1.0, 0.1, 1.5, 0.4, -0.1, 0.7]), 1e-5
    central = jnp.stack([shift(x + h * e) - shift(x - h * e) for e in np.eye(6)]) / (2 * h)
    assert_allclose(jax.jit(jax.grad(shift))(x), central, atol=1e-9)
    with refused("^k: expected numbers in"):
        stokes.wave(3.2, 0.1, 1.0, 0.5, 0.1)
    with refused("^constraint"):
        stokes.wave(3.0, 0.1, 1.0, 0.5, 0.1, constraint="mean")


@pytest.mark.slow
@pytest.mark.parametrize("E", [(-1.2, 0.2, 0.7, 1.5), (-1.3, 0.3, 1.0, 1.25)])
def test_the_periodic_family_of_toda_is_that_of_the_closed_form(E):
    # a number added to all four takes the mean velocity away
    E = np.array(E) - float(toda.periodic_numbers(*E).mean_velocity) / 2
    numbers = toda.periodic_numbers(*E)
    length, speed, mean = (
        float(x) for x in (numbers.wavelength, numbers.speed, numbers.mean_strain)
    )
    wave = gx.travelling.periodic_wave(gx.Toda(), length, speed=speed, mean=mean)
    x = length / 64 * np.arange(64)
    exact = toda.periodic_wave(x, 0.0, *E)
    assert_allclose(wave.strain(x), exact.strain, atol=1e-10)
    assert_allclose(wave.velocity(x), exact.velocity, atol=1e-10)
    found = wave.averages()
    assert found.mean_force == pytest.approx(float(jnp.expm1(exact.strain).mean()), abs=1e-10)
    assert found.kinetic == pytest.approx(float((exact.velocity**2).mean() / 2), abs=1e-10)
    assert found.mean_strain == pytest.approx(mean, abs=1e-12)


def test_averages_are_derivatives_of_the_lagrangian():
    """dL/d omega is the action, dL/dk less its flux, dL/dy less the mean force."""

    def at(x):
        omega, k, mean = x
        return gx.travelling.periodic_wave(
            HERTZ, 2 * np.pi / k, speed=omega / k, mean=mean, mass=0.7
        ).averages()

    found = gx.travelling.periodic_wave(HERTZ, 7.0, amplitude=0.4, mean=0.1, mass=0.7).averages()
    x, h = np.array([float(found.omega), float(found.wavenumber), 0.1]), 1e-4
    wanted = found.action, -found.energy_flux / found.omega, -found.mean_force
    for e, value in zip(np.eye(3), wanted):
        L = [float(at(x + s * h * e).lagrangian) for s in (1, -1, 2, -2)]
        assert (8 * (L[0] - L[1]) - (L[2] - L[3])) / (12 * h) == pytest.approx(
            float(value), rel=1e-9
        )
    assert (
        found.action == pytest.approx(float(2 * found.kinetic / found.omega))
        and found.error < 1e-12
    )


def test_averages_of_small_waves_are_those_of_the_expansion():
    a, k = 1e-3, 1.0
    found = gx.travelling.periodic_wave(HERTZ, 2 * np.pi / k, amplitude=a).averages()
    # energy a^2 K2/2, in equal halves, which runs with the group velocity
    assert found.energy == pytest.approx(0.75e-6, rel=1e-5) and found.kinetic == pytest.approx(
        0.375e-6, rel=1e-5
    )
    assert found.energy_flux / found.energy == pytest.approx(1.5**0.5 * np.cos(k / 2), rel=1e-5)
    one = stokes.wave(k, a, *gx.laws.taylor(HERTZ))
    assert found.mean_force == pytest.approx(float(one.mean_force), rel=1e-5)
