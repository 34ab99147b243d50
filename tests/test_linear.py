"""Linear theory: frequencies, bands and speeds against closed forms."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose
from refusals import refused

import granjax as gx
from granjax import linear, topology
from granjax.lattice import Lattice
from granjax.laws import Hertz, Linear, PowerLaw
from granjax.scenes import dimer, monomer
from granjax.strains import Pairs, Shift, Stretch
from granjax.terms import (
    Bond,
    Damping,
    Dashpot,
    Drive,
    Function,
    Harmonic,
    Modulated,
    OnSite,
    Term,
    Wall,
)

K_POINT = 2 * np.pi / 3, 4 * np.pi / 3
WAVES = np.linspace(-3.1, 3.1, 11)
MOVING = np.arange(11) != 5
MASS = 2.957949


def springs(mass, stiffness=1.0, boundary="fixed", *terms):
    return Lattice(mass, (Bond(Shift(1, boundary), Linear(stiffness)), *terms))


def two_masses(sites=40, boundary="fixed"):
    """Precompressed Hertz dimer with K2 = 1.5, light mass 1 and heavy mass 2.957949, light bead first."""
    return Lattice(np.resize([1.0, MASS], sites), Bond(Shift(1, boundary), Hertz(1.0, 1.0)))


def triangular(prestress=0.0, boundary="periodic", shape=(5, 6)):
    law = PowerLaw(1.0, 1.0, prestress) if prestress else Linear(1.0)
    h = np.sqrt(3) / 2
    steps = {(1, 0): (1.0, 0.0), (0, 1): (0.5, h), (-1, 1): (-0.5, h)}
    bonds = [
        Bond(Stretch(Shift(offset, boundary), np.array(vector)), law)
        for offset, vector in steps.items()
    ]
    return Lattice(np.ones(shape), tuple(bonds), dimension=2)


def mass_in_mass(ground=None, boundary="periodic", sites=12):
    terms = [
        Bond(Shift(1, boundary, "bead"), Linear(1.0)),
        Bond(Shift(0, boundary, ("bead", "core")), Linear(0.3)),
    ]
    if ground:
        terms.append(OnSite(Linear(ground), "bead"))
    return Lattice({"bead": np.ones(sites), "core": np.full(sites, 0.5)}, tuple(terms))


def kagome(sites=4):
    links = [
        ("a", "b", (0, 0)),
        ("a", "c", (0, 0)),
        ("b", "c", (0, 0)),
        ("b", "a", (1, 0)),
        ("c", "a", (0, 1)),
        ("b", "c", (1, -1)),
    ]
    bonds = tuple(
        Bond(Shift(offset, "periodic", (tail, head)), Linear(1.0)) for tail, head, offset in links
    )
    return Lattice({name: np.ones((sites, sites)) for name in "abc"}, bonds)


def next_nearest(boundary="periodic", sites=12):
    bonds = tuple(Bond(Shift(offset, boundary), Linear(1.0)) for offset in (1, 2))
    return Lattice(np.ones(sites), bonds)


def random_cells(boundary="periodic", size=5, cells=4):
    random = np.random.default_rng(3)
    mass, stiffness = random.uniform(0.5, 2, (2, size))
    # the first spring of a chain between walls is the left wall's
    stiffness = np.resize(
        np.roll(stiffness, boundary == "fixed"), size * cells + (boundary == "fixed")
    )
    return springs(np.tile(mass, cells), stiffness, boundary)


@pytest.mark.slow
@pytest.mark.parametrize("boundary", ["fixed", "free", "periodic"])
def test_monomer(boundary):
    # omega = 2 sqrt(K2/m) |sin(k/2)|, K2 = 3/2 A d0^(1/2) = 1.5 F0^(1/3) A^(2/3)
    chain = monomer(12, mass=2.0, stiffness=1.0, precompression=1.0, boundary=boundary)
    found = linear.dispersion(chain, WAVES)
    top = np.sqrt(1.5 / 2)
    assert found.cell == (1,)
    assert_allclose(found.omega[:, 0], 2 * top * abs(np.sin(WAVES / 2)), rtol=0, atol=1e-12)
    slope, bend = top * np.cos(WAVES / 2) * np.sign(WAVES), -top / 2 * abs(np.sin(WAVES / 2))
    assert_allclose(found.group_velocity[MOVING, 0], slope[MOVING], atol=1e-12)
    assert_allclose(found.curvature[MOVING, 0], bend[MOVING], atol=1e-12)
    assert_allclose(linear.sound_speed(chain), top, rtol=1e-14)
    assert_allclose(linear.bands(chain).upper, [2 * top], rtol=1e-14)
    assert found.vectors.shape == (11, 1, 1)
    assert linear.dispersion(chain, 0.3).omega.shape == (1,)


def test_long_waves_lose_no_digits():
    found = linear.dispersion(monomer(8, precompression=1.0), 1e-9)
    assert_allclose(found.omega[0], np.sqrt(1.5) * 1e-9, rtol=1e-13)


@pytest.mark.slow
@pytest.mark.parametrize("boundary", ["fixed", "free", "periodic"])
def test_dimer_edges(boundary):
    # sqrt(2 K2/M), sqrt(2 K2/m), sqrt(2 K2 (1/m + 1/M)), K2 = 1.5: 1.0070830, 1.7320508, 2.0035509
    found = linear.bands(two_masses(boundary=boundary))
    edges = np.sqrt([3 / MASS, 3.0, 3 * (1 + 1 / MASS)])
    assert_allclose(edges, [1.0070830, 1.7320508, 2.0035509], atol=6e-8)
    assert_allclose(np.r_[found.lower, found.upper], [0, edges[1], edges[0], edges[2]], atol=1e-12)
    assert_allclose(found.gaps, [(edges[0], edges[1])], atol=1e-12)
    words = " ".join(repr(found).split())
    assert "gap 1.007082" in words or "gap 1.007083" in words


def test_dimer_scene_of_any_length():
    found = linear.bands(dimer(101, ratio=0.5, precompression=1.0))
    assert_allclose(found.gaps, [np.sqrt([3.0, 6.0])], rtol=1e-13)
    speed = linear.sound_speed(dimer(101, ratio=0.5, precompression=1.0))
    # one cell of two beads: total mass 1.5, compliance 2/1.5; c = 2 beads per cell / sqrt(mass * compliance)
    assert_allclose(speed, 2 / np.sqrt(1.5 * 2 / 1.5), rtol=1e-13)


def test_speed_of_a_random_cell():
    # a chain of cells: c = p / sqrt(sum of masses * sum of compliances), statics of springs in series
    chain = random_cells()
    mass, stiffness = np.asarray(chain.mass[:5]), np.asarray(chain.terms[0].law.stiffness[:5])
    assert_allclose(
        linear.sound_speed(chain), 5 / np.sqrt(mass.sum() * (1 / stiffness).sum()), rtol=1e-12
    )
    k = 1e-4
    assert_allclose(
        linear.dispersion(chain, k).omega[0] / k * 5, linear.sound_speed(chain), rtol=1e-6
    )


def test_speed_with_further_parts():
    # bead and core move as one in a long wave: sqrt(K/(m + nu)); springs to n +- 2 count four times
    assert_allclose(linear.sound_speed(mass_in_mass()), np.sqrt(1 / 1.5), rtol=1e-12)
    assert_allclose(linear.sound_speed(next_nearest()), np.sqrt(5), rtol=1e-12)


def test_dead_bonds_stop_sound():
    assert linear.sound_speed(springs(np.ones(8), np.resize([1.0, 0.0], 9))) == 0


@pytest.mark.slow
def test_speeds_of_the_triangular_lattice():
    # isotropic, Lame constants sqrt(3)/4 K, density 2 m/sqrt(3): c_T^2 = 3/8, c_L^2 = 9/8
    vectors = np.array([[1, 0], [0.5, np.sqrt(3) / 2]])
    for angle in (0.0, 0.4):
        direction = vectors @ [np.cos(angle), np.sin(angle)]
        for cell in (None, (2, 1)):
            speeds = linear.sound_speed(triangular(shape=(6, 6)), cell, direction=direction)
            assert_allclose(speeds**2, [3 / 8, 9 / 8], rtol=1e-12)


RINGS = {
    "dimer": two_masses(12, "periodic"),
    "trimer": springs(np.resize([1.0, 0.5, 0.3], 12), 1.0, "periodic"),
    "next nearest": next_nearest(),
    "random cells": random_cells(),
    "mass in mass": mass_in_mass(),
    "triangular": triangular(0.1),
    "kagome": kagome(),
    "pairs": Lattice(np.ones(9), Bond(Pairs(np.arange(9), (np.arange(9) + 1) % 9), Linear(1.0))),
}


@pytest.mark.study
@pytest.mark.parametrize("name", RINGS)
def test_bloch_waves_are_the_modes_of_a_ring(name):
    chain = RINGS[name]
    sites = chain.sites["a" if name == "kagome" else "bead"] if chain.fields else chain.sites
    cell = linear.unit_cell(chain).cell
    phases = [2 * np.pi * np.arange(n // p) / (n // p) for n, p in zip(sites, cell)]
    k = np.stack(np.meshgrid(*phases, indexing="ij"), -1)
    waves = linear.dispersion(chain, k if len(sites) > 1 else k[..., 0]).omega_squared
    modes = linear.normal_modes(chain).omega_squared
    assert_allclose(np.sort(np.ravel(waves)), modes, rtol=0, atol=1e-12 * modes.max())


@pytest.mark.slow
@pytest.mark.parametrize("make", [next_nearest, random_cells, mass_in_mass, two_masses])
def test_boundary_does_not_count(make):
    inside = make(boundary="fixed", **({"sites": 20} if make is two_masses else {}))
    ring = make(boundary="periodic", **({"sites": 20} if make is two_masses else {}))
    assert_allclose(
        linear.dispersion(inside, WAVES).omega,
        linear.dispersion(ring, WAVES).omega,
        rtol=1e-10,
        atol=1e-12,
    )


def test_walls_and_drives_do_not_count():
    ends = (Wall(Linear(5.0), "left", Harmonic(1.0, 2.0)), Drive(Harmonic(1.0, 1.0)), Damping(0.3))
    chain = springs(np.ones(10), 1.0, "free", *ends)
    assert_allclose(
        linear.dispersion(chain, WAVES).omega[:, 0], 2 * abs(np.sin(WAVES / 2)), atol=1e-12
    )
    modes = linear.normal_modes(chain)
    K = np.diag([6.0] + [2.0] * 8 + [1.0]) - np.eye(10, k=1) - np.eye(10, k=-1)
    assert_allclose(modes.omega_squared, np.linalg.eigvalsh(K), atol=1e-13)


@pytest.mark.slow
def test_bloch_vectors_solve_the_lattice():
    chain = two_masses(12, "periodic")
    k = 2 * np.pi / 6
    found = linear.dispersion(chain, k)
    for band in range(2):
        wave = np.concatenate([found.vectors[:, band] * np.exp(1j * k * R) for R in range(6)])
        force = [
            chain.force(0.0, 1e-7 * part, chain.zeros()) / 1e-7 for part in (wave.real, wave.imag)
        ]
        assert_allclose(
            (force[0] + 1j * force[1]), -(found.omega[band] ** 2) * chain.mass * wave, atol=1e-5
        )
        assert_allclose(
            np.sum(np.array([1, MASS]) * abs(found.vectors[:, band]) ** 2), 1, rtol=1e-13
        )


@pytest.mark.slow
def test_shapes_of_vectors():
    assert linear.dispersion(triangular(), np.ones((2, 2)), (5, 1)).vectors.shape == (
        2,
        5,
        1,
        2,
        10,
    )
    parts = linear.dispersion(mass_in_mass(), WAVES).vectors
    assert parts["bead"].shape == parts["core"].shape == (11, 1, 2)
    weight = abs(parts["bead"]) ** 2 + 0.5 * abs(parts["core"]) ** 2
    assert_allclose(weight, 1.0, rtol=1e-13)


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["dimer", "trimer", "next nearest", "random cells", "mass in mass"]
)
def test_derivatives_of_bands(name):
    chain, h = RINGS[name], 1e-4
    here, after, before = (linear.dispersion(chain, WAVES + s) for s in (0, h, -h))
    slope, bend = here.group_velocity[MOVING], here.curvature[MOVING]
    assert_allclose(slope, (after.omega - before.omega)[MOVING] / (2 * h), atol=1e-7)
    change = (after.group_velocity - before.group_velocity)[MOVING] / (2 * h)
    assert_allclose(bend, change, atol=2e-6)


def test_derivatives_of_bands_in_the_plane():
    chain, k, h = triangular(0.1), np.array([0.7, -1.1]), 1e-4
    here = linear.dispersion(chain, k)
    assert here.group_velocity.shape == (2, 2) and here.curvature.shape == (2, 2, 2)
    for axis in range(2):
        step = h * np.eye(2)[axis]
        after, before = linear.dispersion(chain, k + step), linear.dispersion(chain, k - step)
        assert_allclose(
            here.group_velocity[:, axis], (after.omega - before.omega) / (2 * h), atol=1e-7
        )
        change = (after.group_velocity - before.group_velocity) / (2 * h)
        assert_allclose(here.curvature[:, axis], change, atol=1e-6)


@pytest.mark.slow
def test_derivatives_that_do_not_exist_are_nan():
    # two cells in one: bands cross at pi; an acoustic band has a corner at 0
    folded = linear.dispersion(springs(np.ones(12)), np.array([0.0, np.pi]), cell=2)
    assert np.isnan(folded.group_velocity[1]).all() and np.isnan(folded.group_velocity[0, 0])
    assert_allclose(folded.group_velocity[0, 1], 0.0, atol=1e-12)
    apart = Lattice(
        {"a": np.ones(6), "b": np.ones(6)},
        tuple(Bond(Shift(1, "periodic", name), Linear(1.0)) for name in "ab"),
    )
    together = linear.dispersion(apart, 1.0)
    assert_allclose(together.group_velocity, np.cos(0.5), rtol=1e-12)
    assert_allclose(together.curvature, -np.sin(0.5) / 2, rtol=1e-12)


@pytest.mark.slow
def test_derivatives_in_k_and_parameters():
    def omega(ratio, k):
        return linear.dispersion(dimer(20, ratio=ratio, precompression=1.0), k).omega[0]

    # K2 = 1.5: omega^2 = K2 s - sqrt(K2^2 s^2 - 4 K2^2 sin^2(k/2)/(m M)), s = 1/m + 1/M
    def closed(ratio, k):
        s = 1 + 1 / ratio
        return jnp.sqrt(1.5 * (s - jnp.sqrt(s * s - 4 * jnp.sin(k / 2) ** 2 / ratio)))

    expected = jax.grad(closed, (0, 1))(0.4, 1.3)
    for derivative in (jax.grad, jax.jacfwd):
        assert_allclose(derivative(omega, (0, 1))(0.4, 1.3), expected, rtol=1e-10)
    got = linear.dispersion(dimer(20, ratio=0.4, precompression=1.0), 1.3).group_velocity[0]
    assert_allclose(got, expected[1], rtol=1e-12)


@pytest.mark.slow
def test_edges_and_speed_are_differentiable_and_batched():
    def edge(ratio):
        return linear.bands(dimer(20, ratio=ratio, precompression=1.0), cell=2).lower[1]

    ratios = jnp.array([0.3, 0.6])
    value, slope = jax.jit(jax.vmap(jax.value_and_grad(edge)))(ratios)
    assert_allclose(value, np.sqrt(3 / ratios), rtol=1e-12)
    assert_allclose(slope, -np.sqrt(3) / 2 * ratios**-1.5, rtol=1e-10)
    chains = jax.vmap(lambda r: dimer(20, ratio=r, precompression=1.0), out_axes=-1)(ratios)
    speed = jax.vmap(lambda chain: linear.sound_speed(chain, cell=2), in_axes=-1)(chains)
    assert_allclose(speed, np.sqrt(3 / (1 + ratios)), rtol=1e-12)
    slope = jax.grad(lambda r: linear.sound_speed(dimer(20, ratio=r, precompression=1.0)))(0.5)
    assert_allclose(slope, -np.sqrt(3) / 2 * 1.5**-1.5, rtol=1e-12)
    omega = jax.vmap(lambda chain: linear.normal_modes(chain).omega, in_axes=-1)(chains)
    one = linear.normal_modes(dimer(20, ratio=0.6, precompression=1.0)).omega
    assert_allclose(omega[1], one, rtol=1e-12)


@pytest.mark.slow
def test_normal_modes_are_normalised_and_differentiable():
    chain = random_cells("fixed")
    found = linear.normal_modes(chain)
    gram = found.modes.T @ (chain.mass[:, None] * found.modes)
    assert_allclose(gram, np.eye(20), atol=1e-13)
    # fixed ends, equal springs: omega_j = 2 sin(j pi/(2 (N + 1)))
    equal = linear.normal_modes(springs(np.ones(9))).omega
    assert_allclose(equal, 2 * np.sin(np.arange(1, 10) * np.pi / 20), rtol=1e-13)
    # d omega_j/dK = omega_j/(2 K) for all springs together
    slope = jax.jacrev(lambda K: linear.normal_modes(springs(np.ones(9), K)).omega)(1.0)
    assert_allclose(slope, equal / 2, rtol=1e-12)
    # a ring has pairs of equal frequencies; the sum over each pair is still smooth
    ring = jax.grad(lambda K: linear.normal_modes(springs(np.ones(8), K, "periodic")).omega.sum())(
        1.0
    )
    assert_allclose(ring, np.sin(np.arange(8) * np.pi / 8).sum(), rtol=1e-12)


@pytest.mark.parametrize("boundary, rigid", [("fixed", 0), ("periodic", 2)])
def test_the_lowest_modes_by_the_sparse_matrix_are_those_of_the_dense_one(boundary, rigid):
    mass = np.random.default_rng(4).uniform(0.5, 2, (7, 6))

    def crystal(K):
        return gx.scenes.triangular(7, 6, mass=mass, stiffness=K, boundary=boundary)

    all_of_them, found = linear.normal_modes(crystal(1.3)), linear.normal_modes(crystal(1.3), 6)
    assert_allclose(found.omega_squared, all_of_them.omega_squared[:6], rtol=0, atol=1e-13)
    assert found.modes.shape == (7, 6, 2, 6) and np.sum(found.omega == 0) == rigid
    gram = np.einsum("nmda,nm,nmdb->ab", found.modes, mass, found.modes)
    assert_allclose(gram, np.eye(6), atol=1e-12)
    slope = jax.grad(lambda K: linear.normal_modes(crystal(K), 6).omega[rigid])(1.3)
    assert slope == pytest.approx(float(found.omega[rigid]) / 2.6, rel=1e-12)
    with refused("count: expected None where masses or laws are traced"):
        jax.jit(lambda K: linear.normal_modes(crystal(K), 6).omega)(1.3)


def test_unstable_sites_have_negative_frequencies():
    # a site potential -u^2/2 over springs of stiffness 1/4: omega^2 = sin^2(k/2) - 1
    chain = springs(np.ones(8), 0.25, "periodic", OnSite(Linear(-1.0)))
    assert_allclose(linear.normal_modes(chain).omega_squared[0], -1.0, rtol=1e-13)
    assert_allclose(linear.normal_modes(chain).omega[0], -1.0, rtol=1e-13)
    assert_allclose(linear.dispersion(chain, 1.0).omega[0], -np.cos(0.5), rtol=1e-13)


def test_light_mass_defect():
    # one light mass, equal springs: omega^2 = 4 K/(m_d (2 - m_d/m)) = 4.761904762 for m = 1, m_d = 0.6
    mass = np.ones(101)
    mass[50] = 0.6
    top = linear.normal_modes(springs(mass)).omega_squared
    assert_allclose(top[-1], 4 / (0.6 * 1.4), rtol=1e-13)
    assert_allclose(top[-1], 4.761904762, atol=1e-9)
    assert top[-2] < 4


@pytest.mark.parametrize("first, expected", [(2.0, [2.99853515, 3.00146485]), (1.0, [])])
def test_ssh_states(first, expected):
    # springs 1, 2 in turn, 20 masses, walls: gap 2 ... 4 in omega^2; states only where the springs at the walls are 2
    chain = springs(np.ones(20), np.resize([first, 3 - first], 21))
    squared = linear.normal_modes(chain).omega_squared
    assert_allclose(squared[(squared > 2) & (squared < 4)], expected, atol=5e-9)
    assert_allclose(linear.bands(chain).gaps, [np.sqrt([2.0, 4.0])], rtol=1e-12)


def test_bands_in_the_plane():
    # greatest omega^2 of the triangular lattice: 6 at M
    found = linear.bands(triangular())
    assert_allclose(found.upper[1], np.sqrt(6), rtol=1e-12)
    assert found.gaps == [] and found.upper_k.shape == (2, 2)


def test_edge_inside_the_zone():
    # omega^2 = 4 x + 16 x (1 - x), x = sin^2(k/2): greatest at x = 5/8, 6.25
    found = linear.bands(next_nearest())
    assert_allclose(found.upper, [2.5], rtol=1e-14)
    assert_allclose(np.sin(found.upper_k / 2) ** 2, 5 / 8, rtol=1e-6)


@pytest.mark.slow
def test_long_reach_of_pairs_is_found():
    n = np.arange(30)
    chain = Lattice(
        np.ones(30),
        (Bond(Shift(1, "periodic"), Linear(1.0)), Bond(Pairs(n, (n + 5) % 30), Linear(0.2))),
    )
    expected = np.sqrt(4 * np.sin(WAVES / 2) ** 2 + 0.8 * np.sin(5 * WAVES / 2) ** 2)
    assert_allclose(linear.dispersion(chain, WAVES).omega[:, 0], expected, atol=1e-12)


def test_sonic_vacuum_has_zero_frequencies():
    chain = monomer(10)
    found = linear.dispersion(chain, WAVES)
    assert (
        (found.omega == 0).all()
        and (found.group_velocity == 0).all()
        and (found.curvature == 0).all()
    )
    assert (linear.normal_modes(chain).omega == 0).all()


def test_single_precision():
    found = linear.bands(two_masses().astype(jnp.float32))
    assert found.upper.dtype == jnp.float32
    assert_allclose(found.upper, np.sqrt([3 / MASS, 3 * (1 + 1 / MASS)]), rtol=1e-6)


def test_long_chains_take_little_memory():
    chain = dimer(20001, ratio=0.5, precompression=1.0)
    assert_allclose(linear.dispersion(chain, np.pi).omega, np.sqrt([3.0, 6.0]), rtol=1e-13)


@pytest.mark.slow
def test_disordered_ring_as_one_cell():
    mass = np.random.default_rng(5).uniform(0.5, 1.5, 7)
    chain = springs(mass, 1.0, "periodic")
    assert_allclose(
        linear.dispersion(chain, 0.0, cell=7).omega_squared,
        linear.normal_modes(chain).omega_squared,
        atol=1e-13,
    )


class OneWay(Term):
    """A push that is not returned."""

    def force(self, t, u, v, mass):
        return 0.1 * jnp.roll(u, 1)


class Turning(Term):
    """A gyroscopic force, rate (v_y, -v_x)."""

    rate: jax.Array

    def force(self, t, u, v, mass):
        return self.rate * jnp.stack([v[..., 1], -v[..., 0]], -1)


class Hall(Term):
    """A force on scalar sites that is odd between neighbours and turns on and off, rate (v_{n+1} - v_{n-1}) sin t."""

    rate: jax.Array

    def force(self, t, u, v, mass):
        return self.rate * jnp.sin(t) * (jnp.roll(v, -1, 0) - jnp.roll(v, 1, 0))


class Matrix(Term):
    """Damping -C v of neighbours, by a symmetric matrix."""

    C: jax.Array

    def force(self, t, u, v, mass):
        return -jnp.einsum("ab,...b->...a", self.C, v)


def with_term(lattice, term):
    return eqx.tree_at(lambda x: x.terms, lattice, (*lattice.terms, term))


def gyroscopic(rate=0.7):
    return with_term(triangular(), Turning(jnp.asarray(rate)))


@pytest.mark.parametrize(
    ("call", "term"),
    [
        (linear.flat_bands, "Turning"),
        (topology.winding, "Turning"),
        (lambda x: linear.normal_modes(x, 3), "Turning"),
        (lambda _: linear.dispersion(springs_with(Hall(jnp.asarray(1e-3))), 1.0), "Hall"),
        (lambda _: topology.zak(springs_with(Hall(jnp.asarray(1e3)))), "Hall"),
    ],
)
def test_what_needs_the_stiffness_alone_refuses_gyroscopic_forces(call, term):
    """So does everything where they change in time."""
    with refused(rf"\({term}\).*gyroscopic.*floquet_bands"):
        call(gyroscopic())


def springs_with(term):
    return with_term(springs(np.ones(12), 1.0, "periodic"), term)


def quadratic(D, G):
    """The positive frequencies of q'' = -D q - G q', rising, and q, by the companion matrix."""
    size = len(D)
    values, vectors = np.linalg.eig(
        np.block([[np.zeros_like(D), np.eye(size)], [-D, -np.asarray(G)]])
    )
    order = np.argsort(-values.imag)[size:]
    assert np.abs(values.real).max() < 1e-12
    return -values.imag[order], vectors[:size, order]


