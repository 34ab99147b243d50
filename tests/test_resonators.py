"""Chains whose beads carry resonators."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from refusals import refused

import granjax as gx
from granjax import scenes
from granjax.orbits import guesses as envelope

MASSES, STIFFNESSES, HERTZ = (0.3, 0.2), (1.2, 2.1), 1.5
K = np.linspace(0.1, np.pi, 6)


def correction(omega, k, K2, m, masses, stiffnesses):
    """Newton's correction to omega^2, relative, of (m + sum mu_j/(1 - omega^2/omega_j^2)) omega^2 = 4 K2 sin^2(k/2)."""
    x, k = (np.asarray(a, np.longdouble) for a in (omega**2, k))
    roots = [np.longdouble(kappa) / np.longdouble(mu) for mu, kappa in zip(masses, stiffnesses)]
    x0 = np.polynomial.Polynomial(np.array([0.0, 1.0], np.longdouble))
    free = [r - x0 for r in roots]
    product = np.prod(free)
    dressed = m * product + sum(
        mu * r * np.prod(free[:j] + free[j + 1 :]) for j, (mu, r) in enumerate(zip(masses, roots))
    )
    value = (x0 * dressed)(x) - 4 * K2 * np.sin(k / 2) ** 2 * product(x)
    slope = (x0 * dressed).deriv()(x) - 4 * K2 * np.sin(k / 2) ** 2 * product.deriv()(x)
    return np.abs(value / slope / x)


@pytest.mark.slow
def test_bands_of_a_woodpile_are_the_closed_form():
    chain = scenes.woodpile(9, MASSES, STIFFNESSES, bead_mass=1.1, precompression=1.0)
    omega = np.asarray(gx.linear.dispersion(chain, K).omega)
    assert omega.shape == (6, 3)
    for branch in range(3):
        assert correction(omega[:, branch], K, 1.5, 1.1, MASSES, STIFFNESSES).max() < 1e-12
    bands = gx.linear.bands(chain)
    assert len(np.asarray(bands.lower)) == 3


def test_bands_of_one_resonator_are_the_roots_of_a_quadratic():
    m, mu, kappa = 1.0, 0.3, 1.2
    inside, outside = (
        make(9, mu, kappa, precompression=1.0)
        for make in (scenes.mass_in_mass, scenes.mass_with_mass)
    )
    q = 4 * HERTZ * np.sin(K / 2) ** 2
    # m mu x^2 - (kappa (m + mu) + mu q) x + kappa q = 0
    b = kappa * (m + mu) + mu * q
    high = (b + np.sqrt(b**2 - 4 * m * mu * kappa * q)) / (2 * m * mu)
    low = kappa * q / (m * mu * high)
    for chain in (inside, outside, scenes.woodpile(9, [mu], [kappa], precompression=1.0)):
        omega = np.asarray(gx.linear.dispersion(chain, K).omega)
        np.testing.assert_allclose(omega, np.sqrt(np.stack([low, high], -1)), rtol=1e-12)
    bands = gx.linear.bands(inside)
    np.testing.assert_allclose(bands.lower[1], np.sqrt(kappa * (1 / m + 1 / mu)), rtol=1e-12)


@pytest.mark.slow
def test_resonators_that_are_let_go_leave_the_monomer():
    chain = scenes.woodpile(9, MASSES, (0.0, 0.0), precompression=1.0)
    alone = scenes.monomer(9, precompression=1.0)
    omega = np.asarray(gx.linear.dispersion(chain, K).omega)
    np.testing.assert_array_equal(omega[:, :2], 0)
    np.testing.assert_allclose(
        omega[:, 2:], np.asarray(gx.linear.dispersion(alone, K).omega), rtol=1e-13
    )
    u = jnp.asarray(np.random.default_rng(0).normal(size=9))
    full = {"bead": u, "resonator_1": u + 1, "resonator_2": -u}
    forces = chain.force(0.0, full, jax.tree.map(jnp.zeros_like, full))
    np.testing.assert_allclose(forces["bead"], alone.force(0.0, u, 0 * u), rtol=1e-14)


