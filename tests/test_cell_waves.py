"""Waves of dimers and of beads with resonators, against published values, closed forms and simulations."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose
from refusals import refused
from scipy.optimize import brentq

import granjax as gx
from granjax import travelling
from granjax.travelling import cell_wave, tail_free
from granjax.travelling.cells import wave

pytestmark = pytest.mark.slow
near = partial(assert_allclose, rtol=0)

TODA = gx.Toda(1.0, 1.0)
LOADED = gx.Hertz(1.0, 1.0)
# zeros of the decay rate of a struck chain's pulse, contacts 200 -> 600: good to 3e-6
ANTI_RESONANCES = (0.342846, 0.154751, 0.090128)


class Stiffening(gx.Law):
    """F(e) = k (e + e^3 + [e]_+ e), a law of one's own, whose second derivative jumps."""

    stiffness: jax.Array

    def force(self, e):
        return self.stiffness * (e + e**3 + jnp.maximum(e, 0) * e)

    def energy(self, e):
        return self.stiffness * (e**2 / 2 + e**4 / 4 + jnp.maximum(e, 0) ** 3 / 3)


def dimer(ratio):
    return gx.Hertz(), [1.0, ratio]


def toda_dimer(ratio):
    return TODA, [1.0, ratio]


def chain(law, masses, sites=140):
    return gx.Lattice(np.resize(masses, sites), gx.Bond(gx.Shift(1, "free"), law))


def moved(wave, lattice, distance=30.0, reach=20):
    """Largest change of the velocities about a wave's peak that a run over a distance [sites] makes, over the peak."""
    start = 40.0
    sites = len(jax.tree.leaves(lattice.mass)[0])
    run = gx.simulate(lattice, wave.state(sites, start), distance / wave.speed, tolerance=1e-12)
    there = slice(int(start + distance) - reach, int(start + distance) + reach)
    v, known = (jax.tree.leaves(y.v)[0] for y in (run.final, wave.state(sites, start + distance)))
    return np.abs(v - known)[there].max() / np.abs(known).max()


@pytest.fixture(scope="module")
def nanopteron():
    return cell_wave(*toda_dimer(0.9), speed=1.1)


def test_strains_change_at_the_rate_of_the_velocities(nanopteron):
    xi = np.linspace(-3, 3, 13)
    h = 1e-4
    for j in (0, 1):
        before, after = (nanopteron.strain(xi + x, j) for x in (-h, h))
        rates = nanopteron.velocity(xi, j) - nanopteron.velocity(xi + 1, 1 - j)
        near(nanopteron.speed * (before - after) / (2 * h), rates, atol=1e-8)


@pytest.mark.parametrize("known", ANTI_RESONANCES)
def test_dimers_at_anti_resonances(known):
    wave = tail_free(dimer, 0.96 * known, 1.05 * known, speed=1.0)
    near(wave.parameter, known, atol=1.5e-6)
    assert wave.ripple == 0 and wave.error < 1e-12
    # mirrored by the bead between the contacts, and both beads at rest on both sides
    near(wave.strains[0, 1:], wave.strains[1, :0:-1], atol=1e-12)
    near(wave.velocities[:, [0, -1]], 0, atol=1e-11)
    if known == ANTI_RESONANCES[0]:
        lattice = chain(gx.Hertz(), wave.masses)
        assert moved(wave, lattice) < 1e-10
        energy = gx.measures.energy(lattice, wave.state(140, 60.3))
        assert_allclose(wave.energy, energy, rtol=1e-12)


def test_equal_beads_have_the_solitary_wave():
    wave = cell_wave(gx.Hertz(), [1.0, 1.0], speed=1.0)
    assert wave.masses.shape == (1,)
    near(wave.energy, 2.82348668842275840, atol=1e-12)
    strains = [1.48735937434940207, 0.583929165288747316, 0.0290981220754717273]
    near(wave.strain([0.0, 1.0, 2.0]), strains, atol=1e-13)
    k = 1.6
    xi = np.linspace(-9, 9, 61)
    wave = cell_wave(*toda_dimer(1.0), speed=np.sinh(k) / k)
    near(wave.strain(xi), np.log1p(np.sinh(k) ** 2 / np.cosh(k * xi) ** 2), atol=1e-11)
    assert_allclose(wave.energy, np.sinh(2 * k) - 2 * k, rtol=1e-11)
    assert wave.ripple == 0