def test_the_waves_of_a_gyroscopic_lattice_by_the_quadratic_eigenproblem():
    """(D(k) - i omega G) q = omega^2 q, G = 0.7 (0, -1; 1, 0)."""
    k = np.array([[np.pi / 3, 2 * np.pi / 3], [1.0, -0.4], [2.0, 0.3]])
    ways = {(1, 0): (1.0, 0.0), (0, 1): (0.5, 3**0.5 / 2), (-1, 1): (-0.5, 3**0.5 / 2)}
    G = 0.7 * np.array([[0, -1], [1, 0]])
    lattice = gyroscopic()
    found, bands = linear.dispersion(lattice, k), linear.floquet_bands(lattice, k, period=0.5)

    def exact(x):
        D = sum(2 * (1 - np.cos(np.dot(x, R))) * np.outer(n, n) for R, n in ways.items())
        return quadratic(D, G)

    for x, own, q, speed, bend, all_omega in zip(
        k, found.omega, found.vectors, found.group_velocity, found.curvature, bands.omega
    ):
        omega, vectors = exact(x)
        np.testing.assert_allclose(own, omega, rtol=1e-12)
        np.testing.assert_allclose(np.sort(all_omega)[2:], omega, rtol=1e-9)
        q = q.reshape(2, 2)
        aligned = np.abs((q.conj() * vectors).sum(0)) / np.linalg.norm(vectors, axis=0)
        np.testing.assert_allclose(aligned, 1, rtol=1e-12)
        moved = lambda way: exact(x + way)[0]
        h = 1e-3 * np.eye(2)
        np.testing.assert_allclose(speed.T, [(moved(a) - moved(-a)) / 2e-3 for a in h], atol=1e-6)
        second = [
            [(moved(a + b) - moved(a - b) - moved(b - a) + moved(-a - b)) / 4e-6 for b in h]
            for a in h
        ]
        np.testing.assert_allclose(np.moveaxis(bend, 0, -1), second, atol=1e-5)
    np.testing.assert_allclose(linear.dispersion(lattice, [0.0, 0.0]).omega, [0, 0.7], atol=1e-12)


