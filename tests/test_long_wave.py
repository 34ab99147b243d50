"""Long-wave equations: each solitary wave in its own and in no other, and their linear waves."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

from granjax.theory import compacton, long_wave

SPEED = 1.3
STIFFNESS = 2.0
MASS = 0.7
UNITS = dict(speed=SPEED, stiffness=STIFFNESS, mass=MASS)
WAVES = {
    "displacement": compacton.nesterenko,
    "strain": compacton.ahnert_pikovsky,
    "regularised": long_wave.regularised_wave,
}


def residual(profile, x, force, form):
    """What a wave y = profile(n - c t) leaves of an equation, integrated twice: m c^2 y - F(y) - R/12."""

    def left(x):
        y = profile(x)
        slope = jax.grad(profile)(x)
        bend = jax.grad(jax.grad(profile))(x)
        F1 = jax.grad(force)(y)
        F2 = jax.grad(jax.grad(force))(y)
        inertia = MASS * SPEED**2
        second = {
            "displacement": F1 * bend + F2 * slope**2 / 2,
            "strain": F1 * bend + F2 * slope**2,
            "regularised": inertia * bend,
        }[form]
        return inertia * y - force(y) - second / 12

    return jax.vmap(left)(jnp.asarray(x))


@pytest.mark.slow
@pytest.mark.parametrize("p", [1.1, 1.5, 5.5])
def test_each_wave_solves_its_own_equation_and_no_other(p):
    x = np.linspace(-0.95, 0.95, 9) * float(compacton.nesterenko(0.0, p).half_width)
    # at p = 1 all three are one
    force = lambda y: STIFFNESS * y**p
    apart = min(0.0125, 0.05 * (p - 1) ** 2)
    for own, wave in WAVES.items():
        size = MASS * SPEED**2 * float(wave(0.0, p, **UNITS).strain)
        for form in WAVES:
            left = residual(lambda x: wave(x, p, **UNITS).strain, x, force, form) / size
            most = np.abs(left).max()
            assert most < 1e-13 if form == own else most > apart, (own, form)


def test_the_regularised_wave():
    x = np.linspace(-6, 6, 7)
    want = 25 / 16 / np.cosh(np.sqrt(3) / 2 * x) ** 4
    assert_allclose(long_wave.regularised_wave(x).strain, want, rtol=1e-13)
    assert_allclose(long_wave.regularised_wave(0.0, 2.0, speed=2.0).strain, 6.0, rtol=1e-13)
    # reverse mode of all that it returns: the half width is infinite
    every = jax.jacrev(lambda p: long_wave.regularised_wave(x, p))(1.5)
    strain = jax.jacfwd(lambda p: long_wave.regularised_wave(x, p).strain)(1.5)
    assert_allclose(every.strain, strain, rtol=1e-13)
    assert not np.any(every.half_width)
    # far out it neither overflows nor is cut off
    far = 25 * np.exp(-600 * np.sqrt(3))
    assert_allclose(long_wave.regularised_wave(-300.0).strain, far, rtol=1e-11)


def test_linear_waves_of_the_ill_posed_equations_grow_beyond_root_twelve():
    k = np.array([1e-3, 1.0, np.sqrt(12) * 0.999, np.sqrt(12) * 1.001, 50.0])
    ill_posed = k**2 * (1 - k**2 / 12)
    for form in ("displacement", "strain"):
        found = long_wave.omega_squared(k, form)
        assert_allclose(found, ill_posed, rtol=1e-11)
        assert (np.sign(found) == [1, 1, 1, -1, -1]).all()
    found = long_wave.omega_squared(k, "regularised", K2=2.0, mass=0.5)
    assert_allclose(found, 4 * k**2 / (1 + k**2 / 12), rtol=1e-13)
    assert (found < 48).all()
    for form in long_wave.FORMS:
        # to the order that they keep they are the lattice
        assert_allclose(long_wave.omega_squared(0.1, form), 4 * np.sin(0.05) ** 2, rtol=1e-5)