def optical(masses, speed, stiffness=1.0):
    """k of the wave with omega(k) = c k in the optical band of a dimer, from its closed form."""
    total = sum(masses)
    product = np.prod(masses)

    def excess(k):
        root = np.sqrt(total**2 - 4 * product * np.sin(k) ** 2)
        return np.sqrt(stiffness * (total + root) / product) - speed * k

    return brentq(excess, 1e-3, 20.0, xtol=1e-14)


def test_nanoptera_ride_on_the_optical_wave_of_their_speed(nanopteron):
    near(nanopteron.linear_wavenumber, optical([1.0, 0.9], 1.1), atol=1e-10)
    masses = [1.0, 0.8]
    speed = 1.03 * np.sqrt(2 / 0.9)
    wave = cell_wave(Stiffening(jnp.asarray(2.0)), masses, speed=speed)
    near(wave.linear_wavenumber, optical(masses, speed, 2.0), atol=1e-10)
    near(wave.wavenumber, wave.linear_wavenumber, atol=5e-4)
    assert 1e-6 < wave.ripple / wave.amplitude < 0.02 and wave.error / wave.amplitude < 1e-8
    assert np.isnan(wave.energy)


def test_the_ripple_of_a_nanopteron_grows_with_contrast_and_has_harmonics(nanopteron):
    weak = cell_wave(*toda_dimer(0.98), speed=1.1 * np.sqrt(0.95 / 0.99))
    # to first order in what differs
    assert_allclose(nanopteron.ripple / weak.ripple, 5, rtol=0.2)
    far = np.abs(nanopteron.xi) > nanopteron._core
    assert_allclose(np.abs(nanopteron.strains[:, far]).max(), nanopteron.ripple, rtol=0.02)


def test_a_wave_without_its_ripple_sheds_twice_the_ripple_and_loses_the_power_that_is_told(
    nanopteron,
):
    wave = nanopteron
    sites = 600
    start = wave.state(sites, 60.0)
    sharp = 0.5 * (1 - np.tanh((np.abs(np.arange(sites) - 60.0) - 14.0) / 3))
    u = np.append(np.cumsum((-np.diff(start.u) * sharp[:-1])[::-1])[::-1], 0.0)
    alone = gx.State(u, start.v * sharp)
    lattice = chain(TODA, wave.masses, sites)
    end = 400 / wave.speed
    run = gx.simulate(lattice, alone, end, tolerance=1e-10, save_at=9)
    behind = np.abs(np.diff(run.us[4])[215:245]).max()
    assert_allclose(behind, 2 * wave.ripple, rtol=0.1)
    energies = []
    mass = np.resize(wave.masses, sites)
    for u, v in zip(run.us[3:], run.vs[3:]):
        strain = -np.diff(u)
        near = slice(np.argmax(strain) - 30, np.argmax(strain) + 30)
        own = np.exp(strain) - 1 - strain
        energies.append(own[near].sum() + (mass * v**2)[near].sum() / 2)
    times = np.asarray(run.ts[3:])
    rates = -np.diff(energies) / np.diff(times)
    # the wave slows down as it loses: the rate at the launch
    rate = np.polynomial.Polynomial.fit((times[1:] + times[:-1]) / 2, rates, 1)(0.0)
    assert_allclose(rate, wave.radiation, rtol=0.05)


def test_a_chain_knows_its_cell_and_its_units(nanopteron):
    """Beads of 3 g, contacts of 2 N/m per strain of 1 mm, walls of other contacts."""
    strength = np.array([0.7, *np.full(7, 2e-3), 0.3])
    bond = gx.Bond(gx.Shift(1, "fixed"), gx.Toda(strength, 1e3))
    lattice = gx.Lattice(np.resize([3e-3, 2.7e-3], 8), bond, units="SI")
    wave = cell_wave(lattice, speed=1.1 * np.sqrt(2 / 3e-3))
    assert wave.units == "SI" and len(wave.masses) == 2
    assert_allclose(wave.strains, 1e-3 * nanopteron.strains, atol=1e-12 * nanopteron.amplitude)
    scale = 2 * 1e-6 * np.sqrt(2 / 3e-3)
    assert_allclose(wave.radiation / scale, nanopteron.radiation, rtol=1e-6)


