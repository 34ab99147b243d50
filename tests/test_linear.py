"""Linear theory: frequencies, bands and speeds against closed forms."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import Turning
from numpy.testing import assert_allclose
from refusals import refused
from scipy.optimize import minimize

import granjax as gx
from granjax import linear, topology
from granjax.lattice import Lattice
from granjax.laws import Hertz, Linear
from granjax.linear import stiffness
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


def triangular(prestress=0.0):
    return gx.scenes.triangular(5, 6, precompression=prestress, boundary="periodic")


def mass_in_mass(boundary="periodic", *terms):
    bonds = (
        Bond(Shift(1, boundary, "bead"), Linear(1.0)),
        Bond(Shift(0, boundary, ("bead", "core")), Linear(0.3)),
    )
    return Lattice({"bead": np.ones(12), "core": np.full(12, 0.5)}, (*bonds, *terms))


def next_nearest(boundary="periodic", sites=12, second=1.0):
    laws = Linear(1.0), Linear(second)
    bonds = tuple(Bond(Shift(offset, boundary), law) for offset, law in zip((1, 2), laws))
    return Lattice(np.ones(sites), bonds)


def random_cells(boundary="periodic", size=5, cells=4):
    mass, stiffness = np.random.default_rng(3).uniform(0.5, 2, (2, size))
    # the first spring of a chain between walls is the left wall's
    held = boundary == "fixed"
    stiffness = np.resize(np.roll(stiffness, held), size * cells + held)
    return springs(np.tile(mass, cells), stiffness, boundary)


# ---------------------------------------------------------------------------------------------------- closed forms


@pytest.mark.slow
def test_a_monomer_has_the_frequencies_velocities_and_curvatures_of_its_closed_form():
    # omega = 2 sqrt(K2/m) |sin(k/2)|, K2 = 3/2 A d0^(1/2) = 1.5 F0^(1/3) A^(2/3)
    chain = monomer(12, mass=2.0, precompression=1.0)
    found = linear.dispersion(chain, WAVES)
    top = np.sqrt(1.5 / 2)
    assert found.cell == (1,) and found.vectors.shape == (11, 1, 1)
    assert_allclose(found.omega[:, 0], 2 * top * abs(np.sin(WAVES / 2)), rtol=0, atol=1e-12)
    slope = top * np.cos(WAVES / 2) * np.sign(WAVES)
    bend = -top / 2 * abs(np.sin(WAVES / 2))
    assert_allclose(found.group_velocity[MOVING, 0], slope[MOVING], atol=1e-12)
    assert_allclose(found.curvature[MOVING, 0], bend[MOVING], atol=1e-12)
    assert_allclose(linear.sound_speed(chain), top, rtol=1e-14)
    assert_allclose(linear.bands(chain).upper, [2 * top], rtol=1e-14)
    # long waves lose no digits
    assert_allclose(linear.dispersion(chain, 1e-9).omega, [top * 1e-9], rtol=1e-13)


def test_a_dimer_has_the_edges_and_the_speed_of_its_closed_form():
    # sqrt(2 K2/M), sqrt(2 K2/m), sqrt(2 K2 (1/m + 1/M)), K2 = 1.5: 1.0070830, 1.7320508, 2.0035509
    found = linear.bands(two_masses())
    edges = np.sqrt([3 / MASS, 3.0, 3 * (1 + 1 / MASS)])
    assert_allclose(edges, [1.0070830, 1.7320508, 2.0035509], atol=6e-8)
    assert_allclose(np.r_[found.lower, found.upper], [0, edges[1], edges[0], edges[2]], atol=1e-12)
    assert_allclose(found.gaps, [(edges[0], edges[1])], atol=1e-12)
    assert "gap 1.00708" in " ".join(repr(found).split())
    odd = dimer(101, ratio=0.5, precompression=1.0)
    assert_allclose(linear.bands(odd).gaps, [np.sqrt([3.0, 6.0])], rtol=1e-13)
    # one cell of two beads: total mass 1.5, compliance 2/1.5; c = 2 beads per cell / sqrt(mass * compliance)
    assert_allclose(linear.sound_speed(odd), 2 / np.sqrt(1.5 * 2 / 1.5), rtol=1e-13)
    long = dimer(20001, ratio=0.5, precompression=1.0)
    assert_allclose(linear.dispersion(long, np.pi).omega, np.sqrt([3.0, 6.0]), rtol=1e-13)
    single = linear.bands(two_masses().astype(jnp.float32)).upper
    assert single.dtype == jnp.float32
    assert_allclose(single, edges[[0, 2]], rtol=1e-6)


@pytest.mark.slow
def test_sound_has_the_speed_of_its_closed_form():
    # a chain of cells: c = p / sqrt(sum of masses * sum of compliances), statics of springs in series
    chain = random_cells()
    mass = np.asarray(chain.mass[:5])
    stiffness = np.asarray(chain.terms[0].law.stiffness[:5])
    speed = 5 / np.sqrt(mass.sum() * (1 / stiffness).sum())
    assert_allclose(linear.sound_speed(chain), speed, rtol=1e-12)
    assert_allclose(linear.dispersion(chain, 1e-4).omega[0] / 1e-4 * 5, speed, rtol=1e-6)
    # bead and core move as one in a long wave: sqrt(K/(m + nu)); springs to n +- 2 count four times
    assert_allclose(linear.sound_speed(mass_in_mass()), np.sqrt(1 / 1.5), rtol=1e-12)
    assert_allclose(linear.sound_speed(next_nearest()), np.sqrt(5), rtol=1e-12)
    assert linear.sound_speed(springs(np.ones(8), np.resize([1.0, 0.0], 9))) == 0
    # the triangular lattice is isotropic, Lame constants sqrt(3)/4 K, density 2 m/sqrt(3)
    crystal = gx.scenes.triangular(6, 6, boundary="fixed")
    for angle, cell in ((0.0, None), (0.4, None), (1.1, (2, 1))):
        direction = [np.cos(angle), np.cos(angle - np.pi / 3)]
        speeds = linear.sound_speed(crystal, cell, direction=direction)
        assert_allclose(speeds**2, [3 / 8, 9 / 8], rtol=1e-12)


def test_walls_and_drives_do_not_count():
    ends = (Wall(Linear(5.0), "left", Harmonic(1.0, 2.0)), Drive(Harmonic(1.0, 1.0)), Damping(0.3))
    chain = springs(np.ones(10), 1.0, "free", *ends)
    omega = linear.dispersion(chain, WAVES).omega[:, 0]
    assert_allclose(omega, 2 * abs(np.sin(WAVES / 2)), atol=1e-12)
    K = np.diag([6.0] + [2.0] * 8 + [1.0]) - np.eye(10, k=1) - np.eye(10, k=-1)
    assert_allclose(linear.normal_modes(chain).omega_squared, np.linalg.eigvalsh(K), atol=1e-13)


def test_unstable_sites_have_negative_frequencies():
    # a site potential -u^2/2 over springs of stiffness 1/4: omega^2 = sin^2(k/2) - 1
    chain = springs(np.ones(8), 0.25, "periodic", OnSite(Linear(-1.0)))
    modes = linear.normal_modes(chain)
    assert_allclose([modes.omega_squared[0], modes.omega[0]], [-1, -1], rtol=1e-13)
    assert_allclose(linear.dispersion(chain, 1.0).omega[0], -np.cos(0.5), rtol=1e-13)


def test_a_light_mass_has_a_mode_above_the_band():
    # one light mass, equal springs: omega^2 = 4 K/(m_d (2 - m_d/m)) = 4.761904762 for m = 1, m_d = 0.6
    mass = np.where(np.arange(101) == 50, 0.6, 1.0)
    below, top = linear.normal_modes(springs(mass)).omega_squared[-2:]
    assert_allclose(top, 4 / (0.6 * 1.4), rtol=1e-13)
    assert_allclose(top, 4.761904762, atol=1e-9)
    assert below < 4


@pytest.mark.slow
def test_of_two_extrema_of_a_band_the_lower_is_its_edge():
    """A kagome lattice of three masses: the best sample of the fourth band lies beside the higher minimum."""
    masses = {"a": 1.0, "b": 1.3, "c": 0.8}
    lattice = gx.scenes.kagome(6, boundary="periodic", mass=masses, ground=0.1)
    found = linear.bands(lattice)
    fourth = lambda k: float(linear.dispersion(lattice, k).omega[3])
    edge = minimize(fourth, [2.5, 4.7], method="Nelder-Mead", options={"fatol": 1e-14})
    assert_allclose(found.lower[3], edge.fun, rtol=1e-10)
    # the edge moves as the band does at its place
    there = found.lower_k[3]
    by_ground = lambda g: gx.scenes.kagome(6, boundary="periodic", mass=masses, ground=g)
    slope = jax.grad(lambda g: linear.bands(by_ground(g), cell=1).lower[3])(0.1)
    band = jax.grad(lambda g: linear.dispersion(by_ground(g), there, cell=1).omega[3])(0.1)
    assert_allclose(slope, band, rtol=1e-7)


@pytest.mark.slow
def test_a_long_cell_of_a_disordered_chain_has_its_edges_at_the_ends_of_the_zone():
    """Each site is coupled to its neighbours alone; under jit, where that is not known, all edges are refined."""
    draw = np.random.default_rng(3)
    mass, stiffness = draw.uniform(0.5, 1.5, (2, 150))
    found = linear.bands(springs(mass, stiffness, "periodic"), cell=150)
    before = np.roll(stiffness, 1)
    expected = []
    for around in (1, -1):  # exp(ik) at k = 0 and pi
        K = np.diag(stiffness + before) - np.diag(stiffness[:-1], 1) - np.diag(stiffness[:-1], -1)
        K[0, -1] = K[-1, 0] = -around * stiffness[-1]
        expected.append(np.linalg.eigvalsh(K / np.sqrt(np.outer(mass, mass))))
    squared = found.lower**2, found.upper**2
    assert_allclose(squared, np.sort(expected, 0), atol=2e-14 * np.max(expected))
    assert set(np.append(found.lower_k, found.upper_k)) == {0.0, np.pi}
    few = springs(mass[:5], stiffness[:5], "periodic")
    both = [
        f(few).upper for f in (lambda x: linear.bands(x, 5), jax.jit(lambda x: linear.bands(x, 5)))
    ]
    assert_allclose(*both, rtol=1e-14)


@pytest.mark.slow
def test_edges_are_found_in_the_plane_inside_the_zone_and_where_bands_touch():
    # greatest omega^2 of the triangular lattice: 6 at M
    plane = linear.bands(triangular())
    assert_allclose(plane.upper[1], np.sqrt(6), rtol=1e-12)
    assert plane.gaps == [] and plane.upper_k.shape == (2, 2)
    # omega^2 = 4 x + 16 x (1 - x), x = sin^2(k/2): greatest at x = 5/8, 6.25
    inside = linear.bands(next_nearest())
    assert_allclose(inside.upper, [2.5], rtol=1e-14)
    assert_allclose(np.sin(inside.upper_k / 2) ** 2, 5 / 8, rtol=1e-6)
    assert linear.bands(springs(np.ones(12)), cell=3).gaps == []
    # six maxima, of which the last is the greatest
    far = [Bond(Shift(n, "periodic"), Linear(1.0)) for n in (1, 12)]
    k = np.linspace(0, np.pi, 400_001)
    highest = np.sqrt(np.max(4 * np.sin(k / 2) ** 2 + 4 * np.sin(6 * k) ** 2))
    assert_allclose(linear.bands(Lattice(np.ones(30), far)).upper, [highest], rtol=1e-9)


@pytest.mark.slow
def test_an_edge_inside_the_zone_of_a_plane_is_told_with_its_place():
    # omega^2 = 4 x + 16 x (1 - x) along either axis, x = sin^2(k/2): greatest at x = 5/8, twice 6.25
    ways = (1, 0), (0, 1), (2, 0), (0, 2)
    bonds = [Bond(Shift(way, "periodic"), Linear(1.0)) for way in ways]
    found = linear.bands(Lattice(1.0, bonds, sites=(6, 6)))
    assert_allclose(found.upper, [12.5**0.5], rtol=1e-14)
    k = found.upper_k
    assert_allclose(np.sin(k / 2) ** 2, [[5 / 8] * 2], rtol=1e-6)
    assert np.all((k >= 0) & (k <= 2 * np.pi))


def test_edges_at_the_ends_of_the_zone_are_exact():
    # omega^2 = 4 x + 1.6 x (1 - x), x = sin^2(k/2), rises from 0 to pi
    found = linear.bands(next_nearest(second=0.1))
    ends = found.lower, found.lower_k, found.upper, found.upper_k
    assert_allclose(np.ravel(ends), [0, 0, 2, np.pi], rtol=1e-15, atol=0)


@pytest.mark.slow
def test_long_reach_of_pairs_is_found():
    n = np.arange(30)
    bonds = (
        Bond(Shift(1, "periodic"), Linear(1.0)),
        Bond(Pairs(n, (n + 5) % 30), Linear(0.2)),
    )
    expected = np.sqrt(4 * np.sin(WAVES / 2) ** 2 + 0.8 * np.sin(5 * WAVES / 2) ** 2)
    found = linear.dispersion(Lattice(np.ones(30), bonds), WAVES).omega[:, 0]
    assert_allclose(found, expected, atol=1e-12)


def test_a_sonic_vacuum_has_zero_frequencies_and_says_so():
    chain = monomer(10)
    found = linear.dispersion(chain, WAVES)
    bands = linear.bands(chain)
    for zero in (found.omega, found.group_velocity, found.curvature, bands.upper):
        assert not np.any(zero)
    assert not np.any(linear.normal_modes(chain).omega) and "sonic vacuum" in bands.outcome


# ------------------------------------------------------------------------------------------- waves, rings, derivatives


RINGS = {
    "random cells": random_cells(),
    "mass in mass": mass_in_mass(),
    "triangular": triangular(0.1),
    "kagome": gx.scenes.kagome(4, out_of_plane=True, boundary="periodic"),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", RINGS)
def test_bloch_waves_are_the_modes_of_a_ring(name):
    chain = RINGS[name]
    sites = next(iter(chain.sites.values())) if chain.fields else chain.sites
    cell = linear.unit_cell(chain).cell
    phases = [2 * np.pi * np.arange(n // p) / (n // p) for n, p in zip(sites, cell)]
    k = np.stack(np.meshgrid(*phases, indexing="ij"), -1)
    waves = linear.dispersion(chain, k if len(sites) > 1 else k[..., 0]).omega_squared
    modes = linear.normal_modes(chain).omega_squared
    assert_allclose(np.sort(np.ravel(waves)), modes, rtol=0, atol=1e-12 * modes.max())


@pytest.mark.slow
def test_a_disordered_ring_may_be_one_cell():
    chain = springs(np.random.default_rng(5).uniform(0.5, 1.5, 7), 1.0, "periodic")
    found = linear.dispersion(chain, 0.0, cell=7).omega_squared
    assert_allclose(found, linear.normal_modes(chain).omega_squared, atol=1e-13)


@pytest.mark.slow
@pytest.mark.parametrize("make", [next_nearest, random_cells, mass_in_mass])
def test_boundary_does_not_count(make):
    inside, ring = (linear.dispersion(make(x), WAVES).omega for x in ("fixed", "periodic"))
    assert_allclose(inside, ring, rtol=1e-10, atol=1e-12)


@pytest.mark.slow
def test_bloch_vectors_solve_the_lattice_and_are_normalised():
    chain = two_masses(12, "periodic")
    k = 2 * np.pi / 6
    found = linear.dispersion(chain, k)
    for band in range(2):
        wave = np.concatenate([found.vectors[:, band] * np.exp(1j * k * R) for R in range(6)])
        real, imaginary = (
            chain.force(0.0, 1e-7 * x, chain.zeros()) / 1e-7 for x in (wave.real, wave.imag)
        )
        want = -(found.omega[band] ** 2) * chain.mass * wave
        assert_allclose(real + 1j * imaginary, want, atol=1e-5)
        assert_allclose(np.array([1, MASS]) @ abs(found.vectors[:, band]) ** 2, 1, rtol=1e-13)
    plane = linear.dispersion(triangular(), np.ones((2, 2)), (5, 1)).vectors
    assert plane.shape == (2, 5, 1, 2, 10)
    parts = linear.dispersion(mass_in_mass(), WAVES).vectors
    assert parts["bead"].shape == parts["core"].shape == (11, 1, 2)
    assert_allclose(abs(parts["bead"]) ** 2 + 0.5 * abs(parts["core"]) ** 2, 1.0, rtol=1e-13)


def test_velocities_and_curvatures_are_derivatives_of_bands():
    k = np.array([0.7, -1.1])
    h = 1e-4
    found = lambda k: linear.dispersion(RINGS["triangular"], k)
    here = found(k)
    assert here.group_velocity.shape == (2, 2) and here.curvature.shape == (2, 2, 2)
    for axis, step in enumerate(h * np.eye(2)):
        after = found(k + step)
        before = found(k - step)
        slope = (after.omega - before.omega) / (2 * h)
        assert_allclose(here.group_velocity[:, axis], slope, atol=1e-7)
        bend = (after.group_velocity - before.group_velocity) / (2 * h)
        assert_allclose(here.curvature[:, axis], bend, atol=1e-6)


@pytest.mark.slow
def test_derivatives_that_do_not_exist_are_nan():
    # two cells in one: bands cross at pi; an acoustic band has a corner at 0
    folded = linear.dispersion(springs(np.ones(12)), np.array([0.0, np.pi]), cell=2).group_velocity
    assert np.isnan(folded[1]).all() and np.isnan(folded[0, 0]) and abs(folded[0, 1]) < 1e-12
    bonds = tuple(Bond(Shift(1, "periodic", name), Linear(1.0)) for name in "ab")
    together = linear.dispersion(Lattice({"a": np.ones(6), "b": np.ones(6)}, bonds), 1.0)
    assert_allclose(together.group_velocity, np.cos(0.5), rtol=1e-12)
    assert_allclose(together.curvature, -np.sin(0.5) / 2, rtol=1e-12)


def light(ratio):
    return dimer(20, ratio=ratio, precompression=1.0)


@pytest.mark.slow
def test_frequencies_have_derivatives_by_wave_number_and_by_parameters():
    omega = lambda ratio, k: linear.dispersion(light(ratio), k).omega[0]

    # K2 = 1.5: omega^2 = K2 s - sqrt(K2^2 s^2 - 4 K2^2 sin^2(k/2)/(m M)), s = 1/m + 1/M
    def closed(ratio, k):
        s = 1 + 1 / ratio
        return jnp.sqrt(1.5 * (s - jnp.sqrt(s * s - 4 * jnp.sin(k / 2) ** 2 / ratio)))

    expected = jax.grad(closed, (0, 1))(0.4, 1.3)
    for derivative in (jax.grad, jax.jacfwd):
        assert_allclose(derivative(omega, (0, 1))(0.4, 1.3), expected, rtol=1e-10)
    assert_allclose(linear.dispersion(light(0.4), 1.3).group_velocity[0], expected[1], rtol=1e-12)


@pytest.mark.slow
def test_edges_and_speed_are_differentiable_and_batched():
    edge = lambda ratio: linear.bands(light(ratio), cell=2).lower[1]
    ratios = jnp.array([0.3, 0.6])
    value, slope = jax.jit(jax.vmap(jax.value_and_grad(edge)))(ratios)
    assert_allclose(value, np.sqrt(3 / ratios), rtol=1e-12)
    assert_allclose(slope, -np.sqrt(3) / 2 * ratios**-1.5, rtol=1e-10)
    chains = jax.vmap(light, out_axes=-1)(ratios)
    speed = jax.vmap(lambda chain: linear.sound_speed(chain, cell=2), in_axes=-1)(chains)
    assert_allclose(speed, np.sqrt(3 / (1 + ratios)), rtol=1e-12)
    slope = jax.grad(lambda r: linear.sound_speed(light(r)))(0.5)
    assert_allclose(slope, -np.sqrt(3) / 2 * 1.5**-1.5, rtol=1e-12)
    omega = jax.vmap(lambda chain: linear.normal_modes(chain).omega, in_axes=-1)(chains)
    assert_allclose(omega[1], linear.normal_modes(light(0.6)).omega, rtol=1e-12)


@pytest.mark.slow
def test_an_edge_inside_the_zone_follows_the_parameters():
    def found(K):
        bands = linear.bands(next_nearest(second=K), cell=1)
        return jnp.stack([bands.upper[0], bands.upper_k[0]])

    # omega^2 = 2 (1 - cos k) + 2 K (1 - cos 2k) is greatest at cos k = -1/(4 K)
    exact = lambda K: jnp.stack([jnp.sqrt(2 + 4 * K + 1 / (4 * K)), jnp.arccos(-1 / (4 * K))])
    for derivative in (jax.jacrev, jax.hessian):
        edge, place = derivative(found)(0.6) / derivative(exact)(0.6) - 1
        assert abs(edge) < 1e-12 and abs(place) < 1e-6


def in_a_row(stiffness):
    bond = Bond(Stretch(Shift(1, "periodic"), (1.0, 0.0, 0.0)), Linear(stiffness))
    return Lattice(1.0, bond, sites=6, dimension=3)


@pytest.mark.slow
def test_close_levels_of_single_precision_are_not_taken_for_equal():
    def size(m, kind):
        masses = jnp.ones(150, kind).at[40].set(m)
        bond = gx.Bond(gx.Shift(1, "fixed"), gx.Linear(jnp.asarray(1.0, kind)))
        return jnp.abs(gx.linear.normal_modes(gx.Lattice(masses, bond)).modes[10, 0])

    single, double = (
        jax.grad(size)(jnp.asarray(1.3, kind), kind) for kind in (jnp.float32, jnp.float64)
    )
    assert single.dtype == jnp.float32
    assert_allclose(single, double, rtol=0.05)


@pytest.mark.slow
@pytest.mark.parametrize(
    "level",
    [
        lambda F: linear.bands(triangular(F)).upper[1],
        lambda F: linear.dispersion(triangular(F), [(0.0, 0.0), (np.pi, 0.0)]).omega[1, 1],
        lambda F: linear.normal_modes(in_a_row(1.5 - F / 2)).omega[-1],
        lambda F: linear.sound_speed(in_a_row(6 - 2 * F))[2],
    ],
    ids=["edge", "wave", "mode", "sound"],
)
def test_degenerate_levels_leave_the_second_derivatives_of_others_alone(level):
    # at M the upper band of a triangular lattice has omega^2 = 6 K - 2 F; a ring has 4 K
    assert_allclose(jax.jacrev(jax.jacrev(level))(0.1), -(5.8**-1.5), rtol=1e-10)


@pytest.mark.slow
@pytest.mark.parametrize("inner", [jax.jacfwd, jax.jacrev])
@pytest.mark.parametrize("outer", [jax.jacfwd, jax.jacrev])
def test_second_derivatives_of_frequencies_that_a_parameter_splits_are_nan(inner, outer):
    # bonds of their own split the pairs of a ring, not its highest mode
    omega = lambda K: linear.normal_modes(springs(np.ones(6), K, "periodic")).omega
    K = jnp.ones(6)
    slopes = outer(inner(omega))(K)
    h = 1e-3
    step = np.zeros(6)
    step[0] = h
    middle = (omega(K + step) - 2 * omega(K) + omega(K - step))[-1] / h**2
    assert_allclose(slopes[-1, 0, 0], middle, rtol=1e-5)
    assert np.isfinite(slopes[-1]).all() and np.isnan(slopes[1:3]).all()
    # all bonds together split none: omega_j is proportional to sqrt(K)
    together = outer(inner(lambda x: omega(x * K)))(1.0)
    assert_allclose(together[1:], -omega(K)[1:] / 4, rtol=1e-12)


@pytest.mark.slow
def test_bands_that_touch_leave_the_second_derivatives_of_others_alone():
    def edges(x):
        # omega^2 = 2 at k = pi, where x opens a gap; the highest edge is sqrt(4 + 2 x)
        found = linear.bands(springs(np.ones(12), 1 + x * jnp.array([1.0, 0.0] * 6), "periodic"))
        return jnp.concatenate([found.lower, found.upper])

    for outer in (jax.jacfwd, jax.jacrev):
        low, *touching, high = outer(jax.jacrev(edges))(0.0)
        assert abs(low) < 1e-12 and np.isnan(touching).all() and abs(high + 0.125) < 1e-12


@pytest.mark.slow
def test_normal_modes_are_normalised_and_differentiable():
    chain = random_cells("fixed")
    modes = linear.normal_modes(chain).modes
    assert_allclose(modes.T @ (chain.mass[:, None] * modes), np.eye(20), atol=1e-13)
    # fixed ends, equal springs: omega_j = 2 sin(j pi/(2 (N + 1)))
    omega = lambda K: linear.normal_modes(springs(np.ones(9), K)).omega
    equal = 2 * np.sin(np.arange(1, 10) * np.pi / 20)
    assert_allclose(omega(1.0), equal, rtol=1e-13)
    # d omega_j/dK = omega_j/(2 K) for all springs together
    assert_allclose(jax.jacrev(omega)(1.0), equal / 2, rtol=1e-12)
    # a ring has pairs of equal frequencies; the sum over each pair is still smooth
    ring = lambda K: linear.normal_modes(springs(np.ones(8), K, "periodic")).omega.sum()
    assert_allclose(jax.grad(ring)(1.0), np.sin(np.arange(8) * np.pi / 8).sum(), rtol=1e-12)
    parts = linear.normal_modes(mass_in_mass()).modes
    assert parts["bead"].shape == parts["core"].shape == (12, 24)


@pytest.mark.slow
def test_the_lowest_modes_by_the_sparse_matrix_are_those_of_the_dense_one():
    mass = np.random.default_rng(4).uniform(0.5, 2, (6, 5))
    crystal = lambda K: gx.scenes.triangular(6, 5, mass=mass, stiffness=K, boundary="periodic")
    every = linear.normal_modes(crystal(1.3))
    found = linear.normal_modes(crystal(1.3), 6)
    assert_allclose(found.omega_squared, every.omega_squared[:6], rtol=0, atol=1e-13)
    assert found.modes.shape == (6, 5, 2, 6) and np.sum(found.omega == 0) == 2
    gram = np.einsum("nmda,nm,nmdb->ab", found.modes, mass, found.modes)
    assert_allclose(gram, np.eye(6), atol=1e-12)
    third = lambda K: linear.normal_modes(crystal(K), 6).omega[2]
    assert jax.grad(third)(1.3) == pytest.approx(float(found.omega[2]) / 2.6, rel=1e-12)
    with refused("count: expected None where masses or laws are traced"):
        jax.jit(third)(1.3)


@pytest.mark.parametrize("count", [20, 76, 374])
def test_lowest_modes_of_equal_frequency_are_all_found(count):
    """The rows of a cube of central springs are free of each other: each frequency comes 75 times."""
    one = 4 * np.sin(np.arange(1, 6) * np.pi / 12) ** 2
    found = linear.normal_modes(gx.scenes.cubic(5), count=count)
    assert_allclose(found.omega_squared, np.repeat(one, 75)[:count], rtol=0, atol=1e-13)
    modes = found.modes.reshape(375, count)
    assert_allclose(modes.T @ modes, np.eye(count), atol=1e-12)


@pytest.mark.slow
def test_the_lowest_modes_have_one_derivative_and_refuse_the_second():
    """SSH: the derivative is that of the dense matrix, which has the second too."""

    def third(K, count):
        return linear.normal_modes(gx.scenes.ssh(6, 1.0, K), count=count).omega[2]

    slope = jax.grad(third)
    assert_allclose(slope(2.0, 4), slope(2.0, None), rtol=1e-10)
    for outer in (jax.grad, jax.jacfwd):
        with refused("count: expected None for second derivatives, got 4. Leave it out."):
            outer(slope)(2.0, 4)


# ------------------------------------------------------------------------------------------------ gyroscopes, damping


class OneWay(Term):
    """A push that is not returned."""

    def force(self, t, u, v, mass):
        return 0.1 * jnp.roll(u, 1)


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


def gyroscopic(rate=0.7, odd=0.0):
    return with_term(triangular(), Turning(jnp.asarray(rate), odd))


def test_a_fine_mesh_is_one_loop_of_eigenproblems():
    """A remainder beside the loop may deadlock with it: 40 000 points of kagome never came back."""
    D = jnp.linspace(0, 1, 7)[:, None, None] * jnp.array([[2.0, 1.0], [1.0, 3.0]])
    roots = lambda D: stiffness.each(jnp.linalg.eigvalsh, D, 3)
    assert str(jax.make_jaxpr(roots)(D)).count("= eigh") == 1
    assert_allclose(roots(D), np.linalg.eigvalsh(D), rtol=0, atol=1e-15)
    # d(sum of roots)/dD is the unit matrix, of the last row too
    assert_allclose(jax.grad(lambda D: roots(D).sum())(D)[1:], [np.eye(2)] * 6, rtol=0, atol=1e-15)


TURN = np.array([[0, -1], [1, 0]])
# two directions, and against each
WAYS = np.array([[1.0, 0.0], [-1.0, 0.0], [0.3, 0.8], [-0.3, -0.8]])


def quadratic(D, G):
    """The positive frequencies of q'' = -D q - G q', rising, and q, by the companion matrix."""
    size = len(D)
    values, vectors = np.linalg.eig(np.block([[np.zeros_like(D), np.eye(size)], [-D, -G]]))
    order = np.argsort(-values.imag)[size:]
    assert np.abs(values.real).max() < 1e-12
    return -values.imag[order], vectors[:size, order]


