"""Initial states, against closed forms."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import xarray
from cases import Turning
from numpy.testing import assert_allclose, assert_array_equal
from refusals import refused
from scipy.linalg import expm

import granjax as gx
from granjax import Bond, Hertz, Lattice, Linear, Polynomial, Shift, measures, states


def chain(sites=8, law=None, boundary="fixed", mass=1.0):
    law = Hertz(1.0, precompression=1.0) if law is None else law
    return Lattice(mass, Bond(Shift(1, boundary), law), sites=sites)


def plane():
    bond = Bond(gx.Stretch(Shift((1, 0), ("free", "free")), [1.0, 0.0]), Linear())
    return Lattice(1.0, bond, sites=(3, 4), dimension=2)


def cells(names=("bead", "resonator")):
    first, second = names
    terms = (
        Bond(Shift(1, "fixed", first), Linear()),
        Bond(Shift(0, "free", names), Linear(0.5)),
    )
    return Lattice({first: 1.0, second: 0.3}, terms, sites=5)


def batch():
    return jax.vmap(lambda r: chain(6, Hertz(r, precompression=1.0)), out_axes=-1)(
        jnp.array([1.0, 2.0, 3.0])
    )


def dimer(sites=60):
    return chain(sites, Linear(), mass=np.tile([1.0, 0.5], sites // 2))


def pressed(boundary="free", **numbers):
    return gx.scenes.monomer(120, precompression=1.0, boundary=boundary, **numbers)


@pytest.mark.parametrize("make", [cells, lambda: batch().astype(jnp.float32)])
def test_shapes_and_types(make):
    lattice = make()

    def all_states():
        made = [
            states.rest(lattice),
            states.impact(lattice),
            states.random(lattice),
            states.thermal(lattice, 1.0),
            states.normal_mode(lattice, 1),
        ]
        if lattice.fields is None:
            made += [
                states.sine_mode(lattice),
                states.velocity_step(lattice, 0.1),
                states.strain_step(lattice, 0.1),
                states.wave_packet(lattice, 1.0, width=1.0),
            ]
        return made

    described = lambda x: (x.shape, x.dtype)
    for state in jax.eval_shape(all_states):
        assert isinstance(state, gx.State)
        for x in state:
            assert jax.tree.map(described, x) == jax.tree.map(described, lattice.template())


def test_an_impact_gives_one_site_a_velocity():
    state = states.impact(chain(5), 2.0, -1)
    assert_array_equal(state.v, [0, 0, 0, 0, 2])
    assert_array_equal(state.u, 0)
    assert_array_equal(states.impact(chain(5)).v, [1, 0, 0, 0, 0])
    grid = states.impact(plane(), [1.0, -2.0], (1, 2))
    assert_array_equal(grid.v[1, 2], [1, -2])
    assert np.abs(grid.v).sum() == 3
    named = states.impact(cells(), 3.0, 2, field="resonator")
    assert named.v["resonator"][2] == 3 and not np.any(named.v["bead"])
    assert states.impact(cells(), 3.0, 2).v["bead"][2] == 3
    assert_array_equal(states.impact(batch(), [1.0, 2.0, 3.0], 4).v[4], [1, 2, 3])


@pytest.mark.slow
def test_random_states_are_uniform_thermal_or_seeded():
    long = chain(20000, mass=3.0)
    u, v = states.random(long, 3, 0.2, 0.5)
    for x, a in (u, 0.2), (v, 0.5):
        assert np.abs(x).max() <= a and np.abs(x).max() > 0.99 * a
        # variance of a uniform distribution a^2/3, known to 0.6 % from 20000 values
        assert abs(np.var(x) / (a**2 / 3) - 1) < 0.02
    assert_array_equal(states.random(long, 3, 0.2, 0.5).u, u)
    assert_array_equal(states.random(long, jax.random.key(3), 0.2, 0.5).v, v)
    assert np.all(states.random(long, 4, 0.2).u != u) and not np.any(states.random(long, 3).v)
    lanes = states.random(batch()).u
    assert np.all(lanes[:, 0] != lanes[:, 1])
    u, v = states.thermal(long, 0.4)
    # m <v^2> = k_B T, known to 1 % from 20000 values
    assert abs(3 * np.mean(v**2) / 0.4 - 1) < 0.03 and not np.any(u)


@pytest.mark.slow
def test_modes_of_the_uniform_chain_are_sines():
    fput = chain(31, Polynomial(1.0, 0.25))
    # 32 sin^2(pi/64)
    for state in states.sine_mode(fput, 1, 1.0), states.normal_mode(fput, 0, 1.0):
        assert abs(fput.energy(0.0, *state) - 0.0770443732448498) < 1e-14
    lattice = chain(9, Linear(2.0), mass=0.5)
    for k in range(1, 10):
        sine = states.sine_mode(lattice, k).u
        mode = states.normal_mode(lattice, k - 1).u
        assert_allclose(mode, sine / np.abs(sine).max(), atol=1e-13)
    turning = states.normal_mode(plane(), -1, 0.1).u
    assert turning.shape == (3, 4, 2) and abs(np.abs(turning).max() - 0.1) < 1e-15


@pytest.mark.slow
@pytest.mark.parametrize("make", [lambda: dimer(12), cells, batch], ids=["dimer", "cells", "batch"])
def test_a_normal_mode_turns_with_its_frequency(make):
    """u = a cos(phase) phi, v = -omega a sin(phase) phi solves the linear equation: a(phi) = -omega^2 phi."""
    lattice = make()
    zeros = lattice.zeros()
    mass = jax.tree.map(jnp.add, lattice.mass, zeros)
    for index in 0, 5, -1:
        stretched = states.normal_mode(lattice, index, 1e-3).u
        moving = states.normal_mode(lattice, index, 1e-3, np.pi / 2).v
        _, force = jax.jvp(lambda u: lattice.force(0.0, u, zeros), (zeros,), (stretched,))
        for f, m, u, v in zip(*map(jax.tree.leaves, (force, mass, stretched, moving))):
            assert_allclose(f, -m * (v / u) ** 2 * u, atol=1e-14)
        largest = np.max([np.abs(u).max(0) for u in jax.tree.leaves(stretched)], 0)
        assert_allclose(largest, 1e-3, rtol=1e-12)


def turning(rate=0.6):
    """A chain in the plane in a magnetic field, stable at rest."""
    bond = Bond(gx.Stretch(Shift(1, "fixed"), (1.0, 0.0)), Polynomial(1.0))
    terms = bond, gx.OnSite(Linear(0.3)), Turning(jnp.asarray(rate))
    return Lattice(1.0, terms, sites=4, dimension=2)


@pytest.mark.slow
def test_a_normal_mode_among_gyroscopic_forces_solves_the_linear_equations():
    """y = (u, v) at phase p is Re(exp(-i p) y_0): dy/dt = omega dy/dp, and y_0 has its largest entry."""
    lattice = turning()
    flat = lambda y: np.concatenate([np.ravel(x) for x in y])
    for index in 0, 2, -1:
        omega = gx.linear.normal_modes(lattice).omega[index]
        y, quarter = (states.normal_mode(lattice, index, 1e-3, p) for p in (0.4, 0.4 + np.pi / 2))
        zeros = lattice.zeros(), lattice.zeros()
        _, rate = jax.jvp(lambda u, v: lattice.acceleration(0.0, u, v), zeros, tuple(y))
        assert_allclose(flat((y.v, rate)), omega * flat(quarter), atol=1e-15)
        assert_allclose(np.hypot(y.u, quarter.u).max(), 1e-3, rtol=1e-12)
        start = states.normal_mode(lattice, index, 1e-3)
        first = np.argmax(np.hypot(start.u, start.v / omega).ravel() >= 1e-4)
        assert start.u.ravel()[first] > 0 and abs(start.v.ravel()[first]) < 1e-17


@pytest.mark.slow
def test_a_gyroscopic_mode_returns_after_its_period_and_has_lanes_and_derivatives():
    lattice = turning()
    start = states.normal_mode(lattice, 2, 1e-4)
    period = 2 * np.pi / float(gx.linear.normal_modes(lattice).omega[2])
    run = gx.simulate(lattice, start, period, tolerance=1e-11, save_at=2)
    assert np.abs(run.us[-1] - start.u).max() < 1e-9 and np.abs(run.vs[-1] - start.v).max() < 1e-9
    rates = jnp.array([0.3, 0.6])
    lanes = states.normal_mode(jax.vmap(turning, out_axes=-1)(rates), 2, 1e-4, 0.3)
    alone = states.normal_mode(lattice, 2, 1e-4, 0.3)
    assert_allclose(lanes.u[..., 1], alone.u, atol=1e-17)
    assert_allclose(lanes.v[..., 1], alone.v, atol=1e-17)
    made = lambda rate: jnp.stack(states.normal_mode(turning(rate), 2, 1.0, 0.3))
    slope = (made(0.6 + 1e-5) - made(0.6 - 1e-5)) / 2e-5
    assert_allclose(jax.jacfwd(made)(0.6), slope, atol=1e-8)
    assert_allclose(jax.jacrev(made)(0.6), slope, atol=1e-8)


def test_a_strain_step_has_its_strains():
    lattice = chain(11, boundary="free")
    u = states.strain_step(lattice, 0.3, 0.1).u
    assert_allclose(u[:-1] - u[1:], [0.3] * 5 + [0.1] * 5, rtol=1e-13)
    assert u[-1] == 0
    assert_allclose(states.strain_step(lattice, 0.3, centre=2).u, [0.6, 0.3] + [0] * 9)
    lanes = states.strain_step(batch(), jnp.array([0.1, 0.2, 0.3])).u[0]
    assert_allclose(lanes, [0.2, 0.4, 0.6])


def test_a_velocity_step_has_its_velocities():
    for sites, centre, want in (
        (4, None, [0.2, 0.2, -0.2, -0.2]),
        (5, None, [0.2, 0.2, 0, -0.2, -0.2]),
        (4, 0.5, [0.2, -0.2, -0.2, -0.2]),
    ):
        assert_allclose(states.velocity_step(chain(sites), 0.1, centre=centre).v, want)
    lanes = states.velocity_step(batch(), jnp.array([1.0, 2.0, 3.0])).v[0]
    assert_allclose(lanes, [2, 4, 6])


@pytest.mark.slow
def test_wave_packet_runs_one_way_with_the_group_velocity():
    """By the matrix exponential of the linear chain between free ends, K = m = 1."""
    lattice = chain(400, Linear(1.0), "free")
    start = states.wave_packet(lattice, 1.2, 200, 12.0, 0.3)
    left = states.wave_packet(lattice, 1.2, 199, 12.0, 0.3, direction="left")
    assert_allclose(left.u, start.u[::-1], atol=1e-14)
    assert_allclose(left.v, start.v[::-1], atol=1e-14)
    K = 2 * np.eye(400) - np.eye(400, k=1) - np.eye(400, k=-1)
    K[0, 0] = K[-1, -1] = 1
    flow = expm(100 * np.block([[0 * K, np.eye(400)], [-K, 0 * K]]))
    later = gx.State(*np.split(flow @ np.append(*start), 2))
    e = np.asarray(measures.site_energy(lattice, later))
    centre = np.sum(np.arange(400) * e) / e.sum()
    # omega = 2 sin(q/2), group velocity cos(q/2), averaged over the energy: Gaussian of deviation 1/(sqrt2 w) in q,
    # times omega^2
    q = np.linspace(0.6, 1.8, 2001)
    weight = np.exp(-((12 * (q - 1.2)) ** 2)) * np.sin(q / 2) ** 2
    speed = np.sum(weight * np.cos(q / 2)) / np.sum(weight)
    assert abs((centre - 200) / 100 / speed - 1) < 1e-4
    assert e[:180].sum() < 1e-12 * e.sum()


@pytest.mark.slow
@pytest.mark.parametrize("k", [0.1, 0.3, 1.2])
def test_wave_packet_in_float32(k):
    # a phase k n is rounded by its own size, and the carrier's omega^2 at k = 0.1 is 1/400 of its largest
    exact, lattice = pressed(), pressed().astype(jnp.float32)
    found = states.wave_packet(lattice, k, 60, 5.0).v
    assert found.dtype == jnp.float32
    want = states.wave_packet(exact, k, 60, 5.0).v
    assert_allclose(found, want, rtol=0, atol=1e-5 * np.abs(want).max())
    uneven = gx.scenes.dimer(120, ratio=0.99, precompression=1.0, boundary="free")
    with refused("This chain is not uniform"):
        states.wave_packet(uneven.astype(jnp.float32), k, 60, 5.0)


@pytest.mark.slow
def test_solitons_in_float32():
    exact = gx.scenes.toda(64, boundary="free")
    for soliton, how in (
        (states.toda_soliton, {"k": 1.0}),
        (states.kdv_soliton, {"amplitude": 0.5}),
    ):
        found = soliton(exact.astype(jnp.float32), centre=30, **how)
        assert found.u.dtype == found.v.dtype == jnp.float32
        for got, want in zip(found, soliton(exact, centre=30, **how)):
            assert_allclose(got, want, rtol=0, atol=1e-6 * np.abs(want).max())


@pytest.mark.slow
def test_wave_packet_has_the_frequency_of_its_lattice_or_the_one_it_is_told():
    uniform = chain(200, Linear(1.0), "free")
    terms = (
        Bond(Shift(1), Linear(1.0)),
        Bond(Shift(2), Linear(0.3)),
        gx.OnSite(gx.Sine(0.5)),
    )
    for lattice, squared in (
        (uniform, lambda q: 4 * jnp.sin(q / 2) ** 2),
        (
            Lattice(2 * jnp.ones(300), terms),
            lambda q: (4 * jnp.sin(q / 2) ** 2 + 1.2 * jnp.sin(q) ** 2 + 0.5) / 2,
        ),
    ):
        own = states.wave_packet(lattice, 1.2, 100).v
        told = states.wave_packet(lattice, 1.2, 100, omega=lambda q: jnp.sqrt(squared(q))).v
        assert_allclose(own, told, atol=1e-15)
    number = states.wave_packet(uniform, 1.2, 100, width=20.0, omega=2 * np.sin(0.6)).v
    # what is left out: v_group/(omega w) = cos 0.6/(2 sin 0.6 * 20) = 0.037 of the amplitude's velocity, times e^-1/2
    own = states.wave_packet(uniform, 1.2, 100, width=20.0).v
    assert 0.01 < np.abs(number - own).max() / np.abs(own).max() < 0.037


@pytest.mark.slow
def test_toda_soliton_of_a_toda_chain_is_exact():
    lattice = gx.scenes.toda(120, boundary="free")
    u, v = states.toda_soliton(lattice, speed=np.sinh(0.8) / 0.8)
    wave = gx.theory.toda.soliton(np.arange(120), 0.0, 0.8, centre=30.0)
    assert_allclose(u[:-1] - u[1:], wave.strain[:-1], atol=1e-14)
    assert_allclose(u, wave.displacement, atol=1e-10)
    assert_allclose(v, wave.velocity, atol=1e-10)
    back = states.toda_soliton(lattice, 0.8, direction="left").v
    mirrored = states.toda_soliton(lattice, 0.8, centre=119 - 91.0).v
    assert_allclose(back, -mirrored[::-1], atol=1e-14)
    # the shortest chain
    v = states.toda_soliton(gx.scenes.toda(8, boundary="free"), 3.0).v
    assert_allclose(
        v, gx.theory.toda.soliton(np.arange(8), 0.0, 3.0, centre=2.0).velocity, atol=1e-12
    )


@pytest.mark.slow
def test_kdv_soliton_of_any_law_in_any_units():
    mass = 2e-3
    lattice = pressed(mass=mass, stiffness=5e3)
    about = dict(speed=1.05 * gx.linear.sound_speed(lattice), centre=60.25)
    state = states.kdv_soliton(lattice, **about)
    y = measures.strain(lattice, state)
    K2, K3, _ = gx.laws.taylor(lattice.terms[0].law)
    wave = lambda t: gx.theory.kdv.soliton(np.arange(119), t, K2, K3, mass=mass, **about).strain
    want, rate = jax.jvp(wave, (0.0,), (1.0,))
    assert_allclose(y, want, atol=1e-13 * y.max())
    # v_n - v_{n+1} = dy_n/dt: the strain travels
    assert_allclose(-np.diff(state.v), rate, atol=1e-13 * np.abs(rate).max())
    toda = states.toda_soliton(lattice, amplitude=y.max())
    assert toda.v.max() == pytest.approx(float(state.v.max()), rel=0.1)


@pytest.mark.parametrize("boundary, bonds", [("fixed", 121), ("periodic", 120)])
def test_a_soliton_where_the_length_is_fixed_stretches_all_bonds_alike(boundary, bonds):
    free = pressed()
    held = pressed(boundary)
    y, alone = (measures.strain(x, states.toda_soliton(x, 0.8)) for x in (held, free))
    assert y.sum() == pytest.approx(0, abs=1e-13)
    start = bonds - 120
    assert_allclose(y[start : start + 119], alone - alone.sum() / bonds, atol=1e-13)


@pytest.mark.slow
def test_solitons_of_a_batch():
    scene = lambda k: gx.scenes.monomer(60, stiffness=k, precompression=1.0, boundary="free")
    stiffness = jnp.array([1.0, 2.0])
    sizes = jnp.array([0.5, 0.9])
    for make in (
        states.toda_soliton,
        lambda x, a: states.kdv_soliton(x, amplitude=a),
    ):
        both = make(jax.vmap(scene, out_axes=-1)(stiffness), sizes).v
        each = [make(scene(k), a).v for k, a in zip(stiffness, sizes)]
        assert_allclose(both, np.stack(each, -1), atol=1e-14)


@pytest.mark.slow
def test_states_work_inside_jit_and_derivatives():
    def energy(a):
        lattice = chain()
        made = (
            states.normal_mode(lattice, 2, a),
            states.wave_packet(lattice, 1.0, width=1.0, amplitude=a),
            states.impact(lattice, a),
            states.velocity_step(lattice, a),
        )
        return sum(lattice.energy(0.0, *y) for y in made)

    slope = eqx.filter_jit(jax.grad(energy))(0.01)
    expected = (energy(0.01 + 1e-5) - energy(0.01 - 1e-5)) / 2e-5
    assert_allclose(slope, expected, rtol=1e-6)


def test_a_stored_batch_is_refused_for_one_lattice():
    many = batch()
    state = states.random(many)
    data = xarray.Dataset({name: (("site", "ratio"), x) for name, x in state._asdict().items()})
    assert_array_equal(states.stored(many, data).u, state.u)
    with refused(r"data.u: expected shape \(6,\), .* got shape \(6, 3\). .*data.isel\(ratio=0\)"):
        states.stored(chain(6), data)
    assert_array_equal(states.stored(chain(6), data.isel(ratio=1)).v, state.v[:, 1])
    cell = cells()
    state = states.random(cell)
    data = xarray.Dataset(
        {
            f"{name}_{field}": (("site",), x)
            for name in "uv"
            for field, x in getattr(state, name).items()
        }
    )
    assert_array_equal(states.stored(cell, data).u["bead"], state.u["bead"])
    with refused(r"data.v: expected shape \(5,\)"):
        states.stored(cell, data.assign(v_bead=data.v_bead.expand_dims(lane=2)))


@pytest.mark.parametrize("other", [None, 2, 3], ids=["no fields", "alike", "of two sizes"])
def test_the_axes_of_a_stored_grid_are_taken_by_name(other):
    cube = np.ones((2, 2, 2))
    mass = cube if other is None else {"a": cube, "b_2": np.ones((other, other, other))}
    lattice = Lattice(mass, gx.Damping(0.1, None if other is None else "a"), dimension=2)
    shape = states.random(lattice).u
    run = gx.simulate(lattice, gx.State(shape, shape), 0.1, step=0.1, save_at=2)
    data = run.to_xarray()
    turned = data.transpose(*[*data.dims][::-1])
    for found in (states.stored(lattice, data), states.stored(lattice, turned)):
        jax.tree.map(assert_array_equal, found, run.final)
    if other is None:
        # Names without numbers stand in the order in which they are given.
        named = turned.rename(site="site_z", site_1="site_y", site_2="site_x")
        assert_array_equal(states.stored(lattice, named).u, np.swapaxes(run.final.u, 0, 2))


@pytest.mark.parametrize(
    "call, message",
    [
        (lambda: states.impact(chain(5), 1.0, 5), "site: expected .* within -5 ... 4, got 5"),
        (lambda: states.impact(chain(5), 1.0, 1.5), "site: expected .* within -5 ... 4, got 1.5"),
        (lambda: states.impact(chain(5), 1.0, True), "site: expected .* within -5 ... 4, got True"),
        (lambda: states.impact(plane(), 1.0, (0, 0)), "velocity: expected a vector"),
        (lambda: states.impact(cells(("a", "b"))), "field: expected one of 'a', 'b'"),
        (lambda: states.normal_mode(chain(5), 5), "index: expected a whole number within -5 ... 4"),
        (lambda: states.normal_mode(chain(5), 1.5), "index: expected .* within -5 ... 4, got 1.5"),
        (
            lambda: states.normal_mode(chain(5), True),
            "index: expected .* within -5 ... 4, got True",
        ),
        (lambda: states.normal_mode(chain(5, Hertz())), "sonic vacuum"),
        (lambda: states.sine_mode(chain(5), 6), "k: expected a whole number from 1 to 5"),
        (lambda: states.strain_step(chain(5), 0.1, centre=9), "centre: expected a place"),
        (lambda: states.wave_packet(chain(50), 4.0), "k: expected numbers in"),
        (lambda: states.toda_soliton(gx.scenes.toda(7), 3.0), "8 sites or more, .* got 7"),
        (lambda: states.toda_soliton(dimer(), 1.0), "lattice: expected a uniform chain"),
        (
            lambda: states.kdv_soliton(chain(50, Polynomial(1.0, 0.0, 1.0)), amplitude=0.1),
            "K3 other than zero",
        ),
        (lambda: states.kdv_soliton(pressed(), amplitude=1e-3), "longer than the wave"),
        (lambda: states.toda_soliton(pressed(), 1.0, speed=2.0), "k, speed, amplitude: expected"),
        (lambda: states.wave_packet(dimer(), 1.0), "omega: expected the wave's frequency"),
    ],
)
def test_bad_input_is_refused_with_a_sentence(call, message):
    with refused(message):
        call()


@pytest.mark.slow
@pytest.mark.parametrize("length", [1e-6, 1e6])
def test_a_cubic_part_that_varies_is_no_uniform_chain_in_any_unit_of_length(length):
    K3 = np.where(np.arange(39) % 2, 1.0, 1.02) / length
    with refused("a uniform chain"):
        states.kdv_soliton(chain(40, Polynomial(1.0, K3, 0.0), "free"), speed=1.05, centre=20.0)
