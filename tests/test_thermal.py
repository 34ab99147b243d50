"""Thermal chains: Gibbs states, heat baths, transport, against quadrature and exact covariances."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from refusals import refused
from scipy.integrate import simpson
from scipy.linalg import solve_continuous_lyapunov, solve_discrete_lyapunov

import granjax as gx
from granjax.measures import time_average
from granjax.theory.thermal import bond_state

# a standard error away by chance: five seeds of some quantities, all reported
SIGMAS = 4.0


def chain(law, sites, boundary="free", *terms):
    return gx.Lattice(1.0, (gx.Bond(gx.Shift(1, boundary), law), *terms), sites=sites)


def copies(make, count):
    """Lanes of equal lattices."""
    return jax.vmap(lambda zero: make(1.0 + zero), out_axes=-1)(jnp.zeros(count))


# ---------------------------------------------------------------------------------------------------------- quadrature


def test_published_averages():
    stiff = bond_state(gx.Polynomial(1.0, -2.0, 1.0), 0.5, 1.0)
    assert stiff.sound_speed == pytest.approx(1.454680309, abs=5e-10)
    # the renormalised dispersion of the beta chain at P = 0 is its isothermal stiffness
    beta = bond_state(gx.Polynomial(1.0, 0.0, 1.0), 1.0, 0.0)
    assert beta.strain_variance**-0.5 == pytest.approx(1.461888448, abs=5e-10)
    # of a Toda bond at P = a exp(e) is Gamma-distributed
    toda = bond_state(gx.Toda(), 1.0)
    assert toda.strain == pytest.approx(-np.euler_gamma, abs=1e-12)
    assert toda.strain_variance == pytest.approx(np.pi**2 / 6, abs=1e-12)


@pytest.mark.parametrize(
    "law, T, P, low, high",
    [
        (gx.Hertz(1.0, 1.0), 0.3, None, -20.0, 20.0),
        (gx.Hertz(2.0), 1.0, 0.05, -900.0, 12.0),
        (gx.PowerLaw(1.3, -3.0, 0.7), 0.1, 0.5, -12.0, (1.3 / 0.7) ** (1 / 3)),
        (gx.Polynomial(-1.0, 0.1, 1.0), 0.2, 0.1, -5.0, 5.0),
    ],
    ids=["hertz", "loose contacts", "magnets", "double well"],
)
def test_averages_against_a_fine_mesh(law, T, P, low, high):
    found = bond_state(law, T, P)
    e = np.linspace(low, high, 400_001)[1:-1]
    V = np.asarray(law.energy(e))
    U = (V - float(found.pressure - law.preload) * e) / T
    weight = np.exp(U.min() - U)
    mean = lambda q: simpson(q * weight, x=e) / simpson(weight, x=e)
    scale = float(found.strain_variance) ** 0.5
    # the mesh itself is good to 1e-10
    error = float(found.error) + 1e-10
    assert error < 1e-6
    assert abs(found.strain - mean(e)) < error * scale
    assert found.energy == pytest.approx(mean(V), rel=error)
    assert found.strain_variance == pytest.approx(mean((e - mean(e)) ** 2), rel=error)
    assert mean(np.asarray(law.force(e)) + law.preload) == pytest.approx(
        float(found.pressure), abs=1e-8
    )


def test_averages_in_si_and_their_derivatives():
    """The unit of length of a steel bead's contact is 1e-6 of a metre."""
    units = gx.Units(mass=1e-3, length=1e-6, time=1e-4)
    A = 1.0 * float(units.force / units.length**1.5)
    F, E = float(units.force), float(units.energy)
    scaled, si = bond_state(gx.Hertz(1.0), 0.2, 0.7), bond_state(gx.Hertz(A), 0.2 * E, 0.7 * F)
    assert si.strain / 1e-6 == pytest.approx(float(scaled.strain), rel=1e-8)
    speed = bond_state(gx.Hertz(A), 0.2 * E, 0.7 * F, mass=1e-3).sound_speed
    assert speed * 1e-4 == pytest.approx(float(scaled.sound_speed), rel=1e-8)
    mean = lambda T: bond_state(gx.Hertz(1.0, 1.0), T).strain
    slope = (mean(0.1001) - mean(0.0999)) / 2e-4
    assert jax.grad(mean)(0.1) == pytest.approx(float(slope), rel=1e-6)
    assert jax.jacfwd(mean)(0.1) == pytest.approx(float(jax.grad(mean)(0.1)), rel=1e-12)
    both = bond_state(gx.Hertz(jnp.array([1.0, 2.0]), 1.0), 0.1)
    assert both.strain.shape == (2,)
    assert both.strain[1] == pytest.approx(
        float(bond_state(gx.Hertz(2.0, 1.0), 0.1).strain), rel=1e-12
    )


