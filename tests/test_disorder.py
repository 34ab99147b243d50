"""Disordered chains, how far their waves reach, and how their energy spreads."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from gallery import left_by
from numpy.testing import assert_allclose, assert_array_equal
from refusals import refused

import granjax as gx

N = 8
disordered = gx.scenes.disordered


def noise(**keywords):
    return np.asarray(disordered(4000, 0.5, 1, **keywords).mass) - 1


@pytest.mark.parametrize(
    "correlation, neighbours", [("none", 0.0), ("alike", 0.5), ("opposite", -0.5)]
)
def test_dimers_are_correlated_as_they_say(correlation, neighbours):
    x = noise(correlation=correlation)
    assert np.abs(x).max() <= 0.5 and abs(x.mean()) < 0.02
    assert np.mean(x[1:] * x[:-1]) / x.var() == pytest.approx(neighbours, abs=0.04)
    assert abs(np.mean(x[2:] * x[:-2])) < 0.04 * x.var()


def test_random_dimers_hold_two_beads_that_are_alike_or_one_of_either():
    pairs = noise(distribution="binary", correlation="alike").reshape(-1, 2)
    assert_array_equal(pairs[:, 0], pairs[:, 1])
    pairs = noise(distribution="binary", correlation="opposite").reshape(-1, 2)
    assert_array_equal(pairs[:, 0], -pairs[:, 1])
    assert disordered(9, 0.5, correlation="alike").mass.shape == (9,)


ENDS = ["fixed", *(pytest.param(x, marks=pytest.mark.slow) for x in ("free", "periodic"))]


@pytest.mark.parametrize("boundary", ENDS)
def test_what_is_random(boundary):
    common = dict(seed=3, precompression=2.0, boundary=boundary)
    mass = disordered(N, 0.4, mass=2.0, **common)
    R = np.asarray(disordered(N, 0.4, **common).mass)
    assert_allclose(mass.mass, 2 * R)
    # the same numbers as radii: masses by the cube, contacts by 1/R* = 1/R + 1/R'
    spheres = disordered(N, 0.4, of="radius", **common)
    assert_allclose(spheres.mass, R**3)
    A = np.asarray(spheres.terms[0].law.stiffness)
    first = {"fixed": 1, "free": 0, "periodic": 0}[boundary]
    assert_allclose(A[first], np.sqrt(2 / (1 / R[0] + 1 / R[1])))
    assert len(A) == N + {"fixed": 1, "free": -1, "periodic": 0}[boundary]
    soft = disordered(N, 0.4, of="stiffness", **common)
    assert (
        np.ptp(soft.terms[0].law.stiffness) > 0.1 and soft.terms[0].law.stiffness.shape == A.shape
    )
    # overlaps follow from where the beads lie; between walls they add up to that of the regular chain
    moved = disordered(N, 0.4, of="position", **common).terms[0].law
    d0 = 2 ** (2 / 3)
    assert_allclose(
        np.diff(moved.rest_overlap)[first], 0.5 * d0 * (2 * R[1] - R[0] - R[2]), rtol=1e-10
    )
    if boundary != "free":
        assert moved.rest_overlap.mean() == pytest.approx(d0, rel=1e-12)


def test_a_law_of_ones_own_and_units():
    chain = disordered(N, 0.4, of="stiffness", law=lambda A: gx.Polynomial(A, 0.0, A), units="SI")
    assert chain.terms[0].law.K2.shape == (N + 1,) and "1 kg" in repr(chain)
    magnets = disordered(N, 0.4, of="position", exponent=-3.0, precompression=1.0).terms[0].law
    assert (magnets.rest_overlap > 0).all() and np.ptp(magnets.rest_overlap) > 0.1


@pytest.mark.parametrize(
    "keywords, sentence",
    [
        (dict(of="position"), "precompression: expected a static force above zero"),
        (dict(of="position", law=gx.Linear), "law: expected None with of='position'"),
        (dict(of="radius", exponent=2.0), "exponent: expected 3/2"),
        (dict(law=gx.Linear, precompression=1.0), "precompression: expected 0 with a law"),
    ],
)
def test_scenes_refused(keywords, sentence):
    with refused(sentence):
        disordered(N, 0.3, **keywords)


def test_realisations_are_lanes():
    chains = jax.vmap(lambda n: disordered(N, 0.3, n, of="radius"), out_axes=-1)(jnp.arange(3))
    assert chains.lanes == (3,)
    assert_array_equal(chains.mass[:, 1], disordered(N, 0.3, 1, of="radius").mass)


# how far waves reach
closed_form = gx.theory.localisation.lyapunov_exponent


def realisations(samples, sites, spread, first=0, **keywords):
    def one(n):
        return disordered(sites, spread, n, **{"law": gx.Linear, **keywords})

    return jax.vmap(one, out_axes=-1)(first + jnp.arange(samples))


def test_the_closed_form():
    assert float(closed_form(0.5, mass_deviation=0.2)) == pytest.approx(1 / 750, rel=1e-12)
    assert float(closed_form(0.5, mass_deviation=0.2)) == pytest.approx(
        0.04 * 0.5**2 / 8 / (1 - 0.5**2 / 4), rel=1e-12
    )
    # heavier and stiffer chains; what turns a wave back is the disorder at twice its wavenumber
    assert float(
        closed_form(1.0, mass=3.0, stiffness=12.0, compliance_deviation=0.2)
    ) == pytest.approx(1 / 750)
    k = np.pi / 3
    alone, opposite = (
        closed_form(2 * np.sin(k / 2), mass_deviation=0.1, correlations=c) for c in ([], [-0.5])
    )
    assert float(opposite / alone) == pytest.approx(1 - np.cos(2 * k))
    with refused("omega: expected frequencies within the band"):
        closed_form([0.5, 2.0])
    with refused("correlations: expected a list"):
        closed_form(0.5, correlations=0.5)


@pytest.mark.parametrize("first, errors", [(0, 1), (1000, 2)])
def test_waves_localise_as_theory_says(first, errors):
    """Masses of deviation 0.2 at omega = 0.5: 1.3333e-3, within the standard error (two of other seeds), below 3 %."""
    found = gx.linear.localisation_length(
        realisations(200, 8000, 0.2, first, distribution="binary"), 0.5
    )
    assert abs(float(found.gamma) - 1 / 750) < errors * float(found.error) < errors * 0.03 / 750
    assert found.samples == 200 and found.sites == 8000 and bool(found.resolved)
    assert "gamma = 0.0013" in found.outcome and "200 chains of 8000 sites" in found.outcome
    # what is expected of so many sites
    assert float(found.error) == pytest.approx(np.sqrt(1 / 750 / (200 * 8000 * 8 / 9)), rel=0.3)


@pytest.mark.slow
@pytest.mark.parametrize(
    "keywords, correlations",
    [({}, []), ({"correlation": "alike"}, [0.5]), ({"correlation": "opposite"}, [-0.5])],
)
def test_random_dimers_let_waves_pass_where_their_spectrum_is_zero(keywords, correlations):
    omega = jnp.array([0.5, 1.0, 1.6])
    found = gx.linear.localisation_length(realisations(200, 4000, 0.1, **keywords), omega)
    theory = closed_form(omega, mass_deviation=0.1 / 3**0.5, correlations=correlations)
    assert (np.abs(found.gamma - theory) < 2.5 * found.error).all()


@pytest.mark.slow
def test_random_dimers_of_two_masses_pass_two_waves_exactly():
    """m omega^2 = 2 K of either mass: two such beads in a row only turn the sign (Dunlap, Wu, Phillips)."""
    omega = np.sqrt(2 / np.array([1.2, 1.0, 0.8]))
    chains = realisations(200, 4000, 0.2, distribution="binary", correlation="alike")
    heavy, between, light = gx.linear.localisation_length(chains, omega).gamma
    assert abs(float(heavy)) < 1e-4 and abs(float(light)) < 1e-4 and float(between) > 5e-3


@pytest.mark.slow
@pytest.mark.parametrize("of, correlations", [("stiffness", []), ("position", [-0.5])])
def test_contacts_localise_as_their_linearisation_says(of, correlations):
    x = np.random.default_rng(0).uniform(-0.3, 0.3, 10**6)
    # d0^(p-1) of a Hertz contact
    softer = {"stiffness": (1 + x) ** (-2 / 3), "position": (1 + (x[:-1] - x[1:]) / 2) ** -0.5}[of]
    omega = jnp.array([0.6, 1.1])
    theory = closed_form(
        omega,
        stiffness=1.5 / softer.mean(),
        correlations=correlations,
        compliance_deviation=softer.std() / softer.mean(),
    )
    found = gx.linear.localisation_length(
        realisations(200, 4000, 0.3, of=of, law=None, precompression=1.0), omega
    )
    assert (np.abs(found.gamma - theory) < 3 * found.error).all()


@pytest.mark.slow
def test_one_chain_tells_its_error_by_pieces_and_is_differentiable():
    def gamma(spread):
        found = gx.linear.localisation_length(
            disordered(600, spread, 3, law=gx.Linear, boundary="periodic"), 1.5
        )
        return found.gamma, found

    (value, found), slope = jax.value_and_grad(gamma, has_aux=True)(0.4)
    assert abs(float(value) - float(closed_form(1.5, mass_deviation=0.4 / 3**0.5))) < 3 * float(
        found.error
    )
    difference = (gamma(0.4 + 1e-5)[0] - gamma(0.4 - 1e-5)[0]) / 2e-5
    assert float(slope) == pytest.approx(float(difference), rel=1e-5)


def test_a_wave_that_does_not_travel_decays_as_in_the_ordered_chain():
    """Above the band, and below that of sites tied to their places: cosh(gamma) = |1 - (m omega^2 - s)/(2 K)|."""
    tied = gx.Lattice(
        2.0, (gx.Bond(gx.Shift(1, "fixed"), gx.Linear(3.0)), gx.OnSite(gx.Linear(0.5))), sites=200
    )
    omega = np.array([0.3, 2.9])
    found = gx.linear.localisation_length(tied, omega)
    assert_allclose(found.gamma, np.arccosh(np.abs(1 - (2 * omega**2 - 0.5) / 6)), rtol=1e-7)
    still = gx.linear.localisation_length(tied, 1.0)
    assert not bool(still.resolved) and "No decay is seen" in still.outcome


@pytest.mark.parametrize(
    "lattice, sentence",
    [
        (lambda: disordered(N, 0.3), "bonds with a stiffness at rest"),
        (lambda: gx.scenes.triangular(4, 4), "a chain of scalar displacements"),
        (
            lambda: gx.Lattice(
                1.0, tuple(gx.Bond(gx.Shift(n, "fixed"), gx.Linear()) for n in (1, 2)), sites=N
            ),
            "further",
        ),
    ],
)
def test_lattices_without_such_waves_are_refused(lattice, sentence):
    with refused(sentence):
        gx.linear.localisation_length(lattice(), 0.5)


# how energy spreads: one program for the ordered chain and the strongly disordered one
SPREAD, T1 = 0.9, 80.0
TIMES = T1 * np.geomspace(1 / 64, 1, 24)


def ordered_or_not(seed):
    return disordered(
        260, jnp.where(seed < 1000, 0.0, SPREAD), seed, law=gx.Linear, distribution="binary"
    )


@functools.cache
def spread(seed=1000, samples=64, **keywords):
    seeds = seed + np.arange(samples)
    return left_by("superdiffusion").moments(
        ordered_or_not, seeds, TIMES, 0.3, chunk=32, **keywords
    )


def told(of, samples, window=(T1 / 8, T1), times=TIMES):
    """A number of the samples' mean by the name of the script's function, and its standard error."""
    device = left_by("superdiffusion")
    return device.fitted(getattr(device, of) if isinstance(of, str) else of, times, samples, window)


@pytest.mark.slow
def test_energy_spreads_freely_in_the_ordered_chain():
    found = spread(0, 32)
    assert told("slope", found)[0] == pytest.approx(2, abs=0.005)
    change, uncertain = told("drift", found)
    assert abs(change) + 2 * uncertain < 0.075
    # every wave at its own speed, cos(k/2), of equal shares: half of t^2
    assert found.mean(0)[-1] == pytest.approx(T1**2 / 2, rel=0.01)
    chain = ordered_or_not(0)
    kick = chain.zeros().at[130].set(1.0)
    run = gx.simulate(chain, gx.State(chain.zeros(), kick), T1, step=0.3, solver=gx.SRKN6b())
    share = np.asarray(gx.measures.site_energy(chain, run.final))
    ends = (share[0] + share[-1]) / share.sum() * 130**2 / found.mean(0)[-1]
    assert ends < 1e-12 and run.energy_error < 1e-4


@pytest.mark.slow
def test_disorder_slows_it_down_to_three_halves():
    found = spread()
    exponent, error = told("slope", found)
    assert len(found) == 64 and exponent < 1.75 and told("slope", found, (TIMES[-4], T1))[0] < 1.65
    # the bootstrap says what the scatter between halves of the samples says
    one, two = (
        np.polyfit(np.log(TIMES[12:]), np.log(half.mean(0)[12:]), 1)[0]
        for half in (found[:32], found[32:])
    )
    assert abs(one - two) < 4 * 2 * error
    assert told("slope", found, (20.0, T1))[0] < exponent


@pytest.mark.slow
def test_energy_that_reaches_the_ends_is_refused():
    with pytest.raises(AssertionError, match="waves have reached the ends"):
        spread(0, 32, displaced=True, site=10)


def beside_constant(x, y):
    """gamma of A t^gamma + B over x = log t, by least squares of relative deviations; a fit for each row of y."""
    grid = np.linspace(0.02, 3.0, 597)
    rows = np.atleast_2d(y)
    weight = 1 / rows[0]
    basis = (
        np.stack([np.exp(grid[:, None] * (x - x[-1])), np.ones((len(grid), len(x)))], -1)
        * weight[:, None]
    )
    basis = np.linalg.qr(basis)[0]
    seen = np.einsum("gka,dk->gda", basis, rows * weight)
    left = ((rows * weight) ** 2).sum(1) - (seen**2).sum(-1)
    least = np.clip(left.argmin(0), 1, len(grid) - 2)
    before, here, after = (left[least + k, np.arange(len(rows))] for k in (-1, 0, 1))
    found = grid[least] + (grid[1] - grid[0]) * (before - after) / (2 * (before - 2 * here + after))
    return found if np.ndim(y) > 1 else found[0]


@pytest.mark.study
def test_a_thousand_samples():
    """After a kick of momentum 3/2; after a displacement 1/2 beside a constant, while the plain slope still falls."""

    def many(sites, spread, displaced, t1, step):
        def chain(seed):
            return disordered(sites, spread, seed, law=gx.Linear, distribution="binary")

        times = t1 * np.geomspace(1 / 64, 1, 40)
        found = left_by("superdiffusion").moments(
            chain, np.arange(1000), times, step, displaced=displaced, chunk=100
        )
        return found, times

    found, times = many(2300, 0.7, False, 1000.0, 0.5)
    window = (1000 / 8, 1000.0)
    (exponent, error), (change, uncertain) = (
        told(of, found, window, times) for of in ("slope", "drift")
    )
    assert abs(change) + 2 * uncertain <= 0.075 and abs(exponent - 1.5) < 0.04 and error < 0.005
    found, times = many(2740, 0.9, True, 1200.0, 0.3)
    change, uncertain = told("drift", found, (150.0, 1200.0), times)
    assert abs(change) - 2 * uncertain > 0.075
    assert told("slope", found, (times[-4], 1200.0), times)[0] < 0.66
    late, error = told(beside_constant, found, (300.0, 1200.0), times)
    assert abs(late - 0.5) < 2 * error < 0.1


def decay(mass, k, c, s, g, omega):
    """The slower decay of a wave driven at one end of a finite chain, by a dense complex matrix (NumPy)."""
    n = len(mass)
    D = np.zeros((n, n), complex)
    joint = k - 1j * omega * c
    for i in range(n):
        D[i, i] = joint[i] + joint[i + 1] + s[i] - 1j * omega * g[i] - mass[i] * omega**2
    D += np.diag(-joint[1:-1], 1) + np.diag(-joint[1:-1], -1)
    u = np.abs(np.linalg.solve(D, np.eye(n)[0]))
    return np.polyfit(np.arange(n // 8, n // 2), np.log(u[n // 8 : n // 2]), 1)[0] * -1


N_LOSSY = 400
FIXED = gx.Shift(1, "fixed")


@pytest.mark.parametrize(
    "terms, omega, parts",
    [
        # K_n, c_n, S_n, g_n
        ((gx.Bond(FIXED, gx.Linear(1.0)), gx.Damping(0.1)), 1.0, (1.0, 0.0, 0.0, 0.1)),
        ((gx.Bond(FIXED, gx.Linear(1.0)), gx.Dashpot(FIXED, 0.2)), 1.3, (1.0, 0.2, 0.0, 0.0)),
        (
            (
                gx.Bond(FIXED, gx.Hertz(1.0, 1.0)),
                gx.OnSite(gx.Sine(0.4)),
                gx.Damping(0.05),
                gx.Dashpot(FIXED, 0.1),
            ),
            1.7,
            (1.5, 0.1, 0.4, 0.05),
        ),
    ],
)
def test_damping_decays_as_a_driven_chain_does(terms, omega, parts):
    chain = gx.Lattice(1.0, terms, sites=N_LOSSY)
    found = gx.linear.localisation_length(chain, omega)
    k, c, s, g = (np.full(N_LOSSY + 1, x) for x in parts)
    expected = decay(np.ones(N_LOSSY), k, c, s, g, omega)
    assert (
        bool(found.resolved)
        and abs(float(found.gamma) - expected) < 3 * float(found.error) + 1e-6 * expected
    )
    # cos(kappa) = 1 - (omega^2 - s)/(2 k), all of them complex
    kappa = np.arccos(
        1 - (omega**2 - parts[2] + 1j * omega * parts[3]) / (2 * (parts[0] - 1j * omega * parts[1]))
    )
    assert expected == pytest.approx(abs(kappa.imag), rel=1e-6)
    assert float(found.gamma) == pytest.approx(expected, rel=2e-4)


def test_the_loss_of_a_wave_is_differentiable_and_runs_in_lanes():
    def gamma(g):
        chain = gx.Lattice(1.0, (gx.Bond(FIXED, gx.Linear(1.0)), gx.Damping(g)), sites=2000)
        return gx.linear.localisation_length(chain, 1.0).gamma

    closed = lambda g: abs(np.arccos(0.5 - 0.5j * g).imag)
    slope = (closed(0.1 + 1e-5) - closed(0.1 - 1e-5)) / 2e-5
    assert float(jax.grad(gamma)(0.1)) == pytest.approx(slope, rel=1e-4)
    assert float(jax.jacfwd(gamma)(0.1)) == pytest.approx(slope, rel=1e-4)


class Gyroscopic(gx.Term):
    """Pushes neighbours by each other's velocity, one of either sign: no work is done, no law of damping."""

    def force(self, t, u, v, mass):
        return 0.2 * (jnp.pad(v[1:], (0, 1)) - jnp.pad(v[:-1], (1, 0)))


