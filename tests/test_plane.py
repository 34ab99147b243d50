"""Lattices of the plane by name: bands against closed forms, momenta, walls, outlines, beads that turn."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import xarray as xr
from cases import ended
from numpy.testing import assert_allclose
from refusals import refused
from scipy import ndimage
from scipy.integrate import solve_ivp

import granjax as gx
from granjax import scenes
from granjax.flow.remarks import passing
from granjax.flow.steps import frequency_bound

K, M = np.array([2 * np.pi / 3, 4 * np.pi / 3]), np.array([np.pi, 0.0])
RNG = np.random.default_rng(7)
PHASES = RNG.uniform(-np.pi, np.pi, (5, 2))


def squares(lattice, k):
    return np.asarray(gx.linear.dispersion(lattice, k).omega_squared)


@pytest.mark.parametrize("f", [0.0, 0.1])
def test_the_triangular_lattice_at_its_points(f):
    crystal = scenes.triangular(8, 8, precompression=f, boundary="periodic")
    found = squares(crystal, np.stack([K, M]))
    assert np.abs(found - [[4.5 * (1 - f)] * 2, [2 - 6 * f, 6 - 2 * f]]).max() < 1e-12


def test_flat_and_dirac_bands_out_of_plane():
    c = np.cos(PHASES / 2)
    honey = squares(
        scenes.honeycomb(6, out_of_plane=True, boundary="periodic"),
        np.concatenate([PHASES, K[None]]),
    )
    h = np.abs(1 + np.exp(1j * PHASES[:, 0]) + np.exp(1j * PHASES[:, 1]))
    assert (
        np.abs(honey[:-1] - np.stack([3 - h, 3 + h], -1)).max() < 1e-12
        and np.abs(honey[-1] - 3).max() < 1e-12
    )
    lieb = squares(scenes.lieb(6, boundary="periodic", ground=0.3), PHASES)
    wide = 2 * np.sqrt((c**2).sum(1))
    assert np.abs(lieb - 4.3 - np.stack([-wide, 0 * wide, wide], -1)).max() < 1e-12
    kagome = squares(scenes.kagome(6, out_of_plane=True, boundary="periodic"), PHASES)
    root = np.sqrt(4 * ((c**2).sum(1) + np.cos((PHASES[:, 0] - PHASES[:, 1]) / 2) ** 2) - 3)
    assert np.abs(kagome - 4 + np.stack([1 + root, 1 - root, -2 + 0 * root], -1)).max() < 1e-12


def test_chains_with_flat_bands():
    k = PHASES[:, 0]
    flat = np.zeros_like(k)
    sums, bands = (
        {
            "sawtooth": (2 + 2 * 2**0.5, (flat - 2, 2 + 2 * np.cos(k))),
            "stub": (3.0, (flat, np.sqrt(3 + 2 * np.cos(k)))),
            "diamond": (4.0, (flat, 8**0.5 * np.cos(k / 2))),
        },
        {},
    )
    for name, (most, (still, wide)) in sums.items():
        bands[name] = squares(getattr(scenes, name)(9, ground=0.2), k)
        other = [] if name == "sawtooth" else [-wide]
        want = np.sort(most + 0.2 - np.stack([still, wide, *other], -1), -1)
        assert np.abs(bands[name] - want).max() < 1e-12
    uneven = squares(scenes.stub(9, equal=False), k)
    assert np.ptp(uneven, axis=0).min() > 0.1


def hexagonal_matrix(k, K2, f, kt, inertia):
    """Triangular packing of beads that turn, by hand: of each line of contacts K2 n n - f t t, and the slip's kt."""
    D = np.zeros((3, 3), complex)
    for angle, phase in ((0.0, k[0]), (np.pi / 3, k[1]), (2 * np.pi / 3, k[1] - k[0])):
        n, t = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
        normal, sideways = np.append(n, 0), np.append(t, 0)
        spin = np.array([0, 0, 1.0])
        c = np.cos(phase)
        D += 2 * (1 - c) * (K2 * np.outer(normal, normal) - f * np.outer(sideways, sideways))
        # slip = s_1 + s_2 - t . (u_2 - u_1): the sum over both contacts along this line
        tail, head = spin + sideways, np.exp(1j * phase) * (spin - sideways)
        row = tail + head
        D += kt * np.outer(row.conj(), row)
    scale = 1 / np.sqrt(np.array([1, 1, inertia]))
    return scale[:, None] * D * scale


def test_bands_of_beads_that_turn_against_a_matrix_by_hand():
    A, F0, kt = 1.3, 0.2, 0.7
    crystal = scenes.triangular(
        7,
        7,
        stiffness=A,
        exponent=1.5,
        precompression=F0,
        rotation=True,
        tangential=kt,
        boundary="periodic",
    )
    K2 = 1.5 * A ** (2 / 3) * F0 ** (1 / 3)
    for k in (0 * K, K, PHASES[0]):
        want = np.linalg.eigvalsh(hexagonal_matrix(k, K2, F0, kt, 0.4))
        assert np.abs(squares(crystal, k) - want).max() < 1e-12 * 20


def turned(x, angle, radius=0.5):
    """Displacements of a rigid rotation of places (N, 2) of beads, which turn with it."""
    c, s = np.cos(angle), np.sin(angle)
    spin = np.full((len(x), 1), radius * angle)
    return np.concatenate([x @ np.array([[c, s], [-s, c]]) - x, spin], 1)


def angular_momenta(lattice, run, radius):
    """sum m r x v + m_theta R s' of each frame."""
    p = np.asarray(lattice.mass * run.vs)
    r = np.asarray(lattice.positions + run.us[..., :2])
    return (r[..., 0] * p[..., 1] - r[..., 1] * p[..., 0] + radius * p[..., 2]).sum(-1)


@pytest.mark.slow
def test_beads_that_turn_keep_both_momenta_and_a_rigid_rotation_costs_nothing():
    crystal = scenes.hexagon(2, rotation=True, tangential=0.3, boundary="free")
    v = 0.1 * RNG.normal(size=crystal.shape)
    run = gx.simulate(
        crystal, gx.State(crystal.zeros(), v), 10.0, solver=gx.SRKN11b(), step=0.05, save_at=3
    )
    turning = angular_momenta(crystal, run, 0.5)
    assert np.ptp(turning) < 1e-13 and abs(turning[0]) > 0.1
    assert np.ptp(np.asarray(run.vs)[..., :2].sum(1), axis=0).max() < 1e-13
    assert float(run.energy_error) < 1e-8
    u = turned(np.asarray(crystal.positions), 0.7)
    assert float(crystal.potential_energy(0.0, u)) < 1e-28
    assert float(jnp.abs(crystal.force(0.0, u, 0 * u)).max()) < 1e-14


@pytest.mark.slow
def test_a_struck_hexagon_against_an_independent_integration():
    crystal = scenes.hexagon(4, exponent=1.5)
    assert crystal.shape == (61, 2)
    x = np.asarray(crystal.positions)
    assert (
        np.abs(np.sort(np.linalg.norm(x - x[30], axis=1))[:7] - [0, 1, 1, 1, 1, 1, 1]).max() < 1e-12
    )
    # beads at rest all around
    ring = [np.array([i + j / 2, j * 0.75**0.5]) for i in range(-6, 7) for j in range(-6, 7)]
    every = np.concatenate(
        [x, [p + x[30] for p in ring if np.linalg.norm(p + x[30] - x, axis=1).min() > 1e-6]]
    )

    apart = np.linalg.norm(x[:, None] - every, axis=-1)
    own, other = np.nonzero((apart > 0.5) & (apart < 1.5))
    assert len(own) == 6 * 61

    def rhs(t, y):
        at = every.copy()
        at[:61] += y[:122].reshape(61, 2)
        D = at[own] - at[other]
        length = np.sqrt((D * D).sum(-1))
        pull = np.zeros((61, 2))
        np.add.at(pull, own, (np.maximum(1 - length, 0) ** 1.5 / length)[:, None] * D)
        return np.concatenate([y[122:], pull.ravel()])

    y0 = np.zeros(244)
    y0[122 + 60 : 122 + 62] = 0.1, 0.03
    far = ended(rhs, 12.0, y0)
    run = gx.simulate(
        crystal, gx.states.impact(crystal, [0.1, 0.03], site=30), 12.0, tolerance=1e-11
    )
    assert np.abs(np.asarray(run.final.u).ravel() - far[:122]).max() < 1e-9
    assert np.abs(far[:122]).max() > 0.03


