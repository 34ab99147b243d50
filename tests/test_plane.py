"""Lattices of the plane by name: bands against closed forms, momenta, walls, outlines, beads that turn."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose
from refusals import refused

import granjax as gx
from granjax import linear, materials, measures, plots, scenes, states, strains
from granjax.flow.remarks import passing
from granjax.flow.steps import frequency_bound

K = np.array([2 * np.pi / 3, 4 * np.pi / 3])
M = np.array([np.pi, 0.0])
RNG = np.random.default_rng(7)
PHASES = RNG.uniform(-np.pi, np.pi, (5, 2))


def squares(lattice, k):
    return linear.dispersion(lattice, k).omega_squared


def modes(lattice):
    return linear.normal_modes(lattice).omega


def force(lattice, u):
    return np.asarray(lattice.force(0.0, u, 0 * u))


def off(found, want):
    """The largest difference."""
    return np.abs(np.asarray(found) - want).max()


# ---------------------------------------------------------------------------------------------------- bands, outlines


@pytest.mark.slow
@pytest.mark.parametrize("f", [0.0, 0.1])
def test_a_loaded_triangular_lattice_has_its_frequencies_at_the_corner_and_the_middle(f):
    crystal = scenes.triangular(8, 8, precompression=f, boundary="periodic")
    want = [[4.5 * (1 - f)] * 2, [2 - 6 * f, 6 - 2 * f]]
    assert off(squares(crystal, np.stack([K, M])), want) < 1e-12


@pytest.mark.slow
def test_honeycomb_lieb_and_kagome_have_their_bands_out_of_plane():
    c = np.cos(PHASES / 2)
    honeycomb = scenes.honeycomb(6, out_of_plane=True, boundary="periodic")
    h = np.abs(1 + np.exp(1j * PHASES).sum(1))
    assert off(squares(honeycomb, PHASES), np.stack([3 - h, 3 + h], -1)) < 1e-12
    assert off(squares(honeycomb, K), 3) < 1e-12
    lieb = squares(scenes.lieb(6, boundary="periodic", ground=0.3), PHASES)
    wide = 2 * np.sqrt((c**2).sum(1))
    assert off(lieb, 4.3 + np.stack([-wide, 0 * wide, wide], -1)) < 1e-12
    kagome = squares(scenes.kagome(6, out_of_plane=True, boundary="periodic"), PHASES)
    root = np.sqrt(4 * ((c**2).sum(1) + np.cos((PHASES[:, 0] - PHASES[:, 1]) / 2) ** 2) - 3)
    assert off(kagome, 4 - np.stack([1 + root, 1 - root, -2 + 0 * root], -1)) < 1e-12


def test_complex_wave_numbers_solve_the_chain_and_the_triangular_lattice():
    chain = scenes.monomer(12, precompression=1.0, boundary="periodic")
    omega = np.array([1.0, 2.0, 3.0])
    found = linear.complex_bands(chain, omega)
    cosine = 1 - omega**2 / 3
    assert off(np.cos(np.asarray(found.k)), cosine[:, None]) < 1e-12
    assert np.nanmax(found.residual) < 1e-14
    assert off(found.decay, np.arccosh(np.maximum(np.abs(cosine), 1))) < 1e-7
    plane = linear.complex_bands(scenes.triangular(6, 6, boundary="periodic"), 3.0, across=0.7)
    k = complex(np.asarray(plane.k)[0, 0])
    n = np.array([[np.cos(a), np.sin(a)] for a in (0, np.pi / 3, 2 * np.pi / 3)])
    D = sum(2 * (1 - np.cos(p)) * np.outer(x, x) for x, p in zip(n, (k, 0.7, 0.7 - k)))
    assert abs(np.linalg.det(D - 9 * np.eye(2))) < 1e-10 and plane.decay[0] > 0.1


def test_no_wave_travels_where_none_is_found():
    """At its resonance the effective mass of a site is infinite; near it cos k = 1 - M omega^2/(2 K), K = 3/2."""
    omega = np.array([1.9, 2.0, 2.1])
    lattice = scenes.mass_in_mass(20, 0.5, 2.0, precompression=1.0)
    found = linear.complex_bands(lattice, omega)
    mass = 1 + 2 / (4 - omega[::2] ** 2)
    kappa = np.arccosh(np.abs(1 - mass * omega[::2] ** 2 / 3))
    np.testing.assert_allclose(found.decay, [kappa[0], np.inf, kappa[1]], rtol=1e-12)
    assert found.outcome == "Wave numbers of 3 frequencies; at 3 of them every wave decays."
    alone = linear.complex_bands(lattice, 2.0)
    assert alone.decay == np.inf and plots.complex_bands(alone).collections


def test_a_determinant_without_the_wave_number_has_no_waves():
    """At the phase pi across, the two bonds of a honeycomb's site to its neighbours along the axis cancel."""
    found = linear.complex_bands(scenes.honeycomb(6, boundary="periodic"), [0.9, 1.7], across=np.pi)
    assert np.all(found.decay == np.inf)
    # a real wave that decays nearly as fast as is told: cosh(kappa) = omega^2/2 - 1
    bond = gx.Bond(gx.Shift(1), gx.Linear(1.0))
    fast = linear.complex_bands(gx.Lattice(1.0, [bond], sites=8), 2 * np.cosh(13.5 / 2))
    assert_allclose(fast.decay, 13.5, rtol=1e-12)


def test_outlines_select_sites():
    rows = scenes.triangular(5, 4, outline="rectangle", boundary="free")
    wide, high = np.ptp(np.asarray(rows.positions), axis=0)
    assert rows.shape == (20, 2) and wide == 4.5 and abs(high - 3 * 0.75**0.5) < 1e-12
    inside = lambda p: np.hypot(p[..., 0] - 11, p[..., 1] - 6) < 4.1
    disk = scenes.honeycomb(9, outline=inside, out_of_plane=True)
    assert disk.shape["a"] != (9, 9) and abs(disk.shape["a"][0] - disk.shape["b"][0]) < 6
    modes = np.asarray(linear.normal_modes(disk).omega_squared)
    assert modes[0] > 0 and modes[-1] < 6


