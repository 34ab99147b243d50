"""Thermal chains: Gibbs states, heat baths, transport, against quadrature and exact covariances."""

import jax
import jax.numpy as jnp
import numpy as np
from numpy.testing import assert_allclose
from pytest import mark, param
from refusals import refused
from scipy.integrate import quad, simpson
from scipy.linalg import solve_continuous_lyapunov, solve_discrete_lyapunov

import granjax as gx
from granjax.measures import (
    along,
    correlation,
    effective_modes,
    green_kubo,
    heat_current,
    site_energy,
    spectral_entropy,
    time_average,
)
from granjax.states import gibbs, impact, rest
from granjax.theory.thermal import bond_state

SIGMAS = 4.0


def chain(law, sites, boundary="free", *terms):
    return gx.Lattice(1.0, (gx.Bond(gx.Shift(1, boundary), law), *terms), sites=sites)


def copies(make, count):
    """Lanes of equal lattices."""
    return jax.vmap(lambda zero: make(1.0 + zero), out_axes=-1)(jnp.zeros(count))


def assert_mean(samples, mean):
    """The mean of independent samples is the given one, within standard errors."""
    samples = np.asarray(samples)
    assert abs(samples.mean() - mean) < SIGMAS * samples.std() / len(samples) ** 0.5


# ---------------------------------------------------------------------------------------------------------- quadrature


@mark.slow
def test_published_averages():
    stiff = bond_state(gx.Polynomial(1.0, -2.0, 1.0), 0.5, 1.0)
    assert_allclose(stiff.sound_speed, 1.454680309, rtol=0, atol=5e-10)
    # the renormalised dispersion of the beta chain at P = 0 is its isothermal stiffness
    beta = bond_state(gx.Polynomial(1.0, 0.0, 1.0), 1.0, 0.0)
    assert_allclose(beta.strain_variance**-0.5, 1.461888448, rtol=0, atol=5e-10)
    # exp(e) of a Toda bond at P = a is Gamma-distributed
    toda = bond_state(gx.Toda(), 1.0)
    assert_allclose(toda.strain, -np.euler_gamma, rtol=0, atol=1e-12)
    assert_allclose(toda.strain_variance, np.pi**2 / 6, rtol=0, atol=1e-12)


def test_the_law_is_evaluated_once_for_all_points_of_a_rule():
    calls = []

    class Counted(gx.Toda):
        def energy(self, e):
            calls.append(e)
            return super().energy(e)

    assert_allclose(bond_state(Counted(), 1.0).strain, -np.euler_gamma, rtol=0, atol=1e-12)
    assert len(calls) < 50


@mark.slow
@mark.parametrize(
    "law, T, P, low, high",
    [
        (gx.Hertz(2.0, 0.5), 1.0, 0.05, -900.0, 12.0),
        param(
            gx.PowerLaw(1.3, -3.0, 0.7),
            0.1,
            0.5,
            -12.0,
            (1.3 / 0.7) ** (1 / 3),
            marks=mark.slow,
        ),
        (gx.Polynomial(-1.0, 0.1, 1.0), 0.2, 0.1, -5.0, 5.0),
    ],
    ids=["loose contacts", "magnets", "double well"],
)
def test_averages_against_a_fine_mesh(law, T, P, low, high):
    found = bond_state(law, T, P)
    e = np.linspace(low, high, 400_001)[1:-1]
    V = np.asarray(law.energy(e))
    U = (V - float(found.pressure - law.preload) * e) / T
    weight = np.exp(U.min() - U)
    mean = lambda q: simpson(q * weight, x=e) / simpson(weight, x=e)
    # the mesh itself is good to 1e-10
    error = float(found.error) + 1e-10
    assert error < 1e-6
    assert abs(found.strain - mean(e)) < error * float(found.strain_variance) ** 0.5
    assert_allclose(found.energy, mean(V), rtol=error)
    assert_allclose(found.strain_variance, mean((e - mean(e)) ** 2), rtol=error)
    force = np.asarray(law.force(e)) + law.preload
    assert_allclose(mean(force), found.pressure, rtol=0, atol=1e-8)


def closed_moment(law, T, P, power):
    """The integral of s^power exp(-(V - P e)/T) over the overlaps s > 0 of a contact with d0 = A = 1."""
    p = float(law.exponent)
    weight = lambda s: s**power * np.exp(-(s ** (p + 1) / (p + 1) - P * s) / T)
    end = (45 * (p + 1) * T) ** (1 / (p + 1)) + 1
    return quad(weight, 0, end, epsabs=0, epsrel=1e-12)[0]


