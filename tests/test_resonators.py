"""Chains whose beads carry resonators."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose
from refusals import refused
from scipy.integrate import solve_ivp
from scipy.optimize import root

import granjax as gx
from granjax import scenes
from granjax.orbits import guesses as envelope

MASSES = (0.3, 0.2)
STIFFNESSES = (1.2, 2.1)
HERTZ = 1.5
K = np.linspace(0.1, np.pi, 6)


def zeros(tree):
    return jax.tree.map(jnp.zeros_like, tree)


def in_mass(sites, mu, kappa, **how):
    return scenes.mass_in_mass(sites, mu, kappa, **{"precompression": 1.0, **how})


@pytest.mark.slow
def test_bands_of_a_woodpile_are_those_of_its_dynamical_matrix():
    chain = scenes.woodpile(9, MASSES, STIFFNESSES, bead_mass=1.1, precompression=1.0)
    ties = np.diag([sum(STIFFNESSES), *STIFFNESSES])
    ties[0, 1:] = ties[1:, 0] = -np.array(STIFFNESSES)
    bonds = 4 * HERTZ * np.sin(K[:, None, None] / 2) ** 2 * np.diag([1, 0, 0])
    root_mass = np.sqrt([1.1, *MASSES])
    squares = np.linalg.eigvalsh((ties + bonds) / np.outer(root_mass, root_mass))
    assert_allclose(gx.linear.dispersion(chain, K).omega ** 2, squares, rtol=1e-12)
    assert len(np.asarray(gx.linear.bands(chain).lower)) == 3


@pytest.mark.slow
def test_bands_of_one_resonator_are_the_roots_of_a_quadratic():
    m = 1.0
    mu = 0.3
    kappa = 1.2
    inside = in_mass(9, mu, kappa)
    outside = scenes.mass_with_mass(9, mu, kappa, precompression=1.0)
    q = 4 * HERTZ * np.sin(K / 2) ** 2
    # m mu x^2 - (kappa (m + mu) + mu q) x + kappa q = 0
    b = kappa * (m + mu) + mu * q
    high = (b + np.sqrt(b**2 - 4 * m * mu * kappa * q)) / (2 * m * mu)
    low = kappa * q / (m * mu * high)
    for chain in (inside, outside, scenes.woodpile(9, [mu], [kappa], precompression=1.0)):
        omega = gx.linear.dispersion(chain, K).omega
        assert_allclose(omega, np.sqrt(np.stack([low, high], -1)), rtol=1e-12)
    bands = gx.linear.bands(inside)
    assert_allclose(bands.lower[1], np.sqrt(kappa * (1 / m + 1 / mu)), rtol=1e-12)


def test_accelerations_are_the_equations():
    rng = np.random.default_rng(1)
    u, w, x = rng.normal(size=(3, 7))
    masses = [0.3, rng.uniform(0.1, 0.2, 7)]
    bead = dict(bead_mass=2.0, contact_stiffness=3.0)
    chain = scenes.woodpile(7, masses, STIFFNESSES, precompression=0.5, **bead)
    y = {"bead": jnp.asarray(u), "resonator_1": jnp.asarray(w), "resonator_2": jnp.asarray(x)}
    a = chain.acceleration(0.0, y, zeros(y))
    overlap = (0.5 / 3) ** (2 / 3) - np.diff(u, prepend=0, append=0)
    contact = 3 * np.maximum(overlap, 0) ** 1.5
    first = 1.2 * (u - w)
    second = 2.1 * (u - x)
    assert_allclose(a["bead"], (-np.diff(contact) - first - second) / 2, rtol=1e-12)
    assert_allclose(a["resonator_1"], first / 0.3, rtol=1e-12)
    assert_allclose(a["resonator_2"], second / masses[1], rtol=1e-12)


@pytest.mark.slow
def test_a_few_beads_may_carry_a_mass():
    every, all_of_them, some = (
        scenes.mass_with_mass(5, 0.3, 1.2, precompression=1.0, **at)
        for at in ({}, {"at": range(5)}, {"at": [2, -1]})
    )
    bead, resonator = jnp.asarray(np.random.default_rng(2).normal(size=(2, 5)))
    u = {"bead": bead, "resonator": resonator}
    first, second = (x.force(0.0, u, zeros(u)) for x in (all_of_them, every))
    for name in u:
        assert_allclose(first[name], second[name], rtol=1e-14)
    assert some.shape == {"bead": (5,), "resonator": (2,)}
    u["resonator"] = resonator[:2]
    pull = some.force(0.0, u, zeros(u))["resonator"]
    assert_allclose(pull, 1.2 * (bead[np.array([2, 4])] - resonator[:2]), rtol=1e-14)


@pytest.mark.slow
def test_lanes_units_and_derivatives():
    batch = jax.vmap(lambda mu: in_mass(6, mu, 1.2), out_axes=-1)(jnp.array([0.3, 0.5]))
    one = in_mass(6, 0.5, 1.2, units="SI")
    assert batch.lanes == (2,) and (one.units, batch.units) == ("SI", "scaled")
    rng = np.random.default_rng(2)
    u = jax.tree.map(lambda x: jnp.asarray(rng.normal(size=x.shape)), one.zeros())
    lanes = jax.tree.map(lambda x: jnp.stack([x, x], -1), u)
    a, b = (x.acceleration(0.0, y, zeros(y)) for x, y in ((one, u), (batch, lanes)))
    for name in a:
        assert_allclose(a[name], b[name][:, 1], rtol=1e-14)
    # the upper band begins at (kappa (1 + 1/mu))^(1/2)
    edge = jax.grad(lambda mu: gx.linear.dispersion(in_mass(6, mu, 1.2), 1e-6).omega[1])(0.3)
    assert_allclose(edge, -1.2 / 0.3**2 / (2 * np.sqrt(1.2 * (1 + 1 / 0.3))), rtol=1e-6)


def test_the_nearest_stiffness_without_a_tail_is_the_nearest_one():
    # they are kappa_n = (2 pi n)^2/2, halfway between the first two at 5 pi^2
    for factor, n in ((0.99, 1), (1.01, 2)):
        resonator = gx.Resonator(1.0, factor * 5 * np.pi**2)
        assert_allclose(resonator.tail_free(1.0), 2 * (np.pi * n) ** 2, rtol=1e-14)


def bright(sites, omega):
    return lambda: gx.breathers.breather(in_mass(sites, 0.3, 1.2), omega, "bright")


def travelling(kappa):
    resonator = gx.Resonator(0.1, kappa)
    return lambda: gx.travelling.solitary_wave(gx.Hertz(), speed=1.0, resonator=resonator)


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
        (bright(12, 2.0), "only dark"),
        (travelling(3.77), "a stiffness of 3.588947"),
    ],
)
def test_what_cannot_be_is_refused(make, said):
    with refused(said):
        make()


def standing(a, omega, kappa, mu):
    """Frequency near omega of u_n = (-1)^n a(t) with resonators and Hertz contacts, d0 = A = m = 1, by SciPy."""
    f = lambda x: max(1 - 2 * x, 0) ** 1.5 - max(1 + 2 * x, 0) ** 1.5

    def field(t, y):
        pull = kappa * (y[0] - y[1])
        return [y[2], y[3], f(y[0]) - pull, pull / mu]

    def end(unknown):
        w, half = unknown
        return solve_ivp(field, (0, half), [a, w, 0, 0], rtol=1e-11, atol=1e-13).y[2:, -1]

    swing = a / (1 - omega**2 * mu / kappa)
    return np.pi / root(end, [swing, np.pi / omega], tol=1e-11).x[1]


@pytest.mark.slow
def test_envelopes_shift_the_frequency_as_standing_waves_do():
    chain = in_mass(8, 0.3, 1.2)
    dressed = envelope.dressed(chain)
    for branch, omega in enumerate(map(float, gx.linear.dispersion(chain, np.pi).omega)):
        # strains 2 a cos(omega t), so |Y| = a; the ring keeps its length
        near, far = ((standing(a, omega, 1.2, 0.3) - omega) / a**2 for a in (0.02, 0.04))
        nu3 = dressed.coefficients(branch, "length").nu3
        assert_allclose(near + (near - far) / 3, nu3, rtol=2e-4)


@pytest.mark.slow
@pytest.mark.parametrize("branch", [0, 1])
def test_dark_breathers_of_precompressed_chains(branch):
    chain = in_mass(40, 0.3, 1.2, boundary="free")
    omega = 0.994 * float(gx.linear.bands(chain).upper[branch])
    dark = gx.breathers.breather(chain, omega, "dark", steps=64)
    assert dark.converged and float(jnp.abs(dark.error.state.u["bead"]).max()) < 1e-7
    guess = gx.breathers.guesses.dark_guess(chain, omega)
    for name in ("bead", "resonator"):
        own, envelope_of = (-np.diff(x.u[name]) for x in (dark.state, guess))
        # the dip, and of the envelope's the middle; constant forces end a chain with strains of their own
        assert abs(own[19]) < 0.03 * np.abs(own).max()
        assert np.abs(own - envelope_of)[14:-14].max() < 0.06 * np.abs(own).max()
    if branch:
        axes = gx.plots.breather(dark, field="resonator")
        assert axes.shape == (2, 2) and gx.plots.breather(dark, axes=axes).shape == (2, 2)
        with refused("field: expected one of 'bead', 'resonator'"):
            gx.plots.breather(dark, field="ring")


@pytest.mark.slow
def test_bright_breathers_of_a_softening_chain_with_resonators():
    chain = scenes.mass_in_mass(40, 0.3, 1.2, law=gx.PowerLaw(1.0, 0.5, 1.0), boundary="free")
    omega = 1.001 * float(gx.linear.bands(chain).upper[1])
    orbit = gx.breathers.breather(chain, omega, "bright", steps=64)
    guess = gx.breathers.guesses.bright_guess(chain, omega)
    assert orbit.converged
    for name in ("bead", "resonator"):
        own, other = (-np.diff(x.u[name]) for x in (orbit.state, guess))
        assert np.abs(own - other).max() < 0.1 * np.abs(own).max()  # the square of strains near d0


@pytest.mark.slow
def test_contacts_that_only_push_let_no_breather_last():
    only_pushes = gx.orbits.families._only_pushes
    assert only_pushes(scenes.monomer(12))
    held = gx.Lattice(1.0, (*scenes.monomer(12).terms, gx.OnSite(gx.Linear(1.0))), sites=12)
    assert not any(map(only_pushes, (in_mass(12, 0.3, 1.2), held, scenes.toda(12))))
    chain = scenes.mass_in_mass(6, 5.0, 1.0)
    start = gx.State({"bead": 0.01 * jnp.eye(6)[2], "resonator": jnp.zeros(6)}, chain.zeros())
    with pytest.raises(RuntimeError, match="push and never pull"):
        gx.breathers.breather(chain, 1.2, start, steps=32)


class TwoWays(gx.Law):
    """F = A e |e|^(1/2): a spring as stiff in extension as a Hertz contact in compression, and soft at rest."""

    opens = False
    stiffness: jax.Array

    def force(self, e):
        return self.stiffness * (gx.laws.plus_power(e, 1.5) - gx.laws.plus_power(-e, 1.5))

    def energy(self, e):
        return self.stiffness * 2 / 5 * (gx.laws.plus_power(e, 2.5) + gx.laws.plus_power(-e, 2.5))


def ratios(strains, least=0.0):
    """Ratios of successive changes of log e beyond the largest strain: 3/2 where each is that power of the last."""
    e = strains[np.argmax(strains) + 1 :]
    steps = np.diff(np.log(e[e > least * e[0]]))
    return steps[1:] / steps[:-1]


@pytest.mark.slow
def test_bright_breather_without_precompression_decays_super_exponentially():
    # pushed and pulled alike, the mean force of every contact is zero: a breather that lasts
    chain = scenes.mass_in_mass(12, 0.5, 1.0, law=TwoWays(jnp.asarray(1.0)), boundary="free")
    orbit = gx.breathers.breather(chain, 1.1 * float(gx.Resonator(0.5, 1.0).swing()))
    found = ratios(np.abs(np.diff(np.asarray(orbit.state.u["bead"]))), 1e-9)
    # log e_{n+1} = (3/2) log e_n + ...
    assert orbit.converged and len(found) >= 2 and np.all(found > 1.5)
    assert_allclose(found[-1], 1.5, atol=0.05)


@pytest.mark.slow
def test_heavy_resonators_hold_a_bright_breather_for_long():
    # relative to its resonator a bead is a cradle's: m (m + mu)/mu, kappa (m + mu)^2/mu^2, until the pairs have drifted
    left = []
    contacts = gx.Bond(gx.Shift(1, "free"), gx.Hertz())
    for mu in (100.0, 10000.0):
        mass = (1 + mu) / mu
        cradle = gx.Lattice(mass, (contacts, gx.OnSite(gx.Linear(mass**2))), sites=11)
        omega = 1.1 * np.sqrt(mass)
        start = gx.breathers.breather(cradle, omega).state.u
        chain = scenes.mass_in_mass(11, mu, 1.0, boundary="free")
        state = gx.State({"bead": start, "resonator": -start / mu}, chain.zeros())
        run = gx.simulate(chain, state, 20 * 2 * np.pi / omega, save_at=201)
        push = np.maximum(-np.diff(np.asarray(run.us["bead"]), axis=1), 0)
        left.append(push[-11:].max() / push[:11].max())
    assert left[0] < 0.8 and left[1] > 0.97
    # of the one that lasts, each strain is nearly the power 3/2 of that before
    found = ratios(push[-11:].max(0))
    assert np.all(found > 1.3) and len(found) >= 2