@pytest.mark.parametrize(
    "make, centre, kept, bonds, walls",
    [
        # a square of nine beads is left out of 81
        (scenes.square, [4.0, 4.0], lambda x: np.abs(x).max(-1) > 1.2, 144 - 12 - 12, 36),
        # of a hexagon of 19 beads one beside the middle is left out
        (
            scenes.triangular,
            [6.0, 4 * 0.75**0.5],
            lambda x: (
                (np.linalg.norm(x, axis=-1) < 2.2) & (np.linalg.norm(x - [1.0, 0], axis=-1) > 0.1)
            ),
            42 - 6,
            6 * 19 - 2 * 42,
        ),
    ],
)
def test_a_hole_of_an_outline_is_empty(make, centre, kept, bonds, walls):
    outline = lambda x: kept(x - centre)
    crystal, free = (make(9, exponent=1.5, outline=outline, boundary=b) for b in ("fixed", "free"))
    pairs = [t.strain_map.pairs for t in crystal.terms]
    at_wall = (np.concatenate([[x.tail, x.head] for x in pairs], 1) == -1).any(0)
    assert at_wall.sum() == walls and (~at_wall).sum() == bonds
    assert sum(len(t.strain_map.pairs.tail) for t in free.terms) == bonds
    if make is scenes.square:
        # a bead beside the hole moves into it against nothing
        x = np.asarray(crystal.positions)
        near = np.argmin(np.linalg.norm(x - centre, axis=1))
        u = np.zeros(crystal.shape)
        u[near] = 1e-3 * (centre - x[near])
        assert not force(crystal, u)[near].any()


def test_a_hole_of_a_honeycomb_with_a_slit_to_the_rim_is_part_of_it():
    whole = lambda x: np.ones(x.shape[:-1], bool)
    x0 = np.array([12.990381, 8.0])
    hole = lambda x: np.linalg.norm(x - x0, axis=-1) > 1.2
    slit = lambda x: hole(x) & ~((np.abs(x[..., 0] - x0[0]) < 1.0) & (x[..., 1] < x0[1]))
    count = lambda outline: sum(
        np.sum(np.equal([t.strain_map.tail, t.strain_map.head], -1))
        for t in scenes.honeycomb(7, outline=outline, out_of_plane=True).terms
    )
    assert count(hole) == count(whole) < count(slit)


# ------------------------------------------------------------------------------------------------------------- runs


def test_a_struck_hexagon_is_pushed_as_by_all_distances():
    crystal = scenes.hexagon(2, exponent=1.5)
    x = np.asarray(crystal.positions)
    # beads at rest all around
    grid = [np.array([i + j / 2, j * 0.75**0.5]) for i, j in np.ndindex(9, 9)]
    rim = [p for p in grid + x[9] - grid[40] if np.linalg.norm(p - x, axis=1).min() > 1e-6]
    every = np.concatenate([x, rim])
    apart = np.linalg.norm(x[:, None] - every, axis=-1)
    own, other = np.nonzero((apart > 0.5) & (apart < 1.5))
    assert crystal.shape == (19, 2) and off(apart[own, other], 1) < 1e-12 and len(own) == 6 * 19
    for _ in range(3):
        u = 0.1 * RNG.normal(size=(19, 2))
        at = every.copy()
        at[:19] += u
        D = at[own] - at[other]
        length = np.linalg.norm(D, axis=1)
        pull = np.zeros((19, 2))
        np.add.at(pull, own, (np.maximum(1 - length, 0) ** 1.5 / length)[:, None] * D)
        assert off(force(crystal, u), pull) < 1e-14


@pytest.mark.slow
def test_a_power_of_the_distance_is_found_with_its_error():
    hexagon = scenes.hexagon(8, spacing=0.02)
    places = np.asarray(hexagon.positions)
    r = np.linalg.norm(places - places[108], axis=1)
    exact = np.where(r > 0, r, 1.0) ** -0.7
    found = measures.front_decay(hexagon, exact, 108, direction=[1.0, 0.0])
    assert abs(float(found.exponent) + 0.7) < 1e-12 and abs(float(found.drift)) < 1e-12
    assert off(found.distance, 0.02 * np.arange(1, 9)) < 1e-15
    assert "Amplitude ~ distance^(-0.7" in found.outcome
    noise = np.exp(0.1 * RNG.normal(size=(60, r.size)))
    many = [measures.front_decay(hexagon, exact * x, 108, direction=[1.0, 0.0]) for x in noise]
    # the standard error is the scatter over draws
    scatter = np.std([float(x.exponent) for x in many])
    assert 0.7 < np.mean([float(x.error) for x in many]) / scatter < 1.4


@pytest.mark.slow
def test_beads_that_a_front_has_not_reached_have_no_weight_in_its_decay():
    """As numbers, under derivatives and within `jax.jit` alike."""
    square = scenes.square(13)
    r = np.linalg.norm(np.asarray(square.positions) - np.asarray(square.positions)[6, 6], axis=-1)
    amplitude = np.where(r > 0, np.maximum(r, 0.1) ** -0.7, 0)
    amplitude[(np.arange(13) % 2 == 0)[:, None] & (r > 3) & (r < 5)] = 0
    exponent = lambda a: measures.front_decay(square, a, (6, 6)).exponent
    plain = exponent(jnp.asarray(amplitude))
    value, slope = jax.value_and_grad(exponent)(jnp.asarray(amplitude))
    assert value == plain and off(jax.jit(exponent)(amplitude), plain) < 1e-14
    assert np.isfinite(slope).all() and (slope[amplitude == 0] == 0).all()


@pytest.mark.slow
def test_rings_that_a_front_has_not_reached_have_no_weight_in_its_decay():
    square = scenes.square(9, boundary="free")
    r = np.linalg.norm(np.asarray(square.positions) - np.asarray(square.positions)[4, 4], axis=-1)
    amplitude = jnp.where((r > 0) & (r < 4.6), np.maximum(r, 0.5) ** -0.5, 0.0)
    decay = lambda a: measures.front_decay(square, a, (4, 4))
    plain = decay(amplitude)
    within = jax.jit(decay)(amplitude)
    for name in ("exponent", "error", "drift"):
        assert off(getattr(within, name), getattr(plain, name)) < 1e-13
    assert within.distance.size == 6 and off(within.distance[:4], plain.distance) < 1e-15
    assert np.isnan(within.amplitude[4:]).all() and np.isnan(within.distance[4:]).all()
    exponent = lambda a: decay(a).exponent
    assert off(jax.jit(jax.grad(exponent))(amplitude), jax.grad(exponent)(amplitude)) < 1e-14


@pytest.mark.slow
def test_films_show_stored_runs_and_draw_on_given_axes(tmp_path):
    crystal = scenes.hexagon(1, exponent=1.5)
    start = states.impact(crystal, [0.1, 0.0], site=3)
    run = gx.simulate(crystal, start, 1.0, step=0.1, save_at=3)
    run.save(tmp_path / "run.nc")
    left, right = plots.figure(6.0, 2.0).subplots(1, 2)
    for film in (
        plots.film(xr.load_dataset(tmp_path / "run.nc"), crystal),
        plots.film(run, crystal, ax=right),
    ):
        assert plots.save(film, tmp_path / "run.gif", dpi=20).stat().st_size > 1000
    assert not left.collections and len(right.collections[0].get_offsets()) == 7


