"""Chaos: exponents, alignment indices, frequencies, against exact sums and SciPy."""

import jax
import jax.numpy as jnp
import numpy as np
from numpy.testing import assert_allclose
from pytest import approx, mark
from refusals import refused
from scipy.integrate import solve_ivp
from scipy.special import ellipk

import granjax as gx
from granjax.orbits.chaos import birkhoff, frequency, gali, lyapunov


def state(lattice, size=0.3, seed=1):
    return gx.State(*jnp.asarray(np.random.default_rng(seed).normal(0, size, (2, *lattice.shape))))


def test_a_linear_chain_loses_half_of_its_damping_rate():
    lattice = gx.Lattice(
        np.ones(4), (gx.Bond(gx.Shift(1, "fixed"), gx.Linear(1.0)), gx.Damping(0.1))
    )
    found = lyapunov(lattice, state(lattice), 2.0, periods=400, number=8)
    assert abs(found.exponents[0] + 0.05) < found.uncertainty[0] < 0.005
    assert abs(found.exponents.sum() + 0.4) < 1e-12
    assert found.verdict == "at rest" and "At rest" in found.outcome and not found.chaotic


@mark.slow
def test_exponents_of_a_damped_driven_chain_pair():
    monomer = gx.scenes.monomer(4, precompression=1.0)
    lattice = gx.driven.driven_chain(monomer, 0.3, 2.0, damping=0.05)
    found = lyapunov(lattice, state(lattice), np.pi, periods=400, number=8)
    assert_allclose(found.exponents + found.exponents[::-1], -0.05, rtol=0, atol=5e-4)
    assert abs(found.exponents.sum() + 0.2) < 1e-12
    assert "Periodic" in found.outcome


@mark.slow
def test_exponents_of_an_integrable_ring_fall_like_a_logarithm_over_time():
    ring = gx.scenes.toda(8, boundary="periodic")
    first, last = (
        lyapunov(ring, state(ring, 0.7), 2.0, periods=p, transient=0) for p in (250, 2500)
    )
    # ln t/t falls by 0.126
    assert 0.08 < last.exponents[0] / first.exponents[0] < 0.2
    found = lyapunov(ring, state(ring, 0.7), 2.0, periods=4000)
    assert abs(found.exponents[0]) < found.uncertainty[0] < 2e-3 and "Regular" in found.outcome


@mark.parametrize("seed", [0, 2, 5, 7])
def test_the_shear_of_an_integrable_ring_is_not_called_chaos(seed):
    ring = gx.scenes.toda(3, boundary="periodic")
    u, v = np.random.default_rng(seed).normal(size=(2, 3))
    start = gx.State(jnp.asarray(u - u.mean()), jnp.asarray(v - v.mean()))
    found = lyapunov(ring, start, 1.0, periods=300, steps=40)
    assert found.verdict == "regular" and 0 < found.exponents[0] < found.uncertainty[0]


