"""Floquet theory: multipliers against closed forms, what symmetry promises of them, errors, verdicts, products."""

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import ended
from known_orbits import reference
from refusals import refused
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.optimize import fsolve, linear_sum_assignment

import granjax as gx
from granjax.floquet import floquet, multipliers
from granjax.forced import forced_orbit
from granjax.orbits.floquet import decide, sentence, weights
from granjax.orbits.spectrum import product_multipliers, reversible_multipliers


def apart(a, b):
    """Distances between two sets of numbers in their best one-to-one matching, in the order of the first."""
    distance = np.abs(np.asarray(a)[:, None] - np.asarray(b)[None])
    return distance[linear_sum_assignment(distance)]


def rest(chain):
    return gx.State(chain.zeros(), chain.zeros())


# equilibria ---------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("boundary, law", [("free", gx.Hertz(1.0, 1.0)), ("fixed", gx.Linear(1.5))])
def test_at_rest_multipliers_are_those_of_the_normal_modes(boundary, law):
    chain = gx.Lattice(1.0, (gx.Bond(gx.Shift(1, boundary), law),), sites=6)
    omega, period = np.asarray(gx.linear.normal_modes(chain).omega), 2.0
    assert omega[-1] * period > np.pi  # one of them has gone around more than half of the circle
    fl = floquet(chain, rest(chain), period)
    assert fl.verdict == "stable" and fl.defect < 1e-13
    assert fl.expected == np.count_nonzero(omega == 0) * 2 == {"free": 2, "fixed": 0}[boundary]
    moving = omega[omega > 0]
    own = np.abs(fl.multipliers - 1) > 1e-6
    for sign in (1, -1):
        # of positive energy those that turn with exp(i omega t)
        found = fl.multipliers[own & (fl.krein == sign)]
        assert apart(np.exp(sign * 1j * moving * period), found).max() < 1e-9
    assert np.abs(fl.multipliers[~own] - 1).max(initial=0) < 1e-7 and not fl.krein[~own].any()


@pytest.mark.slow
def test_krein_signatures_are_the_signs_of_the_symplectic_form():
    chain = gx.scenes.dimer(6, ratio=0.5, precompression=1.0, boundary="fixed")
    fl = floquet(chain, rest(chain), 2.0)
    m = np.diag(np.asarray(chain.mass))
    J = np.block([[0 * m, m], [-m, 0 * m]])
    # <x, i J x> of x = (a, -i omega a), which turns with exp(-i omega t), is 2 omega a . m a > 0
    form = np.real(np.einsum("ik,ij,jk->k", fl.vectors.conj(), 1j * J, fl.vectors))
    assert np.abs(form).min() > 0.1 and np.array_equal(fl.krein, -np.sign(form))
    conjugate = np.argmin(np.abs(fl.multipliers[:, None] - fl.multipliers.conj()[None]), axis=1)
    assert np.array_equal(fl.krein[conjugate], -fl.krein)


# strongly unstable --------------------------------------------------------------------------------------------------

LONG = 32.0


def inverted(sites, coupling=0.2):
    """Coupled pendula on their heads, linear bonds: exponents +-sqrt(1 - kappa_j), kappa_j those of the bonds."""
    chain = gx.Lattice(
        1.0,
        (gx.Bond(gx.Shift(1, "free"), gx.Linear(coupling)), gx.OnSite(gx.Sine(1.0, 1.0))),
        sites=sites,
    )
    kappa = 2 * coupling * (1 - np.cos(np.pi * np.arange(sites) / sites))
    return chain, gx.State(jnp.full(sites, jnp.pi), jnp.zeros(sites)), np.sqrt(1 - kappa)


def relative(found, exact):
    """Largest relative error of real numbers of many sizes, each against its own."""
    return np.abs(np.sort(np.abs(found)) / np.sort(exact) - 1).max()


@pytest.fixture(scope="module")
def pendula():
    chain, state, growth = inverted(4)
    exact = np.exp(np.concatenate([growth, -growth]) * LONG)
    assert exact.max() > 7e13
    return exact, {m: floquet(chain, state, LONG, segments=m) for m in (1, 4, 16)}