def test_two_pulses_are_not_one_wave_without_a_tail(monkeypatch):
    alone = tail_free(dimer, 0.33, 0.35, speed=1.0)

    def two(chain):
        # Pulses without a tail do not know of each other; neighbours do not drift between them.
        box = wave.Box(chain, 20.0, 320)
        x = box.x + np.array([-20.0, 0.0, 20.0])[:, None]
        phi = np.stack([alone.strain(x, j).sum(0) for j in (0, 1)])
        row = lambda box: np.roll(wave.drift_row(box).reshape(2, -1), 80, axis=1).ravel()
        return box, phi, 1.0, row, alone._core

    monkeypatch.setattr(wave, "_simulated", two)
    with pytest.raises(RuntimeError, match="a train of pulses"):
        tail_free(dimer, 0.33, 0.35, speed=1.0)


@pytest.mark.parametrize(
    "law, speed, ratio, most",
    [
        (LOADED, 1.1 * np.sqrt(1.5 / 0.65), 0.3435665808, 1e-9),
        (gx.PowerLaw(1.0, 2.0), 1.0, 0.33085624619, 1e-6),
    ],
)
def test_other_laws_have_anti_resonances_too(law, speed, ratio, most):
    wave = tail_free(lambda r: (law, [1.0, r]), 0.3, 0.36, speed=speed)
    near(wave.parameter, ratio, atol=1e-9)
    assert wave.ripple == 0 and wave.error < 1e-7
    assert moved(wave, chain(law, wave.masses), 20.0, reach=12) < most


def test_tail_free_waves_over_the_speed_and_the_ripple_beside_them():
    start = 1.1 / np.sqrt(0.65)
    speeds = start * np.array([1.0, 1.05, 1.1])
    curve = travelling.tail_free_curve(toda_dimer, 0.28, 0.36, speeds)
    assert not curve.lost and np.all(np.diff(curve.parameter) > 0)
    near(curve.parameter[0], 0.3092496782, atol=1e-9)
    again = tail_free(toda_dimer, 0.25, 0.36, speed=speeds[-1])
    near(curve.parameter[-1], again.parameter, atol=1e-11)
    ratios = curve.parameter[1] * np.array([0.97, 1.0, 1.03])
    found = travelling.nanoptera(toda_dimer, ratios, speeds[1:2])
    share = found.ripple[:, 0] / found.amplitude[:, 0]
    assert not found.lost and share[1] < 1e-9 and np.all(share[[0, 2]] > 1e-4)
    # the amplitude passes zero, and the power is its square
    assert found.radiation[1, 0] < 1e-15 < 1e-9 < found.radiation[[0, 2], 0].min()
    slow = travelling.nanoptera(toda_dimer, [0.9], [0.5])
    assert np.isnan(slow.ripple).all() and "supersonic" in slow.lost[0]


def test_a_wave_that_is_lost_at_its_own_speed_is_found_from_a_slower_one():
    wave = cell_wave(*toda_dimer(0.1), speed=1.25 / np.sqrt(0.55))
    assert 1e-3 < wave.ripple / wave.amplitude < 4e-3


def test_stiffnesses_that_alternate_have_a_mirror_at_a_contact():
    speed = 1.03 * np.sqrt(1 / np.mean([1.0, 1 / 1.5]))
    wave = cell_wave(gx.Polynomial([1.0, 1.5], 0.25, 0.0), [1.0, 1.0], speed=speed)
    near(wave.strains[:, 1:], wave.strains[:, :0:-1], atol=1e-11)
    assert 0 < wave.ripple < 0.02
    cell = lambda r: (gx.Hertz(jnp.array([1.0, r])), [1.0, 1.0])
    found = tail_free(cell, 0.1, 0.4, speed=1.0)
    lattice = chain(gx.Hertz(np.resize([1.0, found.parameter], 139)), [1.0])
    assert found.ripple == 0 and moved(found, lattice) < 1e-9


