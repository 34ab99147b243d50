"""Floquet theory: multipliers against closed forms, what symmetry promises of them, errors, verdicts, products."""

from functools import cache

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import ended
from known_orbits import dimer, hard, reference
from numpy.testing import assert_allclose
from refusals import refused
from scipy.integrate import solve_ivp
from scipy.optimize import fsolve, linear_sum_assignment

import granjax as gx
from granjax.breathers import breather
from granjax.floquet import floquet, multipliers
from granjax.forced import forced_orbit
from granjax.orbits.floquet import decide, sentence, weights
from granjax.orbits.spectrum import product_spectrum, reversible_multipliers
from granjax.states import rest


def apart(a, b):
    """Distances between two sets of numbers in their best one-to-one matching, in the order of the first."""
    distance = np.abs(np.asarray(a)[:, None] - np.asarray(b)[None])
    return distance[linear_sum_assignment(distance)]


# equilibria ---------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("boundary, still", [("free", 2), ("fixed", 0)])
def test_at_rest_multipliers_and_signatures_are_those_of_the_normal_modes(boundary, still):
    chain = gx.scenes.dimer(6, ratio=0.5, precompression=1.0, boundary=boundary)
    omega = np.asarray(gx.linear.normal_modes(chain).omega)
    period = 2.0
    assert omega[-1] * period > np.pi  # one of them has gone around more than half of the circle
    fl = floquet(chain, rest(chain), period)
    assert fl.verdict == "stable" and fl.defect < 1e-13
    assert fl.expected == np.count_nonzero(omega == 0) * 2 == still
    own = np.abs(fl.multipliers - 1) > 1e-6
    for sign in (1, -1):
        # of positive energy those that turn with exp(i omega t)
        found = fl.multipliers[own & (fl.krein == sign)]
        assert apart(np.exp(sign * 1j * omega[omega > 0] * period), found).max() < 1e-9
    assert np.abs(fl.multipliers[~own] - 1).max(initial=0) < 1e-7 and not fl.krein[~own].any()
    # <x, i J x> of x = (a, -i omega a), which turns with exp(-i omega t), is 2 omega a . m a > 0
    m = np.diag(np.asarray(chain.mass))
    J = np.block([[0 * m, m], [-m, 0 * m]])
    form = np.real(np.einsum("ik,ij,jk->k", fl.vectors.conj(), 1j * J, fl.vectors))[own]
    assert np.abs(form).min() > 0.1 and np.array_equal(fl.krein[own], -np.sign(form))


def test_the_matrix_is_that_of_the_steps_asked_for():
    # of u'' = -u a step of Verlet is a matrix in closed form; few steps, which are far from the truth
    balls = gx.Lattice(np.ones(2), gx.OnSite(gx.Linear(1.0)))
    fl = floquet(balls, rest(balls), 2.0, steps=8, solver=gx.VelocityVerlet())
    h = 2.0 / 8
    drift = np.array([[1, h], [0, 1]])
    kick = np.array([[1, 0], [-h / 2, 1]])
    wanted = np.kron(np.linalg.matrix_power(kick @ drift @ kick, 8), np.eye(2))
    assert_allclose(fl.monodromy, wanted, atol=1e-14)


@pytest.mark.slow
def test_rest_between_loaded_contacts_needs_no_exact_balance():
    # forces of neighbours cancel to rounding alone, whatever the order in which a program adds: it is rest
    mass = np.where(np.arange(9) % 2 == 0, 1.0, 2.9)
    lattice = gx.Lattice(mass, gx.Bond(gx.Shift(1, "free"), gx.Hertz(1.3, 1.0)))
    omega = float(gx.linear.normal_modes(lattice).omega[4])
    for size in (0.0, 1e-18):
        state = gx.State(jnp.full(9, size), jnp.zeros(9))
        assert floquet(lattice, state, 2 * np.pi / omega, steps=24).expected == 2


# breathers ----------------------------------------------------------------------------------------------------------

N = 13
# largest displacements of breathers, and their frequencies: contacts open from 0.8 on
CLOSED = (0.25, 1.7603620260708719)
GROWING = (0.7358, 1.7266932371119086)


