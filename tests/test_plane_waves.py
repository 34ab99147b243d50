"""Waves in the plane: packets of Bloch waves, conical diffraction, sound bullets, fronts that spread."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from gallery import left_by
from refusals import refused
from scipy.integrate import quad, solve_ivp
from scipy.optimize import minimize_scalar

import granjax as gx

# of a Gaussian packet of width w at a Dirac point the bright ring runs ahead of c t by this much of w, far out: the
# largest of |integral of k^{1/2} exp(-k^2/2) cos(k x - pi/4) dk|, from the asymptotic form of the two Bessel functions
AHEAD = minimize_scalar(
    lambda x: (
        -abs(quad(lambda k: np.sqrt(k) * np.exp(-k * k / 2) * np.cos(k * x - np.pi / 4), 0, 12)[0])
    ),
    bounds=(0, 2),
    method="bounded",
).x


@pytest.mark.slow
def test_conical_diffraction_at_a_dirac_point():
    lattice = gx.scenes.honeycomb(90, 90, out_of_plane=True, boundary="periodic")
    width, cone = 5.0, 1.5 / (2 * np.sqrt(3))  # omega^2 = 3 +- 1.5 |q|
    state = gx.states.bloch_packet(lattice, "K", width, polarisation={"a": 1.0, "b": 0.0})
    run = gx.simulate(lattice, state, 90.0, save_at=4)
    places = np.concatenate([np.asarray(lattice.positions[x]).reshape(-1, 2) for x in "ab"])
    energies = gx.measures.along(gx.measures.site_energy, lattice, run)
    energies = np.concatenate([np.asarray(energies[x]).reshape(4, -1) for x in "ab"], 1)
    ring = np.floor(np.linalg.norm(places - places.mean(0), axis=1) + 0.5).astype(int)
    count = np.maximum(np.bincount(ring), 1)
    crest = np.array([np.argmax(np.bincount(ring, e) / count) for e in energies])
    late = np.asarray(run.ts)[1:]
    # within a cell, whose side is 3^{1/2}
    assert np.abs(crest[1:] - (cone * late + AHEAD * width)).max() < np.sqrt(3) and crest[0] < 2
    # a packet of the third of the width in one band of the Gamma point does not
    still = gx.states.bloch_packet(lattice, "G", width, band=1)
    assert (
        float(gx.measures.energy_radius(lattice, gx.simulate(lattice, still, 90.0).final))
        < 0.75 * crest[-1]
    )


@pytest.fixture(scope="module")
def dimer():
    return gx.scenes.dimer(240, ratio=0.5, precompression=1.0, boundary="periodic")


@pytest.mark.slow
def test_a_packet_of_one_band_runs_with_its_group_velocity(dimer):
    waves = gx.linear.dispersion(dimer, np.array([1.3]))
    small = 1e-6
    for band in (0, 1):
        state = gx.states.bloch_packet(dimer, 1.3, 10.0, band=band, amplitude=small)
        run = gx.simulate(dimer, state, 40.0, save_at=2)
        places = gx.measures.along(gx.measures.energy_centre, dimer, run)
        moved = float(places[1] - places[0]) / 2
        assert moved == pytest.approx(float(waves.group_velocity[0, band]) * 40.0, rel=0.01)
        assert np.abs(state.u).max() == pytest.approx(small, rel=0.05)


def test_a_packet_oscillates_with_positive_frequencies_alone(dimer):
    # u + i Omega^{-1} v turns by exp(-i Omega t): its norm is kept, and v = -Omega Im of it, mode by mode
    modes = gx.linear.normal_modes(dimer)
    state = gx.states.bloch_packet(dimer, 2.0, 8.0, polarisation=[1.0, 0.3])
    mass = np.asarray(dimer.mass)
    cell = gx.linear.unit_cell(dimer)
    n = 120
    for k in 2 * np.pi * np.array([30, 38, 45]) / n:
        squared, q = np.linalg.eigh(np.asarray(cell.dynamical_matrix(jnp.asarray([k]))))
        turn = np.exp(-1j * k * np.arange(n))[:, None]
        at = lambda x, turn=turn: np.sum((np.sqrt(mass) * np.asarray(x)).reshape(n, 2) * turn, 0)
        u, v = q.conj().T @ at(state.u), q.conj().T @ at(state.v)
        assert np.abs(v + 1j * np.sqrt(squared) * u).max() < 1e-9 * np.abs(u).max()
    assert float(modes.omega.max()) > 0


def test_packets_are_refused_in_a_sentence(dimer):
    honeycomb = gx.scenes.honeycomb(6, 6, out_of_plane=True, boundary="periodic")
    for match, call in (
        ("They meet at k", lambda: gx.states.bloch_packet(honeycomb, "K", 2.0, band=0)),
        ("This lattice has 2 bands", lambda: gx.states.bloch_packet(dimer, 1.0, 5.0)),
        ("k: expected one of 'G'", lambda: gx.states.bloch_packet(honeycomb, "Q", 2.0, band=0)),
        ("whole numbers below 2", lambda: gx.states.bloch_packet(dimer, 1.0, 5.0, band=2)),
        (
            "Its packet would grow",
            lambda: gx.states.bloch_packet(
                gx.scenes.square(6, precompression=0.5, boundary="periodic"), "X", 2.0, band=0
            ),
        ),
        (
            "have no derivative",
            lambda: jax.grad(lambda k: gx.states.bloch_packet(dimer, k, 5.0, band=0).u.sum())(1.0),
        ),
    ):
        with refused(match):
            call()
    slope = jax.grad(lambda a: gx.states.bloch_packet(dimer, 1.0, 5.0, band=0, amplitude=a).u[120])(
        0.1
    )
    assert float(slope) == pytest.approx(
        float(gx.states.bloch_packet(dimer, 1.0, 5.0, band=0, amplitude=1.0).u[120])
    )


def test_radii_are_sums_over_sites():
    crystal = gx.scenes.hexagon(4, spacing=0.02)
    places = np.asarray(crystal.positions)
    state = gx.states.random(crystal, 1, displacement=0.0, velocity=1.0)
    e = np.asarray(gx.measures.site_energy(crystal, state))
    for centre in (None, (0.01, 0.0)):
        c = (e[:, None] * places).sum(0) / e.sum() if centre is None else np.asarray(centre)
        want = np.sqrt((e * ((places - c) ** 2).sum(1)).sum() / e.sum())
        assert float(gx.measures.energy_radius(crystal, state, centre=centre)) == pytest.approx(
            want, rel=1e-13
        )


CHANNELS, FOCUS = [(0, j) for j in range(2, 19, 4)], (10, 10)


@pytest.fixture(scope="module")
def linear_bullet():
    square = gx.scenes.square(21, out_of_plane=True)
    return square, left_by("sound_bullet").bullet(square, CHANNELS, FOCUS, 26.0, 0.7, 7.0)


@pytest.mark.slow
def test_in_a_linear_lattice_the_gain_of_a_sound_bullet_is_the_sum(linear_bullet):
    square, found = linear_bullet
    strongest = found.alone.max()
    assert np.abs(found.together - found.alone.cumsum()).max() < 6 * found.error < 1e-4 * strongest
    assert found.together[-1] > 1.3 * found.at_once
    # symmetric channels arrive at a time
    assert np.abs(found.arrival - found.arrival[::-1]).max() < 1e-9


@pytest.mark.slow
def test_a_channel_alone_by_scipy(linear_bullet):
    square, found = linear_bullet

    def rate(t, y):
        u, v = y.reshape(2, 21, 21)
        p = np.pad(u, 1)
        force = p[2:, 1:-1] + p[:-2, 1:-1] + p[1:-1, 2:] + p[1:-1, :-2] - 4 * u
        if t < 7.0:
            force[CHANNELS[1]] += 0.7 * np.sin(np.pi * t / 7.0) ** 2
        return np.concatenate([v.ravel(), force.ravel()])

    ts = np.linspace(found.arrival[1] - 0.5, found.arrival[1] + 0.5, 101)
    run = solve_ivp(
        rate,
        (0, 26.0),
        np.zeros(882),
        method="DOP853",
        rtol=1e-10,
        atol=1e-12,
        max_step=0.5,
        t_eval=ts,
    )
    v = run.y[441 + FOCUS[0] * 21 + FOCUS[1]]
    top = int(np.argmax(v))
    a, b, c = np.polyfit(ts[top - 2 : top + 3] - ts[top], v[top - 2 : top + 3], 2)
    assert ts[top] - b / (2 * a) == pytest.approx(found.arrival[1], abs=1e-4)
    assert c - b * b / (4 * a) == pytest.approx(found.alone[1], rel=1e-6)


@pytest.mark.study
def test_a_sound_bullet_in_a_packing_of_beads():
    crystal = gx.scenes.packing("steel 316", 5e-3, 15, 15, 50.0)
    channels = [(0, j) for j in (3, 5, 7, 9, 11)]
    found = left_by("sound_bullet").bullet(crystal, channels, (7, 5), 1.5e-4, 1.0, 4e-5, (1.0, 0.0))
    assert 0.9 < found.together[-1] / found.alone.sum() < 1.1
    assert found.together[-1] > found.at_once


@pytest.mark.study
def test_a_radial_front_falls_and_slows_down_where_a_planar_one_does_neither():
    speed = lambda t, y, lattice: jnp.linalg.norm(y.v, axis=-1)

    def fronts(crystal, state, until, threshold, **where):
        run = gx.simulate(
            crystal,
            state,
            until,
            record={"peak": gx.Peak(speed), "at": gx.Arrival(speed, threshold)},
        )
        return run, gx.measures.front_decay(crystal, run.recorded["peak"], **where)

    hexagon = gx.scenes.hexagon(16, exponent=1.5, precompression=0.1)
    away = np.asarray(hexagon.positions - hexagon.positions.mean(0))
    size = np.linalg.norm(away, axis=-1, keepdims=True)
    outwards = np.where(size < 4 + 1e-9, 0.5 * away / np.maximum(size, 1e-9), 0.0)
    burst = gx.State(hexagon.zeros(), jnp.asarray(outwards))
    run, ring = fronts(hexagon, burst, 13.0, 0.005, site=hexagon.shape[0] // 2, between=(6.0, 13.0))
    assert float(ring.exponent) + 5 * float(ring.error) < -0.4
    places, at = np.asarray(hexagon.positions), np.asarray(run.recorded["at"])
    row = np.flatnonzero(
        (np.abs(places[:, 1]) < 1e-9) & (places[:, 0] > 6.5) & (places[:, 0] < 13.5)
    )
    steps = np.diff(at[row[np.argsort(places[row, 0])]])
    # it begins faster than sound, (9/8 K)^{1/2} with K = 3/2 F0^{1/3}, and ends at it
    sound = np.sqrt(9 / 8 * 1.5 * 0.1 ** (1 / 3))
    assert steps[0] < 0.9 / sound < 0.95 / sound < steps[-1] < 1.0 / sound and np.all(
        np.diff(steps) > 0
    )
    # a whole row of beads in touch, pushed: a solitary wave
    strip = gx.scenes.square(24, 4, exponent=1.5, boundary=("fixed", "periodic"))
    v = strip.zeros().at[0, :, 0].set(0.5)
    _, plane = fronts(
        strip,
        gx.State(strip.zeros(), v),
        24.0,
        0.005,
        site=(0, 0),
        direction=[1.0, 0.0],
        between=(5.0, 16.0),
    )
    assert abs(float(plane.exponent)) < 0.01