def test_accelerations_are_the_equations():
    rng = np.random.default_rng(1)
    u, w, x = rng.normal(size=(3, 7))
    chain = scenes.woodpile(
        7,
        [0.3, rng.uniform(0.1, 0.2, 7)],
        [1.2, 2.1],
        bead_mass=2.0,
        contact_stiffness=3.0,
        precompression=0.5,
    )
    y = {"bead": jnp.asarray(u), "resonator_1": jnp.asarray(w), "resonator_2": jnp.asarray(x)}
    a = chain.acceleration(0.0, y, jax.tree.map(jnp.zeros_like, y))
    contact = (
        3 * np.maximum((0.5 / 3) ** (2 / 3) - np.diff(np.concatenate([[0], u, [0]])), 0) ** 1.5
    )
    np.testing.assert_allclose(
        a["bead"], (contact[:-1] - contact[1:] - 1.2 * (u - w) - 2.1 * (u - x)) / 2, rtol=1e-12
    )
    np.testing.assert_allclose(a["resonator_1"], 1.2 * (u - w) / 0.3, rtol=1e-12)
    np.testing.assert_allclose(
        a["resonator_2"], 2.1 * (u - x) / np.asarray(chain.mass["resonator_2"]), rtol=1e-12
    )


@pytest.mark.slow
def test_a_few_beads_may_carry_a_mass():
    all_of_them = scenes.mass_with_mass(5, 0.3, 1.2, at=range(5), precompression=1.0)
    every, some = (
        scenes.mass_with_mass(5, 0.3, 1.2, precompression=1.0),
        scenes.mass_with_mass(5, 0.3, 1.2, at=[2, -1]),
    )
    assert some.shape == {"bead": (5,), "resonator": (2,)}
    u = {
        "bead": jnp.asarray([0.1, -0.2, 0.3, 0.0, 0.2]),
        "resonator": jnp.asarray([0.3, 0.1, -0.4, 0.2, 0.0]),
    }
    zero = jax.tree.map(jnp.zeros_like, u)
    first, second = all_of_them.force(0.0, u, zero), every.force(0.0, u, zero)
    for name in u:
        np.testing.assert_allclose(first[name], second[name], rtol=1e-14)
    defect = scenes.mass_with_mass(7, 0.3, 1.2, at=[3])
    run = gx.simulate(defect, gx.states.impact(defect, velocity=1.0), 6.0)
    assert run.final.u["resonator"].shape == (1,) and abs(float(run.final.u["resonator"][0])) > 0.01
    u = {"bead": u["bead"], "resonator": u["resonator"][:2]}
    pull = some.force(0.0, u, jax.tree.map(jnp.zeros_like, u))["resonator"]
    np.testing.assert_allclose(
        pull, 1.2 * (np.asarray(u["bead"])[[2, 4]] - np.asarray(u["resonator"])), rtol=1e-14
    )


@pytest.mark.slow
def test_lanes_units_and_derivatives():
    masses = jnp.array([0.3, 0.5])
    batch = jax.vmap(lambda mu: scenes.mass_in_mass(6, mu, 1.2, precompression=1.0), out_axes=-1)(
        masses
    )
    assert batch.lanes == (2,)
    one = scenes.mass_in_mass(6, 0.5, 1.2, precompression=1.0, units="SI")
    assert one.units == "SI" and batch.units == "scaled"
    u = jax.tree.map(
        lambda x: jnp.asarray(np.random.default_rng(2).normal(size=x.shape)), one.zeros()
    )
    lanes = jax.tree.map(lambda x: jnp.stack([x, x], -1), u)
    zero = jax.tree.map(jnp.zeros_like, (u, lanes))
    a, b = one.acceleration(0.0, u, zero[0]), batch.acceleration(0.0, lanes, zero[1])
    for name in a:
        np.testing.assert_allclose(a[name], b[name][:, 1], rtol=1e-14)
    # the upper band begins at (kappa (1 + 1/mu))^(1/2)
    edge = jax.grad(
        lambda mu: gx.linear.dispersion(
            scenes.mass_in_mass(6, mu, 1.2, precompression=1.0), 1e-6
        ).omega[1]
    )(0.3)
    np.testing.assert_allclose(edge, -1.2 / 0.3**2 / (2 * np.sqrt(1.2 * (1 + 1 / 0.3))), rtol=1e-6)


@pytest.mark.parametrize(
    "make, said",
    [
        (lambda: scenes.mass_in_mass(5, mass=np.ones(4)), "one per bead"),
        (lambda: scenes.mass_in_mass(5, precompression=np.ones(5)), "one per contact"),
        (lambda: scenes.mass_with_mass(5, at=[5]), "at: expected sites from 0 to 4"),
        (lambda: scenes.mass_with_mass(5, at=[1, -4]), "each once"),
        (lambda: scenes.mass_with_mass(5, at=[]), "at: expected .* one at least, got"),
        (lambda: scenes.mass_with_mass(5, np.ones(3), at=[1, 2]), "one per resonator"),
        (lambda: scenes.woodpile(5, [0.3], [1.2, 1.0]), "stiffnesses: expected 1"),
    ],
)
def test_refused(make, said):
    with refused(said):
        make()