def test_simple_bands_of_a_gyroscopic_lattice_have_a_curvature_where_all_velocities_vanish():
    found = linear.dispersion(gyroscopic(0.3), np.array([[np.pi, 0.0]]))
    h = 1e-4
    beside = np.array([[np.pi - h, 0.0], [np.pi + h, 0.0]])
    below, above = np.asarray(linear.dispersion(gyroscopic(0.3), beside).omega)
    here = np.asarray(found.omega[0])
    assert_allclose(found.group_velocity[0], 0, atol=1e-14)
    assert_allclose(found.curvature[0][:, 0, 0], (below - 2 * here + above) / h**2, rtol=1e-6)


@pytest.mark.slow
def test_the_waves_of_a_gyroscopic_lattice_by_the_quadratic_eigenproblem():
    """(D(k) - i omega G) q = omega^2 q, G = 0.7 (0, -1; 1, 0) - 2 i 0.2 sin k_1."""
    k = np.array([[np.pi / 3, 2 * np.pi / 3], [1.0, -0.4]])
    ways = {(1, 0): (1.0, 0.0), (0, 1): (0.5, 3**0.5 / 2), (-1, 1): (-0.5, 3**0.5 / 2)}
    lattice = gyroscopic(odd=0.2)
    found = linear.dispersion(lattice, k)
    bands = linear.floquet_bands(lattice, k, period=0.5)

    def exact(x):
        D = sum(2 * (1 - np.cos(np.dot(x, R))) * np.outer(n, n) for R, n in ways.items())
        return quadratic(D, 0.7 * TURN - 0.4j * np.sin(x[0]) * np.eye(2))

    for i, x in enumerate(k):
        omega, vectors = exact(x)
        assert_allclose(found.omega[i], omega, rtol=1e-12)
        assert_allclose(np.sort(bands.omega[i])[2:], omega, rtol=1e-9)
        q = found.vectors[i].reshape(2, 2)
        aligned = np.abs((q.conj() * vectors).sum(0)) / np.linalg.norm(vectors, axis=0)
        assert_allclose(aligned, 1, rtol=1e-12)
        moved = lambda way: exact(x + way)[0]
        h = 1e-3 * np.eye(2)
        slope = [(moved(a) - moved(-a)) / 2e-3 for a in h]
        assert_allclose(found.group_velocity[i].T, slope, atol=1e-6)
        bend = [
            [(moved(a + b) - moved(a - b) - moved(b - a) + moved(-a - b)) / 4e-6 for b in h]
            for a in h
        ]
        assert_allclose(np.moveaxis(found.curvature[i], 0, -1), bend, atol=1e-5)
    assert_allclose(linear.dispersion(lattice, [0.0, 0.0]).omega, [0, 0.7], atol=1e-12)


