"""Strain-softening chains, and chains that soften and harden in turn."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose
from refusals import refused

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
    assert_allclose(
        chain.acceleration(0.0, jnp.asarray(u), jnp.zeros(6)), (F[:-1] - F[1:]) / 2, rtol=1e-9
    )
    K2 = 0.4 * 3 ** (1 / 0.4) * 0.7 ** (1 - 1 / 0.4)
    assert_allclose(gx.linear.sound_speed(chain), np.sqrt(K2 / 2), rtol=1e-12)


@pytest.mark.slow
def test_envelopes_are_bright_above_the_band_for_softening_alone():
    law = scenes.foam(5, 0.5).terms[0].law
    assert np.isclose(float(nls.B(*gx.laws.taylor(law))), 0.0883883476483184, rtol=1e-12)
    for p in (-3.0, 0.05, 0.3, 0.7, 0.95, 1.05, 1.5, 2.0, 4.0):
        K2, K3, K4 = (float(x) for x in gx.laws.taylor(gx.PowerLaw(1.3, p, 0.8)))
        d0 = (0.8 / 1.3) ** (1 / p)
        B = float(nls.B(K2, K3, K4))
        assert (B > 0) == (0 < p < 1)
        assert_allclose(
            B, -(p**3) * (p - 1) * 1.3**2 * d0 ** (2 * p - 4) / (2 * K2**1.5), rtol=1e-10
        )


def test_bands_of_alternating_contacts_are_the_closed_form():
    chain = scenes.alternating(8, (1.7, 0.4), stiffnesses=(0.9, 1.3), precompression=0.8, mass=1.1)
    K1, K2 = (p * A ** (1 / p) * 0.8 ** (1 - 1 / p) for p, A in ((1.7, 0.9), (0.4, 1.3)))
    k = np.linspace(0.1, np.pi, 6)
    root = np.sqrt(K1**2 + K2**2 + 2 * K1 * K2 * np.cos(k))
    upper = K1 + K2 + root
    lower = 4 * K1 * K2 * np.sin(k / 2) ** 2 / upper
    omega = np.asarray(gx.linear.dispersion(chain, k).omega)
    assert_allclose(omega, np.sqrt(np.stack([lower, upper], -1) / 1.1), rtol=1e-12)
    bands = gx.linear.bands(chain)
    assert_allclose(
        [bands.upper[0], bands.lower[1]],
        np.sqrt(2 * np.array([min(K1, K2), max(K1, K2)]) / 1.1),
        rtol=1e-12,
    )


@pytest.mark.slow
def test_equal_exponents_are_one_chain():
    u = jnp.asarray(0.1 * np.random.default_rng(3).normal(size=6))
    for boundary in ("fixed", "free", "periodic"):
        a, b = (
            scenes.alternating(6, (0.5, 0.5), boundary=boundary),
            scenes.foam(6, 0.5, boundary=boundary),
        )
        assert_allclose(a.force(0.0, u, 0 * u), b.force(0.0, u, 0 * u), rtol=1e-12, atol=1e-15)


@pytest.mark.slow
def test_exponents_can_be_swept_and_differentiated():
    batch = jax.vmap(lambda p: scenes.alternating(6, jnp.stack([1.5, p])), out_axes=-1)(
        jnp.array([0.4, 0.5])
    )
    assert batch.lanes == (2,)
    soft = jax.vmap(lambda p: scenes.foam(6, p), out_axes=-1)(jnp.array([0.4, 0.5]))
    u = jnp.asarray(0.1 * np.random.default_rng(4).normal(size=6))
    for lanes, one in ((batch, scenes.alternating(6)), (soft, scenes.foam(6))):
        a = lanes.force(0.0, jnp.stack([u, u], -1), jnp.zeros((6, 2)))[:, 1]
        assert_allclose(a, one.force(0.0, u, 0 * u), rtol=1e-12)
    # A = F0 = 1: c = sqrt(p)
    assert_allclose(
        jax.grad(lambda p: gx.linear.sound_speed(scenes.foam(6, p), cell=1))(0.25), 1, rtol=1e-9
    )


@pytest.mark.parametrize(
    "make, said",
    [
        (lambda: scenes.foam(6, 1.5), "exponent: expected numbers in \\(0, 1\\)"),
        (lambda: scenes.origami(6, 1.0), "gx.scenes.monomer"),
        (lambda: scenes.tensegrity(6, precompression=0.0), "infinitely stiff"),
        (lambda: scenes.foam(6, stiffness=np.ones(3)), "one per contact"),
        (lambda: scenes.alternating(6, (1.5, -3.0)), "two bonds"),
        (
            lambda: scenes.alternating(6, stiffnesses=(1.0, 2.0, 3.0)),
            "as many stiffnesses as exponents",
        ),
        (lambda: scenes.alternating(7, boundary="periodic"), "multiple of 2"),
    ],
)
def test_refused(make, said):
    with refused(said):
        make()


@pytest.mark.study
def test_a_contact_that_re_opens_is_said_to_be_infinitely_stiff():
    chain = scenes.foam(8, boundary="free")
    run = gx.simulate(chain, gx.states.impact(chain, velocity=-3.0), 4.0)
    assert run.opening != "no" and "infinitely stiff" in repr(run)
    assert (
        "infinitely stiff"
        in gx.simulate(chain, gx.states.impact(chain, velocity=-3.0), 4.0, step=0.2).outcome
    )


class Mirrored(gx.Law):
    """F(e) = -F_law(-e): the chain seen after u -> -u, which hardens where the other one softens."""

    opens = False
    law: gx.Law

    @property
    def preload(self):
        return -self.law.preload

    def force(self, e):
        return -self.law.force(-e)

    def energy(self, e):
        return self.law.energy(-e)


@pytest.mark.parametrize(
    "p",
    [
        pytest.param(0.5, marks=pytest.mark.slow),
        pytest.param(jnp.asarray(0.37), marks=pytest.mark.study),
    ],
)
def test_rarefaction_pulses_mirror_those_of_the_hardening_chain(p):
    law = scenes.origami(5, p, stiffness=1.3, precompression=0.8).terms[0].law
    speed = 1.1 * float(jnp.sqrt(law.derivative(0.0)))
    soft, hard = (gx.travelling.solitary_wave(x, speed=speed) for x in (law, Mirrored(law)))
    assert soft.amplitude < 0 < hard.amplitude and soft.error < 1e-12
    assert_allclose(
        soft.strains, -np.asarray(hard.strains), rtol=0, atol=2e-15 * float(hard.amplitude)
    )
    assert_allclose(soft.energy, hard.energy, rtol=1e-13)
    with refused("above that of sound"):
        gx.travelling.solitary_wave(law, speed=0.9 * speed)


@pytest.mark.study
def test_a_rarefaction_shock_mirrors_the_shock_of_the_hardening_chain():
    law = scenes.hollow_cylinders(5).terms[0].law
    found = []
    for own, side in ((law, -1), (Mirrored(law), 1)):
        chain = gx.Lattice(1.0, gx.Bond(gx.Shift(1, "free"), own), sites=240)
        run = gx.shocks.velocity_shock(chain, 0.2 * side).run(130.0, step=0.2)
        found.append((run, gx.shocks.measure(run), gx.theory.shock_edges(own, 0.2 * side)))
    (soft, shock, edges), (hard, mirror, others) = found
    np.testing.assert_array_equal(soft.final.u, -np.asarray(hard.final.u))
    np.testing.assert_array_equal(soft.final.v, -np.asarray(hard.final.v))
    assert shock.mean < 0 and float(shock.mean) == -float(mirror.mean)
    assert_allclose(shock.leading_speed, mirror.leading_speed, rtol=1e-10)
    assert shock.outcome.startswith("A shock of rarefaction") and mirror.outcome.startswith(
        "A shock of compression"
    )
    assert_allclose(edges.mean, -others.mean, rtol=1e-13)
    assert_allclose(shock.mean, edges.mean, rtol=2e-3)
    assert_allclose(shock.leading_speed, edges.leading_speed, rtol=2e-2)


@pytest.mark.slow
def test_a_step_up_in_compression_spreads():
    chain = scenes.foam(100, boundary="free")
    with refused("This is a rarefaction|softens in compression"):
        gx.shocks.measure(gx.shocks.velocity_shock(chain, 0.1).run(40.0))


@pytest.mark.study
def test_bright_breathers_above_the_band():
    chain = scenes.foam(61, boundary="free")
    omega = 1.003 * np.sqrt(2)
    bright = gx.breathers.breather(chain, omega, "bright", steps=64)
    guess = gx.breathers.guesses.bright_guess(chain, omega)
    own, envelope = (-np.diff(x.u) for x in (bright.state, guess))
    assert bright.converged and np.abs(own - envelope).max() < 0.04 * np.abs(own).max()
    assert np.abs(own).max() < 1  # contacts stay closed, d0 = 1
    with refused("nonlinearity raises the frequency"):
        gx.breathers.breather(chain, 0.99 * np.sqrt(2), "dark")
    hard = scenes.monomer(61, precompression=1.0, boundary="free")
    with refused("only dark"):
        gx.breathers.breather(hard, 1.003 * np.sqrt(6), "bright")


@pytest.mark.study
def test_a_compressive_impact_sends_a_rarefaction_pulse_ahead():
    # the struck contact opens as the bead comes back: infinitely stiff there, so the step is halved to know the rest
    chain = scenes.origami(160, 0.5, boundary="free")
    sound, found = np.sqrt(0.5), []
    for step in (0.1, 0.05):
        run = gx.simulate(chain, gx.states.impact(chain, velocity=5.0), 130 / sound, step=step)
        found.append(-np.diff(np.asarray(run.final.u)))
    assert run.opening == "yes" and "infinitely stiff" in run.outcome
    y = found[1]
    lead = 110 + int(np.argmin(y[110:]))
    assert y[lead] < -0.8 and y[lead + 4 :].min() > -0.01
    error = np.abs(found[0] - found[1])[lead - 2 : lead + 5].max()
    assert error < 5e-3

    # a solitary wave at its place between two contacts, but for the waves that still follow closely
    pulse = gx.travelling.solitary_wave(chain, amplitude=-0.91)
    places = np.linspace(-0.6, 0.6, 241)
    misfit = min(
        np.abs(pulse.strain(np.arange(-1, 5) - x) - y[lead - 1 : lead + 5]).max() for x in places
    )
    assert misfit < 0.03 and float(pulse.speed) > 1.1 * sound


@pytest.mark.study
def test_breathers_of_contacts_that_harden_and_soften_in_turn():
    chain = scenes.alternating(41, boundary="free")
    bright = gx.breathers.breather(chain, 1.72, "bright", steps=64)
    assert bright.converged and 1 < 1.72 < float(gx.linear.bands(chain).lower[1])
    assert (
        np.abs(np.diff(bright.state.u)).max() < 1
        and float(jnp.abs(bright.error.state.u).max()) < 1e-9
    )
