"""Strain-softening chains, and chains that soften and harden in turn."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import Mirrored
from numpy.testing import assert_allclose, assert_array_equal
from refusals import refused

import granjax as gx
from granjax import scenes

BUILDERS = (scenes.foam, scenes.hollow_cylinders, scenes.origami, scenes.tensegrity)


@pytest.mark.parametrize("make", BUILDERS)
def test_builders_make_the_power_law(make):
    chain = make(6, 0.4, mass=2.0, stiffness=3.0, precompression=0.7, units="SI")
    assert chain.units == "SI"
    u = np.random.default_rng(0).normal(size=6)
    d0 = (0.7 / 3) ** (1 / 0.4)
    u *= d0 / np.abs(u).max() / 3
    F = 3 * (d0 - np.diff(np.concatenate([[0], u, [0]]))) ** 0.4
    a = chain.acceleration(0.0, jnp.asarray(u), jnp.zeros(6))
    assert_allclose(a, (F[:-1] - F[1:]) / 2, rtol=1e-9)
    K2 = 0.4 * 3 ** (1 / 0.4) * 0.7 ** (1 - 1 / 0.4)
    assert_allclose(gx.linear.sound_speed(chain), np.sqrt(K2 / 2), rtol=1e-12)


@pytest.mark.slow
def test_bands_of_alternating_contacts_are_the_closed_form():
    chain = scenes.alternating(8, (1.7, 0.4), stiffnesses=(0.9, 1.3), precompression=0.8, mass=1.1)
    K1, K2 = (p * A ** (1 / p) * 0.8 ** (1 - 1 / p) for p, A in ((1.7, 0.9), (0.4, 1.3)))
    k = np.linspace(0.1, np.pi, 6)
    upper = K1 + K2 + np.sqrt(K1**2 + K2**2 + 2 * K1 * K2 * np.cos(k))
    lower = 4 * K1 * K2 * np.sin(k / 2) ** 2 / upper
    omega = np.asarray(gx.linear.dispersion(chain, k).omega)
    assert_allclose(omega, np.sqrt(np.stack([lower, upper], -1) / 1.1), rtol=1e-12)
    bands = gx.linear.bands(chain)
    edges = np.sqrt(2 * np.array([min(K1, K2), max(K1, K2)]) / 1.1)
    assert_allclose([bands.upper[0], bands.lower[1]], edges, rtol=1e-12)


@pytest.mark.slow
def test_exponents_can_be_swept_and_differentiated_and_equal_ones_make_one_chain():
    u = jnp.asarray(0.1 * np.random.default_rng(3).normal(size=6))

    def force(lattice):
        return lattice.force(0.0, u, 0 * u)

    for boundary in ("fixed", "periodic"):
        same = scenes.alternating(6, (0.5, 0.5), boundary=boundary)
        one = scenes.foam(6, 0.5, boundary=boundary)
        assert_allclose(force(same), force(one), rtol=1e-12, atol=1e-15)
    exponents = jnp.array([0.4, 0.5])
    for make in (lambda p: scenes.alternating(6, jnp.stack([1.5, p])), lambda p: scenes.foam(6, p)):
        batch = jax.vmap(make, out_axes=-1)(exponents)
        assert batch.lanes == (2,)
        lanes = batch.force(0.0, jnp.stack([u, u], -1), jnp.zeros((6, 2)))
        assert_allclose(lanes[:, 1], force(make(0.5)), rtol=1e-12)
    # A = F0 = 1: c = sqrt(p)
    slope = jax.grad(lambda p: gx.linear.sound_speed(scenes.foam(6, p), cell=1))(0.25)
    assert_allclose(slope, 1, rtol=1e-9)


def test_what_cannot_be_meant_is_refused():
    for call, said in (
        (lambda: scenes.foam(6, 1.5), "exponent: expected numbers in \\(0, 1\\)"),
        (lambda: scenes.origami(6, 1.0), "gx.scenes.monomer"),
        (lambda: scenes.tensegrity(6, precompression=0.0), "infinitely stiff"),
        (lambda: scenes.foam(6, stiffness=np.ones(3)), "one per contact"),
        (lambda: scenes.alternating(6, (1.5, -3.0)), "two bonds"),
        (lambda: scenes.alternating(6, stiffnesses=(1.0, 2.0, 3.0)), "as many stiffnesses"),
        (lambda: scenes.alternating(7, boundary="periodic"), "multiple of 2"),
    ):
        with refused(said):
            call()


@pytest.mark.slow
def test_a_contact_that_re_opens_is_said_to_be_infinitely_stiff():
    chain = scenes.foam(8, boundary="free")
    state = gx.states.impact(chain, velocity=-3.0)
    run = gx.simulate(chain, state, 4.0)
    assert run.opening != "no" and "infinitely stiff" in repr(run)
    assert "infinitely stiff" in gx.simulate(chain, state, 4.0, step=0.2).outcome


class Hardening(Mirrored):
    """The chain seen after u -> -u, which hardens where the other one softens."""

    opens = False

    @property
    def preload(self):
        return -self.law.preload


@pytest.mark.slow
def test_rarefaction_pulses_mirror_those_of_the_hardening_chain():
    law = scenes.origami(5, 0.5, stiffness=1.3, precompression=0.8).terms[0].law
    speed = 1.1 * float(jnp.sqrt(law.derivative(0.0)))
    soft, hard = (gx.travelling.solitary_wave(x, speed=speed) for x in (law, Hardening(law)))
    assert soft.amplitude < 0 < hard.amplitude and soft.error < 1e-12
    rounding = 2e-15 * float(hard.amplitude)
    assert_allclose(soft.strains, -np.asarray(hard.strains), rtol=0, atol=rounding)
    assert_allclose(soft.energy, hard.energy, rtol=1e-13)
    with refused("above that of sound"):
        gx.travelling.solitary_wave(law, speed=0.9 * speed)


@pytest.mark.slow
def test_a_rarefaction_shock_mirrors_the_shock_of_the_hardening_chain():
    law = scenes.hollow_cylinders(5).terms[0].law
    finals = []
    for own, side in ((Hardening(law), 1), (law, -1)):
        chain = gx.Lattice(1.0, gx.Bond(gx.Shift(1, "free"), own), sites=240)
        run = gx.shocks.velocity_shock(chain, 0.2 * side).run(130.0, step=0.2)
        finals.append(np.asarray(run.final))
    assert_array_equal(finals[0], -finals[1])
    shock = gx.shocks.measure(run)
    edges = gx.theory.shock_edges(law, -0.2)
    assert shock.mean < 0 and shock.outcome.startswith("A shock of rarefaction")
    assert_allclose(edges.mean, -gx.theory.shock_edges(Hardening(law), 0.2).mean, rtol=1e-13)
    assert_allclose(shock.mean, edges.mean, rtol=2e-3)
    assert_allclose(shock.leading_speed, edges.leading_speed, rtol=2e-2)


@pytest.mark.slow
def test_a_step_up_in_compression_spreads():
    chain = scenes.foam(100, boundary="free")
    with refused("This is a rarefaction|softens in compression"):
        gx.shocks.measure(gx.shocks.velocity_shock(chain, 0.1).run(40.0))


@pytest.mark.slow
def test_breathers_are_bright_above_the_band():
    chain = scenes.foam(61, boundary="free")
    omega = 1.003 * np.sqrt(2)
    bright = gx.breathers.breather(chain, omega, "bright", steps=64)
    guess = gx.breathers.guesses.bright_guess(chain, omega)
    own, envelope = (-np.diff(x.u) for x in (bright.state, guess))
    assert bright.converged and np.abs(own - envelope).max() < 0.04 * np.abs(own).max()
    assert np.abs(own).max() < 1  # contacts stay closed, d0 = 1
    with refused("nonlinearity raises the frequency"):
        gx.breathers.breather(chain, 0.99 * np.sqrt(2), "dark")