@pytest.mark.slow
def test_the_speed_of_sound_among_gyroscopes_is_that_of_long_waves():
    """Two masses with gyroscopes of opposite senses, and odd forces: along a direction and against it."""
    mass = np.resize([[1.0], [0.4]], (6, 1)) * np.ones(6)
    crystal = gx.scenes.triangular(6, 6, boundary="periodic", mass=mass)
    sense = jnp.resize(jnp.array([1.0, -1.0]), (6, 1, 1))
    lattice = lambda rate: with_term(crystal, Turning(rate * sense, 0.2))
    for way in WAYS:
        found = linear.sound_speed(lattice(0.5), direction=way)
        # per cell of two sites along the first axis
        slow = linear.dispersion(lattice(0.5), 1e-3 * way * [2, 1]).omega[:2] / 1e-3
        assert_allclose(found, slow, rtol=1e-6)
    speed = lambda r: linear.sound_speed(lattice(r), cell=(2, 1), direction=way)
    has_derivatives(speed, 0.5, rtol=1e-7)
    assert_allclose(jax.vmap(speed)(jnp.array([0.2, 0.5]))[1], speed(0.5), rtol=1e-12)


class Opposed(Term):
    """Gyroscopes of opposite senses on two fields."""

    rate: float

    def force(self, t, u, v, mass):
        turned = {name: jnp.stack([x[..., 1], -x[..., 0]], -1) for name, x in v.items()}
        return {"a": self.rate * turned["a"], "b": -self.rate * turned["b"]}


