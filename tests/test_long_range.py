"""Bonds to all neighbours: by FFT as by the direct sum, in every boundary; magnets."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import granjax as gx
from granjax.lattice import linearised

N, M = 14, 30
KERNEL = np.arange(1.0, M + 1) ** -2.5
LAWS = {"polynomial": gx.Polynomial(1.1, -0.4, 0.3), "magnets": gx.PowerLaw(1.0, -3.0, 200.0)}


def pairs(boundary):
    """(tail, head, offset) of every bond of the term; -1 for a site at rest beyond the chain."""
    for m in range(1, M + 1):
        for n in range(-m, N):
            ends = [(n, n + m), (n, (n + m) % N)][boundary == "periodic"]
            inside = [0 <= i < N for i in ends]
            if all(inside) or boundary == "fixed" and any(inside):
                yield *(i if here else -1 for i, here in zip(ends, inside)), m


def direct(law, u, boundary, takes):
    """Forces and energy, bond by bond."""
    tail, head, m = np.array(list(pairs(boundary))).T
    x = np.append(u, 0.0)
    e = (x[tail] - x[head]) / (m if takes == "strain" else 1)
    push = KERNEL[m - 1] * np.asarray(law.force(jnp.asarray(e)))
    f = np.zeros(N + 1)
    np.add.at(f, tail, -push)
    np.add.at(f, head, push)
    stored = KERNEL[m - 1] * np.asarray(law.energy(jnp.asarray(e))) * (m if takes == "strain" else 1)
    return f[:N], stored.sum()


def lattice_of(law, boundary, takes="displacement", kernel=KERNEL):
    return gx.Lattice(1.0, gx.LongRange(kernel, law, boundary, takes=takes), sites=N)


@pytest.mark.parametrize("boundary", ["free", "fixed", "periodic"])
@pytest.mark.parametrize("name, takes", [("polynomial", "displacement"), ("polynomial", "strain"),
                                         ("magnets", "strain")])
def test_as_the_direct_sum_with_gradient_and_tangents(name, takes, boundary):
    lattice, random = lattice_of(LAWS[name], boundary, takes), np.random.default_rng(3)
    u, W = jnp.asarray(0.02 * random.normal(size=N)), jnp.asarray(random.normal(size=(N, 2)))

    @jax.jit
    def found(u):
        force = lambda u: lattice.force(0.0, u, 0 * u)
        energy, slope = jax.value_and_grad(lambda u: lattice.potential_energy(0.0, u))(u)
        return energy, slope, force(u), jax.jacfwd(force)(u), linearised(lattice, 0.0, u).force(0.0, W, 0 * W)

    energy, slope, own, K, tangents = found(u)
    force, stored = direct(LAWS[name], np.asarray(u), boundary, takes)
    size = np.abs(force).max()
    assert np.abs(own - force).max() < 1e-13 * size
    assert np.abs(slope + force).max() < 1e-13 * size
    assert abs(energy - stored) < 1e-13 * stored
    np.testing.assert_allclose(tangents, K @ W, rtol=0, atol=1e-13 * np.abs(K @ W).max())


def test_a_uniform_displacement_costs_no_accuracy():
    u = jnp.round(2.0**26 * np.random.default_rng(4).normal(size=N)) / 2.0**30
    lattice = lattice_of(LAWS["polynomial"], "free")
    far = lattice.force(0.0, u + 2.0**20, 0 * u)
    np.testing.assert_allclose(far, lattice.force(0.0, u, 0 * u), rtol=0, atol=1e-13 * np.abs(far).max())


def test_the_bands_of_an_algebraic_kernel():
    kernel = np.arange(1.0, 10) ** -3
    lattice = gx.Lattice(1.0, gx.LongRange(kernel, gx.Linear(1.3), "periodic"), sites=20)
    k = np.linspace(0.1, 3.0, 7)
    m = np.arange(1, 10)
    squared = 2 * 1.3 * np.sum(kernel * (1 - np.cos(np.multiply.outer(k, m))), -1)
    np.testing.assert_allclose(gx.linear.dispersion(lattice, k).omega_squared[:, 0], squared, rtol=1e-13)


def test_one_neighbour_is_a_chain():
    lattice = gx.Lattice(1.0, gx.LongRange([0.7], gx.Hertz(1.2, 0.3), "free"), sites=N)
    plain = gx.Lattice(1.0, gx.Bond(gx.Shift(1, "free"), gx.Hertz(0.7 * 1.2, 0.7 * 0.3)), sites=N)
    u = jnp.asarray(0.05 * np.random.default_rng(4).normal(size=N))
    np.testing.assert_allclose(lattice.force(0.0, u, u), plain.force(0.0, u, u), rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(lattice.unbalanced(), plain.unbalanced(), rtol=1e-13)


def test_refusals():
    with pytest.raises(ValueError, match="kernel: expected a row of weights"):
        gx.LongRange(1.0, gx.Linear())
    with pytest.raises(ValueError, match="boundary: expected one of"):
        gx.LongRange([1.0], gx.Linear(), "open")
    with pytest.raises(ValueError, match="same for all bonds"):
        gx.Lattice(1.0, gx.LongRange([1.0, 0.5], gx.Linear([1.0, 2.0])), sites=2)
    with pytest.raises(ValueError, match="a chain"):
        gx.Lattice(1.0, gx.LongRange([1.0, 0.5], gx.Linear()), sites=(3, 3))
