"""Measures of states and of histories, against closed forms."""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import xarray
from cases import MASS_IN_MASS
from numpy.testing import assert_allclose, assert_array_equal
from refusals import refused

import granjax as gx
from granjax import measures, states


def chain(sites=8, boundary="fixed", precompression=1.0):
    law = gx.Hertz(1.0, precompression=precompression)
    mass = 1.0 + 0.5 * jnp.arange(sites) / sites
    return gx.Lattice(mass, gx.Bond(gx.Shift(1, boundary), law))


def springs(sites, boundary="free", stiffness=1.0, mass=1.0):
    return gx.Lattice(mass, gx.Bond(gx.Shift(1, boundary), gx.Linear(stiffness)), sites=sites)


def scaled(r):
    terms = (gx.Bond(gx.Shift(1, "fixed"), gx.Hertz(r, 1.0)), gx.OnSite(gx.Linear(r)))
    return gx.Lattice(jnp.ones(6) * r, terms)


RATIOS = jnp.array([1.0, 2.0, 3.0])
BATCH = jax.vmap(scaled, out_axes=-1)(RATIOS)
PLANE = gx.scenes.triangular(4, 5, boundary="free")


# ---- energies and momentum


@pytest.mark.slow
@pytest.mark.parametrize(
    "lattice, shapes", [(PLANE, [(4, 5)]), (MASS_IN_MASS, [(6,), (6,)]), (BATCH, [(6, 3)])]
)
def test_site_energies_have_the_sites_shape_and_sum_to_the_energy(lattice, shapes):
    @eqx.filter_jit
    def everything(lattice, t):
        y = states.random(lattice, 1, 0.2, 0.3)
        kinds = measures.kinetic_energy, measures.potential_energy
        parts = sum(kind(lattice, y, t) for kind in kinds)
        return measures.energy(lattice, y, t), measures.site_energy(lattice, y, t), parts

    for t in (0.0, 1.3):
        energy, shares, parts = everything(lattice, t)
        shares = jax.tree.leaves(shares)
        assert energy.shape == lattice.lanes and [x.shape for x in shares] == shapes
        total = sum(x.sum(tuple(range(lattice.axes))) for x in shares)
        assert_allclose(total, energy, rtol=1e-14)
        assert_allclose(parts, energy, rtol=1e-14)


@pytest.mark.parametrize("lattice", [chain(), MASS_IN_MASS], ids=["chain", "fields"])
@pytest.mark.parametrize("kind", [xarray.DataArray, np.ndarray.tolist])
def test_a_state_may_be_of_lists_or_of_arrays_of_xarray(lattice, kind):
    shape = states.random(lattice).u
    y = gx.State(shape, shape)
    pair = jax.tree.map(lambda x: kind(np.asarray(x)), tuple(y))
    size = sum(x.size for x in jax.tree.leaves(shape))
    for measure in (
        measures.energy,
        measures.momentum,
        measures.power,
        measures.site_energy,
        measures.energy_centre,
        measures.contact_force,
        partial(measures.sensor_force, field=lattice.fields and lattice.fields[0]),
        lambda *given: measures.modal_energy(*given, np.eye(size), np.ones(size)),
    ):
        jax.tree.map(assert_array_equal, measure(lattice, pair), measure(lattice, y))


@pytest.mark.slow
def test_a_state_may_be_of_whole_numbers():
    plane = gx.scenes.square(3, exponent=1.5, boundary="free")
    map_ = gx.Stretch(gx.Shift((1, 0), "free"), [[1.0, 0.0]])
    lossy = gx.Lattice(1.0, gx.BrilliantovContact(map_, 1.0, 0.3, 0.1), sites=(3, 3), dimension=2)
    whole = np.zeros((3, 3, 2), int)
    whole[1, 1, 0] = 1
    for lattice in (plane, lossy):
        for measure in (measures.energy, measures.site_energy, measures.contact_force):
            found = measure(lattice, (whole, whole))
            assert_array_equal(found, measure(lattice, (1.0 * whole, 1.0 * whole)))


