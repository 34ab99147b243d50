"""Forced orbits and their branches: harmonic balance, SciPy, long runs that settle, batches, and derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import ended
from known_orbits import MODES, STIFFNESS, pair, period_of, shaken_bond
from numpy.testing import assert_allclose
from refusals import refused
from scipy.integrate import solve_ivp
from scipy.optimize import brentq, fsolve, minimize_scalar

import granjax as gx
from granjax.driven import driven_chain, settle
from granjax.forced import forced_branch, forced_orbit

DAMPING, FORCE, CUBIC = 0.05, 0.1, 0.1  # those of `pair`


def balance(lag):
    """Harmonic balance with seven odd harmonics where x lags by an angle behind the drive: omega and |c_k|."""
    k = np.arange(1, 14, 2)
    phase = 2 * np.pi * np.arange(64) / 64
    modes = np.exp(1j * k * phase[:, None])

    def equations(unknowns):
        c = unknowns[:7] + 1j * unknowns[7:14]
        w = unknowns[14]
        cubic = 2 / 64 * modes.conj().T @ (CUBIC * (modes @ c).real ** 3)
        force = (1 - (k * w) ** 2 + 1j * DAMPING * k * w) * c + cubic - np.where(k == 1, FORCE, 0)
        return np.concatenate([force.real, force.imag, [(c[0] * np.exp(1j * lag)).imag]])

    omega = 1.0
    for _ in range(50):  # one harmonic
        amplitude = FORCE * np.sin(lag) / (DAMPING * omega)
        omega = np.sqrt(1 + 0.75 * CUBIC * amplitude**2 - FORCE * np.cos(lag) / amplitude)
    start = np.zeros(15)
    start[[0, 7, 14]] = amplitude * np.cos(lag), -amplitude * np.sin(lag), omega
    solution = fsolve(equations, start, xtol=1e-13)
    assert np.abs(equations(solution)).max() < 1e-12
    return solution[14], np.abs(solution[:7] + 1j * solution[7:14])


@pytest.fixture(scope="module")
def hump():
    return forced_branch(pair, 0.7, 1.4, period=period_of)


@pytest.mark.slow
def test_the_folds_are_those_of_harmonic_balance(hump):
    assert [b.kind for b in hump.bifurcations] == ["fold", "fold"]
    # the lag grows along the branch, and omega with it but between the folds
    for fold, sign, bounds in zip(hump.folds, (-1, 1), ((1.2, 2.0), (2.0, 2.9))):
        how = dict(bounds=bounds, method="bounded", options={"xatol": 1e-9})
        turn = minimize_scalar(lambda lag: sign * balance(lag)[0], **how)
        assert fold == pytest.approx(sign * turn.fun, rel=1e-8)
    assert hump.outcome == "p reached 1.4."
    assert repr(hump.bifurcations[0]) == f"Bifurcation(Fold at p = {hump.folds[0]:.9g})"
    with refused("Use branch.bifurcations"):
        gx.breathers.bifurcations(hump)


@pytest.mark.slow
def test_stability_changes_at_the_folds_alone(hump):
    first, second = (b.after for b in hump.bifurcations)
    i = np.arange(len(hump.p))
    assert (hump.verdict == np.where((i > first) & (i <= second), "unstable", "stable")).all()
    assert_allclose([b.multiplier for b in hump.bifurcations], 1, rtol=0, atol=1e-7)
    assert hump.error.max() < 1e-7
    # rho rho' = exp(-gamma T): all of them multiply to exp(-2 gamma T)
    product = np.exp(-2 * DAMPING * hump.periods)
    assert_allclose(np.prod(hump.multipliers, 1), product, rtol=1e-10)


@pytest.mark.slow
def test_an_orbit_of_the_branch_is_an_orbit(hump):
    orbit = hump.orbit(40)
    assert orbit.converged
    assert_allclose(orbit.state.u, hump.states.u[40], rtol=0, atol=1e-9)
    rms = float(np.sqrt(np.mean(orbit.rms_velocity**2)))
    assert rms == pytest.approx(hump.response[40], rel=1e-9)


@pytest.mark.slow
def test_an_orbit_has_the_harmonics_of_harmonic_balance_and_takes_what_the_drive_gives():
    omega, expected = balance(0.5)
    orbit = forced_orbit(pair(omega), period_of(omega))
    amplitudes = np.abs(orbit.harmonics(5))
    assert_allclose(amplitudes[1::2, 0], expected[:3], rtol=0, atol=1e-8)
    assert_allclose(amplitudes[::2], 0, atol=1e-10)
    assert_allclose(orbit.amplitude, expected[0], rtol=1e-8)
    run = orbit.run(64)
    work = 2 * orbit.period * np.mean(FORCE * np.cos(omega * run.ts) * run.vs[:, 0])
    assert float(orbit.energy_input) == pytest.approx(float(work), rel=1e-8)
    assert_allclose(orbit.rms_velocity, np.sqrt(np.mean(run.vs**2, 0)), rtol=1e-8)


PAIR = pair(0.9)
REFUSED = {
    "steps: expected a multiple of the 3 segments": lambda: forced_orbit(
        PAIR, 1.0, steps=32, segments=3
    ),
    "lattice: expected one Lattice, got a batch": lambda: forced_orbit(
        jax.vmap(pair, out_axes=-1)(jnp.array([0.8, 0.9])), 1.0
    ),
    "guess: expected a state that moves.*, got rest": lambda: forced_orbit(
        gx.scenes.monomer(4), 1.0
    ),
    "guess: expected a State that moves": lambda: forced_orbit(
        gx.scenes.modulated(6, amplitude=0.1, omega=2.0), np.pi
    ),
    "period: expected one after which the forces repeat, got 7.0": lambda: forced_orbit(PAIR, 7.0),
    "make: expected a lattice under": lambda: branch_of(PAIR.terms[:2]),
    "got damping alone": lambda: branch_of(PAIR.terms[:3]),
}


def branch_of(terms):
    return forced_branch(lambda p: gx.Lattice(jnp.ones(2), terms), 0.9, 1.0, period=7.0)


@pytest.mark.parametrize("words", REFUSED)
def test_input_that_cannot_be_meant_is_refused(words):
    with refused(words):
        REFUSED[words]()


@pytest.mark.slow
def test_what_does_not_converge_says_so():
    with pytest.raises(RuntimeError, match="the steps were spent"):
        forced_orbit(PAIR, period_of(0.9), max_steps=1)
    orbit = forced_orbit(PAIR, period_of(0.9), max_steps=1, throw=False)
    assert not orbit.converged and float(orbit.residual) > 1e-10


@pytest.mark.slow
def test_a_batch_over_damping_and_its_gradient():
    @jax.jit
    def amplitude(damping):
        lattice = pair(0.9, damping=damping)
        return forced_orbit(lattice, period_of(0.9), steps=32, throw=False).amplitude[0]

    rates = jnp.linspace(0.03, 0.09, 4)
    h = 1e-4
    assert_allclose(jax.vmap(amplitude)(rates), [amplitude(rate) for rate in rates], rtol=1e-10)
    slope = float(jax.jacfwd(amplitude)(0.05))
    difference = float(amplitude(0.05 + h) - amplitude(0.05 - h)) / (2 * h)
    assert slope == pytest.approx(difference, rel=1e-5)
    assert float(jax.grad(amplitude)(0.05)) == pytest.approx(slope, rel=1e-9)


@pytest.mark.slow
def test_newton_finds_the_state_that_a_run_from_rest_settles_to_in_si_too():
    # 21 steel beads, whose cut-off is 2 sqrt(3/2) in units of m, F0 and d0, both walls shaken in phase
    radius = 9.53e-3
    young = 200e9
    poisson = 0.3
    stiffness = young * np.sqrt(2 * radius) / (3 * (1 - poisson**2))
    chain = gx.scenes.monomer(21, mass=28.2e-3, stiffness=stiffness, precompression=10.0)
    scaled, units = gx.scenes.scaled(chain)
    damping = float(units.time) / 5e-3
    omega = 0.99 * 2 * np.sqrt(1.5)
    period = 2 * np.pi / omega
    assert omega / 0.99 / (2 * np.pi) / units.time == pytest.approx(7369.09, abs=0.01)
    lattice = driven_chain(scaled, 0.05, omega, damping=damping)
    orbit = forced_orbit(lattice, period)
    run = settle(lattice, gx.states.rest(lattice), period, tolerance=1e-9)
    assert run.multiple == 1
    for found, settled in zip(orbit.state, run.state):
        assert np.abs(found - settled).max() < 1e-6 * np.abs(settled).max()
    # multiple shooting from another phase, and SI give the same
    several = forced_orbit(lattice, period, segments=4, t0=0.4 * period)
    later = gx.Flow(64)(orbit.state, 0.0, 0.4 * period, lattice)
    assert_allclose(several.state.u, later.u, rtol=0, atol=1e-9)
    si = driven_chain(chain, 0.05 * units.length, omega / units.time, damping=damping / units.time)
    in_si = units.state_from_si(forced_orbit(si, units.time * period).state)
    assert_allclose(in_si.u, orbit.state.u, rtol=0, atol=1e-10)
    stability = orbit.floquet()
    rho = stability.multipliers
    product = np.exp(-damping * period)
    assert stability.verdict == "stable"
    assert np.abs(rho[:, None] * rho - product).min(1).max() < 1e-8


@pytest.mark.slow
def test_a_parametric_guess_that_falls_to_rest_is_no_orbit():
    lattice = shaken_bond(0.1, 2.0, 0.1)
    guess = gx.State(jnp.array([0.1, -0.1]), jnp.zeros(2))
    with pytest.raises(RuntimeError, match="The guess fell to rest"):
        forced_orbit(lattice, np.pi, guess, steps=32)
    # whoever asks for rest gets it
    assert forced_orbit(lattice, np.pi, gx.states.rest(lattice), steps=32).converged


def threshold(omega, damping):
    """Strength at which the spectral radius of the rest state passes 1, by SciPy."""
    spring = np.diag([1.0, 1 / 2.3])

    def radius(strength):
        def slope(t, y):
            u, v = y.reshape(2, 2, 4)
            stiffness = spring + (1 + strength * np.cos(omega * t)) * (STIFFNESS - spring)
            return np.concatenate([v, -stiffness @ u - damping * v]).ravel()

        end = ended(slope, 2 * np.pi / omega, np.eye(4).ravel())
        return np.abs(np.linalg.eigvals(end.reshape(4, 4))).max()

    return brentq(lambda strength: radius(strength) - 1, 0.05, 0.9, xtol=1e-10)


@pytest.mark.slow
@pytest.mark.parametrize(
    "kind, omega, damping",
    [("period doubling", 2 * MODES[1], 0.05), ("Neimark-Sacker", MODES.sum(), 0.02)],
)
def test_parametric_resonance_sets_in_where_scipy_says(kind, omega, damping):
    make = lambda strength: shaken_bond(strength, omega, damping)
    branch = forced_branch(make, 0.0, 0.9, period=2 * np.pi / omega)
    first = branch.bifurcations[0]
    assert first.kind == kind
    assert first.p == pytest.approx(threshold(omega, damping), rel=1e-6)
    assert_allclose(branch.response, 0, atol=1e-12)
    i = first.after
    assert (branch.verdict[: i + 1] == "stable").all() and branch.verdict[i + 1] == "unstable"


def driven_ends(force, damping, mean=0.0, law=gx.Linear(1.0)):
    terms = gx.Bond(gx.Shift(1, "free"), law), gx.Drive(gx.Harmonic(force, 2.5, mean=mean), 0)
    return gx.Lattice(jnp.ones(3), (*terms, *[gx.Damping(damping)] * (damping > 0)))


@pytest.mark.slow
def test_a_small_force_that_breaks_a_symmetry_leaves_the_branch_stable_without_a_branch_point():
    # Ueda's oscillator becomes lopsided at a pitchfork; with a static force the branch leads there
    hard = gx.OnSite(gx.Polynomial(jnp.array([0.0, 1.0]), 0.0, 1.0))  # the second site rests
    guess = gx.State(jnp.array([0.1, 0.0]), jnp.zeros(2))

    def over(static):
        both = lambda f: (gx.Harmonic(f, 1.0), gx.Harmonic(static, 0.0))
        make = lambda f: gx.Lattice(
            jnp.ones(2), (hard, gx.Damping(0.2), *[gx.Drive(drive, 0) for drive in both(f)])
        )
        return forced_branch(make, 2.2, 2.6, period=2 * np.pi, guess=guess, transient=30)

    (event,) = over(0.0).bifurcations
    assert event.kind == "branch point" and event.p == pytest.approx(2.4034, abs=1e-4)
    assert event.multiplier == pytest.approx(1, abs=1e-6)
    branch = over(1e-6)
    assert not branch.bifurcations and set(branch.verdict) == {"stable"}
    assert branch.outcome == "p reached 2.6."


@pytest.mark.slow
@pytest.mark.parametrize("damping", [0.3, 0.0])
def test_a_chain_that_moves_freely_responds_linearly_and_has_no_bifurcation(damping):
    make = lambda force: driven_ends(force, damping)
    branch = forced_branch(make, 0.1, 1.0, period=2 * np.pi / 2.5, arclength=0.1)
    assert branch.outcome == "p reached 1." and not branch.bifurcations
    assert set(branch.verdict) == {"stable"}
    # m a = F - gamma m v, mode by mode
    omega, modes = np.linalg.eigh(np.array([[1.0, -1, 0], [-1, 2, -1], [0, -1, 1]]))
    u = modes @ (modes[0] / (omega - 2.5**2 + 2.5j * damping))
    exact = np.sqrt(np.mean(np.abs(2.5 * u) ** 2) / 2)
    assert_allclose(branch.response / branch.p, exact, rtol=1e-8)
    assert (branch.response_error < 1e-8).all()
    assert_allclose(np.asarray(branch.u).mean(1), 0, atol=1e-9)
    slope = jax.jvp(
        lambda f: forced_orbit(make(f), 2 * np.pi / 2.5, steps=64).state.u, (0.2,), (1.0,)
    )
    assert_allclose(slope[1], slope[0] / 0.2, atol=1e-9)


@pytest.mark.slow
def test_a_chain_that_is_driven_away_has_no_orbit():
    with pytest.raises(RuntimeError, match="drive the lattice away"):
        forced_orbit(driven_ends(0.1, 0.3, mean=0.1), 2 * np.pi / 2.5)


@pytest.mark.slow
def test_without_damping_multipliers_on_the_circle_are_no_bifurcations():
    chain = gx.scenes.monomer(4, precompression=1.0)
    make = lambda force: driven_chain(chain, force, 2.7, ends="left")
    branch = forced_branch(make, 0.01, 0.1, period=2 * np.pi / 2.7, arclength=0.2)
    assert not branch.bifurcations and set(branch.verdict) == {"stable"}
    assert branch.orbit(-1).floquet().verdict == "stable"

    # one of two wells apart is driven: its orbit doubles where the trace of its map is -2, by SciPy
    well = gx.OnSite(gx.Polynomial(-1.0, 0.0, 1.0))
    make = lambda force: gx.Lattice(jnp.ones(2), (well, gx.Drive(gx.Harmonic(force, 2.9), 0)))
    beside = gx.State(jnp.ones(2), jnp.zeros(2))
    branch = forced_branch(make, 0.02, 2.0, period=2 * np.pi / 2.9, guess=beside)
    (doubling,) = branch.bifurcations
    assert doubling.kind == "period doubling"

    def trace(force):
        def rate(t, y):
            x, v, *w = y
            stiff = 1 - 3 * x**2
            return [v, x - x**3 + force * np.cos(2.9 * t), w[2], w[3], stiff * w[0], stiff * w[1]]

        def end(y):
            whole = [*y, 1.0, 0, 0, 1]
            return solve_ivp(rate, (0, 2 * np.pi / 2.9), whole, "DOP853", rtol=1e-12, atol=1e-12).y[
                :, -1
            ]

        start = np.array(branch.orbit(int(doubling.after)).state)[:, 0]
        for _ in range(12):
            y = end(start)
            start = start - np.linalg.solve(y[2:].reshape(2, 2) - np.eye(2), y[:2] - start)
        return y[2] + y[5] + 2

    assert doubling.p == pytest.approx(
        brentq(trace, doubling.p - 0.01, doubling.p + 0.01), rel=1e-7
    )
    with refused("with damping"):
        branch.normal_form(0)
