import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import ended, few
from refusals import refused
from scipy.optimize import brentq, fsolve, minimize_scalar

import granjax as gx
from granjax.driven import driven_chain, response, settle
from granjax.forced import forced_branch, forced_orbit

DAMPING, FORCE, QUARTIC = 0.05, 0.1, 0.1


def duffing(omega, damping=DAMPING, force=FORCE):
    """Two sites that move alike: x'' + gamma x' + x + beta x^3 = F cos(omega t)."""
    drive = gx.Harmonic(force, omega)
    return gx.Lattice(
        jnp.ones(2),
        (
            gx.Bond(gx.Shift(1, "free"), gx.Linear(0.3)),
            gx.OnSite(gx.Polynomial(1.0, 0.0, QUARTIC)),
            gx.Damping(damping),
            gx.Drive(drive, 0),
            gx.Drive(drive, 1),
        ),
    )


def period_of(omega):
    return 2 * jnp.pi / omega


def balance(lag):
    """Harmonic balance with seven odd harmonics where x lags by an angle behind the drive: omega and |c_k|."""
    k, phase = np.arange(1, 14, 2), 2 * np.pi * np.arange(64) / 64
    modes = np.exp(1j * k * phase[:, None])

    def equations(unknowns):
        c, w = unknowns[:7] + 1j * unknowns[7:14], unknowns[14]
        cubic = 2 / 64 * modes.conj().T @ (QUARTIC * (modes @ c).real ** 3)
        force = (1 - (k * w) ** 2 + 1j * DAMPING * k * w) * c + cubic - np.where(k == 1, FORCE, 0)
        return np.concatenate([force.real, force.imag, [(c[0] * np.exp(1j * lag)).imag]])

    omega = 1.0
    for _ in range(50):  # one harmonic
        amplitude = FORCE * np.sin(lag) / (DAMPING * omega)
        omega = np.sqrt(1 + 0.75 * QUARTIC * amplitude**2 - FORCE * np.cos(lag) / amplitude)
    start = np.zeros(15)
    start[[0, 7, 14]] = amplitude * np.cos(lag), -amplitude * np.sin(lag), omega
    solution = fsolve(equations, start, xtol=1e-13)
    assert np.abs(equations(solution)).max() < 1e-12
    return solution[14], np.abs(solution[:7] + 1j * solution[7:14])


@pytest.fixture(scope="module")
def hump():
    return forced_branch(duffing, 0.7, 1.4, period=period_of)


def test_the_folds_are_those_of_harmonic_balance(hump):
    upper, lower = hump.folds
    assert [b.kind for b in hump.bifurcations] == ["fold", "fold"]

    # the lag grows along the branch, and omega with it but between the folds
    top = minimize_scalar(
        lambda lag: -balance(lag)[0], bounds=(1.2, 2.0), method="bounded", options={"xatol": 1e-9}
    )
    bottom = minimize_scalar(
        lambda lag: balance(lag)[0], bounds=(2.0, 2.9), method="bounded", options={"xatol": 1e-9}
    )
    assert upper == pytest.approx(-top.fun, rel=1e-8)
    assert lower == pytest.approx(bottom.fun, rel=1e-8)
    assert hump.outcome == "p reached 1.4."
    assert repr(hump.bifurcations[0]) == f"Bifurcation(Fold at p = {upper:.9g})"
    with refused("Its own are branch.bifurcations"):
        gx.breathers.bifurcations(hump)


@pytest.mark.slow
def test_an_orbit_has_the_harmonics_of_harmonic_balance():
    omega, expected = balance(0.5)
    orbit = forced_orbit(duffing(omega), period_of(omega))
    amplitudes = np.abs(orbit.harmonics(5))
    np.testing.assert_allclose(amplitudes[1::2, 0], expected[:3], rtol=0, atol=1e-8)
    np.testing.assert_allclose(amplitudes[::2], 0, atol=1e-10)
    np.testing.assert_allclose(orbit.amplitude, expected[0], rtol=1e-8)