def test_one_bond_is_shared_by_its_ends_and_a_wall_takes_nothing():
    spring = springs(3, "fixed", 2.0)
    y = gx.State(jnp.array([0.1, 0.0, 0.0]), jnp.zeros(3))
    # bonds wall-0 and 0-1 hold 0.01 each (K e^2/2 = 2 * 0.01/2); site 0 has all of the first, half of the second
    assert_allclose(measures.site_energy(spring, y), [0.015, 0.005, 0.0], rtol=1e-14)
    # the energy of a wall that pulls is negative
    for side, shares in (("left", [-0.005, 0.0, 0.0]), ("right", [0.0, 0.0, -0.02])):
        ends = gx.State(jnp.array([0.1, 0.0, 0.2]), jnp.zeros(3))
        wall = gx.Lattice(1.0, gx.Wall(gx.Linear(-1.0), side), sites=3)
        assert_allclose(measures.site_energy(wall, ends), shares, rtol=1e-14)


def test_momentum_changes_by_the_forces_of_the_walls():
    lattice = chain()
    y = states.random(lattice, 3, 0.3, 1.0)
    rate = measures.momentum(lattice, gx.State(y.u, lattice.acceleration(0.0, y.u, y.v)))
    force = measures.contact_force(lattice, y)
    assert_allclose(rate, force[0] - force[-1], rtol=1e-12)
    struck = states.impact(PLANE, [0.5, -2.0], (1, 2))
    assert_array_equal(measures.momentum(PLANE, struck), [0.5, -2.0])


# ---- contacts


def test_contact_force_overlap_and_strain_by_hand():
    lattice = chain(5, "free")
    y = gx.State(jnp.array([0.3, 0.0, 0.0, 2.0, 4.5]), jnp.zeros(5))
    e = np.array([0.3, 0.0, -2.0, -2.5])
    assert_allclose(measures.strain(lattice, y), e)
    assert_allclose(measures.overlap(lattice, y), 1 + e, rtol=1e-15)
    force = np.maximum(1 + e, 0) ** 1.5
    assert_allclose(measures.contact_force(lattice, y), force, rtol=1e-14, atol=1e-16)
    pressed = chain(8, precompression=0.7)
    at_rest = measures.contact_force(pressed, states.rest(pressed))
    assert_allclose(at_rest, np.full(9, 0.7), rtol=1e-15)


def test_contacts_are_counted_bonds_first_then_walls():
    left = gx.Wall(gx.Hertz(1.0, 0.5), "left", motion=gx.Harmonic(0.2, 1.0))
    near = gx.Bond(gx.Shift(1, "free"), gx.Hertz(1.0, 0.5))
    far = gx.Bond(gx.Shift(2, "free"), gx.Linear(2.0))
    lattice = gx.Lattice(jnp.ones(4), (left, near, far))
    y = states.random(lattice, 2, 0.1)
    assert [measures.strain(lattice, y, bond=i).shape for i in range(3)] == [(3,), (2,), (1,)]
    second = 2 * (y.u[:-2] - y.u[2:])
    assert_allclose(measures.contact_force(lattice, y, bond=1), second, rtol=1e-14)
    # e = w(t) - u_0 with w = 0.2 cos t
    wall = measures.strain(lattice, y, 0.4, bond=2)
    assert_allclose(wall, [0.2 * np.cos(0.4) - y.u[0]], rtol=1e-14)


def test_modulated_contact_force_follows_the_time():
    bond = gx.Bond(gx.Shift(1), gx.Hertz(1.0, precompression=0.5))
    steady = gx.Lattice(jnp.ones(4), bond)
    shaken = gx.Lattice(jnp.ones(4), gx.Modulated(bond, gx.Harmonic(0.3, 2.0, mean=1.0)))
    y = states.random(steady, 2, 0.1)
    ratio = measures.contact_force(shaken, y, 0.7) / measures.contact_force(steady, y)
    assert_allclose(ratio, 1 + 0.3 * np.cos(1.4), rtol=1e-14)


@pytest.mark.slow
def test_lanes_and_jit_give_the_same_as_one_by_one():
    y = states.random(BATCH, 5, 0.1, 0.1)
    for measure in (
        measures.contact_force,
        measures.sensor_force,
        measures.site_energy,
        measures.energy,
        measures.second_moment,
        measures.participation_number,
        measures.momentum,
        measures.overlap,
    ):
        together = eqx.filter_jit(measure)(BATCH, y)
        for lane, r in enumerate(RATIOS):
            alone = measure(scaled(r), gx.State(y.u[:, lane], y.v[:, lane]))
            assert_allclose(together[..., lane], alone, rtol=1e-13)