@mark.slow
@mark.parametrize("T, P", [(100.0, 1e-3), (1e4, 1e-2)])
def test_contacts_that_are_nearly_always_open_press_all_the_same(T, P):
    law = gx.Hertz(1.0, 1.0)
    found = bond_state(law, T, P)
    # of the open contact, exp(P s/T) over s < 0, these integrals are T/P and -(T/P)^2
    overlap = closed_moment(law, T, P, 1) - (T / P) ** 2
    want = overlap / (closed_moment(law, T, P, 0) + T / P) - 1
    error = float(found.error)
    assert error < 1e-7
    assert abs(found.strain - want) < error * float(found.strain_variance) ** 0.5


@mark.slow
def test_magnets_that_are_mostly_far_apart():
    """The last cell of the mesh ends where they meet, beyond which the law is not defined."""
    A, T, P = 1.3, 100.0, 1e-3
    found = bond_state(gx.PowerLaw(A, -3.0, 0.7), T, P)
    rest = (0.7 / A) ** (-1 / 3)
    energy = lambda r: A / 2 * (r**-2 - rest**-2) - 0.7 * (rest - r)
    # the distance r = e^x, over T/P, has the density exp(-(V + P r)/T) of V without the load's energy
    weight = lambda x: np.exp(x - (A / 2 * (T / P * np.exp(x)) ** -2 / T + np.exp(x)))
    of = lambda f: quad(lambda x: f(T / P * np.exp(x)) * weight(x), -20, 4, epsabs=0, limit=200)[0]
    whole = of(lambda r: 1.0)
    error = float(found.error)
    assert error < 1e-5
    assert (
        abs(found.strain - rest + of(lambda r: r) / whole)
        < error * float(found.strain_variance) ** 0.5
    )
    assert_allclose(found.energy, of(energy) / whole, rtol=error)


@mark.slow
def test_drawn_contacts_are_closed_as_often_as_in_the_distribution():
    law = gx.PowerLaw(1.0, 4.0, 1.0)
    T = 100.0
    P = T ** (1 - 1 / 5) / 1000
    state = gibbs(chain(law, 2_000_001), T, P, seed=0)
    closed = closed_moment(law, T, P, 0)
    assert_mean(-np.diff(state.u) > -1, closed / (closed + T / P))


@mark.slow
def test_averages_scale_with_units_and_differentiate_and_take_several_laws():
    # the unit of length of a steel bead's contact is 1e-6 of a metre
    units = gx.Units(mass=1e-3, length=1e-6, time=1e-4)
    A = float(units.force / units.length**1.5)
    F = float(units.force)
    E = float(units.energy)
    scaled = bond_state(gx.Hertz(1.0), 0.2, 0.7)
    si = bond_state(gx.Hertz(A), 0.2 * E, 0.7 * F, mass=1e-3)
    assert_allclose(si.strain / 1e-6, scaled.strain, rtol=1e-8)
    assert_allclose(si.sound_speed * 1e-4, scaled.sound_speed, rtol=1e-8)
    mean = lambda T, A=1.0: bond_state(gx.Hertz(A, 1.0), T).strain
    backward = jax.grad(mean)(0.1)
    assert_allclose(backward, (mean(0.1001) - mean(0.0999)) / 2e-4, rtol=1e-6)
    assert_allclose(jax.jacfwd(mean)(0.1), backward, rtol=1e-12)
    both = mean(0.1, jnp.array([1.0, 2.0]))
    assert both.shape == (2,)
    assert_allclose(both[1], mean(0.1, 2.0), rtol=1e-12)


# -------------------------------------------------------------------------------------------------------- Gibbs states


@mark.slow
def test_a_million_bonds_have_the_averages_of_quadrature():
    law = gx.Polynomial(1.0, -2.0, 1.0)
    T = 0.5
    P = 1.0
    state = gibbs(chain(law, 1_000_001), T, P, seed=0)
    want = bond_state(law, T, P)
    e = np.asarray(state.u[:-1] - state.u[1:])
    U = np.asarray(law.energy(e)) - P * e
    assert_mean(e, want.strain)
    assert_mean(law.force(e), P)
    assert_mean(law.energy(e), want.energy)
    assert_mean((e - e.mean()) ** 2, want.strain_variance)
    assert_mean((U - U.mean()) ** 2, want.energy_variance)
    assert_mean(state.v**2, T)