# --------------------------------------------------------------------------------------------------- beads that turn


def hexagonal_matrix(k, K2, f, kt):
    """Triangular packing of spheres that turn: of each line of contacts K2 n n - f t t, and the slip's kt."""
    D = np.zeros((3, 3), complex)
    spin = np.array([0, 0, 1.0])
    for angle, phase in ((0.0, k[0]), (np.pi / 3, k[1]), (2 * np.pi / 3, k[1] - k[0])):
        normal = np.array([np.cos(angle), np.sin(angle), 0])
        sideways = np.array([-np.sin(angle), np.cos(angle), 0])
        held = K2 * np.outer(normal, normal) - f * np.outer(sideways, sideways)
        # slip = s_1 + s_2 - t . (u_2 - u_1)
        slip = spin + sideways + np.exp(1j * phase) * (spin - sideways)
        D += 2 * (1 - np.cos(phase)) * held + kt * np.outer(slip.conj(), slip)
    scale = 1 / np.sqrt([1, 1, 0.4])
    return scale[:, None] * D * scale


@pytest.mark.slow
def test_bands_of_beads_that_turn_are_those_of_a_matrix_by_hand():
    A = 1.3
    F0 = 0.2
    kt = 0.7
    how = {"rotation": True, "boundary": "periodic"}
    crystal = scenes.triangular(
        7, 7, stiffness=A, exponent=1.5, precompression=F0, tangential=kt, **how
    )
    K2 = 1.5 * A ** (2 / 3) * F0 ** (1 / 3)
    for k in (0 * K, K, PHASES[0]):
        want = np.linalg.eigvalsh(hexagonal_matrix(k, K2, F0, kt))
        assert off(squares(crystal, k), want) < 1e-12 * 20
    steel = scenes.packing("steel 316", 5e-3, 7, 7, 30.0, **how)
    body = materials.material("steel 316")
    A = float(materials.hertz_coefficient(body, 5e-3))
    nu = float(body.poisson)
    K2 = 1.5 * A ** (2 / 3) * 30.0 ** (1 / 3)
    by_hand = hexagonal_matrix(K, K2, 30.0 / 1e-2, 2 * (1 - nu) / (2 - nu) * K2)
    want = np.linalg.eigvalsh(by_hand) / float(materials.bead_mass(body, 5e-3))
    assert off(squares(steel, K) / want, 1) < 1e-11 and steel.units == "SI"


@pytest.mark.slow
@pytest.mark.parametrize("kb, F0, pull", [(0.1, 0.02, 0.02), (0.8, 0.05, 0.0), (0.0, 0.01, 0.03)])
def test_a_chain_of_beads_that_turn_has_the_bands_of_its_closed_form(kb, F0, pull):
    A = 1.3
    kt = 0.9
    J = 0.4
    L = 1.7
    m = 1.2
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
    k = PHASES[:, 0]
    f = (F0 - pull) / L
    c = np.cos(k)
    along = 2 * 1.5 * A ** (2 / 3) * F0 ** (1 / 3) * (1 - c)
    a = 2 * (kt - f) * (1 - c)
    b = 2 * kt * np.sin(k) / J**0.5
    d = (2 * kt * (1 + c) + 2 * kb * (1 - c)) / J
    root = np.sqrt(((a - d) / 2) ** 2 + b**2)
    want = np.sort(np.stack([along, (a + d) / 2 - root, (a + d) / 2 + root], 1), 1) / m
    assert off(squares(chain, k), want) < 1e-12


@pytest.mark.slow
def test_a_wave_of_turning_beads_stands_and_a_pressed_chain_buckles():
    kt = 1.0
    kb = 0.8
    J = 0.4
    make = lambda sites, **how: scenes.rotating_chain(sites, tangential=kt, bending=kb, **how)
    D = kb - (1 - J) * kt
    k = np.arccos(1 - 4 * kt * D / (4 * J * kt * kb - D**2))
    chain = make(9, attraction=0.01, boundary="periodic")
    before, at, after = linear.dispersion(chain, [k - 0.1, k, k + 0.1]).group_velocity[:, 2]
    assert before > 1e-3 and abs(at) < 1e-12 and after < -1e-3
    lowest = lambda pull: float(
        linear.normal_modes(make(30, precompression=0.1, attraction=pull)).omega_squared[0]
    )
    assert lowest(0.0) < -1e-4 and lowest(0.1) > 0


def turned(x, angle, radius=0.5):
    """Displacements of a rigid rotation of places (N, 2) of beads, which turn with it."""
    c = np.cos(angle)
    s = np.sin(angle)
    spin = np.full((len(x), 1), radius * angle)
    return np.concatenate([x @ np.array([[c, s], [-s, c]]) - x, spin], 1)


@pytest.mark.slow
def test_beads_that_turn_keep_both_momenta():
    crystal = scenes.hexagon(2, rotation=True, tangential=0.3, boundary="free")
    v = 0.1 * RNG.normal(size=crystal.shape) + [0, 0, 0.1]
    start = gx.State(crystal.zeros(), v)
    run = gx.simulate(crystal, start, 10.0, solver=gx.SRKN11b(), step=0.05, save_at=3)
    # sum m r x v + m_theta R s' of each frame
    p = np.asarray(crystal.mass * run.vs)
    r = np.asarray(crystal.positions + run.us[..., :2])
    turning = (r[..., 0] * p[..., 1] - r[..., 1] * p[..., 0] + p[..., 2] / 2).sum(-1)
    assert np.ptp(turning) < 1e-13 and abs(turning[0]) > 0.1
    assert np.ptp(p[..., :2].sum(1), axis=0).max() < 1e-13
    assert float(run.energy_error) < 1e-8


@pytest.mark.slow
def test_a_free_chain_of_beads_that_turn_and_attract_turns_as_a_whole_at_no_cost():
    load = {"precompression": 0.05, "attraction": 0.05}
    chain = scenes.rotating_chain(
        8, tangential=0.3, bending=0.2, boundary="free", spacing=1.4, **load
    )
    u = turned(np.asarray(chain.positions), 0.7, radius=0.7)
    assert abs(float(chain.potential_energy(0.0, u))) < 1e-15
    assert np.abs(force(chain, u)).max() < 1e-14
    assert np.abs(np.asarray(chain.unbalanced())).max() < 1e-15