@pytest.mark.parametrize("boundary", ["free", "periodic"])
def test_a_sensor_in_a_bead_reads_half_the_sum_of_its_contacts(boundary):
    contacts = 4 if boundary == "free" else 5
    A = np.linspace(1.0, 2.0, contacts)
    F0 = 0.5
    bond = gx.Bond(gx.Shift(1, boundary, "bead"), gx.Hertz(A, F0))
    u = 0.9 * np.random.default_rng(2).normal(size=5)
    wanted = np.zeros(5)
    for i in range(contacts):
        j = (i + 1) % 5
        force = A[i] * max((F0 / A[i]) ** (2 / 3) + u[i] - u[j], 0) ** 1.5
        wanted[[i, j]] += force / 2
    state = gx.State({"bead": jnp.asarray(u)}, {"bead": jnp.zeros(5)})
    found = measures.sensor_force(gx.Lattice({"bead": np.ones(5)}, bond), state, field="bead")
    assert_allclose(found, wanted, rtol=1e-13, atol=1e-13)


def test_a_sensor_reads_every_term_between_next_neighbours():
    bond = lambda K, boundary: gx.Bond(gx.Shift(1, boundary), gx.Linear(K))
    pushed = gx.State(jnp.zeros(4).at[0].set(0.3), jnp.zeros(4))
    read = lambda *terms: measures.sensor_force(gx.Lattice(1.0, terms, sites=4), pushed)
    assert_allclose(read(bond(1.0, "free"), bond(2.0, "free")), [0.45, 0.45, 0, 0], atol=1e-15)
    # each with its own ends; a wall, and on a ring the last site, push the first one back
    modulated = gx.Modulated(bond(1.0, "fixed"), gx.Harmonic(0.0, 1.0, mean=2.0))
    found = read(bond(1.0, "free"), modulated, bond(4.0, "periodic"))
    assert_allclose(found, [0.15, 1.05, 0, -0.6], atol=1e-15)


# ---- localisation


def test_participation_centre_and_second_moment_of_two_sites():
    # weights 3, 1: (3 + 1)^2/(9 + 1)
    assert_allclose(measures.participation(jnp.array([3.0, 1.0])), 1.6, rtol=1e-15)
    free = springs(10)
    y = gx.State(jnp.zeros(10), jnp.zeros(10).at[jnp.array([2, 6])].set(1.0))
    assert measures.participation_number(free, y) == 2
    assert measures.energy_centre(free, y) == 4 and measures.second_moment(free, y) == 4
    y = states.impact(PLANE, [1.0, 0.0], (1, 3))
    assert_allclose(measures.energy_centre(PLANE, y), [1, 3], atol=1e-15)
    assert_allclose(measures.second_moment(PLANE, y), 0, atol=1e-15)


def test_participation_of_energies_whose_squares_are_below_float32():
    found = measures.participation(jnp.array([3e-25, 1e-25], jnp.float32))
    assert found.dtype == jnp.float32
    assert_allclose(found, 1.6, rtol=1e-6)


# ---- normal modes


@pytest.mark.slow
def test_modal_energies_sum_to_the_energy_of_a_linear_chain():
    N = 12
    lattice = springs(N, "fixed", 3.0, 2.0)
    k = np.arange(1, N + 1)
    # modes and frequencies of a chain between walls: sqrt(2/(m(N+1))) sin(pi k n/(N+1)), 2 sqrt(K/m) sin(pi k/(2(N+1)))
    modes = np.sqrt(2 / (2.0 * (N + 1))) * np.sin(np.pi * np.outer(k, k) / (N + 1))
    omega = 2 * np.sqrt(1.5) * np.sin(np.pi * k / (2 * (N + 1)))
    y = states.random(lattice, 7, 0.1, 0.2)
    E = measures.modal_energy(lattice, y, modes, omega)
    assert_allclose(E.sum(), measures.energy(lattice, y), rtol=1e-13)
    y = states.normal_mode(lattice, 3, 0.2, phase=0.6)
    one = measures.modal_energy(lattice, y, modes, omega)
    assert_allclose(np.delete(one, 3), 0, atol=1e-28)
    assert_allclose(one[3], 0.04 * omega[3] ** 2 / 2 / np.max(modes[:, 3] ** 2), rtol=1e-12)


