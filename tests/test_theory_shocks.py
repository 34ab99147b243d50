"""Dispersive shocks of Toda and KdV by modulation theory: published numbers, formulas in 60 digits, equations."""

import jax
import jax.numpy as jnp
import mpmath as mp
import numpy as np
import pytest

from granjax.theory import toda

# a, b, m in no particular units; both a and b negative: waves of rarefaction
CONSTANTS = dict(strength=0.7, rate=1.3, mass=2.1), dict(strength=-0.7, rate=-1.3, mass=2.1)
M = np.array([0.0, 1e-9, 0.2, 0.5, 0.8, 0.95, 1 - 2.0**-30, 1.0])
C = np.array([1e-6, 0.1, 0.5, 0.9])


def toda_speed(m, c):
    """s(m) as it is printed, in 60 digits; at the ends the limits."""
    with mp.workdps(60):
        m, c = mp.mpf(float(m)), mp.mpf(float(c))
        if m == 0 or m == 1:
            return float(1 - c if m == 0 else mp.sqrt(c * (c + 1)) / mp.log(mp.sqrt(c) + mp.sqrt(c + 1)))
        K, E, share = mp.ellipk(m), mp.ellipe(m), 1 + c * (1 - m)
        third = (c + 1) * K - share * mp.ellippi(c * m / (c + 1), m)
        return float(c * (c + 1) / share * (share * E - (c + 1) * (1 - m) * K) / third)


def test_edges_of_the_toda_shock():
    edges = toda.velocity_shock(np.array([0.1, 0.5]))
    np.testing.assert_allclose(edges, [[0.9, 0.5], [1.06581768, 1.31519072], [0.19062036, 0.81093022],
                                       [0.36464311, 1.38629436]], rtol=0, atol=5.1e-9)
    # what the modulation has at its ends
    back, front = toda.modulation(0.0, C), toda.modulation(1.0, C)
    edges = toda.velocity_shock(C)
    for got, want in ((back.speed, edges.trailing_speed), (front.speed, edges.leading_speed), (back.mean, edges.mean),
                      (front.amplitude, edges.amplitude)):
        np.testing.assert_allclose(got, want, rtol=4e-15)
    assert np.all(back.amplitude == 0) and np.all(front.trough == 0) and np.all(np.isinf(front.wavelength))
    np.testing.assert_allclose(front.mean, 0, atol=2e-15)


def test_speed_inside_the_toda_shock():
    np.testing.assert_allclose(toda.modulation([0.2, 0.5, 0.8, 0.95], 0.5).speed,
                               [0.607509, 0.803701, 1.063430, 1.237004], rtol=0, atol=5.1e-7)
    m, c = np.meshgrid(M, C, indexing="ij")
    np.testing.assert_allclose(toda.modulation(m, c).speed, np.vectorize(toda_speed)(m, c), rtol=0, atol=2e-15)


def test_m_of_a_speed():
    m, c = np.meshgrid(M, C, indexing="ij")
    speed = toda.modulation(m, c).speed
    # a weak shock is as narrow as its c
    assert np.all(np.abs(toda.modulus(speed, c) - m) < 2e-15 / c)
    far = np.where(m < 0.5, -3.0 * m, 2 + m)
    np.testing.assert_array_equal(toda.modulus(far, c), m >= 0.5)