def test_stability_changes_at_the_folds_alone(hump):
    first, second = (b.after for b in hump.bifurcations)
    expected = np.where(
        (np.arange(len(hump.p)) > first) & (np.arange(len(hump.p)) <= second), "unstable", "stable"
    )
    assert (hump.verdict == expected).all()
    rho = np.array([b.multiplier for b in hump.bifurcations])
    np.testing.assert_allclose(rho, 1, rtol=0, atol=1e-7)
    assert hump.error.max() < 1e-7
    # rho rho' = exp(-gamma T): all of them multiply to exp(-2 gamma T)
    np.testing.assert_allclose(
        np.prod(hump.multipliers, 1), np.exp(-2 * DAMPING * hump.periods), rtol=1e-10
    )


@pytest.mark.slow
def test_the_drive_gives_what_damping_takes():
    orbit = forced_orbit(duffing(0.9), period_of(0.9))
    run = orbit.run(64)
    work = 2 * orbit.period * np.mean(FORCE * np.cos(0.9 * run.ts) * run.vs[:, 0])
    assert float(orbit.energy_input) == pytest.approx(float(work), rel=1e-8)
    np.testing.assert_allclose(orbit.rms_velocity, np.sqrt(np.mean(run.vs**2, 0)), rtol=1e-8)


def test_input_that_cannot_be_meant_is_refused():
    lattice = duffing(0.9)
    with refused("steps: expected a multiple of the 3 segments"):
        forced_orbit(lattice, 1.0, steps=32, segments=3)
    with refused("lattice: expected one Lattice, got a batch"):
        forced_orbit(jax.vmap(duffing, out_axes=-1)(jnp.array([0.8, 0.9])), 1.0)
    with refused("guess: expected a state that moves.*, got rest"):
        forced_orbit(gx.scenes.monomer(4), 1.0)
    with refused("guess: expected a State that moves"):
        forced_orbit(gx.scenes.modulated(6, amplitude=0.1, omega=2.0), np.pi)
    with refused("period: expected one after which the forces repeat, got 7.0"):
        forced_orbit(lattice, 7.0)
    free = gx.Lattice(jnp.ones(2), lattice.terms[:2])
    for terms, words in (
        (free.terms, "make: expected a lattice under"),
        (lattice.terms[:3], "got damping alone"),
    ):
        with refused(words):
            forced_branch(
                lambda p, terms=terms: gx.Lattice(jnp.ones(2), terms), 0.9, 1.0, period=7.0
            )


def test_what_does_not_converge_says_so():
    with pytest.raises(RuntimeError, match="the steps were spent"):
        forced_orbit(duffing(0.9), period_of(0.9), max_steps=1)
    orbit = forced_orbit(duffing(0.9), period_of(0.9), max_steps=1, throw=False)
    assert not orbit.converged and float(orbit.residual) > 1e-10


@pytest.mark.slow
def test_a_batch_over_damping_and_its_gradient():
    omega, rates = 0.9, jnp.linspace(0.03, 0.09, 4)

    def amplitude(damping):
        orbit = forced_orbit(duffing(omega, damping), 2 * jnp.pi / omega, steps=32, throw=False)
        return orbit.amplitude[0]

    batch = jax.vmap(amplitude)(rates)
    one_by_one = [float(amplitude(rate)) for rate in rates]
    np.testing.assert_allclose(batch, one_by_one, rtol=1e-10)
    h = 1e-4
    ahead, behind = (amplitude(0.05 + s * h) for s in (1, -1))
    slope = jax.jacfwd(amplitude)(0.05)
    assert float(slope) == pytest.approx(float(ahead - behind) / (2 * h), rel=1e-5)
    assert float(jax.grad(amplitude)(0.05)) == pytest.approx(float(slope), rel=1e-9)


# 21 steel beads in units of m, F0 and d0, whose cut-off is 2 sqrt(3/2), both walls shaken in phase
CUT_OFF = 2 * np.sqrt(1.5) / (2 * np.pi)


@pytest.fixture(scope="module")
def steel():
    """The chain in scaled units, its units, and gamma = 1/tau in them."""
    radius, young, poisson = 9.53e-3, 200e9, 0.3
    stiffness = young * np.sqrt(2 * radius) / (3 * (1 - poisson**2))
    chain = gx.scenes.monomer(21, mass=28.2e-3, stiffness=stiffness, precompression=10.0)
    scaled, units = gx.scenes.scaled(chain)
    return chain, scaled, units, float(units.time) / 5e-3


