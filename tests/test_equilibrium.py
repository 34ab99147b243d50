"""Where lattices rest: magnets between ends, loads, saddles, terms of one's own."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import granjax as gx

N, P = 9, -4.0


def pair_forces(x):
    """The force on each magnet at positions x."""
    away = x[:, None] - x
    np.fill_diagonal(away, np.inf)
    return np.sum(np.sign(away) * np.abs(away) ** P, 1)


@pytest.mark.study
@pytest.mark.parametrize("boundary, length", [
    ("fixed", N + 1), pytest.param("free", N - 1, marks=pytest.mark.slow)])
def test_magnets_between_ends_rest(boundary, length):
    lattice = gx.scenes.magnets(N, P, boundary=boundary)
    x = np.arange(N) + np.asarray(lattice.terms[0].rest)
    x = np.concatenate([[-1.0], x, [N]]) if boundary == "fixed" else x
    forces = pair_forces(x)
    assert np.abs(forces[1:-1]).max() < 1e-13 * np.abs(forces).max()
    assert x[-1] - x[0] == length
    found = gx.equilibrium(lattice)
    np.testing.assert_allclose(found.ends, [-forces[0], forces[-1]], rtol=1e-12)
    assert found.residual <= 1e-13 * found.largest and found.verdict == "stable"
    np.testing.assert_allclose(found.state.u, 0, atol=1e-14)
    np.testing.assert_array_equal(lattice.force(0.0, lattice.zeros(), lattice.zeros()), 0)


@pytest.mark.study
def test_equal_spacings_are_no_rest_and_the_outcome_says_so():
    magnets = gx.LongRange(np.arange(1.0, N) ** P, gx.PowerLaw(1.0, P, 1.0), "free", takes="strain")
    lattice = gx.Lattice(np.linspace(1, 2, N), magnets, sites=N)
    found = gx.equilibrium(lattice)
    np.testing.assert_allclose(found.state.u, gx.scenes.magnets(N, P, boundary="free").terms[0].rest, atol=1e-14)
    assert "only loads on inner sites hold" in found.outcome
    there = found.lattice
    u = jnp.asarray(0.01 * np.random.default_rng(2).normal(size=N))
    x = np.arange(N) + np.asarray(found.state.u)
    np.testing.assert_allclose(there.force(0.0, u, u), pair_forces(x + np.asarray(u)) - pair_forces(x), atol=1e-14)
    slope = jax.grad(lambda u: there.potential_energy(0.0, u))(u)
    np.testing.assert_allclose(slope, -there.force(0.0, u, u), rtol=0, atol=1e-13)


class Wells(gx.Term):
    """Double wells of a user's own: energy k (u^2 - a^2)^2/(4 a^2)."""

    stiffness: jax.Array
    width: jax.Array

    def energy(self, t, u):
        return self.stiffness * (u**2 - self.width**2) ** 2 / (4 * self.width**2)

    def force(self, t, u, v, mass):
        return -jax.grad(lambda u: self.energy(t, u).sum())(u)


def test_a_saddle_is_called_one_and_a_guess_finds_the_minimum():
    wells = Wells(jnp.asarray(2.0e3), jnp.asarray(1e-3))
    lattice = gx.Lattice(1.0, (wells, gx.Bond(gx.Shift(1, "free"), gx.Linear(100.0))), sites=4)
    saddle = gx.equilibrium(lattice)
    assert saddle.verdict == "unstable" and "saddle" in saddle.outcome
    np.testing.assert_allclose(saddle.stiffness, -2e3, rtol=1e-12)
    found = gx.equilibrium(lattice, guess=jnp.full(4, 0.7e-3))
    assert found.verdict == "stable"
    np.testing.assert_allclose(found.state.u, 1e-3, rtol=1e-13)


@pytest.mark.slow
def test_loads_and_their_derivative():
    lattice = gx.scenes.monomer(5, precompression=1.0)
    weight = jnp.full(5, 0.02)

    def lowest(stiffness):
        chain = gx.scenes.monomer(5, stiffness=stiffness, precompression=1.0)
        return gx.equilibrium(chain, loads=weight).state.u[-1]

    found = gx.equilibrium(lattice, loads=weight)
    forces = gx.measures.contact_force(lattice, found.state)
    np.testing.assert_allclose(np.diff(forces), 0.02, rtol=1e-12)
    np.testing.assert_allclose(found.ends, forces[jnp.asarray([0, -1])], rtol=1e-14)
    h = 1e-4
    np.testing.assert_allclose(jax.grad(lowest)(1.0), (lowest(1 + h) - lowest(1 - h)) / (2 * h), rtol=1e-6)


