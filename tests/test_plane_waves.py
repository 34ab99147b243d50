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
from granjax import linear, measures, scenes, states

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
def test_the_ring_of_conical_diffraction_is_where_the_cone_has_brought_it():
    made = left_by("conical_diffraction")
    cone = 1.5 / (2 * np.sqrt(3))  # omega^2 = 3 +- 1.5 |q|
    energies = measures.along(measures.site_energy, made.lattice, made.run)
    places, energies = (
        np.concatenate([np.reshape(x[name], shape) for name in "ab"], -1)
        for x, shape in (
            (jax.tree.map(lambda at: np.moveaxis(at, -1, 0), made.lattice.positions), (2, -1)),
            (energies, (3, -1)),
        )
    )
    ring = np.floor(np.linalg.norm(places.T - places.mean(1), axis=1) + 0.5).astype(int)
    count = np.maximum(np.bincount(ring), 1)
    crest = np.array([np.argmax(np.bincount(ring, e) / count) for e in energies])
    # within a cell, whose side is 3^{1/2}
    assert np.abs(crest - (cone * made.run.ts + AHEAD * 4.0)).max() < np.sqrt(3)


@pytest.fixture(scope="module")
def dimer():
    return scenes.dimer(240, ratio=0.5, precompression=1.0, boundary="periodic")


@pytest.mark.slow
@pytest.mark.parametrize("band", [0, 1])
def test_a_packet_of_one_band_runs_with_its_group_velocity(dimer, band):
    speed = float(linear.dispersion(dimer, 1.3).group_velocity[band])
    state = states.bloch_packet(dimer, 1.3, 10.0, band=band, amplitude=1e-6)
    run = gx.simulate(dimer, state, 40.0, save_at=2)
    start, end = measures.along(measures.energy_centre, dimer, run)
    assert float(end - start) / 2 == pytest.approx(speed * 40.0, rel=0.01)
    assert np.abs(state.u).max() == pytest.approx(1e-6, rel=0.05)


@pytest.mark.slow
def test_a_packet_oscillates_with_positive_frequencies_alone(dimer):
    # u + i Omega^{-1} v turns by exp(-i Omega t): its norm is kept, and v = -Omega Im of it, mode by mode
    state = states.bloch_packet(dimer, 2.0, 8.0, polarisation=[1.0, 0.3])
    cell = linear.unit_cell(dimer)
    mass = np.asarray(dimer.mass)
    for k in 2 * np.pi * np.array([30, 38, 45]) / 120:
        squared, q = np.linalg.eigh(np.asarray(cell.dynamical_matrix(jnp.asarray([k]))))
        turn = np.exp(-1j * k * np.arange(120))
        u, v = (q.conj().T @ (turn @ (np.sqrt(mass) * x).reshape(120, 2)) for x in state)
        assert np.abs(v + 1j * np.sqrt(squared) * u).max() < 1e-9 * np.abs(u).max()


@pytest.mark.slow
def test_a_packet_in_the_plane_has_the_components_of_its_polarisation():
    # u = Re a p exp(-|r - c|^2/(2 w^2) + i k . R) without a band, on either site of a cell
    i = np.indices((12, 10))
    wave = np.exp(1j * np.tensordot([1.0, 0.5], i, 1))
    p = {"a": np.array([1.0, -0.4j]), "b": np.array([0.3, 0.2])}
    for crystal, own in (
        (scenes.triangular(12, 10, boundary="periodic"), p["a"]),
        (scenes.honeycomb(12, 10, boundary="periodic"), p),
    ):
        places = crystal.positions
        places = places["a"] if isinstance(places, dict) else places
        c = np.asarray(places[5, 4])
        packet = 0.02 * np.exp(-((places - c) ** 2).sum(-1) / 8) * wave
        u = states.bloch_packet(
            crystal, [1.0, 0.5], 2.0, polarisation=own, centre=c, amplitude=0.02
        ).u
        want = jax.tree.map(lambda x: np.real(packet[..., None] * x), own)
        jax.tree.map(lambda x, y: np.testing.assert_allclose(x, y, atol=1e-15), u, want)


@pytest.mark.slow
def test_packets_are_refused_in_a_sentence_and_have_derivatives(dimer):
    packet = states.bloch_packet
    honeycomb = scenes.honeycomb(6, 6, out_of_plane=True, boundary="periodic")
    unstable = scenes.square(6, precompression=0.5, boundary="periodic")
    for match, call in (
        ("They meet at k", lambda: packet(honeycomb, "K", 2.0, band=0)),
        ("This lattice has 2 bands", lambda: packet(dimer, 1.0, 5.0)),
        ("k: expected one of 'G'", lambda: packet(honeycomb, "Q", 2.0, band=0)),
        ("whole numbers below 2", lambda: packet(dimer, 1.0, 5.0, band=2)),
        ("Its packet would grow", lambda: packet(unstable, "X", 2.0, band=0)),
        (
            "have no derivative",
            lambda: jax.grad(lambda k: packet(dimer, k, 5.0, band=0).u.sum())(1.0),
        ),
    ):
        with refused(match):
            call()
    middle = lambda a: packet(dimer, 1.0, 5.0, band=0, amplitude=a).u[120]
    assert float(jax.grad(middle)(0.1)) == pytest.approx(float(middle(1.0)))