@pytest.mark.slow
def test_sound_among_gyroscopes_on_sites_without_inversion():
    """Honeycomb bonds and some between sites of one kind: no site is a centre of the others."""
    comb = gx.scenes.plane.cells.HONEYCOMB
    more = (gx.scenes.Tie("a", "a", offset) for offset in ((1, 0), (0, 1), (-1, 1)))
    cell = comb._replace(ties=(*comb.ties, *more))
    crystal = gx.scenes.crystal(
        cell,
        5,
        stiffness=(1.0, 0.6, 1.3, 0.5, 0.5, 0.5),
        mass={"a": 1.0, "b": 0.4},
        boundary="periodic",
    )
    lattice = with_term(crystal, Opposed(jnp.asarray(0.7)))
    for way in WAYS:
        slow = linear.dispersion(lattice, 1e-3 * way).omega[:2] / 1e-3
        assert_allclose(linear.sound_speed(lattice, direction=way), slow, rtol=1e-6)


def has_derivatives(function, at, rtol, modes=(jax.jacfwd, jax.jacrev)):
    slope = (function(at + 1e-5) - function(at - 1e-5)) / 2e-5
    for derivative in modes:
        assert_allclose(derivative(function)(at), slope, rtol=rtol)


@pytest.mark.slow
def test_gyroscopic_modes_and_bands_are_traced_and_batched():
    omega = lambda r: linear.dispersion(gyroscopic(r), K_POINT, cell=(1, 1)).omega
    rates = jnp.array([0.1, 0.7])
    assert_allclose(jax.vmap(omega)(rates), [omega(r) for r in rates], rtol=1e-12)
    has_derivatives(omega, 0.7, rtol=1e-8)
    has_derivatives(lambda r: linear.bands(gyroscopic(r)).upper[-1], 0.7, 1e-7, (jax.grad,))


