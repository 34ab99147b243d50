"""Waves of dimers and of beads with resonators, against published values, closed forms and simulations."""

import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose
from refusals import refused
from scipy.optimize import brentq

import granjax as gx
from granjax import travelling
from granjax.travelling.cells import wave as solving
from granjax.travelling.cells.cell import chain_of

TODA = gx.Toda(1.0, 1.0)
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


def moved(wave, lattice, distance=30.0, sites=140, reach=20):
    """Largest change of the velocities about a wave's peak that a run over a distance [sites] makes, over the peak."""
    start, sites = 40.0, sites
    run = gx.simulate(lattice, wave.state(sites, start), distance / wave.speed, tolerance=1e-12)
    there = slice(int(start + distance) - reach, int(start + distance) + reach)
    v, known = (jax.tree.leaves(y.v)[0] for y in (run.final, wave.state(sites, start + distance)))
    return np.abs(v - known)[there].max() / np.abs(known).max()


def chain(law, masses, sites=140):
    return gx.Lattice(np.resize(masses, sites), gx.Bond(gx.Shift(1, "free"), law))


@pytest.mark.slow
@pytest.mark.parametrize(
    "known",
    [ANTI_RESONANCES[0], *(pytest.param(x, marks=pytest.mark.slow) for x in ANTI_RESONANCES[1:])],
)
def test_dimers_at_anti_resonances(known):
    wave = travelling.tail_free(dimer, 0.96 * known, 1.05 * known, speed=1.0)
    assert wave.parameter == pytest.approx(known, abs=1.5e-6)
    assert wave.ripple == 0 and wave.error < 1e-12
    # mirrored by the bead between the contacts, and both beads at rest on both sides
    assert np.allclose(wave.strains[0, 1:], wave.strains[1, :0:-1], atol=1e-12)
    assert np.abs(wave.velocities[:, [0, -1]]).max() < 1e-11
    if known == ANTI_RESONANCES[0]:
        lattice = chain(gx.Hertz(), wave.masses)
        assert moved(wave, lattice) < 1e-10
        assert wave.energy == pytest.approx(
            float(gx.measures.energy(lattice, wave.state(140, 60.3))), rel=1e-12
        )


@pytest.mark.study
def test_a_chain_knows_its_cell_and_its_units():
    chain = gx.scenes.beads(["steel 316", "aluminium 6061-T6"], 9.525e-3, 20.0, cells=8)
    wave = travelling.cell_wave(chain, speed=1.05 * float(gx.linear.sound_speed(chain)))
    law, mass = chain.terms[0].law, np.asarray(chain.mass)
    stiffness = float(
        np.ravel(law.stiffness)[1]
    )  # of the contacts between beads, as those with walls are others
    scaled = travelling.cell_wave(gx.Hertz(stiffness, 20.0), mass[:2], speed=wave.speed)
    assert wave.units == "SI" and len(wave.masses) == 2
    assert_allclose(wave.strains, scaled.strains, rtol=0, atol=1e-9 * wave.amplitude)
    for bad, said in (
        (gx.scenes.taper(8, 0.9), "that repeats"),
        (gx.scenes.fput(8), "None beside a lattice"),
    ):
        with refused(said):
            travelling.cell_wave(bad, None if "repeats" in said else [1.0], speed=2.0)


def test_equal_beads_have_the_solitary_wave():
    wave = travelling.cell_wave(gx.Hertz(), [1.0, 1.0], speed=1.0)
    assert wave.masses.shape == (1,) and wave.energy == pytest.approx(
        2.82348668842275840, abs=1e-12
    )
    assert_allclose(
        wave.strain([0.0, 1.0, 2.0]),
        [1.48735937434940207, 0.583929165288747316, 0.0290981220754717273],
        atol=1e-13,
    )


@pytest.mark.parametrize("k", [0.8, 1.6])
def test_the_toda_dimer_of_ratio_one_is_the_soliton_without_ripple(k):
    wave = travelling.cell_wave(TODA, [1.0, 1.0], speed=np.sinh(k) / k)
    xi = np.linspace(-9, 9, 61)
    assert_allclose(wave.strain(xi), np.log1p(np.sinh(k) ** 2 / np.cosh(k * xi) ** 2), atol=1e-11)
    assert wave.ripple == 0 and wave.energy == pytest.approx(np.sinh(2 * k) - 2 * k, rel=1e-11)