# -------------------------------------------------------------------------------------------------------- Gibbs states


@pytest.mark.parametrize("seed", range(5))
def test_a_million_bonds_have_the_averages_of_quadrature(seed):
    law, T, P = gx.Polynomial(1.0, -2.0, 1.0), 0.5, 1.0
    lattice = chain(law, 1_000_001)
    state = gx.states.gibbs(lattice, T, P, seed=seed)
    want, e = bond_state(law, T, P), np.asarray(state.u[:-1] - state.u[1:])
    U = np.asarray(law.energy(e)) - P * e
    for got, mean in (
        (e, want.strain),
        (np.asarray(law.force(e)), P),
        (np.asarray(law.energy(e)), want.energy),
        ((e - e.mean()) ** 2, want.strain_variance),
        ((U - U.mean()) ** 2, want.energy_variance),
        (np.asarray(state.v) ** 2, T),
    ):
        assert abs(got.mean() - mean) < SIGMAS * got.std() / len(got) ** 0.5


def test_bonds_and_lanes_of_their_own():
    """A dimer of stiffnesses, lanes of temperatures: <F> is the preload in each, <F e> - F0 <e> is k_B T."""
    T = jnp.array([0.05, 0.4])
    stiffness = np.tile([1.0, 3.0], 2_000)
    make = lambda T: chain(gx.Hertz(stiffness + 0 * T, 1.0), 4_001)
    lattice = jax.vmap(make, out_axes=-1)(T)
    state = gx.states.gibbs(lattice, T, seed=1)
    e = state.u[:-1] - state.u[1:]
    law = lattice.terms[0].law
    virial = np.asarray(law.force(e) * e)
    for i in range(2):
        for bond in range(2):
            x = virial[bond::2, i]
            assert abs(x.mean() - T[i]) < SIGMAS * x.std() / len(x) ** 0.5


def test_hybrid_monte_carlo_on_a_ring_is_gaussian_in_a_linear_lattice():
    rings = copies(lambda k: chain(gx.Linear(k), 32, "periodic"), 512)
    state = gx.states.gibbs(rings, 2.0, seed=1)
    k = np.arange(1, 17)
    power = np.abs(np.fft.fft(np.asarray(state.u), axis=0)[1:17]) ** 2 / 32
    got = power * (4 * np.sin(np.pi * k / 32) ** 2)[:, None] / 2.0
    off = (got.mean(1) - 1) / (got.std(1) / 512**0.5)
    assert np.abs(off).max() < SIGMAS


@pytest.mark.slow
def test_the_virial_on_sites_and_in_the_plane():
    gordon = jax.vmap(lambda c: gx.scenes.klein_gordon(16, c), out_axes=-1)(jnp.full(2000, 0.2))
    state = gx.states.gibbs(gordon, 0.5, seed=1)
    virial = np.asarray(-(state.u * gordon.force(0.0, *state)).mean(0))
    assert abs(virial.mean() - 0.5) < SIGMAS * virial.std() / 2000**0.5
    plane = jax.vmap(lambda k: gx.scenes.triangular(4, 4, stiffness=k), out_axes=-1)(
        jnp.full(500, 1.0)
    )
    state = gx.states.gibbs(plane, 1e-3, seed=2)
    virial = np.asarray(-(state.u * plane.force(0.0, *state)).mean((0, 1, 2)))
    assert abs(virial.mean() / 1e-3 - 1) < SIGMAS * virial.std() / 1e-3 / 500**0.5


