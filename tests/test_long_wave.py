"""Long-wave equations: each solitary wave in its own and in no other, and the regularised one in time."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from granjax.theory import compacton, long_wave

SPEED, STIFFNESS, MASS = 1.3, 2.0, 0.7
TIGHT = dict(rtol=1e-12, atol=1e-13)
UNITS = dict(speed=SPEED, stiffness=STIFFNESS, mass=MASS)
WAVES = {
    "displacement": compacton.nesterenko,
    "strain": compacton.ahnert_pikovsky,
    "regularised": long_wave.regularised_wave,
}


def residual(profile, x, force, form):
    """What a wave y = profile(n - c t) leaves of an equation, integrated twice: m c^2 y - F(y) - R/12."""

    def left(x):
        y, slope, bend = profile(x), jax.grad(profile)(x), jax.grad(jax.grad(profile))(x)
        F1, F2, inertia = jax.grad(force)(y), jax.grad(jax.grad(force))(y), MASS * SPEED**2
        second = {
            "displacement": F1 * bend + F2 * slope**2 / 2,
            "strain": F1 * bend + F2 * slope**2,
            "regularised": inertia * bend,
        }[form]
        return inertia * y - force(y) - second / 12

    return jax.vmap(left)(jnp.asarray(x))


@pytest.mark.slow
@pytest.mark.parametrize(
    "p", [1.5, 3.0, *(pytest.param(p, marks=pytest.mark.slow) for p in (1.1, 2.0, 5.5))]
)
def test_each_wave_solves_its_own_equation_and_no_other(p):
    x = np.linspace(-0.95, 0.95, 9) * float(compacton.nesterenko(0.0, p).half_width)
    # at p = 1 all three are one
    force, apart = lambda y: STIFFNESS * y**p, min(0.0125, 0.05 * (p - 1) ** 2)
    for own, wave in WAVES.items():
        size = MASS * SPEED**2 * float(wave(0.0, p, **UNITS).strain)
        for form in WAVES:
            left = residual(lambda x: wave(x, p, **UNITS).strain, x, force, form) / size
            assert np.abs(left).max() < 1e-13 if form == own else np.abs(left).max() > apart, (
                own,
                form,
            )


def test_the_regularised_wave():
    x = np.linspace(-6, 6, 7)
    want = 25 / 16 / np.cosh(np.sqrt(3) / 2 * x) ** 4
    np.testing.assert_allclose(long_wave.regularised_wave(x).strain, want, rtol=1e-13)
    assert long_wave.regularised_wave(0.0, 2.0, speed=2.0).strain == pytest.approx(6.0)
    # far out it neither overflows nor is cut off
    assert long_wave.regularised_wave(-300.0).strain == pytest.approx(
        25 * np.exp(-600 * np.sqrt(3)), rel=1e-11
    )


def test_linear_waves_of_the_ill_posed_equations_grow_beyond_root_twelve():
    k = np.array([1e-3, 1.0, np.sqrt(12) * 0.999, np.sqrt(12) * 1.001, 50.0])
    for form in ("displacement", "strain"):
        assert (np.sign(long_wave.omega_squared(k, form)) == [1, 1, 1, -1, -1]).all()
    found = long_wave.omega_squared(k, "regularised", K2=2.0, mass=0.5)
    assert (found > 0).all() and (found < 48).all()
    for form in long_wave.FORMS:
        assert long_wave.omega_squared(0.1, form) == pytest.approx(4 * np.sin(0.05) ** 2, rel=1e-5)


X, BOX = 360, 30.0
PLACES = (np.arange(X) - X // 2) * BOX / X


def ended(force, y, rate, time):
    """The strain of m y_tt = d_x^2 F(y) + m y_ttxx/12 in a periodic box, by Fourier and DOP853."""
    k = 2 * np.pi * np.fft.rfftfreq(X, BOX / X)
    symbol = -(k**2) / (MASS * (1 + k**2 / 12))

    def rates(t, z):
        y, v = np.split(z, 2)
        return np.concatenate([v, np.fft.irfft(symbol * np.fft.rfft(force(y)), X)])

    found = solve_ivp(rates, (0, time), np.concatenate([y, rate]), method="DOP853", **TIGHT)
    return found.y[:X, -1]


@pytest.mark.slow
def test_the_regularised_wave_travels():
    """Over a third of the box it keeps its shape."""
    wave = lambda x: long_wave.regularised_wave(x, **UNITS).strain
    rate = -SPEED * np.asarray(jax.vmap(jax.grad(wave))(PLACES))
    force = lambda y: STIFFNESS * np.maximum(y, 0) ** 1.5
    y = ended(force, np.asarray(wave(PLACES)), rate, 10.0)
    want = wave((PLACES - 10 * SPEED + BOX / 2) % BOX - BOX / 2)
    np.testing.assert_allclose(y, want, atol=1e-9 * want.max())


@pytest.mark.slow
def test_small_waves_run_as_the_linear_branch_says():
    k = 2 * np.pi * 3 / BOX
    y = 1.0 + 1e-6 * np.cos(k * PLACES)
    K2 = 0.8 * 1.1 * np.exp(1.1)
    period = 2 * np.pi / np.sqrt(float(long_wave.omega_squared(k, "regularised", K2=K2, mass=MASS)))
    force = lambda y: 0.8 * np.expm1(1.1 * y)
    np.testing.assert_allclose(ended(force, y, 0 * y, period), y, atol=1e-10)