def optical(masses, speed, stiffness=1.0):
    """k of the wave with omega(k) = c k in the optical band of a dimer, from its closed form."""
    total, product = sum(masses), np.prod(masses)

    def excess(k):
        root = np.sqrt(total**2 - 4 * product * np.sin(k) ** 2)
        return np.sqrt(stiffness * (total + root) / product) - speed * k

    return brentq(excess, 1e-3, 20.0, xtol=1e-14)


@pytest.mark.study
@pytest.mark.parametrize(
    "law, masses, over",
    [
        (TODA, [1.0, 0.5], 1.02),
        pytest.param(gx.Polynomial(1.0, 0.25, 0.0), [1.0, 0.5], 1.02, marks=pytest.mark.study),
        pytest.param(gx.Hertz(1.0, 1.0), [1.0, 0.5], 1.02, marks=pytest.mark.study),
        (Stiffening(jnp.asarray(2.0)), [1.0, 0.8], 1.03),
    ],
    ids=["toda", "fput", "hertz", "own"],
)
def test_nanoptera_ride_on_the_optical_wave_of_their_speed(law, masses, over):
    K2 = float(gx.laws.taylor(law).K2)
    speed = over * np.sqrt(K2 / np.mean(masses))
    wave = travelling.cell_wave(law, masses, speed=speed)
    assert wave.linear_wavenumber == pytest.approx(optical(masses, speed, K2), abs=1e-10)
    assert wave.wavenumber == pytest.approx(
        wave.linear_wavenumber, abs=1e-6 if over < 1.03 else 5e-4
    )
    assert 1e-6 < wave.ripple / wave.amplitude < 0.02 and wave.error / wave.amplitude < (
        1e-11 if over < 1.03 else 1e-8
    )
    assert "ripple" in wave.outcome and np.isnan(wave.energy)


@pytest.mark.study
def test_a_nanopteron_runs_on_unchanged_and_its_ripple_grows_with_contrast():
    ripples = []
    for ratio in (0.98, 0.9):
        wave = travelling.cell_wave(TODA, [1.0, ratio], speed=1.1 / np.sqrt((1 + ratio) / 2))
        ripples.append(wave.ripple)
    # to first order in what differs
    assert ripples[1] / ripples[0] == pytest.approx(5, rel=0.2)
    # beyond its box the ripple is the linear one
    assert moved(wave, chain(TODA, wave.masses)) < (wave.ripple / wave.amplitude) ** 2
    # it has harmonics as well
    far = np.abs(wave.xi) > wave._core
    assert np.abs(wave.strains[:, far]).max() == pytest.approx(wave.ripple, rel=0.02)


@pytest.mark.study
def test_no_box_has_a_smaller_ripple():
    law = gx.Hertz(1.0, 1.0)
    lattice = chain_of(law, [1.0, 0.75], 1.1 * np.sqrt(3 / 1.75))
    found = solving.on_a_box(lattice)
    smallest, period = abs(found.tail.amplitude), np.pi / found.ripple.wavenumber
    for part in (-0.3, -0.1, 0.1, 0.3, 1.0, 2.0):
        half = found.box.half + part * period
        box, other = solving._again(
            lattice, found.box, found.solved.phi, half, solving._density(found.box)
        )
        size = abs(solving.fit(box, other.phi, found.ripple, found.core).amplitude)
        assert size > 0.99 * smallest
        # lengths a period apart are alike
        assert part < 1 or size < 1.02 * smallest


@pytest.mark.slow
def test_a_ripple_that_is_cut_off_ahead_grows_twice_as_high_behind():
    wave = travelling.cell_wave(TODA, [1.0, 0.9], speed=1.1)
    start, sites = wave.state(400, 60.0), 400
    sharp = 0.5 * (1 - np.tanh((np.abs(np.arange(sites) - 60.0) - 14.0) / 3))
    strain = -np.diff(start.u) * sharp[:-1]
    u = np.append(np.cumsum(strain[::-1])[::-1], 0.0)
    run = gx.simulate(
        chain(TODA, wave.masses, sites),
        gx.State(u, start.v * sharp),
        200 / wave.speed,
        tolerance=1e-10,
    )
    behind = -np.diff(run.final.u)[215:245]
    assert np.abs(behind).max() == pytest.approx(2 * wave.ripple, rel=0.1)