@pytest.mark.slow
def test_the_modes_of_a_finite_gyroscopic_lattice():
    still = gx.scenes.triangular(3, 3, boundary="fixed", mass=2.0)
    plain = linear.normal_modes(still)
    phi = np.asarray(plain.modes).reshape(18, 18)
    D = 2 * phi @ np.diag(plain.omega_squared) @ phi.T
    omega, _ = quadratic(D, np.kron(np.eye(9), 0.35 * TURN))
    found = linear.normal_modes(with_term(still, Turning(jnp.asarray(0.7))))
    assert_allclose(found.omega, omega, rtol=1e-10)
    assert found.omega.shape == (18,) and jnp.iscomplexobj(found.modes)


@pytest.mark.slow
@pytest.mark.parametrize(
    "term",
    [
        Matrix(jnp.array([[0.3, 0.1], [0.1, 0.2]])),
        Dashpot(Stretch(Shift((1, 0), "periodic"), np.array([1.0, 0.0])), 0.3),
    ],
)
def test_damping_leaves_the_undamped_frequencies(term):
    plain = triangular()
    damped = with_term(plain, term)
    waves = [linear.dispersion(x, WAVES[:2]).omega for x in (plain, damped)]
    modes = [linear.normal_modes(x).omega for x in (plain, damped)]
    assert np.array_equal(*waves) and np.array_equal(*modes)
    # in jit too, where a matrix may be any, so that the gyroscopic form is taken
    traced = jax.jit(lambda x: linear.normal_modes(x).omega)
    assert np.abs(traced(damped) - modes[0]).max() < 1e-12