def standing(lattice, a, kappa, mu):
    """Frequencies of u_n = (-1)^n a(t) with resonators and Hertz contacts, d0 = A = m = 1, from rest at a, by SciPy."""
    from scipy.integrate import solve_ivp
    from scipy.optimize import root

    f = lambda x: max(1 - 2 * x, 0) ** 1.5 - max(1 + 2 * x, 0) ** 1.5

    def end(unknown):
        w, half = unknown
        field = lambda t, y: [
            y[2],
            y[3],
            f(y[0]) - kappa * (y[0] - y[1]),
            kappa * (y[0] - y[1]) / mu,
        ]
        return solve_ivp(field, (0, half), [a, w, 0, 0], rtol=1e-11, atol=1e-13).y[2:, -1]

    top = gx.linear.dispersion(lattice, np.pi)
    found = []
    for omega in np.asarray(top.omega):
        swing = a / (1 - omega**2 * mu / kappa)
        found.append(np.pi / root(end, [swing, np.pi / omega], tol=1e-11).x[1])
    return np.array(found), np.asarray(top.omega)


@pytest.mark.slow
def test_envelopes_shift_the_frequency_as_standing_waves_do():
    kappa, mu = 1.2, 0.3
    chain = scenes.mass_in_mass(8, mu, kappa, precompression=1.0)
    dressed = envelope.dressed(chain)
    shifts = []
    for a in (0.02, 0.04):
        omega, linear = standing(chain, a, kappa, mu)
        # strains 2 a cos(omega t), so |Y| = a; the ring keeps its length
        shifts.append((omega - linear) / a**2)
    shift = shifts[0] + (shifts[0] - shifts[1]) / 3
    nu3 = [float(dressed.coefficients(branch, "length").nu3) for branch in (0, 1)]
    np.testing.assert_allclose(shift, nu3, rtol=2e-4)


@pytest.mark.study
@pytest.mark.parametrize("branch", [0, 1])
def test_dark_breathers_of_precompressed_chains(branch):
    chain = scenes.mass_in_mass(40, 0.3, 1.2, precompression=1.0, boundary="free")
    top = float(gx.linear.bands(chain).upper[branch])
    dark = gx.breathers.breather(chain, 0.994 * top, "dark", steps=64)
    assert dark.converged and float(jnp.abs(dark.error.state.u["bead"]).max()) < 1e-7
    guess = gx.breathers.guesses.dark_guess(chain, 0.994 * top)
    if branch:
        axes = gx.plots.breather(dark, field="resonator")
        assert axes.shape == (2, 2) and gx.plots.breather(dark, axes=axes).shape == (2, 2)
        with refused("field: expected one of 'bead', 'resonator'"):
            gx.plots.breather(dark, field="ring")
    for name in ("bead", "resonator"):
        own, envelope_of = (-np.diff(x.u[name]) for x in (dark.state, guess))
        # the dip, and of the envelope's the middle; constant forces end a chain with strains of their own
        assert abs(own[19]) < 0.03 * np.abs(own).max()
        assert np.abs(own - envelope_of)[14:-14].max() < 0.06 * np.abs(own).max()


@pytest.mark.slow
def test_bright_breathers_of_a_softening_chain_with_resonators():
    law = gx.PowerLaw(1.0, 0.5, 1.0)
    chain = scenes.mass_in_mass(40, 0.3, 1.2, law=law, boundary="free")
    omega = 1.001 * float(gx.linear.bands(chain).upper[1])
    bright = gx.breathers.breather(chain, omega, "bright", steps=64)
    guess = gx.breathers.guesses.bright_guess(chain, omega)
    assert bright.converged
    for name in ("bead", "resonator"):
        own, other = (-np.diff(x.u[name]) for x in (bright.state, guess))
        assert np.abs(own - other).max() < 0.1 * np.abs(own).max()  # the square of strains near d0