@pytest.mark.parametrize(
    "term, sentence",
    [
        (Gyroscopic(), "gyroscopic"),
        (gx.PlasticContact(FIXED, gx.WaltonBraun(1.0, 2.0)), "remembers"),
        (gx.Dashpot(gx.Shift(2, "fixed"), 0.1), "further"),
    ],
)
def test_other_forces_by_velocity_are_refused(term, sentence):
    with refused(sentence):
        gx.linear.localisation_length(
            gx.Lattice(1.0, (gx.Bond(FIXED, gx.Linear()), term), sites=N), 0.5
        )


@pytest.mark.parametrize("order", [0.3, 0.8])
def test_a_damping_with_a_memory_is_a_complex_spring_of_the_frequency(order):
    """2 (1 - cos k) = omega^2 - c (-i omega)^a of equal beads, by both functions."""
    omega, c = 1.1, 0.1
    chain = gx.Lattice(1.0, (gx.Bond(FIXED, gx.Linear()), gx.CaputoDamping(c, order)), sites=2000)
    exact = np.arccos(1 - (omega**2 - c * (-1j * omega) ** order) / 2)
    found = gx.linear.localisation_length(chain, omega)
    assert abs(found.gamma - abs(exact.imag)) < 5 * found.error + 1e-12
    waves = gx.linear.complex_bands(chain, omega).k[0]
    assert_allclose(np.sort_complex(waves), np.sort_complex([exact, -exact]), rtol=1e-12)