@pytest.mark.slow
def test_the_whole_product_loses_the_small_multipliers_and_says_so(pendula):
    exact, found = pendula
    fl = found[1]
    assert relative(fl.multipliers, exact) > 1e10  # 4e-3 where 1e-14 is true
    assert relative(fl.multipliers[:3], np.sort(exact)[-3:]) < 1e-9
    assert np.all(apart(np.abs(fl.multipliers), exact) <= fl.error)
    assert fl.verdict == "unstable"


@pytest.mark.parametrize("segments, accuracy", [(4, 1e-7), (16, 1e-11)])
def test_segments_keep_them(pendula, segments, accuracy):
    exact, found = pendula
    fl = found[segments]
    assert relative(fl.multipliers, exact) < accuracy
    rho = np.sort(np.abs(fl.multipliers))
    np.testing.assert_allclose(rho * rho[::-1], 1, rtol=0, atol=accuracy)
    assert np.all(apart(np.abs(fl.multipliers), exact) <= fl.error)
    # vectors are those of the product: V = M v/rho for the ones that grow
    grown = fl.monodromy @ fl.vectors[:, :3] / fl.multipliers[:3]
    np.testing.assert_allclose(grown, fl.vectors[:, :3], rtol=0, atol=1e-6)
    assert fl.verdict == "unstable" and fl.steps % segments == 0


def test_multipliers_of_a_product_from_its_factors():
    rng = np.random.default_rng(1)
    basis, size = rng.normal(size=(4, 4)), np.array([1e4, 3.0, -0.5, 1e-3])
    rotated = [np.linalg.qr(rng.normal(size=(4, 4)))[0] for _ in range(2)]
    # factors of which each turns into the next one's basis: the product is basis size^3 basis^-1
    frames = [basis, *rotated, basis]
    factors = [b @ np.diag(size) @ np.linalg.inv(a) for a, b in zip(frames, frames[1:])]
    exact = size**3
    # the range of one factor, 1e7, is what costs digits, not that of the product, 1e21
    np.testing.assert_allclose(product_multipliers(factors).real, exact, rtol=1e-8)
    plain = np.linalg.eigvals(factors[2] @ factors[1] @ factors[0])
    assert np.abs(plain).min() > 1e3 * np.abs(exact).min()


def test_multipliers_of_many_symplectic_factors():
    rng, zero, one = np.random.default_rng(0), np.zeros((4, 4)), np.eye(4)
    for _ in range(20):
        factors = []
        for _ in range(16):  # of Hamiltonians A, exp(J A/2)
            A = rng.normal(size=(8, 8))
            factors.append(expm(np.block([[zero, one], [-one, zero]]) @ (A + A.T) / 4))
        found, plain = product_multipliers(factors), one_product(factors)
        large = np.sort(np.abs(plain))[::-1] > 1e-6 * np.abs(plain).max()
        np.testing.assert_allclose(
            np.abs(found)[large], np.sort(np.abs(plain))[::-1][large], rtol=1e-5
        )


def one_product(factors):
    return np.linalg.eigvals(np.linalg.multi_dot(factors[::-1]))


def test_a_segment_count_that_does_not_divide_the_steps_is_refused():
    chain, state, _ = inverted(4)
    with refused("steps: expected a multiple of 6, twice the segments"):
        floquet(chain, state, LONG, steps=40, segments=3)
    with refused("period: expected a time above zero"):
        floquet(chain, state, 0.0)
    with refused("state.v: expected shape"):
        floquet(chain, gx.State(state.u, state.v[:3]), LONG)


# breathers ----------------------------------------------------------------------------------------------------------

N, HEAVY = 13, 2.957949


@pytest.fixture(scope="module")
def dimers():
    """A family of breathers with free ends: contacts open from amplitude 0.8 on."""
    chain = gx.Lattice(
        np.where(np.arange(N) % 2 == 0, 1.0, HEAVY),
        (gx.Bond(gx.Shift(1, "free"), gx.Hertz(1.0, 1.0)),),
    )
    return gx.breathers.family(chain, until=0.97 * 3**0.5, stability=False)


# frequencies of the breathers with these largest displacements
FREQUENCY = {0.25: 1.7603620260708719, 0.7358: 1.7266932371119086}


def nearest(branch, amplitude):
    near = branch.orbit(int(np.argmin(np.abs(branch.amplitude - amplitude))))
    omega = FREQUENCY.get(amplitude)
    return near if omega is None else gx.breathers.breather(near.lattice, omega, near, check=False)