def test_what_has_no_equilibrium_is_refused():
    for lattice in (
        gx.scenes.fput(8, alpha=0.25),
        gx.scenes.fput(8, alpha=0.25, boundary="free"),
        gx.scenes.monomer(8, boundary="free"),
    ):
        with refused("(law|lattice): expected .* It has no thermal equilibrium"):
            gx.states.gibbs(lattice, 1.0)
    with refused("lattice: expected forces of positions alone, got Damping. A damped lattice"):
        gx.states.gibbs(chain(gx.Linear(), 8, "free", gx.Damping(0.1)), 1.0)
    with refused("pressure: expected None but for a chain between free ends"):
        gx.states.gibbs(chain(gx.Linear(), 8, "fixed"), 1.0, 2.0)
    with refused("temperature"):
        gx.states.gibbs(chain(gx.Linear(), 8), -1.0)
    # contacts that rattle between walls have one
    assert np.isfinite(gx.states.gibbs(gx.scenes.monomer(8), 1.0).u).all()


# --------------------------------------------------------------------------------------------------------------- baths


def test_baoab_has_the_moments_of_its_discrete_process():
    """The covariance of the discrete process, without sampling: <q^2> exact, <p^2> off by -h^2 omega^2/4 of itself."""
    h, rate, T = 0.5, 0.7, 2.0
    c = np.exp(-rate * h)
    kick = np.array([[1, 0], [-h / 2, 1]])
    drift = np.array([[1, h / 2], [0, 1]])
    left = kick @ drift
    A = left @ np.diag([1, c]) @ drift @ kick
    noise = left @ np.array([0, np.sqrt((1 - c * c) * T)])
    want = solve_discrete_lyapunov(A, np.outer(noise, noise))
    np.testing.assert_allclose(want, np.diag([T, T * (1 - h * h / 4)]), atol=1e-12)
    lattice = gx.Lattice(1.0, (gx.OnSite(gx.Linear()), gx.Langevin(rate, T, seed=4)), sites=4000)
    start = gx.State(lattice.zeros().at[0].set(1.0), lattice.zeros())
    # the mean of one step is A, its covariance that of the noise
    run = gx.simulate(lattice, start, h, solver=gx.VelocityVerlet(), step=h)
    got = np.stack([run.final.u[1:], run.final.v[1:]])
    np.testing.assert_allclose(
        got @ got.T / 3999, np.outer(noise, noise), atol=0.08 * noise.max() ** 2
    )
    run = gx.simulate(lattice, start, 100 * h, solver=gx.VelocityVerlet(), step=h)
    for x, mean in ((run.final.u, T), (run.final.v, T * (1 - h * h / 4))):
        x = np.asarray(x**2)
        assert abs(x.mean() - mean) < SIGMAS * x.std() / len(x) ** 0.5


@pytest.mark.parametrize("solver", [gx.SRKN6b(), gx.SRKN11b(), gx.SRKN14a()])
def test_moments_are_right_to_the_order_of_the_solver(solver):
    """One oscillator of 4e5 by a step of 0.9: the discrete covariance from the solver's own matrix."""
    h, rate, T = 0.9, 0.3, 1.0
    one = chain(gx.Linear(0.5), 2, "free")
    # u1 - u0 moves as an oscillator of frequency 1
    flow = lambda y: gx.Flow(1, solver)(gx.State(*y), 0.0, h, one)
    unit = [(jnp.array([1.0, -1.0]), jnp.zeros(2)), (jnp.zeros(2), jnp.array([1.0, -1.0]))]
    M = np.array([[x.u[0], x.v[0]] for x in map(flow, unit)]).T
    c = np.exp(-rate * h)
    B = M @ np.diag([0, np.sqrt((1 - c * c) * T)])
    want = np.diag(solve_discrete_lyapunov(M @ np.diag([1, c]), B @ B.T))
    assert np.abs(want - 1).max() < {4: 1e-3, 6: 1e-4}[solver.order(None)]
    sites = 100_000
    lattice = gx.Lattice(1.0, (gx.OnSite(gx.Linear()), gx.Langevin(rate, T, seed=2)), sites=sites)
    run = gx.simulate(lattice, gx.states.rest(lattice), 40 * h, solver=solver, step=h)
    for x, mean in zip(run.final, want):
        x = np.asarray(x**2)
        assert abs(x.mean() - mean) < SIGMAS * x.std() / len(x) ** 0.5


