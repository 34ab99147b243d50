"""Disordered chains, how far their waves reach, and how their energy spreads."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from refusals import refused

import granjax as gx

N = 8
FIXED = gx.Shift(1, "fixed")
disordered = gx.scenes.disordered


def noise(**keywords):
    return np.asarray(disordered(4000, 0.5, 1, **keywords).mass) - 1


def test_masses_are_correlated_as_they_say():
    for correlation, neighbours in (("none", 0.0), ("alike", 0.5), ("opposite", -0.5)):
        x = noise(correlation=correlation)
        assert np.abs(x).max() <= 0.5 and abs(x.mean()) < 0.02
        assert np.mean(x[1:] * x[:-1]) / x.var() == pytest.approx(neighbours, abs=0.04)
        assert abs(np.mean(x[2:] * x[:-2])) < 0.04 * x.var()
    # random dimers hold two beads that are alike, or one of either
    for correlation, sign in (("alike", 1), ("opposite", -1)):
        pairs = noise(distribution="binary", correlation=correlation).reshape(-1, 2)
        assert_array_equal(pairs[:, 0], sign * pairs[:, 1])
    assert disordered(9, 0.5, correlation="alike").mass.shape == (9,)


@pytest.mark.parametrize(
    "boundary, first, more", [("fixed", 1, 1), ("free", 0, -1), ("periodic", 0, 0)]
)
def test_what_is_random(boundary, first, more):
    made = lambda **how: disordered(N, 0.4, seed=3, precompression=2.0, boundary=boundary, **how)
    R = np.asarray(made().mass)
    assert_allclose(made(mass=2.0).mass, 2 * R)
    # the same numbers as radii: masses by the cube, contacts by 1/R* = 1/R + 1/R'
    spheres = made(of="radius")
    assert_allclose(spheres.mass, R**3)
    A = spheres.terms[0].law.stiffness
    assert_allclose(A[first], np.sqrt(2 / (1 / R[0] + 1 / R[1])))
    soft = made(of="stiffness").terms[0].law.stiffness
    assert np.ptp(soft) > 0.1 and soft.shape == A.shape == (N + more,)
    # overlaps follow from where the beads lie; between walls they add up to that of the regular chain
    moved = made(of="position").terms[0].law.rest_overlap
    d0 = 2 ** (2 / 3)
    assert_allclose(np.diff(moved)[first], 0.5 * d0 * (2 * R[1] - R[0] - R[2]), rtol=1e-10)
    assert boundary == "free" or moved.mean() == pytest.approx(d0, rel=1e-12)


def test_a_law_of_ones_own_and_units():
    chain = disordered(N, 0.4, of="stiffness", law=lambda A: gx.Polynomial(A, 0.0, A), units="SI")
    assert chain.terms[0].law.K2.shape == (N + 1,) and "1 kg" in repr(chain)
    magnets = disordered(N, 0.4, of="position", exponent=-3.0, precompression=1.0).terms[0].law
    assert (magnets.rest_overlap > 0).all() and np.ptp(magnets.rest_overlap) > 0.1


def test_realisations_are_lanes():
    chains = jax.vmap(lambda n: disordered(N, 0.3, n, of="radius"), out_axes=-1)(jnp.arange(3))
    assert chains.lanes == (3,)
    assert_array_equal(chains.mass[:, 1], disordered(N, 0.3, 1, of="radius").mass)


# how far waves reach
closed_form = gx.theory.localisation.lyapunov_exponent
length = gx.linear.localisation_length


def realisations(samples, sites, spread, **keywords):
    def one(n):
        return disordered(sites, spread, n, **{"law": gx.Linear, **keywords})

    return jax.vmap(one, out_axes=-1)(jnp.arange(samples))


def test_the_closed_form():
    light = closed_form(0.5, mass_deviation=0.2)
    assert float(light) == pytest.approx(0.04 * 0.5**2 / 8 / (1 - 0.5**2 / 4), rel=1e-12)
    assert float(light) == pytest.approx(1 / 750, rel=1e-12)
    # heavier and stiffer chains; what turns a wave back is the disorder at twice its wavenumber
    heavy = closed_form(1.0, mass=3.0, stiffness=12.0, compliance_deviation=0.2)
    assert float(heavy) == pytest.approx(1 / 750)
    k = np.pi / 3
    alone, opposite = (
        closed_form(2 * np.sin(k / 2), mass_deviation=0.1, correlations=c) for c in ([], [-0.5])
    )
    assert float(opposite / alone) == pytest.approx(1 - np.cos(2 * k))


@pytest.mark.parametrize("sites", [200, 20000])
def test_the_rounding_of_a_uniform_damped_chain_is_within_the_error(sites):
    """2 - 2 cos k = omega^2 + i omega gamma."""
    omega = np.array([1.9, 2.5])
    bond = gx.Bond(gx.Shift(1, "fixed"), gx.Linear())
    found = length(gx.Lattice(1.0, (bond, gx.Damping(3.0)), sites=sites), omega)
    decay = np.abs(np.arccos(1 - (omega**2 + 3j * omega) / 2).imag)
    assert (np.abs(found.gamma - decay) <= found.error).all() and (found.error < 1e-12).all()


@pytest.mark.slow
def test_waves_localise_as_theory_says():
    """Masses of deviation 0.2 at omega = 0.5: 1.3333e-3, within the standard error, below 3 %."""
    found = length(realisations(200, 8000, 0.2, distribution="binary"), 0.5)
    assert abs(float(found.gamma) - 1 / 750) < float(found.error) < 0.03 / 750
    assert found.samples == 200 and found.sites == 8000 and bool(found.resolved)
    assert "gamma = 0.0013" in found.outcome and "200 chains of 8000 sites" in found.outcome
    # what is expected of so many sites
    assert float(found.error) == pytest.approx(np.sqrt(1 / 750 / (200 * 8000 * 8 / 9)), rel=0.3)


@pytest.mark.parametrize("sites, spread, omega", [(40, 0.3, 1.0), (100, 0.1, 1.5), (12, 0.5, 1.5)])
def test_short_chains_localise_waves_as_long_ones_do(sites, spread, omega):
    """The norm does not oscillate along the mean chain; the last number is from 64 chains of 40000 sites."""
    found = length(realisations(20000, sites, spread), omega)
    expected = closed_form(omega, mass_deviation=spread / 3**0.5) if spread < 0.5 else 0.0507
    assert abs(float(found.gamma) - expected) < 3 * float(found.error) < 0.1 * expected


@pytest.mark.slow
@pytest.mark.parametrize("correlation, c", [("alike", 0.5), ("opposite", -0.5)])
def test_random_dimers_let_waves_pass_where_their_spectrum_is_zero(correlation, c):
    omega = jnp.array([0.5, 1.0, 1.6])
    found = length(realisations(200, 4000, 0.1, correlation=correlation), omega)
    theory = closed_form(omega, mass_deviation=0.1 / 3**0.5, correlations=[c])
    assert (np.abs(found.gamma - theory) < 2.5 * found.error).all()


@pytest.mark.slow
def test_random_dimers_of_two_masses_pass_two_waves_exactly():
    """m omega^2 = 2 K of either mass: two such beads in a row only turn the sign (Dunlap, Wu, Phillips)."""
    omega = np.sqrt(2 / np.array([1.2, 1.0, 0.8]))
    chains = realisations(200, 4000, 0.2, distribution="binary", correlation="alike")
    heavy, between, light = length(chains, omega).gamma
    assert abs(float(heavy)) < 1e-4 and abs(float(light)) < 1e-4 and float(between) > 5e-3


@pytest.mark.slow
@pytest.mark.parametrize("of, correlations", [("stiffness", []), ("position", [-0.5])])
def test_contacts_localise_as_their_linearisation_says(of, correlations):
    x = np.random.default_rng(0).uniform(-0.3, 0.3, 10**6)
    # d0^(p-1) of a Hertz contact
    softer = {"stiffness": (1 + x) ** (-2 / 3), "position": (1 + (x[:-1] - x[1:]) / 2) ** -0.5}[of]
    omega = jnp.array([0.6, 1.1])
    mean = softer.mean()
    deviation = softer.std() / mean
    how = dict(correlations=correlations, compliance_deviation=deviation)
    theory = closed_form(omega, stiffness=1.5 / mean, **how)
    chains = realisations(200, 4000, 0.3, of=of, law=None, precompression=1.0)
    found = length(chains, omega)
    assert (np.abs(found.gamma - theory) < 3 * found.error).all()


@pytest.mark.slow
def test_one_chain_tells_its_error_by_pieces_and_is_differentiable():
    def gamma(spread):
        found = length(disordered(600, spread, 3, law=gx.Linear, boundary="periodic"), 1.5)
        return found.gamma, found

    (value, found), slope = jax.value_and_grad(gamma, has_aux=True)(0.4)
    theory = closed_form(1.5, mass_deviation=0.4 / 3**0.5)
    assert abs(float(value) - float(theory)) < 3 * float(found.error)
    difference = (gamma(0.4 + 1e-5)[0] - gamma(0.4 - 1e-5)[0]) / 2e-5
    assert float(slope) == pytest.approx(float(difference), rel=1e-5)


@pytest.mark.parametrize("lanes", [1, 16])
def test_a_perfect_chain_of_two_masses_has_no_decay_to_tell(lanes):
    """In its optical band, 2 to 6^{1/2}, gamma = 0; in its gap cosh(2 gamma) = |1 - 3 w + w^2|, w = omega^2/2."""
    masses = jnp.where(jnp.arange(400) % 2 == 0, 1.0, 0.5)
    bonds = (gx.Bond(FIXED, gx.Linear(1.0)),)
    chains = jax.vmap(lambda m: gx.Lattice(m * masses, bonds), out_axes=-1)(jnp.ones(lanes))
    found = length(chains, np.linspace(2.05, 2.4, 200))
    assert not found.resolved.any() and np.abs(found.gamma / found.error).max() < 1.5
    omega = np.array([1.6, 1.8])
    gap = length(chains, omega)
    w = omega**2 / 2
    exact = np.arccosh(np.abs(1 - 3 * w + w**2)) / 2
    assert (np.abs(gap.gamma - exact) < 3 * gap.error + 1e-14).all() and gap.error.max() < 1e-8


@pytest.mark.slow
def test_nearly_equal_short_chains_tell_what_long_ones_do():
    """Two masses, each random by 2 %: 400 and 16000 sites agree within their errors."""

    def chain(n, sites):
        random = jax.random.uniform(jax.random.key(n), (sites,), minval=-0.02, maxval=0.02)
        return gx.Lattice(
            jnp.where(jnp.arange(sites) % 2 == 0, 1.0, 0.5) * (1 + random),
            (gx.Bond(FIXED, gx.Linear(1.0)),),
        )

    omega = np.array([2.05, 2.1, 2.15, 2.3])
    short, long = (
        length(jax.vmap(lambda n: chain(n, sites), out_axes=-1)(jnp.arange(64)), omega)
        for sites in (400, 16000)
    )
    error = np.hypot(short.error, long.error)
    assert (np.abs(short.gamma - long.gamma) < 2.5 * error).all() and long.resolved.all()


@pytest.mark.parametrize("stiffness, ground", [(1.0, 0.0), (-1.0, 5.0)])
def test_little_damping_of_a_short_chain_is_not_halved(stiffness, ground):
    """cos(kappa) = 1 - (omega^2 - s + i omega g)/(2 k), of a wave whose crests run either way."""
    omega = np.array([1.2, 1.7])
    terms = gx.Bond(FIXED, gx.Linear(stiffness)), gx.OnSite(gx.Linear(ground)), gx.Damping(0.003)
    found = length(gx.Lattice(1.0, terms, sites=400), omega)
    exact = np.arccos(1 - (omega**2 - ground + 0.003j * omega) / (2 * stiffness))
    assert_allclose(found.gamma, np.abs(exact.imag), rtol=2e-3)
    assert (np.abs(found.gamma - np.abs(exact.imag)) < found.error).all()


@pytest.mark.slow
def test_damping_that_vanishes_changes_no_short_disordered_chain():
    """And with some, short chains tell what a long one does."""

    def chain(n, damping, sites):
        random = jax.random.uniform(jax.random.key(n), (sites,), minval=-0.3, maxval=0.3)
        return gx.Lattice(1 + random, (gx.Bond(FIXED, gx.Linear(1.0)), gx.Damping(damping)))

    omega = np.array([0.6, 1.0, 1.4])
    none, least, some, long = (
        length(jax.vmap(lambda n: chain(n, damping, sites), out_axes=-1)(jnp.arange(lanes)), omega)
        for damping, sites, lanes in (
            (0.0, 40, 400),
            (1e-10, 40, 400),
            (1e-2, 100, 400),
            (1e-2, 4000, 16),
        )
    )
    assert_allclose(least.gamma, none.gamma, atol=1e-9)
    assert_allclose(least.error, none.error, atol=1e-9)
    assert (np.abs(some.gamma - long.gamma) < 2 * np.hypot(some.error, long.error)).all()


def test_a_wave_that_does_not_travel_decays_as_in_the_ordered_chain():
    """Above the band, and below that of sites tied to their places: cosh(gamma) = |1 - (m omega^2 - s)/(2 K)|."""
    terms = gx.Bond(FIXED, gx.Linear(3.0)), gx.OnSite(gx.Linear(0.5))
    tied = gx.Lattice(2.0, terms, sites=200)
    omega = np.array([0.3, 2.9])
    found = length(tied, omega)
    assert_allclose(found.gamma, np.arccosh(np.abs(1 - (2 * omega**2 - 0.5) / 6)), rtol=1e-7)
    still = length(tied, 1.0)
    assert not bool(still.resolved) and "No decay is seen" in still.outcome


@pytest.mark.slow
def test_energy_spreads_freely_in_the_ordered_chain():
    """Every wave has its own speed, cos(k/2), and an equal share: the second moment is half of t^2."""
    chain = disordered(260, 0.0, law=gx.Linear)
    times = 80 * np.geomspace(1 / 64, 1, 24)
    kick = gx.State(chain.zeros(), chain.zeros().at[130].set(1.0))
    run = gx.simulate(chain, kick, 80.0, save_at=times, step=0.3, solver=gx.SRKN6b())
    moment = np.asarray(gx.measures.along(gx.measures.second_moment, chain, run))
    slope = np.polyfit(np.log(times[12:]), np.log(moment[12:]), 1)[0]
    assert slope == pytest.approx(2, abs=0.005) and run.energy_error < 1e-4
    assert moment[-1] == pytest.approx(80**2 / 2, rel=0.01)


def decay(n, k, c, s, g, omega):
    """The slower decay of a wave driven at one end of a finite chain, by a dense complex matrix (NumPy)."""
    joint = k - 1j * omega * c
    D = (2 * joint + s - 1j * omega * g - omega**2) * np.eye(n)
    D -= joint * (np.eye(n, k=1) + np.eye(n, k=-1))
    u = np.abs(np.linalg.solve(D, np.eye(n)[0]))
    return -np.polyfit(np.arange(n // 8, n // 2), np.log(u[n // 8 : n // 2]), 1)[0]


LOSSES = gx.OnSite(gx.Sine(0.4)), gx.Damping(0.05), gx.Dashpot(FIXED, 0.1)


@pytest.mark.parametrize(
    "terms, omega, k, c, s, g",
    [
        ((gx.Bond(FIXED, gx.Linear(1.0)), gx.Dashpot(FIXED, 0.2)), 1.3, 1.0, 0.2, 0.0, 0.0),
        ((gx.Bond(FIXED, gx.Hertz(1.0, 1.0)), *LOSSES), 1.7, 1.5, 0.1, 0.4, 0.05),
    ],
)
def test_damping_decays_as_a_driven_chain_does(terms, omega, k, c, s, g):
    found = length(gx.Lattice(1.0, terms, sites=400), omega)
    expected = decay(400, k, c, s, g, omega)
    gamma = float(found.gamma)
    assert bool(found.resolved)
    assert abs(gamma - expected) < 3 * float(found.error) + 1e-6 * expected
    # cos(kappa) = 1 - (omega^2 - s)/(2 k), all of them complex
    kappa = np.arccos(1 - (omega**2 - s + 1j * omega * g) / (2 * (k - 1j * omega * c)))
    assert expected == pytest.approx(abs(kappa.imag), rel=1e-6)
    assert gamma == pytest.approx(expected, rel=2e-4)


@pytest.mark.slow
def test_the_loss_of_a_wave_is_differentiable_and_runs_in_lanes():
    def gamma(g):
        chain = gx.Lattice(1.0, (gx.Bond(FIXED, gx.Linear(1.0)), gx.Damping(g)), sites=2000)
        return length(chain, 1.0).gamma

    closed = lambda g: abs(np.arccos(0.5 - 0.5j * g).imag)
    slope = (closed(0.1 + 1e-5) - closed(0.1 - 1e-5)) / 2e-5
    assert float(jax.grad(gamma)(0.1)) == pytest.approx(slope, rel=1e-4)
    assert float(jax.jacfwd(gamma)(0.1)) == pytest.approx(slope, rel=1e-4)


class Gyroscopic(gx.Term):
    """Pushes neighbours by each other's velocity, one of either sign: no work is done, no law of damping."""

    def force(self, t, u, v, mass):
        return 0.2 * (jnp.pad(v[1:], (0, 1)) - jnp.pad(v[:-1], (1, 0)))


