"""First-order lattices: against quadrature, closed forms, the cradle, and their own conservation laws."""

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
from numpy.testing import assert_allclose
from pytest import mark, raises
from refusals import refused
from scipy.integrate import solve_ivp

import granjax as gx
from granjax import first_order
from granjax.first_order import DNLS, DpS, Equation, SplitStep, electrical, evolve, field, soliton

RNG = np.random.default_rng(8)
N = 9
PSI = RNG.standard_normal(N) + 1j * RNG.standard_normal(N)
MOVED = jnp.asarray(RNG.standard_normal((N, 3)) + 1j * RNG.standard_normal((N, 3)))
RING, FIXED = (
    DNLS(N, 0.7, 1.3, order=0.5, boundary=boundary, potential=np.linspace(0, 1, N))
    for boundary in ("periodic", "fixed")
)


def laplacian(weights, boundary):
    """The matrix of the coupling, by its definition, with images on a ring."""
    matrix = np.zeros((N, N))
    for n in range(N):
        for m in range(1, len(weights) + 1):
            for other in (n - m, n + m):
                inside = boundary == "periodic" or 0 <= other < N
                if inside or boundary == "fixed":
                    matrix[n, n] += weights[m - 1]
                if inside:
                    matrix[n, other % N] -= weights[m - 1]
    return matrix


@mark.slow
@mark.parametrize("boundary", ["periodic", "fixed", "free"])
def test_the_equation_of_a_kernel_and_of_next_neighbours(boundary):
    weights = np.array([1.0, 0.5, 0.2])
    for own, given in (({"kernel": weights}, weights), ({}, [1.0])):
        equation = DNLS(N, 0.7, 1.3, boundary=boundary, **own)
        wanted = 0.7 * laplacian(given, boundary) @ PSI - 1.3 * np.abs(PSI) ** 2 * PSI
        assert_allclose(equation.gradient(jnp.asarray(PSI)), wanted, atol=1e-14)


@mark.slow
def test_the_gradient_is_that_of_the_energy():
    for equation in (RING, FIXED, *(DpS(N, boundary=b) for b in ("periodic", "fixed", "free"))):
        psi = jnp.asarray(PSI)
        assert_allclose(equation.gradient(psi), Equation.gradient(equation, psi), atol=1e-14)
        # JAX's gradient of a real function is twice that by psi*, conjugated.
        by_jax = np.conj(jax.grad(equation.energy)(PSI)) / 2
        assert_allclose(by_jax, equation.gradient(psi), atol=1e-14)


@mark.slow
def test_the_flow_and_its_tangents_are_those_of_another_solver():
    split = gx.Flow(40, SplitStep(), field)
    other = gx.Flow(400, diffrax.Dopri8(), field)
    for equation in (RING, FIXED):
        end, moved = split.tangents(PSI, MOVED, 0.0, 1.0, equation)
        wanted, as_wanted = other.tangents(PSI, MOVED, 0.0, 1.0, equation)
        assert_allclose(end, wanted, atol=1e-11)
        assert_allclose(moved, as_wanted, atol=1e-10)
        assert abs(equation.norm(end) / equation.norm(PSI) - 1) < 1e-14


def test_rounding_does_not_grow_with_the_number_of_steps():
    """Of a finite chain, whose coupling is a product of matrices."""
    equation = DNLS(N, boundary="free")
    start = jnp.asarray(PSI)
    count = 4096
    end = jax.lax.fori_loop(
        0, count, lambda _, psi: equation.drift(psi, jnp.asarray(1 / count)), start
    )
    assert np.abs(end - equation.drift(start, jnp.asarray(1.0))).max() < 2e-13


@mark.slow
def test_norm_and_energy_are_kept_to_1e_10():
    start = jnp.zeros(21).at[10].set(1.0)
    free = DNLS(21, 1.0, 4.0, boundary="free")
    for equation, t1, within in ((free, 30.0, 1e-12), (DpS(21), 5.0, 1e-10)):
        run = evolve(equation, start, t1)
        assert run.completed and run.norm_error < within and run.energy_error < 1e-10