@pytest.mark.study
@pytest.mark.parametrize(
    "law, ratio, over",
    [
        # each of these is confirmed below by the wave's own ripple there, which is zero
        (TODA, 0.3092496782, 1.1),
        pytest.param(gx.Hertz(1.0, 1.0), 0.3435665808, 1.1, marks=pytest.mark.study),
        pytest.param(gx.Polynomial(1.0, 0.25, 0.0), 0.3269192425, 1.1, marks=pytest.mark.study),
    ],
    ids=["toda", "hertz", "fput"],
)
def test_anti_resonances_of_chains_with_a_stiffness_at_rest(law, ratio, over):
    speed = over * np.sqrt(float(gx.laws.taylor(law).K2) / 0.65)
    alone = travelling.tail_free(lambda r: (law, [1.0, r]), 0.28, 0.36, speed=speed)
    assert alone.parameter == pytest.approx(ratio, abs=1e-9) and alone.ripple == 0
    there = travelling.cell_wave(law, [1.0, alone.parameter], speed=speed)
    assert there.ripple < 1e-9 * there.amplitude
    beside = travelling.cell_wave(law, [1.0, 0.95 * ratio], speed=speed)
    assert beside.ripple > 1e-4 * beside.amplitude
    assert moved(alone, chain(law, alone.masses), 20.0, reach=12) < 1e-9


@pytest.mark.slow
def test_a_wave_that_is_lost_at_its_own_speed_is_found_from_a_slower_one():
    wave = travelling.cell_wave(TODA, [1.0, 0.1], speed=1.25 / np.sqrt(0.55))
    assert 1e-3 < wave.ripple / wave.amplitude < 4e-3


@pytest.mark.study
def test_alternating_stiffness():
    law = gx.Polynomial([1.0, 1.5], 0.25, 0.0)
    speed = 1.03 * np.sqrt(1 / np.mean([1.0, 1 / 1.5]))
    wave = travelling.cell_wave(law, [1.0, 1.0], speed=speed)
    # mirrored by a contact
    assert (
        np.allclose(wave.strains[:, 1:], wave.strains[:, :0:-1], atol=1e-11)
        and 0 < wave.ripple < 0.02
    )
    found = travelling.tail_free(
        lambda r: (gx.Hertz(jnp.stack([jnp.asarray(1.0), jnp.asarray(r)])), [1.0, 1.0]),
        0.1,
        0.4,
        speed=1.0,
    )
    lattice = chain(gx.Hertz(np.resize([1.0, found.parameter], 139)), [1.0])
    assert found.ripple == 0 and moved(found, lattice) < 1e-9


@pytest.mark.slow
def test_masses_and_stiffnesses_that_both_alternate():
    wave = travelling.cell_wave(gx.Polynomial([1.0, 1.2], 0.25, 0.0), [1.0, 0.8], speed=1.16)
    assert 1e-4 < wave.ripple / wave.amplitude < 0.1


@pytest.mark.slow
def test_a_trimer_keeps_pace_with_two_waves_and_says_so():
    wave = travelling.cell_wave(TODA, [1.0, 0.9, 0.9], speed=1.12)
    assert np.isnan(wave.ripple) and "2 linear waves" in wave.outcome


@pytest.mark.slow
def test_tail_free_waves_over_the_speed_and_the_ripple_beside_them():
    cell, start = lambda ratio: (TODA, [1.0, ratio]), 1.1 / np.sqrt(0.65)
    curve = travelling.tail_free_curve(cell, 0.28, 0.36, start * np.array([1.0, 1.02, 1.05, 1.1]))
    assert not curve.lost and np.all(np.diff(curve.parameter) > 0)
    assert curve.parameter[0] == pytest.approx(0.3092496782, abs=1e-9)
    again = travelling.tail_free(cell, 0.25, 0.36, speed=curve.speed[-1])
    assert curve.parameter[-1] == pytest.approx(again.parameter, abs=1e-11)
    ratio, c = float(curve.parameter[2]), float(curve.speed[2])
    found = travelling.nanoptera(cell, ratio * np.array([0.97, 1.0, 1.03]), [c])
    assert not found.lost and found.ripple[1, 0] < 1e-9 * found.amplitude[1, 0]
    assert np.all(found.ripple[[0, 2], 0] > 1e-4 * found.amplitude[[0, 2], 0])
    # the amplitude passes zero, and the power is its square
    assert found.radiation[1, 0] < 1e-15 < 1e-9 < found.radiation[[0, 2], 0].min()
    slow = travelling.nanoptera(cell, [0.9], [0.5])
    assert np.isnan(slow.ripple).all() and "supersonic" in slow.lost[0]
    with refused("supersonic"):
        travelling.tail_free_curve(cell, 0.28, 0.36, [0.5])