@pytest.mark.parametrize("own", CONSTANTS)
def test_the_modulated_wave_of_toda(own):
    """It is `periodic_wave` of its numbers, counts its crests, and has its speed as d omega/dk."""
    unit, c = np.sqrt(0.7 * 1.3 / 2.1), 0.4 * np.sqrt(0.7 * 1.3 / 2.1) / own["rate"]
    m = np.array([0.1, 0.5, 0.9])
    at = toda.modulation(m, c, **own)
    same = toda.periodic_numbers(at.E1, at.E2, at.E3, at.E4, **own)
    for name in ("mean", "wavelength", "crest", "trough"):
        other = {"mean": "mean_strain"}.get(name, name)
        np.testing.assert_allclose(getattr(at, name), getattr(same, other), rtol=1e-13)
    np.testing.assert_allclose(at.amplitude, at.crest - at.trough, rtol=1e-13)
    np.testing.assert_allclose(at.speed, unit * np.array([toda_speed(x, 0.4) for x in m]), rtol=1e-14)
    # far behind, inside, ahead
    t = 2000.0
    n = np.array([0.1 * unit * t, *at.speed * t, 2 * unit * t])
    shock = toda.shock_wave(n, t, c, **own)
    np.testing.assert_allclose(shock.m, [0, *m, 1], atol=1e-13)
    np.testing.assert_allclose(shock.mean[1:4], at.mean, rtol=1e-13)
    np.testing.assert_allclose(shock.strain[jnp.array([0, 4])], [2 * np.log(1.4) / own["rate"], 0], atol=1e-14)
    wave = toda.periodic_wave(n[1:4], t, at.E1, at.E2, at.E3, at.E4, **own)
    np.testing.assert_allclose(shock.strain[1:4], wave.strain, rtol=1e-10)


def frequencies(m):
    """k and omega where the parameter is m, 2 pi a wave."""
    at = toda.modulation(m, 0.5)
    own = toda.periodic_numbers(at.E1, at.E2, at.E3, at.E4)
    return 2 * jnp.pi / own.wavelength, 2 * jnp.pi / own.period


def test_waves_are_conserved():
    """s = d omega/dk: crests neither begin nor end inside."""
    m = jnp.array([0.05, 0.5, 0.95])
    (k, _), (dk, domega) = jax.jit(lambda m: jax.jvp(frequencies, (m,), (jnp.ones(3),)))(m)
    np.testing.assert_allclose(domega / dk, toda.modulation(m, 0.5).speed, rtol=1e-12)
    assert np.all(dk < 0) and np.all(k > 0)


@pytest.mark.slow
def test_a_shock_differentiates():
    """In both modes, and where c alone moves at the edges too."""
    f = lambda x: toda.shock_wave(80 * x[0], 80.0, x[1], phase=x[2]).strain + toda.modulus(x[0], x[1])
    x, h = jnp.array([0.9, 0.5, 0.3]), 1e-5
    back, along = jax.jit(lambda x: (jax.grad(f)(x), jax.jvp(f, (x,), (jnp.array([1.0, -2.0, 0.7]),))[1]))(x)
    assert float(back @ jnp.array([1.0, -2.0, 0.7])) == pytest.approx(float(along), rel=1e-12)
    want = [(f(x.at[i].add(h)) - f(x.at[i].add(-h))) / (2 * h) for i in range(3)]
    np.testing.assert_allclose(back, want, rtol=1e-6)
    edges = jax.jit(jax.jacfwd(lambda c: jnp.stack(toda.modulation(jnp.array([0.0, 1.0]), c)[:7])))(0.5)
    assert np.all(np.isfinite(edges))
    assert jax.grad(lambda m: toda.modulation(m, 0.5).speed)(1.0) == np.inf


@pytest.mark.parametrize("call, said", [
    (lambda: toda.velocity_shock(1.0), r"^c: expected .* in \(0, 1\).*from 1 on its middle oscillates"),
    (lambda: toda.velocity_shock(-0.1), "^c: expected .*pulled apart"),
    (lambda: toda.velocity_shock(0.1, strength=-1.0, rate=-1.0), "^c: expected .*pulled apart"),
    (lambda: toda.modulation(1.1, 0.5), r"^m: expected numbers in \[0, 1\]"),
    (lambda: toda.modulus(np.ones(3), np.full(2, 0.5)), "expected shapes that broadcast"),
    (lambda: toda.shock_wave(1.0, 0.0, 0.5), "^t: expected numbers above zero"),
])
def test_what_is_no_shock_is_refused(call, said):
    with pytest.raises(ValueError, match=said):
        call()