class Shaken(eqx.Module):
    """Walls that move by a cos(2 pi f t), over the frequency f."""

    chain: gx.Lattice
    damping: jax.Array
    amplitude: jax.Array

    def __call__(self, f):
        return driven_chain(self.chain, self.amplitude, 2 * jnp.pi * f, damping=self.damping)


def over(f):
    return 1 / f


@pytest.mark.slow
def test_newton_finds_the_state_that_a_run_from_rest_settles_to(steel):
    chain, scaled, units, damping = steel
    assert CUT_OFF / units.time == pytest.approx(7369.09, abs=0.01)
    f = 0.99 * CUT_OFF
    lattice = Shaken(scaled, jnp.asarray(damping), jnp.asarray(0.05))(f)
    orbit = forced_orbit(lattice, 1 / f)
    rest = gx.State(lattice.zeros(), lattice.zeros())
    run = settle(lattice, rest, 1 / f, tolerance=1e-9)
    assert run.multiple == 1
    for found, settled in zip(orbit.state, run.state):
        assert np.abs(found - settled).max() < 1e-6 * np.abs(settled).max()
    # multiple shooting and SI give the same
    several = forced_orbit(lattice, 1 / f, segments=4)
    np.testing.assert_allclose(several.state.u, orbit.state.u, rtol=0, atol=1e-9)
    si = driven_chain(
        chain, 0.05 * units.length, 2 * np.pi * f / units.time, damping=damping / units.time
    )
    in_si = units.state_from_si(forced_orbit(si, units.time / f).state)
    np.testing.assert_allclose(in_si.u, orbit.state.u, rtol=0, atol=1e-10)
    stability = orbit.floquet()
    rho, product = stability.multipliers, np.exp(-damping / f)
    assert stability.verdict == "stable"
    pairs = np.abs(rho[:, None] * rho - product).min(1)
    assert pairs.max() < 1e-8


@pytest.mark.study
def test_sweeps_jump_at_the_folds(steel):
    """At a = 0.08 d0 (79 nm) the folds lie at 0.96480 and 0.97065 of the cut-off, 7110 and 7153 Hz."""
    _, scaled, _, damping = steel
    make = Shaken(scaled, jnp.asarray(damping), jnp.asarray(0.08))
    branch = forced_branch(make, 1.0 * CUT_OFF, 0.955 * CUT_OFF, period=over)
    assert [b.kind for b in branch.bifurcations] == ["fold", "fold"]
    low, high = np.sort(branch.folds) / CUT_OFF
    assert low == pytest.approx(0.964804, abs=2e-6) and high == pytest.approx(0.970653, abs=2e-6)
    found = response(
        make, np.linspace(0.96, 0.975, 16) * CUT_OFF, over, accuracy=2e-4, tolerance=1e-7
    )
    (up,), (down,) = found.up.jumps, found.down.jumps
    assert up.value / CUT_OFF == pytest.approx(high, rel=1e-3)
    assert down.value / CUT_OFF == pytest.approx(low, rel=1e-3)


class Parametric(eqx.Module):
    """Two sites whose bond is modulated, over the strength of the modulation; at rest whatever it is."""

    omega: jax.Array
    damping: jax.Array

    def __call__(self, strength):
        bond = gx.Modulated(
            gx.Bond(gx.Shift(1, "free"), gx.Linear(1.0)),
            gx.Harmonic(strength, self.omega, mean=1.0),
        )
        return gx.Lattice(
            jnp.array([1.0, 2.0]), (bond, gx.OnSite(gx.Linear(1.0)), gx.Damping(self.damping))
        )


@pytest.mark.slow
def test_a_parametric_guess_that_falls_to_rest_is_no_orbit():
    lattice, period = Parametric(jnp.asarray(2.0), jnp.asarray(0.1))(0.1), np.pi
    with pytest.raises(RuntimeError, match="The guess fell to rest"):
        forced_orbit(lattice, period, gx.State(jnp.array([0.1, -0.1]), jnp.zeros(2)), steps=32)
    # whoever asks for rest gets it
    assert forced_orbit(lattice, period, gx.states.rest(lattice), steps=32).converged