@pytest.fixture(scope="module")
def dimers():
    """A family of breathers with free ends."""
    return gx.breathers.family(dimer(N), until=0.97 * 3**0.5, stability=False)


def nearest(branch, amplitude, omega=None):
    near = branch.orbit(int(np.argmin(np.abs(branch.amplitude - amplitude))))
    return near if omega is None else breather(near.lattice, omega, near, check=False)


@pytest.fixture(scope="module")
def closed(dimers):
    return nearest(dimers, *CLOSED)


@pytest.fixture(scope="module")
def growing(dimers):
    return nearest(dimers, *GROWING)


def unpaired(fl, product=1.0):
    """The largest distance of a multiplier's best partner from product/rho, relative."""
    rho = fl.multipliers
    return np.abs(rho[:, None] * rho[None] / product - 1).min(1).max()


@pytest.mark.slow
def test_multipliers_of_a_breather_come_in_pairs_and_four_at_one(closed):
    assert gx.measures.overlap(closed.lattice, closed.state).min() > 0.5
    fl = closed.floquet()
    assert unpaired(fl) < 1e-9 and fl.defect < 1e-13
    at_one = np.abs(fl.multipliers - 1) < 1e-5
    assert at_one.sum() == fl.expected == 4
    # nothing else is near: the others are on the circle, with a signature each
    assert np.abs(fl.multipliers[~at_one] - 1).min() > 0.1 and fl.error[~at_one].max() < 1e-8
    assert np.array_equal(np.unique(fl.krein[~at_one]), [-1, 1])
    assert fl.verdict == "stable" and np.abs(np.abs(fl.multipliers[~at_one]) - 1).max() < 1e-12
    # the motion along the orbit is one of the vectors at +1: M f = f
    f = np.concatenate([closed.state.v, closed.lattice.acceleration(0.0, *closed.state)])
    assert np.abs(fl.monodromy @ f - f).max() < 1e-9 * np.abs(f).max()


@pytest.mark.slow
def test_a_growing_pair_of_pairs_is_called_unstable_at_any_step(growing):
    rho = growing.floquet(tolerance=1e-11).multipliers[:2]
    assert np.abs(rho) == pytest.approx(1.02194, abs=2e-5) and np.abs(rho.imag).min() > 0.1
    for steps in (8, 48):
        fl = growing.floquet(steps=steps)
        assert fl.verdict == "unstable" and list(fl.unstable) == [0, 1] and "complex" in fl.outcome
        assert np.all(np.abs(fl.multipliers[:2] - rho[:2]) < fl.error[:2])


@pytest.mark.slow
def test_coarse_steps_leave_a_stable_breather_undecided(closed):
    words = [closed.floquet(steps=steps).verdict for steps in (6, 10, 20, 48)]
    assert words == ["undecided"] * 2 + ["stable"] * 2
    coarse = closed.floquet(steps=8)
    assert "smaller steps would tell" in coarse.outcome and coarse.error.max() > 1e-2
    assert np.all(apart(coarse.multipliers, closed.floquet().multipliers) < coarse.error)
    assert closed.floquet(steps=12, resolution=1e-6).verdict == "undecided"


@pytest.mark.slow
def test_half_a_period_gives_the_multipliers_of_the_whole(growing):
    b = growing
    mass = np.asarray(growing.lattice.mass)
    scale = np.concatenate([np.ones(N), mass])
    fine, coarse = (
        gx.Flow(jnp.asarray(k), gx.KahanLi8()).derivative(b.state, 0.0, b.period / 2, b.lattice)[1]
        for k in (64, 32)
    )
    traces, rho, error = reversible_multipliers(
        *(scale[:, None] * np.asarray(M) / scale for M in (fine, coarse))
    )
    whole = b.floquet().multipliers
    away = np.abs(rho - 1) > 1e-4
    assert away.sum() == 2 * N - 4
    assert apart(rho[away], whole).max() < 1e-10 and apart(1 / rho, rho).max() < 1e-12
    # at +1 the whole period knows half as many digits; the half-traces know all of them
    assert np.abs(whole[np.abs(whole - 1) < 1e-4] - 1).max() > 1e-9
    assert np.sort(np.abs(traces - 1))[:2].max() < 1e-11
    assert np.all(np.abs(rho - 1)[~away] < 1e-5) and np.all(error[away] < 1e-9)