@pytest.mark.slow
def test_a_wave_without_its_ripple_loses_the_power_that_is_told():
    wave = travelling.cell_wave(TODA, [1.0, 0.9], speed=1.1)
    start, sites = wave.state(600, 60.0), 600
    sharp = 0.5 * (1 - np.tanh((np.abs(np.arange(sites) - 60.0) - 14.0) / 3))
    u = np.append(np.cumsum((-np.diff(start.u) * sharp[:-1])[::-1])[::-1], 0.0)
    run = gx.simulate(
        chain(TODA, wave.masses, sites),
        gx.State(u, start.v * sharp),
        400 / wave.speed,
        tolerance=1e-10,
        save_at=9,
    )
    energies, mass = [], np.resize(wave.masses, sites)
    for u, v in zip(run.us[3:], run.vs[3:]):
        strain = -np.diff(u)
        near = slice(np.argmax(strain) - 30, np.argmax(strain) + 30)
        own = np.exp(strain) - 1 - strain
        energies.append(own[near].sum() + (mass * v**2)[near].sum() / 2)
    times = np.asarray(run.ts[3:])
    rates = -np.diff(energies) / np.diff(times)
    # the wave slows down as it loses: the rate at the launch
    rate = np.polynomial.Polynomial.fit((times[1:] + times[:-1]) / 2, rates, 1)(0.0)
    assert rate == pytest.approx(wave.radiation, rel=0.05)
    # in SI: beads of 3 g, contacts of 2 N/m per strain of 1 mm
    law = gx.Toda(2e-3, 1e3)
    si = travelling.cell_wave(law, [3e-3, 0.9 * 3e-3], speed=1.1 * np.sqrt(2 / 3e-3))
    scale = 2 * 1e-6 * np.sqrt(2 / 3e-3)
    assert si.radiation / scale == pytest.approx(wave.radiation, rel=1e-6)


# ---------------------------------------------------------------------------------------------------------- resonators


def with_resonators(law, resonator, sites=140):
    inner = gx.Bond(gx.Shift(0, "free", ("bead", "resonator")), gx.Linear(resonator.stiffness))
    mass = {"bead": np.ones(sites), "resonator": float(resonator.mass) * np.ones(sites)}
    return gx.Lattice(mass, (gx.Bond(gx.Shift(1, "free", "bead"), law), inner))


@pytest.mark.slow
def test_the_resonators_wave_without_tail():
    kappa = float(travelling.tail_free_stiffness(1.0, 0.1))
    assert kappa == pytest.approx(3.5889470549, abs=1e-10)
    wave = travelling.cell_wave(gx.Hertz(), [1.0], speed=1.0, resonator=gx.Resonator(0.1, kappa))
    assert_allclose(wave.strain([0.0, 1.0]), [1.799176764595, 0.727976214335], atol=1e-9)
    assert_allclose(wave.strain([0.0, 1.0]), [1.799176764595, 0.727976214335], atol=1e-12)
    assert np.abs(wave.strain(np.linspace(5, 11, 50))).max() < 1e-14 and wave.ripple == 0
    alone = travelling.solitary_wave(gx.Hertz(), speed=1.0, resonator=wave.resonator)
    assert (
        alone.amplitude == wave.amplitude
        and alone.outcome == "A wave that travels without loss: no ripple."
    )
    lattice = with_resonators(gx.Hertz(), wave.resonator)
    assert moved(wave, lattice) < 1e-11
    assert wave.energy == pytest.approx(
        float(gx.measures.energy(lattice, wave.state(140, 60.3))), rel=1e-12
    )


@pytest.mark.study
def test_other_resonators_leave_a_ripple():
    ripples = []
    for factor in (0.9, 0.99, 1.0, 1.01):
        resonator = gx.Resonator(0.1, factor * travelling.tail_free_stiffness(1.0, 0.1))
        wave = travelling.cell_wave(gx.Hertz(), [1.0], speed=1.0, resonator=resonator)
        ripples.append(wave.ripple / wave.amplitude)
        assert float(resonator.tail_free(1.0)) == pytest.approx(3.5889470549, abs=1e-9)
        assert wave.linear_wavenumber == pytest.approx(2 * np.pi * np.sqrt(factor), abs=1e-12)
    assert ripples[0] > 10 * ripples[1] > 100 * ripples[2] == 0 and ripples[3] > 1e-9