@pytest.mark.slow
def test_a_planar_front_in_the_square_lattice_is_a_chain():
    square = scenes.square(20, 3, exponent=1.5, boundary=("fixed", "periodic"))
    chain = scenes.monomer(20)
    v = np.zeros(square.shape)
    v[0, :, 0] = 0.2
    flat = gx.simulate(square, gx.State(square.zeros(), v), 20.0, step=0.05)
    line = gx.simulate(chain, gx.states.impact(chain, 0.2), 20.0, step=0.05)
    assert (
        np.abs(np.asarray(flat.final.u)[..., 0] - np.asarray(line.final.u)[:, None]).max() < 1e-12
    )
    assert np.abs(np.asarray(flat.final.u)[..., 1]).max() == 0


def test_outlines():
    rows = scenes.triangular(5, 4, outline="rectangle", boundary="free")
    x = np.asarray(rows.positions)
    assert len(x) == 20 and np.ptp(x[:, 0]) == 4.5 and abs(np.ptp(x[:, 1]) - 3 * 0.75**0.5) < 1e-12
    disk = scenes.honeycomb(
        9, outline=lambda p: np.hypot(p[..., 0] - 11, p[..., 1] - 6) < 4.1, out_of_plane=True
    )
    assert disk.shape["a"] != (9, 9) and abs(disk.shape["a"][0] - disk.shape["b"][0]) < 6
    modes = np.asarray(gx.linear.normal_modes(disk).omega_squared)
    assert modes[0] > 0 and modes[-1] < 6
    for wrong, words in (
        (dict(outline="hexagon"), "cells are square"),
        (dict(tangential=1.0), "tangential"),
    ):
        with refused(words):
            scenes.square(4, **wrong)


@pytest.mark.slow
def test_lanes_and_derivatives():
    make = lambda f: scenes.triangular(4, 4, precompression=f, boundary="periodic", spacing=1.0)
    batch = jax.vmap(make, out_axes=-1)(jnp.array([0.02, 0.1]))
    assert batch.lanes == (2,)
    u = 0.01 * RNG.normal(size=(4, 4, 2))
    both = batch.force(0.0, jnp.stack([u, u], -1), jnp.zeros((4, 4, 2, 2)))
    for i, f in enumerate((0.02, 0.1)):
        assert np.abs(both[..., i] - make(f).force(0.0, u, 0 * u)).max() < 1e-15
    at_K = lambda f: gx.linear.dispersion(
        scenes.triangular(6, 6, precompression=f, boundary="periodic"), K
    )
    slope = jax.grad(lambda f: at_K(f).omega_squared.sum())(0.1)
    assert abs(slope + 9) < 1e-9


@pytest.mark.slow
def test_forces_between_beads_and_what_slips():
    crystal = scenes.hexagon(1, precompression=0.5, rotation=True, tangential=0.4, boundary="free")
    network = gx.measures.force_network(crystal, gx.states.rest(crystal))
    assert network.segments.shape == (12, 2, 2) and np.abs(network.force - 0.5).max() < 1e-15
    assert (
        np.abs(np.linalg.norm(network.segments[:, 1] - network.segments[:, 0], axis=-1) - 1).max()
        < 1e-14
    )
    u = np.zeros(crystal.shape)
    u[3, 2] = 0.25
    assert (
        abs(float(gx.measures.slip_ratio(crystal, gx.State(u, 0 * u))) - 0.4 * 0.25 / 0.5) < 1e-14
    )
    with refused("rotation=True"):
        gx.measures.slip_ratio(scenes.square(3), gx.states.rest(scenes.square(3)))


@pytest.mark.study
def test_two_equal_branches_are_one_chain():
    fork = scenes.junction(6, (9, 9))
    mass, A = np.r_[np.ones(6), 2 * np.ones(9)], np.r_[np.ones(6), 2 * np.ones(10)]
    chain = scenes.monomer(15, mass=mass, stiffness=A)
    runs = [gx.simulate(x, gx.states.impact(x, 0.3), 25.0, step=0.05) for x in (fork, chain)]
    both, one = (np.asarray(run.final.u) for run in runs)
    assert (
        np.abs(both[:15] - one).max() < 1e-12
        and np.abs(both[15:] - one[6:]).max() < 1e-12
        and one[12] > 1e-3
    )
    turned = scenes.junction(6, (9, 9), angles=(0.4, -0.4))
    run = gx.simulate(turned, gx.states.impact(turned, 0.3), 25.0, step=0.05, save_at=2)
    assert float(run.energy_error) < 1e-6 and np.abs(np.asarray(run.final.u)[12] - one[12]) > 1e-3
    with refused("backwards"):
        scenes.junction(6, (9,), angles=(1.6,))


def test_a_packing_of_steel_beads():
    crystal = scenes.packing("steel 316", 5e-3, 7, 7, 30.0, boundary="periodic", rotation=True)
    body = gx.materials.material("steel 316")
    A, nu = float(gx.materials.hertz_coefficient(body, 5e-3)), float(body.poisson)
    K2 = 1.5 * A ** (2 / 3) * 30.0 ** (1 / 3)
    m = float(gx.materials.bead_mass(body, 5e-3))
    want = (
        np.linalg.eigvalsh(hexagonal_matrix(K, K2, 30.0 / 1e-2, 2 * (1 - nu) / (2 - nu) * K2, 0.4))
        / m
    )
    assert np.abs(squares(crystal, K) / want - 1).max() < 1e-11 and crystal.units == "SI"
    with refused("slide"):
        scenes.packing("steel 316", 5e-3, 7, rotation=True)