def test_an_error_of_the_factors_counts_by_each_factor_s_share_of_a_multiplier():
    # (a + d)^m = a^m + m a^(m-1) d, for multipliers that grow and that shrink
    a = np.array([3.0, 0.5])
    factors = [np.diag(a)] * 4
    rho, _, error = product_spectrum(factors, factors, factors, moved=1e-6)
    assert_allclose(rho, a**4, rtol=1e-14)
    assert_allclose(error, 4 * a**3 * 1e-6, rtol=1e-5)


# other flows --------------------------------------------------------------------------------------------------------


def hopf(t, z, rate):
    """A limit cycle of radius 1 and frequency 1, to which radii tend as exp(-2 rate t)."""
    x, y = z
    slack = rate * (1 - x * x - y * y)
    return jnp.stack([slack * x - y, slack * y + x])


def of_hopf(x, rate=0.1, **keywords):
    flow = gx.Flow(400, diffrax.Dopri8(), hopf)
    return floquet(flow, jnp.array([x, 0.0]), 2 * np.pi, args=jnp.asarray(rate), **keywords)


def test_any_vector_field_has_multipliers():
    fl = of_hopf(1.0)
    assert_allclose(fl.multipliers, [1, np.exp(-0.4 * np.pi)], rtol=0, atol=1e-11)
    assert_allclose(fl.exponents.real, [0, -0.2], rtol=0, atol=1e-11)
    assert np.isnan(fl.krein).all() and np.isnan(fl.defect) and fl.rate is None
    # nothing says that one is at +1 by symmetry, so that it might lie outside
    assert fl.expected == 0 and fl.verdict == "undecided"
    one = of_hopf(1.0, expected=1)
    assert one.expected == 1 and one.verdict == "stable"
    assert of_hopf(0.0, -0.1).verdict == "stable" and of_hopf(0.0).verdict == "unstable"


FREE = gx.scenes.fput(4, beta=1.0, boundary="free")
U = np.random.default_rng(0).uniform(-1, 1, 4)
LANES = jax.vmap(lambda r: gx.scenes.dimer(4, r, precompression=1.0), out_axes=-1)(
    jnp.array([0.4, 0.7])
)
REFUSED = {
    "steps: expected a multiple of 6, twice the segments": lambda: floquet(
        FREE, rest(FREE), 3.0, steps=40, segments=3
    ),
    "steps: expected a whole number not below 1, got -1": lambda: floquet(
        FREE, rest(FREE), 3.0, steps=-1
    ),
    "period: expected a time above zero, got 0": lambda: floquet(FREE, rest(FREE), 0),
    "state.v: expected shape": lambda: floquet(FREE, gx.State(U, U[:3]), 3.0),
    "lattice: expected one Lattice, got a batch with lanes": lambda: floquet(
        LANES, rest(LANES), 1.0
    ),
    "state: expected one that returns after the period, got a gap of": lambda: of_hopf(0.4),
    "lattice, state, period: expected known numbers, got traced ones. gx.floquet.multipliers": lambda: (
        jax.grad(
            lambda T: (
                gx.orbits.orbit(FREE, gx.State(U, 0 * U), T, steps=32, throw=False).floquet().period
            )
        )(3.0)
    ),
    "lattice, state, period: expected known": lambda: jax.jit(lambda x: floquet(FREE, x, 3.0))(
        rest(FREE)
    ),
    "lattice, state, period: expected known numbers": lambda: jax.jit(lambda r: of_hopf(1.0, r))(
        0.1
    ),
    # where a free lattice stands does not tell whether its state returns
    "state: expected one that returns": lambda: floquet(
        FREE, gx.State(U + 1e3, 0 * U), 3.0, steps=64
    ),
}


@pytest.mark.parametrize("words", REFUSED)
def test_what_has_no_multipliers_is_refused(words):
    with refused(words):
        REFUSED[words]()


