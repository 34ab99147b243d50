"""Chains with a force on every site, against the closed forms of the continuum and of single oscillators."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import granjax as gx

RNG = np.random.default_rng(5)


def test_the_equations_of_motion():
    u = RNG.standard_normal(6)
    left, right = np.diff(u, prepend=u[0]), np.diff(u, append=u[-1])
    n = np.arange(1.0, 7.0)
    k, L = 0.3 + 0.1 * n, 2.0 + 0.1 * n

    def force(lattice):
        return lattice.force(0.0, jnp.asarray(u), jnp.zeros(6))

    contacts = np.maximum(-left, 0) ** 1.5 - np.maximum(-right, 0) ** 1.5
    np.testing.assert_allclose(force(gx.scenes.cradle(6, pendulum=k)), contacts - k * u, atol=1e-14)
    np.testing.assert_allclose(force(gx.scenes.cradle(6, pendulum=k, length=L)),
                               contacts - k * L * np.sin(u / L), atol=1e-14)
    np.testing.assert_allclose(force(gx.scenes.klein_gordon(6, 0.3)), 0.3 * (right - left) - u - u**3, atol=1e-14)
    own = gx.scenes.klein_gordon(6, 0.3, law=gx.Toda(0.5, 2.0))
    np.testing.assert_allclose(force(own), 0.3 * (right - left) - 0.5 * np.expm1(2 * u), atol=1e-14)
    np.testing.assert_allclose(force(gx.scenes.sine_gordon(6, 0.3, wavenumber=2.0)),
                               0.3 * (right - left) - np.sin(2 * u) / 2, atol=1e-14)


def test_bands():
    k = np.linspace(-np.pi, np.pi, 7)
    for lattice in (gx.scenes.klein_gordon(9, 0.2, stiffness=1.3), gx.scenes.sine_gordon(9, 0.2, stiffness=1.3)):
        omega = gx.linear.dispersion(lattice, k).omega[:, 0]
        np.testing.assert_allclose(omega**2, 1.3 + 0.8 * np.sin(k / 2) ** 2, rtol=1e-14)
    flat = gx.linear.dispersion(gx.scenes.cradle(9, pendulum=1.7), k).omega[:, 0]
    np.testing.assert_allclose(flat**2, 1.7, rtol=1e-15)


def test_numbers_of_sites_and_springs_are_lanes_and_are_refused():
    batch = jax.vmap(lambda c: gx.scenes.klein_gordon(5, c), out_axes=-1)(jnp.linspace(0.0, 1.0, 3))
    u = jnp.asarray(RNG.standard_normal(5))
    lanes = jnp.tile(u[:, None], 3)
    together = batch.force(0.0, lanes, 0 * lanes)
    for i, c in enumerate((0.0, 0.5, 1.0)):
        one = gx.scenes.klein_gordon(5, c).force(0.0, u, 0 * u)
        np.testing.assert_allclose(together[:, i], one, rtol=1e-14, atol=1e-15)
    for make, words in (
        (lambda: gx.scenes.klein_gordon(7, -1.0), "coupling"),
        (lambda: gx.scenes.klein_gordon(7, stiffness=0.0), "stiffness"),
        (lambda: gx.scenes.klein_gordon(7, beta=np.ones(6)), r"beta: .*one per site, shape \(7,\)"),
        (lambda: gx.scenes.klein_gordon(7, alpha=1.0, law=gx.Sine()), "law"),
        (lambda: gx.scenes.sine_gordon(5, np.ones(5)), r"coupling: .*one per contact, shape \(4,\)"),
        (lambda: gx.scenes.cradle(7, length=0.0), "length"), (lambda: gx.scenes.cradle(1), "sites"),
    ):
        with pytest.raises(ValueError, match=words):
            make()


def sites_at(h, half):
    return h * np.arange(-round(half / h), round(half / h) + 1)


def test_a_sine_gordon_kink_has_the_energy_8():
    def excess(h, speed=0.6):
        x, g = sites_at(h, 20.0), (1 - speed**2) ** -0.5
        lattice = gx.scenes.sine_gordon(len(x), 1 / h**2)
        u, v = 4 * np.arctan(np.exp(g * x)), -2 * speed * g / np.cosh(g * x)
        return float(lattice.energy(0.0, jnp.asarray(u), jnp.asarray(v))) * h - 8 * g

    coarse, fine = excess(0.2), excess(0.1)
    assert abs(fine) < 0.01 and coarse / fine == pytest.approx(4, rel=0.03)


def breather_after_50_periods(h, w=0.9):
    x, s = sites_at(h, 45.0), np.sqrt(1 - w * w)
    lattice = gx.scenes.sine_gordon(len(x), 1 / h**2)

    def exact(t):
        return 4 * np.arctan(s / w * np.cos(w * t) / np.cosh(s * x))

    # a quarter of a period later: a phase that is late shows in first order
    t1 = 50.25 * 2 * np.pi / w
    run = gx.simulate(lattice, gx.State(jnp.asarray(exact(0.0)), jnp.zeros(len(x))), t1)
    return float(np.max(np.abs(run.final.u - exact(t1))))


@pytest.mark.slow
def test_a_sine_gordon_breather_after_50_periods_is_off_by_h_squared():
    errors = [breather_after_50_periods(h) for h in (0.2, 0.1, 0.05)]
    assert errors[0] < 0.1
    np.testing.assert_allclose(np.divide(errors[:-1], errors[1:]), 4, rtol=0.01)