def test_cells_without_a_mirror_and_with_two_ripples():
    wave = cell_wave(gx.Polynomial([1.0, 1.2], 0.25, 0.0), [1.0, 0.8], speed=1.16)
    assert 1e-4 < wave.ripple / wave.amplitude < 0.1
    trimer = cell_wave(TODA, [1.0, 0.9, 0.9], speed=1.12)
    assert np.isnan(trimer.ripple) and "2 linear waves" in trimer.outcome
    assert moved(trimer, chain(TODA, trimer.masses), 9.0, reach=12) < 1e-11


def test_beyond_its_box_the_ripple_is_its_own():
    masses = [1.0, 0.7]
    start = 150.0
    speed = 1.15 * np.sqrt(1.5 / 0.85)
    wave = cell_wave(LOADED, masses, speed=speed)
    lattice = chain(LOADED, masses, 360)
    assert moved(wave, lattice, 10.0) < 1e-9
    # two sites on, where the box's end is
    run = gx.simulate(lattice, wave.state(360, start), 2 / speed, tolerance=1e-13)
    off = np.abs(np.diff(run.final.u) - np.diff(wave.state(360, start + 2).u))
    near = np.abs(np.arange(359) - start) < 100
    assert max(off[near].max(), wave.error) < 1e-10 * wave.amplitude


def test_the_error_covers_what_a_loud_ripple_beyond_the_box_misses():
    masses = [1.0, 0.7]
    speed = 1.6
    law = gx.Hertz(precompression=0.5)
    wave = cell_wave(law, masses, speed=speed)
    start, known = (wave.state(361, place) for place in (150.0, 152.0))
    run = gx.simulate(chain(law, masses, 361), start, 2 / speed, tolerance=1e-13)
    there = slice(50, 250)
    strains = np.abs(np.diff(run.final.u) - np.diff(known.u))[there].max()
    velocities = np.abs(run.final.v - known.v)[there].max()
    assert max(strains, velocities / speed) < wave.error < 1e-10 * wave.amplitude


@pytest.mark.parametrize(
    "law, stiffness, ratio, over, share",
    [
        (TODA, 1.0, 0.4, 1.5, 0.0687),
        (LOADED, 1.5, 0.3, 1.4, 0.0276),
        # a search at these speeds comes to a train of pulses
        (LOADED, 1.5, 0.5, 1.3, 0.1092),
        (LOADED, 1.5, 0.4, 1.5, 0.0489),
    ],
)
def test_the_smallest_ripple_is_continuous_in_the_speed(law, stiffness, ratio, over, share):
    """The shares were followed from 1.1 times the speed of sound by steps of 0.02 of it."""
    speed = over * np.sqrt(stiffness * 2 / (1 + ratio))
    wave = cell_wave(law, [1.0, ratio], speed=speed)
    assert_allclose(wave.ripple / wave.amplitude, share, rtol=0.01)
    assert wave.error < 1e-7 * wave.amplitude


@pytest.mark.parametrize(
    "ratio, over, share",
    [
        (0.7, 2.0, 0.1241),
        # it is lost on the way from a slower wave, but not on that from equal masses
        (0.8, 2.2, 0.0835),
    ],
)
def test_waves_are_found_in_whose_ripples_contacts_open(ratio, over, share):
    masses = [1.0, ratio]
    speed = over * np.sqrt(1.5 * 2 / (1 + ratio))
    wave = cell_wave(LOADED, masses, speed=speed)
    assert_allclose(wave.ripple / wave.amplitude, share, rtol=0.01)
    start, known = (wave.state(361, place) for place in (150.0, 152.0))
    run = gx.simulate(chain(LOADED, masses, 361), start, 2 / speed, tolerance=1e-12)
    off = np.abs(np.diff(run.final.u) - np.diff(known.u))[50:250].max()
    assert wave.strains.min() < -1 and off < wave.error < 2e-4 * wave.amplitude


