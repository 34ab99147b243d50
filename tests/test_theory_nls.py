"""The nonlinear Schroedinger equation of periodic chains: coefficients, solitons, breathers that they seed."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate
import scipy.optimize
from cases import ended
from refusals import refused

import granjax as gx
from granjax.theory import nls

# Hertz with A = d0 = 1
HERTZ = (1.5, 0.375, -0.0625)
LIGHT, HEAVY = 1.0, 2.957949
# light mass last, so that it lies between bonds 0 and 1, which belong to one cell
DIMER = np.array([HEAVY, LIGHT])
CELL = (
    np.array([1.0, 2.0, 1.4]),
    np.array([1.5, 1.1, 2.2]),
    np.array([0.3, -0.5, 0.4]),
    np.array([0.2, 0.1, -0.3]),
)


def power_law(p):
    """Taylor coefficients of [1 + sign(p) y]^p."""
    return abs(p), p * (p - 1) / 2, abs(p) * (p - 1) * (p - 2) / 6


def test_the_coefficients_are_those_of_the_laws():
    assert power_law(1.5) == HERTZ
    np.testing.assert_allclose(
        gx.laws.taylor(gx.PowerLaw(1.0, -3.0, 1.0)), power_law(-3.0), rtol=1e-14
    )


# -------------------------------------------------------------------------------------------------------- coefficients


@pytest.mark.parametrize("p, expected", [(1.5, -0.459279), (0.5, 0.0883883), (-3.0, -10.3923048)])
def test_B_of_power_laws(p, expected):
    K2, K3, K4 = power_law(p)
    assert nls.B(K2, K3, K4) == pytest.approx(expected, rel=1e-6)
    assert nls.B(K2, K3, K4) == pytest.approx(-(p**3) * (p - 1) / (2 * abs(p) ** 1.5), rel=1e-12)
    found = nls.coefficients(1.7, K2, K3, K4, np.pi)
    assert found.nu3 == pytest.approx(float(nls.B(K2, K3, K4, 1.7)), rel=1e-12)
    assert bool(found.focusing) == (p == 0.5)


def test_monomer_at_fixed_length():
    found = nls.coefficients(1.0, *HERTZ, np.pi, constraint="length")
    assert found.nu3 == pytest.approx(-0.153093, rel=1e-5)
    assert found.nu3_force == pytest.approx(-0.459279, rel=1e-6)
    # omega = 2 sqrt(K2) sin(k/2)
    assert found.nu2 == pytest.approx(np.sqrt(1.5) / 4, rel=1e-12)
    assert found.mean_strain[0] == pytest.approx(0.0, abs=1e-15)
    assert found.mean_strain_force[0] == pytest.approx(-2 * 0.375 / 1.5)


@pytest.mark.parametrize("k", [0.2, 1.1, np.pi / 2, 2.9])
def test_monomer_in_closed_form(k):
    m, (K2, K3, K4) = 1.3, (1.5, 0.4, 0.2)
    lam = lambda q: 4 * np.sin(q / 2) ** 2
    omega, speed = np.sqrt(K2 * lam(k) / m), np.sqrt(K2 / m) * np.cos(k / 2)
    Y2 = -lam(2 * k) * K3 / (K2 * lam(2 * k) - 4 * m * omega**2)
    Y0 = -2 * K3 / (K2 - m * speed**2)
    found = nls.coefficients(m, K2, K3, K4, k)
    assert found.omega == pytest.approx(omega, rel=1e-13)
    assert found.group_velocity == pytest.approx(speed, rel=1e-12)
    assert found.nu2 == pytest.approx(omega / 8, rel=1e-12)
    assert found.harmonic_strain[0] == pytest.approx(Y2, rel=1e-11)
    assert found.mean_strain[0] == pytest.approx(Y0, rel=1e-11)
    assert found.nu3 == pytest.approx(
        lam(k) / (2 * omega * m) * (3 * K4 + 2 * K3 * (Y0 + Y2)), rel=1e-10
    )


@pytest.mark.parametrize("k, folded, branch", [(np.pi, 0.0, 1), (2.0, 4.0, 1), (1.0, 2.0, 0)])
@pytest.mark.parametrize("constraint", ["force", "length"])
def test_dimer_of_equal_masses_is_the_monomer(k, folded, branch, constraint):
    one = nls.coefficients(1.0, *HERTZ, k, constraint=constraint)
    two = nls.coefficients([1.0, 1.0], *HERTZ, folded, branch, constraint)
    lanes = jax.tree.map(lambda *x: np.stack(x), two, two).to_xarray()
    assert lanes.mode_real.dims == ("lane", "site") and lanes.omega.dims == ("lane",)
    assert two.omega == pytest.approx(float(one.omega), rel=1e-13)
    # k per cell, cells of two sites
    assert 2 * abs(two.group_velocity) == pytest.approx(
        abs(float(one.group_velocity)), rel=1e-12, abs=1e-12
    )
    assert 4 * two.nu2 == pytest.approx(float(one.nu2), rel=1e-11)
    assert two.nu3 == pytest.approx(float(one.nu3), rel=1e-11)
    assert two.nu3_force == pytest.approx(float(one.nu3_force), rel=1e-11)


def test_signs_in_the_hertz_dimer():
    top = nls.coefficients(DIMER, *HERTZ, np.pi, 0)
    bottom = nls.coefficients(DIMER, *HERTZ, np.pi, 1)
    assert top.omega == pytest.approx(1.0070830, rel=1e-7) and bottom.omega == pytest.approx(
        1.7320508, rel=1e-7
    )
    assert not top.focusing and "dark" in top.outcome
    assert bottom.focusing and "bright" in bottom.outcome
    # light beads between heavy ones at rest: (3 K4 - 4 K3^2/K2)/(omega m)
    assert bottom.nu3 == pytest.approx((3 * -0.0625 - 4 * 0.375**2 / 1.5) / np.sqrt(3), rel=1e-11)


def test_dispersion_derivatives_by_finite_differences():
    mass, K2, K3, K4 = CELL
    k, h = 1.3, 1e-3
    near = [nls.coefficients(mass, K2, K3, K4, k + step * h, 1) for step in range(-2, 3)]
    at = jax.tree.map(lambda *x: np.stack(x), *near)
    first = np.array([1, -8, 0, 8, -1]) / (12 * h)
    second = np.array([-1, 16, -30, 16, -1]) / (12 * h * h)
    assert at.group_velocity[2] == pytest.approx(float(first @ at.omega), rel=1e-10)
    assert at.nu2[2] == pytest.approx(float(-second @ at.omega / 2), rel=1e-7)
    np.testing.assert_allclose(at.strain_slope[2], first @ at.strain, rtol=1e-9, atol=1e-10)
    assert len(set(np.asarray(at.bond))) == 1 and np.mean(
        np.abs(at.strain[2]) ** 2
    ) == pytest.approx(1, rel=1e-14)
    assert abs(np.imag(at.strain[2][at.bond[2]])) < 1e-16


# three equal masses at k = pi: the other branches touch, which derivatives of eigenvectors would not survive
_MASS, _STEP, _H = jnp.ones(3), jnp.array([0.3, -0.1, 0.4]), 1e-4


def nu3_of(mass):
    return nls.coefficients(mass, 1.5, 0.375, -0.0625, np.pi, 2).nu3


@pytest.mark.slow
def test_gradient_in_the_masses():
    expected = float(nu3_of(_MASS + _H * _STEP) - nu3_of(_MASS - _H * _STEP)) / (2 * _H)
    assert jax.jit(jax.grad(nu3_of))(_MASS) @ _STEP == pytest.approx(expected, rel=1e-6)


@pytest.mark.slow
def test_second_derivative_in_the_masses():
    below, here, above = (float(nu3_of(_MASS + x * _H * _STEP)) for x in (-1, 0, 1))
    along = lambda m: jax.jvp(nu3_of, (m,), (_STEP,))[1]
    assert jax.jvp(along, (_MASS,), (_STEP,))[1] == pytest.approx(
        (above - 2 * here + below) / _H**2, rel=1e-5
    )


# ------------------------------------------------------------------------------- against periodic orbits of small rings


def wave_on_ring(mass, K, p, k, a, guess, constraint):
    """Frequency, displacements and strains of the wave u_j(n, t) = u_j(k n + omega t) with amplitude Y = a.

    Harmonic balance on 16 phases, bonds with force K_j [(1 + y)^p - 1]. Unknown: u_j, omega, and the mean strain where
    it is the mean force that is zero.
    """
    points, P = 16, len(mass)
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
    return z[-2], split(z)[0], strains(z), shift


ONE = np.ones(1)
RINGS = {
    "monomer, k = pi/2, length": (ONE, ONE, 2.5, np.pi / 2, 0, "length"),
    "monomer, k = pi, length": (ONE, ONE, 1.5, np.pi, 0, "length"),
    "monomer, k = pi, force": (ONE, ONE, 1.5, np.pi, 0, "force"),
    "dimer, optical bottom, length": (DIMER, np.ones(2), 1.5, np.pi, 1, "length"),
    "dimer, optical bottom, force": (DIMER, np.ones(2), 1.5, np.pi, 1, "force"),
    "dimer, acoustic top, length": (DIMER, np.ones(2), 1.5, np.pi, 0, "length"),
    "cell of three, k = 3 pi/4, length": (CELL[0], CELL[1], 1.5, 3 * np.pi / 4, 1, "length"),
}


def predicted(mass, K, p, k, branch, constraint):
    return nls.coefficients(mass, *(K * c for c in power_law(p)), k, branch, constraint)


@pytest.mark.slow
@pytest.mark.parametrize("ring", RINGS.values(), ids=RINGS.keys())
def test_frequency_of_waves_on_a_ring(ring):
    *waves, _, constraint = ring
    found = predicted(*ring)
    small, large = 0.003, 0.006
    omega = [wave_on_ring(*waves, a, found, constraint)[0] for a in (small, large)]
    slope = (omega[1] - omega[0]) / (large**2 - small**2)
    assert slope == pytest.approx(float(found.nu3), rel=1e-3)


def test_second_harmonic_and_mean_strain_on_a_ring():
    ring = RINGS["cell of three, k = 3 pi/4, length"]
    *waves, _, constraint = ring
    found, a = predicted(*ring), 0.002
    y = np.fft.fft(wave_on_ring(*waves, a, found, constraint)[2], axis=1) / 16
    np.testing.assert_allclose(y[:, 1] / a, found.strain, atol=1e-4)
    np.testing.assert_allclose(y[:, 2] / a**2, found.harmonic_strain, atol=1e-4)
    np.testing.assert_allclose(y[:, 0] / a**2, found.mean_strain, atol=1e-4)


def test_the_wave_on_a_ring_is_an_orbit_of_the_ring():
    # four sites, from an initial state in time, by another method
    ring = RINGS["monomer, k = pi/2, length"]
    *waves, _, constraint = ring
    omega, u, _, shift = wave_on_ring(*waves, 0.02, predicted(*ring), constraint)
    slope = np.real(np.fft.ifft(1j * np.fft.fftfreq(16, 1 / 16) * np.fft.fft(u[0])))
    sites = np.arange(4) * shift
    start = np.concatenate([u[0][sites], omega * slope[sites]])

    def field(t, z):
        F = (1 + z[:4] - np.roll(z[:4], -1)) ** 2.5
        return np.concatenate([z[4:], np.roll(F, 1) - F])

    end = ended(field, 2 * np.pi / omega, start)
    np.testing.assert_allclose(end, start, atol=1e-10)


def test_hertz_has_no_shift_at_a_quarter_of_the_zone():
    # at fixed length nu3 = p (p - 1) (2p - 3)/(2 omega) there
    assert abs(predicted(ONE, ONE, 1.5, np.pi / 2, 0, "length").nu3) < 1e-15
    found = predicted(ONE, ONE, 2.5, np.pi / 2, 0, "length")
    assert found.nu3 == pytest.approx(2.5 * 1.5 * 2 / (2 * np.sqrt(5)), rel=1e-12)


# ------------------------------------------------------------------------------------------------------------ resonance


def test_a_resonant_second_harmonic_is_said():
    # the second harmonic of k = pi, acoustic, has k = 0 and meets the top of the optical branch
    mass, K2 = np.array([1.0, 1.0]), np.array([1.5, 1.5 / 3])
    # omega^2 at the edges of the diatomic chain of springs: 2 K_small and 2 (K_1 + K_2); equal at 4 omega^2
    found = nls.coefficients(mass, K2, [0.3, 0.1], [0.1, 0.0], np.pi, 0)
    assert 4 * found.omega**2 == pytest.approx(2 * K2.sum(), rel=1e-12)
    assert found.resonant and found.nu3 == np.inf
    assert "second harmonic" in found.outcome
    with refused("second harmonic"):
        nls.bright_profile(found, 0.9, 10)


def test_a_resonance_that_is_not_fed_does_no_harm():
    # masses 1:3: 4 omega^2 of the acoustic top is omega^2 of the optical top, but by symmetry no force drives it
    found = nls.coefficients([3.0, 1.0], *HERTZ, np.pi, 0)
    # that of the optical top is 2 K2 (1/m + 1/M)
    assert 4 * found.omega**2 == pytest.approx(4.0, rel=1e-12)
    near = nls.coefficients([3.1, 1.0], *HERTZ, np.pi, 0)
    assert not found.resonant
    assert found.nu3 * np.sqrt(3.0) == pytest.approx(float(near.nu3) * np.sqrt(3.1), rel=1e-10)


# --------------------------------------------------------------------------------------------------- solitons and seeds


def residual(Y, X, T, nu2, nu3):
    """i Y_T + nu2 Y_XX + nu3 |Y|^2 Y by derivatives of the real and the imaginary part."""
    parts = lambda X, T: jnp.stack([jnp.real(Y(X, T)), jnp.imag(Y(X, T))])
    slope_T = jax.jacfwd(parts, 1)(X, T)
    bend_X = jax.jacfwd(jax.jacfwd(parts))(X, T)
    join = lambda p: p[0] + 1j * p[1]
    return 1j * join(slope_T) + nu2 * join(bend_X) + nu3 * jnp.abs(Y(X, T)) ** 2 * Y(X, T)


@pytest.mark.slow
@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("kind", ["bright", "dark"])
def test_solitons_solve_the_envelope_equation(kind, sign):
    nu3, kappa = sign * 0.7, sign * 0.2
    nu2 = 0.3 * sign if kind == "bright" else -0.3 * sign
    Y = lambda X, T: getattr(nls, kind)(X, T, kappa, nu2, nu3, 0.4)
    left = jax.jit(jax.vmap(lambda X: residual(Y, X, 0.8, nu2, nu3)))(jnp.array([-3.0, 0.4, 1.7]))
    assert np.abs(left).max() < 1e-14
    assert abs(Y(0.9, 1.3)) > 0.1


def test_bright_tail_neither_overflows_nor_is_nan():
    shape = lambda X: jnp.real(nls.bright(X, 0.0, 1.0, 1.0, 2.0))
    value, slope = jax.jit(jax.vmap(jax.value_and_grad(shape)))(jnp.array([40.0, 2000.0]))
    np.testing.assert_allclose(value, [2 * np.exp(-40.0), 0], rtol=1e-12)
    np.testing.assert_allclose(slope, -value, rtol=1e-12)


def test_growth_rate_is_that_of_the_linearised_equation():
    nu2, nu3, a = -0.3, -0.7, 0.6
    Q = np.linspace(0.0, 2.0, 9)
    # w = x + i y about a exp(i nu3 a^2 T): x' = nu2 Q^2 y, y' = (2 nu3 a^2 - nu2 Q^2) x
    matrices = [[[0, nu2 * q * q], [2 * nu3 * a * a - nu2 * q * q, 0]] for q in Q]
    expected = [np.linalg.eigvals(np.array(matrix)).real.max() for matrix in matrices]
    found = nls.growth_rate(Q, a, nu2, nu3)
    np.testing.assert_allclose(found, expected, atol=1e-12)
    assert (found > 0).any() and found[0] == 0 and found[-1] == 0
    assert nls.growth_rate(np.sqrt(nu3 / nu2) * a, a, nu2, nu3) == pytest.approx(-nu3 * a * a)
    assert (nls.growth_rate(Q, a, -nu2, nu3) == 0).all()
    assert jax.jit(jax.grad(lambda a: nls.growth_rate(2.0, a, nu2, nu3)))(a) == 0


def test_dark_profile_of_the_monomer():
    found = nls.coefficients(1.0, *HERTZ, np.pi)
    omega_0 = np.sqrt(6)
    profile = nls.dark_profile(found, 0.99 * omega_0, 82)
    assert 2 * profile.amplitude == pytest.approx(0.461880, rel=1e-5)
    # y_n = 2 (-1)^n (kappa/B)^{1/2} tanh[(-kappa/(2 nu2))^{1/2} (n - x0)] and the mean strain
    kappa, n = -0.01 * omega_0, np.arange(82)
    envelope = np.sqrt(kappa / float(nls.B(*HERTZ))) * np.tanh(
        np.sqrt(-kappa / (2 * float(found.nu2))) * (n - 40)
    )
    np.testing.assert_allclose(profile.mean_strain, -2 * 0.375 / 1.5 * envelope**2, atol=1e-14)
    np.testing.assert_allclose(
        profile.strain - profile.mean_strain, 2 * (-1.0) ** n * envelope, atol=1e-14
    )
    np.testing.assert_allclose(
        profile.displacement[:-1] - profile.displacement[1:], profile.strain[:-1], atol=1e-14
    )
    # the same chain in cells of two
    folded = nls.coefficients([1.0, 1.0], *HERTZ, 0.0, 1)
    again = nls.dark_profile(folded, 0.99 * omega_0, 41)
    np.testing.assert_allclose(np.abs(again.strain), np.abs(profile.strain), atol=1e-12)


def test_dark_background_at_fixed_length():
    found = nls.coefficients(1.0, *HERTZ, np.pi, constraint="length")
    omega = 0.99 * np.sqrt(6)
    kappa, B = -0.01 * np.sqrt(6), -0.459279327
    profile = nls.dark_profile(found, omega, 82)
    assert profile.amplitude**2 == pytest.approx(kappa * np.sqrt(1.5) / (3 * -0.0625), rel=1e-11)
    width = np.sqrt(-B * kappa * np.sqrt(1.5) / (3 * -0.0625) / (2 * np.sqrt(1.5) / 4))
    assert profile.inverse_width == pytest.approx(width, rel=1e-8)
    assert abs(profile.mean_strain[0]) < 1e-12
    assert profile.mean_strain.max() == pytest.approx(
        2 * 0.375 / 1.5 * float(profile.amplitude) ** 2, rel=1e-9
    )
    Y = nls.dark(0.8, 0.0, kappa, found.nu2, found.nu3, nu3_force=found.nu3_force)
    assert Y == pytest.approx(float(profile.amplitude) * np.tanh(0.8 * width), rel=1e-8)


def test_bright_profile_approaches_the_breather():
    # u(0), u(1), u(2) of the light-centred breathers, N = 121, computed by Newton's method
    exact = {0.9900: (0.6377287, 0.0398740, -0.4638610), 0.9850: (0.7784533, 0.0526330, -0.4492773)}
    found = nls.coefficients(DIMER, *HERTZ, np.pi, 1)
    errors = []
    for ratio, u in exact.items():
        profile = nls.bright_profile(found, ratio * np.sqrt(3), 60, centre=59)
        errors.append(np.abs(np.array(profile.strain[59:61]) + np.diff(u)).max() / u[0])
    assert errors[0] < 0.06 and errors[0] < 0.75 * errors[1]
    profile = nls.bright_profile(found, 0.99 * np.sqrt(3), 60, centre=59)
    # even about the bead in what oscillates, odd in the mean
    np.testing.assert_allclose(
        profile.strain[59 - 40 : 59] - profile.mean_strain[59 - 40 : 59],
        -(profile.strain - profile.mean_strain)[59:99][::-1],
        atol=1e-12,
    )
    np.testing.assert_allclose(
        profile.mean_strain[19:59], profile.mean_strain[59:99][::-1], atol=1e-12
    )


def test_profile_is_a_superposition_of_modes():
    # a packet at k = 0, without second order: sum over q of the sech's spectrum times s(q) exp(i q n); error O(width^2)
    mass, K2 = CELL[:2]
    found = nls.coefficients(mass, K2, 0.0, -1.0, 0.0, 2)
    omega_0 = float(found.omega)
    s, w, place = np.real(found.strain), np.imag(found.strain_slope), np.arange(3) / 3
    shift = np.sum(s * (w - s * place)) / np.sum(s**2)
    cells, centre = 80, 120.3
    n = np.arange(cells)
    errors = []
    for kappa in (-0.002, -0.0005):
        profile = nls.bright_profile(found, omega_0 + kappa, cells, centre)
        a, b = float(profile.amplitude), float(profile.inverse_width)
        q = np.linspace(-10 * b, 10 * b, 101)
        modes = np.array([nls.coefficients(mass, K2, 0.0, -1.0, k, 2).strain for k in q])
        spectrum = a / (2 * b) / np.cosh(np.pi * q / (2 * b)) * (q[1] - q[0])
        place_of_cell = n - (centre - 0.5) / 3 - shift
        packet = np.exp(1j * np.outer(place_of_cell, q)) @ (spectrum[:, None] * modes)
        errors.append(np.abs(profile.strain - 2 * np.real(packet).ravel()).max() / a)
    assert errors[0] < 0.02
    assert errors[1] < errors[0] / 3.5


# ------------------------------------------------------------------------------------------------------------- refusals


def test_refusals_say_what_is_there():
    monomer = nls.coefficients(1.0, *HERTZ, np.pi)
    with refused("nu3 < 0 with nu2 > 0: only dark"):
        nls.bright_profile(monomer, 0.99 * np.sqrt(6), 40)
    with refused("lowers the frequency"):
        nls.dark_profile(monomer, 1.01 * np.sqrt(6), 40)
    with refused("only bright"):
        nls.dark(0.0, 0.0, 1.0, 1.0, 1.0)
    with refused("stands still"):
        nls.dark_profile(nls.coefficients(1.0, *HERTZ, 1.0), 1.0, 40)
    with refused("omega = 0"):
        nls.coefficients(1.0, *HERTZ, 0.0)
    with refused("touches another"):
        nls.coefficients([1.0, 1.0], *HERTZ, np.pi, 1)
    with refused("precompression"):
        nls.coefficients(1.0, 0.0, 0.0, 0.0, np.pi)
    with refused("jax.vmap"):
        nls.coefficients(1.0, *HERTZ, [1.0, 2.0])


def test_traced_wave_numbers_that_have_no_equation_give_nan():
    found = jax.vmap(lambda k: nls.coefficients(1.0, *HERTZ, k))(jnp.array([0.0, np.pi]))
    assert np.isnan(found.nu3[0]) and found.nu3[1] == pytest.approx(-0.459279, rel=1e-6)