@mark.slow
def test_bonds_and_lanes_have_a_virial_of_their_own_temperature():
    T = jnp.array([0.05, 0.4])
    stiffness = np.tile([1.0, 3.0], 2_000)
    make = lambda T: chain(gx.Hertz(stiffness + 0 * T, 1.0), 4_001)
    lattice = jax.vmap(make, out_axes=-1)(T)
    state = gibbs(lattice, T, seed=1)
    e = state.u[:-1] - state.u[1:]
    virial = lattice.terms[0].law.force(e) * e
    for i in range(2):
        for bond in range(2):
            assert_mean(virial[bond::2, i], T[i])


@mark.slow
def test_hybrid_monte_carlo_on_a_ring_is_gaussian_in_a_linear_lattice():
    rings = copies(lambda k: chain(gx.Linear(k), 32, "periodic"), 512)
    state = gibbs(rings, 2.0, seed=1)
    k = np.arange(1, 17)
    power = np.abs(np.fft.fft(np.asarray(state.u), axis=0)[1:17]) ** 2 / 32
    for own in power * (4 * np.sin(np.pi * k / 32) ** 2)[:, None] / 2.0:
        assert_mean(own, 1)


@mark.slow
def test_walls_draw_the_slowest_wave_of_warm_and_cold_lanes():
    """<u_n^2> from densities of bonds that close between the walls, convolved on a grid."""
    sites, T = 8, np.tile([0.05, 5.0], 2_000)
    make = lambda beta: gx.scenes.fput(sites, alpha=0.0, beta=beta, boundary="fixed")
    state = gibbs(jax.vmap(make, out_axes=-1)(jnp.ones(T.size)), T, seed=1)
    r = np.linspace(-50, 50, 4_096, endpoint=False)
    for lane in range(2):
        bond = np.fft.fft(np.fft.ifftshift(np.exp(-(r**2 / 2 + r**4 / 4) / T[lane])))
        after = lambda bonds: np.fft.fftshift(np.fft.ifft(bond**bonds).real)
        for n, u in enumerate(state.u[:, lane::2], 1):
            weight = after(n) * after(sites + 1 - n)
            assert_mean(u**2, (weight * r**2).sum() / weight.sum())


class Gravity(gx.Term):
    """A weight on every site, towards larger u."""

    weight: float

    def force(self, t, u, v, mass):
        return jnp.full_like(u, self.weight)

    def energy(self, t, u):
        return -self.weight * u


@mark.slow
def test_weak_wells_are_filled_in_short_lattices():
    """The slowest mode, that of all sites together, against quadrature and equipartition."""
    lattice = copies(lambda k: gx.scenes.klein_gordon(2, k, stiffness=0.01), 4000)
    state = gibbs(lattice, 1e-3, seed=1)
    x = np.linspace(-1, 1, 401)
    a, b = x, x[:, None]
    V = 0.005 * (a**2 + b**2) + (a**4 + b**4) / 4 + (a - b) ** 2 / 2
    weight = np.exp(-V / 1e-3)
    assert_mean(state.u.sum(0) ** 2, ((a + b) ** 2 * weight).sum() / weight.sum())
    make = lambda k: gx.scenes.square(
        3, stiffness=k, boundary="periodic", out_of_plane=True, ground=0.01
    )
    u = gibbs(copies(make, 2000), 1.0, seed=1).u
    assert_mean(u.sum((0, 1)) ** 2 * 0.01 / 9, 1)


@mark.slow
def test_a_loose_column_has_the_averages_of_quadrature():
    """The weight of the beads above presses each contact: far apart they fly slowly."""
    law = gx.Hertz(1.0)
    make = lambda m: chain(gx.Hertz(m), 2, "free", gx.Wall(law, "right"), Gravity(0.1))
    u = gibbs(copies(make, 2000), 1.0, seed=1).u
    assert_mean(u[0] - u[1], bond_state(law, 1.0, 0.1).strain)
    assert_mean(u[1], bond_state(law, 1.0, 0.2).strain)


@mark.slow
def test_a_gibbs_state_is_drawn_inside_a_program():
    make = lambda: gx.scenes.fput(2, alpha=0.0, beta=1.0, boundary="fixed")
    draw = lambda seed: gibbs(make(), 0.5, seed=seed, moves=1).u
    assert_allclose(jax.jit(draw)(3), draw(3), rtol=1e-9)


