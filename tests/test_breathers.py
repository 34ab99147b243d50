"""Breathers and their families: at what frequencies they exist, their published numbers, guesses, and derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import ended
from known_orbits import HEAVY, covers, dimer, hard, reference
from numpy.testing import assert_allclose
from refusals import refused
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from scipy.special import ellipk

import granjax as gx
from granjax.breathers import breather, bright_guess, dark_guess, family, guesses, localisation
from granjax.orbits.families import resonant_harmonic
from granjax.orbits.guesses import cell_of, edges_beside
from granjax.theory import nls

pytestmark = pytest.mark.slow
OMEGA2 = 3**0.5  # the lower edge of the dimer's optical band
EDGE = 6**0.5  # the upper edge of the monomer's band
B_FORCE, B_LENGTH = (
    -0.459279327,
    -0.153093109,
)  # of the monomer at constant force, and at fixed length


def monomer(sites, exponent=1.5, boundary="free"):
    return gx.scenes.monomer(sites, exponent=exponent, precompression=1.0, boundary=boundary)


def at_rest(u):
    return gx.State(jnp.asarray(u), jnp.zeros(len(u)))


def odd_part(b):
    """Half the difference of the displacements now and half a period later."""
    half = gx.Flow(64)(b.state, 0.0, float(b.period) / 2, b.lattice)
    return np.asarray(b.state.u - half.u) / 2


def localised_at(chain, state, sites):
    energy = np.asarray(gx.measures.site_energy(chain, state))
    return energy[sites].sum() > 0.95 * energy.sum()


# families -------------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def short():
    # contacts stay closed down to 0.983 omega_2
    return family(dimer(25), until=0.985 * OMEGA2)


def test_a_family_begins_at_the_linear_mode_and_ends_where_it_was_asked_to(short):
    omega = np.asarray(gx.linear.normal_modes(dimer(25)).omega)
    start = omega[omega > OMEGA2].min()
    assert short.omega[0] == pytest.approx(start, rel=1e-5) and short.omega[-1] == 0.985 * OMEGA2
    assert "reached" in short.outcome and len(short) < 120
    # E = omega^2 a^2 (half the mass) for small amplitudes
    ratio = short.energy[:3] / short.amplitude[:3] ** 2
    assert_allclose(ratio[:2], ratio[2], rtol=1e-3)
    assert short.verdict[0] == "stable" and short.step_error.max() < 1e-6
    table = short.to_xarray()
    assert table.sizes["multiplier"] == 50 and table.attrs["outcome"] == short.outcome
    assert np.array_equal(table.omega, short.omega)
    assert np.array_equal(table.amplitude, short.amplitude)
    assert table.bifurcations_p.values.tolist() == [b.p for b in short.bifurcations]
    assert table.attrs["folds"] == short.folds.tolist()


def test_members_of_a_family_are_periodic_and_know_their_errors_and_multipliers(short):
    for i in (3, -1):
        b = short.orbit(i)
        end = gx.Flow(200)(b.state, 0.0, b.period, b.lattice)
        assert max(np.abs(end.u - b.state.u).max(), np.abs(end.v).max()) < 1e-9
        assert b.residual < 1e-10 and b.converged
    covers(b, reference("family"))
    assert short.energy_error[-1] < 1e-6
    assert abs(np.sum(b.lattice.mass * b.state.u)) < 1e-12
    # half a period knows the multipliers of the whole one, and those at +1 better
    whole = b.floquet()
    half = short.multipliers[-1]
    assert whole.verdict == short.verdict[-1]
    at_one = np.abs(half - 1) < 1e-4
    assert at_one.sum() == 4 and np.all(np.abs(half - 1)[at_one] <= short.error[-1][at_one])
    for rho in half[~at_one]:
        assert np.abs(whole.multipliers - rho).min() < 1e-6 * abs(rho)


def test_a_breather_from_its_family_another_orbit_or_a_state_is_the_same(short):
    orbit = short.orbit(-1)
    chain = orbit.lattice
    omega = float(orbit.omega)
    steps = int(orbit.flow.steps)
    by_orbit, by_pair = (
        breather(chain, omega, guess, steps=steps) for guess in (orbit, list(orbit.state))
    )
    assert np.array_equal(by_orbit.state.u, by_pair.state.u)
    for b in (by_orbit, breather(chain, omega), breather(chain, omega, short.orbit(-2).state)):
        assert float(b.energy) == pytest.approx(float(orbit.energy), rel=1e-9)


def test_frequencies_and_amplitudes_end_a_family():
    br = family(dimer(25), amplitude=0.3, mode=13, points=60, stability=False)
    assert "amplitude" in br.outcome and 0.3 <= br.amplitude[-1] < 0.5
    again = family(dimer(25), guess=br.orbit(4), until=float(br.omega[8]), stability=False)
    assert again.omega[-1] == br.omega[8]
    assert again.energy[-1] == pytest.approx(br.energy[8], rel=1e-8)


def test_newton_that_fails_says_how_far_it_came():
    ask = dimer(25), 0.985 * OMEGA2, at_rest(2.0 * jnp.cos(jnp.arange(25.0) ** 2))
    with pytest.raises(RuntimeError, match="residual went from .* in .* steps"):
        breather(*ask, max_steps=4)
    b = breather(*ask, max_steps=4, throw=False)
    assert not b.converged and np.isfinite(b.state.u).all() and "did not converge" in b.outcome


REFUSED = {
    r"B = -0\.459279 < 0 .* only dark": lambda: breather(monomer(24), 1.01 * EDGE),
    r"got 2 rad/s\. n = 1: .* band 0 \.\.\. 2\.449\d* rad/s": lambda: breather(
        monomer(24).counted_in("SI"), 2.0
    ),
    r"n = 1: .* lies in the band 0 \.\.\. 2\.449.* finite": lambda: breather(
        monomer(24), 0.9 * EDGE
    ),
    r"n = 2: .* 1\.97 ": lambda: breather(
        gx.scenes.pattern(24, (1.0, 3.2), precompression=1.0), 0.985
    ),
    r"dark.*n = 2": lambda: breather(monomer(24), 1.0, "dark"),
    "bright": lambda: breather(monomer(24), 2.5, "brigth"),
    "sonic vacuum": lambda: family(gx.scenes.monomer(8), until=1.0),
    r"one of omega\^2 = -2\.49 \(unstable\)": lambda: family(
        gx.scenes.triangular(3, precompression=1.0, boundary="fixed"), mode=2
    ),
    "tolerance: expected at least 1.1e-14": lambda: family(
        gx.scenes.fput(5, beta=1.0), points=2, tolerance=1e-15
    ),
    r"energy: expected numbers above zero, got 0\.0": lambda: breather(hard(), 1.4, energy=0.0),
    "until: expected finite numbers, got nan": lambda: family(hard(), float("nan")),
    "mode: expected a whole number, .* 7 modes, got 1.5": lambda: family(hard(), mode=1.5),
    "mode: expected a whole number, .* 5 modes, got 1.5": lambda: gx.breathers.q_breather(
        gx.scenes.fput(5, beta=1.0), 1.5, 0.01
    ),
    # a boolean would select by a mask
    "mode: expected a whole number, .* 7 modes, got True": lambda: family(hard(), mode=True),
    "mode: expected a whole number, .* 5 modes, got True": lambda: gx.breathers.q_breather(
        gx.scenes.fput(5, beta=1.0), True, 0.01
    ),
    "mode: expected a whole number below 7, .* got True": lambda: gx.breathers.backbone(
        hard(), True
    ),
    r"sites: expected indices within \(7,\), got \[True, False\]": lambda: guesses.single_site(
        hard(), 1.4, [True, False]
    ),
    r"sites: expected indices within \(7,\), got \[1, 9\]": lambda: guesses.single_site(
        hard(), 1.4, [1, 9]
    ),
    r"sites: expected different sites, got \[1, -6\]": lambda: guesses.single_site(
        hard(), 1.4, [1, -6]
    ),
    "mode: expected a whole number below 7, .* got 1.5": lambda: gx.breathers.backbone(hard(), 1.5),
}


@pytest.mark.parametrize("words", REFUSED)
def test_what_does_not_exist_is_refused_with_the_reason(words):
    with refused(words):
        REFUSED[words]()


# limits in which a breather is known ----------------------------------------------------------------------------------


def test_breathers_of_weakly_coupled_sites_begin_at_those_of_a_site_by_itself():
    chain = hard()
    seed = guesses.single_site(chain, 1.4, 3)
    a = float(seed.u[3])
    alone = ended(lambda t, y: (y[1], -1.04 * y[0] - y[0] ** 3), np.pi / 1.4, (a, 0))
    assert alone[1] == pytest.approx(0, abs=1e-9)
    # the mean of the linear bond's force is zero
    assert_allclose(np.delete(seed.u, 3), 0, atol=1e-12)
    b = breather(chain, 1.4, seed)
    assert b.converged and 0.9 < float(b.state.u[3]) / a < 1.1
    two = breather(chain, 1.4, guesses.single_site(chain, 1.4, [2, 4], amplitudes=[1, -1]))
    assert_allclose(two.state.u, -np.asarray(two.state.u)[::-1], atol=1e-9)
    assert two.floquet().expected == 2
    with refused("wrong side"):
        guesses.single_site(chain, 0.5, 3)


@pytest.mark.slow
def test_two_beads_of_a_cradle_lead_to_a_breather_that_is_localised():
    chain = gx.scenes.cradle(11)
    found = breather(chain, 1.1, guesses.single_site(chain, 1.1, "+0+"))
    assert 3 < localisation(chain, found.state).participation < 3.5


def test_a_light_bead_between_heavy_ones_tends_to_its_own_limit():
    omega = 0.995 * OMEGA2

    def limit_and_orbit(heavy):
        bond = gx.Bond(gx.Shift(1), gx.Hertz(1.0, 1.0))
        chain = gx.Lattice(np.where(np.arange(9) == 4, 1.0, heavy), bond)
        seed = guesses.single_site(chain, omega, 4)
        found = breather(chain, omega, seed, check=False)
        return np.asarray(seed.u), np.asarray(found.state.u)

    limit, near = limit_and_orbit(400.0)
    same, nearer = limit_and_orbit(1600.0)
    assert_allclose(limit, same, atol=1e-9)
    # the neighbours stand elsewhere, by an amount that the mass ratio does not make small, and the error falls as it
    assert limit[3] < -0.01 < 0.01 < limit[5]
    assert (near - limit)[4] / (nearer - limit)[4] == pytest.approx(4, rel=0.1)
    assert_allclose(nearer, limit, atol=0.03 * limit[4])


def test_light_beads_hold_families_whose_modes_tend_to_the_dimer_s_optical_band():
    # light beads of mass 1/2 at every other of n places in a monomer; of the dimer the optical band is sqrt 6 ... 3
    lowest = []
    highest = []
    for n in (1, 6):
        chain = gx.scenes.defects(63, {32 - n + 2 * i: 0.5 for i in range(n)}, precompression=1.0)
        omega = np.asarray(gx.linear.normal_modes(chain).omega)
        modes = np.flatnonzero(omega > EDGE + 1e-9)
        assert len(modes) == n and omega[-1] < 3
        lowest = [*lowest, omega[modes[0]]]
        highest = [*highest, omega[-1]]
        br = family(chain, mode=int(modes[0]), amplitude=0.3, points=40, stability=False)
        assert "amplitude" in br.outcome and br.omega[0] == pytest.approx(lowest[-1], rel=1e-5)
        assert np.all(np.diff(br.omega) < 0) and np.all(np.diff(br.energy) > 0)
        assert localised_at(chain, br.orbit(-1).state, slice(30 - n, 34 + n))
    assert np.all(np.diff(lowest) < 0) and np.all(np.diff(highest) > 0) and 3 - highest[-1] < 0.02


def test_a_hardening_chain_has_breathers_above_its_band():
    br = family(gx.scenes.fput(16, 0.0, 1.0), until=2.2, stability=False)
    # from the highest mode, which is below the frequency
    assert br.omega[0] == pytest.approx(2 * np.sin(np.pi * 16 / 34), abs=1e-5)
    assert br.omega[-1] == 2.2 and np.all(np.diff(br.energy) > 0)
    u = np.asarray(br.orbit(-1).state.u)
    assert np.all(u[:-1] * u[1:] < 0) and np.abs(u[0]) < 0.01 * np.abs(u).max()


SOFT_HARD = gx.PowerLaw(1.0, np.where(np.arange(40) % 2, 1.5, 0.5), 1.0)
GAPS = {
    "trimer": gx.scenes.trimer(31, (0.5, 0.25), precompression=1.0, boundary="free"),
    "contacts soft and hard": gx.Lattice(dimer(41).mass, gx.Bond(gx.Shift(1, "free"), SOFT_HARD)),
}


@pytest.mark.parametrize(
    "case, gap, share",
    [("trimer", 0, 0.05), ("trimer", 1, 0.05), ("contacts soft and hard", -1, 0.02)],
)
def test_breathers_exist_in_each_gap(case, gap, share):
    low, high = gx.linear.bands(GAPS[case]).gaps[gap]
    br = family(
        GAPS[case], until=high - share * (high - low), points=300, stability=case != "trimer"
    )
    energy = gx.measures.site_energy(GAPS[case], br.orbit(-1).state)
    if case != "trimer":
        assert len(br) > 3 and np.isfinite(br.multipliers).all()
    else:
        assert "reached" in br.outcome and gx.measures.participation(np.asarray(energy)) < 20


# derivatives and batches ----------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def of_mass(short):
    """The breather of 25 beads over the mass of the heavy ones and the frequency, or at a given energy."""
    seed = short.orbit(-1)

    def found(heavy, omega, energy=None):
        chain = gx.Lattice(jnp.where(dimer(25).mass > 1, heavy, 1.0), dimer(25).terms)
        how = dict(steps=48, throw=False, tolerance=1e-12)
        return breather(chain, omega, seed.state, energy=energy, **how)

    return seed, found


def test_energy_and_frequency_of_a_breather_are_differentiable(of_mass):
    seed, found = of_mass
    at = jnp.array([HEAVY, float(seed.omega)])
    energy = jax.jit(lambda x: found(*x).energy)
    slopes = jax.jit(jax.jacfwd(energy))(at)
    h = 1e-4
    for i, step in enumerate(h * np.eye(2)):
        near, far = (float(energy(at + k * step) - energy(at - k * step)) for k in (1, 2))
        assert float(slopes[i]) == pytest.approx((8 * near - far) / (12 * h), rel=1e-6)
    assert_allclose(jax.jit(jax.jacrev(energy))(at), slopes, rtol=1e-6)
    # at constant energy d omega/d mass = -(dE/d mass)/(dE/d omega)
    held = float(energy(at))
    omega = jax.jit(lambda heavy: found(heavy, 1.001 * at[1], held).omega)
    assert float(omega(HEAVY)) == pytest.approx(float(seed.omega), rel=1e-9)
    assert float(jax.jacfwd(omega)(HEAVY)) == pytest.approx(-float(slopes[0] / slopes[1]), rel=1e-6)


def test_mass_ratios_in_a_batch(of_mass):
    seed, found = of_mass
    energies = jax.vmap(lambda heavy: found(heavy, seed.omega).energy)(jnp.array([2.9, HEAVY, 3.0]))
    assert float(energies[1]) == pytest.approx(float(seed.energy), rel=1e-9)
    assert np.all(np.diff(energies) != 0)


# the envelope equation ------------------------------------------------------------------------------------------------


# chain, edge, side of the edge, the smallest shift, guess, the place of the largest amplitude
ENVELOPES = {
    "dark Hertz": (monomer(184), EDGE, -1, 0.004, dark_guess, 46),
    "dimer's optical edge": (dimer(169), OMEGA2, -1, 0.002, bright_guess, 84),
}


@pytest.mark.parametrize("case", ENVELOPES)
def test_the_error_of_the_envelope_is_proportional_to_the_shift(case):
    # nearer to the band a dark soliton of a chain this long may stand anywhere: its place is held by less than 1e-10
    chain, top, side, least, guess, i = ENVELOPES[case]
    shifts = least * np.array([1, 2])
    errors = []
    for shift in shifts:
        omega = top * (1 + side * shift)
        odd = odd_part(breather(chain, omega, guess(chain, omega), steps=64, check=False))
        if case == "dark Hertz":
            found = abs(odd[i] - odd[i + 1])
            expected = 2 * (shift * EDGE / -B_FORCE) ** 0.5
        else:
            edge = min(edges_beside(chain, omega), key=lambda edge: abs(edge.omega - omega))
            cells = len(odd) // len(cell_of(chain)[0]) | 1
            profile = nls.bright_profile(edge.coefficients, omega, cells)
            expected = 2 * float(profile.amplitude) * float(np.abs(edge.coefficients.mode).max())
            found = abs(odd[i])
        errors.append(abs(expected / found - 1))
    assert np.log2(errors[1] / errors[0]) == pytest.approx(1.0, abs=0.1), errors


def test_a_dark_breather_at_fixed_length_has_the_amplitude_of_its_mean_compression():
    for shift in (0.0025, 0.01):
        chain = monomer(162, boundary="fixed")
        omega = EDGE * (1 - shift)
        odd = odd_part(breather(chain, omega, "dark", steps=64))
        # kappa = B |Y|^2, B between those of constant force and fixed length as the mean of |Y|^2 over the chain says:
        # tanh^2(x/w) lacks 2 w at the dip and as much at the walls
        nu2 = 0.306186218
        share = 1.0
        for _ in range(50):
            amplitude = (-shift * EDGE / (B_FORCE + share * (B_LENGTH - B_FORCE))) ** 0.5
            share = 1 - 4 / 162 / (-B_FORCE * amplitude**2 / (2 * nu2)) ** 0.5
        assert abs(2 * amplitude / abs(odd[40] - odd[41]) - 1) < 6 * shift


def test_a_uniform_wave_of_the_hertz_monomer_does_not_grow():
    wave = 0.05 * (-1.0) ** np.arange(20)
    c = cell_of(monomer(20)).coefficients(0, "length")
    omega = EDGE + float(c.nu3) * (0.05 / (2 * float(np.abs(c.mode).max()))) ** 2
    b = breather(monomer(20, boundary="periodic"), omega, at_rest(wave), check=False)
    assert np.abs(b.state.u).max() > 0.03 and b.floquet(tolerance=1e-11).verdict == "stable"


def test_the_envelope_has_the_bonds_between_the_sites_of_a_cell():
    # the first bond of a chain between walls is the left wall's
    for boundary, bonds, stiffness in (("free", 7, [1.0, 2.0]), ("fixed", 9, [2.0, 1.0])):
        K = np.resize([1.0, 2.0], bonds)
        law = gx.Polynomial(K, 0.1 * K, 0.3 * K)
        cell = cell_of(gx.Lattice(np.ones(8), gx.Bond(gx.Shift(1, boundary), law)))
        assert_allclose(cell[1:4], np.outer([1.0, 0.1, 0.3], stiffness), rtol=1e-14)


# published numbers ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "fraction, E, u, largest",
    [
        (0.9900, 2.6192908, (0.6377287, 0.0398740, -0.4638610), None),
        (0.9850, 2.7015770, (0.7784533, 0.0526330, -0.4492773), 1.126536),
    ],
)
def test_light_centred_breathers_of_the_dimer(fraction, E, u, largest, optimised):
    b, by_envelope = (breather(dimer(121), fraction * OMEGA2, seed) for seed in (None, "bright"))
    assert float(by_envelope.energy) == pytest.approx(float(b.energy), rel=1e-9)
    assert float(b.energy) == pytest.approx(E, abs=1e-6)
    assert_allclose(b.state.u[60:63], u, atol=1e-6)
    fl = b.floquet()
    assert fl.defect < 1e-12
    if largest is None:
        assert fl.verdict == "stable" and fl.expected == 4
    else:
        assert fl.verdict == "unstable"
        assert abs(fl.multipliers[0]) == pytest.approx(largest, abs=1e-5)


def test_the_light_centred_family_turns_unstable_where_its_energy_has_its_extremum(optimised):
    seed = breather(dimer(81), 0.988 * OMEGA2)
    br = family(dimer(81), guess=seed, until=0.9855 * OMEGA2, longest_arclength=0.1)
    assert "reached" in br.outcome
    found = gx.breathers.bifurcations(br, ("real pair at +1", "extremum of energy"))
    at = {b.kind: b.p for b in found}
    assert at["real pair at +1"] == pytest.approx(at["extremum of energy"], rel=1e-6)
    assert at["extremum of energy"] / OMEGA2 == pytest.approx(0.9866761, abs=1e-6)


def test_a_pair_and_its_mirror_image_leave_a_ring_together_where_hill_says():
    # u = (-1)^n a(t) with a'' = -4a - 16a^3; a wave of k, and one of -k, obey
    # x'' = -4 sin^2(k/2) (1 + 12a^2) x, whose half trace over a period of a^2 passes -1
    sites = 8
    stiffness = 4 * np.sin(3 * np.pi / sites) ** 2

    def period(a):
        return 4 * ellipk(8 * a**2 / (4 + 16 * a**2)) / np.sqrt(4 + 16 * a**2)

    def flow(t, y):
        a, b, x, v, z, w = y
        g = -stiffness * (1 + 12 * a**2)
        return [b, -4 * a - 16 * a**3, v, g * x, w, g * z]

    def half_trace(a):
        run = solve_ivp(
            flow, (0, period(a) / 2), [a, 0, 1, 0, 0, 1], "DOP853", rtol=1e-12, atol=1e-13
        )
        return (run.y[2, -1] + run.y[5, -1]) / 2

    omega = 2 * np.pi / period(brentq(lambda a: half_trace(a) + 1, 0.17, 0.18))
    assert omega == pytest.approx(2.091458086, abs=1e-9)
    ring = gx.Lattice(
        1.0, gx.Bond(gx.Shift(1, "periodic"), gx.Polynomial(1.0, 0.0, 1.0)), sites=sites
    )
    (event,) = gx.breathers.bifurcations(family(ring, mode=sites - 1, amplitude=0.19))
    assert event.kind == "real pair at +1" and (event.before, event.behind) == (0, 2)
    assert event.p == pytest.approx(omega, rel=2e-9)


def test_few_steps_place_a_real_pair_no_worse_than_the_orbits_know_it():
    # u = (a, -a) with a'' = -1.4 a - a^3, a = A cn(W t, m), W^2 (1 - 2m) = 1.4; the sum obeys Lame's equation, whose
    # solution cn dn has the period of a at 1/W^2 + 6m = 1 + m: m = 0.08
    omega = np.pi * np.sqrt(1.4 / 0.84) / (2 * ellipk(0.08))
    bond = gx.Bond(gx.Shift(1, "free"), gx.Linear(0.2))
    pair = gx.Lattice(jnp.ones(2), (gx.OnSite(gx.Polynomial(1.0, 0.0, 1.0)), bond))
    branch = family(pair, 1.3, mode=1, steps=12)
    (event,) = gx.breathers.bifurcations(branch, "real pair at +1")
    # the tangent map changes by 3e-6 when the steps are doubled
    assert event.p == pytest.approx(omega, abs=6e-8)


def test_steps_are_not_doubled_for_an_orbit_that_is_not_isolated():
    # all motions of Toda's ring lie on tori: a standing wave may be anywhere
    ring = gx.scenes.toda(8, boundary="periodic")
    branch = family(ring, mode=3, points=4, stability=False)
    assert branch._family.shooting.flow.steps <= 240
    found = gx.breathers.q_breather(ring, 3, 0.1, steps=64, stability=False)
    assert "It may be one of many" in found.outcome
    isolated = gx.breathers.q_breather(gx.scenes.toda(8), 3, 0.1, steps=64, stability=False)
    assert "one of many" not in isolated.outcome and "known to" in isolated.outcome


def test_the_heavy_centred_family_is_real_unstable(optimised):
    seed = breather(dimer(121, "heavy"), 0.9929 * OMEGA2)
    br = family(seed.lattice, guess=seed, until=0.98 * OMEGA2, longest_arclength=0.1)
    assert "reached" in br.outcome and np.all(br.verdict == "unstable")
    largest = br.multipliers[:, 0]
    assert np.all(np.abs(largest.imag) < 1e-6) and np.all(largest.real > 1)


def test_the_dark_breather_of_the_monomer_is_an_orbit_of_scipy():
    b = breather(monomer(82), 0.99 * EDGE, "dark", steps=96)
    # the number of the literature, 9.321146696, is that of an integrator whose frequency is 4.7e-8 off
    assert float(b.energy) == pytest.approx(9.321099312, rel=1e-8)
    odd = np.diff(odd_part(b))
    assert abs(odd[20]) == pytest.approx(0.448960, abs=2e-6)
    strain = np.abs(gx.measures.strain(b.lattice, b.state))
    assert b.converged and strain[40] < 0.05 * strain[20]

    def field(t, y):
        force = np.maximum(1 - np.diff(y[:82]), 0) ** 1.5 - 1
        return np.concatenate([y[82:], -np.diff(force, prepend=0, append=0)])

    start = np.concatenate([b.state.u, np.zeros(82)])
    assert np.abs(ended(field, float(b.period) / 2, start)[82:]).max() < 1e-11


# harmonics that would be waves ----------------------------------------------------------------------------------------


class Tanh(gx.Law):
    """An odd law as a user writes it, of a stiffness K and a length a; `bent` by a share beyond a/3."""

    stiffness: float
    length: float
    bent: float = 0.0

    def force(self, e):
        beyond = self.bent * jnp.maximum(e - self.length / 3, 0.0)
        return self.stiffness * (self.length * jnp.tanh(e / self.length) + beyond)

    def energy(self, e):
        beyond = self.bent / 2 * jnp.maximum(e - self.length / 3, 0.0) ** 2
        return self.stiffness * (self.length**2 * jnp.log(jnp.cosh(e / self.length)) + beyond)


def on_sites(own, bonds=gx.Linear(0.5), sites=12):
    """A ring with the band 1 ... sqrt(3)."""
    return gx.Lattice(1.0, (gx.Bond(gx.Shift(1, "periodic"), bonds), gx.OnSite(own)), sites=sites)


ALPHAS = 0.3 * (-1.0) ** np.arange(12)
HARMONICS = {
    "its third harmonic": (lambda: gx.scenes.sine_gordon(12, 0.5, boundary="periodic"), 0.5, 3),
    "a law in SI": (lambda: on_sites(Tanh(1.0, 3e-7), Tanh(0.5, 2e-9)), 0.8, None),
    "bent": (lambda: on_sites(Tanh(1.0, 3e-7, 1e-3)), 0.8, 2),
    "staggered": (lambda: on_sites(gx.Polynomial(1.0, ALPHAS, 1.0)), 0.8, 2),
    "asymmetric bonds": (lambda: on_sites(gx.Sine(1.0), gx.Polynomial(0.5, 0.1)), 0.8, 2),
    "all neighbours": (lambda: gx.scenes.fractional_sine_gordon(12, 0.5, 0.5), 0.7, None),
}


@pytest.mark.parametrize("name", HARMONICS)
def test_harmonics_that_the_symmetry_forbids_do_not_count(name):
    make, omega, expected = HARMONICS[name]
    found = resonant_harmonic(make(), omega)
    assert (None if found is None else found[0]) == expected


def test_a_breather_of_an_odd_force_exists_though_its_second_harmonic_would_be_a_wave():
    omega = 0.8
    coupling = 0.5
    n = np.arange(21) - 10
    away = np.sqrt(1 - omega**2)
    guess = 4 * np.arctan(away / omega / np.cosh(away * n / np.sqrt(coupling)))
    found = breather(gx.scenes.sine_gordon(21, coupling), omega, at_rest(guess))
    assert found.converged

    def field(t, y):
        u = y[:21]
        pull = np.diff(coupling * np.diff(u), prepend=0, append=0)
        return np.concatenate([y[21:], pull - np.sin(u)])

    start = np.concatenate([found.state.u, np.zeros(21)])
    assert_allclose(ended(field, np.pi / omega, start), -start, rtol=0, atol=1e-9)
    with refused("n = 2: 2 omega = 1.6 lies in the band"):
        breather(on_sites(gx.Polynomial(1.0, 0.1, -0.1), sites=21), omega)


@pytest.mark.slow
def test_a_breather_without_a_guess_in_float32():
    chain = gx.scenes.sine_gordon(9, 0.05)
    exact = gx.breathers.breather(chain, 0.8)
    found = gx.breathers.breather(chain.astype(jnp.float32), 0.8, tolerance=1e-5)
    assert found.state.u.dtype == jnp.float32
    assert (
        np.abs(np.asarray(found.state.u - exact.state.u)).max() < 1e-5 * np.abs(exact.state.u).max()
    )
    assert float(found.energy) == pytest.approx(float(exact.energy), rel=1e-5)


def test_an_energy_that_is_the_same_along_a_branch_has_no_extremum():
    """Sites that move alike do not feel their coupling."""
    mass = jnp.array([1.0, 0.7, 1.3])
    well = gx.OnSite(gx.Polynomial(mass, 0 * mass, mass))
    scene = lambda c: gx.Lattice(mass, (well, gx.Bond(gx.Shift(1, "periodic"), gx.Linear(c))))
    br = gx.breathers.anticontinuous(
        scene, 0.05, 1.2, [0, 1, 2], points=12, arclength=0.05, steps=64
    )
    assert np.ptp(br.energy) < 1e-12
    assert gx.breathers.bifurcations(br, "extremum of energy") == []