# ---------------------------------------------------------------------------------------------------------- resonators


def with_resonators(law, resonator, sites=140):
    inner = gx.Bond(gx.Shift(0, "free", ("bead", "resonator")), gx.Linear(resonator.stiffness))
    mass = {"bead": np.ones(sites), "resonator": float(resonator.mass) * np.ones(sites)}
    return gx.Lattice(mass, (gx.Bond(gx.Shift(1, "free", "bead"), law), inner))


def resonating(law, speed, mass, factor=1.0, count=1):
    """The wave of beads whose resonators have the stiffness without a tail, times a factor."""
    kappa = factor * travelling.tail_free_stiffness(speed, mass, 1.0, count)
    return cell_wave(law, [1.0], speed=speed, resonator=gx.Resonator(mass, kappa))


def test_the_resonators_wave_without_tail():
    wave = resonating(gx.Hertz(), 1.0, 0.1)
    near(wave.resonator.stiffness, 3.5889470549, atol=1e-10)
    near(wave.strain([0.0, 1.0]), [1.799176764595, 0.727976214335], atol=1e-12)
    near(wave.strain(np.linspace(5, 11, 50)), 0, atol=1e-14)
    alone = travelling.solitary_wave(gx.Hertz(), speed=1.0, resonator=wave.resonator)
    assert wave.ripple == 0 and alone.amplitude == wave.amplitude
    lattice = with_resonators(gx.Hertz(), wave.resonator)
    assert moved(wave, lattice) < 1e-11
    energy = gx.measures.energy(lattice, wave.state(140, 60.3))
    assert_allclose(wave.energy, energy, rtol=1e-12)
    heavy = resonating(gx.Hertz(), 1.0, 1.0)
    near(heavy.strain([0.0, 1.0]), [5.925655714858, 2.968118897523], atol=2e-12)
    assert heavy.ripple == 0 and heavy.error < 1e-11


def test_other_resonators_leave_a_ripple():
    ripples = []
    for factor in (0.9, 0.99, 1.0):
        wave = resonating(gx.Hertz(), 1.0, 0.1, factor)
        ripples.append(wave.ripple / wave.amplitude)
        near(wave.resonator.tail_free(1.0), 3.5889470549, atol=1e-9)
        near(wave.linear_wavenumber, 2 * np.pi * np.sqrt(factor), atol=1e-12)
    assert ripples[0] > 10 * ripples[1] > 100 * ripples[2] == 0
    # at twice the speed all strains are 16 times as large
    fast = resonating(gx.Hertz(), 2.0, 0.1, 0.9)
    near(fast.linear_wavenumber, 2 * np.pi * np.sqrt(0.9), atol=1e-12)
    assert_allclose(fast.ripple / fast.amplitude, ripples[0], rtol=1e-8)


def test_with_precompression_the_same_stiffness_leaves_no_tail():
    free = resonating(LOADED, 1.5, 0.2, count=2)
    assert free.ripple == 0 and np.abs(free.strain(free.xi[:3])).max() < 1e-11
    off = resonating(LOADED, 1.5, 0.2, 0.2, count=2)
    assert 1e-7 < off.ripple / off.amplitude < 0.1
    assert moved(off, with_resonators(LOADED, off.resonator)) < 1e-4


@pytest.mark.parametrize(
    "law, speed, mass", [(gx.Toda(), 3.0, 2.0), (gx.PowerLaw(1.0, 3.0), 2.0, 4.0)]
)
def test_heavy_resonators_under_the_real_kernel(law, speed, mass):
    """phi = Lambda * F(phi) with the kernel of `tail_free_stiffness` in real space, by Gauss' rule."""
    wave = resonating(law, speed, mass)
    z, w = np.polynomial.legendre.leggauss(120)
    z = (1 + z) / 2
    w = w / 2
    kernel = (1 - z - mass * np.sin(2 * np.pi * z) / (2 * np.pi)) / ((1 + mass) * speed**2)
    for x in (0.0, 0.4, 1.3):
        force = np.asarray(sum(law.force(wave.strain(x + side * z)) for side in (1, -1)))
        near((kernel * force) @ w, wave.strain(x), atol=1e-7 * wave.amplitude)