@pytest.mark.slow
@pytest.mark.parametrize("angle", [0.7, 3.3, -8.0, 40.0])
def test_a_rotation_by_any_angle_slips_nowhere_and_slip_is_signed(angle):
    crystal = scenes.hexagon(1, rotation=True, tangential=0.3, boundary="free")
    slip = crystal.terms[1].strain_map
    u = turned(np.asarray(crystal.positions), angle)
    assert np.abs(slip.strain(u)).max() < 1e-13
    assert float(crystal.potential_energy(0.0, u)) < 1e-25
    assert np.abs(force(crystal, u)).max() < 1e-14
    # one bead turned by more: each of its contacts slips by as much, either way
    of_three = (np.array([slip.pairs.tail, slip.pairs.head]) == 3).any(0)
    for more in (0.2, -0.2):
        one = u.copy()
        one[3, 2] += more
        assert off(slip.strain(one), more * of_three) < 1e-13


@pytest.mark.slow
def test_slip_of_beads_that_circle_each_other_is_continuous_in_time():
    """Against the angle unwrapped over time, over three turns: one bead rolls around another that turns slowly."""
    slip = strains.Slip(gx.Shift(1, "free"), (1.0, 0.0))
    t = np.linspace(0, 1, 400)
    angle = 6 * np.pi * t
    own = np.stack([2 * np.pi * t, 3.7 * np.pi * t + 0.2 * np.sin(9 * t)])
    at = np.stack([np.cos(angle), np.sin(angle)])
    u = np.zeros((2, 3, len(t)))
    u[1, :2] = at - np.array([[1.0], [0.0]])
    u[:, 2] = own
    phi = np.unwrap(np.arctan2(at[1], at[0]))
    assert off(np.asarray(slip.strain(u))[0], own.sum(0) - phi) < 1e-12


@pytest.mark.slow
def test_forces_between_beads_and_what_slips():
    crystal = scenes.hexagon(1, precompression=0.5, rotation=True, tangential=0.4, boundary="free")
    # in guides contacts are drawn between beads, whatever their weights
    fork = scenes.junction(6, (9, 9), angles=(0.4, -0.4), precompression=0.5, boundary="free")
    for lattice, bonds in ((crystal, 12), (fork, 23)):
        network = measures.force_network(lattice, states.rest(lattice))
        assert network.segments.shape == (bonds, 2, 2) and off(network.force, 0.5) < 1e-15
        along = network.segments[:, 1] - network.segments[:, 0]
        assert off(np.linalg.norm(along, axis=-1), 1) < 1e-14
    u = np.zeros(crystal.shape)
    u[3, 2] = 0.25
    ratio = float(measures.slip_ratio(crystal, gx.State(u, 0 * u)))
    assert abs(ratio - 0.4 * 0.25 / 0.5) < 1e-14


@pytest.mark.slow
def test_pictures_of_forces_hold_all_bonds_with_a_site_and_no_others():
    nodes = {"a": (0, 0), "b": (10, 0), "c": (13, 0)}
    edges = [("a", "b"), ("b", "c")]
    chains = scenes.network(nodes, edges, (5, 20), precompression=1.0)
    square = scenes.square(5)
    moved = gx.State(square.zeros().at[2, 2, 0].set(0.7), square.zeros())
    # of the 40 bonds of a triangular lattice and its walls two touch no bead, at corners
    corners = scenes.triangular(3, 3, precompression=0.1)
    for lattice, y, bonds in (
        (chains, states.rest(chains), 24),
        (square, moved, 60),
        (corners, states.rest(corners), 38),
    ):
        assert measures.force_network(lattice, y).force.shape == (bonds,)
    # rings of scalar displacements: in rows, unevenly spaced, in a circle
    rows = scenes.triangular(3, 3, out_of_plane=True, boundary="periodic")
    assert measures.force_network(rows, states.rest(rows)).force.shape == (6 + 6 + 4,)
    angle = np.pi / 4 * np.arange(8)
    circle = np.stack([np.cos(angle), np.sin(angle)], -1)
    for places, bonds in (np.array([[0.0], [1.0], [2.0], [9.0]]), 3), (circle, 8):
        bond = gx.Bond(gx.Shift(1, "periodic"), gx.Linear())
        ring = gx.Lattice(1.0, bond, sites=len(places), positions=places)
        assert measures.force_network(ring, states.rest(ring)).force.shape == (bonds,)


@pytest.mark.slow
def test_drawn_forces_balance_on_every_bead_of_a_packing_at_rest():
    radii = 5e-3 + 1e-6 * np.random.default_rng(0).uniform(-1, 1, (4, 5))
    beads = scenes.packing("steel 316", radii, 4, 5, precompression=20.0)
    lines, force = measures.force_network(beads, states.rest(beads))
    lines = np.asarray(lines)
    along = lines[:, 1] - lines[:, 0]
    push = np.asarray(force)[:, None] * along / np.linalg.norm(along, axis=1)[:, None]
    for place in np.asarray(beads.positions).reshape(-1, 2):
        tail, head = (np.linalg.norm(lines[:, i] - place, axis=1) < 1e-3 for i in (0, 1))
        assert (tail | head).sum() == 6
        assert np.abs(push[head].sum(0) - push[tail].sum(0)).max() < 1e-9


class Crossed(gx.StrainMap):
    """A strain of the first component alone."""

    def strain(self, u):
        return u[:-1, :, 0] - u[1:, :, 0]


def test_a_picture_of_forces_needs_bonds_with_two_ends():
    places = np.stack(np.meshgrid(np.arange(3.0), np.arange(3.0), indexing="ij"), -1)
    for term in gx.Bond(Crossed(), gx.Linear()), gx.OnSite(gx.Linear()):
        lattice = gx.Lattice(1.0, term, sites=(3, 3), dimension=2, positions=places)
        with refused("lattice: expected bonds of gx.Shift, gx.Stretch or gx.Pairs"):
            measures.force_network(lattice, states.rest(lattice))


@pytest.mark.slow
def test_the_default_step_of_beads_that_turn_is_that_of_their_highest_mode():
    crystal = scenes.packing("steel 316", 5e-3, 2, 2, 20.0, rotation=True, outline="hexagon")
    highest = float(modes(crystal).max())
    bound = lambda state: float(frequency_bound(crystal, state, 0.0, 1e-5))
    assert highest <= bound(states.rest(crystal)) < 2 * highest
    # one bead alone may go anywhere along a contact without slipping, and through its neighbour
    assert highest < bound(states.impact(crystal, [1e-3, 0.0, 0.0], site=9)) < 2 * highest


def gripped(s, overlap, k):
    """Slopes by slip and by overlap of (k/2) s^2, and of (k/2) a^2 z^3 (10 - 15 z + 6 z^2) for z = overlap/|s| < 1."""
    if overlap <= 0:
        return 0.0, 0.0
    if abs(s) <= overlap:
        return k * s, 0.0
    a = abs(s)
    z = overlap / a
    by_slip = k / 2 * s * (-10 * z**3 + 30 * z**4 - 18 * z**5)
    return by_slip, k / 2 * a * (30 * z**2 - 60 * z**3 + 30 * z**4)