@pytest.mark.study
def test_a_front_is_a_solitary_wave_in_a_row_of_a_square_and_spreads_in_a_hexagon():
    speed = lambda t, y, lattice: jnp.linalg.norm(y.v, axis=-1)

    def decay(crystal, site, until, **options):
        run = gx.simulate(
            crystal,
            gx.states.impact(crystal, [0.3, 0.0], site=site),
            until,
            record={"peak": gx.Peak(speed)},
        )
        return gx.measures.front_decay(crystal, run.recorded["peak"], site, **options)

    # a row in touch with its neighbours alone, past the first beads
    row = decay(
        scenes.square(25, exponent=1.5), (2, 12), 40.0, direction=[1.0, 0.0], between=(5.0, 18.0)
    )
    assert abs(float(row.exponent)) < 0.01
    hexagon = scenes.hexagon(14, exponent=1.5)
    ring = decay(hexagon, hexagon.shape[0] // 2, 45.0)
    assert abs(float(ring.exponent) + 0.5) < 3 * float(ring.error) < 0.1
    assert "Amplitude ~ distance^(-0.5" in ring.outcome


def test_a_power_of_the_distance_is_found_with_its_error():
    hexagon = scenes.hexagon(8, spacing=0.02)
    places = np.asarray(hexagon.positions)
    r = np.linalg.norm(places - places[108], axis=1)
    exact = np.where(r > 0, r, 1.0) ** -0.7
    found = gx.measures.front_decay(hexagon, exact, 108, direction=[1.0, 0.0])
    assert abs(float(found.exponent) + 0.7) < 1e-12 and abs(float(found.drift)) < 1e-12
    assert np.abs(found.distance - 0.02 * np.arange(1, 9)).max() < 1e-15
    noise = np.exp(0.1 * RNG.normal(size=(60, r.size)))
    many = [gx.measures.front_decay(hexagon, exact * x, 108, direction=[1.0, 0.0]) for x in noise]
    # the standard error is the scatter over draws
    scatter = np.std([float(x.exponent) for x in many])
    assert 0.7 < np.mean([float(x.error) for x in many]) / scatter < 1.4
    with refused("four distances"):
        gx.measures.front_decay(hexagon, exact, 108, between=(0.01, 0.05))


def test_complex_wave_numbers():
    chain = scenes.monomer(12, precompression=1.0, boundary="periodic")
    omega = np.array([1.0, 2.0, 3.0])
    found = gx.linear.complex_bands(chain, omega)
    cosine = 1 - omega**2 / 3
    assert (
        np.abs(np.cos(np.asarray(found.k)) - cosine[:, None]).max() < 1e-12
        and np.nanmax(found.residual) < 1e-14
    )
    assert np.abs(found.decay - np.arccosh(np.maximum(np.abs(cosine), 1))).max() < 1e-7
    plane = gx.linear.complex_bands(scenes.triangular(6, 6, boundary="periodic"), 3.0, across=0.7)
    k = complex(np.asarray(plane.k)[0, 0])
    n = np.array([[np.cos(a), np.sin(a)] for a in (0, np.pi / 3, 2 * np.pi / 3)])
    D = sum(2 * (1 - np.cos(p)) * np.outer(x, x) for x, p in zip(n, (k, 0.7, 0.7 - k)))
    assert abs(np.linalg.det(D - 9 * np.eye(2))) < 1e-10 and plane.decay[0] > 0.1


def turned_tree(depth, beads, angle):
    """The same with branches at +-angle of their stem."""
    nodes, edges, ways = [(0.0, 0.0), (beads, 0.0)], [(0, 1)], {1: 0.0}
    for level in range(1, depth + 1):
        for node in range(2 ** (level - 1), 2**level):
            for way in (ways[node] + angle, ways[node] - angle):
                ways[len(nodes)] = way
                edges.append((node, len(nodes)))
                nodes.append(nodes[node] + beads * np.array([np.cos(way), np.sin(way)]))
    return np.array(nodes), edges


@pytest.mark.slow
def test_a_network_of_three_guides_in_space_is_a_junction():
    angle, turn = 0.4, np.linalg.qr(RNG.normal(size=(3, 3)))[0]
    out = [
        [np.cos(angle), np.sin(angle) * np.cos(x), np.sin(angle) * np.sin(x)] for x in (0.3, 2.5)
    ]
    nodes = np.array([[0, 0, 0], [6, 0, 0], *([6, 0, 0] + 9 * np.array(out))]) @ turn
    edges = [(0, 1), (1, 2), (1, 3)]
    net = scenes.network(nodes, edges, (6, 9, 9))
    fork = scenes.junction(6, (9, 9), angles=(angle, -angle))
    u = RNG.normal(size=24)
    assert np.abs(net.force(0.0, u, 0 * u) - fork.force(0.0, u, 0 * u)).max() < 2e-15
    assert net.positions.shape == (24, 3)
    assert (
        np.abs(np.linalg.norm(np.diff(np.asarray(net.positions)[:6], axis=0), axis=1) - 1).max()
        < 1e-14
    )
    named = {name: x for name, x in zip(("in", "fork", "up", "down"), nodes)}
    words = scenes.network(
        named, [("in", "fork"), ("fork", "up"), ("fork", "down")], (6, 9, 9), boundary="free"
    )
    free = scenes.junction(6, (9, 9), angles=(angle, -angle), boundary="free")
    assert np.abs(words.force(0.0, u, 0 * u) - free.force(0.0, u, 0 * u)).max() < 2e-15
    # the places of contacts are those of the beads, whatever the weights
    segments = gx.measures.force_network(fork, gx.states.rest(fork)).segments
    assert np.abs(np.linalg.norm(segments[:, 1] - segments[:, 0], axis=-1) - 1).max() < 1e-14


@pytest.mark.slow
def test_a_network_read_backwards_is_the_same_network():
    nodes, edges = turned_tree(2, 5, 0.3)
    net = scenes.network(nodes, edges, 5)
    back = scenes.network(nodes, [(head, tail) for tail, head in edges], 5)
    u = RNG.normal(size=35)
    # all ends but the first and the last of each guide change their roles
    flip = lambda x: -np.asarray(x).reshape(7, 5)[:, ::-1].ravel()
    assert np.abs(flip(back.force(0.0, flip(u), 0 * u)) - net.force(0.0, u, 0 * u)).max() < 1e-14
    # two guides through one node at right angles pass through each other
    cross = scenes.network(
        [[-1, 0], [0, 0], [1, 0], [0, -1], [0, 1]], [(0, 1), (1, 2), (3, 1), (1, 4)], 4
    )
    chain = scenes.monomer(8)
    u = RNG.normal(size=16)
    want = [chain.force(0.0, x, 0 * x) for x in (u[:8], u[8:])]
    assert np.abs(cross.force(0.0, u, 0 * u) - np.concatenate(want)).max() < 1e-14


@pytest.mark.slow
def test_loads_of_a_network_and_its_derivative():
    nodes, edges = turned_tree(1, 6, 0.3)
    share = 0.5 / np.cos(0.3)
    held = scenes.network(nodes, edges, 6, precompression=[1.0, share, share])
    over = np.asarray(held.unbalanced())
    assert np.abs(over).max() < 1e-14
    over = np.asarray(scenes.network(nodes, edges, 6, precompression=1.0).unbalanced())
    assert abs(over[5] - (1 - 2 * np.cos(0.3))) < 1e-14 and np.abs(np.delete(over, 5)).max() < 1e-14
    masses = np.asarray(scenes.network(nodes, edges, 6, mass=[1.0, 2.0, 3.0]).mass)
    assert (masses == np.repeat([1.0, 2.0, 3.0], 6)).all()
    batch = jax.vmap(lambda A: scenes.network(nodes, edges, 6, stiffness=A), out_axes=-1)(
        jnp.array([1.0, 2.0])
    )
    u = np.linspace(0.5, 0.0, 18)
    both = np.asarray(batch.force(0.0, np.stack([u, u], -1), np.zeros((18, 2))))
    assert (
        batch.lanes == (2,)
        and np.abs(both[:, 1] - 2 * both[:, 0]).max() < 1e-15 < np.abs(both).max()
    )
    steel = scenes.network(
        1e-2 * nodes, edges, 6, mass=4e-3, stiffness=1e10, precompression=20.0, units="SI"
    )
    plain, units = scenes.scaled(steel)
    modes = [np.asarray(gx.linear.normal_modes(x).omega) for x in (steel, plain)]
    assert np.abs(modes[1] / float(units.time) / modes[0] - 1).max() < 1e-11 and steel.units == "SI"

    def energy(x):
        return scenes.network(nodes + x * np.eye(4, 2, -2), edges, 6).potential_energy(0.0, u)

    slope = float(jax.grad(energy)(0.0))
    assert abs(slope) > 1e-4 and abs(slope - (energy(1e-5) - energy(-1e-5)) / 2e-5) < 1e-8


def test_networks_that_are_refused():
    nodes = [[0, 0], [1, 0], [2, 0], [1, 1]]
    for edges, beads, words in (
        ([(0, 1), (1, 2), (1, 3)], 3, "right angle"),
        ([(0, 1), (1, 4)], 3, "one of 0, 1, 2, 3"),
        ([(0, 1), (1, 2)], (3, 3, 3), "one per guide"),
    ):
        with refused(words):
            scenes.network(nodes, edges, beads)
    with refused("traced"):
        jax.jit(lambda x: scenes.network(x, [(0, 1)], 3).mass)(np.array(nodes, float))
    with refused("one number, or an array"):
        scenes.network(nodes, [(0, 1), (1, 2)], 3, precompression=[1.0, 1.0, 1.0])


def exponential(amplitude):
    """The slope of log(amplitude) over its number, with its standard error."""
    A = np.stack([np.ones(len(amplitude)), np.arange(len(amplitude))], -1)
    c = np.linalg.lstsq(A, np.log(amplitude), rcond=None)[0]
    left = np.log(amplitude) - A @ c
    return c[1], np.sqrt(np.linalg.inv(A.T @ A)[1, 1] * (left @ left) / (len(left) - 2))


@pytest.mark.study
def test_a_pulse_falls_exponentially_with_depth_in_an_ordered_network():
    beads, angle = 12, 0.3

    def peaks(net, until):
        run = gx.simulate(
            net,
            gx.states.impact(net),
            until,
            step=0.1,
            record={"peak": gx.Peak(lambda t, y, _: y.v)},
        )
        return np.asarray(run.recorded["peak"]).reshape(-1, beads)[:, beads // 2]

    tree = peaks(scenes.network(*turned_tree(4, beads, angle), beads), 170.0)
    rate, error = exponential(tree[[2**level - 1 for level in range(1, 5)]])
    assert error < 1e-4 * abs(rate)
    # one junction gives the factor of every level, as the law has no scale
    single = peaks(scenes.junction(beads, (beads, beads), angles=(angle, -angle)), 45.0)
    assert abs(np.log(single[1] / single[0]) / rate - 1) < 0.01
    # a net of hexagons: guides split and join again
    stems, nodes, edges = {}, {}, []
    across, down = beads * np.sin(angle), beads * np.cos(angle)
    rows = 5
    for row in range(rows):
        for column in range(-row, row + 1, 2):
            y = -row * (beads + down)
            for end, at in (("top", y), ("bottom", y - beads)):
                nodes[f"{end} {row} {column}"] = (column * across, at)
            stems[row, column] = len(edges)
            edges.append((f"top {row} {column}", f"bottom {row} {column}"))
            if row + 1 < rows:
                edges += [
                    (f"bottom {row} {column}", f"top {row + 1} {column + side}") for side in (-1, 1)
                ]
    net = peaks(scenes.network(nodes, edges, beads), 330.0)
    rim = np.array([net[stems[row, row]] for row in range(1, rows)])
    middle = np.array(
        [max(net[stems[row, c]] for c in range(-row, row + 1, 2)) for row in range(rows)]
    )
    slope, error = exponential(rim)
    # along the rim, two turns a row: those of the tree, with error
    assert slope < -0.2 and error < 0.02 * abs(slope)
    assert (np.diff(middle) < 0).all() and middle[-1] < 0.5 * middle[0]


def across(k, kt, kb, f, J):
    """Waves across a chain of beads that turn, by hand, of masses 1: from the energies of slip, roll and prestress."""
    slip = np.array([1 - np.exp(1j * k), 1 + np.exp(1j * k)])
    bend = np.array([0, 1 - np.exp(1j * k)])
    turn = np.array([1 - np.exp(1j * k), 0])
    D = sum(x * np.outer(row.conj(), row) for x, row in ((kt, slip), (kb, bend), (-f, turn)))
    scale = np.array([1, J**-0.5])
    return scale[:, None] * D * scale


@pytest.mark.parametrize("kb, F0, pull", [(0.1, 0.02, 0.02), (0.8, 0.05, 0.0), (0.0, 0.01, 0.03)])
def test_bands_of_a_chain_of_beads_that_turn(kb, F0, pull):
    A, kt, J, L, m = 1.3, 0.9, 0.4, 1.7, 1.2
    chain = scenes.rotating_chain(
        9,
        mass=m,
        stiffness=A,
        precompression=F0,
        tangential=kt,
        bending=kb,
        spacing=L,
        attraction=pull,
        boundary="periodic",
    )
    k, f = PHASES[:, 0], (F0 - pull) / L
    waves = np.stack([np.linalg.eigvalsh(across(x, kt, kb, f, J)) for x in k])
    along = 2 * 1.5 * A ** (2 / 3) * F0 ** (1 / 3) * (1 - np.cos(k))
    want = np.sort(np.concatenate([waves, along[:, None]], 1), 1) / m
    assert np.abs(squares(chain, k) - want).max() < 1e-12
    c = np.cos(k)
    a, b = 2 * (kt - f) * (1 - c), 2 * kt * np.sin(k) / J**0.5
    d = (2 * kt * (1 + c) + 2 * kb * (1 - c)) / J
    root = np.sqrt(((a - d) / 2) ** 2 + b**2)
    assert np.abs(np.stack([(a + d) / 2 - root, (a + d) / 2 + root], 1) - waves).max() < 1e-12


def test_a_wave_of_turning_beads_stands_and_a_pressed_chain_buckles():
    kt, kb, J = 1.0, 0.8, 0.4
    chain = scenes.rotating_chain(
        9, tangential=kt, bending=kb, attraction=0.01, boundary="periodic"
    )
    D = kb - (1 - J) * kt
    k = np.arccos(1 - 4 * kt * D / (4 * J * kt * kb - D**2))
    waves = gx.linear.dispersion(chain, [k - 0.1, k, k + 0.1])
    velocity = np.asarray(waves.group_velocity)[:, 2]
    assert velocity[0] > 1e-3 and abs(velocity[1]) < 1e-12 and velocity[2] < -1e-3
    bent = lambda pull: scenes.rotating_chain(
        30, tangential=kt, bending=kb, precompression=0.1, attraction=pull
    )
    assert float(gx.linear.normal_modes(bent(0.0)).omega_squared[0]) < -1e-4
    assert float(gx.linear.normal_modes(bent(0.1)).omega_squared[0]) > 0


@pytest.mark.slow
def test_turning_beads_keep_both_momenta_and_turn_freely():
    chain = scenes.rotating_chain(
        8,
        precompression=0.05,
        tangential=0.3,
        bending=0.2,
        attraction=0.05,
        boundary="free",
        spacing=1.4,
    )
    assert np.abs(np.asarray(chain.unbalanced())).max() < 1e-15
    u = turned(np.asarray(chain.positions), 0.7, radius=0.7)
    assert abs(float(chain.potential_energy(0.0, u))) < 1e-15
    assert float(jnp.abs(chain.force(0.0, u, 0 * u)).max()) < 1e-14
    v = np.zeros(chain.shape)
    v[0] = 0.1, 0.04, 0.05
    run = gx.simulate(
        chain, gx.State(chain.zeros(), v), 20.0, solver=gx.SRKN11b(), step=0.05, save_at=4
    )
    turning = angular_momenta(chain, run, 0.7)
    assert np.ptp(turning) < 1e-12 and abs(turning[0]) > 1e-2
    assert np.ptp(np.asarray(run.vs)[..., :2].sum(1), axis=0).max() < 1e-12
    assert float(run.energy_error) < 1e-6 and np.abs(np.asarray(run.final.v)[-1]).max() > 1e-3


@pytest.mark.slow
def test_turning_beads_between_walls_in_batches_in_si_and_when_they_would_slide():
    counts = {"fixed": 7, "free": 5, "periodic": 6}
    for boundary, bonds in counts.items():
        chain = scenes.rotating_chain(6, bending=0.1, attraction=0.01, boundary=boundary)
        assert [term.strain_map.strain(chain.zeros()).shape for term in chain.terms] == [
            (bonds,)
        ] * 4
    make = lambda kb: scenes.rotating_chain(6, tangential=0.4, bending=kb)
    batch = jax.vmap(make, out_axes=-1)(jnp.array([0.1, 0.7]))
    u = 0.01 * RNG.normal(size=(6, 3))
    both = batch.force(0.0, jnp.stack([u, u], -1), jnp.zeros((6, 3, 2)))
    for i, kb in enumerate((0.1, 0.7)):
        assert np.abs(both[..., i] - make(kb).force(0.0, u, 0 * u)).max() < 1e-15
    slipped = np.zeros((6, 3))
    slipped[3, 2] = 0.004
    chain = make(0.1)
    ratio = float(gx.measures.slip_ratio(chain, gx.State(slipped, 0 * slipped)))
    assert abs(ratio - 0.4 * 0.004 / 0.01) < 1e-13
    A = float(gx.materials.hertz_coefficient("steel 316", 5e-3))
    steel = scenes.rotating_chain(
        8,
        mass=4.2e-3,
        stiffness=A,
        precompression=20.0,
        attraction=20.0,
        bending=2e3,
        spacing=1e-2,
        boundary="periodic",
        units="SI",
    )
    plain, units = scenes.scaled(steel)
    k = np.array([0.5, 2.0])
    want = np.asarray(gx.linear.dispersion(steel, k).omega)
    found = np.asarray(gx.linear.dispersion(plain, k).omega) / float(units.time)
    assert steel.units == "SI" and np.abs(found / want - 1).max() < 1e-11
    with refused("slide"):
        scenes.rotating_chain(6, precompression=0.0)
    with refused("boundary"):
        scenes.rotating_chain(6, boundary="closed")


@pytest.mark.slow
def test_the_default_step_of_beads_that_turn_is_that_of_their_highest_mode():
    crystal = scenes.packing(
        "steel 316", 5e-3, 2, precompression=20.0, rotation=True, outline="hexagon"
    )
    highest = float(gx.linear.normal_modes(crystal).omega.max())
    assert (
        highest <= float(frequency_bound(crystal, gx.states.rest(crystal), 0.0, 1e-5)) < 2 * highest
    )
    # one bead alone may go anywhere along a contact without slipping, and through its neighbour
    state = gx.states.impact(crystal, [1e-3, 0.0, 0.0], site=9)
    assert highest < float(frequency_bound(crystal, state, 0.0, 1e-5)) < 2 * highest


@pytest.mark.slow
def test_films_of_stored_runs_and_what_is_no_picture(tmp_path):
    crystal = scenes.hexagon(1, exponent=1.5)
    run = gx.simulate(
        crystal, gx.states.impact(crystal, [0.1, 0.0], site=3), 1.0, step=0.1, save_at=3
    )
    run.save(tmp_path / "run.nc")
    film = gx.plots.film(xr.load_dataset(tmp_path / "run.nc"), crystal)
    assert gx.plots.save(film, tmp_path / "run.gif").stat().st_size > 1000
    left, right = gx.plots.figure(6.0, 2.0).subplots(1, 2)
    film = gx.plots.film(run, crystal, ax=right)
    assert gx.plots.save(film, tmp_path / "two.gif").stat().st_size > 1000
    assert not left.collections and len(right.collections[0].get_offsets()) == 7
    batch = jax.vmap(lambda A: scenes.hexagon(1, stiffness=A), out_axes=-1)(jnp.ones(2))
    for places in (batch, np.zeros((4, 3))):
        with refused("places: expected"):
            gx.plots.beads(places)


@pytest.mark.parametrize("angle", [0.7, 3.0, 3.3, -8.0, 40.0])
def test_a_rotation_by_any_angle_slips_nowhere_and_slip_is_signed(angle):
    crystal = scenes.hexagon(1, rotation=True, tangential=0.3, boundary="free")
    slip = crystal.terms[1].strain_map
    u = turned(np.asarray(crystal.positions), angle)
    assert np.abs(slip.strain(u)).max() < 1e-13
    assert float(crystal.potential_energy(0.0, u)) < 1e-25
    # one bead turned by more: each of its contacts slips by as much, either way
    for more in (0.2, -0.2):
        one = u.copy()
        one[3, 2] += more
        found = np.asarray(slip.strain(one))
        ends = np.asarray(slip.pairs.tail), np.asarray(slip.pairs.head)
        assert np.abs(found - more * ((ends[0] == 3) | (ends[1] == 3))).max() < 1e-13


@pytest.mark.slow
def test_slip_of_beads_that_circle_each_other_is_continuous_in_time():
    """Against the angle unwrapped over time, over three turns: one bead rolls around another that turns slowly."""
    slip = gx.strains.Slip(gx.Shift(1, "free"), (1.0, 0.0))
    t = np.linspace(0, 1, 400)
    angle, own = 6 * np.pi * t, np.stack([2 * np.pi * t, 3.7 * np.pi * t + 0.2 * np.sin(9 * t)])
    at = np.stack([np.cos(angle), np.sin(angle)])
    u = np.zeros((2, 3, len(t)))
    u[1, :2] = at - np.array([[1.0], [0.0]])
    u[:, 2] = own
    phi = np.unwrap(np.arctan2(at[1], at[0]))
    assert np.abs(np.asarray(slip.strain(u))[0] - (own.sum(0) - phi)).max() < 1e-12


def gripped(s, overlap, k):
    """Energy of a tangential spring that lets go, and its slopes by slip and by overlap, by hand."""
    if overlap <= 0:
        return 0.0, 0.0, 0.0
    if abs(s) <= overlap:
        return k * s * s / 2, k * s, 0.0
    # (k/2) a^2 z^3 (10 - 15 z + 6 z^2) of z = overlap/a, term by term
    a = abs(s)
    energy = k / 2 * (10 * overlap**3 / a - 15 * overlap**4 / a**2 + 6 * overlap**5 / a**3)
    by_slip = (
        k
        / 2
        * np.sign(s)
        * (-10 * overlap**3 / a**2 + 30 * overlap**4 / a**3 - 18 * overlap**5 / a**4)
    )
    by_overlap = k / 2 * (30 * overlap**2 / a - 60 * overlap**3 / a**2 + 30 * overlap**4 / a**3)
    return energy, by_slip, by_overlap


def test_an_open_contact_lets_go_of_its_tangential_spring():
    kt, kb, F0 = 0.5, 0.2, 0.001
    chain = scenes.rotating_chain(
        3, precompression=F0, tangential=kt, bending=kb, boundary="free", inertia=0.5
    )
    d0, rest = F0 ** (2 / 3), np.zeros(chain.shape)
    slipped = rest.copy()
    slipped[2, 2] = 0.004
    closed = np.asarray(chain.force(0.0, slipped, rest))
    # slip and roll of the last contact: both are its turn
    assert (
        np.abs(closed[:, 2] - [0, -kt * 0.004 + kb * 0.004, -kt * 0.004 - kb * 0.004]).max() < 1e-15
    )
    for apart in (d0 * 1.0001, 0.3, 20.0):
        u = slipped.copy()
        u[2, 0], u[2, 1] = apart, 0.1 * apart
        force = np.asarray(chain.force(0.0, u, rest))
        assert np.abs(force[2, 2]) == 0 and np.abs(force[1, 2]) == 0
        # what is left is the load that is held at the end
        assert np.abs(force[2, :2] - [-F0, 0]).max() < 1e-15
        assert float(gx.measures.slip_ratio(chain, gx.State(u, rest))) == 0
    # twice pressed together, and slipped beyond the overlap
    for e, s in ((0.005, 0.01), (-0.004, 0.02), (0.003, -0.04)):
        u = rest.copy()
        u[2, 0], u[2, 2] = -e, s
        _, T, N = gripped(s, d0 + e, kt)
        _, M, more = gripped(s, d0 + e, kb)
        force = np.asarray(chain.force(0.0, u, rest))
        # the slip turns with the line of centres, which is shorter by e
        want = [(d0 + e) ** 1.5 - F0 + N + more, T / (1 - e), -T - M]
        assert np.abs(force[2] - want).max() < 1e-15
        T_over_N = float(gx.measures.slip_ratio(chain, gx.State(u, rest)))
        assert abs(T_over_N - abs(T) / (d0 + e) ** 1.5) < 1e-12


@pytest.mark.parametrize(
    "exponent, F0, law", [(1.5, 0.0, None), (2.5, 0.01, None), (1.5, 0.01, "cubic")]
)
def test_derivatives_of_a_contact_that_lets_go_are_numbers(exponent, F0, law):
    class Cubic(gx.Law):
        k: jax.Array

        def force(self, e):
            return self.k * e**3

        def energy(self, e):
            return self.k * e**4 / 4

    tangential = Cubic(jnp.array(2.0)) if law else 0.4
    make = lambda F: scenes.rotating_chain(
        3, exponent=exponent, precompression=F, tangential=tangential, bending=0.1
    )
    chain, d0 = make(F0), F0 ** (1 / exponent)
    energy = lambda u: chain.potential_energy(0.0, u)
    force = jax.jit(lambda u: chain.force(0.0, u, 0 * u))
    slope = jax.jit(jax.jacfwd(force))
    for u in (
        np.zeros(chain.shape),
        np.pad([[-d0 - 0.1, 0, 0.3]], ((1, 1), (0, 0))),
        0.2 * RNG.normal(size=(3, 3)),
        np.pad([[0.0, 0, d0]], ((1, 1), (0, 0))),
        np.pad([[-d0, 0, 0.0]], ((1, 1), (0, 0))),
    ):
        found = np.asarray(slope(u))
        assert np.isfinite(found).all() and np.isfinite(np.asarray(force(u))).all()
        step = 1e-6 * RNG.normal(size=u.shape)
        work = float(energy(u + step) - energy(u - step)) / 2
        assert abs(work + float((force(u) * step).sum())) < 1e-9 * 1e-2


@pytest.mark.slow
def test_beads_that_part_and_meet_again_keep_their_energy_against_an_independent_integration():
    A, F0, kt, J, L = 1.0, 0.002, 0.6, 0.4, 1.0
    chain = scenes.rotating_chain(
        3, precompression=F0, attraction=F0, tangential=kt, boundary="free"
    )
    d0 = F0 ** (2 / 3)

    def rhs(t, y):
        u, force = y[:9].reshape(3, 3), np.zeros((3, 3))
        for n in (0, 1):
            D = np.array([L, 0.0]) + u[n + 1, :2] - u[n, :2]
            length = np.hypot(*D)
            along, across = D / length, np.array([-D[1], D[0]]) / length
            slip, overlap = u[n, 2] + u[n + 1, 2] - L * np.arctan2(D[1], D[0]), d0 + L - length
            _, T, N = gripped(slip, overlap, kt)
            push = A * max(overlap, 0) ** 1.5 + N - F0
            on_head = push * along + T * L / length * across
            force[n + 1, :2] += on_head
            force[n, :2] -= on_head
            force[[n, n + 1], 2] -= T
        return np.concatenate([y[9:], (force / [1, 1, J]).ravel()])

    v = np.array([[0.0, 0.0, 0.02], [0.02, 0.01, 0.0], [0.05, -0.01, 0.03]])
    far = solve_ivp(
        rhs,
        (0, 40.0),
        np.concatenate([np.zeros(9), v.ravel()]),
        method="DOP853",
        rtol=1e-11,
        atol=1e-13,
    )
    run = gx.simulate(chain, gx.State(chain.zeros(), v), 40.0, tolerance=1e-11, save_at=81)
    gaps = (
        np.linalg.norm(
            np.diff(np.asarray(run.us)[..., :2] + np.asarray(chain.positions), axis=1), axis=-1
        )
        - L
        - d0
    )
    # the second contact opens and closes again
    assert gaps[:, 1].max() > 1e-3 and (np.diff(np.sign(gaps[:, 1])) != 0).sum() >= 2
    assert np.abs(np.asarray(run.final.u).ravel() - far.y[:9, -1]).max() < 1e-6
    assert float(run.energy_error) < 1e-8 and run.opening == "yes"


def rim_bonds(inside, ties):
    """Bonds of a crystal on one grid, and those to what is outside of it, counted by flood from beyond the rim."""
    padded = np.pad(inside, 1)
    structure = np.zeros((3, 3), bool)
    structure[1, 1] = True
    for i, j in ties:
        structure[1 + i, 1 + j] = structure[1 - i, 1 - j] = True
    label, _ = ndimage.label(~padded, structure)
    outside = (label == label[0, 0]) & ~padded
    bonds = walls = 0
    for i, j in np.argwhere(padded):
        for a, b in ties:
            bonds += padded[i + a, j + b]
            walls += int(outside[i + a, j + b]) + int(outside[i - a, j - b])
    return bonds, walls


@pytest.mark.parametrize(
    "make, ties, away",
    [
        (scenes.square, ((1, 0), (0, 1)), lambda x: np.abs(x).max(-1) > 1.2),
        (scenes.square, ((1, 0), (0, 1)), lambda x: np.abs(x).sum(-1) > 0.1),
        (
            scenes.triangular,
            ((1, 0), (0, 1), (-1, 1)),
            lambda x: np.hypot(*np.moveaxis(x, -1, 0)) > 1.3,
        ),
        (
            scenes.triangular,
            ((1, 0), (0, 1), (-1, 1)),
            lambda x: (
                (np.hypot(*np.moveaxis(x, -1, 0)) < 2.2)
                & (np.hypot(*np.moveaxis(x - [1.0, 0], -1, 0)) > 0.1)
            ),
        ),
    ],
)
def test_a_hole_of_an_outline_is_empty(make, ties, away):
    centre = np.array([4.0, 4.0]) if make is scenes.square else np.array([6.0, 4 * 0.75**0.5])
    seen = []

    def outline(x):
        seen.append(away(x - centre))
        return seen[-1]

    crystal, free = (make(9, exponent=1.5, outline=outline, boundary=b) for b in ("fixed", "free"))
    bonds, walls = rim_bonds(seen[0], ties)
    ends = [
        (np.asarray(t.strain_map.pairs.tail), np.asarray(t.strain_map.pairs.head))
        for t in crystal.terms
    ]
    assert sum(((tail == -1) | (head == -1)).sum() for tail, head in ends) == walls > 0
    assert sum(((tail != -1) & (head != -1)).sum() for tail, head in ends) == bonds
    assert sum(len(t.strain_map.pairs.tail) for t in free.terms) == bonds
    # a bead beside the hole moves into it against nothing
    x = np.asarray(crystal.positions)
    near = np.argmin(np.linalg.norm(x - centre, axis=1))
    u = np.zeros(crystal.shape)
    u[near] = 1e-3 * (centre - x[near])
    assert not np.asarray(crystal.force(0.0, u, 0 * u))[near].any() or np.allclose(x[near], centre)


def test_a_hole_of_a_honeycomb_with_a_slit_to_the_rim_is_part_of_it():
    whole = lambda x: np.ones(x.shape[:-1], bool)
    x0 = np.array([12.990381, 8.0])
    hole = lambda x: np.hypot(*np.moveaxis(x - x0, -1, 0)) > 1.2
    slit = lambda x: hole(x) & ~((np.abs(x[..., 0] - x0[0]) < 1.0) & (x[..., 1] < x0[1]))
    count = lambda outline: sum(
        sum(np.sum(np.equal(end, -1)) for end in (t.strain_map.tail, t.strain_map.head))
        for t in scenes.honeycomb(7, outline=outline, out_of_plane=True).terms
    )
    assert count(hole) == count(whole) < count(slit)


def said(crystal, *frames):
    """What is said of beads without a bond in a run that has saved these displacements."""
    us = np.stack(frames)
    return passing(crystal, np.arange(float(len(us))), us, us[-1])


def overlapping(x, joined, radii, periods=()):
    """The pairs without a bond whose rims overlap, by all distances, and the nearest."""
    R = np.add.outer(radii, radii)
    images = [0 * x[0], *periods, *(-p for p in periods)]
    apart = np.min([np.linalg.norm(x[:, None] - x - p, axis=-1) for p in images], 0)
    over = np.triu((apart < (1 - 1e-4) * R) & ~joined, 1)
    return (
        over.sum(),
        np.unravel_index(np.argmin(np.where(over, apart / R, np.inf)), over.shape),
        apart,
    )


@pytest.mark.parametrize("name", ["square", "strip", "honeycomb"])
def test_beads_without_a_bond_that_overlap_are_named(name):
    crystal = {
        "square": lambda: scenes.square(5, exponent=1.5, boundary="free", spacing=0.02),
        "strip": lambda: scenes.triangular(
            5, 4, exponent=2.0, precompression=0.1, boundary=("periodic", "free")
        ),
        "honeycomb": lambda: scenes.honeycomb(3, exponent=1.5, boundary="free"),
    }[name]()
    parts = [np.asarray(x).reshape(-1, 2) for x in jax.tree.leaves(crystal.positions)]
    x, L = np.concatenate(parts), 0.02 if name == "square" else 1.0
    periods = [np.array([5.0, 0.0])] if name == "strip" else []
    images = [np.zeros(2), *periods, *(-p for p in periods)]
    rest = np.min([np.linalg.norm(x[:, None] - x - p, axis=-1) for p in images], 0)
    joined, hits = rest < 1.1 * L, 0
    for size in (0.02, 0.15, 0.25, 0.35, 0.5, 0.8) * 2:
        u = size * L * RNG.normal(size=x.shape)
        many, (i, j), apart = overlapping(x + u, joined, np.full(len(x), L / 2), periods)
        if name == "honeycomb":
            fields = {name: u[9 * n : 9 * n + 9].reshape(3, 3, 2) for n, name in enumerate("ab")}
            words = passing(crystal, np.zeros(1), jax.tree.map(lambda x: x[None], fields), fields)
            site = lambda i: f"site {divmod(i % 9, 3)} of {'ab'[i // 9]!r}"
        else:
            words = said(crystal, np.zeros(crystal.shape), u.reshape(crystal.shape))
            site = lambda i: f"site {divmod(i, crystal.shape[1])}"
            assert "at t = 1:" in words or not words
        assert bool(words) == bool(many)
        hits += bool(many)
        if many:
            assert {site(int(i)), site(int(j))} == set(
                words.split(": ")[1].split(", " + f"{apart[i, j]:.3g}")[0].split(" and ")
            )
            assert (f"and {many - 1} more" in words) == (many > 1)
    assert 2 <= hits < 12


@pytest.mark.slow
def test_the_outcome_of_a_run_names_beads_that_pass_through_one_another():
    crystal = scenes.square(5, exponent=1.5, boundary="free")
    v = np.zeros(crystal.shape)
    v[0, 0] = 0.3, 0.3
    run = gx.simulate(crystal, gx.State(crystal.zeros(), v), 6.0, save_at=25)
    places = np.asarray(run.us) + np.asarray(crystal.positions)
    diagonal = np.linalg.norm(places[:, 0, 0] - places[:, 1, 1], axis=-1)
    first = np.argmax(diagonal < 1 - 1e-4)
    assert (
        f"overlap at t = {run.ts[first]:g}: site (0, 0) and site (1, 1), {diagonal[first]:.3g} apart"
        in run.outcome
    )
    assert run.outcome.startswith("Completed") and "Bonds are fixed" in run.outcome
    slow = gx.simulate(crystal, gx.State(crystal.zeros(), 0.01 * v), 6.0, save_at=25)
    assert "bond" not in slow.outcome


def test_beads_of_two_sizes_on_a_graph_and_a_chain_on_a_line():
    # a packing of two sizes: the radii follow from who is in touch with whom
    R = np.array([1.0, 1.0, 0.5, 0.7, 0.4])
    x = [np.zeros(2), np.array([2.0, 0.0])]
    for a, b, r in ((0, 1, R[2]), (1, 2, R[3]), (0, 2, R[4])):
        # the third bead touches both, above their line
        p, q, d1, d2 = x[a], x[b], R[a] + r, R[b] + r
        d = np.linalg.norm(q - p)
        along = (d1**2 - d2**2 + d**2) / (2 * d)
        e = (q - p) / d
        h = np.sqrt(d1**2 - along**2)
        side = np.array([-e[1], e[0]])
        x.append(
            p
            + along * e
            + h * (side if (a, b) != (1, 2) else -side) * (1 if (a, b) != (1, 2) else 1)
        )
    x = np.stack(x)
    pairs = [(0, 1), (0, 2), (1, 2), (1, 3), (2, 3), (0, 4), (2, 4)]
    tail, head = np.array(pairs).T
    assert np.abs(np.linalg.norm(x[tail] - x[head], axis=1) - R[tail] - R[head]).max() < 1e-12
    bond = gx.Bond(gx.Stretch(gx.Pairs(tail, head), x[head] - x[tail]), gx.Hertz())
    packing = gx.Lattice(R**3, bond, dimension=2, positions=x)
    joined = np.zeros((5, 5), bool)
    joined[tail, head] = joined[head, tail] = True
    for size in (0.0, 0.1, 0.3, 0.6, 1.0):
        u = size * RNG.normal(size=x.shape)
        many, _, _ = overlapping(x + u, joined, R)
        assert bool(said(packing, u)) == bool(many)
    # on a line the first and the third bead meet where the one between is pressed through
    line = gx.Lattice(
        1.0,
        gx.Bond(gx.Shift(1, "fixed"), gx.Hertz()),
        sites=5,
        positions=2.0 * np.arange(5.0)[:, None],
    )
    assert said(line, [0, 0.9, 0, 0, 0]) == said(line, [1.0, 0, -0.9, 0, 0]) == ""
    assert "site 0 and site 2, 1.9 apart where they touch at 2." in said(line, [1.1, 0, -1.0, 0, 0])
    folded = scenes.rotating_chain(4, boundary="free")
    u = np.zeros((4, 3))
    u[2, :2], u[3, :2] = [-1.5, 0.8], [-1.0, 1.5]
    assert "at t = 1: site 0 and site 2, 0.943 apart" in said(folded, 0 * u, u + [0, 0, 7.0])


class Everywhere(gx.Term):
    """A force of one's own that may join any sites."""

    def force(self, t, u, v, mass):
        return -1e-3 * (u - u.mean(0))


def test_nothing_is_said_of_scenes_without_beads_and_the_lane_is_named():
    far = lambda x: 3 * RNG.normal(size=x.shape)
    springs, alone = scenes.square(4), scenes.monomer(6)
    own = gx.Lattice(
        1.0,
        (*scenes.hexagon(1, exponent=1.5).terms, Everywhere()),
        sites=7,
        dimension=2,
        positions=scenes.hexagon(1).positions,
    )
    assert said(springs, far(springs)) == said(alone, far(alone)) == said(own, far(own)) == ""
    # beads at rest all around, which those that move may meet too
    wall = scenes.hexagon(1, exponent=1.5)
    x = np.asarray(wall.positions)
    grid = [
        x[3] + [i + j / 2, j * 0.75**0.5]
        for i in range(-3, 4)
        for j in range(-3, 4)
        if abs(i + j) < 3
    ]
    ring = np.array([p for p in grid if 0.1 < np.linalg.norm(p - x, axis=1).min() < 1.1])
    assert len(ring) == 12
    seen = set()
    for shift in (0.3, 0.6, 0.9, 1.5):
        through = np.zeros(wall.shape)
        through[0] = shift * np.array([0.5, -(0.75**0.5)])
        unbound = ring[np.linalg.norm(ring - x[0], axis=1) > 1.1]
        met = np.linalg.norm(unbound - x[0] - through[0], axis=1).min() < 1
        assert ("site 0 and a bead of the wall" in said(wall, through)) == met
        seen.add(bool(met))
    assert seen == {True, False}
    batch = jax.vmap(
        lambda A: scenes.square(3, stiffness=A, exponent=1.5, boundary="free"), out_axes=-1
    )(jnp.ones(3))
    u = np.zeros((3, 3, 2, 3))
    u[0, 0, :, 1] = 0.6
    assert "in lane 1: site (0, 0) and site (1, 1)" in said(batch, 0 * u, u)
    run = jax.jit(lambda v: gx.simulate(wall, gx.State(wall.zeros(), v), 0.1, step=0.1).final.u)
    assert run(jnp.zeros(wall.shape)).shape == wall.shape


@pytest.mark.study
def test_a_tree_of_guides_on_a_line_is_a_chain_that_doubles():
    depth, beads = 3, 4
    nodes, edges = turned_tree(depth, beads, 0.0)
    tree = scenes.network(nodes, edges, beads)
    double = 2.0 ** np.repeat(np.arange(depth + 1), beads)
    chain = scenes.monomer(16, mass=double, stiffness=np.append(double, 2.0**depth))
    first = [2**level - 1 for level in range(depth + 1)]
    path = np.concatenate([np.arange(i * beads, (i + 1) * beads) for i in first])
    level = np.repeat(np.floor(np.log2(np.arange(1, 16))).astype(int), beads)
    same = beads * level + np.tile(np.arange(beads), 15)
    u = 0.1 * RNG.normal(size=16)
    force = np.asarray(tree.force(0.0, u[same], np.zeros(60)))
    assert np.abs(force * 2.0**level - np.asarray(chain.force(0.0, u, 0 * u))[same]).max() < 1e-12
    runs = [gx.simulate(x, gx.states.impact(x, 0.3), 25.0, step=0.05) for x in (tree, chain)]
    both, one = (np.asarray(run.final.u) for run in runs)
    assert (
        np.abs(both[path] - one).max() < 1e-12
        and np.abs(both - one[same]).max() < 1e-12
        and one[10] > 1e-3
    )


def test_long_waves_of_the_triangular_lattice_are_isotropic():
    crystal = scenes.triangular(7, 7, boundary="fixed")
    vectors = np.array([[1.0, 0.0], [0.5, 0.75**0.5]])
    for angle in (0.0, 0.4, 1.1):
        q = 1e-4 * np.array([np.cos(angle), np.sin(angle)])
        found = squares(crystal, vectors @ q) / 1e-8
        assert np.abs(found - [3 / 8, 9 / 8]).max() < 1e-7


@pytest.mark.parametrize("boundary", ["fixed", "periodic"])
def test_a_packing_of_two_materials(boundary):
    """Stripes of PTFE in steel: masses, the three contacts, bands of a cell of two rows; a random one conserves."""
    beads, R, A = ("steel 316", "PTFE"), 5e-3, gx.materials.hertz_coefficient
    stripes = np.broadcast_to(np.arange(8)[:, None] % 2, (8, 6))
    crystal = scenes.packing(beads, R, 8, 6, 20.0, pattern=stripes, boundary=boundary)
    mass = [float(gx.materials.bead_mass(gx.materials.named("material", x), R)) for x in beads]
    assert_allclose(crystal.mass[..., 0], np.array(mass)[stripes], rtol=1e-14)
    across, along, _ = (np.asarray(term.law.stiffness) for term in crystal.terms)
    inside = slice(1, -1) if boundary == "fixed" else slice(None)
    assert_allclose(across[inside], float(A(beads[0], R, beads[1], R)), rtol=1e-14)
    own = np.broadcast_to([[float(A(x, R))] for x in beads * 4], along.shape)
    assert_allclose(along, own, rtol=1e-14)
    found = gx.linear.dispersion(crystal, [0.3, 0.7])
    assert found.cell == (2, 1) and found.omega.shape == (4,)
    whole = scenes.packing(beads, R, 8, 6, 20.0, pattern=0 * stripes, boundary=boundary)
    plain = scenes.packing(beads[0], R, 8, 6, 20.0, boundary=boundary)
    assert_allclose(linear_modes(whole), linear_modes(plain), rtol=1e-9)
    drawn = scenes.packing(
        beads, R, 8, 6, 20.0, pattern=np.random.default_rng(0).integers(2, size=(8, 6))
    )
    still = drawn.zeros()
    run = gx.simulate(drawn, gx.State(still, still.at[3, 3].set(0.1)), 2e-3, save_at=9)
    assert run.energy_error < 1e-8
    with refused("pattern"):
        scenes.packing(beads, R, 8, 6, 20.0)
    with refused("rotation"):
        scenes.packing(beads, R, 8, 6, 20.0, pattern=stripes, rotation=True)
    with refused("one per site"):
        scenes.packing(beads, R, 8, 6, 20.0, pattern=stripes[:3])
    with refused("one material"):
        scenes.packing(beads[0], R, 8, 6, 20.0, pattern=stripes)


@pytest.mark.parametrize(
    ("arrangement", "boundary"),
    [("hexagonal", "fixed"), ("hexagonal", "periodic"), ("square", "fixed")],
)
def test_a_packing_of_many_radii_rests(arrangement, boundary):
    """From places, radii and Hertz's law alone: no bead is pushed, and some contacts are open."""
    rng, shape, F0 = np.random.default_rng(3), (4, 5), 5.0
    radii = 5e-3 * (1 + 1.2e-4 * rng.uniform(-1, 1, shape))
    how = {"arrangement": arrangement, "boundary": boundary}
    crystal = scenes.packing("steel 316", radii, *shape, F0, **how)
    assert_allclose(crystal.mass[..., 0], gx.materials.bead_mass("steel 316", radii), rtol=1e-14)
    mean = np.mean(radii)
    regular = np.asarray(scenes.packing("steel 316", mean, *shape, F0, **how).positions)
    places, vectors = np.asarray(crystal.positions), regular[[1, 0], [0, 1]] - regular[0, 0]
    beads = []
    for cell in itertools.product(*(range(-1, n + 1) for n in shape)):
        at = tuple(np.mod(cell, shape))
        if boundary == "periodic" or at == cell:
            beads.append((places[at] + np.subtract(cell, at) @ vectors, radii[at], at == cell))
        else:
            # a wall's bead, at its place in the regular packing, is like the one that it touches
            beads.append((regular[0, 0] + np.array(cell) @ vectors, None, False))
    forces, pushes = [], []
    for x, R, _ in filter(lambda bead: bead[2], beads):
        forces.append(np.zeros(2))
        for y, other, _ in beads:
            d = np.linalg.norm(x - y)
            if 0 < d < 2.2 * mean:
                other = R if other is None else other
                A = float(gx.materials.hertz_coefficient("steel 316", R, "steel 316", other))
                pushes.append(A * max((F0 / A) ** (2 / 3) + R + other - d, 0) ** 1.5)
                forces[-1] += pushes[-1] * (x - y) / d
    # places of a centimetre have the digits of an overlap of a micrometre to 1e-12
    assert np.abs(forces).max() < 1e-10 * max(pushes) and min(pushes) < 0.3 * max(pushes)


def test_radii_that_are_equal_differ_too_much_or_are_differentiated():
    shape = (4, 5)
    make = lambda R, **how: scenes.packing("steel 316", R, *shape, 20.0, **how)
    noise = np.random.default_rng(0).uniform(-1, 1, shape)
    equal, plain = make(np.full(shape, 5e-3)), make(5e-3)
    assert_allclose(linear_modes(equal), linear_modes(plain), rtol=1e-9)
    assert_allclose(equal.positions, plain.positions, rtol=0, atol=1e-15)
    lowest = lambda part: gx.linear.normal_modes(make(5e-3 * (1 + part * noise))).omega[0]
    slope = (lowest(1.01e-4) - lowest(0.99e-4)) / 2e-6
    for derivative in (jax.jacfwd, jax.jacrev):
        assert_allclose(derivative(lowest)(1e-4), slope, rtol=1e-3)
    assert_allclose(jax.vmap(lowest)(np.array([0.0, 1e-4]))[1], lowest(1e-4), rtol=1e-9)
    with pytest.raises(RuntimeError, match="no stable state of rest"):
        make(5e-3 * (1 + 3e-3 * noise))
    with refused("many radii"):
        make(5e-3 * (1 + 1e-4 * noise), boundary="free")
    with refused("one of each"):
        make(5e-3 * (1 + 1e-4 * noise), rotation=True)


def linear_modes(lattice):
    return gx.linear.normal_modes(lattice).omega