def test_radii_are_sums_over_sites():
    crystal = scenes.hexagon(4, spacing=0.02)
    places = np.asarray(crystal.positions)
    state = states.random(crystal, 1, displacement=0.0, velocity=1.0)
    e = np.asarray(measures.site_energy(crystal, state))
    for centre in (None, (0.01, 0.0)):
        c = e @ places / e.sum() if centre is None else np.asarray(centre)
        want = np.sqrt(e @ ((places - c) ** 2).sum(1) / e.sum())
        found = float(measures.energy_radius(crystal, state, centre=centre))
        assert found == pytest.approx(want, rel=1e-13)


@pytest.mark.slow
def test_a_channel_of_a_linear_sound_bullet_alone_by_scipy():
    """The gallery's example, whose channels add up: the crest of the second one alone, and its time."""
    found = left_by("sound_bullet").found

    def rate(t, y):
        u, v = y.reshape(2, 15, 15)
        p = np.pad(u, 1)
        force = p[2:, 1:-1] + p[:-2, 1:-1] + p[1:-1, 2:] + p[1:-1, :-2] - 4 * u
        if t < 7.0:
            force[0, 4] += 0.7 * np.sin(np.pi * t / 7.0) ** 2
        return np.concatenate([v.ravel(), force.ravel()])

    ts = np.linspace(found.arrival[1] - 0.5, found.arrival[1] + 0.5, 101)
    how = dict(method="DOP853", rtol=1e-10, atol=1e-12, max_step=0.5, t_eval=ts)
    v = solve_ivp(rate, (0, 18.0), np.zeros(450), **how).y[225 + 7 * 15 + 7]
    top = int(np.argmax(v))
    a, b, c = np.polyfit(ts[top - 2 : top + 3] - ts[top], v[top - 2 : top + 3], 2)
    assert ts[top] - b / (2 * a) == pytest.approx(found.arrival[1], abs=1e-4)
    assert c - b * b / (4 * a) == pytest.approx(found.alone[1], rel=1e-6)
    # symmetric channels arrive at a time; together they give more than at once
    assert np.abs(found.arrival - found.arrival[::-1]).max() < 1e-9
    assert found.together[-1] > 1.3 * found.at_once


@pytest.mark.slow
def test_a_sound_bullet_in_a_packing_of_beads():
    crystal = scenes.packing("steel 316", 5e-3, 7, 7, 50.0)
    channels = [(0, j) for j in (1, 3, 5)]
    found = left_by("sound_bullet").bullet(crystal, channels, (3, 3), 9e-5, 1.0, 4e-5, (1.0, 0.0))
    assert 0.9 < found.together[-1] / found.alone.sum() < 1.1
    assert found.together[-1] > found.at_once


@pytest.mark.slow
def test_a_radial_front_falls_and_slows_down_to_sound():
    speed = lambda t, y, lattice: jnp.linalg.norm(y.v, axis=-1)
    hexagon = scenes.hexagon(16, exponent=1.5, precompression=0.1)
    places = np.asarray(hexagon.positions - hexagon.positions.mean(0))
    size = np.linalg.norm(places, axis=-1, keepdims=True)
    outwards = np.where(size < 4 + 1e-9, 0.5 * places / np.maximum(size, 1e-9), 0.0)
    burst = gx.State(hexagon.zeros(), jnp.asarray(outwards))
    record = {"peak": gx.Peak(speed), "at": gx.Arrival(speed, 0.005)}
    run = gx.simulate(hexagon, burst, 13.0, record=record)
    how = {"site": hexagon.shape[0] // 2, "between": (6.0, 13.0)}
    ring = measures.front_decay(hexagon, run.recorded["peak"], **how)
    assert float(ring.exponent) + 5 * float(ring.error) < -0.4
    x, y = places.T
    row = np.flatnonzero((np.abs(y) < 1e-9) & (x > 6.5) & (x < 13.5))
    steps = np.diff(np.asarray(run.recorded["at"])[row[np.argsort(x[row])]])
    # it begins faster than sound, (9/8 K)^{1/2} with K = 3/2 F0^{1/3}, and ends at it
    sound = np.sqrt(9 / 8 * 1.5 * 0.1 ** (1 / 3))
    assert steps[0] < 0.9 / sound < 0.95 / sound < steps[-1] < 1.0 / sound
    assert np.all(np.diff(steps) > 0)