# ---- fronts


def pulse(frames):
    """A Gaussian of width 1.5 that runs over 40 sites at 0.84, from site -5 at t = 0."""
    ts = np.linspace(0, 50 / 0.84, frames)
    return ts, np.exp(-(((np.arange(40) + 5 - 0.84 * ts[:, None]) / 1.5) ** 2) / 2)


@pytest.mark.slow
def test_front_speed_of_a_pulse_to_the_right_and_to_the_left():
    ts, q = pulse(800)
    front = measures.front_speed(ts, q, by="arrival")
    assert abs(front.speed - 0.84) < 1e-6 and front.error < 1e-6
    assert front.arrivals.shape == (40,)
    q[:, 7] = 0.0
    both = np.stack([q, q[:, ::-1]], -1)
    front = measures.front_speed(ts, both, sites=np.arange(3, 35))
    assert_allclose(front.speed, [0.84, -0.84], atol=1e-6)
    assert np.isnan(front.arrivals[[4, 29], [0, 1]]).all() and (front.error < 1e-6).all()


@pytest.mark.slow
def test_arrival_and_peak_times_converge_with_order_four():
    errors = {"arrival": [], "peak": []}
    for frames in (300, 600):
        ts, q = pulse(frames)
        peak = (np.arange(40) + 5) / 0.84
        half = peak - 1.5 * np.sqrt(2 * np.log(2)) / 0.84
        errors["arrival"].append(np.sqrt(np.mean((measures.arrival_times(ts, q, 0.5) - half) ** 2)))
        errors["peak"].append(np.sqrt(np.mean((measures.peak_times(ts, q).times - peak) ** 2)))
    for name, error in errors.items():
        assert np.log2(error[0] / error[1]) > 3.5, (name, error)
    assert_allclose(measures.peak_times(*pulse(800)).heights, 1, atol=1e-6)


@pytest.mark.slow
def test_peak_and_arrival_times_have_the_derivatives_of_their_polynomials():
    ts = np.arange(5.0)
    rng = np.random.default_rng(0)
    q = rng.random((5, 400))
    q[2] += 0.5
    way = rng.standard_normal(q.shape)
    times = lambda q: jnp.stack(
        [measures.peak_times(ts, q).times, measures.arrival_times(ts, q, 0.4)]
    )
    found, change = jax.jvp(times, (q,), (way,))
    slopes = np.polynomial.Polynomial.fit
    for j in range(400):
        shape, moved = (slopes(ts, x[:, j], 4) for x in (q, way))
        at = found[0, j]
        if np.isfinite(at):
            bend = shape.deriv(2)(at)
            assert abs(shape.deriv()(at) / bend) < 1e-12
            assert_allclose(change[0, j], -moved.deriv()(at) / bend, rtol=1e-9, atol=1e-9)
    twice = jax.jvp(lambda q: jax.jvp(times, (q,), (way,))[1], (q,), (way,))[1]
    h = 1e-6
    apart = (
        jax.jvp(times, (q + h * way,), (way,))[1] - jax.jvp(times, (q - h * way,), (way,))[1]
    ) / (2 * h)
    small = np.abs(apart) < 10
    assert_allclose(np.asarray(twice)[small], np.asarray(apart)[small], atol=1e-3)


class Bending(gx.Term):
    """An energy for each three neighbours, of a user's own."""

    stiffness: jax.Array

    def energy(self, t, u):
        return self.stiffness * (u[2:] - 2 * u[1:-1] + u[:-2]) ** 2 / 2

    def force(self, t, u, v, mass):
        return -jax.grad(lambda u: self.energy(t, u).sum())(u)


def test_energies_of_an_own_term_are_shared_where_it_is_flat_or_almost():
    spring = gx.Bond(gx.Shift(1, "free"), gx.Linear(1.0))
    lattice = lambda k: gx.Lattice(1.0, (spring, Bending(jnp.asarray(k))), sites=9)
    for size in (0.0, 1e-200, 1e-90, 1e-3):
        y = gx.State(jnp.zeros(9).at[3].set(size), jnp.zeros(9).at[0].set(1.0))
        centre = lambda k: measures.energy_centre(lattice(k), y)
        h = 1e-4
        slope = (centre(0.5 + h) - centre(0.5 - h)) / (2 * h)
        for derivative in (jax.grad, jax.jacfwd):
            assert_allclose(derivative(centre)(0.5), slope, atol=1e-9)
        shared = measures.site_energy(lattice(0.5), y)
        assert_allclose(shared.sum(), measures.energy(lattice(0.5), y), rtol=1e-14)