@mark.slow
@mark.parametrize("chi, trapped", [(3.8, False), (4.2, True)])
def test_the_dimer_is_that_of_kenkre_and_campbell(chi, trapped):
    """p = cn(2 V t | chi/4V), so that it returns at chi < 4 V and stays beyond."""
    ts = np.linspace(0, 6.0, 25)
    run = evolve(DNLS(2, 1.0, chi, boundary="fixed"), np.array([1.0, 0.0]), 6.0, save_at=ts)
    m = min(chi / 4, 4 / chi) ** 2
    _, cn, dn = gx.theory.elliptic.jacobi(2 * ts * max(1.0, chi / 4), m)
    p = run.densities[:, 0] - run.densities[:, 1]
    assert_allclose(p, dn if trapped else cn, atol=1e-8)
    assert (run.densities[:, 0].min() > 0.5) == trapped


@mark.slow
def test_the_dimer_traps_itself_at_4V():
    found = first_order.self_trapping(
        lambda chi: DNLS(2, 0.7, chi, boundary="fixed"), 2.0, 4.0, 20.0, tolerance=1e-4
    )
    assert abs(found.nonlinearity - 2.8) < found.error < 4e-4
    assert "among" not in found.outcome


@mark.slow
def test_a_site_keeps_its_share_between_the_frames_too():
    # the density of a trapped dimer falls to (1 + (1 - 16/chi^2)^{1/2})/2, within each period
    found = first_order.self_trapping(
        lambda chi: DNLS(2, 1.0, chi, boundary="fixed"), 4.1, 5.0, 8.0, share=0.7, frames=30
    )
    assert abs(found.nonlinearity - 4 / np.sqrt(0.84)) < found.error < 1e-5
    least = (1 + np.sqrt(1 - 16 / found.tried**2)) / 2
    assert (abs(found.kept - least) < found.kept_error).all()


@mark.slow
def test_a_threshold_of_self_trapping_that_is_not_sharp_says_so():
    # SciPy's DOP853 to 1e-12: the trimer escapes at 4.48096 and 4.4844, and stays at 4.4648 and 4.4802
    found = first_order.self_trapping(
        lambda chi: DNLS(3, 1.0, chi, boundary="fixed"), 3.0, 6.0, 30.0, tolerance=1e-4
    )
    stays = found.kept > 0.5
    above = found.tried > found.nonlinearity
    assert stays[above].all() and stays[~above].any()
    assert "values that trap lie among values that do not" in found.outcome


@mark.slow
def test_fractional_coupling_lowers_the_threshold_of_self_trapping():
    threshold = [
        first_order.self_trapping(
            lambda chi: DNLS(32, 1.0, chi, order=s), 1.0, 8.0, 10.0, tolerance=0.02
        ).nonlinearity
        for s in (1.0, 0.5)
    ]
    assert threshold[1] < 0.7 * threshold[0]


@mark.slow
@mark.parametrize("guess", ["site", "bond"])
def test_solitons_are_those_of_the_continuum(guess):
    found = soliton(DNLS(61, 16.0, 2.0), -1.0, guess=guess)
    x = (np.arange(61) - 30 - 0.5 * (guess == "bond")) / 4
    assert_allclose(found.psi, 1 / np.cosh(x), atol=0.1 * 0.25**2)


@mark.slow
@mark.parametrize(
    "equation, omega, tail",
    [
        (DNLS(41, 1.0, 1.0, order=0.6), -2.0, 0.05),
        (DNLS(41, 1.0, -1.0, boundary="fixed"), 5.0, 1e-6),
    ],
    ids=["fractional", "staggered"],
)
def test_solitons_stand_still(equation, omega, tail):
    found = soliton(equation, omega)
    assert found.residual < 1e-12 and found.tail < tail
    assert (found.psi[20] * found.psi[21] < 0) == (omega > 0)
    run = evolve(equation, found.psi, 5.0)
    assert_allclose(run.final, found.psi * np.exp(-5j * omega), atol=1e-9)