@mark.slow
@mark.parametrize(
    "make, count, T",
    [
        (lambda A: gx.scenes.monomer(8, stiffness=A), 2000, 1.0),
        (lambda k: gx.scenes.triangular(4, 4, stiffness=k), 500, 1e-3),
    ],
    ids=["contacts that rattle between walls", "plane"],
)
def test_the_virial_of_a_gibbs_state_is_its_temperature(make, count, T):
    lattice = copies(make, count)
    state = gibbs(lattice, T, seed=1)
    virial = -state.u * lattice.force(0.0, *state)
    assert_mean(virial.mean(tuple(range(virial.ndim - 1))) / T, 1)


# --------------------------------------------------------------------------------------------------------------- baths


def in_baths(sites, rate, T, seed):
    return gx.Lattice(1.0, (gx.OnSite(gx.Linear()), gx.Langevin(rate, T, seed=seed)), sites=sites)


@mark.slow
def test_baoab_has_the_moments_of_its_discrete_process():
    """<q^2> is exact, <p^2> off by -h^2 omega^2/4 of itself."""
    h = 0.5
    rate = 0.7
    T = 2.0
    c = np.exp(-rate * h)
    kick = np.array([[1, 0], [-h / 2, 1]])
    drift = np.array([[1, h / 2], [0, 1]])
    left = kick @ drift
    noise = left @ np.array([0, np.sqrt((1 - c * c) * T)])
    want = solve_discrete_lyapunov(left @ np.diag([1, c]) @ drift @ kick, np.outer(noise, noise))
    assert_allclose(want, np.diag([T, T * (1 - h * h / 4)]), atol=1e-12)
    lattice = in_baths(4000, rate, T, 4)
    run = lambda t1: gx.simulate(lattice, rest(lattice), t1, solver=gx.VelocityVerlet(), step=h)
    one = np.stack(run(h).final)
    assert_allclose(one @ one.T / 4000, np.outer(noise, noise), atol=0.08 * noise.max() ** 2)
    for x, mean in zip(run(100 * h).final, np.diag(want)):
        assert_mean(x**2, mean)


@mark.slow
@mark.parametrize("solver, within", [(gx.SRKN6b(), 1e-3), (gx.SRKN14a(), 1e-4)])
def test_moments_are_right_to_the_order_of_the_solver(solver, within):
    """The discrete covariance of an oscillator is that of the solver's own matrix."""
    h = 0.9
    rate = 0.3
    T = 1.0
    one = chain(gx.Linear(0.5), 2, "free")
    # u1 - u0 moves as an oscillator of frequency 1
    flow = lambda y: gx.Flow(1, solver)(gx.State(*y), 0.0, h, one)
    unit = [(jnp.array([1.0, -1.0]), jnp.zeros(2)), (jnp.zeros(2), jnp.array([1.0, -1.0]))]
    M = np.array([[x.u[0], x.v[0]] for x in map(flow, unit)]).T
    c = np.exp(-rate * h)
    B = M @ np.diag([0, np.sqrt((1 - c * c) * T)])
    want = np.diag(solve_discrete_lyapunov(M @ np.diag([1, c]), B @ B.T))
    assert np.abs(want - 1).max() < within
    lattice = in_baths(100_000, rate, T, 2)
    run = gx.simulate(lattice, rest(lattice), 40 * h, solver=solver, step=h)
    for x, mean in zip(run.final, want):
        assert_mean(x**2, mean)


def between_baths(N, hot, cold, rate):
    """(flux, temperatures) of a linear chain between walls whose end sites are in baths, from Lyapunov's equation."""
    K = 2 * np.eye(N) - np.eye(N, k=1) - np.eye(N, k=-1)
    ends = np.r_[rate, np.zeros(N - 2), rate]
    A = np.block([[np.zeros((N, N)), np.eye(N)], [-K, -np.diag(ends)]])
    D = np.diag(2 * np.r_[np.zeros(N), ends * np.r_[hot, np.zeros(N - 2), cold]])
    S = solve_continuous_lyapunov(A, -D)
    return rate * (hot - S[N, N]), np.diag(S)[N:]


