"""The nonlinear Schroedinger equation of periodic chains: coefficients, solitons, breathers that they seed."""

import jax
import jax.numpy as jnp
import numpy as np
import scipy.optimize
from numpy.testing import assert_allclose
from pytest import approx, mark
from refusals import refused

from granjax.theory import nls
from granjax.theory.nls import (
    bright,
    bright_profile,
    coefficients,
    dark,
    dark_profile,
    growth_rate,
)

# Hertz with A = d0 = 1
HERTZ = (1.5, 0.375, -0.0625)
# light mass last, so that it lies between bonds 0 and 1, which belong to one cell
DIMER = np.array([2.957949, 1.0])
CELL = (
    np.array([1.0, 2.0, 1.4]),
    np.array([1.5, 1.1, 2.2]),
    np.array([0.3, -0.5, 0.4]),
    np.array([0.2, 0.1, -0.3]),
)


def power_law(p):
    """Taylor coefficients of [1 + sign(p) y]^p."""
    return abs(p), p * (p - 1) / 2, abs(p) * (p - 1) * (p - 2) / 6


# -------------------------------------------------------------------------------------------------------- coefficients


@mark.parametrize("p, expected", [(1.5, -0.459279), (0.5, 0.0883883), (-3.0, -10.3923048)])
def test_B_of_power_laws(p, expected):
    K2, K3, K4 = power_law(p)
    assert_allclose(nls.B(K2, K3, K4), expected, rtol=1e-6)
    assert_allclose(nls.B(K2, K3, K4), -(p**3) * (p - 1) / (2 * abs(p) ** 1.5), rtol=1e-12)
    found = coefficients(1.7, K2, K3, K4, np.pi)
    assert_allclose(found.nu3, nls.B(K2, K3, K4, 1.7), rtol=1e-12)
    assert bool(found.focusing) == (p == 0.5)


@mark.parametrize("k", [0.2, 2.9])
def test_monomer_in_closed_form(k):
    m = 1.3
    K2 = 1.5
    K3 = 0.4
    K4 = 0.2
    lam = lambda q: 4 * np.sin(q / 2) ** 2
    omega = np.sqrt(K2 * lam(k) / m)
    speed = np.sqrt(K2 / m) * np.cos(k / 2)
    Y2 = -lam(2 * k) * K3 / (K2 * lam(2 * k) - 4 * m * omega**2)
    Y0 = -2 * K3 / (K2 - m * speed**2)
    nu3 = lam(k) / (2 * omega * m) * (3 * K4 + 2 * K3 * (Y0 + Y2))
    found = coefficients(m, K2, K3, K4, k)
    assert_allclose(found.omega, omega, rtol=1e-13)
    assert_allclose(found.group_velocity, speed, rtol=1e-12)
    assert_allclose(found.nu2, omega / 8, rtol=1e-12)
    assert_allclose(found.harmonic_strain[0], Y2, rtol=1e-11)
    assert_allclose(found.mean_strain[0], Y0, rtol=1e-11)
    assert_allclose(found.nu3, nu3, rtol=1e-10)


@mark.parametrize(
    "k, folded, branch, constraint",
    [(np.pi, 0.0, 1, "force"), (2.0, 4.0, 1, "length"), (1.0, 2.0, 0, "length")],
)
def test_dimer_of_equal_masses_is_the_monomer(k, folded, branch, constraint):
    one = coefficients(1.0, *HERTZ, k, constraint=constraint)
    two = coefficients([1.0, 1.0], *HERTZ, folded, branch, constraint)
    assert_allclose(two.omega, one.omega, rtol=1e-13)
    # k per cell, cells of two sites
    speed = abs(float(one.group_velocity))
    assert 2 * abs(two.group_velocity) == approx(speed, rel=1e-12, abs=1e-12)
    assert_allclose(4 * two.nu2, one.nu2, rtol=1e-11)
    assert_allclose(two.nu3, one.nu3, rtol=1e-11)
    assert_allclose(two.nu3_force, one.nu3_force, rtol=1e-11)
    lanes = jax.tree.map(lambda *x: np.stack(x), two, two).to_xarray()
    assert lanes.mode_real.dims == ("lane", "site") and lanes.omega.dims == ("lane",)