class Staggered(Term):
    """Gyroscopes of opposite senses in turn along the first axis, rate (v_y, -v_x), and odd forces of neighbours."""

    rate: jax.Array
    odd: jax.Array

    def force(self, t, u, v, mass):
        sense = jnp.where(jnp.arange(v.shape[0]) % 2, -1, 1)[:, None, None]
        return self.rate * sense * jnp.stack([v[..., 1], -v[..., 0]], -1) + self.odd * (
            jnp.roll(v, -1, 0) - jnp.roll(v, 1, 0)
        )


def test_the_speed_of_sound_among_gyroscopes():
    """Against long waves by the companion matrix of a cell of two masses, along a direction and against it."""
    masses = np.array([1.0, 0.4])
    mass = jnp.asarray(np.repeat(np.resize(masses, 6)[:, None], 6, 1))

    def lattice(rate, odd=0.2):
        crystal = gx.scenes.triangular(6, 6, boundary="periodic", mass=mass)
        return with_term(crystal, Staggered(jnp.asarray(rate), jnp.asarray(odd)))

    def slowest(way, rate, odd, h=1e-3):
        """omega/|k| of the two lowest waves with phases h way per site."""
        K, C = np.zeros((2, 4, 4), complex)
        for (a, b), x in (((1, 0), 0.0), ((0, 1), np.pi / 3), ((1, -1), -np.pi / 3)):
            n = np.array([np.cos(x), np.sin(x)])
            pull, turn = np.outer(n, n), np.exp(1j * h * (a * way[0] + b * way[1]))
            for i in range(2):
                other = slice(2 * ((i + a) % 2), 2 * ((i + a) % 2) + 2)
                own = slice(2 * i, 2 * i + 2)
                K[own, own] += 2 * pull
                K[own, other] -= pull * turn
                K[other, own] -= pull / turn
        J = np.array([[0, -1], [1, 0]])
        C[:2, :2], C[2:, 2:] = rate * J, -rate * J
        shift = -2j * odd * np.sin(h * way[0]) * np.eye(2)
        C[:2, 2:], C[2:, :2] = shift, shift
        root = np.repeat(masses, 2) ** 0.5
        K, C = (x / root[:, None] / root for x in (K, C))
        values = np.linalg.eigvals(np.block([[np.zeros((4, 4)), np.eye(4)], [-K, -C]]))
        return np.sort(-values.imag)[4:6] / h

    for way in np.array([[1.0, 0.0], [-1.0, 0.0], [0.3, 0.8], [-0.3, -0.8]]):
        found = linear.sound_speed(lattice(0.5), direction=way)
        np.testing.assert_allclose(found, slowest(way, 0.5, 0.2), rtol=1e-6)
    speed = lambda r: linear.sound_speed(lattice(r), cell=(2, 1), direction=way)
    slope = (speed(0.5 + 1e-5) - speed(0.5 - 1e-5)) / 2e-5
    for derivative in (jax.jacfwd, jax.jacrev):
        np.testing.assert_allclose(derivative(speed)(0.5), slope, rtol=1e-7)
    np.testing.assert_allclose(jax.vmap(speed)(jnp.array([0.2, 0.5]))[1], speed(0.5), rtol=1e-12)
    with refused("turn a uniform motion"):
        linear.sound_speed(gyroscopic())