def between_baths(N, hot, cold, rate):
    """(flux, temperatures) of a linear chain between walls whose end sites are in baths, from Lyapunov's equation."""
    K = 2 * np.eye(N) - np.eye(N, k=1) - np.eye(N, k=-1)
    ends = np.r_[rate, np.zeros(N - 2), rate]
    A = np.block([[np.zeros((N, N)), np.eye(N)], [-K, -np.diag(ends)]])
    D = np.diag(2 * np.r_[np.zeros(N), ends * np.r_[hot, np.zeros(N - 2), cold]])
    S = solve_continuous_lyapunov(A, -D)
    return rate * (hot - S[N, N]), np.diag(S)[N:]


@pytest.mark.parametrize("N", [8, 32])
def test_flux_and_profile_between_two_baths(N):
    flux, profile = between_baths(N, 2.0, 1.0, 1.0)
    off = []
    ends = np.r_[1.0, np.zeros(N - 2), 1.0]

    def make(seed):
        bath = gx.Langevin(ends + 0.0 * seed, np.r_[2.0, np.zeros(N - 2), 1.0] + 0.0 * seed, seed)
        bond = gx.Bond(gx.Shift(1, "fixed"), gx.Linear(1.0 + 0.0 * seed))
        return gx.Lattice(1.0, (bond, bath), sites=N)

    lattice = jax.vmap(make, out_axes=-1)(jnp.arange(5))
    total = gx.Integral(lambda t, y, lattice: gx.measures.heat_current(lattice, y))
    run = gx.simulate(
        lattice, gx.states.rest(lattice), 8000.0, step=0.2, save_at=8001, record={"heat": total}
    )
    found = time_average(gx.measures.along(gx.measures.heat_current, lattice, run)[500:].mean(1))
    off = (np.asarray(found.value) - flux) / np.asarray(found.error)
    assert np.abs(off).max() < SIGMAS, off
    assert found.error.max() < 0.1 * flux
    # the integral along the run, between the steps too, says the same
    np.testing.assert_allclose(run.recorded["heat"].mean(0) / 8000, flux, rtol=0.15)
    temperature = time_average(run.vs[500:] ** 2)
    off = (np.asarray(temperature.value).mean(1) - profile) / (
        np.asarray(temperature.error).mean(1) / 5**0.5
    )
    assert np.abs(off).max() < 1.5 * SIGMAS


def test_energy_flows_as_its_density_changes():
    rng = np.random.default_rng(0)
    for lattice in (
        gx.scenes.monomer(7, precompression=1.0),
        gx.scenes.fput(7, 0.2, 1.0, boundary="periodic"),
        gx.scenes.klein_gordon(7, 0.3),
        gx.scenes.toda(7, boundary="free"),
        gx.scenes.dimer(8, ratio=0.4, precompression=0.5),
    ):
        y = gx.State(*(jnp.asarray(rng.normal(0, s, lattice.shape)) for s in (0.2, 1.0)))
        density = lambda u, v, lattice=lattice: gx.measures.site_energy(lattice, (u, v))
        change = jax.jvp(density, tuple(y), tuple(gx.vector_field(0.0, y, lattice)))[1]
        j = gx.measures.heat_current(lattice, y)
        j = jnp.concatenate([j[-1:], j]) if len(j) == len(y.u) else jnp.pad(j, 1)
        np.testing.assert_allclose(change, j[:-1] - j[1:], atol=1e-14)
    with refused("lattice: expected a chain"):
        gx.measures.heat_current(gx.scenes.square(3, 3), gx.states.rest(gx.scenes.square(3, 3)))
    far = gx.scenes.long_range(8, 2.0)
    with refused(r"terms\[0\]: expected bonds to the next site"):
        gx.measures.heat_current(far, gx.states.rest(far))