def unpaired(fl, product=1.0):
    """The largest distance of a multiplier's best partner from product/rho, relative."""
    rho = fl.multipliers
    return np.abs(rho[:, None] * rho[None] / product - 1).min(1).max()


@pytest.mark.slow
def test_multipliers_of_a_breather_come_in_pairs_and_four_at_one(dimers):
    b = nearest(dimers, 0.25)
    assert gx.measures.overlap(b.lattice, b.state).min() > 0.5
    fl = b.floquet()
    assert unpaired(fl) < 1e-9 and fl.defect < 1e-13
    at_one = np.abs(fl.multipliers - 1) < 1e-5
    assert at_one.sum() == fl.expected == 4
    # nothing else is near: the others are on the circle, with a signature each
    assert np.abs(fl.multipliers[~at_one] - 1).min() > 0.1 and fl.error[~at_one].max() < 1e-8
    assert np.array_equal(np.unique(fl.krein[~at_one]), [-1, 1])
    assert fl.verdict == "stable" and np.abs(np.abs(fl.multipliers[~at_one]) - 1).max() < 1e-12
    # the motion along the orbit is one of the vectors at +1: M f = f
    f = np.concatenate([b.state.v, b.lattice.acceleration(0.0, *b.state)])
    assert np.abs(fl.monodromy @ f - f).max() < 1e-9 * np.abs(f).max()


@pytest.mark.slow
def test_a_growing_pair_of_pairs_is_called_unstable_at_any_step(dimers):
    b = nearest(dimers, 0.7358)
    rho = b.floquet(tolerance=1e-11).multipliers[:2]
    assert np.abs(rho) == pytest.approx(1.02194, abs=2e-5) and np.abs(rho.imag).min() > 0.1
    for steps in (8, 16, 48):
        fl = b.floquet(steps=steps)
        assert fl.verdict == "unstable" and list(fl.unstable) == [0, 1] and "complex" in fl.outcome
        assert np.all(np.abs(fl.multipliers[:2] - rho[:2]) < fl.error[:2])


@pytest.mark.slow
def test_coarse_steps_leave_a_stable_breather_undecided(dimers):
    b = nearest(dimers, 0.25)
    words = [b.floquet(steps=steps).verdict for steps in (6, 8, 10, 20, 32, 48)]
    assert words == ["undecided"] * 3 + ["stable"] * 3
    coarse = b.floquet(steps=8)
    assert "smaller steps would tell" in coarse.outcome and coarse.error.max() > 1e-2
    assert np.all(apart(coarse.multipliers, b.floquet().multipliers) < coarse.error)
    assert b.floquet(steps=12, resolution=1e-6).verdict == "undecided"


@pytest.mark.slow
@pytest.mark.parametrize("amplitude", (0.25, 0.7358))
def test_half_a_period_gives_the_multipliers_of_the_whole(dimers, amplitude):
    b = nearest(dimers, amplitude)
    fl, scale = b.floquet(), np.concatenate([np.ones(N), np.asarray(b.lattice.mass)])
    fine, coarse = (
        np.asarray(
            gx.Flow(jnp.asarray(k), gx.KahanLi8()).derivative(
                b.state, 0.0, float(b.period) / 2, b.lattice
            )[1]
        )
        * scale[:, None]
        / scale
        for k in (64, 32)
    )
    traces, rho, error = reversible_multipliers(fine, coarse)
    away = np.abs(rho - 1) > 1e-4
    assert away.sum() == 2 * N - 4
    assert apart(rho[away], fl.multipliers).max() < 1e-10
    assert apart(1 / rho, rho).max() < 1e-12
    # at +1 the whole period knows half as many digits; the half-traces know all of them
    assert np.abs(fl.multipliers[np.abs(fl.multipliers - 1) < 1e-4] - 1).max() > 1e-9
    assert np.sort(np.abs(traces - 1))[:2].max() < 1e-11
    assert np.all(np.abs(rho - 1)[~away] < 1e-5) and np.all(error[away] < 1e-9)


# other flows --------------------------------------------------------------------------------------------------------


def hopf(t, z, rate):
    """A limit cycle of radius 1 and frequency 1, to which radii tend as exp(-2 rate t)."""
    x, y = z
    slack = rate * (1 - x * x - y * y)
    return jnp.stack([slack * x - y, slack * y + x])