def test_gyroscopic_modes_and_bands_are_traced_and_batched():
    K_only = lambda r: linear.dispersion(gyroscopic(r), K_POINT, cell=(1, 1)).omega
    rates = jnp.array([0.1, 0.7])
    each = np.array([K_only(r) for r in rates])
    np.testing.assert_allclose(jax.vmap(K_only)(rates), each, rtol=1e-12)
    slope = (K_only(0.7 + 1e-5) - K_only(0.7 - 1e-5)) / 2e-5
    for derivative in (jax.jacfwd, jax.jacrev):
        np.testing.assert_allclose(derivative(K_only)(0.7), slope, rtol=1e-8)
    top = lambda r: linear.bands(gyroscopic(r)).upper[-1]
    np.testing.assert_allclose(
        jax.grad(top)(0.7), (top(0.7 + 1e-5) - top(0.7 - 1e-5)) / 2e-5, rtol=1e-7
    )


def test_the_modes_of_a_finite_gyroscopic_lattice():
    lattice = with_term(
        gx.scenes.triangular(3, 3, boundary="fixed", mass=2.0), Turning(jnp.asarray(0.7))
    )
    plain = linear.normal_modes(gx.scenes.triangular(3, 3, boundary="fixed", mass=2.0))
    phi = np.asarray(plain.modes).reshape(18, 18)
    G = np.kron(np.eye(9), 0.35 * np.array([[0, -1], [1, 0]]))
    omega, _ = quadratic(2 * phi @ np.diag(plain.omega_squared) @ phi.T, G)
    found = linear.normal_modes(lattice)
    np.testing.assert_allclose(found.omega, omega, rtol=1e-10)
    assert found.omega.shape == (18,) and jnp.iscomplexobj(found.modes)