def test_a_damping_with_a_memory_is_a_complex_spring_of_the_frequency():
    """2 (1 - cos k) = omega^2 - c (-i omega)^a of equal beads, by both functions."""
    omega = 1.1
    c = 0.1
    order = 0.3
    chain = gx.Lattice(1.0, (gx.Bond(FIXED, gx.Linear()), gx.CaputoDamping(c, order)), sites=2000)
    exact = np.arccos(1 - (omega**2 - c * (-1j * omega) ** order) / 2)
    found = length(chain, omega)
    assert abs(found.gamma - abs(exact.imag)) < 5 * found.error + 1e-12
    waves = gx.linear.complex_bands(chain, omega).k[0]
    assert_allclose(np.sort_complex(waves), np.sort_complex([exact, -exact]), rtol=1e-12)


@pytest.mark.slow
def test_resonators_hang_on_their_sites():
    """In their gap the decay of the effective mass m + sum mu kappa/(kappa - mu omega^2); else NumPy's product."""
    mu = [0.2, 0.3]
    kappa = [0.5, 0.6]
    omega = 1.55
    hung = lambda omega: sum(m * k / (k - m * omega**2) for m, k in zip(mu, kappa))
    chain = gx.scenes.woodpile(20000, mu, kappa, precompression=1.0)
    exact = abs(np.arccos(1 - (1 + hung(omega)) * omega**2 / 3 + 0j).imag)
    assert abs(length(chain, omega).gamma - exact) < 1e-12
    masses = np.random.default_rng(0).uniform(0.5, 1.5, 20000)
    every = {name: jnp.broadcast_to(m, 20000) for name, m in chain.mass.items()}
    found = length(gx.Lattice(every | {"bead": masses}, chain.terms), 1.0)
    u = 1.0
    f = 0.0
    grown = []
    for m in masses[1:-1]:
        f += (m + hung(1.0)) * u
        u -= f / 1.5
        size = np.hypot(u, f)
        u = u / size
        f = f / size
        grown.append(np.log(size))
    assert abs(found.gamma - np.mean(grown[2222:])) < 0.1 * found.error
    assert found.error < 0.15 * found.gamma