def test_signs_in_the_hertz_dimer():
    top, bottom = (coefficients(DIMER, *HERTZ, np.pi, branch) for branch in (0, 1))
    assert_allclose(top.omega, 1.0070830, rtol=1e-7)
    assert_allclose(bottom.omega, 1.7320508, rtol=1e-7)
    assert not top.focusing and "dark" in top.outcome
    assert bottom.focusing and "bright" in bottom.outcome
    # light beads between heavy ones at rest: (3 K4 - 4 K3^2/K2)/(omega m)
    assert_allclose(bottom.nu3, (3 * -0.0625 - 4 * 0.375**2 / 1.5) / np.sqrt(3), rtol=1e-11)


def test_dispersion_derivatives_by_finite_differences():
    k = 1.3
    h = 1e-3
    near = [coefficients(*CELL, k + step * h, 1) for step in range(-2, 3)]
    at = jax.tree.map(lambda *x: np.stack(x), *near)
    first = np.array([1, -8, 0, 8, -1]) / (12 * h)
    second = np.array([-1, 16, -30, 16, -1]) / (12 * h * h)
    assert_allclose(at.group_velocity[2], first @ at.omega, rtol=1e-10)
    assert_allclose(at.nu2[2], -second @ at.omega / 2, rtol=1e-7)
    assert_allclose(at.strain_slope[2], first @ at.strain, rtol=1e-9, atol=1e-10)
    assert len(set(np.asarray(at.bond))) == 1
    assert_allclose(np.mean(np.abs(at.strain[2]) ** 2), 1, rtol=1e-14)
    assert abs(np.imag(at.strain[2][at.bond[2]])) < 1e-16


@mark.slow
def test_first_and_second_derivative_in_the_masses():
    """Of three equal masses at k = pi, where the other branches touch."""
    mass = jnp.ones(3)
    way = jnp.array([0.3, -0.1, 0.4])
    h = 1e-4
    nu3 = lambda mass: coefficients(mass, *HERTZ, np.pi, 2).nu3
    below, here, above = (float(nu3(mass + x * h * way)) for x in (-1, 0, 1))
    assert_allclose(jax.jit(jax.grad(nu3))(mass) @ way, (above - below) / (2 * h), rtol=1e-6)
    along = lambda m: jax.jvp(nu3, (m,), (way,))[1]
    second = jax.jvp(along, (mass,), (way,))[1]
    assert_allclose(second, (above - 2 * here + below) / h**2, rtol=1e-5)


@mark.slow
@mark.parametrize("sites, k", [(3, np.pi), (6, 0.0)])
def test_derivatives_in_the_masses_where_other_branches_touch(sites, k):
    # equal masses: the other branches touch in pairs, that of largest frequency is simple
    def nu2(mass):
        return coefficients(mass, 1.0, 0.3, 0.2, k, sites - 1).nu2

    mass = jnp.ones(sites)
    way = np.random.default_rng(1).normal(size=sites)
    h = 3e-5
    difference = (nu2(mass + h * way) - nu2(mass - h * way)) / (2 * h)
    assert_allclose(jax.jit(jax.grad(nu2))(mass) @ way, difference, rtol=1e-6)


# ------------------------------------------------------------------------------- against periodic orbits of small rings


def wave_on_ring(mass, K, p, k, a, guess, constraint):
    """Frequency and strains of the wave u_j(n, t) = u_j(k n + omega t) with amplitude Y = a.

    Harmonic balance on 16 phases, bonds with force K_j [(1 + y)^p - 1]. Unknown: u_j, omega, and the mean strain where
    it is the mean force that is zero.
    """
    points = 16
    P = len(mass)
    theta = 2 * np.pi * np.arange(points) / points
    number = np.fft.fftfreq(points, 1 / points)
    shift = round(k / (2 * np.pi) * points)
    phase = np.exp(-1j * theta) / points

    def split(z):
        return z[: P * points].reshape(P, points), z[-2], z[-1]

    def strains(z):
        u, _, stretch = split(z)
        y = u - np.concatenate([u[1:], np.roll(u[:1], -shift, axis=1)])
        y[-1] += stretch
        return y

    def residual(z):
        u, omega, stretch = split(z)
        y = strains(z)
        F = K[:, None] * ((1 + y) ** p - 1)
        acceleration = np.real(np.fft.ifft(-((omega * number) ** 2) * np.fft.fft(u)))
        before = np.concatenate([np.roll(F[-1:], shift, axis=1), F[:-1]])
        held = stretch if constraint == "length" else F[0].mean()
        first = y[guess.bond] @ phase - a * np.real(guess.strain[guess.bond])
        balance = (mass[:, None] * acceleration - before + F).ravel()
        return np.concatenate([balance, [u[0].mean(), first.real, first.imag, held]])

    start = 2 * a * np.real(np.asarray(guess.mode)[:, None] * np.exp(1j * theta))
    z = np.concatenate([start.ravel(), [float(guess.omega), 0.0]])
    z = scipy.optimize.least_squares(residual, z, method="lm", xtol=1e-15, ftol=1e-15, gtol=1e-15).x
    assert np.abs(residual(z)).max() < 1e-12
    return z[-2], strains(z)