def test_loads_that_stay_are_those_of_the_preloads_and_without_any_it_falls_apart():
    law = gx.laws.Strained(gx.Polynomial(1.0, 0.3, 0.5), 0.1)
    chain = gx.Lattice(1.0, gx.Bond(gx.Shift(1, "free"), law), sites=5)
    held = gx.equilibrium(chain, hold="loads")
    np.testing.assert_allclose(held.state.u, 0, atol=1e-15)
    np.testing.assert_allclose(held.loads, [law.preload, 0, 0, 0, -law.preload], atol=1e-15)
    np.testing.assert_allclose(held.ends, [law.preload] * 2, rtol=1e-13)
    push = jnp.asarray([0.02, 0, 0, 0, -0.02])
    pressed = gx.equilibrium(chain, hold="loads", loads=push)
    forces = gx.measures.contact_force(chain, pressed.state)
    np.testing.assert_allclose(forces, law.preload + 0.02, rtol=1e-12)
    apart = gx.equilibrium(chain, hold="nothing")
    np.testing.assert_allclose(np.diff(apart.state.u), 0.1, rtol=1e-12)
    np.testing.assert_array_equal(apart.loads, 0)
    assert abs(np.mean(apart.state.u)) < 1e-15


@pytest.mark.slow
def test_a_lattice_with_fields_and_its_gradient():
    lattice = gx.scenes.mass_in_mass(4, 0.5, 2.0, precompression=1.0)
    load = {"bead": jnp.full(4, 0.02), "resonator": jnp.full(4, 0.01)}
    found = gx.equilibrium(lattice, loads=load)
    swing = found.state.u["resonator"] - found.state.u["bead"]
    np.testing.assert_allclose(swing, 0.01 / 2.0, rtol=1e-12)
    assert found.ends is None and found.verdict == "stable"
    slope = jax.grad(lambda k: gx.equilibrium(gx.scenes.mass_in_mass(4, 0.5, k, precompression=1.0),
                                              loads=load).state.u["resonator"][1])(2.0)
    np.testing.assert_allclose(slope, -0.01 / 2.0**2, rtol=1e-10)


@pytest.mark.slow
def test_the_plane():
    h = 0.75**0.5
    bonds = [gx.Bond(gx.Stretch(gx.Shift(offset, "free"), vector), gx.Polynomial(1.0, 0.3) + gx.Hertz(0.5, 0.2))
             for offset, vector in (((1, 0), [1.0, 0.0]), ((0, 1), [0.5, h]), ((-1, 1), [-0.5, h]))]
    lattice = gx.Lattice(1.0, bonds, sites=(4, 4), dimension=2)
    loads = 0.02 * jnp.asarray(np.random.default_rng(7).normal(size=(4, 4, 2)))
    found = gx.equilibrium(lattice, loads=loads)
    u = np.asarray(found.state.u)
    left = lattice.force(0.0, found.state.u, lattice.zeros()) + lattice.unbalanced() + found.loads
    assert np.abs(left).max() <= 1e-13 * found.largest and found.verdict == "stable"
    # the edges are held by what loads they need, the inner sites by those given
    assert np.abs(u[1:3, 1:3]).min() > 1e-4 and np.count_nonzero(u) == 8
    np.testing.assert_array_equal(found.loads[1:3, 1:3], loads[1:3, 1:3])


@pytest.mark.slow
def test_in_si_as_in_scaled_numbers():
    chain = gx.scenes.magnets(5, -3.0, boundary="free", stiffness=2e-7, spacing=0.03, mass=0.01, units="SI")
    plain = gx.scenes.magnets(5, -3.0, boundary="free")
    found, scaled = gx.equilibrium(chain), gx.equilibrium(plain)
    np.testing.assert_allclose(found.ends, 2e-7 * 0.03**-3 * np.asarray(scaled.ends), rtol=1e-12)
    np.testing.assert_allclose(found.stiffness, 2e-7 * 0.03**-4 * scaled.stiffness, rtol=1e-9)
    assert found.verdict == scaled.verdict == "stable" and " N " in f"{found.outcome} "


@pytest.mark.slow
def test_lanes_by_vmap():
    stiffness = jnp.asarray([1.0, 2.0, 4.0])
    batch = jax.vmap(lambda A: gx.scenes.monomer(5, stiffness=A, precompression=1.0), out_axes=-1)(stiffness)
    found = jax.vmap(lambda lattice: gx.equilibrium(lattice, loads=jnp.full(5, 0.02)).state.u, in_axes=-1,
                     out_axes=-1)(batch)
    for lane, A in enumerate(stiffness):
        alone = gx.equilibrium(gx.scenes.monomer(5, stiffness=A, precompression=1.0), loads=jnp.full(5, 0.02))
        np.testing.assert_allclose(found[:, lane], alone.state.u, rtol=1e-11)


def test_refusals():
    with pytest.raises(ValueError, match="apart"):
        gx.equilibrium(gx.scenes.magnets(N, P), guess=jnp.zeros(N).at[3].set(3.0))
    with pytest.raises(ValueError, match="one lattice"):
        gx.equilibrium(jax.vmap(lambda m: gx.scenes.monomer(5, m), out_axes=-1)(jnp.ones(2)))
    with pytest.raises(ValueError, match="hold: expected one of"):
        gx.equilibrium(gx.scenes.monomer(5, boundary="free"), hold="end")
    with pytest.raises(ValueError, match="These touch"):
        gx.scenes.magnets(N, P, spacing=1.0, diameter=1.2)
    with pytest.raises(ValueError, match="repel less further apart"):
        gx.scenes.magnets(N, 1.5)