def test_a_gyroscopic_honeycomb_is_a_chern_insulator():
    """Between the two valleys' gaps: as many one-way edge modes as the Chern numbers below sum to."""
    rate, held = 0.3, [gx.OnSite(gx.Linear(0.2), field=name) for name in "ab"]

    class Both(Term):
        def force(self, t, u, v, mass):
            return {n: rate * jnp.stack([x[..., 1], -x[..., 0]], -1) for n, x in v.items()}

    def crystal(*size, boundary):
        found = gx.scenes.honeycomb(*size, boundary=boundary)
        for term in (*held, Both()):
            found = with_term(found, term)
        return found

    lattice = crystal(6, 6, boundary="periodic")
    numbers = [topology.chern(lattice, band) for band in range(4)]
    cell = linear.cell.turning_cell(lattice)
    k = 2 * np.pi * np.arange(24) / 24
    states = np.empty((24, 24, 4, 4), complex)
    for i, j in np.ndindex(24, 24):
        at = jnp.array([k[i], k[j]])
        states[i, j] = quadratic(np.asarray(cell.dynamical_matrix(at)), cell.gyration(at))[1]
    states /= np.linalg.norm(states, axis=-2, keepdims=True)
    ahead = [(states.conj() * np.roll(states, -1, a)).sum(-2) for a in (0, 1)]
    around = ahead[0] * np.roll(ahead[1], -1, 0) / (np.roll(ahead[0], -1, 1) * ahead[1])
    assert numbers == np.round(-np.angle(around).sum((0, 1)) / (2 * np.pi)).astype(int).tolist()
    assert numbers == [-1, 0, 0, 1]
    assert np.isfinite(topology.valley_chern(lattice, 3, points=24))
    strip = linear.ribbon(crystal(4, 14, boundary=("periodic", "free")))
    middle = np.mean(linear.bands(lattice).gaps[1])
    crossed = np.diff(np.sign(np.asarray(strip.omega) - middle), axis=0) != 0
    at_edge = [np.sign(strip.edge[i, n]) for i, n in np.argwhere(crossed)]
    assert crossed.sum() == 2 and sorted(at_edge) == [-1, 1]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["damping", "dashpot", "matrix", "drag"])