def test_baths_draw_their_own_noise_and_refuse_what_has_none():
    lattice = chain(gx.Linear(), 4, "fixed", gx.Langevin(0.5, 1.0, seed=3))
    rest = gx.states.rest(lattice)
    run = gx.simulate(lattice, rest, 10.0, step=0.1)
    again = gx.simulate(lattice, rest, 10.0, step=0.1)
    np.testing.assert_array_equal(run.final.v, again.final.v)
    other = chain(gx.Linear(), 4, "fixed", gx.Langevin(0.5, 1.0, seed=4))
    assert np.abs(gx.simulate(other, rest, 10.0, step=0.1).final.v - run.final.v).max() > 1e-3
    # lanes of one seed have noise of their own, the first of them that of a run alone, in any order of seeds
    seeds = jnp.array([3, 4, 3, 4, 3])
    make = lambda seed: chain(gx.Linear(), 4, "fixed", gx.Langevin(0.5, 1.0, seed=seed))
    lanes = jax.vmap(make, out_axes=-1)(seeds)
    many = gx.simulate(lanes, gx.states.rest(lanes), 10.0, step=0.1).final.v
    np.testing.assert_allclose(many[:, 0], run.final.v, atol=1e-13)
    np.testing.assert_allclose(
        many[:, 1], gx.simulate(other, rest, 10.0, step=0.1).final.v, atol=1e-13
    )
    assert np.ptp(np.asarray(many), 1).min() > 0.1
    assert len({x.tobytes() for x in np.asarray(many).T}) == 5
    mapped = jax.vmap(
        lambda seed: gx.simulate(make(seed), rest, 10.0, step=0.1).final.v, out_axes=-1
    )(seeds)
    np.testing.assert_allclose(mapped, many, atol=1e-13)
    # another start draws other numbers
    later = gx.simulate(lattice, rest, 20.0, t0=10.0, step=0.1)
    assert np.abs(later.final.v - run.final.v).max() > 1e-3
    for how, said in (
        (dict(tolerance=1e-6), "solver: expected a splitting solver"),
        (dict(step=0.1, confirm=True), "confirm"),
        (dict(step=0.1, adjoint=gx.Reversible()), "confirm"),
        (dict(step=0.1, save_at=[1.0, 1.7, 9.0]), "save_at: expected times at an even spacing"),
    ):
        with refused(said):
            gx.simulate(lattice, rest, 10.0, **how)
    with refused("seed: expected a whole number"):
        gx.Langevin(1.0, 1.0, seed=0.5)
    # elsewhere it is the damping that it is on average
    damped = chain(gx.Linear(), 4, "fixed", gx.Damping(0.5))
    np.testing.assert_allclose(
        gx.Flow(40)(gx.states.impact(lattice), 0.0, 3.0, lattice).v,
        gx.Flow(40)(gx.states.impact(damped), 0.0, 3.0, damped).v,
        atol=1e-14,
    )


def test_a_bath_differentiates_along_its_noise():
    def end(T, rate=0.5):
        lattice = chain(gx.Polynomial(1.0, 0.0, 1.0), 4, "fixed", gx.Langevin(rate, T, seed=3))
        return gx.simulate(lattice, gx.states.impact(lattice), 3.0, step=0.1).final.v[1]

    slope = (end(1.0001) - end(0.9999)) / 2e-4
    assert jax.grad(end)(1.0) == pytest.approx(float(slope), rel=1e-5)
    assert jax.jacfwd(end)(1.0) == pytest.approx(float(slope), rel=1e-5)


def test_two_fields_and_the_plane_have_baths():
    cells = gx.scenes.mass_in_mass(60, 0.3, 1.0, precompression=1.0)
    bath = gx.Langevin(0.5, 0.01, field="resonator")
    lattice = gx.Lattice(cells.mass, (*cells.terms, bath), sites=60)
    run = gx.simulate(lattice, gx.states.rest(lattice), 4000.0, step=0.2, save_at=801)
    for name, m in lattice.mass.items():
        got = time_average(m * jnp.mean(run.vs[name][100:] ** 2, 1))
        assert abs(got.value - 0.01) < SIGMAS * got.error
    plane = gx.scenes.square(4, 4)
    lattice = gx.Lattice(
        plane.mass, (*plane.terms, gx.Langevin(0.5, 0.01)), sites=(4, 4), dimension=2
    )
    run = gx.simulate(lattice, gx.states.rest(lattice), 4000.0, step=0.2, save_at=801)
    got = time_average(jnp.mean(run.vs[100:] ** 2, (1, 2, 3)))
    assert abs(got.value - 0.01) < SIGMAS * got.error


# ----------------------------------------------------------------------------------------------------------- transport