@mark.slow
def test_flux_and_profile_between_two_baths():
    N = 8
    flux, profile = between_baths(N, 2.0, 1.0, 1.0)
    middle = np.zeros(N - 2)

    def make(seed):
        zero = 0.0 * seed
        bath = gx.Langevin(np.r_[1.0, middle, 1.0] + zero, np.r_[2.0, middle, 1.0] + zero, seed)
        return chain(gx.Linear(1.0 + zero), N, "fixed", bath)

    lattice = jax.vmap(make, out_axes=-1)(jnp.arange(5))
    total = gx.Integral(lambda t, y, lattice: heat_current(lattice, y))
    run = gx.simulate(
        lattice, rest(lattice), 8000.0, step=0.2, save_at=8001, record={"heat": total}
    )
    found = time_average(along(heat_current, lattice, run)[500:].mean(1))
    off = (np.asarray(found.value) - flux) / np.asarray(found.error)
    assert np.abs(off).max() < SIGMAS
    assert found.error.max() < 0.1 * flux
    # so is the integral along the run, between the steps too
    assert_allclose(run.recorded["heat"].mean(0) / 8000, flux, rtol=0.15)
    temperature = time_average(run.vs[500:] ** 2)
    error = np.asarray(temperature.error).mean(1) / 5**0.5
    assert np.all(np.abs(np.asarray(temperature.value).mean(1) - profile) < 1.5 * SIGMAS * error)


@mark.slow
def test_sites_in_baths_of_unequal_temperature_are_right_to_second_order():
    """Whole steps of the baths before those of the solver leave 1.63 and 1.38 for 1.73 and 1.27."""
    profile = between_baths(3, 2.0, 1.0, 0.7)[1]
    ends = np.array([1.0, 0.0, 1.0])
    make = lambda zero: chain(
        gx.Linear(), 3, "fixed", gx.Langevin(0.7 * ends + zero, np.array([2.0, 0.0, 1.0]), seed=5)
    )
    lattice = jax.vmap(make, out_axes=-1)(jnp.zeros(50_000))
    run = gx.simulate(lattice, rest(lattice), 30.0, step=0.5)
    for v, mean in zip(run.final.v, profile):
        assert_mean(v**2, mean)


@mark.slow
def test_a_record_sees_the_path_between_the_baths():
    """With the velocity after the second half bath <v^2> is 1.04 at h = 0.4."""
    mean = {"v2": gx.Integral(lambda t, y, lattice: y.v**2)}
    lattice = in_baths(2000, 1.0, 1.0, 3)
    run = gx.simulate(lattice, gibbs(lattice, 1.0, seed=1), 100.0, step=0.4, record=mean)
    assert abs(run.recorded["v2"].mean() / 100 - 1) < 0.01


@mark.slow
def test_frames_with_baths_are_the_ends_of_steps():
    """Times add up with rounding errors: a frame may belong to the next step, half a bath later."""
    lattice = shaken(3)
    save = lambda at: gx.simulate(lattice, rest(lattice), 30.0, step=0.1, save_at=at).vs
    np.testing.assert_array_equal(save(301), save("steps"))


@mark.parametrize(
    "lattice",
    [
        gx.scenes.fput(7, 0.2, 1.0, boundary="periodic"),
        gx.scenes.klein_gordon(7, 0.3),
        gx.scenes.toda(7, boundary="free"),
        gx.scenes.dimer(8, ratio=0.4, precompression=0.5),
        chain(gx.Linear(), 7, "periodic", gx.Bond(gx.Shift(1, "free"), gx.Toda(jnp.ones(6)))),
    ],
    ids=["ring", "sites in wells", "free ends", "two masses between walls", "a chain on a ring"],
)
def test_energy_flows_as_its_density_changes(lattice):
    rng = np.random.default_rng(0)
    y = gx.State(*(jnp.asarray(rng.normal(0, s, lattice.shape)) for s in (0.2, 1.0)))
    density = lambda u, v: site_energy(lattice, (u, v))
    change = jax.jvp(density, tuple(y), tuple(gx.vector_field(0.0, y, lattice)))[1]
    j = heat_current(lattice, y)
    j = jnp.concatenate([j[-1:], j]) if len(j) == len(y.u) else jnp.pad(j, 1)
    assert_allclose(change, j[:-1] - j[1:], atol=1e-14)


def shaken(seed):
    return chain(gx.Linear(), 4, "fixed", gx.Langevin(0.5, 1.0, seed=seed))


def damped():
    return chain(gx.Linear(), 4, "fixed", gx.Damping(0.5))


def speeds(lattice, t1=10.0, step=0.1, **how):
    return gx.simulate(lattice, rest(lattice), t1, step=step, **how).final.v


def bathed(*terms):
    return chain(gx.Linear(), 4, "fixed", *terms)