@pytest.mark.study
def test_with_precompression_the_same_stiffness_leaves_no_tail():
    law, speed = gx.Hertz(1.0, 1.0), 1.5
    kappa = float(travelling.tail_free_stiffness(speed, 0.2, 1.0, 2))
    free = travelling.cell_wave(law, [1.0], speed=speed, resonator=gx.Resonator(0.2, kappa))
    assert free.ripple == 0 and np.abs(free.strain(free.xi[:3])).max() < 1e-11
    off = travelling.cell_wave(law, [1.0], speed=speed, resonator=gx.Resonator(0.2, kappa / 5))
    assert 1e-7 < off.ripple / off.amplitude < 0.1
    assert moved(off, with_resonators(law, off.resonator)) < 1e-4


@pytest.mark.slow
@pytest.mark.parametrize(
    "mass, values",
    [(0.7, (4.287040968548, 2.020209812845)), (1.0, (5.925655714858, 2.968118897523))],
)
def test_resonators_as_heavy_as_the_beads(mass, values):
    resonator = gx.Resonator(mass, travelling.tail_free_stiffness(1.0, mass))
    wave = travelling.solitary_wave(gx.Hertz(), speed=1.0, resonator=resonator)
    assert_allclose(wave.strain([0.0, 1.0]), values, atol=2e-12)
    assert wave.ripple == 0 and wave.error < 1e-11


@pytest.mark.slow
@pytest.mark.parametrize(
    "law, speed, mass",
    [
        (gx.Toda(), 1.5, 2.0),
        (gx.Toda(), 3.0, 2.0),
        (gx.Hertz(1.0, 1.0), 2.2, 4.0),
        (gx.PowerLaw(1.0, 3.0), 2.0, 4.0),
    ],
)
def test_heavy_resonators_under_the_real_kernel(law, speed, mass):
    """phi = Lambda * F(phi) with the kernel of `tail_free_stiffness` in real space, by Gauss' rule."""
    resonator = gx.Resonator(mass, travelling.tail_free_stiffness(speed, mass))
    wave = travelling.solitary_wave(law, speed=speed, resonator=resonator)
    z, w = np.polynomial.legendre.leggauss(120)
    z, w = (1 + z) / 2, w / 2
    kernel = (1 - z - mass * np.sin(2 * np.pi * z) / (2 * np.pi)) / ((1 + mass) * speed**2)
    for x in (0.0, 0.4, 1.3):
        force = sum(np.asarray(law.force(wave.strain(x + side * z))) for side in (1, -1))
        assert (kernel * force) @ w == pytest.approx(
            float(wave.strain(x)), abs=1e-7 * wave.amplitude
        )


@pytest.mark.slow
@pytest.mark.parametrize("mass, factor", [(0.1, 0.9), (0.7, 1.02)])
def test_a_ripple_close_to_the_swing_of_bead_and_resonator_is_seen(mass, factor):
    speed, kappa = 1.5, factor * float(travelling.tail_free_stiffness(1.5, mass))
    wave = travelling.cell_wave(gx.Toda(), [1.0], speed=speed, resonator=gx.Resonator(mass, kappa))

    def left(k):
        rest = kappa - mass * (k * speed) ** 2
        return 4 * np.sin(k / 2) ** 2 * rest - (k * speed) ** 2 * (rest + mass * kappa)

    swing = np.sqrt(kappa * (1 + 1 / mass)) / speed
    assert wave.linear_wavenumber == pytest.approx(
        brentq(left, 0.98 * swing, 1.02 * swing, xtol=1e-14), abs=1e-9
    )
    assert 1e-7 < wave.ripple / wave.amplitude < 1e-2