@pytest.mark.slow
def test_sound_of_a_thermal_chain():
    """The correlation of strains has two peaks that move with the adiabatic speed of sound."""
    law, T, N, lanes = gx.Polynomial(1.0, -2.0, 1.0), 0.5, 512, 16
    mean = bond_state(law, T, 1.0)
    # a ring is held at its mean length: the same law about its mean compression
    e, K3, K4 = float(mean.strain), -2.0, 1.0
    about = gx.Polynomial(1 + 2 * K3 * e + 3 * K4 * e * e, K3 + 3 * K4 * e, K4)
    rings = copies(
        lambda one: gx.Lattice(one, (gx.Bond(gx.Shift(1, "periodic"), about),), sites=N), lanes
    )
    state = gx.states.gibbs(rings, T, seed=5, moves=4)
    run = gx.simulate(rings, state, 3000.0, step=0.2, save_at=601)
    found = gx.measures.correlation(run.us - jnp.roll(run.us, -1, 1), dt=5.0, lags=31)
    speed, seen = float(mean.sound_speed), []
    for lag in range(12, 31, 3):
        t = float(found.lag[lag])
        # peaks are as wide as t^(2/3)
        window = np.hanning(2 * round(2 + 0.6 * t ** (2 / 3)) + 1)
        value = np.convolve(found.value[lag], window, "same")
        for side in (-1, 1):
            there = np.flatnonzero(found.offset * side > 0.5 * speed * t)
            i = there[np.argmax(value[there])]
            before, top, after = value[i - 1 : i + 2]
            place = found.offset[i] + (before - after) / (2 * (before - 2 * top + after))
            seen.append(abs(float(place)) / t)
    assert np.mean(seen) == pytest.approx(speed, rel=5e-3)


def test_conductivity_of_a_chain_with_a_known_one():
    """A current of <J(0) J(t)> = 0.9^t/0.19, in lanes and as one history."""
    rng = np.random.default_rng(0)
    slow = np.zeros((20000, 40))
    noise = rng.normal(size=slow.shape)
    for i in range(1, len(slow)):
        slow[i] = 0.9 * slow[i - 1] + noise[i]
    # <J(0) J(t)> = 0.9^t/(1 - 0.81)
    found = gx.measures.green_kubo(slow, 1.0, temperature=2.0, sites=5, lags=80)
    want = (0.5 + 0.9 / 0.1) / 0.19 / 4 / 5
    assert abs(found.conductivity[-1] - want) < SIGMAS * found.error[-1] < 0.08 * want
    one = gx.measures.green_kubo(slow[:, 0], 1.0, temperature=2.0, sites=5, lags=80)
    assert abs(one.conductivity[-1] - want) < SIGMAS * one.error[-1]
    assert one.blocks == 20 and "20 blocks" in one.outcome
    with refused("lags: expected at most"):
        gx.measures.green_kubo(slow[:, 0], 1.0, temperature=2.0, sites=5, lags=8000)


def test_correlations_of_a_wave_and_of_two_histories():
    t, n, phase = np.arange(200.0), np.arange(16), 2 * np.pi * np.arange(100) / 100
    wave = np.cos(np.pi / 4 * n[:, None] - 0.3 * t[:, None, None] + phase)
    found = gx.measures.correlation(wave, lags=20)
    want = 0.5 * np.cos(np.pi / 4 * found.offset - 0.3 * found.lag[:, None])
    np.testing.assert_allclose(found.value, want, atol=1e-12)
    cross = gx.measures.correlation(np.roll(wave, 3, 1), wave, 0.5, lags=4)
    np.testing.assert_allclose(cross.value[0], np.roll(found.value[0], 3), atol=1e-12)
    assert found.to_xarray().value.dims == ("lag", "offset")


def test_entropy_of_shares():
    assert gx.measures.spectral_entropy(np.ones(8)) == pytest.approx(np.log(8))
    assert gx.measures.spectral_entropy([1.0, 0.0, 0.0]) == 0
    assert gx.measures.effective_modes(np.ones((8, 3))) == pytest.approx(1)
    # energies of thermal modes are exponential: 1/2 + 1/3 + ..., or ln M less 1 - gamma
    energies = np.random.default_rng(0).exponential(size=(20_000, 4))
    want = np.log(20_000) - (1 - np.euler_gamma)
    np.testing.assert_allclose(gx.measures.spectral_entropy(energies), want, atol=0.02)
    with refused("energies"):
        gx.measures.spectral_entropy([-1.0, 2.0])
