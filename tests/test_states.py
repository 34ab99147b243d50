"""Initial states, against closed forms."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_array_equal
from refusals import refused

import granjax as gx
from granjax import measures, states


def chain(sites=8, law=None, boundary="fixed", mass=1.0):
    law = gx.Hertz(1.0, precompression=1.0) if law is None else law
    return gx.Lattice(mass * jnp.ones(sites), (gx.Bond(gx.Shift(1, boundary), law),))


def plane():
    bond = gx.Bond(gx.Stretch(gx.Shift((1, 0), ("free", "free")), [1.0, 0.0]), gx.Linear())
    return gx.Lattice(1.0, (bond,), sites=(3, 4), dimension=2)


def cells(names=("bead", "resonator")):
    first, second = names
    terms = (
        gx.Bond(gx.Shift(1, "fixed", first), gx.Linear()),
        gx.Bond(gx.Shift(0, "free", names), gx.Linear(0.5)),
    )
    return gx.Lattice({first: jnp.ones(5), second: jnp.full(5, 0.3)}, terms)


def batch():
    return jax.vmap(lambda r: chain(6, gx.Hertz(r, precompression=1.0)), out_axes=-1)(
        jnp.array([1.0, 2.0, 3.0])
    )


def dimer(sites=60):
    return gx.Lattice(
        jnp.where(jnp.arange(sites) % 2 == 0, 1.0, 0.5), (gx.Bond(gx.Shift(1), gx.Linear()),)
    )


@pytest.mark.parametrize("make", [chain, cells, batch, lambda: chain().astype(jnp.float32)])
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

    for state in jax.eval_shape(all_states):
        assert isinstance(state, gx.State)
        for x in state:
            got = jax.tree.map(lambda x: (x.shape, x.dtype), x)
            assert got == jax.tree.map(lambda s: (s.shape, s.dtype), lattice.template())


def test_impact():
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


def test_impact_with_one_velocity_per_lane():
    assert_array_equal(states.impact(batch(), [1.0, 2.0, 3.0], 4).v[4], [1, 2, 3])
    assert_array_equal(states.impact(batch(), 2.0, 4).v[4], [2, 2, 2])
    swept = jax.vmap(lambda v: states.impact(chain(5), v, 1).v)(jnp.array([1.0, 4.0]))
    assert_array_equal(swept[:, 1], [1, 4])


@pytest.mark.slow
def test_random_is_uniform_and_seeded():
    long = chain(20000)
    state = states.random(long, 3, 0.2, 0.5)
    for x, a in ((state.u, 0.2), (state.v, 0.5)):
        assert np.abs(x).max() <= a and np.abs(x).max() > 0.99 * a
        # variance of a uniform distribution a^2/3, known to 0.6 % from 20000 values
        assert abs(np.var(x) / (a**2 / 3) - 1) < 0.02
    assert_array_equal(states.random(long, 3, 0.2, 0.5).u, state.u)
    assert_array_equal(states.random(long, jax.random.key(3), 0.2, 0.5).v, state.v)
    assert np.all(states.random(long, 4, 0.2).u != state.u) and not np.any(states.random(long, 3).v)
    lanes = states.random(batch()).u
    assert np.all(lanes[:, 0] != lanes[:, 1])


def test_thermal_energy():
    lattice = chain(20000, mass=3.0)
    state = states.thermal(lattice, 0.4)
    # m <v^2> = k_B T, known to 1 % from 20000 values
    assert abs(3 * np.mean(state.v**2) / 0.4 - 1) < 0.03 and not np.any(state.u)


@pytest.mark.slow
def test_fput_first_mode_has_its_energy():
    fput = chain(31, gx.Polynomial(1.0, 0.25))
    # 32 sin^2(pi/64)
    for state in (states.sine_mode(fput, 1, 1.0), states.normal_mode(fput, 0, 1.0)):
        assert abs(fput.energy(0.0, *state) - 0.0770443732448498) < 1e-14


@pytest.mark.slow
def test_modes_of_the_uniform_chain_are_sines():
    lattice = chain(9, gx.Linear(2.0), mass=0.5)
    for k in range(1, 10):
        sine, mode = states.sine_mode(lattice, k).u, states.normal_mode(lattice, k - 1).u
        np.testing.assert_allclose(mode, sine / np.abs(sine).max(), atol=1e-13)


@pytest.mark.slow
@pytest.mark.parametrize("index", [0, 5, -1])
@pytest.mark.parametrize("make", [lambda: dimer(12), cells, batch], ids=["dimer", "cells", "batch"])
def test_a_normal_mode_turns_with_its_frequency(make, index):
    """u = a cos(phase) phi, v = -omega a sin(phase) phi solves the linear equation: a(phi) = -omega^2 phi."""
    lattice = make()
    stretched, moving = (
        states.normal_mode(lattice, index, 1e-3),
        states.normal_mode(lattice, index, 1e-3, np.pi / 2),
    )
    zeros = lattice.zeros()
    _, force = jax.jvp(lambda u: lattice.force(0.0, u, zeros), (zeros,), (stretched.u,))
    mass = jax.tree.map(jnp.add, lattice.mass, zeros)
    for f, m, u, v in zip(*map(jax.tree.leaves, (force, mass, stretched.u, moving.v))):
        omega = -v / u
        np.testing.assert_allclose(f, -m * omega**2 * u, atol=1e-14)
    largest = np.max([np.abs(u).max(0) for u in jax.tree.leaves(stretched.u)], 0)
    np.testing.assert_allclose(largest, 1e-3, rtol=1e-12)


@pytest.mark.slow
def test_normal_mode_of_a_vector_lattice_fits():
    state = states.normal_mode(plane(), -1, 0.1)
    assert state.u.shape == (3, 4, 2) and abs(np.abs(state.u).max() - 0.1) < 1e-15


def test_strain_step():
    lattice = chain(11, boundary="free")
    u = states.strain_step(lattice, 0.3, 0.1).u
    np.testing.assert_allclose(u[:-1] - u[1:], [0.3] * 5 + [0.1] * 5, rtol=1e-13)
    assert u[-1] == 0
    u = states.strain_step(lattice, 0.3, centre=2).u
    assert_array_equal(u[2:], 0)
    np.testing.assert_allclose(u[:2], [0.6, 0.3])
    np.testing.assert_allclose(
        states.strain_step(batch(), jnp.array([0.1, 0.2, 0.3])).u[0], [0.2, 0.4, 0.6]
    )


def test_velocity_step():
    np.testing.assert_allclose(states.velocity_step(chain(4), 0.1).v, [0.2, 0.2, -0.2, -0.2])
    np.testing.assert_allclose(states.velocity_step(chain(5), 0.1).v, [0.2, 0.2, 0, -0.2, -0.2])
    np.testing.assert_allclose(
        states.velocity_step(chain(4), 0.1, centre=0.5).v, [0.2, -0.2, -0.2, -0.2]
    )
    np.testing.assert_allclose(
        states.velocity_step(batch(), jnp.array([1.0, 2.0, 3.0])).v[0], [2, 4, 6]
    )


def free_flow(state, t):
    """Exact solution of the linear chain between free ends, K = m = 1, by its eigenvectors."""
    N = len(state.u)
    K = 2 * np.eye(N) - np.eye(N, k=1) - np.eye(N, k=-1)
    K[0, 0] = K[-1, -1] = 1
    squares, Q = np.linalg.eigh(K)
    omega = np.sqrt(np.maximum(squares, 1e-30))
    a, b = Q.T @ np.asarray(state.u), Q.T @ np.asarray(state.v)
    u = Q @ (a * np.cos(omega * t) + b * np.sin(omega * t) / omega)
    v = Q @ (b * np.cos(omega * t) - a * omega * np.sin(omega * t))
    return gx.State(jnp.asarray(u), jnp.asarray(v))


@pytest.mark.slow
@pytest.mark.parametrize("direction,sign", [("right", 1), ("left", -1)])
def test_wave_packet_runs_one_way_with_the_group_velocity(direction, sign):
    lattice = chain(400, gx.Linear(1.0), "free")
    state = states.wave_packet(lattice, 1.2, 200, 12.0, 0.3, direction=direction)
    later = free_flow(state, 100.0)
    e = np.asarray(measures.site_energy(lattice, later))
    centre = np.sum(np.arange(400) * e) / e.sum()
    # omega = 2 sin(q/2), group velocity cos(q/2), averaged over the energy: Gaussian of deviation 1/(sqrt2 w) in q,
    # times omega^2
    q = np.linspace(0.6, 1.8, 2001)
    weight = np.exp(-((12 * (q - 1.2)) ** 2)) * np.sin(q / 2) ** 2
    speed = np.sum(weight * np.cos(q / 2)) / np.sum(weight)
    assert abs((centre - 200) / (sign * 100) / speed - 1) < 1e-4
    behind = e[:180].sum() if sign > 0 else e[220:].sum()
    assert behind < 1e-12 * e.sum()


@pytest.mark.slow
def test_wave_packet_with_a_frequency_of_ones_own():
    uniform = chain(200, gx.Linear(1.0), "free")
    own = states.wave_packet(uniform, 1.2, 100)
    told = states.wave_packet(uniform, 1.2, 100, omega=lambda q: 2 * jnp.sin(q / 2))
    np.testing.assert_allclose(own.v, told.v, atol=1e-15)
    number = states.wave_packet(uniform, 1.2, 100, width=20.0, omega=2 * np.sin(0.6))
    # what is left out: v_group/(omega w) = cos 0.6/(2 sin 0.6 * 20) = 0.037 of the amplitude's velocity, times e^-1/2
    own = states.wave_packet(uniform, 1.2, 100, width=20.0)
    error = np.abs(number.v - own.v).max() / np.abs(own.v).max()
    assert 0.01 < error < 0.037
    states.wave_packet(dimer(), 0.5, omega=0.3)


@pytest.mark.slow
def test_wave_packet_counts_site_springs_and_far_neighbours():
    terms = (
        gx.Bond(gx.Shift(1), gx.Linear(1.0)),
        gx.Bond(gx.Shift(2), gx.Linear(0.3)),
        gx.OnSite(gx.Sine(0.5)),
    )
    lattice = gx.Lattice(2 * jnp.ones(300), terms)

    def omega(q):
        return jnp.sqrt((4 * jnp.sin(q / 2) ** 2 + 1.2 * jnp.sin(q) ** 2 + 0.5) / 2)

    own, told = (
        states.wave_packet(lattice, 1.0, 150),
        states.wave_packet(lattice, 1.0, 150, omega=omega),
    )
    np.testing.assert_allclose(own.v, told.v, atol=1e-15)


def pressed(sites=120, boundary="free", **numbers):
    return gx.scenes.monomer(sites, precompression=1.0, boundary=boundary, **numbers)


@pytest.mark.slow
def test_toda_soliton_of_a_toda_chain_is_exact():
    lattice, t = gx.scenes.toda(120, boundary="free"), 40.0
    state = states.toda_soliton(lattice, speed=np.sinh(0.8) / 0.8)
    wave = gx.theory.toda.soliton(np.arange(119), 0.0, 0.8, centre=30.0)
    np.testing.assert_allclose(measures.strain(lattice, state), wave.strain, atol=1e-14)
    final = gx.simulate(lattice, state, t, step=0.05, solver=gx.SRKN14a()).final
    later = gx.theory.toda.soliton(np.arange(120), t, 0.8, centre=30.0)
    np.testing.assert_allclose(final.u, later.displacement, atol=1e-10)
    np.testing.assert_allclose(final.v, later.velocity, atol=1e-10)
    back = states.toda_soliton(lattice, 0.8, direction="left")
    np.testing.assert_allclose(
        back.v, -states.toda_soliton(lattice, 0.8, centre=119 - 91.0).v[::-1], atol=1e-14
    )


@pytest.mark.slow
@pytest.mark.parametrize("numbers", [{}, dict(mass=2e-3, stiffness=5e3)])
def test_kdv_soliton_of_any_law_in_any_units(numbers):
    lattice = pressed(**numbers)
    sound = gx.linear.sound_speed(lattice)
    state = states.kdv_soliton(lattice, speed=1.05 * sound, centre=60.25)
    y = measures.strain(lattice, state)
    taylor = gx.laws.taylor(lattice.terms[0].law)
    wave = lambda t: (
        gx.theory.kdv.soliton(
            np.arange(119),
            t,
            taylor.K2,
            taylor.K3,
            speed=1.05 * sound,
            centre=60.25,
            mass=numbers.get("mass", 1.0),
        ).strain
    )
    want, rate = jax.jvp(wave, (0.0,), (1.0,))
    np.testing.assert_allclose(y, want, atol=1e-13 * y.max())
    # v_n - v_{n+1} = dy_n/dt: the strain travels
    np.testing.assert_allclose(-np.diff(state.v), rate, atol=1e-13 * np.abs(rate).max())
    assert states.toda_soliton(lattice, amplitude=y.max()).v.max() == pytest.approx(
        float(state.v.max()), rel=0.1
    )


@pytest.mark.parametrize("boundary, bonds", [("fixed", 121), ("periodic", 120)])
def test_a_soliton_where_the_length_is_fixed_stretches_all_bonds_alike(boundary, bonds):
    free, held = pressed(), pressed(boundary=boundary)
    state = states.toda_soliton(held, 0.8)
    y, alone = measures.strain(held, state), measures.strain(free, states.toda_soliton(free, 0.8))
    assert y.sum() == pytest.approx(0, abs=1e-13)
    start = 1 if boundary == "fixed" else 0
    np.testing.assert_allclose(y[start : start + 119], alone - alone.sum() / bonds, atol=1e-13)


@pytest.mark.slow
def test_solitons_of_a_batch():
    chains = jax.vmap(
        lambda k: gx.scenes.monomer(60, stiffness=k, precompression=1.0, boundary="free"),
        out_axes=-1,
    )(jnp.array([1.0, 2.0]))
    for make in (
        lambda x, k: states.toda_soliton(x, k),
        lambda x, a: states.kdv_soliton(x, amplitude=a),
    ):
        both = make(chains, jnp.array([0.5, 0.9]))
        for lane, (stiffness, k) in enumerate(((1.0, 0.5), (2.0, 0.9))):
            one = make(
                gx.scenes.monomer(60, stiffness=stiffness, precompression=1.0, boundary="free"), k
            )
            np.testing.assert_allclose(both.v[:, lane], one.v, atol=1e-14)


@pytest.mark.slow
def test_states_work_inside_jit_and_derivatives():
    def energy(a):
        lattice = chain(8, gx.Hertz(1.0, precompression=1.0))
        made = (
            states.normal_mode(lattice, 2, a),
            states.wave_packet(lattice, 1.0, width=1.0, amplitude=a),
        )
        made += states.impact(lattice, a), states.velocity_step(lattice, a)
        return sum(lattice.energy(0.0, *y) for y in made)

    slope = eqx.filter_jit(jax.grad(energy))(0.01)
    expected = (energy(0.01 + 1e-5) - energy(0.01 - 1e-5)) / 2e-5
    np.testing.assert_allclose(slope, expected, rtol=1e-6)


BAD = {
    "site": (
        lambda: states.impact(chain(5), 1.0, 5),
        r"site: expected an index for each axis, within -5 ... 4, got 5",
    ),
    "site on a grid": (
        lambda: states.impact(plane(), [1.0, 0.0], 1),
        "site: expected an index for each axis",
    ),
    "velocity": (lambda: states.impact(chain(5), np.nan), "velocity: expected finite"),
    "a vector on a chain": (
        lambda: states.impact(chain(5), [1.0, 2.0]),
        "velocity: expected a number",
    ),
    "a number in the plane": (
        lambda: states.impact(plane(), 1.0, (0, 0)),
        "velocity: expected a vector",
    ),
    "field": (lambda: states.impact(cells(), field="resonatr"), "Did you mean 'resonator'"),
    "no field named": (lambda: states.impact(cells(("a", "b"))), "field: expected one of 'a', 'b'"),
    "temperature": (
        lambda: states.thermal(chain(5), -1.0),
        "temperature: expected numbers not below zero",
    ),
    "index": (
        lambda: states.normal_mode(chain(5), 5),
        "index: expected a whole number within -5 ... 4",
    ),
    "sonic vacuum": (lambda: states.normal_mode(chain(5, gx.Hertz())), "sonic vacuum"),
    "k of a sine": (
        lambda: states.sine_mode(chain(5), 6),
        "k: expected a whole number from 1 to 5",
    ),
    "centre of a step": (
        lambda: states.strain_step(chain(5), 0.1, centre=9),
        "centre: expected a place",
    ),
    "k": (lambda: states.wave_packet(chain(50), 4.0), "k: expected numbers in"),
    "soliton in a sonic vacuum": (
        lambda: states.toda_soliton(chain(50, gx.Hertz()), 1.0),
        "expected a linear stiff",
    ),
    "soliton in a dimer": (
        lambda: states.toda_soliton(dimer(), 1.0),
        "lattice: expected a uniform chain",
    ),
    "soliton of a beta chain": (
        lambda: states.kdv_soliton(chain(50, gx.Polynomial(1.0, 0.0, 1.0)), amplitude=0.1),
        "K3 other than zero",
    ),
    "soliton that does not fit": (
        lambda: states.kdv_soliton(pressed(), amplitude=1e-3),
        "longer than the wave",
    ),
    "soliton by two numbers": (
        lambda: states.toda_soliton(pressed(), 1.0, speed=2.0),
        "k, speed, amplitude: expected",
    ),
    "packet in a dimer": (
        lambda: states.wave_packet(dimer(), 1.0),
        "omega: expected the wave's frequency",
    ),
}


@pytest.mark.parametrize("case", BAD, ids=lambda name: name.replace(" ", "-"))
def test_bad_input_is_refused_with_a_sentence(case):
    call, message = BAD[case]
    with pytest.raises(ValueError, match=message):
        call()


@pytest.mark.parametrize("length", [1e-6, 1.0, 1e6])
def test_a_cubic_part_that_varies_is_no_uniform_chain_in_any_unit_of_length(length):
    K3 = np.where(np.arange(39) % 2, 1.0, 1.02) / length
    varied = gx.Lattice(1.0, gx.Bond(gx.Shift(1, "free"), gx.Polynomial(1.0, K3, 0.0)), sites=40)
    with refused("a uniform chain"):
        states.kdv_soliton(varied, speed=1.05, centre=20.0)