ONE = np.ones(1)
RINGS = {
    "monomer, k = pi/2, length": (ONE, ONE, 2.5, np.pi / 2, 0, "length"),
    "monomer, k = pi, force": (ONE, ONE, 1.5, np.pi, 0, "force"),
    "dimer, optical bottom, length": (DIMER, np.ones(2), 1.5, np.pi, 1, "length"),
    "dimer, acoustic top, force": (DIMER, np.ones(2), 1.5, np.pi, 0, "force"),
    "cell of three, k = 3 pi/4, length": (CELL[0], CELL[1], 1.5, 3 * np.pi / 4, 1, "length"),
}


def predicted(mass, K, p, k, branch, constraint):
    return coefficients(mass, *(K * c for c in power_law(p)), k, branch, constraint)


@mark.slow
@mark.parametrize("ring", RINGS.values(), ids=RINGS.keys())
def test_frequency_of_waves_on_a_ring(ring):
    *waves, _, constraint = ring
    found = predicted(*ring)
    small = 0.003
    large = 0.006
    omega = [wave_on_ring(*waves, a, found, constraint)[0] for a in (small, large)]
    slope = (omega[1] - omega[0]) / (large**2 - small**2)
    assert_allclose(slope, found.nu3, rtol=1e-3)


def test_second_harmonic_and_mean_strain_on_a_ring():
    ring = RINGS["cell of three, k = 3 pi/4, length"]
    *waves, _, constraint = ring
    found = predicted(*ring)
    a = 0.002
    y = np.fft.fft(wave_on_ring(*waves, a, found, constraint)[1], axis=1) / 16
    assert_allclose(y[:, 1] / a, found.strain, atol=1e-4)
    assert_allclose(y[:, 2] / a**2, found.harmonic_strain, atol=1e-4)
    assert_allclose(y[:, 0] / a**2, found.mean_strain, atol=1e-4)


def test_hertz_has_no_shift_at_a_quarter_of_the_zone():
    """At fixed length nu3 = p (p - 1) (2p - 3)/(2 omega) there."""
    assert abs(predicted(ONE, ONE, 1.5, np.pi / 2, 0, "length").nu3) < 1e-15
    found = predicted(ONE, ONE, 2.5, np.pi / 2, 0, "length")
    assert_allclose(found.nu3, 2.5 * 1.5 * 2 / (2 * np.sqrt(5)), rtol=1e-12)


# ------------------------------------------------------------------------------------------------------------ resonance


def test_a_resonant_second_harmonic_is_said():
    # the second harmonic of k = pi, acoustic, meets the top of the optical branch at k = 0
    K2 = np.array([1.5, 1.5 / 3])
    found = coefficients([1.0, 1.0], K2, [0.3, 0.1], [0.1, 0.0], np.pi, 0)
    assert_allclose(4 * found.omega**2, 2 * K2.sum(), rtol=1e-12)
    assert found.resonant and found.nu3 == np.inf and "second harmonic" in found.outcome
    with refused("second harmonic"):
        bright_profile(found, 0.9, 10)


def test_a_resonance_that_is_not_fed_does_no_harm():
    # masses 1:3: 4 omega^2 of the acoustic top is that of the optical top, but by symmetry no force drives it
    found = coefficients([3.0, 1.0], *HERTZ, np.pi, 0)
    assert_allclose(4 * found.omega**2, 4.0, rtol=1e-12)
    near = coefficients([3.1, 1.0], *HERTZ, np.pi, 0)
    assert not found.resonant
    assert_allclose(found.nu3 * np.sqrt(3.0), float(near.nu3) * np.sqrt(3.1), rtol=1e-10)


# --------------------------------------------------------------------------------------------------- solitons and seeds


def residual(Y, X, T, nu2, nu3):
    """i Y_T + nu2 Y_XX + nu3 |Y|^2 Y by derivatives of the real and the imaginary part."""
    parts = lambda X, T: jnp.stack([jnp.real(Y(X, T)), jnp.imag(Y(X, T))])
    slope_T = jax.jacfwd(parts, 1)(X, T)
    bend_X = jax.jacfwd(jax.jacfwd(parts))(X, T)
    join = lambda p: p[0] + 1j * p[1]
    return 1j * join(slope_T) + nu2 * join(bend_X) + nu3 * jnp.abs(Y(X, T)) ** 2 * Y(X, T)