# errors -------------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_multipliers_of_what_is_not_quite_an_orbit_cover_those_of_the_orbit_near_by(closed):
    other = gx.State(1.003 * closed.state.u, closed.state.v)
    fl = floquet(closed.lattice, other, float(closed.period))
    assert np.all(apart(fl.multipliers, closed.floquet().multipliers) <= fl.error)
    assert fl.error.min() > 1e-6


@pytest.mark.slow
@pytest.mark.parametrize("name", ["forced_opening", "hard_pair", "forced_branch_upper", "defect"])
def test_errors_cover_the_multipliers_of_dop853(name):
    known = reference(name)
    rng = np.random.default_rng(0)
    size = 1e-4 * np.abs(known.u).max()
    moved = gx.State(*(x + size * rng.normal(size=len(x)) for x in known.state))
    of = lambda state, **how: floquet(known.lattice, state, known.period, **how)
    default = of(known.state)
    # and of an orbit from so few steps that it is off
    found = default, of(known.state, steps=64), of(moved, steps=64), known.ask(steps=40).floquet()
    for fl in found:
        away = apart(fl.multipliers, known.multipliers)
        assert np.all(away <= fl.error + known.multiplier_errors.max())
    # nor are they beyond belief
    assert np.median(default.error) < 1e-4


@cache
def settled(force, omega, damping):
    """The orbit to which four beads between walls settle, the first of them driven, and its least overlap."""
    drive = gx.Drive(gx.Harmonic(jnp.asarray(force), jnp.asarray(omega)), 0)
    bond = gx.Bond(gx.Shift(1, "fixed"), gx.Hertz(1.0, 1.0))
    rate = jnp.asarray(damping)
    chain = gx.Lattice(1.0, (bond, gx.Damping(rate), drive), sites=4)
    orbit = forced_orbit(chain, 2 * np.pi / omega, transient=60, steps=256)
    strains = [gx.measures.overlap(chain, gx.State(u, 0 * u)) for u in orbit.run(64).us]
    return orbit, float(np.min(strains))


@pytest.mark.slow
@pytest.mark.parametrize(
    "force, omega, damping, opens, modulus",
    [(0.3, 1.5, 0.2, False, 0.7086), (2.0, 1.2, 0.1, True, 1.0343)],
)
def test_multipliers_of_a_damped_driven_orbit(force, omega, damping, opens, modulus):
    orbit, overlap = settled(force, omega, damping)
    assert (overlap < -0.5) == opens
    fl = orbit.floquet()
    product = np.exp(-damping * 2 * np.pi / omega)
    assert unpaired(fl, product) < 1e-8 and fl.defect < 1e-11 and fl.expected == 0
    assert fl.verdict == ("unstable" if opens else "stable")
    assert np.abs(fl.multipliers[0]) == pytest.approx(modulus, abs=1e-4)
    if opens:
        coarse = orbit.floquet(steps=8)
        assert coarse.verdict == "undecided" and coarse.error[0] > modulus - 1