def test_any_vector_field_has_multipliers():
    flow = gx.Flow(400, diffrax.Dopri8(), hopf)
    fl = floquet(flow, jnp.array([1.0, 0.0]), 2 * np.pi, args=jnp.asarray(0.1))
    np.testing.assert_allclose(fl.multipliers, [1, np.exp(-0.4 * np.pi)], rtol=0, atol=1e-11)
    np.testing.assert_allclose(fl.exponents.real, [0, -0.2], rtol=0, atol=1e-11)
    assert np.isnan(fl.krein).all() and np.isnan(fl.defect) and fl.rate is None
    # nothing says that one is at +1 by symmetry, so that it might lie outside
    assert fl.expected == 0 and fl.verdict == "undecided"
    one = floquet(flow, jnp.array([1.0, 0.0]), 2 * np.pi, args=jnp.asarray(0.1), expected=1)
    assert one.expected == 1 and one.verdict == "stable"
    assert floquet(flow, jnp.zeros(2), 2 * np.pi, args=jnp.asarray(-0.1)).verdict == "stable"
    assert floquet(flow, jnp.zeros(2), 2 * np.pi, args=jnp.asarray(0.1)).verdict == "unstable"


# units --------------------------------------------------------------------------------------------------------------


def test_lanes_are_not_taken_for_one_lattice():
    lanes = jax.vmap(lambda r: gx.scenes.dimer(4, r, precompression=1.0), out_axes=-1)(
        jnp.array([0.4, 0.7])
    )
    with refused("lattice: expected one Lattice, got a batch with lanes"):
        floquet(lanes, rest(lanes), 1.0)


def test_where_a_free_lattice_stands_does_not_tell_whether_its_state_returns():
    chain = gx.scenes.fput(4, beta=1.0, boundary="free")
    u = np.random.default_rng(0).uniform(-1, 1, 4)
    for shift in (0.0, 1e3):
        with refused("state: expected one that returns"):
            floquet(chain, gx.State(u + shift, np.zeros(4)), 3.0, steps=64)


def test_a_state_that_is_no_orbit_is_refused(dimers):
    b = nearest(dimers, 0.25)
    with refused("state: expected one that returns after the period, got a gap of"):
        floquet(b.lattice, b.state, 1.1 * float(b.period))
    with refused("state: expected one that returns"):
        floquet(
            gx.Flow(400, diffrax.Dopri8(), hopf),
            jnp.array([0.4, 0.0]),
            2 * np.pi,
            args=jnp.asarray(0.1),
        )
    # not quite an orbit: the multipliers are those of an orbit near by, within errors that say so
    other = gx.State(1.003 * b.state.u, b.state.v)
    fl, exact = floquet(b.lattice, other, float(b.period)), b.floquet().multipliers
    assert np.all(apart(fl.multipliers, exact) <= fl.error) and fl.error.min() > 1e-6


# against orbits and multipliers that granjax did not compute ----------------------------------------------------------


@pytest.mark.study
@pytest.mark.parametrize(
    "name",
    [
        "forced_opening",
        "forced_branch",
        pytest.param("hard_pair", marks=pytest.mark.slow),
        pytest.param("forced_branch_upper", marks=pytest.mark.slow),
        pytest.param("defect", marks=pytest.mark.slow),
        pytest.param("family", marks=pytest.mark.slow),
        pytest.param("light_centred", marks=pytest.mark.slow),
    ],
)
def test_errors_cover_multipliers_of_dop853(name):
    known, period = reference(name), 2 * np.pi / reference(name).omega
    rng = np.random.default_rng(0)
    for steps, off in ((None, 0.0), (64, 0.0), (64, 1e-4)):
        u, v = (
            x + off * np.abs(known.u).max() * rng.normal(size=len(x)) for x in (known.u, known.v)
        )
        fl = floquet(known.lattice, gx.State(u, v), period, steps=steps)
        assert np.all(
            apart(fl.multipliers, known.multipliers) <= fl.error + known.multiplier_errors.max()
        )
    # nor are they beyond belief
    assert np.median(floquet(known.lattice, gx.State(known.u, known.v), period).error) < 1e-4