def bonds(*offsets):
    return [gx.Bond(gx.Shift(n, "fixed"), gx.Linear()) for n in offsets]


def of_chain(*terms):
    return lambda: length(gx.Lattice(1.0, terms, sites=N), 0.5)


@pytest.mark.parametrize(
    "call, sentence",
    [
        (lambda: disordered(N, 0.3, of="position"), "precompression: expected a static force"),
        (
            lambda: disordered(N, 0.3, of="position", law=gx.Linear),
            "law: expected None with of='position'",
        ),
        (lambda: disordered(N, 0.3, of="radius", exponent=2.0), "exponent: expected 3/2"),
        (
            lambda: disordered(N, 0.3, law=gx.Linear, precompression=1.0),
            "precompression: expected 0 with a law",
        ),
        (lambda: closed_form([0.5, 2.0]), "omega: expected frequencies within the band"),
        (lambda: closed_form(0.5, correlations=0.5), "correlations: expected a list"),
        (lambda: length(disordered(N, 0.3), 0.5), "bonds with a stiffness at rest"),
        (lambda: length(gx.scenes.triangular(4, 4), 0.5), "a chain of scalar displacements"),
        (of_chain(*bonds(1, 2)), "further"),
        (of_chain(*bonds(1), gx.Dashpot(gx.Shift(2, "fixed"), 0.1)), "further"),
        (of_chain(*bonds(1), Gyroscopic()), "gyroscopic"),
        (of_chain(*bonds(1), gx.PlasticContact(FIXED, gx.WaltonBraun(1.0, 2.0))), "remembers"),
    ],
)
def test_what_has_no_such_waves_is_refused(call, sentence):
    with refused(sentence):
        call()