@pytest.mark.slow
def test_why_there_is_no_bright_breather():
    precompressed = scenes.mass_in_mass(12, 0.3, 1.2, precompression=1.0)
    with refused("only dark"):
        gx.breathers.breather(precompressed, 2.0, "bright")
    only_pushes = gx.orbits.families._only_pushes
    assert only_pushes(scenes.mass_in_mass(12, 5.0, 1.0)) and only_pushes(scenes.monomer(12))
    chain = scenes.mass_in_mass(6, 5.0, 1.0)
    start = gx.State({"bead": 0.01 * jnp.eye(6)[2], "resonator": jnp.zeros(6)}, chain.zeros())
    with pytest.raises(RuntimeError, match="push and never pull"):
        gx.breathers.breather(chain, 1.2, start, steps=32)
    held = gx.Lattice(1.0, (*scenes.monomer(12).terms, gx.OnSite(gx.Linear(1.0))), sites=12)
    assert not any(map(only_pushes, (precompressed, held, scenes.toda(12))))


class TwoWays(gx.Law):
    """F = A e |e|^(1/2): a spring as stiff in extension as a Hertz contact in compression, and soft at rest."""

    opens = False
    stiffness: jax.Array

    def force(self, e):
        return self.stiffness * (gx.laws.plus_power(e, 1.5) - gx.laws.plus_power(-e, 1.5))

    def energy(self, e):
        return self.stiffness * 2 / 5 * (gx.laws.plus_power(e, 2.5) + gx.laws.plus_power(-e, 2.5))


@pytest.mark.study
def test_bright_breather_without_precompression_decays_super_exponentially():
    # pushed and pulled alike, the mean force of every contact is zero: a breather that lasts
    chain = scenes.mass_in_mass(12, 0.5, 1.0, law=TwoWays(jnp.asarray(1.0)), boundary="free")
    omega = 1.1 * float(gx.Resonator(0.5, 1.0).swing())
    bright = gx.breathers.breather(chain, omega)
    e = np.abs(np.diff(np.asarray(bright.state.u["bead"])))
    e = e[np.argmax(e) + 1 :]
    e = e[e > 1e-9 * e[0]]
    steps = np.diff(np.log(e))
    ratios = steps[1:] / steps[:-1]
    # log e_{n+1} = (3/2) log e_n + ...
    assert bright.converged and len(ratios) >= 2 and np.all(ratios > 1.5)
    np.testing.assert_allclose(ratios[-1], 1.5, atol=0.05)


@pytest.mark.slow
def test_a_tail_free_wave_leaves_no_resonator_swinging():
    kappa = float(gx.travelling.tail_free_stiffness(1.0, 0.1))
    wave = gx.travelling.solitary_wave(gx.Hertz(), speed=1.0, resonator=gx.Resonator(0.1, kappa))
    chain = scenes.mass_in_mass(40, 0.1, kappa, boundary="free")
    run = gx.simulate(chain, wave.state(40, 10.0), 15.0, tolerance=1e-11)
    known = wave.state(40, 25.0)
    for name in ("bead", "resonator"):
        np.testing.assert_allclose(run.final.v[name], known.v[name], rtol=0, atol=1e-9)
    with refused("a stiffness of 3.588947"):
        gx.travelling.solitary_wave(
            gx.Hertz(), speed=1.0, resonator=gx.Resonator(0.1, 1.05 * kappa)
        )


@pytest.mark.study
def test_heavy_resonators_hold_a_bright_breather_for_long():
    # relative to its resonator a bead is a cradle's: m (m + mu)/mu, kappa (m + mu)^2/mu^2, until the pairs have drifted
    kappa, sites = 1.0, 11
    left = []
    for mu in (100.0, 10000.0):
        mass, spring = (1 + mu) / mu, kappa * ((1 + mu) / mu) ** 2
        contacts = gx.Bond(gx.Shift(1, "free"), gx.Hertz())
        cradle = gx.Lattice(mass, (contacts, gx.OnSite(gx.Linear(spring))), sites=sites)
        omega = 1.1 * np.sqrt(spring / mass)
        start = gx.breathers.breather(cradle, omega).state.u
        chain = scenes.mass_in_mass(sites, mu, kappa, boundary="free")
        state = gx.State({"bead": start, "resonator": -start / mu}, chain.zeros())
        run = gx.simulate(chain, state, 20 * 2 * np.pi / omega, save_at=201)
        push = np.maximum(-np.diff(np.asarray(run.us["bead"]), axis=1), 0)
        first, last = (np.sort(push[i].max(0))[::-1] for i in (slice(0, 11), slice(-11, None)))
        left.append(last[0] / first[0])
    assert left[0] < 0.8 and left[1] > 0.97
    # of the one that lasts, each strain is nearly the power 3/2 of that before
    tail = push[-11:].max(0)
    tail = np.log(tail[np.argmax(tail) + 1 :])
    steps = np.diff(tail)
    assert np.all(steps[1:] / steps[:-1] > 1.3) and len(steps) >= 3
