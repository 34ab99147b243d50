"""Lattices of the plane by name: bands against closed forms, momenta, walls, outlines, beads that turn."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import granjax as gx
from granjax import scenes

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


def test_long_waves_of_the_triangular_lattice_are_isotropic():
    crystal = scenes.triangular(7, 7, boundary="fixed")
    vectors = np.array([[1.0, 0.0], [0.5, 0.75**0.5]])
    for angle in (0.0, 0.4, 1.1):
        q = 1e-4 * np.array([np.cos(angle), np.sin(angle)])
        found = squares(crystal, vectors @ q) / 1e-8
        assert np.abs(found - [3 / 8, 9 / 8]).max() < 1e-7


def test_flat_and_dirac_bands_out_of_plane():
    c = np.cos(PHASES / 2)
    honey = squares(scenes.honeycomb(6, out_of_plane=True, boundary="periodic"), np.concatenate([PHASES, K[None]]))
    h = np.abs(1 + np.exp(1j * PHASES[:, 0]) + np.exp(1j * PHASES[:, 1]))
    assert np.abs(honey[:-1] - np.stack([3 - h, 3 + h], -1)).max() < 1e-12 and np.abs(honey[-1] - 3).max() < 1e-12
    lieb = squares(scenes.lieb(6, boundary="periodic", ground=0.3), PHASES)
    wide = 2 * np.sqrt((c**2).sum(1))
    assert np.abs(lieb - 4.3 - np.stack([-wide, 0 * wide, wide], -1)).max() < 1e-12
    kagome = squares(scenes.kagome(6, out_of_plane=True, boundary="periodic"), PHASES)
    root = np.sqrt(4 * ((c**2).sum(1) + np.cos((PHASES[:, 0] - PHASES[:, 1]) / 2) ** 2) - 3)
    assert np.abs(kagome - 4 + np.stack([1 + root, 1 - root, -2 + 0 * root], -1)).max() < 1e-12


def test_chains_with_flat_bands_and_the_chain_of_su_schrieffer_and_heeger():
    k = PHASES[:, 0]
    flat = np.zeros_like(k)
    sums, bands = {
        "sawtooth": (2 + 2 * 2**0.5, (flat - 2, 2 + 2 * np.cos(k))), "stub": (3.0, (flat, np.sqrt(3 + 2 * np.cos(k)))),
        "diamond": (4.0, (flat, 8**0.5 * np.cos(k / 2))),
    }, {}
    for name, (most, (still, wide)) in sums.items():
        bands[name] = squares(getattr(scenes, name)(9, ground=0.2), k)
        other = [] if name == "sawtooth" else [-wide]
        want = np.sort(most + 0.2 - np.stack([still, wide, *other], -1), -1)
        assert np.abs(bands[name] - want).max() < 1e-12
    uneven = squares(scenes.stub(9, equal=False), k)
    assert np.ptp(uneven, axis=0).min() > 0.1
    gap = np.asarray(gx.linear.normal_modes(scenes.ssh(10)).omega_squared)[9:11]
    assert np.abs(gap - [2.99853515, 3.00146485]).max() < 5e-9


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
    crystal = scenes.triangular(7, 7, stiffness=A, exponent=1.5, precompression=F0, rotation=True, tangential=kt,
                                boundary="periodic")
    K2 = 1.5 * A ** (2 / 3) * F0 ** (1 / 3)
    for k in (0 * K, K, PHASES[0]):
        want = np.linalg.eigvalsh(hexagonal_matrix(k, K2, F0, kt, 0.4))
        assert np.abs(squares(crystal, k) - want).max() < 1e-12 * 20


@pytest.mark.slow
def test_beads_that_turn_keep_both_momenta_and_a_rigid_rotation_costs_nothing():
    crystal = scenes.hexagon(2, rotation=True, tangential=0.3, boundary="free")
    v = 0.1 * RNG.normal(size=crystal.shape)
    run = gx.simulate(crystal, gx.State(crystal.zeros(), v), 10.0, solver=gx.SRKN11b(), step=0.05, save_at=3)
    turning = [float(gx.measures.angular_momentum(crystal, gx.State(u, v), radius=0.5)) for u, v in zip(run.us, run.vs)]
    assert np.ptp(turning) < 1e-13 and abs(turning[0]) > 0.1
    assert np.ptp(np.asarray(run.vs)[..., :2].sum(1), axis=0).max() < 1e-13
    assert float(run.energy_error) < 1e-8
    x, angle = np.asarray(crystal.positions), 0.7
    c, s = np.cos(angle), np.sin(angle)
    u = np.concatenate([x @ np.array([[c, s], [-s, c]]) - x, np.full((len(x), 1), 0.5 * angle)], 1)
    assert float(crystal.potential_energy(0.0, u)) < 1e-28
    assert float(jnp.abs(crystal.force(0.0, u, 0 * u)).max()) < 1e-14


@pytest.mark.slow
def test_a_struck_hexagon_against_an_independent_integration():
    crystal = scenes.hexagon(4, exponent=1.5)
    assert crystal.shape == (61, 2)
    x = np.asarray(crystal.positions)
    assert np.abs(np.sort(np.linalg.norm(x - x[30], axis=1))[:7] - [0, 1, 1, 1, 1, 1, 1]).max() < 1e-12
    # beads at rest all around
    ring = [np.array([i + j / 2, j * 0.75**0.5]) for i in range(-6, 7) for j in range(-6, 7)]
    every = np.concatenate([x, [p + x[30] for p in ring if np.linalg.norm(p + x[30] - x, axis=1).min() > 1e-6]])

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
    far = solve_ivp(rhs, (0, 12.0), y0, method="DOP853", rtol=1e-12, atol=1e-14).y[:, -1]
    run = gx.simulate(crystal, gx.states.impact(crystal, [0.1, 0.03], site=30), 12.0, tolerance=1e-11)
    assert np.abs(np.asarray(run.final.u).ravel() - far[:122]).max() < 1e-9
    assert np.abs(far[:122]).max() > 0.03


def test_a_planar_front_in_the_square_lattice_is_a_chain():
    square = scenes.square(20, 3, exponent=1.5, boundary=("fixed", "periodic"))
    chain = scenes.monomer(20)
    v = np.zeros(square.shape)
    v[0, :, 0] = 0.2
    flat = gx.simulate(square, gx.State(square.zeros(), v), 20.0, step=0.05)
    line = gx.simulate(chain, gx.states.impact(chain, 0.2), 20.0, step=0.05)
    assert np.abs(np.asarray(flat.final.u)[..., 0] - np.asarray(line.final.u)[:, None]).max() < 1e-12
    assert np.abs(np.asarray(flat.final.u)[..., 1]).max() == 0


def test_outlines():
    rows = scenes.triangular(5, 4, outline="rectangle", boundary="free")
    x = np.asarray(rows.positions)
    assert len(x) == 20 and np.ptp(x[:, 0]) == 4.5 and abs(np.ptp(x[:, 1]) - 3 * 0.75**0.5) < 1e-12
    disk = scenes.honeycomb(9, outline=lambda p: np.hypot(p[..., 0] - 11, p[..., 1] - 6) < 4.1, out_of_plane=True)
    assert disk.shape["a"] != (9, 9) and abs(disk.shape["a"][0] - disk.shape["b"][0]) < 6
    modes = np.asarray(gx.linear.normal_modes(disk).omega_squared)
    assert modes[0] > 0 and modes[-1] < 6
    for wrong, words in ((dict(outline="circle"), "outline"), (dict(outline="hexagon"), "cells are square"),
                         (dict(boundary=("fixed",)), "boundary"), (dict(rotation=True, out_of_plane=True), "rotation"),
                         (dict(tangential=1.0), "tangential"), (dict(rotation=True, exponent=1.5), "tangential")):
        with pytest.raises(ValueError, match=words):
            scenes.square(4, **wrong)


def test_lanes_derivatives_and_si():
    make = lambda f: scenes.triangular(4, 4, precompression=f, boundary="periodic", spacing=1.0)
    batch = jax.vmap(make, out_axes=-1)(jnp.array([0.02, 0.1]))
    assert batch.lanes == (2,)
    u = 0.01 * RNG.normal(size=(4, 4, 2))
    both = batch.force(0.0, jnp.stack([u, u], -1), jnp.zeros((4, 4, 2, 2)))
    for i, f in enumerate((0.02, 0.1)):
        assert np.abs(both[..., i] - make(f).force(0.0, u, 0 * u)).max() < 1e-15
    at_K = lambda f: gx.linear.dispersion(scenes.triangular(6, 6, precompression=f, boundary="periodic"), K)
    slope = jax.grad(lambda f: at_K(f).omega_squared.sum())(0.1)
    assert abs(slope + 9) < 1e-9
    A = float(gx.materials.hertz_coefficient("steel 316", 5e-3))
    steel = scenes.hexagon(1, mass=4.2e-3, stiffness=A, exponent=1.5, precompression=20.0, spacing=1e-2, units="SI")
    assert steel.units == "SI" and abs(np.ptp(np.asarray(steel.positions)[:, 0]) - 0.02) < 1e-15
    plain, units = gx.scenes.scaled(steel)
    want = np.asarray(gx.linear.normal_modes(steel).omega)
    assert np.abs(np.asarray(gx.linear.normal_modes(plain).omega) / float(units.time) / want - 1).max() < 1e-12


def test_forces_between_beads_and_what_slips():
    crystal = scenes.hexagon(1, precompression=0.5, rotation=True, tangential=0.4, boundary="free")
    network = gx.measures.force_network(crystal, gx.states.rest(crystal))
    assert network.segments.shape == (12, 2, 2) and np.abs(network.force - 0.5).max() < 1e-15
    assert np.abs(np.linalg.norm(network.segments[:, 1] - network.segments[:, 0], axis=-1) - 1).max() < 1e-14
    u = np.zeros(crystal.shape)
    u[3, 2] = 0.25
    assert abs(float(gx.measures.slip_ratio(crystal, gx.State(u, 0 * u))) - 0.4 * 0.25 / 0.5) < 1e-14
    with pytest.raises(ValueError, match="rotation=True"):
        gx.measures.slip_ratio(scenes.square(3), gx.states.rest(scenes.square(3)))


@pytest.mark.slow
def test_two_equal_branches_are_one_chain():
    fork = scenes.junction(6, (9, 9))
    mass, A = np.r_[np.ones(6), 2 * np.ones(9)], np.r_[np.ones(6), 2 * np.ones(10)]
    chain = scenes.monomer(15, mass=mass, stiffness=A)
    runs = [gx.simulate(x, gx.states.impact(x, 0.3), 25.0, step=0.05) for x in (fork, chain)]
    both, one = (np.asarray(run.final.u) for run in runs)
    assert np.abs(both[:15] - one).max() < 1e-12 and np.abs(both[15:] - one[6:]).max() < 1e-12 and one[12] > 1e-3
    turned = scenes.junction(6, (9, 9), angles=(0.4, -0.4))
    run = gx.simulate(turned, gx.states.impact(turned, 0.3), 25.0, step=0.05, save_at=2)
    assert float(run.energy_error) < 1e-6 and np.abs(np.asarray(run.final.u)[12] - one[12]) > 1e-3
    with pytest.raises(ValueError, match="backwards"):
        scenes.junction(6, (9,), angles=(1.6,))


def test_a_packing_of_steel_beads():
    crystal = scenes.packing("steel 316", 5e-3, 7, 7, 30.0, boundary="periodic", rotation=True)
    body = gx.materials.material("steel 316")
    A, nu = float(gx.materials.hertz_coefficient(body, 5e-3)), float(body.poisson)
    K2 = 1.5 * A ** (2 / 3) * 30.0 ** (1 / 3)
    m = float(gx.materials.bead_mass(body, 5e-3))
    want = np.linalg.eigvalsh(hexagonal_matrix(K, K2, 30.0 / 1e-2, 2 * (1 - nu) / (2 - nu) * K2, 0.4)) / m
    assert np.abs(squares(crystal, K) / want - 1).max() < 1e-11 and crystal.units == "SI"
    with pytest.raises(ValueError, match="slide"):
        scenes.packing("steel 316", 5e-3, 7, rotation=True)


@pytest.mark.slow
def test_a_front_is_a_solitary_wave_in_a_row_of_a_square_and_spreads_in_a_hexagon():
    speed = lambda t, y, lattice: jnp.linalg.norm(y.v, axis=-1)

    def decay(crystal, site, until, **options):
        run = gx.simulate(crystal, gx.states.impact(crystal, [0.3, 0.0], site=site), until,
                          record={"peak": gx.Peak(speed)})
        return gx.measures.front_decay(crystal, run.recorded["peak"], site, **options)

    # a row in touch with its neighbours alone, past the first beads
    row = decay(scenes.square(25, exponent=1.5), (2, 12), 40.0, direction=[1.0, 0.0], between=(5.0, 18.0))
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
    with pytest.raises(ValueError, match="four distances"):
        gx.measures.front_decay(hexagon, exact, 108, between=(0.01, 0.05))


def test_complex_wave_numbers():
    chain = scenes.monomer(12, precompression=1.0, boundary="periodic")
    omega = np.array([1.0, 2.0, 3.0])
    found = gx.linear.complex_bands(chain, omega)
    cosine = 1 - omega**2 / 3
    assert np.abs(np.cos(np.asarray(found.k)) - cosine[:, None]).max() < 1e-12 and np.nanmax(found.residual) < 1e-14
    assert np.abs(found.decay - np.arccosh(np.maximum(np.abs(cosine), 1))).max() < 1e-7
    plane = gx.linear.complex_bands(scenes.triangular(6, 6, boundary="periodic"), 3.0, across=0.7)
    k = complex(np.asarray(plane.k)[0, 0])
    n = np.array([[np.cos(a), np.sin(a)] for a in (0, np.pi / 3, 2 * np.pi / 3)])
    D = sum(2 * (1 - np.cos(p)) * np.outer(x, x) for x, p in zip(n, (k, 0.7, 0.7 - k)))
    assert abs(np.linalg.det(D - 9 * np.eye(2))) < 1e-10 and plane.decay[0] > 0.1