@mark.slow
def test_a_soliton_that_is_lost_is_not_found():
    """On an impurity that repels, the branch turns back: an even mode there has no stiffness."""
    potential = 2.0 * np.eye(41)[20]
    chain = DNLS(41, potential=potential)
    with raises(RuntimeError, match="does not reach the coupling, but 0.7339 of it"):
        soliton(chain, -1.2)
    found = soliton(chain, -1.2, throw=False)
    psi = np.asarray(found.psi)
    L = 2 * np.eye(41) - np.roll(np.eye(41), 1, 0) - np.roll(np.eye(41), -1, 0)
    linear = float(found.share) * L + np.diag(potential + 1.2)
    assert_allclose(linear @ psi, psi**3, atol=1e-11)
    values, modes = np.linalg.eigh(linear - np.diag(3 * psi**2))
    even = np.sum(modes * modes[::-1], axis=0) > 0
    assert np.abs(values[even]).min() < 1e-3
    small = 0.3 * np.exp(-np.abs(np.arange(41) - 20.0))
    with raises(RuntimeError, match="fell to zero"):
        soliton(DNLS(41), -1.0, guess=small)
    with raises(RuntimeError, match="fell to zero"):
        soliton(DpS(21, 1.0), 2.0, guess=np.diff(np.eye(23)[11], 2))


@mark.slow
@mark.parametrize("guess", ["site", "bond"])
@mark.parametrize("chi, potential, omega", [(1, 1, 0), (1, 3, 1), (1, 100, 99.5), (-1, -10, -5)])
def test_a_uniform_potential_only_turns_the_phase(chi, potential, omega, guess):
    """Neighbours are in phase below the band and not above it, in whichever frame."""
    found = soliton(DNLS(41, 1.0, chi, potential=potential), omega, guess=guess)
    plain = soliton(DNLS(41, 1.0, chi), omega - potential, guess=guess)
    assert_allclose(found.psi, plain.psi, atol=1e-10)
    assert (found.psi[20] * found.psi[21] > 0) == (chi > 0) and found.residual < 1e-12


@mark.slow
def test_the_sign_of_the_coupling_changes_every_other_sign_of_a_soliton():
    """psi_n -> (-1)^n psi_n takes V to -V and the band [-4 V, 0] to [0, 4 V]."""
    found, plain = (soliton(DNLS(40, v), w, guess="bond") for v, w in ((-1.0, -5.0), (1.0, -1.0)))
    assert_allclose(found.psi * (-1.0) ** np.arange(40), plain.psi, atol=1e-11)


@mark.slow
def test_a_soliton_differentiates_in_the_order_of_the_coupling():
    def norm(s):
        return soliton(DNLS(41, 1.0, 1.0, order=s), -2.0, guess=start).norm

    start = soliton(DNLS(41, 1.0, 1.0, order=0.6), -2.0).psi
    slope = (norm(0.6 + 1e-5) - norm(0.6 - 1e-5)) / 2e-5
    assert_allclose(jax.grad(norm)(0.6), slope, rtol=1e-6)


@mark.slow
def test_the_p_schroedinger_equation_has_compact_looking_breathers():
    chain = DpS(21, boundary="periodic")
    guess = jnp.zeros(21).at[jnp.array([9, 10, 11])].set(jnp.array([-0.4, 1.0, -0.4]))
    omega = float((chain.gradient(guess + 0j)[10]).real)
    found = soliton(chain, omega, guess=guess)
    top = np.abs(found.psi[10:16])
    # super-exponentially: each logarithm is 3/2 times the one before
    assert found.residual < 1e-12 and top[5] < 1e-4 * top[0] and (np.diff(np.log(top), 2) < 0).all()