@mark.slow
@mark.parametrize("kind, sign", [("bright", 1), ("dark", -1)])
def test_solitons_solve_the_envelope_equation(kind, sign):
    nu3 = sign * 0.7
    kappa = sign * 0.2
    nu2 = 0.3
    Y = lambda X, T: getattr(nls, kind)(X, T, kappa, nu2, nu3, 0.4)
    left = jax.jit(jax.vmap(lambda X: residual(Y, X, 0.8, nu2, nu3)))(jnp.array([-3.0, 0.4, 1.7]))
    assert np.abs(left).max() < 1e-14
    assert abs(Y(0.9, 1.3)) > 0.1


def test_bright_tail_neither_overflows_nor_is_nan():
    shape = lambda X: jnp.real(bright(X, 0.0, 1.0, 1.0, 2.0))
    value, slope = jax.jit(jax.vmap(jax.value_and_grad(shape)))(jnp.array([40.0, 2000.0]))
    assert_allclose(value, [2 * np.exp(-40.0), 0], rtol=1e-12)
    assert_allclose(slope, -value, rtol=1e-12)


def test_growth_rate_is_that_of_the_linearised_equation():
    nu2 = -0.3
    nu3 = -0.7
    a = 0.6
    Q = np.linspace(0.0, 2.0, 9)
    # w = x + i y about a exp(i nu3 a^2 T): x' = nu2 Q^2 y, y' = (2 nu3 a^2 - nu2 Q^2) x
    matrices = [[[0, nu2 * q * q], [2 * nu3 * a * a - nu2 * q * q, 0]] for q in Q]
    expected = [np.linalg.eigvals(np.array(matrix)).real.max() for matrix in matrices]
    found = growth_rate(Q, a, nu2, nu3)
    assert_allclose(found, expected, atol=1e-12)
    assert (found > 0).any() and found[0] == 0 and found[-1] == 0
    assert_allclose(growth_rate(np.sqrt(nu3 / nu2) * a, a, nu2, nu3), -nu3 * a * a)
    assert (growth_rate(Q, a, -nu2, nu3) == 0).all()
    assert jax.jit(jax.grad(lambda a: growth_rate(2.0, a, nu2, nu3)))(a) == 0


def test_dark_profile_of_the_monomer():
    found = coefficients(1.0, *HERTZ, np.pi)
    omega_0 = np.sqrt(6)
    profile = dark_profile(found, 0.99 * omega_0, 82)
    assert_allclose(2 * profile.amplitude, 0.461880, rtol=1e-5)
    # y_n = 2 (-1)^n (kappa/B)^{1/2} tanh[(-kappa/(2 nu2))^{1/2} (n - x0)] and the mean strain
    kappa = -0.01 * omega_0
    n = np.arange(82)
    envelope = np.sqrt(kappa / float(nls.B(*HERTZ))) * np.tanh(
        np.sqrt(-kappa / (2 * float(found.nu2))) * (n - 40)
    )
    mean = profile.mean_strain
    u = profile.displacement
    assert_allclose(mean, -2 * 0.375 / 1.5 * envelope**2, atol=1e-14)
    assert_allclose(profile.strain - mean, 2 * (-1.0) ** n * envelope, atol=1e-14)
    assert_allclose(u[:-1] - u[1:], profile.strain[:-1], atol=1e-14)
    # the same chain in cells of two
    folded = coefficients([1.0, 1.0], *HERTZ, 0.0, 1)
    again = dark_profile(folded, 0.99 * omega_0, 41)
    assert_allclose(np.abs(again.strain), np.abs(profile.strain), atol=1e-12)


def test_dark_background_at_fixed_length():
    found = coefficients(1.0, *HERTZ, np.pi, constraint="length")
    kappa = -0.01 * np.sqrt(6)
    B = -0.459279327
    profile = dark_profile(found, 0.99 * np.sqrt(6), 82)
    square = kappa * np.sqrt(1.5) / (3 * -0.0625)
    assert_allclose(profile.amplitude**2, square, rtol=1e-11)
    width = np.sqrt(-B * square / (2 * np.sqrt(1.5) / 4))
    assert_allclose(profile.inverse_width, width, rtol=1e-8)
    assert abs(profile.mean_strain[0]) < 1e-12
    assert_allclose(profile.mean_strain.max(), 2 * 0.375 / 1.5 * square, rtol=1e-9)
    Y = dark(0.8, 0.0, kappa, found.nu2, found.nu3, nu3_force=found.nu3_force)
    assert_allclose(Y, float(profile.amplitude) * np.tanh(0.8 * width), rtol=1e-8)