def threshold(omega, damping):
    """Strength at which the spectral radius of the rest state passes 1, by scipy."""

    def radius(strength):
        def slope(t, y):
            u, v = y.reshape(2, 2, 4)
            push = (1 + strength * np.cos(omega * t)) * (u[0] - u[1])
            return np.concatenate([v, [-push - u[0], (push - u[1]) / 2] - damping * v]).ravel()

        end = ended(slope, 2 * np.pi / omega, np.eye(4).ravel())
        return np.abs(np.linalg.eigvals(end.reshape(4, 4))).max()

    return brentq(lambda strength: radius(strength) - 1, 0.05, 0.9, xtol=1e-10)


@pytest.mark.slow
@pytest.mark.parametrize("kind, damping", [("period doubling", 0.05), ("Neimark-Sacker", 0.02)])
def test_parametric_resonance_sets_in_where_scipy_says(kind, damping):
    modes = np.sqrt(1.5 + np.sqrt(0.75) * np.array([-1, 1]))
    omega = 2 * modes[1] if kind == "period doubling" else modes.sum()
    branch = forced_branch(
        Parametric(jnp.asarray(omega), jnp.asarray(damping)), 0.0, 0.9, period=2 * np.pi / omega
    )
    first = branch.bifurcations[0]
    assert first.kind == kind
    assert first.p == pytest.approx(threshold(omega, damping), rel=1e-6)
    np.testing.assert_allclose(branch.response, 0, atol=1e-12)
    i = first.after
    assert (branch.verdict[: i + 1] == "stable").all() and branch.verdict[i + 1] == "unstable"


class OneWall(eqx.Module):
    """Two beads between walls of which the left one shakes, over its amplitude in units of d0."""

    omega: jax.Array

    def __call__(self, amplitude):
        chain = gx.scenes.monomer(2, precompression=1.0)
        return driven_chain(chain, amplitude, self.omega, ends="left", damping=DAMPING)


@pytest.mark.study
@pytest.mark.parametrize(
    "omega, kind, at",
    few([(2.449, "period doubling", 0.1628306), (3.346, "Neimark-Sacker", 0.3657490)], 1),
)
def test_runs_on_either_side_of_a_bifurcation(omega, kind, at):
    make, period = OneWall(jnp.asarray(omega)), 2 * np.pi / omega
    branch = forced_branch(make, 0.01, 0.4, period=period)
    (found,) = branch.bifurcations
    assert found.kind == kind and found.p == pytest.approx(at, rel=1e-6)
    assert abs(abs(found.multiplier) - 1) < 1e-8
    below, above = (
        settle(make(s * at), found.state, period, periods=20000, tolerance=1e-7)
        for s in (0.97, 1.03)
    )
    assert below.multiple == 1
    assert above.multiple == (2 if kind == "period doubling" else 0)
    if kind == "period doubling":
        doubled = forced_orbit(make(1.03 * at), 2 * period, above.state)
        assert np.abs(doubled.state.u - above.state.u).max() < 1e-5 * np.abs(doubled.state.u).max()
        assert np.abs(doubled.harmonics(1)[1]).max() > 0.01
        assert doubled.floquet().verdict == "stable"


@pytest.mark.slow
def test_an_orbit_of_the_branch_is_an_orbit(hump):
    orbit = hump.orbit(40)
    assert orbit.converged
    np.testing.assert_allclose(orbit.state.u, hump.states.u[40], rtol=0, atol=1e-9)
    assert float(np.sqrt(np.mean(orbit.rms_velocity**2))) == pytest.approx(
        hump.response[40], rel=1e-9
    )


@pytest.mark.study
@pytest.mark.parametrize("masses", [(1.0, 0.5), (1.0, 0.5, 0.25)])
def test_shaken_dimers_and_trimers_settle_to_newtons_orbit(masses):
    chain = gx.scenes.pattern(12, masses, precompression=1.0)
    low, high = gx.linear.bands(chain).gaps[-1]
    omega = 0.5 * (low + high)
    lattice = driven_chain(chain, 0.05, omega, ends="left", damping=0.1)
    orbit = forced_orbit(lattice, 2 * np.pi / omega)
    run = settle(
        lattice, gx.State(lattice.zeros(), lattice.zeros()), 2 * np.pi / omega, tolerance=1e-10
    )
    assert run.multiple == 1 and orbit.floquet().verdict == "stable"
    for found, settled in zip(orbit.state, run.state):
        assert np.abs(found - settled).max() < 1e-6 * np.abs(settled).max()
    # in the gap the wave does not pass
    assert float(orbit.amplitude[-1]) < 0.1 * float(orbit.amplitude[0])