@pytest.mark.slow
def test_turning_beads_push_slip_roll_and_let_go_as_by_hand():
    kt = 0.5
    kb = 0.2
    F0 = 0.002
    chain = scenes.rotating_chain(
        3, precompression=F0, tangential=kt, bending=kb, boundary="free", inertia=0.5
    )
    open_ones = []
    rng = np.random.default_rng(7)

    def by_hand(u):
        """Forces, and the largest |T|/N."""
        pull = np.zeros((3, 3))
        ratios = []
        # the loads that are held at the ends
        pull[[0, 2], 0] = F0, -F0
        for n in (0, 1):
            D = np.array([1.0, 0.0]) + u[n + 1, :2] - u[n, :2]
            length = np.hypot(*D)
            along = D / length
            across = np.array([-D[1], D[0]]) / length
            overlap = F0 ** (2 / 3) + 1 - length
            push = max(overlap, 0) ** 1.5
            T, N = gripped(u[n, 2] + u[n + 1, 2] - np.arctan2(D[1], D[0]), overlap, kt)
            moment, more = gripped(u[n, 2] - u[n + 1, 2], overlap, kb)
            on_head = (push + N + more) * along + T / length * across
            pull[n + 1, :2] += on_head
            pull[n, :2] -= on_head
            pull[[n, n + 1], 2] -= T + moment, T - moment
            open_ones.append(overlap <= 0)
            ratios.append(abs(T) / push if push else 0)
        return pull, max(ratios)

    for size in np.repeat([1e-3, 5e-3, 0.02, 0.1], 6):
        u = size * rng.normal(size=(3, 3))
        want, most = by_hand(u)
        assert off(force(chain, u), want) < 1e-15
        ratio = float(measures.slip_ratio(chain, gx.State(u, 0 * u)))
        assert abs(ratio - most) < 1e-12 * max(most, 1)
    assert 5 < sum(open_ones) < 40


class Cubic(gx.Law):
    k: jax.Array

    def force(self, e):
        return self.k * e**3

    def energy(self, e):
        return self.k * e**4 / 4


@pytest.mark.slow
@pytest.mark.parametrize(
    "exponent, F0, tangential", [(1.5, 0.0, 0.4), (2.5, 0.01, 0.4), (1.5, 0.01, Cubic(2.0))]
)
def test_derivatives_of_a_contact_that_lets_go_are_numbers(exponent, F0, tangential):
    chain = scenes.rotating_chain(
        3, exponent=exponent, precompression=F0, tangential=tangential, bending=0.1
    )
    d0 = F0 ** (1 / exponent)
    energy = lambda u: chain.potential_energy(0.0, u)
    pull = jax.jit(lambda u: chain.force(0.0, u, 0 * u))
    slope = jax.jit(jax.jacfwd(pull))
    middle = ([0.0, 0, 0], [-d0 - 0.1, 0, 0.3], [0.0, 0, d0], [-d0, 0, 0.0])
    held = [np.pad([x], ((1, 1), (0, 0))) for x in middle]
    for u in (*held, 0.2 * RNG.normal(size=(3, 3))):
        assert np.isfinite(slope(u)).all() and np.isfinite(pull(u)).all()
        step = 1e-6 * RNG.normal(size=u.shape)
        work = float(energy(u + step) - energy(u - step)) / 2
        assert abs(work + float((pull(u) * step).sum())) < 1e-9 * 1e-2


# ---------------------------------------------------------------------------------------------------------- networks


def turned_tree(depth, beads, angle):
    """Nodes and edges of a binary tree whose branches leave at +-angle of their stem."""
    nodes = [(0.0, 0.0), (beads, 0.0)]
    edges = [(0, 1)]
    ways = {1: 0.0}
    for level in range(1, depth + 1):
        for node in range(2 ** (level - 1), 2**level):
            for way in (ways[node] + angle, ways[node] - angle):
                ways[len(nodes)] = way
                edges.append((node, len(nodes)))
                nodes.append(nodes[node] + beads * np.array([np.cos(way), np.sin(way)]))
    return np.array(nodes), edges


@pytest.mark.slow
def test_a_network_of_three_guides_in_space_is_a_junction():
    angle = 0.4
    turn = np.linalg.qr(RNG.normal(size=(3, 3)))[0]
    out = [
        [np.cos(angle), np.sin(angle) * np.cos(x), np.sin(angle) * np.sin(x)] for x in (0.3, 2.5)
    ]
    nodes = np.array([[0, 0, 0], [6, 0, 0], *([6, 0, 0] + 9 * np.array(out))]) @ turn
    named = dict(zip("abcd", nodes))
    u = RNG.normal(size=24)
    for where, edges, boundary in (
        (nodes, [(0, 1), (1, 2), (1, 3)], "fixed"),
        (named, ["ab", "bc", "bd"], "free"),
    ):
        net = scenes.network(where, edges, (6, 9, 9), boundary=boundary)
        fork = scenes.junction(6, (9, 9), angles=(angle, -angle), boundary=boundary)
        assert off(force(net, u), force(fork, u)) < 2e-15
    steps = np.diff(np.asarray(net.positions)[:6], axis=0)
    assert net.positions.shape == (24, 3) and off(np.linalg.norm(steps, axis=1), 1) < 1e-14


@pytest.mark.slow
def test_a_network_may_be_read_backwards_and_guides_may_cross():
    nodes, edges = turned_tree(2, 5, 0.3)
    net = scenes.network(nodes, edges, 5)
    back = scenes.network(nodes, [(head, tail) for tail, head in edges], 5)
    u = RNG.normal(size=35)
    # all ends but the first and the last of each guide change their roles
    flip = lambda x: -np.asarray(x).reshape(7, 5)[:, ::-1].ravel()
    assert off(flip(force(back, flip(u))), force(net, u)) < 1e-14
    # two guides through one node at right angles pass through each other
    corners = [[-1, 0], [0, 0], [1, 0], [0, -1], [0, 1]]
    cross = scenes.network(corners, [(0, 1), (1, 2), (3, 1), (1, 4)], 4)
    u = RNG.normal(size=16)
    want = np.concatenate([force(scenes.monomer(8), x) for x in (u[:8], u[8:])])
    assert off(force(cross, u), want) < 1e-14
    # where several meet several a contact halves the angle
    c = np.cos(0.3)
    ways = np.array([[np.cos(0.3), np.sin(0.3)], [np.cos(0.3), -np.sin(0.3)]])
    corners = np.concatenate([-ways, [[0, 0]], ways])
    star = scenes.network(corners, [(0, 2), (1, 2), (2, 3), (2, 4)], 2)
    pushed = force(star, 0.2 * (np.arange(8) == 1))
    assert off(pushed[[4, 6]], [0.2**1.5, c * (c * 0.2) ** 1.5]) < 1e-15