@pytest.mark.study
@pytest.mark.parametrize(
    "name, steps",
    [("forced_opening", 24), ("defect", 40), ("light_centred", 48), ("light_centred", None)],
)
def test_multipliers_of_an_orbit_from_few_steps_know_that_it_is_off(name, steps):
    known = reference(name)
    guess, period = gx.State(jnp.asarray(known.u), jnp.asarray(known.v)), 2 * np.pi / known.omega
    if np.abs(known.v).max() > 0:
        orbit = forced_orbit(known.lattice, period, guess, steps=steps)
    else:
        orbit = gx.breathers.breather(known.lattice, known.omega, guess, steps=steps, check=False)
    fl = orbit.floquet()
    away = apart(fl.multipliers, known.multipliers)
    assert np.all(away <= fl.error + known.multiplier_errors.max())


# damped and driven --------------------------------------------------------------------------------------------------


def shaken(force, omega, damping, steps=64):
    """The orbit to which four beads between walls settle, the first of them driven."""
    drive, rate = (
        gx.Drive(gx.Harmonic(jnp.asarray(force), jnp.asarray(omega)), 0),
        jnp.asarray(damping),
    )
    chain = gx.Lattice(
        1.0, (gx.Bond(gx.Shift(1, "fixed"), gx.Hertz(1.0, 1.0)), gx.Damping(rate), drive), sites=4
    )
    return forced_orbit(chain, 2 * np.pi / omega, transient=60, steps=steps)


def least_overlap(orbit):
    return min(
        float(gx.measures.overlap(orbit.lattice, gx.State(u, 0 * u)).min())
        for u in orbit.run(64).us
    )


@pytest.mark.study
@pytest.mark.parametrize(
    "force, omega, damping, opens, modulus",
    [(0.3, 1.5, 0.2, False, 0.7086), (1.5, 1.5, 0.2, True, 0.8306), (2.0, 1.2, 0.1, True, 1.0343)],
)
def test_multipliers_of_a_damped_driven_orbit(force, omega, damping, opens, modulus):
    orbit = shaken(force, omega, damping, 256)
    assert (least_overlap(orbit) < -0.5) == opens
    fl = orbit.floquet()
    product = np.exp(-damping * 2 * np.pi / omega)
    assert unpaired(fl, product) < 1e-8 and fl.defect < 1e-11 and fl.expected == 0
    assert fl.verdict == ("unstable" if modulus > 1 else "stable")
    assert np.abs(fl.multipliers[0]) == pytest.approx(modulus, abs=1e-4)
    if modulus > 1:
        coarse = orbit.floquet(steps=8)
        assert coarse.verdict == "undecided" and coarse.error[0] > modulus - 1


# contacts that open -------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def opened(dimers):
    """Orbits of three chains whose contacts open, multipliers at numbers of steps and at sixteen times as many."""
    walls = gx.scenes.dimer(5, ratio=0.5, precompression=1.0, boundary="fixed")
    family = gx.breathers.family(walls, amplitude=1.3, stability=False)
    orbits = [nearest(dimers, a) for a in (0.86, 0.9, 0.93)] + [
        nearest(family, a) for a in (0.9, 1.25)
    ]
    assert max(gx.measures.overlap(b.lattice, b.state).min() for b in orbits) < -0.01
    orbits += [shaken(1.5, 1.5, 0.2), shaken(2.0, 1.2, 0.1)]
    assert max(map(least_overlap, orbits[-2:])) < -0.5
    return [
        (b.floquet(steps=steps), b.floquet(steps=16 * steps).multipliers, b.lattice.mass)
        for b in orbits
        for steps in (32, 48, 64, 96, 128, 192, 256, 384)
    ]


