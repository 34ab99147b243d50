"""Stability of standing solitons of first-order lattices, and Salerno's lattice with its integrable limit."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose
from refusals import refused

from granjax.first_order import (
    DNLS,
    Equation,
    Salerno,
    evolve,
    soliton,
    soliton_family,
    stability,
)

SITES = 60
EQUATION = DNLS(SITES)


@pytest.fixture(scope="module")
def bond_centred():
    """A soliton between two sites, and its stability."""
    wave = soliton(EQUATION, -1.5, guess="bond")
    return wave, stability(EQUATION, wave)


@pytest.mark.slow
def test_the_bond_centred_soliton_grows_at_the_published_rate(bond_centred):
    """Source: Kevrekidis (2009): unstable for every frequency; 2.004446 at omega = -1.5."""
    _, found = bond_centred
    assert found.verdict == "unstable" and abs(found.growth - 2.004446) < 5e-7
    assert found.error[0] < 1e-12
    site = stability(EQUATION, soliton(EQUATION, -1.5))
    assert site.verdict == "stable"
    # two zeros of the phase, the band's edge at |omega|
    zeros = np.abs(site.rates) <= site.error
    assert zeros.sum() == 2
    assert np.abs(site.rates[~zeros]).min() > 1.0


@pytest.mark.slow
def test_the_rate_is_that_of_the_matrices(bond_centred):
    """lambda^2 are the eigenvalues of -L- L+, by NumPy alone; psi = phi + a + ib has a' = L- b, b' = -L+ a."""
    wave, found = bond_centred
    phi = np.asarray(wave.psi)
    laplacian = 2 * np.eye(SITES) - np.roll(np.eye(SITES), 1, 0) - np.roll(np.eye(SITES), -1, 0)
    minus, plus = (laplacian + np.diag(1.5 - k * phi**2) for k in (1, 3))
    squared = np.linalg.eigvals(-minus @ plus)
    assert_allclose(found.growth, np.sqrt(squared.real.max()), rtol=1e-11)
    a, b = found.modes[:, :, 0].real
    assert_allclose([minus @ b, -plus @ a], found.growth * np.array([a, b]), atol=1e-10)


@pytest.mark.slow
def test_an_oscillatory_instability_of_a_twisted_soliton():
    """Two sites of unlike sign: stable at weak coupling, a quadruple of rates where modes of unlike signs collide."""
    profile = np.zeros(SITES)
    profile[29], profile[30] = 1.0, -1.0
    verdicts = []
    growth = []
    for coupling in (0.02, 0.4):
        equation = DNLS(SITES, coupling)
        found = stability(equation, soliton(equation, -1.0, guess=profile))
        verdicts.append(found.verdict)
        growth.append(found.rates[0])
    assert verdicts == ["stable", "unstable"] and abs(growth[1].imag) > 0.1


@pytest.mark.slow
def test_the_soliton_of_ablowitz_and_ladik():
    equation = Salerno(81, 1.3, 0.0, 0.7)
    b = 0.8
    n = np.arange(81)
    omega = 2 * 1.3 * (1 - np.cosh(b))
    for centre in (40.0, 40.3):  # anywhere: it is integrable
        profile = np.sinh(b) / np.cosh(b * (n - centre)) / np.sqrt(0.7)
        wave = soliton(equation, omega, guess=profile)
        assert_allclose(np.asarray(wave.psi), profile, atol=1e-12)
        assert_allclose(float(wave.norm), 2 * b / 0.7, rtol=1e-12)
        found = stability(equation, wave)
        assert found.verdict == "stable"
        assert (np.abs(found.rates) < 1e-3).sum() == 4  # phase and place


@pytest.mark.slow
def test_salerno_keeps_its_energy_and_norm_and_has_both_limits():
    rng = np.random.default_rng(3)
    psi = jnp.asarray(rng.normal(size=(9, 2)) + 1j * rng.normal(size=(9, 2)))
    for boundary in ("periodic", "fixed"):
        equation = Salerno(9, 0.7, 0.9, 0.3, boundary=boundary)
        assert_allclose(equation.gradient(psi), Equation.gradient(equation, psi), atol=1e-14)
        run = evolve(equation, psi, 2.0)
        assert run.norm_error.max() < 1e-13 and run.energy_error.max() < 1e-13
        plain = DNLS(9, 0.7, 0.9, boundary=boundary)
        own = Salerno(9, 0.7, 0.9, 0.0, boundary=boundary)
        assert_allclose(own.rate(psi), plain.rate(psi), atol=1e-14)
        assert_allclose(own.energy(psi), plain.energy(psi), rtol=1e-13)
        assert_allclose(own.norm(psi), plain.norm(psi), rtol=1e-14)
        # the energy is the same from both sides of where the series ends
        near = lambda x: float(Salerno(9, 0.7, 0.9, x, boundary=boundary).energy(0.05 * psi[:, 0]))
        edge = 0.05 / float(jnp.abs(0.05 * psi[0, 0]) ** 2)
        assert_allclose(near(edge * (1 + 1e-12)), near(edge * (1 - 1e-12)), rtol=1e-11)
    slope = jax.grad(lambda mu: jnp.sum(Salerno(9, 0.7, 0.9, mu).energy(psi)))(0.3)
    higher, lower = (float(jnp.sum(Salerno(9, 0.7, 0.9, x).energy(psi))) for x in (0.3001, 0.2999))
    assert_allclose(slope, (higher - lower) / 2e-4, rtol=1e-7)


def test_what_is_refused():
    wave = soliton(EQUATION, -1.0)
    with refused("one soliton of 20 sites"):
        stability(DNLS(20), wave)
    with refused("known numbers"):
        jax.jit(lambda w: stability(EQUATION, w))(wave)
    with refused("intersite"):
        Salerno(9, intersite=-1.0)


@pytest.mark.slow
def test_the_self_trapping_dimer_leaves_at_its_pitchfork():
    """phi_1 phi_2 = V/chi on the branch that leaves at omega = 0; the symmetric one grows at 2 (a^2 - 1)^{1/2}."""
    dimer = DNLS(2, boundary="fixed")
    even = soliton(dimer, 0.5, guess=np.full(2, 0.7), throw=False)
    family = soliton_family(dimer, even, -1.0)
    assert_allclose(family.psi, np.sqrt(1 - family.omega)[:, None] * np.ones(2), rtol=1e-12)
    expected = 2 * np.sqrt(np.maximum(-family.omega, 0))
    assert_allclose(family.growth, expected, atol=1e-7)
    (point,) = family.curve.special
    assert point.kind == "branch point" and abs(point.p) < 1e-12
    leaving = soliton_family(dimer, even, -1.0, leaving=(family.curve, 0))
    assert_allclose(leaving.psi.prod(axis=1), 1, rtol=1e-13)
    # phi_1^2 + phi_2^2 = 2 - omega
    assert_allclose(leaving.norm, 2 - leaving.omega, rtol=1e-13)
    assert (leaving.verdict == "stable").all() and leaving.omega[-1] == -1.0


@pytest.mark.slow
def test_a_family_in_other_units_of_time_and_amplitude_has_the_same_points():
    scaled, si = (
        soliton_family(chain, soliton(chain, -V), -2 * V)
        for V, chain in ((1.0, DNLS(9)), (4.8e5, DNLS(9, 4.8e5, 4.8e5 * 1e6)))
    )
    assert_allclose(si.omega, 4.8e5 * scaled.omega, rtol=1e-12)
    assert_allclose(si.psi, 1e-3 * scaled.psi, rtol=1e-9, atol=1e-15)
    assert scaled.omega[-1] == -2.0 and len(scaled.omega) < 12