@pytest.mark.parametrize("field", ["bead", "resonator", None])
def test_complex_bands_with_a_memory_in_one_field(field):
    """Eliminating the resonator: cos k = 1 + (z_a + k_r - omega^2 m_a - k_r^2/d)/(2 K2)."""
    omega = 0.7
    c = 0.3
    held = 0.8
    chain = Bond(Shift(1, "periodic", ("bead", "bead")), gx.Linear(1.2))
    tie = Bond(Shift(0, "free", ("bead", "resonator")), gx.Linear(held))
    mass = {"bead": jnp.ones(4), "resonator": jnp.full(4, 0.5)}
    lattice = Lattice(mass, (chain, tie, gx.CaputoDamping(c, 0.4, field)))
    lag = c * (-1j * omega) ** 0.4
    a, b = (lag if field in (name, None) else 0 for name in ("bead", "resonator"))
    want = 1 + (a + held - omega**2 - held**2 / (held - 0.5 * omega**2 + b)) / 2.4
    assert_allclose(np.cos(linear.complex_bands(lattice, omega).k), [[want] * 2], rtol=1e-12)


def test_complex_bands_follow_all_that_damps():
    """A wave exp(i k n - i omega t) with the k that is found leaves nothing of the equation of motion."""
    omega = np.array([0.4, 1.3])
    mass = np.array([1.0, 2.0] * 6)
    bonds = (Bond(Shift(1), Linear(1.0)), Bond(Shift(2), Linear(0.2)))
    damped = (Damping(0.1), Dashpot(Shift(1), 0.05), gx.CaputoDamping(0.2, 0.4))
    found = linear.complex_bands(Lattice(mass, (*bonds, *damped)), omega)
    assert found.cell == (2,) and found.k.shape == (2, 4) and found.residual.max() < 1e-13
    for w, waves in zip(omega, found.k):
        for k in waves:
            z = np.exp(1j * k / 2)
            near = 1 - 1j * w * 0.05
            far = 0.2
            own = 2 * near + 2 * far + 0.2 * (-1j * w) ** 0.4 - far * (z**2 + z**-2)
            D = np.full((2, 2), -near * (z + 1 / z))
            D[[0, 1], [0, 1]] = own - np.array([1.0, 2.0]) * w * (w + 0.1j)
            assert abs(np.linalg.det(D)) < 1e-11 * np.abs(D).max() ** 2
    undamped, weak = (
        linear.complex_bands(Lattice(mass, (*bonds, *own)), omega)
        for own in ((), (gx.CaputoDamping(1e-6, 0.4),))
    )
    assert_allclose(np.exp(1j * weak.k), np.exp(1j * undamped.k), rtol=1e-4)