def test_tau_0_is_that_of_the_reference():
    assert abs(float(first_order.tau_0()) - 1.5450622310844768) < 1e-14
    t = np.linspace(0, 2 * np.pi, 200_001)[:-1]
    harmonic = np.mean(np.maximum(np.cos(t), 0) ** 2.5 * np.cos(t))
    assert_allclose(float(first_order.tau_0(2.5)), 2**-2.5 / harmonic, rtol=1e-12)


def cradle_error(eps):
    """Of the modulation equation at t = eps^{-1/2}, over the amplitude."""
    n = np.arange(12)
    A = eps * np.exp(-((n - 5.5) ** 2) / 4) * np.exp(0.5j * n)
    equation = DpS.of_cradle(12, mass=2.0, stiffness=3.0, pendulum=8.0)
    t1 = eps**-0.5
    lattice = gx.scenes.cradle(12, mass=2.0, stiffness=3.0, pendulum=8.0)
    run = gx.simulate(lattice, equation.state(jnp.asarray(A)), t1)
    envelope = equation.state(evolve(equation, A, t1, tolerance=1e-6).final, t1)
    return float(np.max(np.abs(run.final.u - envelope.u))) / eps


@mark.slow
def test_the_modulation_equation_of_the_cradle():
    errors = [cradle_error(eps) for eps in (1e-2, 1e-3, 1e-4)]
    assert errors[0] < 0.05 and errors[1] < errors[0] / 2.5 and errors[2] < errors[1] / 2.5


@mark.slow
def test_the_electrical_lattice_s_envelope():
    """Against the circuit, whose voltage is found from the charge; the error is of second order."""
    sites = 16
    b = 1.0
    C = 2.0
    L2 = 0.5
    omega0 = (L2 * C) ** -0.5
    k = np.arange(16)

    def error(small):
        psi = np.sqrt(small) * np.exp(-((k - 8) ** 2) / 8) * (1 + 0.3j)
        L1 = L2 / small
        t1 = 1 / small
        equation = electrical(
            sites, inductance=L1, ground=L2, capacitance=C, nonlinearity=b, order=0.5
        )
        matrix = jax.vmap(equation.laplacian, in_axes=1, out_axes=1)(jnp.eye(sites)).real

        def slope(t, y):
            U = y[:sites]
            dQ = y[sites:]
            return np.concatenate([dQ / (C * (1 + 3 * b * U**2)), -matrix @ U / L1 - U / L2])

        U = 2 * psi.real
        rate = 2 * (-1j * omega0 * psi + field(0.0, jnp.asarray(psi), equation)).real
        start = np.concatenate([U, rate * C * (1 + 3 * b * U**2)])
        exact = solve_ivp(slope, (0, t1), start, method="DOP853", rtol=1e-9, atol=1e-11)
        end = 2 * (evolve(equation, psi, t1).final * np.exp(-1j * omega0 * t1)).real
        return np.max(np.abs(end - exact.y[:sites, -1])) / np.sqrt(small)

    errors = [error(s) for s in (0.04, 0.01)]
    assert errors[0] < 0.2 and errors[1] < errors[0] / 2


@mark.slow
def test_lanes_and_laws_of_ones_own_move_as_each_alone():
    chis = jnp.array([0.5, 1.5])
    batch = jax.vmap(lambda chi: DNLS(N, 0.7, chi, order=0.4), out_axes=-1)(chis)
    start = jnp.asarray(np.stack([PSI, 2 * PSI], axis=-1))
    together = evolve(batch, start, 1.0)
    assert together.to_xarray(lanes={"chi": chis}).psi_real.dims == ("time", "site", "chi")
    for i, own in enumerate((gx.Linear(0.5), 1.5)):
        alone = evolve(DNLS(N, 0.7, own, order=0.4), start[:, i], 1.0)
        assert_allclose(together.final[:, i], alone.final, atol=1e-9)
        assert_allclose(together.energy[0, i], alone.energy[0], rtol=1e-10)


