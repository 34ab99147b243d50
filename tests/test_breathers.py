import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import ended
from numpy.testing import assert_allclose
from refusals import refused
from scipy.integrate import solve_ivp

import granjax as gx
from granjax.orbits.families import resonant_harmonic
from granjax.orbits.guesses import cell_of, edges_beside
from granjax.theory import nls

# precompressed dimer, A = d0 = 1, light mass 1, heavy 2.957949; Theocharis et al., Phys. Rev. E 82, 056604 (2010)
HEAVY, OMEGA2 = 2.957949, 3**0.5


def dimer(sites, centre="light", law=None):
    light = (np.arange(sites) - sites // 2) % 2 == (0 if centre == "light" else 1)
    law = gx.Hertz(1.0, 1.0) if law is None else law
    return gx.Lattice(np.where(light, 1.0, HEAVY), (gx.Bond(gx.Shift(1, "free"), law),))


def monomer(sites, exponent=1.5, boundary="free"):
    return gx.scenes.monomer(sites, exponent=exponent, precompression=1.0, boundary=boundary)


@pytest.fixture(scope="module")
def short():
    # contacts stay closed down to 0.983 omega_2
    return gx.breathers.family(dimer(25), until=0.985 * OMEGA2)


@pytest.mark.slow
def test_a_family_from_the_linear_mode(short):
    omega = np.asarray(gx.linear.normal_modes(dimer(25)).omega)
    start = omega[omega > OMEGA2].min()
    assert short.omega[0] == pytest.approx(start, rel=1e-5) and short.omega[-1] == 0.985 * OMEGA2
    assert "reached" in short.outcome and len(short) < 120
    # E = omega^2 a^2 (half the mass) for small amplitudes
    assert_allclose(
        short.energy[:2] / short.amplitude[:2] ** 2,
        short.energy[2] / short.amplitude[2] ** 2,
        rtol=1e-3,
    )
    assert short.multipliers.shape == (len(short), 50) and short.u.shape == (len(short), 25)
    assert short.verdict[0] == "stable" and short.step_error.max() < 1e-6


@pytest.mark.slow
def test_each_member_is_periodic(short):
    for i in (3, -1):
        b = short.orbit(i)
        end = gx.Flow(200)(b.state, 0.0, b.period, b.lattice)
        assert max(np.abs(end.u - b.state.u).max(), np.abs(end.v).max()) < 1e-9
        assert b.residual < 1e-10 and b.converged


@pytest.mark.slow
def test_multipliers_of_the_family_are_those_of_floquet(short):
    i = len(short) - 1
    fl = short.orbit(i).floquet()
    assert fl.verdict == short.verdict[i]
    outside = np.abs(fl.multipliers) > 1 + 1e-3
    assert_allclose(
        np.sort(np.abs(short.multipliers[i]))[::-1][: outside.sum()],
        np.abs(fl.multipliers[outside]),
        rtol=1e-6,
    )


@pytest.mark.slow
def test_another_breather_or_a_pair_is_a_guess(short):
    orbit = short.orbit(-1)
    by_orbit, by_pair = (
        gx.breathers.breather(dimer(25), 0.985 * OMEGA2, guess, steps=int(orbit.flow.steps))
        for guess in (orbit, list(orbit.state))
    )
    assert np.array_equal(by_orbit.state.u, by_pair.state.u)
    assert float(by_orbit.energy) == pytest.approx(float(orbit.energy), rel=1e-9)


def test_a_family_exports(short):
    table = short.to_xarray()
    assert table.sizes["multiplier"] == 50 and table.attrs["outcome"] == short.outcome
    assert np.array_equal(table.omega, short.omega) and np.array_equal(
        table.amplitude, short.amplitude
    )
    assert table.bifurcations_p.values.tolist() == [b.p for b in short.bifurcations]
    assert table.attrs["folds"] == short.folds.tolist()


@pytest.mark.slow
def test_a_breather_by_the_family_and_by_a_state_is_the_same(short):
    i = int(np.argmin(np.abs(short.omega - 0.99 * OMEGA2)))
    by_family = gx.breathers.breather(dimer(25), float(short.omega[i]))
    by_state = gx.breathers.breather(dimer(25), float(short.omega[i]), short.orbit(i - 1).state)
    for b in (by_family, by_state):
        assert float(b.energy) == pytest.approx(short.energy[i], rel=1e-9)


@pytest.mark.study
def test_a_breather_by_the_envelope_is_the_family_s():
    by_family, by_envelope = (
        gx.breathers.breather(dimer(121), 0.985 * OMEGA2, seed) for seed in (None, "bright")
    )
    assert float(by_envelope.energy) == pytest.approx(float(by_family.energy), rel=1e-9)


@pytest.mark.slow
def test_newton_that_fails_says_how_far_it_came():
    chain = dimer(25)
    rough = gx.State(2.0 * jnp.cos(jnp.arange(25.0) ** 2), jnp.zeros(25))
    with pytest.raises(RuntimeError, match="residual went from .* in .* steps"):
        gx.breathers.breather(chain, 0.985 * OMEGA2, rough, max_steps=4)
    b = gx.breathers.breather(chain, 0.985 * OMEGA2, rough, max_steps=4, throw=False)
    assert not b.converged and np.isfinite(b.state.u).all() and "did not converge" in b.outcome


@pytest.mark.parametrize(
    "ask, words",
    [
        (
            lambda: gx.breathers.breather(monomer(24), 1.01 * 6**0.5),
            r"B = -0\.459279 < 0 .* only dark",
        ),
        (
            lambda: gx.breathers.breather(monomer(24), 0.9 * 6**0.5),
            r"n = 1: .* lies in the band 0 \.\.\. 2\.449.* finite",
        ),
        (lambda: gx.breathers.breather(dimer(25), 0.99), r"n = 1: "),
        (
            lambda: gx.breathers.breather(
                gx.scenes.pattern(24, (1.0, 3.2), precompression=1.0), 0.985
            ),
            r"n = 2: .* 1\.97 ",
        ),
        (lambda: gx.breathers.breather(monomer(24), 1.0, "dark"), r"dark.*n = 2"),
        (lambda: gx.breathers.breather(monomer(24), 2.5, "brigth"), "bright"),
        (lambda: gx.breathers.family(gx.scenes.monomer(8), until=1.0), "sonic vacuum"),
        (
            lambda: gx.breathers.breather(dimer(25), 0.985 * OMEGA2, (np.ones(24), np.zeros(24))),
            r"guess.u: .*\(25,\)",
        ),
        (
            lambda: gx.breathers.family(
                gx.Lattice(np.ones(4), (gx.Bond(gx.Shift(1), gx.Linear()), gx.Damping(0.1)))
            ),
            "positions alone, got Damping",
        ),
    ],
)
def test_what_does_not_exist_is_refused_with_the_reason(ask, words):
    with refused(words):
        ask()


@pytest.mark.study
def test_a_dark_breather_in_its_band_is_not_refused():
    b = gx.breathers.breather(monomer(32), 0.97 * 6**0.5, "dark")
    strain = np.abs(gx.measures.strain(b.lattice, b.state))
    assert b.converged and strain[15] < 0.05 * strain[7]


@pytest.mark.slow
def test_forced_continuation_of_a_bright_breather_in_a_monomer_leads_to_nothing():
    chain = monomer(41)
    n = np.arange(41) - 20
    pulse = gx.State(0.3 * (-1.0) ** n / np.cosh(0.3 * n), np.zeros(41))
    b = gx.breathers.breather(chain, 1.01 * 6**0.5, pulse, check=False, throw=False)
    u = np.asarray(b.state.u)
    decays = np.abs(u[[0, 1, -2, -1]]).max() < 0.1 * np.abs(u).max()
    assert np.abs(u).max() < 1e-6 or not decays or not b.converged


@pytest.mark.slow
def test_one_site_at_the_anticontinuous_limit():
    terms = gx.Bond(gx.Shift(1, "free"), gx.Linear(0.02)), gx.OnSite(gx.Polynomial(1.0, 0.0, 1.0))
    chain = gx.Lattice(np.ones(7), terms)
    seed = gx.breathers.guesses.single_site(chain, 1.4, 3)
    a = float(seed.u[3])
    alone = solve_ivp(
        lambda t, y: (y[1], -1.04 * y[0] - y[0] ** 3),
        (0, np.pi / 1.4),
        (a, 0),
        rtol=1e-12,
        atol=1e-13,
    )
    assert alone.y[1, -1] == pytest.approx(0, abs=1e-9)
    assert_allclose(
        np.delete(seed.u, 3), 0, atol=1e-12
    )  # the mean of the linear bond's force is zero
    b = gx.breathers.breather(chain, 1.4, seed)
    assert b.converged and 0.9 < float(b.state.u[3]) / a < 1.1
    pair = gx.breathers.breather(
        chain, 1.4, gx.breathers.guesses.single_site(chain, 1.4, [2, 4], amplitudes=[1, -1])
    )
    assert_allclose(pair.state.u, -np.asarray(pair.state.u)[::-1], atol=1e-9)
    assert pair.floquet().expected == 2
    with refused("wrong side"):
        gx.breathers.guesses.single_site(chain, 0.5, 3)


@pytest.mark.study
def test_light_beads_between_heavy_ones_tend_to_their_own_limit():
    omega = 0.995 * 3**0.5

    def limit_and_orbit(heavy):
        chain = gx.Lattice(
            np.where(np.arange(9) == 4, 1.0, heavy), (gx.Bond(gx.Shift(1), gx.Hertz(1.0, 1.0)),)
        )
        seed = gx.breathers.guesses.single_site(chain, omega, 4)
        return np.asarray(seed.u), np.asarray(
            gx.breathers.breather(chain, omega, seed, check=False).state.u
        )

    (limit, near), (same, nearer) = limit_and_orbit(400.0), limit_and_orbit(1600.0)
    assert_allclose(limit, same, atol=1e-9)
    # the neighbours stand elsewhere, by an amount that the mass ratio does not make small, and the error falls as it
    assert limit[3] < -0.01 < 0.01 < limit[5]
    assert (near - limit)[4] / (nearer - limit)[4] == pytest.approx(4, rel=0.1)
    assert_allclose(nearer, limit, atol=0.03 * limit[4])


@pytest.mark.slow
def test_a_defect_carries_a_family_from_its_mode():
    chain = gx.scenes.defects(31, {15: 0.5}, precompression=1.0)
    mode = float(gx.linear.normal_modes(chain).omega[-1])
    br = gx.breathers.family(chain, until=0.99 * mode)
    assert br.omega[0] == pytest.approx(mode, rel=1e-5) and np.argmax(np.abs(br.u[-1])) == 15
    assert np.all(np.diff(br.omega) < 0)


def test_frequencies_and_amplitudes_end_a_family():
    br = gx.breathers.family(dimer(25), amplitude=0.3, mode=13, points=60, stability=False)
    assert "amplitude" in br.outcome and 0.3 <= br.amplitude[-1] < 0.5
    again = gx.breathers.family(
        dimer(25), guess=br.orbit(4), until=float(br.omega[8]), stability=False
    )
    assert again.omega[-1] == br.omega[8] and again.energy[-1] == pytest.approx(
        br.energy[8], rel=1e-8
    )


@pytest.fixture(scope="module")
def seed15(short):
    return gx.breathers.breather(dimer(15), 0.985 * OMEGA2, steps=48)


@pytest.mark.slow
def test_energy_is_differentiable_in_the_chain_and_in_omega(seed15):
    omega = 0.985 * OMEGA2

    def energy(ratio, omega):
        chain = gx.Lattice(
            dimer(15).mass * jnp.where(dimer(15).mass > 1, ratio, 1.0), dimer(15).terms
        )
        b = gx.breathers.breather(
            chain, omega, seed15.state, steps=48, throw=False, tolerance=1e-12
        )
        return b.energy

    f = jax.jit(energy)
    for argument, h in ((0, 1e-4), (1, 1e-4)):
        at = lambda d: float(f(*(x + d * (i == argument) for i, x in enumerate((1.0, omega)))))
        finite = (8 * (at(h) - at(-h)) - (at(2 * h) - at(-2 * h))) / (12 * h)
        exact = [
            float(jax.jit(mode(energy, argument))(1.0, omega)) for mode in (jax.jacfwd, jax.jacrev)
        ]
        assert_allclose(exact, finite, rtol=1e-6)


def of_ratio(ratio):
    return gx.Lattice(dimer(15).mass * jnp.where(dimer(15).mass > 1, ratio, 1.0), dimer(15).terms)


def five_points(f, h):
    return (8 * (f(1 + h) - f(1 - h)) - (f(1 + 2 * h) - f(1 - 2 * h))) / (12 * h)


@pytest.mark.study
def test_the_frequency_at_constant_energy_is_differentiable(seed15):
    near = gx.breathers.breather(
        dimer(15), 0.986 * OMEGA2, seed15.state, energy=float(seed15.energy), steps=48
    )
    assert float(near.omega) == pytest.approx(float(seed15.omega), rel=1e-9)

    @jax.jit
    def omega(ratio):
        chain, energy = of_ratio(ratio), seed15.energy
        return gx.breathers.breather(
            chain, seed15.omega, seed15.state, energy=energy, steps=48, throw=False, tolerance=1e-12
        ).omega

    slope = float(jax.jacfwd(omega)(1.0))
    assert slope == pytest.approx(float(five_points(omega, 1e-4)), rel=1e-6) and abs(slope) > 1e-3


@pytest.mark.study
def test_the_largest_multiplier_is_differentiable_in_the_mass_ratio():
    def chain(heavy):
        return gx.Lattice(jnp.where(dimer(61).mass > 1, heavy, 1.0), dimer(61).terms)

    ratio, omega = 2.957949, 0.985 * OMEGA2
    seed = gx.breathers.breather(chain(ratio), omega).state

    def largest(heavy):
        b = gx.breathers.breather(chain(heavy), omega, seed, steps=48, throw=False, tolerance=1e-13)
        return jnp.abs(
            gx.floquet.multipliers(gx.Flow(48), b.state, 0.0, 2 * jnp.pi / omega, chain(heavy))
        ).max()

    assert float(largest(ratio)) == pytest.approx(1.1265, abs=1e-3)
    h = 1e-4
    at = lambda d: float(largest(ratio + d))
    finite = (8 * (at(h) - at(-h)) - (at(2 * h) - at(-2 * h))) / (12 * h)
    assert float(jax.jacfwd(largest)(ratio)) == pytest.approx(finite, rel=1e-6)


@pytest.mark.slow
def test_mass_ratios_in_a_batch(seed15):
    ratios = jnp.array([2.9, 2.957949, 3.0])

    @jax.vmap
    def energies(heavy):
        chain = gx.Lattice(jnp.where(dimer(15).mass > 1, heavy, 1.0), dimer(15).terms)
        return gx.breathers.breather(
            chain, 0.985 * OMEGA2, seed15.state, steps=48, throw=False
        ).energy

    found = energies(ratios)
    assert float(found[1]) == pytest.approx(float(seed15.energy), rel=1e-9) and np.all(
        np.diff(found) != 0
    )


# ------------------------------------------------------------------------------------------------ the envelope equation


# sites, which go with the inverse root of the smallest shift, and that shift
ENVELOPES = {
    "dark Hertz": (184, 0.004),
    "bright p = 1/2": (141, 0.002),
    "dimer's optical edge": (169, 0.002),
}
NEARER = {
    "dark Hertz": (260, 0.002),
    "bright p = 1/2": (201, 0.001),
    "dimer's optical edge": (241, 0.001),
}


@pytest.mark.study
@pytest.mark.parametrize(
    "scenes", [ENVELOPES, pytest.param(NEARER, marks=pytest.mark.study)], ids=["", "nearer"]
)
@pytest.mark.parametrize("case", ENVELOPES)
def test_the_error_of_the_envelope_is_proportional_to_the_shift(case, scenes):
    # nearer to the band a dark soliton of a chain this long may stand anywhere: its place is held by less than 1e-10
    sites, least = scenes[case]
    shifts, errors = least * np.array([1, 1.5, 2]), []
    for shift in shifts:
        if case == "dark Hertz":
            chain, omega, seed, i = (
                monomer(sites),
                6**0.5 * (1 - shift),
                gx.breathers.dark_guess,
                sites // 4,
            )
        elif case == "bright p = 1/2":
            chain, omega, seed, i = (
                monomer(sites, 0.5),
                2**0.5 * (1 + shift),
                gx.breathers.bright_guess,
                sites // 2,
            )
        else:
            chain, omega, seed, i = (
                dimer(sites),
                OMEGA2 * (1 - shift),
                gx.breathers.bright_guess,
                sites // 2,
            )
        b = gx.breathers.breather(chain, omega, seed(chain, omega), steps=128, check=False)
        half = gx.Flow(64)(b.state, 0.0, float(b.period) / 2, chain)
        odd = np.asarray(b.state.u - half.u) / 2
        if case == "dark Hertz":
            found, expected = abs(odd[i] - odd[i + 1]), 2 * (shift * 6**0.5 / 0.459279327) ** 0.5
        else:
            edge = min(edges_beside(chain, omega), key=lambda edge: abs(edge.omega - omega))
            profile = nls.bright_profile(
                edge.coefficients, omega, sites // len(cell_of(chain)[0]) | 1
            )
            expected = 2 * float(profile.amplitude) * float(np.abs(edge.coefficients.mode).max())
            found = abs(odd[i])
        errors.append(abs(expected / found - 1))
    slope = np.polyfit(np.log(shifts), np.log(errors), 1)[0]
    assert slope == pytest.approx(1.0, abs=0.1), errors


@pytest.mark.study
@pytest.mark.parametrize("case", ["softening at pi", "Hertz dimer's optical bottom"])
def test_modulational_instability_grows_at_the_envelopes_rate(case):
    cells, a = 100, 0.1
    if case == "softening at pi":
        chain, n = monomer(cells, 0.5, "periodic"), np.arange(cells)
        shape, omega0, k, branch = (-1.0) ** n, 2**0.5, np.pi, 0
    else:
        chain = gx.scenes.pattern(2 * cells, (HEAVY, 1.0), precompression=1.0, boundary="periodic")
        n = np.arange(2 * cells)
        shape, omega0, k, branch = np.where(n % 2, (-1.0) ** (n // 2), 0.0), OMEGA2, np.pi, 1
    c = cell_of(chain).coefficients(branch, k=k)
    uniform = cell_of(chain).coefficients(branch, "length", k)
    amplitude = a / (2 * float(np.abs(c.mode).max()))
    omega = omega0 + float(uniform.nu3) * amplitude**2
    wave = gx.breathers.breather(chain, omega, gx.State(a * shape, np.zeros(len(n))), check=False)
    found = np.sort(np.log(np.abs(wave.floquet(tolerance=1e-11).multipliers)) / float(wave.period))[
        ::-1
    ]
    Q = 2 * np.pi / cells * np.arange(1, cells // 2)
    y = float(np.abs(np.asarray(wave.state.u)).max()) / (2 * float(np.abs(c.mode).max()))
    expected = np.sort(np.asarray(nls.growth_rate(Q, y, float(c.nu2), float(c.nu3_force))))[::-1]
    assert expected[0] > 0
    # +Q and -Q grow alike
    assert_allclose(found[:2], expected[0], rtol=0.05)


@pytest.mark.study
def test_no_modulational_instability_in_the_hertz_monomer():
    chain = monomer(40, boundary="periodic")
    wave = gx.State(0.05 * (-1.0) ** np.arange(40), np.zeros(40))
    c = cell_of(chain).coefficients(0, "length")
    omega = 6**0.5 + float(c.nu3) * (0.05 / (2 * float(np.abs(c.mode).max()))) ** 2
    b = gx.breathers.breather(chain, omega, wave, check=False)
    assert np.abs(b.state.u).max() > 0.03 and b.floquet(tolerance=1e-11).verdict == "stable"


# --------------------------------------------------------------------------------------------------- published numbers


@pytest.mark.study
@pytest.mark.parametrize(
    "fraction, E, u, largest",
    [
        (0.9900, 2.6192908, (0.6377287, 0.0398740, -0.4638610), 1.0),
        (0.9875, 2.7263022, (0.7122202, 0.0471627, -0.4697628), 1.0),
        (0.9850, 2.7015770, (0.7784533, 0.0526330, -0.4492773), 1.126536),
    ],
)
def test_light_centred_breathers_of_the_dimer(fraction, E, u, largest):
    b = gx.breathers.breather(dimer(121), fraction * OMEGA2)
    assert float(b.energy) == pytest.approx(E, abs=1e-6)
    assert_allclose(b.state.u[60:63], u, atol=1e-6)
    fl = b.floquet()
    if largest == 1.0:
        assert fl.verdict == "stable" and fl.expected == 4
    else:
        assert fl.verdict == "unstable" and abs(fl.multipliers[0]) == pytest.approx(
            largest, abs=1e-5
        )
    assert fl.defect < 1e-12


@pytest.mark.study
def test_the_real_pair_leaves_where_the_energy_has_its_extremum():
    br = gx.breathers.family(dimer(81), until=0.98 * OMEGA2, longest_arclength=0.1)
    assert "reached" in br.outcome
    found = gx.breathers.bifurcations(br, ("real pair at +1", "extremum of energy"))
    at = {b.kind: b.p for b in found}
    assert at["real pair at +1"] == pytest.approx(at["extremum of energy"], rel=1e-6)
    assert at["extremum of energy"] / OMEGA2 == pytest.approx(0.9866761, abs=1e-6)


@pytest.mark.study
def test_the_heavy_centred_family_is_real_unstable():
    br = gx.breathers.family(dimer(121, "heavy"), until=0.98 * OMEGA2, longest_arclength=0.1)
    assert "reached" in br.outcome
    below = br.omega < 0.993 * OMEGA2
    largest = br.multipliers[below, 0]
    assert (
        np.all(br.verdict[below] == "unstable")
        and np.all(np.abs(largest.imag) < 1e-6)
        and np.all(largest.real > 1)
    )


@pytest.mark.study
def test_the_dark_breather_of_the_monomer():
    chain = monomer(82)
    b = gx.breathers.breather(chain, 0.99 * 6**0.5, "dark", steps=96)
    # the number of the literature, 9.321146696, is that of an integrator whose frequency is 4.7e-8 off
    assert float(b.energy) == pytest.approx(9.321099312, rel=1e-8)
    half = gx.Flow(64)(b.state, 0.0, float(b.period) / 2, chain)
    odd = np.asarray(gx.measures.strain(chain, b.state) - gx.measures.strain(chain, half)) / 2
    assert abs(odd[20]) == pytest.approx(0.448960, abs=2e-6)

    def field(t, y):
        force = np.maximum(1 - np.diff(y[:82]), 0) ** 1.5 - 1
        return np.concatenate([y[82:], np.diff(force, prepend=0, append=0) * -1])

    start = np.concatenate([b.state.u, np.zeros(82)])
    end = ended(field, float(b.period) / 2, start)[82:]
    assert np.abs(end).max() < 1e-11


@pytest.mark.study
@pytest.mark.parametrize("gap", [0, 1])
def test_trimers_have_breathers_in_each_gap(gap):
    chain = gx.scenes.trimer(61, (0.5, 0.25), precompression=1.0, boundary="free")
    low, high = gx.linear.bands(chain).gaps[gap]
    br = gx.breathers.family(chain, until=high - 0.05 * (high - low), points=300)
    assert "reached" in br.outcome
    energy = np.asarray(gx.measures.site_energy(chain, br.orbit(-1).state))
    assert gx.measures.participation(energy) < 20


@pytest.mark.study
def test_alternating_softening_and_hardening_contacts():
    chain = dimer(41, law=gx.PowerLaw(1.0, np.where(np.arange(40) % 2, 1.5, 0.5), 1.0))
    found = gx.linear.bands(chain)
    ((low, high),) = [g for g in found.gaps if g[0] > 0][-1:]
    br = gx.breathers.family(chain, until=high - 0.02 * (high - low), points=300)
    assert len(br) > 3 and np.isfinite(br.multipliers).all()


@pytest.mark.study
def test_defects_lead_from_their_modes_to_the_dimers_optical_band():
    # light beads of mass 1/2 at every other of n places in a monomer, whose band ends at sqrt 6; of the dimer the
    # optical band is sqrt 6 ... 3
    lowest, highest = [], []
    for n in (1, 2, 6):
        chain = gx.scenes.defects(63, {32 - n + 2 * i: 0.5 for i in range(n)}, precompression=1.0)
        omega = np.asarray(gx.linear.normal_modes(chain).omega)
        modes = np.flatnonzero(omega > 6**0.5 + 1e-9)
        assert len(modes) == n and omega[-1] < 3
        lowest, highest = [*lowest, omega[modes[0]]], [*highest, omega[-1]]
        br = gx.breathers.family(chain, mode=int(modes[0]), amplitude=0.3, points=40)
        assert (
            "amplitude" in br.outcome
            and np.all(np.diff(br.omega) < 0)
            and np.all(np.diff(br.energy) > 0)
        )
        energy = np.asarray(gx.measures.site_energy(chain, br.orbit(-1).state))
        assert energy[32 - n - 2 : 32 + n + 2].sum() > 0.95 * energy.sum()
    assert np.all(np.diff(lowest) < 0) and np.all(np.diff(highest) > 0) and 3 - highest[-1] < 0.02


@pytest.mark.study
def test_a_dark_breather_at_fixed_length():
    errors, shifts = [], np.array([0.0025, 0.005, 0.01])
    for shift in shifts:
        chain, omega = monomer(162, boundary="fixed"), 6**0.5 * (1 - shift)
        b = gx.breathers.breather(chain, omega, "dark", steps=128)
        half = gx.Flow(64)(b.state, 0.0, float(b.period) / 2, chain)
        odd = np.asarray(b.state.u - half.u) / 2
        # kappa = B |Y|^2, B between those of constant force and fixed length as the mean of |Y|^2 over the chain says:
        # tanh^2(x/w) lacks 2 w at the dip and as much at the walls
        force, length, nu2, r = -0.459279327, -0.153093109, 0.306186218, 1.0
        for _ in range(50):
            B = force + r * (length - force)
            amplitude = (-shift * 6**0.5 / B) ** 0.5
            r = 1 - 4 / 162 / (-force * amplitude**2 / (2 * nu2)) ** 0.5
        errors.append(2 * amplitude / abs(odd[40] - odd[41]) - 1)
    assert np.all(np.abs(errors) < 6 * shifts)


class Tanh(gx.Law):
    """An odd law as a user writes it, of a stiffness K and a length a."""

    stiffness: float
    length: float

    def force(self, e):
        return self.stiffness * self.length * jnp.tanh(e / self.length)

    def energy(self, e):
        return self.stiffness * self.length**2 * jnp.log(jnp.cosh(e / self.length))


class Bent(Tanh):
    """The same, but not odd beyond a third of the length."""

    def force(self, e):
        return super().force(e) + 1e-3 * self.stiffness * jnp.maximum(e - self.length / 3, 0.0)

    def energy(self, e):
        return (
            super().energy(e) + 5e-4 * self.stiffness * jnp.maximum(e - self.length / 3, 0.0) ** 2
        )


def on_sites(own, bonds=gx.Linear(0.5), sites=12):
    """A ring with the band 1 ... sqrt(3)."""
    return gx.Lattice(1.0, (gx.Bond(gx.Shift(1, "periodic"), bonds), gx.OnSite(own)), sites=sites)


def two_fields(own):
    """Bands 1 ... sqrt(3) of each field, whose sites are joined by a spring of a hundredth."""
    fields = [
        (gx.Bond(gx.Shift(1, "periodic", fields=name), gx.Linear(0.5)), gx.OnSite(law, field=name))
        for name, law in (("a", gx.Sine(1.0)), ("b", own))
    ]
    joined = gx.Bond(gx.Shift(0, "periodic", fields=("a", "b")), gx.Polynomial(0.01, 0.0, 0.1))
    return gx.Lattice({"a": np.ones(12), "b": np.ones(12)}, (*fields[0], *fields[1], joined))


ALPHAS = 0.3 * (-1.0) ** np.arange(12)
HARMONICS = {
    "sine-Gordon": (lambda: gx.scenes.sine_gordon(12, 0.5, boundary="periodic"), 0.8, None),
    "its third harmonic": (lambda: gx.scenes.sine_gordon(12, 0.5, boundary="periodic"), 0.5, 3),
    "a law in SI": (lambda: on_sites(Tanh(1.0, 3e-7), Tanh(0.5, 2e-9)), 0.8, None),
    "bent": (lambda: on_sites(Bent(1.0, 3e-7)), 0.8, 2),
    "asymmetric": (lambda: on_sites(gx.Polynomial(1.0, 1e-3, 1.0)), 0.8, 2),
    "staggered": (lambda: on_sites(gx.Polynomial(1.0, ALPHAS, 1.0)), 0.8, 2),
    "asymmetric bonds": (lambda: on_sites(gx.Sine(1.0), gx.Polynomial(0.5, 0.1)), 0.8, 2),
    "two fields": (lambda: two_fields(Tanh(1.0, 5.0)), 0.8, None),
    "two fields, one asymmetric": (lambda: two_fields(gx.Polynomial(1.0, 0.2)), 0.8, 2),
    "all neighbours": (lambda: gx.scenes.fractional_sine_gordon(12, 0.5, 0.5), 0.7, None),
}


@pytest.mark.parametrize(
    "name",
    [
        name if name in ("sine-Gordon", "staggered") else pytest.param(name, marks=pytest.mark.slow)
        for name in HARMONICS
    ],
)
def test_harmonics_that_the_symmetry_forbids_do_not_count(name):
    make, omega, expected = HARMONICS[name]
    found = resonant_harmonic(make(), omega)
    assert (None if found is None else found[0]) == expected


@pytest.mark.slow
def test_a_breather_of_an_odd_force_whose_second_harmonic_would_be_a_wave():
    omega, coupling, n = 0.8, 0.5, np.arange(21) - 10
    away = np.sqrt(1 - omega**2)
    guess = 4 * np.arctan(away / omega / np.cosh(away * n / np.sqrt(coupling)))
    chain = gx.scenes.sine_gordon(21, coupling)
    found = gx.breathers.breather(chain, omega, gx.State(jnp.asarray(guess), jnp.zeros(21)))
    assert found.converged

    def field(t, y):
        u = y[:21]
        ends = np.concatenate([u[:1], u, u[-1:]])
        return np.concatenate([y[21:], coupling * (ends[2:] - 2 * u + ends[:-2]) - np.sin(u)])

    start = np.concatenate([found.state.u, np.zeros(21)])
    half = ended(field, np.pi / omega, start)
    assert_allclose(half, -start, rtol=0, atol=1e-9)
    with refused("n = 2: 2 omega = 1.6 lies in the band"):
        gx.breathers.breather(on_sites(gx.Polynomial(1.0, 0.1, -0.1), sites=21), omega)


def test_a_hardening_chain_has_breathers_above_its_band():
    """The family comes from the highest mode below the frequency, which rises with the energy."""
    family = gx.breathers.family(gx.scenes.fput(16, 0.0, 1.0), until=2.2, stability=False)
    assert family.omega[0] == pytest.approx(2 * np.sin(np.pi * 16 / 34), abs=1e-5)
    assert family.omega[-1] == 2.2 and np.all(np.diff(family.energy) > 0)
    u = np.asarray(family.orbit(-1).state.u)
    assert np.all(u[:-1] * u[1:] < 0) and np.abs(u[0]) < 0.01 * np.abs(u).max()