def test_complex_bands_of_a_gyroscopic_lattice_hold_its_dispersion():
    lattice = gyroscopic()
    omega = linear.dispersion(lattice, [1.1, 0.0]).omega
    found = linear.complex_bands(lattice, omega, axis=0, across=0.0)
    assert np.abs(found.k - 1.1).min(1).max() < 1e-8


# -------------------------------------------------------------------------------------------------- words, refusals


@pytest.mark.parametrize("axis", [0, -1])
def test_a_batch_says_how_many_modes_and_bands_each_lane_has(axis):
    def found(ratio):
        ring = dimer(6, ratio=ratio, precompression=1.0, boundary="periodic")
        return linear.normal_modes(ring), linear.bands(ring, cell=2)

    modes, bands = jax.vmap(found, out_axes=axis)(jnp.array([0.3, 0.5, 0.7]))
    assert modes.outcome.startswith("6 modes in each of 3 lanes, up to 3.6")
    assert bands.outcome == "2 bands in each of 3 lanes, cell of 2 sites."


@pytest.mark.slow
def test_gyroscopic_lattices_without_a_minimum_say_that_no_modes_and_bands_are_given():
    def held(rate, stiffness=-0.1):
        bond = Bond(Stretch(Shift(1, "periodic"), (1.0, 0.0)), Linear())
        terms = bond, OnSite(Linear(stiffness)), Turning(jnp.asarray(rate))
        return Lattice(1.0, terms, sites=3, dimension=2)

    modes = linear.normal_modes(held(2.0))
    bands = linear.bands(held(2.0))
    why = "are given: the lattice is not stable at rest"
    assert np.isnan(modes.omega).all() and modes.outcome.startswith(f"No modes {why}")
    assert bands.outcome.startswith(f"No bands {why}") and "nan" not in repr(bands)
    waves = linear.dispersion(held(2.0), np.linspace(0, np.pi, 5))
    assert waves.outcome.startswith(f"No bands {why}")
    with refused(f"No modes {why}"):
        gx.states.normal_mode(held(2.0), 0)
    found = lambda x: (linear.normal_modes(held(2.0, x)), linear.bands(held(2.0, x), cell=1))
    modes, bands = jax.vmap(found, out_axes=-1)(jnp.array([-0.1, 0.1, 0.2]))
    assert modes.outcome.startswith(f"No modes in 1 of 3 lanes {why}")
    assert bands.outcome.startswith(f"No bands in 1 of 3 lanes {why}")
    assert linear.normal_modes(held(2.0, 0.1)).outcome.startswith("6 modes up to 2.")