@pytest.mark.slow
def test_errors_and_the_bound_of_the_step_error_hold_where_contacts_open(dimers):
    walls = gx.scenes.dimer(5, ratio=0.5, precompression=1.0, boundary="fixed")
    family = gx.breathers.family(walls, amplitude=1.3, stability=False)
    orbits = [nearest(dimers, 0.9), nearest(dimers, 0.93), nearest(family, 1.25)]
    assert max(gx.measures.overlap(b.lattice, b.state).min() for b in orbits) < -0.01
    driven, overlap = settled(2.0, 1.2, 0.1)
    assert overlap < -0.5
    for b in (*orbits, driven):
        for steps in (32, 64, 128):
            fl = b.floquet(steps=steps)
            exact = b.floquet(steps=16 * steps).multipliers
            away = apart(fl.multipliers, exact)
            assert np.all(away <= fl.error)
            # Bauer, Fike: |d rho| <= |dM|/|y^H x| to first order, of M without units
            scale = weights(np.broadcast_to(b.lattice.mass, len(exact) // 2), fl.period)
            condition = np.linalg.norm(np.linalg.inv(scale[:, None] * fl.vectors), axis=1)
            assert np.all(away <= condition * len(exact) * fl.step_error)


@pytest.mark.parametrize(
    "rho, error, expected, conserves, verdict, words",
    [
        ([1.1, 1 / 1.1], 1e-6, 0, True, "unstable", "A real multiplier of modulus 1.1 "),
        ([-1.1, -1 / 1.1], 1e-6, 0, True, "unstable", "period doubling"),
        ([1.1j, -1.1j], 1e-6, 0, True, "unstable", "A complex multiplier"),
        ([1 + 1e-3, 1 - 1e-3], 2e-3, 0, True, "undecided", "smaller steps would tell"),
        ([1 + 1e-3, 1 - 1e-3], 2e-5, 2, True, "stable", "2 multipliers at +1"),
        ([1j, -1j, 1 + 1e-3, 1 - 1e-3], 1e-9, 2, True, "stable", "on the unit circle"),
        ([1j, -1j], 1e-3, 0, True, "undecided", "known to 1.0e-03"),
        ([0.9, 0.5], 1e-3, 0, False, "stable", "inside the unit circle, by 9.9e-02"),
        ([1.0, 0.5], 1e-3, 1, False, "stable", "inside"),
    ],
)
def test_the_word_follows_from_the_error(rho, error, expected, conserves, verdict, words):
    rho = np.asarray(rho, complex)
    numbers = rho, np.full(len(rho), error), expected, conserves
    assert decide(*numbers) == verdict and words in sentence(verdict, *numbers)


# derivatives --------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_multipliers_are_differentiable_in_the_lattice_and_the_period():
    # at rest under a modulated stiffness, a system of Mathieu's kind
    bond = gx.Bond(gx.Shift(1, "free"), gx.Linear(0.3))
    flow = gx.Flow(24, gx.KahanLi8())

    @jax.jit
    def largest(x):
        depth, stretch = x
        wave = gx.Harmonic(depth, 2.0 / stretch, mean=1.0)
        chain = gx.Lattice(1.0, (bond, gx.Modulated(gx.OnSite(gx.Linear(1.0)), wave)), sites=3)
        rho = multipliers(flow, rest(chain), 0.0, jnp.pi * stretch, chain)
        return jnp.abs(rho[jnp.argmax(jnp.abs(rho))])

    at = jnp.array([0.3, 1.0])
    h = 1e-4
    assert largest(at) > 1.2
    for slope, step in zip(jax.jit(jax.jacfwd(largest))(at), h * np.eye(2)):
        near, far = (largest(at + k * step) - largest(at - k * step) for k in (1, 2))
        assert abs(slope - (8 * near - far) / (12 * h)) < 1e-9 * abs(slope) + 1e-9
        assert abs(slope) > 0.1


@pytest.mark.slow
def test_multipliers_have_higher_derivatives():
    """At rest they are exp(i omega t), omega^2 = K + 0.3 (0, 1, 3), in closed form."""
    bond = gx.Bond(gx.Shift(1, "free"), gx.Linear(0.3))
    flow = gx.Flow(24, gx.KahanLi8())

    def angles(K):
        chain = gx.Lattice(1.0, (bond, gx.OnSite(gx.Linear(K))), sites=3)
        rho = multipliers(flow, rest(chain), 0.0, 1.0, chain)
        return jnp.append(jnp.sort(jnp.angle(rho))[3:], K**3)

    second = jax.jit(jax.jacfwd(jax.jacrev(angles)))
    omega = np.sqrt(1 + 0.3 * np.array([0, 1, 3]))
    assert_allclose(second(1.0), np.append(-(omega**-3) / 4, 6), rtol=1e-9)
    assert_allclose(jax.jacfwd(second)(1.0), np.append(3 * omega**-5 / 8, 6), rtol=1e-8)


RATE = 0.1
DRIVEN = 0.9
OPENED = 0.5512  # the amplitude at which the contact opens by a hundredth of its compression


def oscillator(amplitude, x):
    """Orbit, trace of M, least u of u'' + 0.1 u' + [1 + u]_+^(3/2) - 1 = F cos 0.9 t, by SciPy with its tangents."""

    def field(t, y):
        s = max(1 + y[0], 0.0)
        M = y[2:].reshape(2, 2)
        a = 1 - s**1.5 - RATE * y[1] + amplitude * np.cos(DRIVEN * t)
        return np.concatenate([[y[1], a], M[1], -1.5 * s**0.5 * M[0] - RATE * M[1]])

    how = dict(method="DOP853", rtol=1e-12, atol=1e-13, max_step=0.03)
    for _ in range(12):
        y = solve_ivp(field, (0, 2 * np.pi / DRIVEN), np.append(x, np.eye(2)), **how).y
        M = y[2:, -1].reshape(2, 2)
        change = np.linalg.solve(np.eye(2) - M, y[:2, -1] - x)
        x = x + change
        if np.abs(change).max() < 1e-12:
            return x, np.trace(M), y[0].min()
    raise AssertionError("no orbit")


@pytest.mark.slow
def test_the_error_of_a_multipliers_derivative_covers_the_truth_where_a_contact_opens():
    period = 2 * np.pi / DRIVEN
    h = 1e-5
    x, _, least = oscillator(OPENED, np.array([0.928, 0.196]))
    assert -1.011 < least < -1.009
    low, high = (oscillator(OPENED + sign * h, x)[1] for sign in (-1, 1))
    truth = (high - low) / (2 * h)

    def trace(amplitude, step):
        steps = 2 * jnp.round(period / step / 2).astype(int)
        drives = [gx.Drive(gx.Harmonic(amplitude, DRIVEN), site) for site in (0, 1)]
        scene = gx.Lattice(1.0, (gx.OnSite(gx.Hertz(1.0, 1.0)), gx.Damping(RATE), *drives), sites=2)
        guess = gx.State(jnp.full(2, x[0]), jnp.full(2, x[1]))
        found = forced_orbit(scene, period, guess, steps=steps, solver=gx.KahanLi8(), throw=False)
        return jnp.sum(multipliers(gx.Flow(steps), found.state, 0.0, period, scene)).real / 2

    errors = []
    for steps in (24, 96, 192):
        found = gx.derivative(trace, OPENED, period / steps)
        assert abs(found.value - truth) < found.error
        errors.append(float(found.error))
    assert min(errors) < 0.5 * truth
    # where contacts stay closed the same is known to many digits
    x = oscillator(0.3, np.array([0.436, 0.060]))[0]
    low, high = (oscillator(0.3 + sign * 1e-4, x)[1] for sign in (-1, 1))
    found = gx.derivative(trace, 0.3, period / 96)
    assert found.relative < 1e-6 and found.value == pytest.approx((high - low) / 2e-4, rel=1e-5)


@pytest.mark.slow
def test_a_breather_s_multiplier_has_a_derivative_with_an_error():
    omega = 1.4
    period = 2 * np.pi / omega
    seed = gx.breathers.guesses.single_site(hard(3), omega, 1)

    def trace(coupling, step):
        steps = 2 * jnp.round(period / step / 2).astype(int)
        chain = hard(3, coupling)
        found = breather(chain, omega, seed, steps=steps, throw=False)
        return jnp.sum(multipliers(gx.Flow(steps), found.state, 0.0, period, chain)).real

    def by_scipy(coupling):
        K = coupling * np.array([[1.0, -1.0, 0.0], [-1.0, 2.0, -1.0], [0.0, -1.0, 1.0]])

        def field(t, y):
            u = y[:3]
            M = y[6:].reshape(6, -1)
            tangents = -(K + np.diag(1 + 3 * u**2)) @ M[:3]
            return np.concatenate([y[3:6], -K @ u - u - u**3, M[3:].ravel(), tangents.ravel()])

        def end(x, time, M):
            return ended(field, time, np.concatenate([x, np.zeros(3), M.ravel()]))

        still = lambda x: end(x, period / 2, np.zeros((6, 0)))[3:]
        x = fsolve(still, np.asarray(seed.u), xtol=1e-12)
        return np.trace(end(x, period, np.eye(6))[6:].reshape(6, 6))

    found = gx.derivative(trace, 0.02, period / 64)
    assert found.relative < 1e-6
    truth = (by_scipy(0.0203) - by_scipy(0.0197)) / 6e-4
    assert float(found.value) == pytest.approx(truth, rel=1e-4)
