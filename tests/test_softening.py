"""Strain-softening chains, and chains that soften and harden in turn."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import granjax as gx
from granjax import scenes
from granjax.theory import nls

BUILDERS = (scenes.foam, scenes.hollow_cylinders, scenes.origami, scenes.tensegrity)


@pytest.mark.parametrize("make", BUILDERS)
def test_builders_make_the_power_law(make):
    chain = make(6, 0.4, mass=2.0, stiffness=3.0, precompression=0.7, units="SI")
    assert chain.units == "SI"
    u = 0.01 * np.random.default_rng(0).normal(size=6)
    d0 = (0.7 / 3) ** (1 / 0.4)
    u *= d0 / np.abs(u).max() / 3
    F = 3 * (d0 - np.diff(np.concatenate([[0], u, [0]]))) ** 0.4
    np.testing.assert_allclose(chain.acceleration(0.0, jnp.asarray(u), jnp.zeros(6)), (F[:-1] - F[1:]) / 2, rtol=1e-9)
    K2 = 0.4 * 3 ** (1 / 0.4) * 0.7 ** (1 - 1 / 0.4)
    np.testing.assert_allclose(gx.linear.sound_speed(chain), np.sqrt(K2 / 2), rtol=1e-12)


def test_envelopes_are_bright_above_the_band_for_softening_alone():
    law = scenes.foam(5, 0.5).terms[0].law
    assert np.isclose(float(nls.B(*gx.laws.taylor(law))), 0.0883883476483184, rtol=1e-12)
    for p in (-3.0, 0.05, 0.3, 0.7, 0.95, 1.05, 1.5, 2.0, 4.0):
        K2, K3, K4 = (float(x) for x in gx.laws.taylor(gx.PowerLaw(1.3, p, 0.8)))
        d0 = (0.8 / 1.3) ** (1 / p)
        B = float(nls.B(K2, K3, K4))
        assert (B > 0) == (0 < p < 1)
        np.testing.assert_allclose(B, -(p**3) * (p - 1) * 1.3**2 * d0 ** (2 * p - 4) / (2 * K2**1.5), rtol=1e-10)


def test_bands_of_alternating_contacts_are_the_closed_form():
    chain = scenes.alternating(8, (1.7, 0.4), stiffnesses=(0.9, 1.3), precompression=0.8, mass=1.1)
    K1, K2 = (p * A ** (1 / p) * 0.8 ** (1 - 1 / p) for p, A in ((1.7, 0.9), (0.4, 1.3)))
    k = np.linspace(0.1, np.pi, 6)
    root = np.sqrt(K1**2 + K2**2 + 2 * K1 * K2 * np.cos(k))
    upper = K1 + K2 + root
    lower = 4 * K1 * K2 * np.sin(k / 2) ** 2 / upper
    omega = np.asarray(gx.linear.dispersion(chain, k).omega)
    np.testing.assert_allclose(omega, np.sqrt(np.stack([lower, upper], -1) / 1.1), rtol=1e-12)
    bands = gx.linear.bands(chain)
    np.testing.assert_allclose([bands.upper[0], bands.lower[1]],
                               np.sqrt(2 * np.array([min(K1, K2), max(K1, K2)]) / 1.1), rtol=1e-12)


def test_equal_exponents_are_one_chain():
    u = jnp.asarray(0.1 * np.random.default_rng(3).normal(size=6))
    for boundary in ("fixed", "free", "periodic"):
        a, b = scenes.alternating(6, (0.5, 0.5), boundary=boundary), scenes.foam(6, 0.5, boundary=boundary)
        np.testing.assert_allclose(a.force(0.0, u, 0 * u), b.force(0.0, u, 0 * u), rtol=1e-12, atol=1e-15)


def test_exponents_can_be_swept_and_differentiated():
    batch = jax.vmap(lambda p: scenes.alternating(6, jnp.stack([1.5, p])), out_axes=-1)(jnp.array([0.4, 0.5]))
    assert batch.lanes == (2,)
    soft = jax.vmap(lambda p: scenes.foam(6, p), out_axes=-1)(jnp.array([0.4, 0.5]))
    u = jnp.asarray(0.1 * np.random.default_rng(4).normal(size=6))
    for lanes, one in ((batch, scenes.alternating(6)), (soft, scenes.foam(6))):
        a = lanes.force(0.0, jnp.stack([u, u], -1), jnp.zeros((6, 2)))[:, 1]
        np.testing.assert_allclose(a, one.force(0.0, u, 0 * u), rtol=1e-12)
    # A = F0 = 1: c = sqrt(p)
    np.testing.assert_allclose(jax.grad(lambda p: gx.linear.sound_speed(scenes.foam(6, p), cell=1))(0.25), 1, rtol=1e-9)


@pytest.mark.parametrize("make, said", [
    (lambda: scenes.foam(6, 1.5), "exponent: expected numbers in \\(0, 1\\)"),
    (lambda: scenes.origami(6, 1.0), "gx.scenes.monomer"),
    (lambda: scenes.tensegrity(6, precompression=0.0), "infinitely stiff"),
    (lambda: scenes.hollow_cylinders(1), "sites"),
    (lambda: scenes.foam(6, stiffness=np.ones(3)), "one per contact"),
    (lambda: scenes.alternating(6, (1.5, -3.0)), "two bonds"),
    (lambda: scenes.alternating(6, 1.5), "as many stiffnesses as exponents"),
    (lambda: scenes.alternating(6, ()), "exponents"),
    (lambda: scenes.alternating(6, stiffnesses=(1.0, 2.0, 3.0)), "as many stiffnesses as exponents"),
    (lambda: scenes.alternating(7, boundary="periodic"), "multiple of 2"),
    (lambda: scenes.alternating(6, precompression=0.0), "infinitely stiff"),
])
def test_refused(make, said):
    with pytest.raises(ValueError, match=said):
        make()


def test_a_contact_that_re_opens_is_said_to_be_infinitely_stiff():
    chain = scenes.foam(8, boundary="free")
    run = gx.simulate(chain, gx.states.impact(chain, velocity=-3.0), 4.0)
    assert run.opening != "no" and "infinitely stiff" in repr(run)