@pytest.mark.parametrize("scene", ["mass in mass", "woodpile"])
def test_resonators_hang_on_their_sites(scene):
    """In their gap the decay of the effective mass m + sum mu kappa/(kappa - mu omega^2); else NumPy's product."""
    if scene == "woodpile":
        mu, kappa, omega = [0.2, 0.3], [0.5, 0.6], 1.55
        chain = gx.scenes.woodpile(20000, mu, kappa, precompression=1.0)
    else:
        mu, kappa, omega = [0.3], [0.5], 1.4
        chain = gx.scenes.mass_in_mass(20000, 0.3, 0.5, precompression=1.0)
    heavy = 1 + sum(m * k / (k - m * omega**2) for m, k in zip(mu, kappa))
    exact = abs(np.arccos(1 - heavy * omega**2 / 3 + 0j).imag)
    assert abs(gx.linear.localisation_length(chain, omega).gamma - exact) < 1e-12
    masses = np.random.default_rng(0).uniform(0.5, 1.5, 20000)
    every = {name: jnp.broadcast_to(m, 20000) for name, m in chain.mass.items()}
    uneven = gx.Lattice(every | {"bead": masses}, chain.terms)
    found = gx.linear.localisation_length(uneven, 1.0)
    hung = sum(m * k / (k - m) for m, k in zip(mu, kappa))
    u, f, grown = 1.0, 0.0, []
    for m in masses[1:-1]:
        f += (m + hung) * u
        u -= f / 1.5
        size = np.hypot(u, f)
        u, f = u / size, f / size
        grown.append(np.log(size))
    assert abs(found.gamma - np.mean(grown[2222:])) < 0.1 * found.error
    assert found.error < 0.15 * found.gamma