def test_damping_leaves_the_undamped_frequencies(name):
    class Drag(Term):
        def force(self, t, u, v, mass):
            return -0.3 * v * jnp.abs(v)

    term = {
        "damping": Damping(0.3),
        "drag": Drag(),
        "matrix": Matrix(jnp.array([[0.3, 0.1], [0.1, 0.2]])),
        "dashpot": Dashpot(Stretch(Shift((1, 0), "periodic"), np.array([1.0, 0.0])), 0.3),
    }[name]
    plain, damped = triangular(), with_term(triangular(), term)
    assert np.array_equal(
        linear.dispersion(plain, WAVES[:2]).omega, linear.dispersion(damped, WAVES[:2]).omega
    )
    assert np.array_equal(linear.normal_modes(plain).omega, linear.normal_modes(damped).omega)
    # in jit too, where a matrix may be any, so that the gyroscopic form is taken
    traced = jax.jit(lambda x: linear.normal_modes(x).omega)
    assert np.abs(traced(damped) - linear.normal_modes(plain).omega).max() < 1e-12


DISORDER = springs(np.random.default_rng(2).uniform(1, 2, 20))
BATCH = jax.vmap(lambda r: dimer(8, ratio=r, precompression=1.0), out_axes=-1)(
    jnp.array([0.3, 0.5])
)
MODULATED = Lattice(np.ones(8), Modulated(Bond(Shift(1), Linear(1.0)), Function(jnp.cos)))
DEFECT = springs(np.where(np.arange(12) == 0, 2.0, 1.0), 1.0, "periodic")

