"""Stiffness that changes in time: Floquet-Bloch bands, k-gaps, growth, non-reciprocal waves."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import Turning
from numpy.testing import assert_allclose
from refusals import refused
from scipy.optimize import brentq, minimize_scalar

import granjax as gx
from granjax.linear import floquet_bands
from granjax.scenes import modulated

PERIOD = np.pi
# wave numbers of a ring of 12
K = 2 * np.pi * np.arange(7) / 12
# the growth of the literature's multiplier
GROWTH = np.log(1.1051133) / PERIOD


def square(q, a=0.1):
    """Trace of the map over a period of x'' = -q^2 (1 +- a) x: 2 cos A cos B - (w1/w2 + w2/w1) sin A sin B."""
    first = q * np.sqrt(1 + a)
    second = q * np.sqrt(1 - a)
    A = first * PERIOD / 2
    B = second * PERIOD / 2
    return 2 * np.cos(A) * np.cos(B) - (first / second + second / first) * np.sin(A) * np.sin(B)


def edges(*brackets):
    """The wave numbers where |trace| = 2."""
    roots = [brentq(lambda q: abs(square(q)) - 2, *b, xtol=1e-15, rtol=1e-15) for b in brackets]
    return 2 * np.arcsin(np.array(roots) / 2)


@pytest.fixture(scope="module")
def layers():
    return modulated(12, 0.1, 2.0, shape="square")


@pytest.fixture(scope="module")
def smooth():
    return modulated(12, 0.1, 2.0)


@pytest.mark.slow
def test_multipliers_of_the_mathieu_equation():
    spring = gx.Modulated(gx.OnSite(gx.Linear(1.0)), gx.Harmonic(0.1, 2.0, mean=1.0))
    found = floquet_bands(gx.Lattice(1.0, spring, sites=2), [0.0, 1.0], PERIOD)
    assert_allclose(found.multipliers, [[-1.08168155, -0.92448651]] * 2, atol=6e-9)
    assert found.error.max() < 1e-10 and found.gaps == [(-np.pi, np.pi)]
    assert_allclose(found.multipliers.prod(-1), 1, atol=1e-12)


@pytest.mark.slow
def test_layers_in_time_have_the_trace_of_the_closed_form(layers):
    q = np.array([1.0, 0.3, 1.7])
    found = floquet_bands(layers, 2 * np.arcsin(q / 2), PERIOD)
    assert_allclose(found.multipliers.sum(-1), square(q), atol=1e-13)
    # the literature's numbers of the first k-gap
    assert abs(abs(found.multipliers[0, 0]) - 1.1051133) < 5e-8
    first, second = floquet_bands(layers, [0.0, np.pi], PERIOD).gaps
    assert_allclose(2 * np.sin(np.array(first) / 2), [0.9693839828, 1.0331144089], atol=5e-11)
    # the second is cut by the band's end and goes on as its own mirror image
    assert_allclose(second, [edges((1.9, 2.0))[0], 2 * np.pi - second[0]], rtol=1e-12)
    # waves that grow in the first gap have -pi/T, on either side of the cut up to rounding
    pairs = floquet_bands(layers, [2.1, -2.1], PERIOD, cell=2)
    assert_allclose(pairs.omega[:, [0, -1]], -np.pi / PERIOD, rtol=1e-12)


@pytest.mark.slow
def test_waves_of_a_cell_of_two_masses_have_one_size_together():
    mass = np.tile([1.0, 4.0], 6)
    bond = gx.Bond(gx.Shift(1, "periodic"), gx.Linear(1.0))
    waves = gx.Modulated(bond, gx.Harmonic(0.3, 2.0, mean=1.0))
    found = floquet_bands(gx.Lattice(mass, waves), 0.4, PERIOD, steps=16)
    assert found.cell == (2,) and found.multipliers.shape == (4,)
    # in units of the geometric mean of the masses, the sites of the cell together
    parts = np.abs(found.displacements) ** 2 + np.abs(found.velocities * PERIOD / (2 * np.pi)) ** 2
    assert_allclose(mass[:2] / 2 @ parts, 1, rtol=1e-12)


@pytest.mark.slow
def test_edges_say_how_well_they_are_known(layers, smooth):
    found = floquet_bands(layers, np.linspace(0, 1.5, 7), PERIOD)
    off = np.abs(found.edges - edges((0.9, 1.0), (1.01, 1.2)))
    assert len(found.edges) == 1 and (off <= found.edge_error + 4e-16).all()
    assert found.edge_error.max() < 1e-11
    top = minimize_scalar(square, (0.97, 1.0, 1.03), tol=1e-9)
    assert abs(2 * np.cosh(found.fastest[0] * PERIOD) + top.fun) < 1e-12
    assert abs(2 * np.sin(found.fastest_k[0] / 2) - top.x) < 1e-5 and abs(top.x - 1.0012) < 1e-4
    coarse, fine = (floquet_bands(smooth, [1.0, 1.1], PERIOD, steps=n) for n in (8, 256))
    assert (np.abs(coarse.multipliers - fine.multipliers) <= coarse.error).all()
    assert (np.abs(coarse.edges - fine.edges) <= coarse.edge_error).all()
    assert coarse.error.max() > 1e-6


@pytest.mark.slow
def test_a_period_of_few_digits_counts_in_the_error(layers, smooth):
    for lattice in layers, smooth:
        known, rough = (floquet_bands(lattice, 1.0, T) for T in (PERIOD, 3.14159265))
        off = np.abs(known.multipliers - rough.multipliers).max()
        assert 1e-10 < off < rough.error.max() < 1e-6
    few = floquet_bands(layers.astype(np.float32), 1.0, PERIOD)
    assert np.abs(few.multipliers - floquet_bands(layers, 1.0, PERIOD).multipliers).max() < 1e-7


@pytest.mark.slow
def test_a_wave_of_a_ring_grows_as_its_multiplier_says(layers):
    found = floquet_bands(layers, K, PERIOD)
    state = found.state(layers, wave=2)
    us = gx.simulate(layers, state, 20 * PERIOD, save_at=2, tolerance=1e-11).us
    first, last = np.linalg.norm(np.asarray(us), axis=1)
    assert abs(np.log(last / first) / (20 * PERIOD) - found.growth[2, 0]) < 1e-9
    assert abs(found.growth[2, 0] - GROWTH) < 2e-8


def truncated(k, cell, depth, omega, orders=24):
    """Quasi-frequencies of u_n = sum_m a_m exp(i(k/P + 2 pi m/P) n - i(w + m omega) t) by a truncated determinant."""
    m = np.arange(-orders, orders + 1)
    one = 1 - np.exp(1j * (k + 2 * np.pi * m) / cell)
    K = np.diag(np.abs(one) ** 2).astype(complex)
    for step in 1, -1:
        i = np.arange(max(0, -step), len(m) - max(0, step))
        K[i + step, i] = depth / 2 * one[i] * one[i + step].conj()
    shift = np.diag(m * omega)
    zero = np.zeros((len(m),) * 2)
    return np.linalg.eigvals(np.block([[zero, np.eye(len(m))], [K - shift**2, -2 * shift]]))


@pytest.mark.slow
def test_a_stiffness_that_travels_makes_waves_non_reciprocal():
    depth = 0.3
    omega = 1.5
    wavelength = 3
    chain = modulated(12, depth, omega, phase=-2 * np.pi * np.arange(12) / wavelength)
    found = floquet_bands(chain, [-2.1, 0.4, 2.1], 2 * np.pi / omega)
    assert found.cell == (3,) and found.omega.shape == (3, 6)
    for k, got in zip(found.k, found.omega):
        away = truncated(float(k), 3, depth, omega)[:, None] - got
        modulo = (away.real + omega / 2) % omega - omega / 2
        assert np.abs(modulo + 1j * away.imag).min(0).max() < 1e-10
    # all frequencies at k are minus those at -k: non-reciprocal where they are not in pairs +-
    back, _, there = np.sort(found.omega, -1)
    assert_allclose(there, -back[::-1], atol=1e-12)
    assert np.abs(there - back).max() > 1e-2
    still = floquet_bands(modulated(12, depth, omega), [-2.1, 2.1], 2 * np.pi / omega)
    assert_allclose(*np.sort(still.omega, -1), atol=1e-9)


@pytest.mark.slow
def test_without_modulation_it_is_the_dispersion():
    terms = (
        gx.Bond(gx.Shift(1, "periodic", "bead"), gx.Hertz(1.0, 0.4)),
        gx.Bond(gx.Shift(0, "free", ("bead", "resonator")), gx.Linear(0.7)),
    )
    lattice = gx.Lattice({"bead": 1.0, "resonator": 0.3}, terms, sites=6)
    found = floquet_bands(lattice, K[1:], 0.7)
    omega = gx.linear.dispersion(lattice, K[1:]).omega
    want = np.sort(np.concatenate([omega, -omega], -1), -1)
    assert_allclose(np.sort(found.omega, -1), want, atol=1e-12)
    assert not found.gaps and not found.grows.any()


@pytest.mark.slow
def test_damping_takes_from_the_growth(smooth):
    """Uniform damping gamma: omega^2 -> omega^2 g - gamma^2/4, growth less gamma/2."""
    rate = 0.02
    damped = modulated(12, 0.1, 2.0, damping=rate)
    found, free = (floquet_bands(x, [0.9, 1.2], PERIOD) for x in (damped, smooth))
    assert_allclose(found.multipliers.prod(-1), np.exp(-rate * PERIOD), atol=1e-12)
    low, high = found.gaps[0]
    wide, end = free.gaps[0]
    assert wide < low < high < end and found.edge_error.max() < 1e-9
    at = floquet_bands(damped, [low, high], PERIOD)
    assert_allclose(np.abs(at.multipliers[:, 0]), 1, atol=1e-10)


@pytest.mark.slow
def test_edges_among_gyroscopic_forces_are_those_of_the_gaps():
    """By bisection on the growth of a map from DOP853; without losses waves outside do not decay."""
    bond = gx.Bond(gx.Stretch(gx.Shift(1, "periodic"), (1.0, 0.0)), gx.Linear())
    waves = gx.Modulated(bond, gx.Harmonic(0.3, 2.0, mean=1.0))
    terms = waves, gx.OnSite(gx.Linear(0.3)), Turning(jnp.array(0.3))
    lattice = gx.Lattice(1.0, terms, sites=8, dimension=2)
    found, coarse = (
        floquet_bands(lattice, np.linspace(0, np.pi, 7), PERIOD, steps=n) for n in (None, 16)
    )
    true = [[0.7199330, 0.8438166], [1.4190646, 1.4952062], [2.4805703, 2.6176741]]
    assert_allclose(found.edges, true, atol=1e-7)
    assert found.edge_error.max() < 1e-7
    assert (np.abs(coarse.edges - found.edges) <= coarse.edge_error).all()


@pytest.mark.slow
def test_dashpots_take_from_the_growth_by_the_wave_number(smooth):
    rate = 0.02
    terms = *smooth.terms, gx.Dashpot(gx.Shift(1, "periodic"), rate)
    lost = floquet_bands(gx.Lattice(1.0, terms, sites=12), K, PERIOD).multipliers.prod(-1)
    assert_allclose(lost, np.exp(-rate * (2 - 2 * np.cos(K)) * PERIOD), atol=1e-12)


@pytest.mark.slow
def test_a_breather_of_the_k_gap():
    """It grows by the linear rate, saturates, and returns to its energy along the wave that decays."""
    ring = modulated(6, 0.1, 2.0, shape="square", law=gx.Polynomial(1.0, 0.0, 1.0))
    found = gx.breathers.k_gap_breather(ring, PERIOD, np.pi / 3)
    assert abs(found.growth - GROWTH) < 2e-8
    early = np.log(found.energy[[0, -4]])
    late = np.log(found.energy[[3, -1]])
    assert_allclose((late - early) / (6 * PERIOD), [found.growth, -found.growth], rtol=0.02)
    assert found.energy.max() > 1000 * found.energy[0]
    assert abs(found.returned) < 1e-5 and found.stray < 1e-2
    # by another solver, in one run
    run = gx.simulate(ring, found.state, found.ts[-1], save_at=found.ts, tolerance=1e-12)
    energy = jax.vmap(lambda u, v: ring.energy(0.0, u, v))(run.us, run.vs)
    assert_allclose(energy, found.energy, rtol=1e-4)
    assert abs(energy[-1] / energy[0] - 1) < 1e-3


def test_the_picture_shows_gaps_and_growth(layers):
    found = floquet_bands(layers, np.linspace(0, 1.5, 7), PERIOD)
    ax = gx.plots.floquet_bands(found)
    assert len(ax.patches) == 1 and ax.patches[0].get_x() == found.gaps[0][0]
    growth = ax.figure.axes[-1]
    shown = growth.lines[0].get_ydata()
    assert_allclose(shown, np.maximum(found.growth[:, 0], 0), atol=1e-15)
    assert ax.get_ylabel().endswith("(scaled)") and growth.get_ylabel().startswith("growth rate")


@pytest.mark.slow
def test_derivatives_and_lanes():
    def largest(x):
        found = floquet_bands(modulated(6, x[0], 2.0, shape="square"), x[1], PERIOD)
        return jnp.abs(found.multipliers[0])

    at = jnp.array([0.1, np.pi / 3])
    k = np.pi / 3
    h = 1e-5
    apart = [largest(at + h * e) - largest(at - h * e) for e in jnp.eye(2)]
    assert_allclose(jax.grad(largest)(at), np.array(apart) / (2 * h), atol=1e-8)
    slopes = [jax.grad(largest)(at + h * e) - jax.grad(largest)(at - h * e) for e in jnp.eye(2)]
    assert_allclose(jax.hessian(largest)(at), np.array(slopes) / (2 * h), rtol=1e-6, atol=1e-6)

    # gaps have no derivative, and are not given where one is taken
    known, _ = jax.jvp(
        lambda a: floquet_bands(modulated(6, a, 2.0), [0.9, 1.2], PERIOD), (0.1,), (1.0,)
    )
    assert known.edges is None and known.fastest is None
    plain = floquet_bands(modulated(6, 0.1, 2.0), [0.9, 1.2], PERIOD)
    assert_allclose(known.velocities, plain.velocities, atol=1e-12)

    def growth(a):
        return floquet_bands(modulated(6, a, 2.0), k, PERIOD, cell=1, steps=32).growth[0]

    one = floquet_bands(modulated(6, 0.2, 2.0), k, PERIOD).growth[0]
    assert_allclose(jax.jit(jax.vmap(growth))(jnp.array([0.1, 0.2]))[1], one, atol=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize(
    "call, words",
    [
        (lambda s: floquet_bands(s, K, PERIOD / 2), "period: expected one after which"),
        (lambda s: floquet_bands(s, K, PERIOD * 1.0001), "period: expected one after which"),
        (lambda s: floquet_bands(s, 1.0, PERIOD).gaps, "gaps: expected a chain, and several"),
        (lambda s: floquet_bands(s, K, PERIOD, cell=5), "cell: expected a divisor of 12"),
        # the error is the difference from fewer steps
        (
            lambda s: floquet_bands(s, K, PERIOD, steps=1),
            "steps: expected a whole number not below 2",
        ),
        (lambda s: gx.linear.dispersion(s, K), "floquet_bands"),
        (
            lambda s: jax.jit(lambda k: floquet_bands(s, k, PERIOD).growth)(1.0),
            "steps: expected the number of steps",
        ),
        (
            lambda s: gx.breathers.k_gap_breather(s, PERIOD, np.pi / 4),
            "k: expected a multiple of 2 pi/12",
        ),
        (
            lambda s: gx.breathers.k_gap_breather(s, PERIOD, np.pi / 6),
            "k: expected a wave number in a k-gap, got 0.5",
        ),
        (lambda s: gx.breathers.k_gap_breather(s, PERIOD), "a force that is nonlinear"),
        pytest.param(
            # Its slope is never below 0.97. By SciPy it stays above 3e3, and grows to 1e11.
            lambda s: gx.breathers.k_gap_breather(
                modulated(6, 0.3, 2.0, law=gx.Polynomial(1.0, 0.3, 1.0), shape="square"), PERIOD
            ),
            r"one that stays above .*e\+03 of it. Losses or other waves took part",
            marks=pytest.mark.slow,
        ),
        (lambda s: gx.breathers.breather(s, 1.0), "expected forces that depend on positions alone"),
        (lambda s: gx.breathers.family(s, until=1.0), "come and go: gx.breathers.k_gap_breather"),
    ],
)
def test_refusals(layers, call, words):
    with refused(words):
        call(layers)