def test_arrival_that_never_comes_is_nan_and_one_at_the_start_is_the_start():
    ts = np.array([1.0, 2.0, 4.0])
    q = np.array([[0.0, 5.0, 0.0], [0.1, 6.0, 1.0], [0.2, 7.0, 3.0]])
    times = measures.arrival_times(ts, q, 2.0)
    assert np.isnan(times[0]) and times[1] == 1.0
    # the parabola through (1, 0), (2, 1), (4, 3) is the straight line t - 1
    assert_allclose(times[2], 3.0, rtol=1e-14)
    assert np.isnan(measures.peak_times(ts, q).times).all()
    # frames on either side of t = 0
    ts = np.arange(-2.0, 3.0)
    peak = measures.peak_times(ts, 1 - (ts - 0.3) ** 2)
    assert_allclose([peak.times, peak.heights], [0.3, 1.0], rtol=1e-14)


def test_sites_that_a_pulse_has_not_passed_have_no_arrival():
    # the pulse is at site 20, ahead of which there is its foot, and nothing at all beyond 30
    ts, q = pulse(801)
    q = q[: 25 * 16]
    q[:, 30:] = 0.0
    front = measures.front_speed(ts[: len(q)], q, np.arange(3, 40), by="arrival")
    assert abs(front.speed - 0.84) < 1e-3 and front.error < 1e-3
    assert np.isnan(front.arrivals[20:]).all()
    # neither has rounding
    q[:, 30:] = 1e-16 * np.random.default_rng(0).normal(size=q[:, 30:].shape)
    front = measures.front_speed(ts[: len(q)], q, np.arange(3, 40), by="arrival")
    assert abs(front.speed - 0.84) < 1e-3 and np.isnan(front.arrivals[20:]).all()
    # a front that ends at a plateau, or a slow ramp, has its largest value in the last frame
    step = np.tanh(2.0 * (ts[:, None] - np.arange(40) / 0.84)) + 1
    front = measures.front_speed(ts, step, np.arange(3, 35), by="arrival")
    assert abs(front.speed - 0.84) < 1e-5 and np.isfinite(front.arrivals).all()
    behind = np.maximum(ts[:, None] - np.arange(40) / 0.84, 0.0)
    front = measures.front_speed(ts, step * (1 + 3e-3 * behind), np.arange(3, 35), by="arrival")
    assert np.isfinite(front.arrivals).all()


def test_a_preload_does_not_move_the_arrival_of_a_front():
    ts, q = pulse(400)
    preload = 3.0 + 0.1 * np.arange(40)
    how = dict(sites=np.arange(5, 35), by="arrival")
    alone, loaded = (measures.front_speed(ts, x, **how) for x in (q, preload + q))
    assert_allclose(loaded.arrivals, alone.arrivals, rtol=1e-6)
    assert_allclose(loaded.speed, 0.84, rtol=1e-5)


def test_error_of_the_front_speed_is_that_of_a_straight_line():
    rng = np.random.default_rng(0)
    ts = np.linspace(0, 60, 3000)
    centres = np.arange(20) / 0.5 + 5 + 0.05 * rng.standard_normal(20)
    front = measures.front_speed(ts, np.exp(-((ts[:, None] - centres) ** 2)))
    (slope, _), covariance = np.polyfit(np.arange(20), centres, 1, cov=True)
    assert_allclose(front.speed, 1 / slope, rtol=1e-7)
    assert_allclose(front.error, np.sqrt(covariance[0, 0]) / slope**2, rtol=1e-4)