RING = springs(np.ones(12), 1.0, "periodic")
HALL = Hall(jnp.asarray(1e-3))
DISORDER = springs(np.random.default_rng(2).uniform(1, 2, 20))
BATCH = jax.vmap(lambda r: dimer(8, ratio=r, precompression=1.0), out_axes=-1)(
    jnp.array([0.3, 0.5])
)
MODULATED = Lattice(np.ones(8), Modulated(Bond(Shift(1), Linear(1.0)), Function(jnp.cos)))
DEFECT = springs(np.where(np.arange(12) == 0, 2.0, 1.0), 1.0, "periodic")

REFUSALS = {
    r"\(Turning\).*gyroscopic.*floquet_bands": lambda: linear.flat_bands(gyroscopic()),
    r"Turning\).*gyroscopic": lambda: topology.winding(gyroscopic()),
    r"Turning.*gyroscopic": lambda: linear.normal_modes(gyroscopic(), 3),
    r"\(Hall\).*gyroscopic": lambda: linear.dispersion(with_term(RING, HALL), 1.0),
    r"Hall.*gyroscopic": lambda: topology.zak(with_term(RING, HALL)),
    "None of a chain.* with 3 axes": lambda: topology.zak(
        Lattice(1.0, Bond(Shift((1, 0, 0), "periodic"), Linear(1.0)), sites=(4, 4, 4))
    ),
    "turn a uniform motion": lambda: linear.sound_speed(gyroscopic()),
    "repeats along axis 0.*normal_modes": lambda: linear.dispersion(DISORDER, 1.0),
    "repeats along axis 0": lambda: linear.bands(DEFECT),
    "in_axes=-1": lambda: linear.bands(BATCH),
    "constant in time": lambda: linear.normal_modes(MODULATED),
    "a period of the lattice.*got 3": lambda: linear.dispersion(two_masses(), 1.0, cell=3),
    "a divisor of 12": lambda: linear.dispersion(two_masses(12, "periodic"), 1.0, cell=5),
    "at most 10": lambda: linear.dispersion(two_masses(12), 1.0, cell=11),
    "at least 5 sites": lambda: linear.dispersion(next_nearest(sites=4), 1.0),
    "k: expected a last axis of length 2": lambda: linear.dispersion(triangular(), 1.0),
    "cell: .*traced": lambda: jax.jit(lambda r: linear.bands(dimer(9, ratio=r)).upper)(0.5),
    "sonic vacuum.*precompression > 0": lambda: linear.sound_speed(monomer(9)),
    "no acoustic band": lambda: linear.sound_speed(
        mass_in_mass("fixed", OnSite(Linear(0.5), "bead"))
    ),
    "held together": lambda: linear.sound_speed(springs(np.ones(8), np.resize([1.0, 0.0, 0.0], 9))),
    "too few": lambda: linear.sound_speed(gx.scenes.kagome(4, boundary="periodic")),
    "direction: expected 2 numbers": lambda: linear.sound_speed(triangular(), direction=(1.0,)),
    "axis: expected .* -2 ... 1, got 2": lambda: linear.complex_bands(triangular(), [1.0], axis=2),
    "across: expected one number, got shape": lambda: linear.complex_bands(
        triangular(), [1.0], across=[0.1, 0.2]
    ),
    "symmetric": lambda: linear.normal_modes(with_term(RING, OneWay())),
}


@pytest.mark.parametrize(
    "masses", [[1, 1, 1], [1, 2, 1, 2], [1, 2, 1, 2, 1], np.where(np.arange(13) == 6, 2, 1)]
)
def test_fewer_than_two_cells_are_no_period(masses):
    # what stands off the ends; with a defect in the middle both halves of a chain are alike
    with refused("repeats along axis 0"):
        linear.bands(springs(masses))


@pytest.mark.slow
@pytest.mark.parametrize("words", REFUSALS)
def test_what_has_no_linear_theory_is_refused(words):
    with refused(words):
        REFUSALS[words]()