@pytest.mark.parametrize("mass, factor", [(0.1, 0.9), (0.7, 1.02)])
def test_a_ripple_close_to_the_swing_of_bead_and_resonator_is_seen(mass, factor):
    speed = 1.5
    wave = resonating(gx.Toda(), speed, mass, factor)
    kappa = float(wave.resonator.stiffness)

    def left(k):
        rest = kappa - mass * (k * speed) ** 2
        return 4 * np.sin(k / 2) ** 2 * rest - (k * speed) ** 2 * (rest + mass * kappa)

    swing = np.sqrt(kappa * (1 + 1 / mass)) / speed
    known = brentq(left, 0.98 * swing, 1.02 * swing, xtol=1e-14)
    near(wave.linear_wavenumber, known, atol=1e-9)
    assert 1e-7 < wave.ripple / wave.amplitude < 1e-2


# ------------------------------------------------------------------------------------------------------------ refusals


def alone(mass=0.1, kappa=3.0, **given):
    return travelling.solitary_wave(gx.Hertz(), resonator=gx.Resonator(mass, kappa), **given)


def curve(speeds):
    return travelling.tail_free_curve(dimer, 0.33, 0.35, speeds)


@pytest.mark.parametrize(
    "call, said",
    [
        (lambda: cell_wave(*dimer(0.35), speed=1.0), "masses: .* the nearest is 0.34284578"),
        # Newton's method comes to equal masses there, whose cell is of another size
        (lambda: cell_wave(*dimer(0.999), speed=1.0), "travels without loss"),
        (lambda: cell_wave(*toda_dimer(0.5), speed=1.0), "speed: expected supersonic"),
        (lambda: cell_wave(gx.Hertz([1.0, 2.0, 3.0]), [1, 0.5], speed=2.0), "law: expected param"),
        (lambda: cell_wave(gx.Hertz(), [1.0, 0.5, 0.5], speed=1.0), "masses: expected one or two"),
        (lambda: cell_wave(gx.Hertz(1.0, [0.0, 1.0]), [1, 1], speed=2.0), "law: expected a stiff"),
        (lambda: cell_wave(gx.scenes.taper(8, 0.9), speed=2.0), "that repeats"),
        (lambda: cell_wave(gx.scenes.fput(8), [1.0], speed=2.0), "None beside a lattice"),
        (lambda: travelling.tail_free_curve(toda_dimer, 0.3, 0.4, [1.0]), "expected supersonic"),
        (lambda: curve([]), "speeds: expected a row of numbers, each other than the one before"),
        (lambda: curve([1.0, 1.0, 2.0]), "each other than the one before, got .1. 1. 2"),
        (lambda: tail_free(dimer, 0.4, 0.3, speed=1.0), "high: expected a number above low"),
        (lambda: tail_free(lambda r: (TODA, [r, r]), 0.3, 0.4, speed=4.0), "several sites"),
        (lambda: alone(speed=1.0), "resonator: expected a stiffness of 3.588947054"),
        (lambda: alone(0.3, 0.5, speed=1.0), "a stiffness of 9.11040.* got 0.5. No wave of speed"),
        (lambda: alone(energy=1.0), "energy: expected a speed"),
        (lambda: travelling.tail_free_stiffness(1.0, 0.1, count=0), "count: expected a whole"),
    ],
)
def test_bad_input_is_refused(call, said):
    with refused(said):
        call()


@pytest.mark.parametrize(
    "call, said",
    [
        (lambda: cell_wave(gx.Hertz(1.0, 1e-8), [1.0, 0.5], speed=1.0), "almost without a stiff"),
        (lambda: cell_wave(gx.Linear(1.0), [1.0, 0.5], speed=2.0), "No wave of speed"),
        (lambda: tail_free(dimer, 0.5, 0.55, speed=1.0), "No wave of speed 1 was found"),
    ],
)
def test_where_nothing_is_found(call, said):
    with pytest.raises(RuntimeError, match=said):
        call()