@pytest.mark.study
def test_the_step_error_bounds_the_multipliers_where_contacts_open(opened):
    for fl, exact, mass in opened:
        # Bauer, Fike: |d rho| <= |dM|/|y^H x| to first order, of M without units
        scale = weights(np.broadcast_to(mass, len(fl.vectors) // 2), fl.period)
        condition = np.linalg.norm(np.linalg.inv(scale[:, None] * fl.vectors), axis=1)
        bound = condition * len(fl.vectors) * fl.step_error
        assert np.all(apart(fl.multipliers, exact) <= bound)


@pytest.mark.study
def test_the_error_covers_the_true_one_where_contacts_open(opened):
    for fl, exact, _ in opened:
        assert np.all(apart(fl.multipliers, exact) <= fl.error)


# words --------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "rho, error, expected, conserves, verdict, words",
    [
        ([1.1, 1 / 1.1], 1e-6, 0, True, "unstable", "A real multiplier of modulus 1.1 "),
        ([-1.1, -1 / 1.1], 1e-6, 0, True, "unstable", "period doubling"),
        ([1.1j, -1.1j], 1e-6, 0, True, "unstable", "A complex multiplier"),
        ([1 + 1e-3, 1 - 1e-3], 2e-3, 0, True, "undecided", "smaller steps would tell"),
        ([1 + 1e-3, 1 - 1e-3], 2e-5, 2, True, "stable", "2 multipliers at +1"),
        ([1j, -1j, 1 + 1e-3, 1 - 1e-3], 1e-9, 2, True, "stable", "on the unit circle"),
        ([1j, -1j, 1 + 1e-3, 1 - 1e-3], 1e-9, 0, True, "unstable", "A real multiplier"),
        ([1j, -1j], 1e-3, 0, True, "undecided", "known to 1.0e-03"),
        ([0.9, 0.5], 1e-3, 0, False, "stable", "inside the unit circle, by 9.9e-02"),
        ([0.9999, 0.5], 1e-3, 0, False, "undecided", "smaller steps"),
        ([1.0, 0.5], 1e-3, 1, False, "stable", "inside"),
    ],
)
def test_the_word_follows_from_the_error(rho, error, expected, conserves, verdict, words):
    rho = np.asarray(rho, complex)
    numbers = rho, np.full(len(rho), error), expected, conserves
    assert decide(*numbers) == verdict and words in sentence(verdict, *numbers)


def test_no_time_and_no_steps_are_refused():
    chain, state, _ = inverted(4)
    with refused("period: expected a time above zero, got 0"):
        floquet(chain, state, 0)
    with refused("steps: expected a whole number not below 1, got -1"):
        floquet(chain, state, 3.0, steps=-1)


# derivatives --------------------------------------------------------------------------------------------------------


def test_multipliers_are_differentiable_in_the_lattice_and_the_period():
    # at rest under a modulated stiffness, a system of Mathieu's kind
    flow = gx.Flow(24, gx.KahanLi8())

    @jax.jit
    def largest(depth, stretch):
        wave = gx.Harmonic(depth, 2.0 / stretch, mean=1.0)
        chain = gx.Lattice(
            1.0,
            (
                gx.Bond(gx.Shift(1, "free"), gx.Linear(0.3)),
                gx.Modulated(gx.OnSite(gx.Linear(1.0)), wave),
            ),
            sites=3,
        )
        rho = multipliers(flow, rest(chain), 0.0, jnp.pi * stretch, chain)
        return jnp.abs(rho[jnp.argmax(jnp.abs(rho))])

    at = 0.3, 1.0
    assert largest(*at) > 1.2
    slopes = jax.jit(jax.jacfwd(largest, (0, 1)))(*at)
    h = 1e-4
    for i, slope in enumerate(slopes):
        a, b, c, d = (
            largest(*(x + k * h * (i == j) for j, x in enumerate(at))) for k in (-2, -1, 1, 2)
        )
        assert abs(slope - (a - 8 * b + 8 * c - d) / (12 * h)) < 1e-9 * abs(slope) + 1e-9
        assert abs(slope) > 0.1


@pytest.mark.slow
def test_rest_between_loaded_contacts_needs_no_exact_balance():
    """Forces of neighbours cancel to rounding alone, whatever the order in which a program adds: it is rest."""
    mass = np.where(np.arange(9) % 2 == 0, 1.0, 2.9)
    lattice = gx.Lattice(mass, gx.Bond(gx.Shift(1, "free"), gx.Hertz(1.3, 1.0)))
    omega = float(gx.linear.normal_modes(lattice).omega[4])
    for size in (0.0, 1e-18):
        state = gx.State(jnp.full(9, size), jnp.zeros(9))
        assert floquet(lattice, state, 2 * np.pi / omega, steps=24).expected == 2


RATE, DRIVEN = 0.1, 0.9
OPENED = 0.5512  # the amplitude at which the contact opens by a hundredth of its compression


def oscillator(amplitude, x, exponent):
    """(orbit, trace of M) of u'' + 0.1 u' + [1 + u]_+^p - 1 = F cos 0.9 t, by SciPy and its variational equations."""

    def field(t, y):
        s = max(1 + y[0], 0.0)
        a = 1 - s**exponent - RATE * y[1] + amplitude * np.cos(DRIVEN * t)
        M = y[2:].reshape(2, 2)
        return np.concatenate(
            [[y[1], a], M[1], -exponent * s ** (exponent - 1) * M[0] - RATE * M[1]]
        )

    period = 2 * np.pi / DRIVEN
    for _ in range(12):
        y = solve_ivp(
            field,
            (0, period),
            np.append(x, np.eye(2)),
            "DOP853",
            rtol=1e-12,
            atol=1e-13,
            max_step=0.03,
        ).y
        M = y[2:, -1].reshape(2, 2)
        change = np.linalg.solve(np.eye(2) - M, y[:2, -1] - x)
        x = x + change
        if np.abs(change).max() < 1e-12:
            return x, np.trace(M), y[0].min()
    raise AssertionError("no orbit")


@pytest.mark.slow
def test_the_error_of_a_multipliers_derivative_covers_the_truth_where_a_contact_opens():
    period, h = 2 * np.pi / DRIVEN, 1e-5
    x, _, least = oscillator(OPENED, np.array([0.928, 0.196]), 1.5)
    assert -1.011 < least < -1.009
    low, high = (oscillator(OPENED + sign * h, x, 1.5)[1] for sign in (-1, 1))
    truth = (high - low) / (2 * h)

    def trace(amplitude, step):
        steps = 2 * jnp.round(period / step / 2).astype(int)
        drives = [gx.Drive(gx.Harmonic(amplitude, DRIVEN), site) for site in (0, 1)]
        scene = gx.Lattice(1.0, (gx.OnSite(gx.Hertz(1.0, 1.0)), gx.Damping(RATE), *drives), sites=2)
        guess = gx.State(jnp.full(2, x[0]), jnp.full(2, x[1]))
        found = gx.forced.forced_orbit(
            scene, period, guess, steps=steps, solver=gx.KahanLi8(), throw=False
        )
        return (
            jnp.sum(gx.floquet.multipliers(gx.Flow(steps), found.state, 0.0, period, scene)).real
            / 2
        )

    errors = []
    for steps in (24, 48, 96, 192):
        found = gx.derivative(trace, OPENED, period / steps)
        assert abs(found.value - truth) < found.error
        errors.append(float(found.error))
    assert min(errors) < 0.5 * truth
    # where contacts stay closed the same is known to many digits
    x = oscillator(0.3, np.array([0.436, 0.060]), 1.5)[0]
    low, high = (oscillator(0.3 + sign * 1e-4, x, 1.5)[1] for sign in (-1, 1))
    found = gx.derivative(trace, 0.3, period / 96)
    assert found.relative < 1e-6 and found.value == pytest.approx((high - low) / 2e-4, rel=1e-5)


@pytest.mark.slow
def test_a_breather_s_multiplier_has_a_derivative_with_an_error():
    omega = 1.4
    period = 2 * np.pi / omega
    seed = gx.breathers.guesses.single_site(gx.scenes.klein_gordon(5, 0.02), omega, 2)

    def trace(coupling, step):
        steps = 2 * jnp.round(period / step / 2).astype(int)
        chain = gx.scenes.klein_gordon(5, coupling)
        found = gx.breathers.breather(chain, omega, seed, steps=steps, throw=False)
        return jnp.sum(gx.floquet.multipliers(gx.Flow(steps), found.state, 0.0, period, chain)).real

    def by_scipy(coupling):
        K = coupling * (np.diag([1.0, 2.0, 2.0, 2.0, 1.0]) - np.eye(5, k=1) - np.eye(5, k=-1))

        def field(t, y):
            u, M = y[:5], y[10:].reshape(10, -1)
            a = -K @ u - u - u**3
            return np.concatenate(
                [y[5:10], a, M[5:].ravel(), (-(K + np.diag(1 + 3 * u**2)) @ M[:5]).ravel()]
            )

        def end(x, time, tangents):
            start = np.concatenate([x, np.zeros(5), tangents.ravel()])
            return ended(field, time, start)

        x = fsolve(
            lambda x: end(x, period / 2, np.zeros((10, 0)))[5:10], np.asarray(seed.u), xtol=1e-12
        )
        return np.trace(end(x, period, np.eye(10))[10:].reshape(10, 10))

    found = gx.derivative(trace, 0.02, period / 64)
    assert found.relative < 1e-6
    truth = (by_scipy(0.0203) - by_scipy(0.0197)) / 6e-4
    assert float(found.value) == pytest.approx(truth, rel=1e-4)