def test_bright_profile_approaches_the_breather():
    # u(0), u(1), u(2) of the light-centred breathers, N = 121, computed by Newton's method
    exact = {0.9850: (0.7784533, 0.0526330, -0.4492773), 0.9900: (0.6377287, 0.0398740, -0.4638610)}
    found = coefficients(DIMER, *HERTZ, np.pi, 1)
    errors = []
    for ratio, u in exact.items():
        profile = bright_profile(found, ratio * np.sqrt(3), 60, centre=59)
        errors.append(np.abs(np.array(profile.strain[59:61]) + np.diff(u)).max() / u[0])
    assert errors[1] < 0.06 and errors[1] < 0.75 * errors[0]
    # even about the bead in what oscillates, odd in the mean
    mean = profile.mean_strain
    swing = profile.strain - mean
    assert_allclose(swing[19:59], -swing[59:99][::-1], atol=1e-12)
    assert_allclose(mean[19:59], mean[59:99][::-1], atol=1e-12)


@mark.slow
def test_profiles_at_pi_in_float32():
    # the nearest number to pi has a sine of 8.7e-8
    short = coefficients(*jnp.array([1.0, 0.5, -0.125, 0.0625, np.pi], jnp.float32))
    assert short.k.dtype == jnp.float32 and abs(np.sin(short.k)) > 8e-8
    profile = bright_profile(short, jnp.float32(1.01 * 2**0.5), 40)
    want = bright_profile(coefficients(1.0, 0.5, -0.125, 0.0625, np.pi), 1.01 * 2**0.5, 40)
    assert_allclose(profile.strain, want.strain, atol=1e-5)


def test_profile_is_a_superposition_of_modes():
    # a packet at k = 0, without second order: sum over q of the sech's spectrum times s(q) exp(i q n); error O(width^2)
    mass, K2 = CELL[:2]
    found = coefficients(mass, K2, 0.0, -1.0, 0.0, 2)
    s = np.real(found.strain)
    w = np.imag(found.strain_slope)
    place = np.arange(3) / 3
    shift = np.sum(s * (w - s * place)) / np.sum(s**2)
    cells = 80
    centre = 120.3
    errors = []
    for kappa in (-0.002, -0.0005):
        profile = bright_profile(found, float(found.omega) + kappa, cells, centre)
        a = float(profile.amplitude)
        b = float(profile.inverse_width)
        q = np.linspace(-10 * b, 10 * b, 101)
        modes = np.array([coefficients(mass, K2, 0.0, -1.0, k, 2).strain for k in q])
        spectrum = a / (2 * b) / np.cosh(np.pi * q / (2 * b)) * (q[1] - q[0])
        place_of_cell = np.arange(cells) - (centre - 0.5) / 3 - shift
        packet = np.exp(1j * np.outer(place_of_cell, q)) @ (spectrum[:, None] * modes)
        errors.append(np.abs(profile.strain - 2 * np.real(packet).ravel()).max() / a)
    assert errors[0] < 0.02 and errors[1] < errors[0] / 3.5


# ------------------------------------------------------------------------------------------------------------- refusals


def monomer(k):
    return coefficients(1.0, *HERTZ, k)


@mark.parametrize(
    "call, said",
    [
        (lambda: bright_profile(monomer(np.pi), 2.4, 40), "nu3 < 0 with nu2 > 0: only dark"),
        (lambda: dark_profile(monomer(np.pi), 2.5, 40), "lowers the frequency"),
        (lambda: dark(0.0, 0.0, 1.0, 1.0, 1.0), "only bright"),
        (lambda: dark_profile(monomer(1.0), 1.0, 40), "stands still"),
        (lambda: monomer(0.0), "omega = 0"),
        (lambda: coefficients([1.0, 1.0], *HERTZ, np.pi, 1), "touches another"),
        (lambda: coefficients(1.0, 0.0, 0.0, 0.0, np.pi), "precompression"),
        (lambda: monomer([1.0, 2.0]), "jax.vmap"),
    ],
)
def test_what_has_no_envelope_equation_or_soliton_is_refused(call, said):
    with refused(said):
        call()


def test_traced_wave_numbers_that_have_no_equation_give_nan():
    found = jax.vmap(monomer)(jnp.array([0.0, np.pi]))
    assert np.isnan(found.nu3[0])
    assert_allclose(found.nu3[1], -0.459279, rtol=1e-6)