class Ends(gx.Langevin):
    """A bath with arguments of its own, which other units do not know."""

    def __init__(self):
        super().__init__(jnp.array([0.5, 0.0, 0.0, 0.5]), 1.0)


class Known(Ends):
    dimensions = gx.Langevin.dimensions


UNITS = gx.Units(2.0, 0.1, 3.0)


def test_a_bath_of_one_s_own_that_has_dimensions_is_one_in_other_units():
    bath = Known().in_units(UNITS)
    assert isinstance(bath, gx.Langevin)
    assert_allclose(bath.rate, 3.0 * Known().rate, rtol=1e-15)
    # an energy of 2 (0.1/3)^2 is the unit
    assert_allclose(bath.temperature, 900 / 2, rtol=1e-15)


def current_at_rest(lattice):
    return heat_current(lattice, rest(lattice))


@mark.slow
def test_a_bath_s_noise_is_that_of_its_seed_in_every_lane():
    own = speeds(shaken(3))
    np.testing.assert_array_equal(speeds(shaken(3)), own)
    other = speeds(shaken(4))
    assert np.abs(other - own).max() > 1e-3
    # another start draws other numbers
    assert np.abs(speeds(shaken(3), 20.0, t0=10.0) - own).max() > 1e-3
    # lanes of one seed have noise of their own, the first of them that of a run alone
    seeds = jnp.array([3, 4, 3, 4, 3])
    many = np.asarray(speeds(jax.vmap(shaken, out_axes=-1)(seeds)))
    assert_allclose(many[:, :2], np.stack([own, other], 1), atol=1e-13)
    assert np.ptp(many, 1).min() > 0.1 and len({x.tobytes() for x in many.T}) == 5
    mapped = jax.vmap(lambda seed: speeds(shaken(seed)), out_axes=-1)(seeds)
    assert_allclose(mapped, many, atol=1e-13)


@mark.parametrize(
    "call, said",
    [
        (lambda: gibbs(gx.scenes.fput(8, alpha=0.25), 1.0), "no thermal equilibrium"),
        (lambda: shaken(jnp.arange(3)), r"\(Langevin\): seed: expected one number, got shape"),
        (
            lambda: gibbs(gx.scenes.monomer(8, boundary="free"), 1.0),
            "no thermal equilibrium",
        ),
        (
            lambda: gibbs(chain(gx.Hertz(1.0), 6, "free", gx.Wall(gx.Hertz(1.0), "right")), 1.0),
            "lattice that its forces hold",
        ),
        (
            lambda: gibbs(chain(gx.Linear(), 6, "free", Gravity(0.1)), 1.0),
            "lattice that its forces hold",
        ),
        (
            lambda: gibbs(gx.scenes.triangular(3, boundary="free", exponent=1.5), 1.0),
            "lattice that its forces hold",
        ),
        # one bond among others that is not bounded
        (
            lambda: gibbs(
                chain(gx.Polynomial(1.0, 0.0, np.where(np.arange(9) == 4, -1.0, 1.0)), 8, "fixed"),
                0.5,
            ),
            "no lower bound",
        ),
        (lambda: gibbs(damped(), 1.0), "lattice: .* Damping"),
        (lambda: gibbs(shaken(3), 1.0, 2.0), "pressure: expected None"),
        (lambda: current_at_rest(gx.scenes.square(3, 3)), "lattice: expected a chain"),
        (lambda: current_at_rest(gx.scenes.long_range(8, 2.0)), r"terms\[0\]: expected bonds"),
        (lambda: speeds(shaken(3), tolerance=1e-6, step=None), "solver: expected a splitting"),
        (lambda: speeds(shaken(3), confirm=True), "confirm"),
        (lambda: speeds(shaken(3), adjoint=gx.Reversible()), "confirm"),
        (lambda: speeds(shaken(3), save_at=[1.0, 1.7, 9.0]), "save_at: .* even spacing"),
        (
            lambda: speeds(
                shaken(3), solver=gx.VelocityVerlet(), record={"e": gx.Peak(site_energy)}
            ),
            "record: .* with VelocityVerlet",
        ),
        (lambda: gx.Langevin(1.0, 1.0, seed=0.5), "seed: expected a whole number"),
        (
            lambda: speeds(bathed(gx.Modulated(gx.Langevin(0.5, 1.0), lambda t: 1.0))),
            r"terms\[1\] \(Modulated\): expected a heat bath that is a term itself",
        ),
        (
            lambda: speeds(gx.scenes.scaled(bathed(Ends()), units=UNITS).lattice),
            "needs dimensions = gx.Langevin.dimensions",
        ),
        (
            lambda: speeds(bathed(gx.Langevin(0.5, 1.0), gx.CaputoDamping(0.1, 0.5))),
            "no heat baths for a lattice whose forces read the past",
        ),
    ],
)
def test_what_has_no_equilibrium_current_or_noise_is_refused(call, said):
    with refused(said):
        call()


