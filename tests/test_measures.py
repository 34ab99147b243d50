"""Measures of states and of histories, against closed forms."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from refusals import refused

import granjax as gx
from granjax import measures, states


def chain(sites=8, boundary="fixed", precompression=1.0, extra=()):
    law = gx.Hertz(1.0, precompression=precompression)
    mass = 1.0 + 0.5 * jnp.arange(sites) / sites
    return gx.Lattice(mass, (gx.Bond(gx.Shift(1, boundary), law), *extra))


def plane():
    """A square lattice in the plane, with prestress."""
    bonds = [
        gx.Bond(gx.Stretch(gx.Shift(o, ("free", "free")), r), gx.Hertz(1.0, 0.1)) for o, r in SQUARE
    ]
    return gx.Lattice(1.0, tuple(bonds), sites=(4, 5), dimension=2)


SQUARE = (((1, 0), [1.0, 0.0]), ((0, 1), [0.0, 1.0]))


def cells():
    """A chain of beads with a resonator each, in a field of springs, with an elastic wall at the right."""
    bead = gx.Bond(gx.Shift(1, "free", "bead"), gx.Hertz(1.0, 0.5))
    inner = gx.Bond(gx.Shift(0, "free", ("bead", "resonator")), gx.Linear(0.7))
    wall = gx.Wall(gx.Hertz(2.0, 0.5), "right", field="bead")
    mass = {"bead": jnp.ones(6), "resonator": jnp.full(6, 0.3)}
    return gx.Lattice(mass, (bead, inner, wall, gx.OnSite(gx.Linear(0.2), "resonator")))


def batch():
    def make(r):
        return gx.Lattice(
            jnp.ones(6) * r,
            (gx.Bond(gx.Shift(1, "fixed"), gx.Hertz(r, 1.0)), gx.OnSite(gx.Linear(r))),
        )

    return jax.vmap(make, out_axes=-1)(jnp.array([1.0, 2.0, 3.0]))


MODULATION = gx.Harmonic(0.3, 1.0, mean=1.0)
LATTICES = {
    "fixed": chain,
    "free": lambda: chain(boundary="free"),
    "periodic": lambda: chain(boundary="periodic"),
    "sonic vacuum": lambda: chain(precompression=0.0),
    "on-site": lambda: chain(extra=(gx.OnSite(gx.Sine()),)),
    "second neighbours": lambda: chain(extra=(gx.Bond(gx.Shift(2, "fixed"), gx.Linear(0.3)),)),
    "modulated": lambda: chain(
        extra=(gx.Modulated(gx.Bond(gx.Shift(1), gx.Linear()), MODULATION),)
    ),
    "graph": lambda: gx.Lattice(
        jnp.ones(4), (gx.Bond(gx.Pairs([-1, 0, 0, 2], [0, 1, 3, -1]), gx.Toda()),)
    ),
    "plane": plane,
    "cells": cells,
    "batch": batch,
}


@pytest.fixture(params=LATTICES, ids=lambda name: name.replace(" ", "-"))
def lattice(request):
    return LATTICES[request.param]()


def total(lattice, x):
    """Sum over the sites (not the lanes) of an array or a dict of them."""
    return sum(leaf.sum(tuple(range(lattice.axes))) for leaf in jax.tree.leaves(x))


# ---- energies and momentum


@pytest.mark.study
def test_site_energies_have_the_sites_shape_and_sum_to_the_energy(lattice):
    @eqx.filter_jit
    def everything(lattice, t):
        y = states.random(lattice, 1, 0.2, 0.3)
        return [
            f(lattice, y, t)
            for f in (
                measures.energy,
                measures.site_energy,
                measures.kinetic_energy,
                measures.potential_energy,
            )
        ]

    for t in (0.0, 1.3):
        energy, e, kinetic, potential = everything(lattice, t)
        assert energy.shape == lattice.lanes
        assert jax.tree.map(jnp.shape, e) == jax.tree.map(
            lambda s: tuple(s) + lattice.lanes,
            lattice.sites,
            is_leaf=lambda s: isinstance(s, tuple),
        )
        np.testing.assert_allclose(total(lattice, e), energy, rtol=1e-14)
        np.testing.assert_allclose(kinetic + potential, energy, rtol=1e-14)


def test_one_bond_is_shared_by_its_ends_and_a_wall_takes_nothing():
    spring = gx.Lattice(jnp.ones(3), (gx.Bond(gx.Shift(1, "fixed"), gx.Linear(2.0)),))
    y = gx.State(jnp.array([0.1, 0.0, 0.0]), jnp.zeros(3))
    # bonds wall-0 and 0-1 hold 0.01 each (K e^2/2 = 2 * 0.01/2); site 0 has all of the first, half of the second
    np.testing.assert_allclose(measures.site_energy(spring, y), [0.015, 0.005, 0.0], rtol=1e-14)


def test_inner_forces_keep_the_momentum():
    free = chain(boundary="free")
    y = states.random(free, 3, 0.3, 1.0)
    a = free.acceleration(0.0, y.u, y.v)
    rate = measures.momentum(free, gx.State(y.u, a))
    assert abs(rate) < 1e-15 * len(a)
    walls = chain(boundary="fixed")
    wall_force = measures.contact_force(walls, y)
    a = walls.acceleration(0.0, y.u, y.v)
    pushed = measures.momentum(walls, gx.State(y.u, a))
    np.testing.assert_allclose(pushed, wall_force[0] - wall_force[-1], rtol=1e-12)


def test_momentum_in_the_plane_is_a_vector():
    lattice = plane()
    y = states.impact(lattice, [0.5, -2.0], (1, 2))
    np.testing.assert_array_equal(measures.momentum(lattice, y), [0.5, -2.0])


@pytest.mark.slow
def test_species_energies_sum_to_the_energy():
    dimer = chain(10)
    y = states.random(dimer, 1, 0.1, 0.5)
    e = measures.site_energy(dimer, y)
    total = measures.energy(dimer, y)
    np.testing.assert_allclose(e[::2].sum() + e[1::2].sum(), total, rtol=1e-14)
    lattice = cells()
    y = states.random(lattice, 1, 0.1, 0.5)
    kinds = measures.site_energy(lattice, y)
    np.testing.assert_allclose(
        kinds["bead"].sum() + kinds["resonator"].sum(), measures.energy(lattice, y), rtol=1e-14
    )


# ---- contacts


def test_contact_force_at_rest_is_the_preload():
    force = measures.contact_force(chain(8, precompression=0.7), states.rest(chain(8)))
    assert force.shape == (9,)
    np.testing.assert_allclose(force, 0.7, rtol=1e-15)


def test_contact_force_overlap_and_strain_by_hand():
    lattice = chain(5, "free", 1.0)
    u = jnp.array([0.3, 0.0, 0.0, 2.0, 4.5])
    y = gx.State(u, jnp.zeros(5))
    e = np.array([0.3, 0.0, -2.0, -2.5])
    np.testing.assert_allclose(measures.strain(lattice, y), e)
    np.testing.assert_allclose(measures.overlap(lattice, y), 1 + e, rtol=1e-15)
    np.testing.assert_allclose(
        measures.contact_force(lattice, y), np.maximum(1 + e, 0) ** 1.5, rtol=1e-14, atol=1e-16
    )


def test_contacts_are_counted_bonds_first_then_walls():
    left = gx.Wall(gx.Hertz(1.0, 0.5), "left", motion=gx.Harmonic(0.2, 1.0))
    near, far = (
        gx.Bond(gx.Shift(1, "free"), gx.Hertz(1.0, 0.5)),
        gx.Bond(gx.Shift(2, "free"), gx.Linear(2.0)),
    )
    lattice = gx.Lattice(jnp.ones(4), (left, near, far))
    y = states.random(lattice, 2, 0.1)
    assert [measures.strain(lattice, y, bond=i).shape for i in range(3)] == [(3,), (2,), (1,)]
    np.testing.assert_allclose(
        measures.contact_force(lattice, y, bond=1), 2 * (y.u[:-2] - y.u[2:]), rtol=1e-14
    )
    # e = w(t) - u_0 with w = 0.2 cos t
    wall = measures.strain(lattice, y, 0.4, bond=2)
    np.testing.assert_allclose(wall, [0.2 * np.cos(0.4) - y.u[0]], rtol=1e-14)


def test_modulated_contact_force_follows_the_time():
    law = gx.Hertz(1.0, precompression=0.5)
    steady = gx.Lattice(jnp.ones(4), (gx.Bond(gx.Shift(1), law),))
    shaken = gx.Lattice(
        jnp.ones(4), (gx.Modulated(gx.Bond(gx.Shift(1), law), gx.Harmonic(0.3, 2.0, mean=1.0)),)
    )
    y = states.random(steady, 2, 0.1)
    ratio = measures.contact_force(shaken, y, 0.7) / measures.contact_force(steady, y)
    np.testing.assert_allclose(ratio, 1 + 0.3 * np.cos(1.4), rtol=1e-14)


@pytest.mark.slow
def test_lanes_and_jit_give_the_same_as_one_by_one():
    lattice = batch()
    y = states.random(lattice, 5, 0.1, 0.1)
    for measure in (
        measures.contact_force,
        measures.site_energy,
        measures.energy,
        measures.second_moment,
        measures.participation_number,
        measures.momentum,
        measures.overlap,
    ):
        all_at_once = eqx.filter_jit(measure)(lattice, y)
        for lane, r in enumerate((1.0, 2.0, 3.0)):
            terms = (gx.Bond(gx.Shift(1, "fixed"), gx.Hertz(r, 1.0)), gx.OnSite(gx.Linear(r)))
            alone = measure(
                gx.Lattice(jnp.ones(6) * r, terms), gx.State(y.u[:, lane], y.v[:, lane])
            )
            np.testing.assert_allclose(all_at_once[..., lane], alone, rtol=1e-13)


@pytest.mark.slow
def test_along_a_run_gives_every_frame():
    class Run:
        ts = jnp.linspace(0.0, 1.0, 4)
        us = 0.1 * jax.random.normal(jax.random.key(0), (4, 8))
        vs = 0.1 * jax.random.normal(jax.random.key(1), (4, 8))

    lattice = chain(8)
    force = measures.along(measures.contact_force, lattice, Run)
    assert force.shape == (4, 9)
    frame = gx.State(Run.us[2], Run.vs[2])
    np.testing.assert_allclose(force[2], measures.contact_force(lattice, frame), rtol=1e-15)
    shares = measures.along(measures.site_energy, lattice, Run)
    total = measures.along(measures.energy, lattice, Run)
    np.testing.assert_allclose(shares.sum(1), total, rtol=1e-14)


def test_a_derivative_goes_through_a_measure():
    def force(A):
        lattice = gx.Lattice(jnp.ones(4), (gx.Bond(gx.Shift(1), gx.Hertz(A)),))
        return measures.contact_force(
            lattice, gx.State(jnp.array([0.4, 0.0, 0.0, 0.0]), jnp.zeros(4))
        )[1]

    np.testing.assert_allclose(jax.grad(force)(2.0), 0.4**1.5, rtol=1e-14)


# ---- localisation


def test_participation_of_uniform_and_of_one():
    free = gx.Lattice(jnp.ones(10), (gx.Bond(gx.Shift(1, "periodic"), gx.Linear()),))
    everywhere = gx.State(jnp.zeros(10), jnp.ones(10))
    assert measures.participation_number(free, everywhere) == 10
    assert measures.participation_number(free, states.impact(free, 2.0, 3)) == 1
    # weights 3, 1: (3 + 1)^2/(9 + 1)
    np.testing.assert_allclose(measures.participation(jnp.array([3.0, 1.0])), 1.6, rtol=1e-15)


@pytest.mark.slow
def test_centre_and_second_moment():
    free = gx.Lattice(jnp.ones(10), (gx.Bond(gx.Shift(1, "free"), gx.Linear()),))
    y = gx.State(jnp.zeros(10), jnp.zeros(10).at[jnp.array([2, 6])].set(1.0))
    assert measures.energy_centre(free, y) == 4 and measures.second_moment(free, y) == 4
    grid = plane()
    y = states.impact(grid, [1.0, 0.0], (1, 3))
    # closed contacts at rest hold rounding of their static energy, 1e-17
    np.testing.assert_allclose(measures.energy_centre(grid, y), [1, 3], atol=1e-15)
    np.testing.assert_allclose(measures.second_moment(grid, y), 0, atol=1e-15)


# ---- normal modes


@pytest.mark.slow
def test_modal_energies_sum_to_the_energy_of_a_linear_chain():
    N = 12
    lattice = gx.Lattice(jnp.full(N, 2.0), (gx.Bond(gx.Shift(1, "fixed"), gx.Linear(3.0)),))
    k = np.arange(1, N + 1)
    # modes and frequencies of a chain between walls: sqrt(2/(m(N+1))) sin(pi k n/(N+1)), 2 sqrt(K/m) sin(pi k/(2(N+1)))
    modes = np.sqrt(2 / (2.0 * (N + 1))) * np.sin(np.pi * np.outer(k, k) / (N + 1))
    omega = 2 * np.sqrt(1.5) * np.sin(np.pi * k / (2 * (N + 1)))
    y = states.random(lattice, 7, 0.1, 0.2)
    E = measures.modal_energy(lattice, y, modes, omega)
    np.testing.assert_allclose(E.sum(), measures.energy(lattice, y), rtol=1e-13)
    one = measures.modal_energy(
        lattice, states.normal_mode(lattice, 3, 0.2, phase=0.6), modes, omega
    )
    np.testing.assert_allclose(np.delete(one, 3), 0, atol=1e-28)
    np.testing.assert_allclose(
        one[3], 0.04 * omega[3] ** 2 / 2 / np.max(modes[:, 3] ** 2), rtol=1e-12
    )


# ---- fronts


def pulse(frames, sites, speed, width):
    """A Gaussian that runs with a known speed, from site -5 at t = 0."""
    ts = np.linspace(0, (sites + 10) / speed, frames)
    return ts, np.exp(-(((np.arange(sites) + 5 - speed * ts[:, None]) / width) ** 2) / 2)


@pytest.mark.slow
@pytest.mark.parametrize("by", ["peak", "arrival"])
def test_front_speed_of_a_pulse(by):
    ts, q = pulse(800, 40, 0.84, 1.5)
    front = measures.front_speed(ts, q, by=by)
    assert abs(front.speed - 0.84) < 1e-6 and front.error < 1e-6
    assert front.arrivals.shape == (40,)


@pytest.mark.slow
def test_arrival_and_peak_times_converge_with_order_four():
    errors = {"arrival": [], "peak": []}
    for frames in (300, 600):
        ts, q = pulse(frames, 40, 0.84, 1.5)
        peak = (np.arange(40) + 5) / 0.84
        half = peak - 1.5 * np.sqrt(2 * np.log(2)) / 0.84
        errors["arrival"].append(np.sqrt(np.mean((measures.arrival_times(ts, q, 0.5) - half) ** 2)))
        errors["peak"].append(np.sqrt(np.mean((measures.peak_times(ts, q).times - peak) ** 2)))
    for name, error in errors.items():
        assert np.log2(error[0] / error[1]) > 3.5, (name, error)
    heights = measures.peak_times(*pulse(800, 40, 0.84, 1.5)).heights
    np.testing.assert_allclose(heights, 1, atol=1e-6)


def test_arrival_that_never_comes_is_nan_and_one_at_the_start_is_the_start():
    ts = np.array([1.0, 2.0, 4.0])
    q = np.array([[0.0, 5.0, 0.0], [0.1, 6.0, 1.0], [0.2, 7.0, 3.0]])
    times = measures.arrival_times(ts, q, 2.0)
    assert np.isnan(times[0]) and times[1] == 1.0
    # the parabola through (1, 0), (2, 1), (4, 3) is the straight line t - 1
    np.testing.assert_allclose(times[2], 3.0, rtol=1e-14)
    assert np.isnan(measures.peak_times(ts, q).times).all()


@pytest.mark.slow
def test_a_front_that_runs_left_and_skips_silent_sites():
    ts, q = pulse(800, 40, 0.84, 1.5)
    q[:, 7] = 0.0
    backward = measures.front_speed(ts, q[:, ::-1])
    assert abs(backward.speed + 0.84) < 1e-6 and np.isnan(backward.arrivals[32])
    lanes = measures.front_speed(ts, np.stack([q, q[:, ::-1]], -1), sites=np.arange(5, 30))
    np.testing.assert_allclose(lanes.speed, [0.84, -0.84], atol=1e-6)


def test_error_of_the_front_speed_is_that_of_a_straight_line():
    rng = np.random.default_rng(0)
    ts = np.linspace(0, 60, 3000)
    centres = np.arange(20) / 0.5 + 5 + 0.05 * rng.standard_normal(20)
    front = measures.front_speed(ts, np.exp(-((ts[:, None] - centres) ** 2)))
    (slope, _), covariance = np.polyfit(np.arange(20), centres, 1, cov=True)
    np.testing.assert_allclose(front.speed, 1 / slope, rtol=1e-7)
    np.testing.assert_allclose(front.error, np.sqrt(covariance[0, 0]) / slope**2, rtol=1e-4)


@pytest.mark.slow
def test_derivative_of_an_arrival_time():
    ts = jnp.linspace(0.0, 10.0, 1200)

    def arrival(speed):
        return measures.arrival_times(ts, jnp.tanh(speed * ts - 3.0)[:, None], 0.2)[0]

    # tanh(c t - 3) = 0.2 at t = (3 + artanh 0.2)/c
    slope = jax.grad(arrival)(1.1)
    np.testing.assert_allclose(slope, -(3 + np.arctanh(0.2)) / 1.1**2, rtol=1e-6)
    np.testing.assert_allclose(slope, (arrival(1.1 + 1e-5) - arrival(1.1 - 1e-5)) / 2e-5, rtol=1e-7)


@pytest.mark.slow
def test_derivative_of_a_peak_time():
    ts = jnp.linspace(0.0, 10.0, 1200)

    def peak(centre):
        return measures.peak_times(ts, jnp.exp(-((ts - centre) ** 2))[:, None]).times[0]

    np.testing.assert_allclose(jax.grad(peak)(4.321), 1.0, rtol=1e-6)
    np.testing.assert_allclose(jax.jvp(peak, (4.321,), (1.0,))[1], 1.0, rtol=1e-6)


# ---- spectra


@pytest.mark.slow
@pytest.mark.parametrize("direction", [1, -1])
@pytest.mark.parametrize("window", ["hann", "none"])
def test_a_plane_wave_has_its_line_at_its_wave_number_and_frequency(direction, window):
    N, T, dt = 32, 256, 0.1
    k, omega = direction * 2 * np.pi * 5 / N, 2 * np.pi * 20 / (T * dt)
    t, n = dt * np.arange(T)[:, None], np.arange(N)
    s = measures.spectrum(
        0.3 * np.cos(k * n - omega * t), dt, time_window=window, space_window=window
    )
    i, j = np.unravel_index(np.argmax(s.power), s.power.shape)
    np.testing.assert_allclose([s.k[i], s.omega[j]], [k, omega], rtol=1e-14)
    np.testing.assert_allclose(s.power.sum(), 0.3**2 / 2, rtol=1e-12)
    if window == "none":
        np.testing.assert_allclose(s.power[i, j], 0.3**2 / 2, rtol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("frames,sites", [(64, 12), (65, 13)])
def test_parseval(frames, sites):
    us = np.random.default_rng(1).standard_normal((frames, sites, 3))
    s = measures.spectrum(us, 0.2, time_window="none", space_window="none")
    assert s.power.shape == (sites, frames // 2 + 1, 3)
    np.testing.assert_allclose(s.power.sum((0, 1)), np.mean(us**2, (0, 1)), rtol=1e-12)
    np.testing.assert_allclose(np.diff(s.k), 2 * np.pi / sites, rtol=1e-12)
    assert abs(s.k).max() <= np.pi * (1 + 1e-15) and s.omega.max() <= np.pi / 0.2 * (1 + 1e-15)


def test_spectrogram_follows_a_chirp():
    t = 0.01 * np.arange(6000)
    # phase 5 t + 0.4 t^2: omega = 5 + 0.8 t
    s = measures.spectrogram(np.sqrt(2) * np.cos(5 * t + 0.4 * t**2), 0.01, 6.0)
    ridge = s.omega[np.argmax(s.power, 1)]
    assert np.max(np.abs(ridge - (5 + 0.8 * s.time))) < 2 * np.pi / 6.0
    assert s.time[0] >= 3.0 and s.time[-1] <= 57.0
    np.testing.assert_allclose(s.power.sum(1) * s.omega[1], 1.0, rtol=0.01)


# ---- bad input

REST = states.rest(chain(8))
TS, Q = np.linspace(0, 1, 10), np.ones((10, 8))
BAD = {
    "another shape": (lambda: measures.energy(chain(9), REST), r"y.u: expected shape \(9,\)"),
    "a trajectory": (lambda: measures.energy(chain(8), gx.State(Q, Q)), "measures.along"),
    "a bond that is not there": (
        lambda: measures.strain(chain(8), REST, bond=1),
        "bond: expected an index below 1",
    ),
    "no contact to open": (
        lambda: measures.overlap(
            gx.Lattice(jnp.ones(8), (gx.Bond(gx.Shift(1), gx.Linear()),)), REST
        ),
        "can open",
    ),
    "modes": (
        lambda: measures.modal_energy(chain(8), REST, np.eye(7), np.ones(7)),
        "modes: expected shape",
    ),
    "falling times": (lambda: measures.arrival_times(TS[::-1], Q, 0.5), "ts: expected rising"),
    "frames": (lambda: measures.arrival_times(TS[:5], Q, 0.5), "q: expected 5 frames"),
    "by": (lambda: measures.front_speed(TS, Q, by="peek"), "Did you mean 'peak'"),
    "sites": (
        lambda: measures.front_speed(TS, Q, sites=[3, 8]),
        "sites: expected two indices or more",
    ),
    "one site": (
        lambda: measures.front_speed(TS, Q, sites=[3]),
        "sites: expected two indices or more",
    ),
    "window name": (lambda: measures.spectrum(Q, 0.1, time_window="han"), "Did you mean 'hann'"),
    "long window": (
        lambda: measures.spectrogram(Q, 0.1, 5.0),
        "window and dt: expected a window of 4 to",
    ),
}


@pytest.mark.parametrize("case", BAD, ids=lambda name: name.replace(" ", "-"))
def test_bad_input_is_refused_with_a_sentence(case):
    call, message = BAD[case]
    with refused(message):
        call()


@pytest.mark.parametrize("boundary", ["fixed", "free", "periodic"])
def test_what_a_sensor_in_a_bead_reads(boundary):
    A, F0, n = np.linspace(1.0, 2.0, 6), 0.5, {"fixed": 6, "free": 4, "periodic": 5}[boundary]
    chain = gx.Lattice(np.ones(5), gx.Bond(gx.Shift(1, boundary), gx.Hertz(A[:n], F0)))
    u = 0.9 * np.random.default_rng(2).normal(size=(5, 2))
    state = gx.State(jnp.asarray(u[:, 0]), jnp.zeros(5))
    wide = {"fixed": np.pad(u[:, 0], 1), "free": u[:, 0], "periodic": np.append(u[:, 0], u[0, 0])}[
        boundary
    ]
    force = A[:n] * np.maximum((F0 / A[:n]) ** (2 / 3) - np.diff(wide), 0) ** 1.5
    left = {"fixed": force[:-1], "free": np.append(0, force), "periodic": np.roll(force, 1)}[
        boundary
    ]
    right = {"fixed": force[1:], "free": np.append(force, 0), "periodic": force}[boundary]
    np.testing.assert_allclose(
        gx.measures.sensor_force(chain, state), (left + right) / 2, rtol=1e-13, atol=1e-13
    )


def test_a_sensor_needs_neighbours():
    with refused("bonds between next neighbours"):
        gx.measures.sensor_force(gx.scenes.square(3), gx.states.rest(gx.scenes.square(3)))
    chain = gx.scenes.mass_in_mass(6, 0.5, 1.0)
    rest = gx.states.rest(chain)
    assert gx.measures.sensor_force(chain, rest, field="bead").shape == (6,)


def test_sensors_in_a_batch():
    chains = jax.vmap(lambda F0: gx.scenes.monomer(5, precompression=F0), out_axes=-1)(
        jnp.array([0.5, 2.0])
    )
    found = gx.measures.sensor_force(chains, gx.states.rest(chains))
    np.testing.assert_allclose(found, np.broadcast_to([0.5, 2.0], (5, 2)), rtol=1e-14)
