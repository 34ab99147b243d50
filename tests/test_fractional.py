"""Fractional lattices against the symbol, the closed form of the kernel, sums bond by bond, and next neighbours."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose
from refusals import refused
from scipy.special import gamma

import granjax as gx
from granjax import fractional, scenes

N = 12
U = np.random.default_rng(6).standard_normal(N)


def force(lattice, u=U):
    return np.asarray(lattice.force(0.0, jnp.asarray(u), jnp.zeros(len(u))))


@pytest.mark.parametrize("s", [0.05, 0.95])
def test_the_kernel_is_the_closed_form(s):
    m = np.arange(1, 101.0)
    size = 4**s * gamma(0.5 + s) / (np.sqrt(np.pi) * abs(gamma(-s)))
    assert_allclose(fractional.kernel(s, 100), size * gamma(m - s) / gamma(m + 1 + s), rtol=1e-12)
    # far away, where the factors of the quotient overflow
    far = fractional.kernel(s, 100_000)
    tail = size * (1e5) ** (-1 - 2 * s)
    assert float(far[-1]) == pytest.approx(tail, rel=1e-5)
    assert_allclose(2 * far.sum() + tail * 1e5 / s, gamma(1 + 2 * s) / gamma(1 + s) ** 2, rtol=1e-4)


@pytest.mark.slow
def test_the_ring_s_kernel_is_the_sum_over_all_images():
    s = 0.7
    wide = fractional.kernel(0.7, 12 * 20_000)
    images = np.zeros(N)
    np.add.at(images, np.arange(1, len(wide) + 1) % N, np.asarray(wide))
    assert_allclose(fractional.to_the_right(s, N), images[1:], atol=1e-7)
    assert_allclose(fractional.ring_kernel(s, N), images[1:] + images[:0:-1], atol=1e-7)
    assert_allclose(fractional.ring_kernel(1.0, N), [1, *[0] * (N - 3), 1], atol=1e-15)
    assert_allclose(fractional.to_the_right(1.0, N), [1, *[0] * (N - 2)], atol=1e-14)
    # the sum to the right does not depend on where it is begun one by one
    wide = fractional.to_the_right(s, 8 * N)
    folded = np.concatenate([[0.0], wide]).reshape(8, N).sum(axis=0)
    assert_allclose(fractional.to_the_right(s, N), folded[1:], rtol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("s, n", [(0.2, 10), (0.8, 15)])
def test_modes_of_a_ring_have_the_symbol_s_frequencies(s, n):
    lattice = scenes.fractional(n, s, mass=2.0, law=gx.Linear(3.0))
    k = 2 * np.pi * np.arange(n) / n
    squares = 1.5 * (4 * np.sin(k / 2) ** 2) ** s
    found = np.asarray(gx.linear.normal_modes(lattice).omega) ** 2
    assert_allclose(np.sort(found), np.sort(squares), atol=1e-12)
    waves = gx.linear.dispersion(lattice, k[1:7]).omega[:, 0]
    assert_allclose(waves**2, squares[1:7], rtol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("boundary", ["periodic", "fixed", "free"])
def test_order_1_is_next_neighbours(boundary):
    bond = gx.Bond(gx.Shift(1, boundary), gx.Polynomial(1.0, 0.3, 0.2))
    wanted = force(gx.Lattice(1.0, bond, sites=N))
    how = {"alpha": 0.3, "beta": 0.2, "boundary": boundary}
    for nonlinear in ("all", "neighbours"):
        own = scenes.fractional_fput(N, 1.0, nonlinear=nonlinear, **how)
        assert_allclose(force(own), wanted, atol=1e-12)
    own = scenes.fractional_sine_gordon(N, 1.0, 0.7, boundary=boundary)
    assert_allclose(force(own), force(scenes.sine_gordon(N, 0.7, boundary=boundary)), atol=1e-13)


@pytest.mark.slow
def test_bonds_of_finite_chains_one_by_one():
    # fixed ends: a long chain at rest beyond; free: the pairs within
    s = 0.6
    law = lambda e: e + 0.3 * e**2 + 0.2 * e**3
    weights = np.asarray(fractional.kernel(s, 40_000))
    for boundary, beyond, close in (("fixed", 40_000, 3e-5), ("free", 0, 1e-12)):
        wide = np.pad(U, beyond)
        wanted = []
        for n in range(beyond, beyond + N):
            right = wide[n + 1 :][: len(weights)]
            left = wide[:n][::-1][: len(weights)]
            pushed = np.sum(weights[: len(left)] * law(left - wide[n]))
            wanted.append(pushed - np.sum(weights[: len(right)] * law(wide[n] - right)))
        own = scenes.fractional_fput(N, s, alpha=0.3, beta=0.2, boundary=boundary)
        assert_allclose(force(own), wanted, atol=close)


@pytest.mark.slow
def test_energy_is_kept_and_the_order_differentiates():
    lattice = scenes.fractional_sine_gordon(N, 0.5, boundary="fixed")
    run = gx.simulate(lattice, gx.State(jnp.asarray(U), jnp.zeros(N)), 20.0)
    assert run.completed and run.energy_error < 1e-6

    def of_order(s):
        chain = scenes.fractional_fput(N, s, boundary="fixed")
        return chain.force(0.0, jnp.asarray(U), jnp.zeros(N))

    slope = jax.jit(jax.jacfwd(of_order))
    for s in (0.5, 0.999):
        central = (of_order(s + 1e-6) - of_order(s - 1e-6)) / 2e-6
        assert_allclose(slope(s), central, rtol=1e-5, atol=1e-6)
    # at the end of the orders, from below
    below = [of_order(1 - x) for x in (0.0, 1e-5, 2e-5)]
    one_sided = (3 * below[0] - 4 * below[1] + below[2]) / 2e-5
    assert_allclose(slope(1.0), one_sided, rtol=1e-6, atol=1e-7)
    batch = jax.vmap(lambda s: scenes.fractional(N, s), out_axes=-1)(jnp.array([0.3, 0.9]))
    both = batch.force(0.0, jnp.stack([U, U], axis=-1), jnp.zeros((N, 2)))
    assert_allclose(both[:, 1], force(scenes.fractional(N, 0.9)), atol=1e-13)


@pytest.mark.slow
def test_a_plane_wave_turns_with_the_symbol_s_frequency_in_si():
    lattice = scenes.fractional(N, 0.5, mass=2e-3, law=gx.Linear(8e3))
    k = 2 * np.pi * 2 / N
    omega = np.sqrt(4e6 * 2 * np.sin(k / 2))
    phase = k * np.arange(N)
    start = gx.State(1e-6 * np.cos(phase), 1e-6 * omega * np.sin(phase))
    run = gx.simulate(lattice, start, 20 / omega)
    assert_allclose(run.final.u, 1e-6 * np.cos(phase - 20), atol=1e-11)


def test_sites_beyond_fixed_ends_hold_every_site_as_much():
    # one site moves alone in the infinite chain, which pulls it back by the sum of all weights
    chain = scenes.fractional(7, 0.3, boundary="fixed")
    pull = [-force(chain, u)[n] for n, u in enumerate(np.eye(7))]
    assert_allclose(pull, float(fractional.total(0.3)), rtol=1e-12)


def test_what_cannot_be_meant_is_refused():
    for make, words in (
        (lambda: scenes.fractional(N, 0.0), r"order: expected numbers in \(0, 1\]"),
        (lambda: scenes.fractional(N, [0.5, 0.6]), "order: .*jax.vmap"),
        (lambda: scenes.fractional_fput(N, nonlinear="some"), "nonlinear"),
        (lambda: scenes.fractional_sine_gordon(N, stiffness=np.ones(N + 1)), r"OnSite.*\(12,\)"),
    ):
        with refused(words):
            make()