def test_a_bath_without_noise_is_the_damping_that_it_is_on_average():
    ends = [gx.Flow(40)(impact(lattice), 0.0, 3.0, lattice).v for lattice in (shaken(3), damped())]
    assert_allclose(*ends, atol=1e-14)


@mark.slow
def test_a_bath_differentiates_along_its_noise():
    def end(T):
        lattice = chain(gx.Polynomial(1.0, 0.0, 1.0), 4, "fixed", gx.Langevin(0.5, T, seed=3))
        return gx.simulate(lattice, impact(lattice), 3.0, step=0.1).final.v[1]

    slope = float(end(1.0001) - end(0.9999)) / 2e-4
    assert_allclose(jax.grad(end)(1.0), slope, rtol=1e-5)
    assert_allclose(jax.jacfwd(end)(1.0), slope, rtol=1e-5)


@mark.slow
@mark.parametrize(
    "lattice, sites, how",
    [
        (gx.scenes.mass_in_mass(30, 0.3, 1.0, precompression=1.0), 30, dict(field="resonator")),
        (gx.scenes.square(4, 4), (4, 4), {}),
    ],
    ids=["two fields", "plane"],
)
def test_two_fields_and_the_plane_have_the_temperature_of_their_bath(lattice, sites, how):
    terms = (*lattice.terms, gx.Langevin(0.5, 0.01, **how))
    warm = gx.Lattice(lattice.mass, terms, sites=sites, dimension=lattice.dimension)
    run = gx.simulate(warm, rest(warm), 4000.0, step=0.2, save_at=801)
    for m, v in zip(jax.tree.leaves(warm.mass), jax.tree.leaves(run.vs), strict=True):
        got = time_average(m * jnp.mean(v[100:] ** 2, tuple(range(1, v.ndim))))
        assert abs(got.value - 0.01) < SIGMAS * got.error


# ----------------------------------------------------------------------------------------------------------- transport


@mark.slow
def test_conductivity_of_a_current_with_a_known_correlation():
    rng = np.random.default_rng(0)
    slow = np.zeros((20000, 40))
    noise = rng.normal(size=slow.shape)
    for i in range(1, len(slow)):
        slow[i] = 0.9 * slow[i - 1] + noise[i]
    # <J(0) J(t)> = 0.9^t/(1 - 0.81)
    want = (0.5 + 0.9 / 0.1) / 0.19 / 4 / 5
    how = dict(temperature=2.0, sites=5, lags=80)
    found = green_kubo(slow, 1.0, **how)
    assert abs(found.conductivity[-1] - want) < SIGMAS * found.error[-1] < 0.08 * want
    # of one history, in blocks
    one = green_kubo(slow[:, 0], 1.0, **how)
    assert abs(one.conductivity[-1] - want) < SIGMAS * one.error[-1]
    assert one.blocks == 20 and "20 blocks" in one.outcome
    with refused("lags: expected at most"):
        green_kubo(slow[:, 0], 1.0, **how | dict(lags=8000))
    with refused("temperature: expected one number, or one per lane"):
        green_kubo(slow, 1.0, **how | dict(temperature=np.ones(3)))


@mark.slow
def test_a_gibbs_state_of_a_lattice_in_float32_has_its_type():
    lattice = gx.scenes.fput(2, alpha=0.0, beta=1.0, boundary="fixed").astype(jnp.float32)
    found = gx.states.gibbs(lattice, 0.5, seed=1, moves=1)
    assert found.u.dtype == found.v.dtype == jnp.float32
    free = gx.scenes.fput(9, alpha=0.0, beta=1.0, boundary="free").astype(jnp.float32)
    assert gibbs(free, 1.0).u.dtype == jnp.float32


@mark.slow
def test_conductivity_in_si_units_in_float32():
    noise = np.random.default_rng(0).normal(size=400)
    want = green_kubo(noise, 1.0, temperature=4e-3, sites=1, lags=5)
    J, dt, T = (jnp.asarray(x, jnp.float32) for x in (1e-18 * noise, 1e-6, 4e-21))
    found = green_kubo(J, dt, temperature=T, sites=1, lags=5)
    assert found.conductivity.dtype == jnp.float32
    assert_allclose(found.conductivity, 1e-6 * want.conductivity, rtol=1e-5)
    assert_allclose(found.correlation / 1e-36, want.correlation, rtol=1e-5, atol=0.02)