TREE = turned_tree(1, 6, 0.3)


@pytest.mark.slow
def test_a_network_holds_its_loads_and_has_a_derivative_by_its_nodes():
    make = lambda **how: scenes.network(*TREE, 6, **how)
    share = 0.5 / np.cos(0.3)
    assert np.abs(make(precompression=[1.0, share, share]).unbalanced()).max() < 1e-14
    want = np.zeros(18)
    want[5] = 1 - 2 * np.cos(0.3)
    assert off(make(precompression=1.0).unbalanced(), want) < 1e-14
    assert (np.asarray(make(mass=[1.0, 2.0, 3.0]).mass) == np.repeat([1.0, 2.0, 3.0], 6)).all()
    u = np.linspace(0.5, 0.0, 18)

    def energy(x):
        nodes = TREE[0] + x * np.eye(4, 2, -2)
        return scenes.network(nodes, TREE[1], 6).potential_energy(0.0, u)

    slope = float(jax.grad(energy)(0.0))
    assert abs(slope) > 1e-4 and abs(slope - (energy(1e-5) - energy(-1e-5)) / 2e-5) < 1e-8


@pytest.mark.slow
def test_a_pulse_falls_exponentially_with_depth_in_an_ordered_network():
    beads = 12
    angle = 0.3

    def peaks(net, until):
        """The largest velocity in the middle of each guide."""
        start = states.impact(net)
        record = {"peak": gx.Peak(lambda t, y, _: y.v)}
        run = gx.simulate(net, start, until, step=0.1, record=record)
        return np.asarray(run.recorded["peak"]).reshape(-1, beads)[:, beads // 2]

    tree = np.log(peaks(scenes.network(*turned_tree(3, beads, angle), beads), 130.0)[[1, 3, 7]])
    (rate, _), left, *_ = np.polyfit(range(3), tree, 1, full=True)
    # three points and two numbers leave one; the variance of the three places is 2
    assert np.sqrt(left[0] / 2) < 1e-4 * abs(rate)
    # one junction gives the factor of every level, as the law has no scale
    single = peaks(scenes.junction(beads, (beads, beads), angles=(angle, -angle)), 45.0)
    assert abs(np.log(single[1] / single[0]) / rate - 1) < 0.01


# ------------------------------------------------------------------------------------- lanes, units, derivatives


@pytest.mark.slow
@pytest.mark.parametrize(
    "make",
    [
        lambda x: scenes.triangular(4, precompression=x, boundary="periodic", spacing=1.0),
        lambda x: scenes.rotating_chain(6, tangential=0.4, bending=x),
        lambda x: scenes.network(*TREE, 6, stiffness=x),
    ],
)
def test_a_batch_of_scenes_has_the_forces_of_each(make):
    values = jnp.array([0.02, 0.1])
    batch = jax.vmap(make, out_axes=-1)(values)
    u = 0.01 * RNG.normal(size=make(0.1).shape)
    both = force(batch, np.stack([u, u], -1))
    assert batch.lanes == (2,)
    assert all(off(both[..., i], force(make(x), u)) < 1e-15 for i, x in enumerate(values))


@pytest.mark.slow
def test_the_frequency_at_the_corner_has_a_derivative_by_the_load():
    make = lambda f: scenes.triangular(6, 6, precompression=f, boundary="periodic")
    slope = jax.grad(lambda f: linear.dispersion(make(f), K).omega_squared.sum())(0.1)
    assert abs(slope + 9) < 1e-9


STEEL = {"mass": 4.2e-3, "stiffness": 1e10, "precompression": 20.0, "units": "SI"}


@pytest.mark.slow
@pytest.mark.parametrize(
    "steel",
    [
        scenes.rotating_chain(8, attraction=20.0, bending=2e6, spacing=1e-2, **STEEL),
        scenes.network(1e-2 * TREE[0], TREE[1], 6, **STEEL),
    ],
)
def test_scenes_in_si_have_the_modes_of_the_scaled_scene(steel):
    plain, units = scenes.scaled(steel)
    want, found = (np.asarray(modes(x)) for x in (steel, plain))
    assert steel.units == "SI" and off(found / float(units.time) / want, 1) < 1e-11


# ------------------------------------------------------------------------------- beads that pass through one another


def said(crystal, *frames):
    """What is said of beads without a bond in a run that has saved these displacements."""
    us = np.stack(frames)
    return passing(crystal, np.arange(float(len(us))), us, us[-1])


def overlapping(x, joined, radii, periods=()):
    """How many pairs without a bond have rims that overlap, by all distances, the nearest, and the distances."""
    R = np.add.outer(radii, radii)
    images = [0 * x[0], *periods, *(-p for p in periods)]
    apart = np.min([np.linalg.norm(x[:, None] - x - p, axis=-1) for p in images], 0)
    over = np.triu((apart < (1 - 1e-4) * R) & ~joined, 1)
    nearest = np.unravel_index(np.argmin(np.where(over, apart / R, np.inf)), over.shape)
    return over.sum(), nearest, apart


@pytest.mark.parametrize("name", ["strip", "honeycomb"])
def test_beads_without_a_bond_that_overlap_are_named(name):
    L = 0.02
    strip = name == "strip"
    rng = np.random.default_rng(7)
    crystal = (
        scenes.triangular(5, 4, exponent=2.0, boundary=("periodic", "free"), spacing=L)
        if strip
        else scenes.honeycomb(3, exponent=1.5, boundary="free", spacing=L)
    )
    x = np.concatenate([np.reshape(x, (-1, 2)) for x in jax.tree.leaves(crystal.positions)])
    periods = [np.array([5 * L, 0.0])] if strip else []
    radii = np.full(len(x), L / 2)
    joined = overlapping(x, False, 1.1 * radii, periods)[2] < 1.1 * L
    hits = 0
    for size in (0.02, 0.15, 0.25, 0.35, 0.5, 0.8) * 2:
        u = size * L * rng.normal(size=x.shape)
        many, nearest, apart = overlapping(x + u, joined, radii, periods)
        if strip:
            words = said(crystal, np.zeros(crystal.shape), u.reshape(crystal.shape))
            names = {f"site {divmod(i, 4)}" for i in map(int, nearest)}
            assert "at t = 1:" in words or not words
        else:
            fields = dict(zip("ab", u.reshape(2, 3, 3, 2)))
            words = passing(crystal, np.zeros(1), jax.tree.map(lambda x: x[None], fields), fields)
            names = {f"site {divmod(i % 9, 3)} of {'ab'[i // 9]!r}" for i in map(int, nearest)}
        assert bool(words) == bool(many)
        hits += bool(many)
        if many:
            told = words.split(": ")[1].split(f", {apart[nearest]:.3g}")[0]
            assert set(told.split(" and ")) == names
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
    where = f"at t = {run.ts[first]:g}: site (0, 0) and site (1, 1), {diagonal[first]:.3g} apart"
    assert where in run.outcome and "Bonds are fixed" in run.outcome
    assert run.outcome.startswith("Completed")


def test_radii_follow_from_who_is_in_touch_and_beads_of_a_line_are_named():
    R = np.array([1.0, 1.0, 0.5, 0.7])
    # the last two touch the first two, above and below their line
    x = np.array([[0, 0], [2, 0], [1, np.sqrt(1.5**2 - 1)], [1, -np.sqrt(1.7**2 - 1)]])
    tail = np.array([0, 0, 1, 0, 1])
    head = np.array([1, 2, 2, 3, 3])
    bond = gx.Bond(gx.Stretch(gx.Pairs(tail, head), x[head] - x[tail]), gx.Hertz())
    packing = gx.Lattice(R**3, bond, dimension=2, positions=x)
    joined = np.ones((4, 4), bool)
    joined[2, 3] = joined[3, 2] = False
    # they meet at 1.2, from 2.49 apart
    for part in (0.0, 0.51, 0.53, 0.7):
        u = x * [[0, 0], [0, 0], [0, -part], [0, -part]]
        assert bool(said(packing, u)) == (part > 0.52) == bool(overlapping(x + u, joined, R)[0])
    # on a line the first and the third bead meet where the one between is pressed through
    bond = gx.Bond(gx.Shift(1, "fixed"), gx.Hertz())
    places = 2.0 * np.arange(5.0)[:, None]
    line = gx.Lattice(1.0, bond, sites=5, positions=places)
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


def test_nothing_is_said_of_scenes_without_beads_and_walls_and_lanes_are_named():
    hexagon = scenes.hexagon(1, exponent=1.5)
    terms = (*hexagon.terms, Everywhere())
    x = hexagon.positions
    own = gx.Lattice(1.0, terms, sites=7, dimension=2, positions=x)
    for quiet in (scenes.square(4), scenes.monomer(6), own):
        assert said(quiet, 3 * RNG.normal(size=quiet.shape)) == ""
    # the bead of the wall beside its neighbour lies 2^{1/2} away, aside
    held = scenes.square(3, exponent=1.5)
    for way, met in ((0.40, False), (0.43, True)):
        u = np.zeros(held.shape)
        u[0, 0] = way * np.array([-1, 1]) / 2**0.5
        assert ("site (0, 0) and a bead of the wall" in said(held, u)) == met
    make = lambda A: scenes.square(3, stiffness=A, exponent=1.5, boundary="free")
    u = np.zeros((3, 3, 2, 3))
    u[0, 0, :, 1] = 0.6
    words = said(jax.vmap(make, out_axes=-1)(jnp.ones(3)), 0 * u, u)
    assert "in lane 1: site (0, 0) and site (1, 1)" in words


# ------------------------------------------------------------------------------------------ packings of several beads


@pytest.mark.slow
@pytest.mark.parametrize("boundary", ["fixed", "periodic"])
def test_a_packing_of_two_materials_has_their_masses_contacts_and_cell(boundary):
    bodies = ("steel 316", "PTFE")
    R = 5e-3
    A = materials.hertz_coefficient
    make = lambda body, **how: scenes.packing(body, R, 6, 4, 20.0, boundary=boundary, **how)
    pattern = np.random.default_rng(0).integers(2, size=(6, 4))
    drawn = make(bodies, pattern=pattern)
    mass = np.array([float(materials.bead_mass(x, R)) for x in bodies])
    assert_allclose(drawn.mass[..., 0], mass[pattern], rtol=1e-14)
    # a bead of the wall is like the one that it touches
    table = np.array([[float(A(x, R, y, R)) for y in bodies] for x in bodies])
    first, mode = (-1, "clip") if boundary == "fixed" else (0, "wrap")
    for axis, term in enumerate(drawn.terms[:2]):
        ends = (np.arange(first + i, pattern.shape[axis] + i) for i in (0, 1))
        tail, head = (np.take(pattern, x, axis, mode=mode) for x in ends)
        assert_allclose(term.law.stiffness, table[tail, head], rtol=1e-14)
    stripes = np.broadcast_to(np.arange(6)[:, None] % 2, (6, 4))
    found = linear.dispersion(make(bodies, pattern=stripes), [0.3, 0.7])
    assert found.cell == (2, 1) and found.omega.shape == (4,)
    alike = make(bodies, pattern=0 * stripes)
    assert_allclose(modes(alike), modes(make("steel 316")), rtol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("arrangement, boundary", [("hexagonal", "periodic"), ("square", "fixed")])
def test_a_packing_of_many_radii_rests(arrangement, boundary):
    """From places, radii and Hertz's law alone: no bead is pushed, and some contacts are open."""
    rng = np.random.default_rng(3)
    shape = (3, 4)
    F0 = 5.0
    radii = 5e-3 * (1 + 1.2e-4 * rng.uniform(-1, 1, shape))
    how = {"arrangement": arrangement, "boundary": boundary}
    crystal = scenes.packing("steel 316", radii, *shape, F0, **how)
    assert_allclose(crystal.mass[..., 0], materials.bead_mass("steel 316", radii), rtol=1e-14)
    mean = np.mean(radii)
    regular = np.asarray(scenes.packing("steel 316", mean, *shape, F0, **how).positions)
    # with the beads around, each at its place in the regular packing where it belongs to a wall
    vectors = regular[[1, 0], [0, 1]] - regular[0, 0]
    cells = np.argwhere(np.ones((5, 6))) - 1
    at = tuple((cells % shape).T)
    inside = (cells.T == at).all(0)
    moved = inside | (boundary == "periodic")
    x = regular[0, 0] + cells @ vectors
    x[moved] += (np.asarray(crystal.positions) - regular)[at][moved]
    forces = []
    pushes = []
    for n in np.flatnonzero(inside):
        R = radii[at][n]
        away = x[n] - x
        d = np.linalg.norm(away, axis=1)
        near = (d > 0) & (d < 2.2 * mean)
        # a bead of a wall is like the one that it touches
        other = np.where(moved, radii[at], R)[near]
        A = np.asarray(materials.hertz_coefficient("steel 316", R, "steel 316", other))
        push = A * np.maximum((F0 / A) ** (2 / 3) + R + other - d[near], 0) ** 1.5
        pushes.extend(push)
        forces.append((push / d[near]) @ away[near])
    # places of a centimetre have the digits of an overlap of a micrometre to 1e-12
    assert np.abs(forces).max() < 1e-10 * max(pushes) and min(pushes) < 0.3 * max(pushes)


@pytest.mark.slow
def test_radii_of_cells_are_cut_by_an_outline():
    """As if the radii of the beads within it were listed alone."""
    outline = lambda x: np.hypot(x[..., 0] - 2.5, x[..., 1] - 0.87) > 0.6
    radii = 5e-3 + 1e-7 * RNG.uniform(-1, 1, (3, 4))
    kept = np.ones((3, 4), bool)
    kept[2, 1] = False
    found, wanted = (
        scenes.packing("steel 316", R, 3, 4, 200.0, outline=outline) for R in (radii, radii[kept])
    )
    assert_allclose(found.mass[:, 0], materials.bead_mass("steel 316", radii[kept]), rtol=1e-14)
    assert_allclose(found.positions, wanted.positions, rtol=1e-14)


@pytest.mark.slow
def test_patterns_of_cells_are_cut_by_an_outline():
    outline = lambda x: np.hypot(x[..., 0], x[..., 1]) > 0.5
    which = {"a": np.arange(12).reshape(3, 4) % 2, "b": np.arange(12).reshape(3, 4) % 3 % 2}
    how = {"arrangement": "honeycomb", "pattern": which, "outline": outline}
    bodies = ["steel 316", "brass"]
    mixed = scenes.packing(bodies, 5e-3, 3, 4, 20.0, **how)
    masses = np.array([float(materials.bead_mass(x, 5e-3)) for x in bodies])
    # the bead "a" of the first cell stands at the origin
    assert_allclose(mixed.mass["a"][:, 0], masses[which["a"].ravel()[1:]], rtol=1e-14)
    assert_allclose(mixed.mass["b"][:, 0], masses[which["b"].ravel()], rtol=1e-14)


NOISE = np.random.default_rng(0).uniform(-1, 1, (3, 4))


def uneven(part, **how):
    """A packing of steel beads of 5 mm whose radii differ by a part."""
    return scenes.packing("steel 316", 5e-3 * (1 + part * NOISE), 3, 4, 20.0, **how)


@pytest.mark.slow
def test_radii_that_are_equal_differ_too_much_or_are_differentiated():
    equal = uneven(0.0)
    plain = scenes.packing("steel 316", 5e-3, 3, 4, 20.0)
    assert_allclose(modes(equal), modes(plain), rtol=1e-9)
    assert_allclose(equal.positions, plain.positions, rtol=0, atol=1e-15)
    lowest = lambda part: modes(uneven(part))[0]
    parts = np.array([0.99e-4, 1e-4, 1.01e-4])
    found, slope = jax.vmap(jax.value_and_grad(lowest))(parts)
    assert_allclose(found[1], lowest(1e-4), rtol=1e-9)
    assert_allclose(slope[1], (found[2] - found[0]) / 2e-6, rtol=1e-3)
    with pytest.raises(RuntimeError, match="no stable state of rest"):
        uneven(3e-3)


@pytest.mark.slow
def test_a_lane_whose_beads_do_not_rest_is_lost():
    """Alone it raises; the other lane is the packing that is built alone."""
    make = lambda part: scenes.packing(
        "steel 316", 5e-3 * (1 + part * NOISE[:2, :2]), 2, 2, 20.0, arrangement="square"
    )
    parts = 4e-2, 4e-4
    both = jax.vmap(make, out_axes=-1)(jnp.array(parts))
    assert both.units == "SI"
    numbers = [np.asarray(x) for x in jax.tree.leaves((both.mass, both.terms, both.positions))]
    assert all(np.isnan(x[..., 0]).all() and np.isfinite(x[..., 1]).all() for x in numbers)
    alone = np.asarray(make(parts[1]).positions)
    assert_allclose(both.positions[..., 1], alone, rtol=0, atol=1e-15)
    with pytest.raises(RuntimeError, match="no stable state of rest"):
        make(parts[0])


NODES = np.array([[0, 0], [1, 0], [2, 0], [1, 1.0]])
TWO = ("steel 316", "PTFE"), 5e-3, 3, 3, 20.0
HALF = np.eye(3, dtype=int)
BOX = scenes.square(3)
REFUSALS = {
    "cells are square": lambda: scenes.square(4, outline="hexagon"),
    "tangential": lambda: scenes.square(4, tangential=1.0),
    "precompression: .* slide": lambda: scenes.packing("steel 316", 5e-3, 7, rotation=True),
    "tangential: .* slide": lambda: scenes.rotating_chain(6, precompression=0.0),
    "boundary": lambda: scenes.rotating_chain(6, boundary="closed"),
    "rotation=True": lambda: measures.slip_ratio(BOX, states.rest(BOX)),
    "four distances": lambda: measures.front_decay(
        scenes.hexagon(2), np.ones(19), 9, between=(0.5, 1.5)
    ),
    "places: .* positions in the plane": lambda: plots.beads(np.zeros((4, 3))),
    "places: expected one lattice": lambda: plots.beads(
        jax.vmap(lambda A: scenes.hexagon(1, stiffness=A), out_axes=-1)(jnp.ones(2))
    ),
    "backwards": lambda: scenes.junction(6, (9,), angles=(1.6,)),
    "right angle": lambda: scenes.network(NODES, [(0, 1), (1, 2), (1, 3)], 3),
    "one of 0, 1, 2, 3": lambda: scenes.network(NODES, [(0, 1), (1, 4)], 3),
    "one per guide": lambda: scenes.network(NODES, [(0, 1), (1, 2)], (3, 3, 3)),
    "traced": lambda: jax.jit(lambda x: scenes.network(x, [(0, 1)], 3).mass)(NODES),
    "one number, or an array": lambda: scenes.network(
        NODES, [(0, 1), (1, 2)], 3, precompression=[1.0, 1.0, 1.0]
    ),
    "pattern": lambda: scenes.packing(*TWO),
    "rotation": lambda: scenes.packing(*TWO, pattern=HALF, rotation=True),
    "one per site": lambda: scenes.packing(*TWO, pattern=HALF[:2]),
    "one material": lambda: scenes.packing("steel 316", *TWO[1:], pattern=HALF),
    "many radii": lambda: uneven(1e-4, boundary="free"),
    "one of each": lambda: uneven(1e-4, rotation=True),
}


@pytest.mark.parametrize("words", REFUSALS)
def test_what_cannot_be_built_is_refused(words):
    with refused(words):
        REFUSALS[words]()