@pytest.mark.slow
@pytest.mark.parametrize(
    "law, masses, speed",
    [
        (TODA, [1.0, 0.5], 1.2 / np.sqrt(0.75)),
        (gx.Hertz(1.0, 1.0), [1.0, 0.7], 1.15 * np.sqrt(1.5 / 0.85)),
    ],
)
def test_beyond_its_box_the_ripple_is_its_own(law, masses, speed):
    wave = travelling.cell_wave(law, masses, speed=speed)
    assert moved(wave, chain(law, wave.masses, 360), 10.0, 360, reach=20) < 1e-9
    # two sites on, where the box's end is
    start = 150.0
    run = gx.simulate(
        chain(law, wave.masses, 360), wave.state(360, start), 2 / speed, tolerance=1e-13
    )
    strain, known = -np.diff(run.final.u), -np.diff(wave.state(360, start + 2).u)
    near = np.abs(np.arange(359) - start) < 100
    assert (
        np.abs(strain - known)[near].max() < 1e-10 * wave.amplitude
        and wave.error < 1e-10 * wave.amplitude
    )


# ------------------------------------------------------------------------------------------------------------ refusals


@pytest.mark.parametrize(
    "call, said",
    [
        (
            lambda: travelling.cell_wave(gx.Hertz(), [1.0, 0.5], speed=1.0),
            "masses: expected a ratio at which a wave",
        ),
        (
            lambda: travelling.cell_wave(gx.Hertz(), [1.0, 0.35], speed=1.0),
            "the nearest is 0.34284578",
        ),
        (lambda: travelling.cell_wave(TODA, [1.0, 0.5], speed=1.0), "speed: expected supersonic"),
        (
            lambda: travelling.cell_wave(gx.Hertz([1.0, 2.0, 3.0]), [1.0, 0.5], speed=2.0),
            "law: expected parameters",
        ),
        (
            lambda: travelling.cell_wave(gx.Hertz(), [1.0, 0.5, 0.5], speed=1.0),
            "masses: expected one or two sites",
        ),
        (
            lambda: travelling.cell_wave(gx.Hertz([1.0, 2.0], [0.0, 1.0]), [1.0, 1.0], speed=2.0),
            "law: expected a stiff",
        ),
        (
            lambda: travelling.tail_free(
                lambda r: (gx.Hertz(1.0, 0.1), [1.0, r]), 0.3, 0.4, speed=1.0
            ),
            "speed: expected supersonic",
        ),
        (
            lambda: travelling.tail_free(dimer, 0.4, 0.3, speed=1.0),
            "high: expected a number above low",
        ),
        (
            lambda: travelling.tail_free(lambda r: (TODA, [r, r]), 0.3, 0.4, speed=4.0),
            "cell: expected a cell of several",
        ),
        (
            lambda: travelling.solitary_wave(
                gx.Hertz(), speed=1.0, resonator=gx.Resonator(0.1, 3.0)
            ),
            "resonator: expected a stiffness of 3.588947054",
        ),
        (
            lambda: travelling.solitary_wave(
                gx.Hertz(), energy=1.0, resonator=gx.Resonator(0.1, 3.0)
            ),
            "energy: expected a",
        ),
    ],
)
def test_bad_input_is_refused(call, said):
    with refused(re.escape(said)):
        call()


@pytest.mark.slow
@pytest.mark.parametrize(
    "exponent, ratio",
    [(2.0, 0.33085624619), pytest.param(3.0, 0.32662322, marks=pytest.mark.study)],
)
def test_other_powers_have_anti_resonances_too(exponent, ratio):
    wave = travelling.tail_free(
        lambda r: (gx.PowerLaw(1.0, exponent), [1.0, r]), 0.3, 0.36, speed=1.0
    )
    assert wave.parameter == pytest.approx(ratio, abs=1e-8) and wave.error < 1e-7
    lattice = gx.Lattice(
        np.resize(wave.masses, 140), gx.Bond(gx.Shift(1, "free"), gx.PowerLaw(1.0, exponent))
    )
    assert moved(wave, lattice) < 1e-6


@pytest.mark.study
def test_where_nothing_is_found():
    with pytest.raises(RuntimeError, match="almost without a stiffness"):
        travelling.cell_wave(gx.Hertz(1.0, 1e-8), [1.0, 0.5], speed=1.0)
    with pytest.raises(RuntimeError, match="No wave of speed 1 was found"):
        travelling.tail_free(dimer, 0.5, 0.55, speed=1.0)
    with pytest.raises(RuntimeError, match="No wave of speed"):
        travelling.cell_wave(gx.Linear(1.0), [1.0, 0.5], speed=2.0)


def test_masses_that_are_nearly_equal_are_refused_in_a_sentence():
    """Newton's method comes to equal masses there, whose cell is of another size."""
    with refused("travels without loss"):
        gx.travelling.cell_wave(gx.Hertz(), speed=1.0, masses=[1.0, 0.999])