REFUSALS = {
    "disorder": (lambda: linear.dispersion(DISORDER, 1.0), "repeats along axis 0.*normal_modes"),
    "defect of a ring": (lambda: linear.bands(DEFECT), "repeats along axis 0"),
    "batch": (lambda: linear.bands(BATCH), "in_axes=-1"),
    "modulated": (lambda: linear.normal_modes(MODULATED), "constant in time"),
    "wrong cell": (
        lambda: linear.dispersion(two_masses(), 1.0, cell=3),
        "a period of the lattice.*got 3",
    ),
    "cell of a ring": (
        lambda: linear.dispersion(two_masses(12, "periodic"), 1.0, cell=5),
        "a divisor of 12",
    ),
    "large cell": (lambda: linear.dispersion(two_masses(12), 1.0, cell=11), "at most 10"),
    "short ring": (lambda: linear.dispersion(next_nearest(sites=4), 1.0), "at least 5 sites"),
    "phases": (lambda: linear.dispersion(triangular(), 1.0), "k: expected a last axis of length 2"),
    "traced": (
        lambda: jax.jit(lambda r: linear.bands(dimer(9, ratio=r)).upper)(0.5),
        "cell: .*traced",
    ),
    "vacuum": (lambda: linear.sound_speed(monomer(9)), "precompression > 0"),
    "ground": (lambda: linear.sound_speed(mass_in_mass(0.5)), "no acoustic band"),
    "loose": (
        lambda: linear.sound_speed(springs(np.ones(8), np.resize([1.0, 0.0, 0.0], 9))),
        "held together",
    ),
    "direction": (
        lambda: linear.sound_speed(triangular(), direction=(1.0,)),
        "direction: expected 2 numbers",
    ),
    "no energy": (
        lambda: linear.normal_modes(springs(np.ones(8), 1.0, "periodic", OneWay())),
        "symmetric",
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", REFUSALS)
def test_refusals(name):
    call, message = REFUSALS[name]
    with refused(message):
        call()


@pytest.mark.parametrize(
    "make",
    [
        lambda: gx.scenes.monomer(8),
        lambda: gx.scenes.beads("PTFE", 5e-3, cells=8),
        lambda: gx.scenes.monomer(8, exponent=2.5, boundary="periodic"),
    ],
)
def test_bands_of_a_sonic_vacuum_say_so(make):
    found = gx.linear.bands(make())
    assert not np.any(found.upper) and "sonic vacuum" in found.outcome

    with refused("sonic vacuum"):
        gx.linear.sound_speed(make())


@pytest.mark.parametrize("axis", [0, -1])
def test_a_batch_says_how_many_modes_and_bands_each_lane_has(axis):
    def found(ratio):
        ring = gx.scenes.dimer(6, ratio=ratio, precompression=1.0, boundary="periodic")
        path = linear.path(ring, "GX", 4, 2)
        waves = linear.floquet_bands(ring, [1.0], 1.0, cell=2, steps=8)
        return linear.normal_modes(ring), linear.bands(ring, cell=2), path, waves

    modes, bands, path, waves = jax.vmap(found, out_axes=axis)(jnp.array([0.3, 0.5, 0.7]))
    assert modes.outcome.startswith("6 modes in each of 3 lanes, up to 3.6")
    assert bands.outcome == "2 bands in each of 3 lanes, cell of 2 sites."
    assert path.outcome.startswith("2 bands along G-X in each of 3 lanes")
    assert waves.outcome.startswith("4 multipliers at 1 wave numbers in each of 3 lanes")
    assert found(0.5)[1].outcome == "2 bands, 1 gap, cell of 2 sites."


def test_folded_bands_touch():
    assert linear.bands(springs(np.ones(12)), cell=3).gaps == []


def test_shapes_of_modes():
    assert linear.normal_modes(triangular()).modes.shape == (5, 6, 2, 60)
    parts = linear.normal_modes(mass_in_mass()).modes
    assert parts["bead"].shape == parts["core"].shape == (12, 24)


@pytest.mark.slow
def test_waves_inside_jit():
    chain = two_masses(12)
    expected = linear.dispersion(chain, WAVES).omega
    assert_allclose(
        jax.jit(lambda k: linear.dispersion(chain, k).omega)(WAVES), expected, atol=1e-12
    )
    given = jax.jit(lambda chain, k: linear.dispersion(chain, k, cell=2).omega)
    assert_allclose(given(chain, WAVES), expected, atol=1e-12)


def test_complex_bands_follow_all_that_damps():
    """A wave exp(i k n - i omega t) with the k that is found leaves nothing of the equation of motion."""
    omega, mass = np.array([0.4, 1.3]), np.array([1.0, 2.0] * 6)
    chain = Lattice(
        mass,
        (
            gx.Bond(Shift(1), Linear(1.0)),
            gx.Bond(Shift(2), Linear(0.2)),
            Damping(0.1),
            gx.Dashpot(Shift(1), 0.05),
            gx.CaputoDamping(0.2, 0.4),
        ),
    )
    found = linear.complex_bands(chain, omega)
    assert found.cell == (2,) and found.k.shape == (2, 4) and found.residual.max() < 1e-13
    for w, waves in zip(omega, found.k):
        for k in waves:
            z = np.exp(1j * k / 2)
            near, far = 1 - 1j * w * 0.05, 0.2
            own = 2 * near + 2 * far + 0.2 * (-1j * w) ** 0.4
            rows = np.array(
                [
                    [own - far * (z**2 + z**-2) - m * w * (w + 0.1j), -near * (z + 1 / z)]
                    for m in (1.0, 2.0)
                ]
            )
            D = np.array([rows[0], rows[1][::-1]])
            assert abs(np.linalg.det(D)) < 1e-11 * np.abs(D).max() ** 2
    undamped = linear.complex_bands(Lattice(mass, chain.terms[:2]), omega)
    weak = linear.complex_bands(
        Lattice(mass, (*chain.terms[:2], gx.CaputoDamping(1e-6, 0.4))), omega
    )
    np.testing.assert_allclose(np.exp(1j * weak.k), np.exp(1j * undamped.k), rtol=1e-4)


def test_complex_bands_of_a_gyroscopic_lattice_hold_its_dispersion():
    lattice = gyroscopic()
    omega = linear.dispersion(lattice, [1.1, 0.0]).omega
    found = linear.complex_bands(lattice, omega, axis=0, across=0.0)
    assert np.abs(found.k - 1.1).min(1).max() < 1e-8