@pytest.mark.slow
def test_arrival_and_peak_times_have_derivatives_in_both_modes():
    ts = jnp.linspace(0.0, 10.0, 1200)

    def arrival(speed):
        return measures.arrival_times(ts, jnp.tanh(speed * ts - 3.0)[:, None], 0.2)[0]

    def peak(centre):
        return measures.peak_times(ts, jnp.exp(-((ts - centre) ** 2))[:, None]).times[0]

    # tanh(c t - 3) = 0.2 at t = (3 + artanh 0.2)/c
    slope = -(3 + np.arctanh(0.2)) / 1.1**2
    for time, at, exact in ((arrival, 1.1, slope), (peak, 4.321, 1.0)):
        assert_allclose(jax.grad(time)(at), exact, rtol=1e-6)
        assert_allclose(jax.jvp(time, (at,), (1.0,))[1], exact, rtol=1e-6)
    difference = (arrival(1.1 + 1e-5) - arrival(1.1 - 1e-5)) / 2e-5
    assert_allclose(jax.grad(arrival)(1.1), difference, rtol=1e-7)


# ---- spectra


@pytest.mark.slow
def test_a_plane_wave_has_its_line_at_its_wave_number_and_frequency():
    N = 32
    T = 256
    dt = 0.1
    k = -2 * np.pi * 5 / N
    omega = 2 * np.pi * 20 / (T * dt)
    t = dt * np.arange(T)[:, None]
    n = np.arange(N)
    s = measures.spectrum(0.3 * np.cos(k * n - omega * t), dt)
    i, j = np.unravel_index(np.argmax(s.power), s.power.shape)
    assert_allclose([s.k[i], s.omega[j]], [k, omega], rtol=1e-14)
    assert_allclose(s.power.sum(), 0.3**2 / 2, rtol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("frames,sites", [(64, 12), (65, 13)])
def test_the_powers_sum_to_the_mean_square(frames, sites):
    us = np.random.default_rng(1).standard_normal((frames, sites, 3))
    s = measures.spectrum(us, 0.2, time_window="none", space_window="none")
    assert s.power.shape == (sites, frames // 2 + 1, 3)
    assert_allclose(s.power.sum((0, 1)), np.mean(us**2, (0, 1)), rtol=1e-12)
    assert_allclose(np.diff(s.k), 2 * np.pi / sites, rtol=1e-12)


def test_spectrogram_follows_a_chirp():
    t = 0.01 * np.arange(6000)
    # phase 5 t + 0.4 t^2: omega = 5 + 0.8 t
    s = measures.spectrogram(np.sqrt(2) * np.cos(5 * t + 0.4 * t**2), 0.01, 6.0)
    ridge = s.omega[np.argmax(s.power, 1)]
    assert np.max(np.abs(ridge - (5 + 0.8 * s.time))) < 2 * np.pi / 6.0
    assert s.time[0] >= 3.0 and s.time[-1] <= 57.0
    assert_allclose(s.power.sum(1) * s.omega[1], 1.0, rtol=0.01)


# ---- bad input


def test_bad_input_is_refused():
    lattice = chain(8)
    grid = gx.scenes.square(3)
    rest = states.rest(lattice)
    run = gx.simulate(lattice, rest, 1.0, step=0.1, save_at=10)
    ts = np.linspace(0, 1, 10)
    q = np.ones((10, 8))
    for call, message in (
        (lambda: measures.energy(lattice, gx.State(q, q)), "measures.along"),
        *(
            (partial(measure, lattice, run), "y: expected a State or a pair.*Run.*measures.along")
            for measure in (measures.energy, measures.strain, measures.contact_force)
        ),
        (lambda: measures.energy(lattice, None), "NoneType. gx.states"),
        (lambda: measures.energy_centre(lattice, (1, 2, 3)), "y: expected a State or a pair"),
        (lambda: measures.strain(lattice, rest, bond=1), "bond: expected an index below 1"),
        (lambda: measures.overlap(springs(8), rest), "can open"),
        (lambda: measures.sensor_force(grid, states.rest(grid)), "bonds between next neighbours"),
        (lambda: measures.modal_energy(lattice, rest, np.eye(7), np.ones(7)), "modes: expected"),
        (lambda: measures.arrival_times(ts[::-1], q, 0.5), "ts: expected rising"),
        (lambda: measures.front_speed(ts, q, by="peek"), "Did you mean 'peak'"),
        (lambda: measures.front_speed(ts, q, sites=[3, 8]), "sites: expected two indices"),
        (lambda: measures.front_speed(ts, q, sites=3), "sites: expected two indices"),
        (lambda: measures.spectrum(q, 0.1, time_window="han"), "Did you mean 'hann'"),
        (lambda: measures.spectrogram(q, 0.1, 5.0), "window and dt: expected"),
    ):
        with refused(message):
            call()