def test_the_step_of_a_run_is_its_longest():
    # 0.3 and 0.7 in two and three steps of at most a quarter, all of which are halved once
    run = evolve(DNLS(N), PSI, 1.0, step=0.25, save_at=[0.0, 0.3, 1.0])
    assert_allclose(run.step, 0.7 / 3 / 2, rtol=1e-14)


@mark.slow
def test_an_evolution_differentiates_in_both_modes():
    def at_site(s):
        return evolve(DNLS(N, 0.7, 0.5, order=s), PSI, 1.0, step=0.1).densities[-1, 3]

    slopes = jax.jvp(at_site, (0.4,), (1.0,))[1], jax.grad(at_site)(0.4)
    difference = (at_site(0.4 + 1e-5) - at_site(0.4 - 1e-5)) / 2e-5
    assert_allclose(slopes, difference, rtol=1e-7)


@mark.slow
def test_float32_stays():
    small = DNLS(N, jnp.float32(0.7), jnp.float32(1.3), order=jnp.float32(0.5))
    for equation, dtype in ((small, jnp.complex64), (DNLS(N), jnp.complex128)):
        run = evolve(equation, jnp.asarray(PSI, jnp.complex64), 1.0, tolerance=1e-4)
        assert run.final.dtype == dtype and run.norm_error < 1e-5


@mark.slow
@mark.parametrize(
    "call, said",
    [
        (lambda: soliton(DNLS(41), 1.0), r"omega: .*outside of the band \[0, 3.99"),
        (lambda: soliton(DNLS(41), 5.0), "a single uncoupled site"),
        (
            lambda: soliton(DNLS(41, boundary="free"), -1.0, guess="bond", centre=-1),
            "centre: expected one of the first 40 sites",
        ),
        (lambda: DNLS(N, order=0.0), r"order: expected numbers in \(0, 1\]"),
        (lambda: DNLS(2), "dimer is two sites"),
        (lambda: DNLS(N, order=0.5, kernel=np.ones(2)), "kernel: expected a kernel, or an order"),
        (lambda: DNLS(N, potential=np.ones(4)), r"potential: .*\(9,\)"),
        (lambda: DpS(N, exponent=1.0), "exponent"),
        (lambda: evolve(DNLS(N), np.ones(4), 1.0), r"psi: expected shape \(9,\)"),
        (
            lambda: evolve(jax.vmap(lambda x: DNLS(N, 1.0, x), out_axes=-1)(MOVED.real[0]), PSI, 1),
            "psi: .*lanes",
        ),
        (lambda: evolve(DNLS(N), np.ones(N), 0.0), "t1"),
        (lambda: evolve(DNLS(N), np.ones(N), 1.0, save_at=[]), "save_at: expected increasing"),
        (lambda: evolve(DpS(N), PSI, 1.0, solver=SplitStep()), "solver: .*DpS"),
        (lambda: gx.Flow(5, field=field)(PSI, 0.0, 1.0, DNLS(N)), "solver: .*SplitStep"),
        (
            lambda: gx.Flow(5, SplitStep(), field).derivative(PSI, 0.0, 1.0, DNLS(N)),
            "complex",
        ),
        (
            lambda: first_order.self_trapping(
                lambda c: DNLS(2, 1.0, c, boundary="fixed"), 5.0, 6.0, 9.0
            ),
            "low",
        ),
    ],
)
def test_what_has_no_solution_is_refused(call, said):
    with refused(said):
        call()


@mark.slow
def test_mapped_solitons_say_what_became_of_them():
    equation = DNLS(12)
    one = soliton(equation, -1.0)
    found = jax.jit(jax.vmap(lambda omega: soliton(equation, omega, guess=one.psi)))
    assert found(jnp.array([-1.0, -1.02])).outcome == one.outcome