def test_correlations_of_a_wave_and_of_two_histories():
    t = np.arange(200.0)
    n = np.arange(16)
    phase = 2 * np.pi * np.arange(100) / 100
    wave = np.cos(np.pi / 4 * n[:, None] - 0.3 * t[:, None, None] + phase)
    found = correlation(wave, lags=20)
    want = 0.5 * np.cos(np.pi / 4 * found.offset - 0.3 * found.lag[:, None])
    assert_allclose(found.value, want, atol=1e-12)
    cross = correlation(np.roll(wave, 3, 1), wave, 0.5, lags=4)
    assert_allclose(cross.value[0], np.roll(found.value[0], 3), atol=1e-12)
    assert found.to_xarray().value.dims == ("lag", "offset")


@mark.slow
def test_correlations_keep_how_lanes_and_parts_of_a_history_differ():
    # the same wave on lanes at levels d: their variance is added everywhere, with its own error
    t = np.arange(200.0)[:, None, None]
    wave = np.cos(np.pi / 4 * np.arange(16)[:, None] - 0.3 * t)
    d = np.random.default_rng(1).normal(size=50)
    found = correlation(wave + d + 3.0, lags=20)
    squares = (d - d.mean()) ** 2
    without = correlation(np.repeat(wave, 2, 2), lags=20).value
    assert_allclose(found.value, without + squares.mean(), atol=1e-12)
    assert_allclose(found.error, squares.std(ddof=1) / 50**0.5, atol=1e-12)
    # one lane that all sites share: one turn in 20 parts
    slow = np.cos(2 * np.pi * np.arange(4000) / 4000)
    assert_allclose(correlation(np.repeat(slow[:, None], 4, 1), lags=1).value, 0.5, atol=1e-12)
    # velocities of a thermal state: variance 1, and no correlation of different sites
    v = np.random.default_rng(0).normal(size=(1, 16, 20_000))
    found = correlation(v, lags=1)
    off = (found.value[0] - (found.offset == 0)) / found.error[0]
    assert np.abs(off).max() < 4 and abs(found.value[0].sum() - 1) < 4 * 0.01


def test_entropy_of_shares():
    assert_allclose(spectral_entropy(np.ones(8)), np.log(8))
    assert spectral_entropy([1.0, 0.0, 0.0]) == 0
    assert np.isnan(spectral_entropy(np.zeros(3)))
    assert_allclose(effective_modes(np.ones((8, 3))), 1)
    # energies of thermal modes are exponential: 1/2 + 1/3 + ..., or ln M less 1 - gamma
    energies = np.random.default_rng(0).exponential(size=(20_000, 4))
    want = np.log(20_000) - (1 - np.euler_gamma)
    assert_allclose(spectral_entropy(energies), want, atol=0.02)
    with refused("energies"):
        spectral_entropy([-1.0, 2.0])


class Gap(gx.Law):
    """A contact that closes at the overlap 1."""

    def force(self, e):
        return gx.laws.plus_power(e - 1, 1.5)

    def energy(self, e):
        return 0.4 * gx.laws.plus_power(e - 1, 2.5)


@mark.slow
def test_two_beads_between_walls_that_rarely_touch():
    """The mean force of the first wall, by quadrature over both places."""
    T = 0.01
    pair = gx.Lattice(1.0, gx.Bond(gx.Shift(1, "fixed"), Gap()), sites=2)
    u = np.linspace(-4, 4, 2001)
    weight = lambda e: np.exp(-0.4 * np.maximum(e - 1, 0) ** 2.5 / T)
    inner = weight(u[:, None] - u) @ weight(u)
    force = np.maximum(-u - 1, 0) ** 1.5
    want = (force * weight(-u)) @ inner / (weight(-u) @ inner)
    draw = jax.jit(jax.vmap(lambda seed: gibbs(pair, T, seed=seed).u, out_axes=-1))
    first, second = np.asarray(draw(jnp.arange(20000)))
    forces = [np.maximum(e - 1, 0) ** 1.5 for e in (-first, first - second, second)]
    mean = np.mean(forces, 0)
    assert abs(mean.mean() - want) < 4 * mean.std() / np.sqrt(mean.size) < 0.1 * want