# The second is a small oscillator in SI units.
@mark.parametrize("mass, time, length", [(1.0, 1.0, 1.0), (1e-3, 1e-5, 1e-6)])
def test_the_uncertainty_of_a_settled_motion_is_the_error_of_its_steps(mass, time, length):
    """Against multipliers by SciPy, without units; the motion repeats after three periods."""
    omega = 1.2
    T = 2 * np.pi / omega
    stiffness = mass / time**2
    terms = (
        gx.OnSite(gx.Polynomial(-stiffness, 0.0, stiffness / length**2)),
        gx.Bond(gx.Shift(1, "free"), gx.Linear(0.1 * stiffness)),
        gx.Damping(0.3 / time),
        gx.Drive(gx.Harmonic(0.5 * stiffness * length, omega / time), 0),
    )
    lattice = gx.Lattice(np.full(2, mass), terms)
    start = gx.State(length * jnp.array([1.0, 0.9]), jnp.zeros(2))
    coarse, usual, fine = (
        lyapunov(lattice, start, T * time, periods=900, transient=99, steps=n)
        for n in (8, None, 64)
    )
    found = [x.exponents[0] * time for x in (coarse, usual, fine)]
    told = [x.uncertainty[0] * time for x in (coarse, usual, fine)]

    def motion(t, x):
        x = x.reshape(4, 5)
        u, v = x[:2], x[2:]
        slope = np.full((2, 5), 1.0) * (1 - np.c_[u[:, :1] ** 2, *4 * [3 * u[:, :1] ** 2]])
        force = slope * u - 0.1 * (u - u[::-1]) - 0.3 * v
        force[0, 0] += 0.5 * np.cos(omega * t)
        return np.concatenate([v, force]).ravel()

    settled = np.r_[fine.state.u / length, fine.state.v * time / length]
    begin = np.c_[settled, np.eye(4)]
    end = solve_ivp(motion, (0, 3 * T), begin.ravel(), "DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
    multipliers = np.linalg.eigvals(end.reshape(4, 5)[:, 1:])
    want = np.log(np.abs(multipliers).max()) / (3 * T)
    assert_allclose(end.reshape(4, 5)[:, 0], settled, rtol=0, atol=1e-9)
    assert_allclose(told[:2], np.abs(np.array(found[:2]) - want), rtol=0.1)
    assert abs(found[2] - want) < 1e-11 and 1e-16 < told[2] < 1e-11


def test_no_uncertainty_is_below_rounding():
    """Two exponents of equal sites at rest, without bonds, are the larger root."""
    lattice = gx.Lattice(np.ones(2), (gx.OnSite(gx.Linear(0.16)), gx.Damping(1.0)))
    found = lyapunov(lattice, gx.states.rest(lattice), 1.0, periods=100, number=2, steps=64)
    want = np.roots([1, 1, 0.16]).max()
    rounding = 4 * np.finfo(float).eps * (np.abs(want) + 1.0)
    assert np.all(found.uncertainty > 0.99 * rounding)
    assert np.all(np.abs(found.exponents - want) <= found.uncertainty)


@mark.slow
def test_exponents_and_indices_of_a_lattice_in_float32_and_counts_of_numpy():
    chain = gx.scenes.monomer(3, precompression=1.0)
    lattices = jax.tree.map(lambda x: x.astype(np.float32), chain), chain
    for f in (
        lambda x: (
            lyapunov(
                x, gx.states.impact(x, 0.1), 1.0, periods=np.int64(10), transient=np.int64(2)
            ).exponents
        ),
        lambda x: gali(x, gx.states.impact(x, 0.1), 1.0, periods=10, number=2).log_gali,
    ):
        single, double = map(f, lattices)
        assert single.dtype == np.float32
        assert_allclose(single, double, rtol=1e-4, atol=1e-6)


@mark.slow
def test_the_whole_spectrum_of_a_chaotic_chain_sums_to_zero_in_pairs():
    lattice = gx.scenes.fput(8, alpha=0.0, beta=1.0)
    found = lyapunov(lattice, state(lattice, 1.0), 1.0, periods=2000, number=16)
    assert found.exponents[0] > 0.03 and found.chaotic and "Chaotic" in found.outcome
    assert f"is {found.exponents[0]:.3g} +- {found.uncertainty[0]:.1g}" in found.outcome
    assert abs(found.exponents.sum()) < 1e-8
    pairs = found.exponents + found.exponents[::-1]
    assert np.all(np.abs(pairs) < found.uncertainty + found.uncertainty[::-1])


@mark.parametrize("force", [0.0, 0.1])
def test_the_instability_of_a_regular_motion_is_not_called_chaos(force):
    """Two sites that repel each other, at rest or moved alike by a force. The exponent by SciPy."""
    drive = gx.Harmonic(force, 1.2)
    terms = (
        gx.OnSite(gx.Polynomial(1.0, 0.0, 1.0)),
        gx.Bond(gx.Shift(1, "free"), gx.Linear(-1.0)),
        gx.Damping(0.3),
        *(gx.Drive(drive, site) for site in (0, 1)),
    )
    lattice = gx.Lattice(np.ones(2), terms)
    T = 2 * np.pi / 1.2
    found = lyapunov(lattice, gx.states.rest(lattice), T, periods=10, transient=99, steps=64)
    assert found.verdict == "unstable" and not found.chaotic
    assert "The motion itself is regular" in found.outcome

    def motion(t, x):
        u, v, du, dv = x
        return [v, -u - u**3 - 0.3 * v + force * np.cos(1.2 * t), dv, du - 3 * u**2 * du - 0.3 * dv]

    begin = [found.state.u[0], found.state.v[0], 1.0, 0.0]
    ends = solve_ivp(
        motion, (0, 12 * T), begin, "DOP853", rtol=1e-11, atol=1e-13, t_eval=[6 * T, 12 * T]
    ).y
    want = np.log(ends[2, 1] / ends[2, 0]) / (6 * T)
    assert_allclose(found.exponents[0], want, atol=1e-5)


def test_an_unstable_orbit_seen_at_its_turning_points_is_not_called_chaos():
    # neighbours in opposite phase: u'' = -4 u - 16 u^3 of every site, with u = 1 at a turning point
    ring = gx.Lattice(jnp.ones(4), gx.Bond(gx.Shift(1, "periodic"), gx.Polynomial(1.0, 0.0, 1.0)))
    u = jnp.array([1.0, -1.0, 1.0, -1.0])
    T = 4 * ellipk(0.4) / np.sqrt(20.0)
    found = lyapunov(ring, gx.State(u, 0 * u), T, periods=20, transient=10)
    assert found.verdict == "unstable" and found.exponents[0] == approx(0.7301210504, abs=1e-8)


@mark.slow
@mark.parametrize("a", [1e-5, 1e-8])
def test_a_small_chaotic_part_beside_a_large_regular_one_is_chaos(a):
    """A double well of width a, driven, beside a linear site that swings by 0.4."""
    k = np.array([4.0, -1.0])
    wells = gx.OnSite(gx.Polynomial(k, 0.0, np.array([0.0, 1 / a**2])))
    loss = gx.Damping(0.25)
    drives = [gx.Drive(gx.Harmonic(size, 1.2), n) for n, size in enumerate((1.0, 0.3 * a))]
    lattice = gx.Lattice(1.0, (wells, loss, *drives), sites=2)
    found = lyapunov(lattice, gx.states.rest(lattice), 2 * np.pi / 1.2, steps=64)
    assert found.verdict == "chaotic"
    assert_allclose(found.exponents[0], 0.14, atol=0.03)


@mark.slow
def test_the_largest_exponent_is_that_of_tangents_by_scipy():
    """Of an alpha chain of 16 sites."""
    lattice = gx.scenes.fput(16, alpha=0.25)
    alpha = 0.25
    N = 16
    start = state(lattice, 0.55, seed=2)

    strains = -np.diff(np.pad(np.eye(N), ((1, 1), (0, 0))), axis=0)

    def motion(t, x):
        x = x.reshape(4, N)
        e, d = x[::2] @ strains.T
        rates = np.empty_like(x)
        rates[::2] = x[1::2]
        rates[1::2] = np.stack([e + alpha * e**2, (1 + 2 * alpha * e) * d]) @ -strains
        return rates.ravel()

    y = np.r_[start.u, start.v, np.random.default_rng(0).normal(size=2 * N)]
    logs = []
    for _ in range(330):
        y[2 * N :] /= np.linalg.norm(y[2 * N :])
        y = solve_ivp(motion, (0, 10), y, "DOP853", rtol=1e-9, atol=1e-11).y[:, -1]
        logs.append(np.log(np.linalg.norm(y[2 * N :])) / 10)
    parts = np.reshape(logs[30:], (10, -1)).mean(1)
    found = lyapunov(lattice, start, 10.0, periods=300, transient=30)
    error = parts.std(ddof=1) / 10**0.5 + found.uncertainty[0]
    assert found.chaotic and abs(found.exponents[0] - parts.mean()) < 2 * error


@mark.slow
def test_alignment_indices_of_a_torus_and_of_a_chaotic_orbit():
    chain = gx.scenes.fput(4, alpha=0.0, beta=1.0)
    amplitudes = (0.3, 0.24, 0.18, 0.3)
    u = sum(a * gx.states.sine_mode(chain, k + 1, 1.0).u for k, a in enumerate(amplitudes))
    found = gali(chain, gx.State(u, jnp.zeros(4)), 5.0, number=8, periods=8000)
    # slopes between averages over stretches, as the indices oscillate
    early = found.log_gali[400:800].mean(0)
    late = found.log_gali[4000:8000].mean(0)
    slope = (late - early) / np.log(10)
    assert_allclose(slope, -2 * np.maximum(found.order - 4, 0), atol=0.6)
    wild = state(chain, 1.5)
    l = lyapunov(chain, wild, 1.0, periods=6000, number=4)
    found = gali(chain, wild, 1.0, number=4, periods=6000)
    want = -np.cumsum(l.exponents[0] - l.exponents)[1:]
    off = np.abs(found.log_gali[-1] / found.t[-1] - want)
    assert np.all(off < found.order * l.uncertainty.max() + 0.1 * np.abs(want))


@mark.slow
def test_frequencies_and_smooth_averages():
    t = 0.1 * np.arange(4096)
    omega = np.array([1.2345, 2.7182])
    q = 0.7 * np.cos(omega * t[:, None] + 0.3) + 0.2 * np.cos(5.1 * t[:, None]) + 3.0
    found = frequency(q, 0.1)
    assert_allclose(found.omega, omega, atol=1e-8)
    assert_allclose(found.amplitude, 0.7, rtol=1e-6)
    assert np.abs(found.drift).max() < 1e-6
    mean = birkhoff(q)
    assert_allclose(mean.value, 3.0, atol=1e-10)
    assert mean.error.max() < 1e-8
    drifting = frequency(np.cos(1.2 * t + 1e-4 * t**2), 0.1)
    # 2e-4 t: half of the time is 205
    assert_allclose(drifting.drift, 2e-4 * 204.8, rtol=0.01)
    # the second signal does not move
    still = frequency(np.stack([np.cos(1.2 * t), np.full(4096, 0.1)], 1), 0.1)
    assert_allclose(still.amplitude, [1.0, 0.0], rtol=1e-6)
    assert_allclose(still.omega, [1.2, np.nan], rtol=1e-6)
    # The line of an alternating signal is its own mirror image.
    for size in (400, 401):
        found = frequency(0.7 * (-1.0) ** np.arange(size), 0.1)
        assert_allclose((found.omega, found.amplitude), (np.pi / 0.1, 0.7), rtol=1e-12)
    slope = jax.jacfwd(lambda w: frequency(jnp.cos(w * t), 0.1).omega)(1.2345)
    assert_allclose(slope, 1.0, rtol=0, atol=1e-6)
    slope = jax.grad(lambda a: birkhoff(a * jnp.cos(t) ** 2).value)(1.0)
    assert_allclose(slope, 0.5, rtol=1e-6)


@mark.parametrize("second", [130.0, 160.0, 160.25])
@mark.parametrize("first", [100.0, 100.25, 100.5])
def test_the_strongest_line_may_lie_anywhere_between_two_points_of_the_transform(first, second):
    frames = 1000
    t = 0.1 * np.arange(frames)
    line = 2 * np.pi / 100.0
    found = frequency(np.cos(first * line * t) + 0.99 * np.cos(second * line * t), 0.1)
    assert_allclose(found.omega, first * line, rtol=0, atol=1e-4 * line)
    assert_allclose(found.amplitude, 1.0, rtol=1e-4)
    assert abs(found.drift) < 1e-2 * line


def test_the_drift_is_that_of_the_strongest_line():
    """Two lines that no half of the time resolves beat, and are then larger than a third."""
    t = 0.1 * np.arange(1000)
    line = 2 * np.pi / 100.0
    pair = sum(0.8 * np.cos(k * line * (t - 25.0)) for k in (158.75, 161.25))
    found = frequency(np.cos(100.5 * line * t) + pair, 0.1)
    assert_allclose(found.omega, 100.5 * line, rtol=0, atol=1e-3 * line)
    assert abs(found.drift) < 0.01 * line
    # A line that moves far is followed.
    moved = frequency(np.cos(np.where(t < 50.0, 2.0, 5.0) * t), 0.1)
    assert_allclose(moved.drift, 3.0, rtol=1e-4)


@mark.parametrize(
    "call, said",
    [
        (lambda chain, rest: gali(chain, rest, 1.0, number=1), "number"),
        (lambda chain, rest: gali(chain, rest, 1.0, number=9), "number: expected 1 to 8"),
        (lambda chain, rest: lyapunov(chain, rest, 1.0, transient=-5), "transient"),
        (lambda chain, rest: lyapunov(chain, rest, 1.0, number=2.0), "number: expected a whole"),
        (lambda chain, rest: lyapunov(chain, rest, 1.0, seed=-1), "seed: expected a whole"),
        (lambda chain, rest: frequency(np.ones(8), 0.1), "q: .* at least 16 frames"),
        (lambda chain, rest: birkhoff(np.ones(8)), "q: .* at least 16 frames"),
    ],
)
def test_numbers_that_do_not_fit_are_refused(call, said):
    chain = gx.scenes.fput(4)
    with refused(said):
        call(chain, gx.states.rest(chain))
