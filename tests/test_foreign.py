"""Kinds of a user's own, written with `force` and `energy` alone: each gets what the library's own kinds get."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import over
from jax.flatten_util import ravel_pytree
from numpy.testing import assert_allclose, assert_array_equal
from refusals import refused

import granjax as gx
from granjax import Bond, Lattice, Linear, OnSite, Polynomial, Shift, State, Term
from granjax.flow.steps import STEP_FRACTION, frequency_bound
from granjax.lattice import linearised
from granjax.orbits.asked import shifts
from granjax.strains import Stencil

N = 8


class Adhesive(gx.Law):
    """F(e) = a (exp(2 b e) - exp(b e)): repels in compression, sticks in tension, lets go far away."""

    strength: jax.Array
    rate: jax.Array

    def force(self, e):
        x = jnp.exp(self.rate * e)
        return self.strength * x * (x - 1)

    def energy(self, e):
        return self.strength / (2 * self.rate) * (jnp.exp(self.rate * e) - 1) ** 2


class Bend(Term):
    """A chain that resists bending: energy k c^2/2 + c^4/4 with c = u_{n-1} - 2 u_n + u_{n+1}."""

    stiffness: jax.Array

    def energy(self, t, u):
        c = u[:-2] - 2 * u[1:-1] + u[2:]
        return self.stiffness * c**2 / 2 + c**4 / 4

    def force(self, t, u, v, mass):
        return -jax.grad(lambda u: self.energy(t, u).sum())(u)


class ShearRotation(Term):
    """Beads of a ring that shear and roll: e = u_n - u_{n+1} + R (theta_n + theta_{n+1}), energy k e^2/2 + e^4/4."""

    stiffness: jax.Array
    radius: float = eqx.field(static=True, default=0.5)

    def energy(self, t, x):
        u = x["u"]
        theta = x["theta"]
        e = u - jnp.roll(u, -1, 0) + self.radius * (theta + jnp.roll(theta, -1, 0))
        return self.stiffness * e**2 / 2 + e**4 / 4

    def force(self, t, x, v, mass):
        return jax.tree.map(jnp.negative, jax.grad(lambda x: self.energy(t, x).sum())(x))


class Friction(Term):
    """Drag without memory: -c v |v|."""

    coefficient: jax.Array

    def force(self, t, u, v, mass):
        return -self.coefficient * v * jnp.abs(v)


RING = Bond(Shift(1, "periodic"), Polynomial(1.0, 0.0, 1.0))
CHAIN = Bond(Shift(1, "free"), Polynomial(1.0, 0.0, 1.0))
NAMED = Bond(Shift(1, "periodic", "u"), Linear(0.3)), OnSite(Linear(0.2), "theta")
K = jnp.asarray(0.7)


class Case(NamedTuple):
    """A lattice as a function of one parameter, and how far it moves."""

    name: str
    make: object
    size: float = 0.3


def _bead(*terms):
    return Lattice(1.0, terms, sites=N)


def _rolling(*terms):
    return Lattice({"u": 1.0, "theta": 0.4}, (*terms, *NAMED), sites=N)


def _sticking(k):
    return _bead(Bond(Shift(1, "periodic"), Adhesive(k, jnp.asarray(1.0))))


ADHESIVE = Case("adhesive", _sticking, 0.1)
BEND = Case("bend", lambda k: _bead(CHAIN, Bend(k)))
ROLLING = Case("shear and rotation", lambda k: _rolling(ShearRotation(k)))
FRICTION = Case("friction", lambda k: _bead(RING, Friction(k), OnSite(Linear(0.1))))
CASES = ADHESIVE, BEND, ROLLING, FRICTION


def moving(case):
    random = np.random.default_rng(0)
    draw = lambda s: jnp.asarray(case.size * random.normal(size=s.shape))
    template = case.make(K).template()
    return State(jax.tree.map(draw, template), jax.tree.map(draw, template))


def dense(lattice, u):
    """M^-1/2 K M^-1/2 about u, from the force alone."""
    flat, unravel = ravel_pytree(u)
    zeros = jax.tree.map(jnp.zeros_like, u)
    force = lambda x: ravel_pytree(lattice.force(0.0, unravel(x), zeros))[0]
    mass = ravel_pytree(jax.tree.map(lambda m, u: jnp.broadcast_to(m, u.shape), lattice.mass, u))[0]
    return -jax.jacfwd(force)(flat) / jnp.sqrt(mass[:, None] * mass)


def largest_frequency(lattice, us):
    squared = jax.lax.map(lambda u: jnp.linalg.eigvalsh(dense(lattice, u)).max(), us)
    return np.sqrt(float(squared.max()))


class Pushed(OnSite):
    """What inherits that it keeps the energy, and does not."""

    def force(self, t, u, v, mass):
        return -jnp.cos(t) * self.law.force(u)


class Slowed(OnSite):
    """What inherits that it reads no velocity, and does."""

    def force(self, t, u, v, mass):
        return -self.law.force(u) - 0.1 * v


class Circling(Term):
    """A force that is no gradient, with an energy all the same."""

    strength: jax.Array

    def force(self, t, u, v, mass):
        return self.strength * jnp.roll(u, 1, 0)

    def energy(self, t, u):
        return -self.strength * u**2 / 2


@pytest.mark.slow
@pytest.mark.parametrize(
    "term", [Pushed(Linear(0.5)), Slowed(Linear(0.5)), Circling(K), Friction(K)]
)
def test_an_energy_that_is_not_kept_has_no_error(term):
    lattice = _bead(RING, term)
    state = moving(BEND)
    run = gx.simulate(lattice, state, 5.0)
    assert np.isnan(run.energy_error) and "no energy is kept" in repr(run)
    said = "The force of Circling is not the slope of its `energy`" in run.outcome
    assert said == lattice.conserves == (type(term) is Circling)
    assert lattice.reads_time == (type(term) is Pushed)
    assert lattice.reads_velocity == isinstance(term, (Slowed, Friction))
    if lattice.reads_velocity:
        assert run.solver == "Dopri8"
        with refused(type(term).__name__):
            gx.simulate(lattice, state, 5.0, solver=gx.SRKN11b(), step=0.1)


@over(CASES)
def test_energies_and_modes_are_those_of_the_force(case):
    lattice = case.make(K)
    state = moving(case)
    share = jax.tree.leaves(gx.measures.site_energy(lattice, state))
    total = sum(float(jnp.sum(x)) for x in share)
    assert_allclose(total, float(gx.measures.energy(lattice, state)), rtol=1e-13)
    assert lattice.conserves == (case is not FRICTION) and not lattice.reads_time
    want = np.linalg.eigvalsh(np.asarray(dense(lattice, lattice.zeros())))
    got = gx.linear.normal_modes(lattice).omega_squared
    assert_allclose(got, want, rtol=0, atol=1e-13 * want.max())


@over(CASES)
def test_a_uniform_displacement_costs_nothing(case):
    """On rings and free chains; rolling beads keep their angle, friction's sites are tied."""
    moves = np.asarray(shifts(case.make(K)))
    if case is FRICTION:
        assert moves.shape[1] == 0
    else:
        still = np.zeros(N) if case is ROLLING else []
        # the fields in the order of their names: theta, u
        assert_array_equal(moves, np.append(still, np.ones(N))[:, None])


def test_an_adhesive_contact_is_measured():
    lattice = ADHESIVE.make(K)
    state = moving(ADHESIVE)
    e = np.asarray(state.u) - np.roll(state.u, -1)
    assert_allclose(gx.measures.strain(lattice, state), e, atol=1e-15)
    force = gx.measures.contact_force(lattice, state)
    assert_allclose(force, 0.7 * np.exp(e) * (np.exp(e) - 1), atol=1e-15)
    with refused("Adhesive"):
        gx.measures.overlap(lattice, state)


@pytest.mark.slow
@over([BEND, ROLLING])
def test_a_breather_and_its_multipliers(case):
    """The nonlinear continuation of the highest mode: closed, of finite size, with four multipliers at +1."""
    lattice = case.make(K)
    modes = gx.linear.normal_modes(lattice)
    shape = jax.tree.map(lambda x: 0.3 * x[..., -1], modes.modes)
    guess = State(shape, jax.tree.map(jnp.zeros_like, shape))
    omega = 1.01 * float(modes.omega[-1])
    found = gx.breathers.breather(lattice, omega, guess, check=False, steps=80)
    assert float(found.energy) > 1e-3
    floquet = found.floquet()
    near = np.abs(np.asarray(floquet.multipliers) - 1) < 1e-3
    assert near.sum() == floquet.expected == 4


@pytest.mark.slow
@over([BEND, ROLLING, FRICTION])
def test_derivatives_in_both_modes(case):
    """d/dk of a scalar of a run: forward, reverse and a difference."""
    state = moving(case)

    def scalar(k):
        run = gx.simulate(case.make(k), state, 2.0, step=0.05)
        return sum(jnp.sum(x**2) for x in jax.tree.leaves(run.final))

    forward = jax.jit(jax.jacfwd(scalar))(K)
    reverse = jax.jit(jax.grad(scalar))(K)
    h = 1e-4
    value = jax.jit(scalar)
    difference = (value(K + h) - value(K - h)) / (2 * h)
    assert_allclose([forward, reverse], float(difference), rtol=1e-6)
    assert_allclose(forward, reverse, rtol=1e-9)


@pytest.mark.slow
def test_a_fit_finds_the_parameter():
    state = moving(ROLLING)
    times = np.linspace(0.0, 4.0, 41)
    run = gx.simulate(ROLLING.make(K), state, 4.0, save_at=times, tolerance=1e-10)
    data = np.asarray(run.vs["u"])[:, :2]
    traces = gx.Traces(times=times, velocity=data, sites=[0, 1], sigma=1e-4, field="u")
    make = lambda p: ROLLING.make(p["k"])
    found = gx.fit(make, {"k": 0.5}, traces, state=lambda p, lattice: state)
    assert_allclose(found.parameters["k"], 0.7, rtol=1e-4)


@over([ADHESIVE, BEND, ROLLING])
def test_other_units(case):
    """In other units the term gives the same force, whatever its parameters mean."""
    lattice = case.make(K)
    state = moving(case)
    units = gx.scenes.Units(3e-3, 2e-6, 5e-5)
    scaled = gx.scenes.scaled(lattice, units=units).lattice
    there = scaled.force(0.0, *units.state_from_si(state))
    here = lattice.force(0.0, *state)
    want = ravel_pytree(here)[0] / units.force
    assert_allclose(ravel_pytree(there)[0], want, atol=1e-13 * float(jnp.abs(want).max()))


def test_the_library_s_stencils_are_the_same_lattices():
    """Shear with rotation and bending by `Stencil`, the sum of (field, offset, weight), against the terms above."""
    law = Polynomial(0.7, 0.0, 1.0)
    shear = Stencil(
        [("u", 0, 1.0), ("u", 1, -1.0), ("theta", 0, 0.5), ("theta", 1, 0.5)], "periodic"
    )
    bend = Stencil([(None, 0, 1.0), (None, 1, -2.0), (None, 2, 1.0)], "free")
    for case, own in (
        (ROLLING, _rolling(Bond(shear, law))),
        (BEND, _bead(CHAIN, Bond(bend, law))),
    ):
        got, want = (x.force(0.0, *moving(case)) for x in (own, case.make(K)))
        assert_allclose(ravel_pytree(got)[0], ravel_pytree(want)[0], atol=1e-14)
        assert_array_equal(shifts(own), shifts(case.make(K)))


class OwnContacts(Bend):
    """A term with contacts of its own, that says which."""

    def compressions(self, t, u):
        return (gx.terms.Compression(gx.Hertz(self.stiffness), u[:-1] - u[1:]),)


@pytest.mark.slow
def test_contacts_of_a_term_of_ones_own_modulated_or_not():
    state = State(moving(BEND).u, jnp.zeros(N))
    overlaps = np.maximum(-np.diff(state.u), 0)
    own = OwnContacts(K)
    for term, factor in (own, 1.0), (gx.Modulated(own, lambda t: 2.0 + 0 * t), 2.0):
        lattice = _bead(CHAIN, term)
        force = gx.measures.contact_force(lattice, state, bond=1)
        assert_allclose(force, factor * 0.7 * overlaps**1.5, atol=1e-15)
        assert bool(gx.simulate(lattice, state, 0.1, step=0.05).contact_opened)
        share = float(jnp.sum(gx.measures.site_energy(lattice, state)))
        assert_allclose(share, float(gx.measures.energy(lattice, state)), rtol=1e-13)


@pytest.mark.slow
def test_a_modulated_term_of_ones_own():
    """A period's monodromy with g = 1 + 0.1 cos(2 t): nothing is expected at +1 but the free displacement."""
    lattice = _bead(CHAIN, gx.Modulated(Bend(K), gx.Harmonic(0.1, 2.0, mean=1.0)))
    assert lattice.reads_time and not lattice.conserves
    found = gx.floquet.floquet(lattice, gx.states.rest(lattice), np.pi)
    assert found.expected == 2 and (np.abs(np.asarray(found.multipliers) - 1) < 1e-3).sum() == 2


@pytest.mark.slow
def test_the_bound_of_the_frequencies_holds_for_short_drives_and_uneven_lanes():
    """A drive whose period divides the samples; stiffnesses that differ by bonds, alone and in lanes."""
    t1 = 256 * 2 * np.pi / 1.5
    driven = _bead(RING, gx.Drive(gx.Harmonic(20.0, 1.5, phase=-np.pi / 2), 4))
    assert frequency_bound(driven, gx.states.rest(driven), 0.0, t1) > 8
    stiff = jnp.ones(N - 2).at[0].set(1e3)
    one = _bead(CHAIN, Bend(stiff))
    state = gx.states.impact(one)
    alone = float(frequency_bound(one, state, 0.0, 1.0))
    both = jax.vmap(lambda f: _bead(CHAIN, Bend(f * stiff)), out_axes=-1)(jnp.ones(2))
    lanes = State(*(jnp.stack([x, x], -1) for x in state))
    assert float(frequency_bound(both, lanes, 0.0, 1.0)) == pytest.approx(alone, rel=0.1)
    assert alone >= largest_frequency(one, one.zeros()[None])


class Squared(gx.StrainMap):
    """A strain that is not linear."""

    def strain(self, u):
        return (u[:-1] - u[1:]) ** 2


def test_bonds_that_are_flat_at_rest_share_their_energy_between_their_ends():
    # the energy of bond n is 50 (u_n - u_{n+1})^4
    lattice = _bead(Bond(Squared(), Linear(100.0)))
    u = jnp.array([0.0, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 0.7])
    first, last = 50 * 0.5**4, 50 * 0.2**4
    shared = [first / 2, first / 2, *[0.0] * 4, last / 2, last / 2]
    for factor in (1.0, 0.0):
        state = State(factor * u, jnp.zeros(N))
        assert_allclose(
            gx.measures.site_energy(lattice, state), factor * np.array(shared), rtol=1e-12
        )


@pytest.mark.slow
@over([ROLLING, Case("bent", lambda k: _bead(CHAIN, Bond(Squared(), Linear(100.0))))])
def test_the_default_step_holds_along_the_run(case):
    """h omega <= 1/2 with the eigenvalues at every frame; SRKN11b, as for the library's own kinds."""
    lattice = case.make(K)
    run = gx.simulate(lattice, moving(case), 5.0, save_at=51)
    assert run.solver == "SRKN11b" and float(run.energy_error) < 1e-6
    h_omega = float(run.stats["step"]) * largest_frequency(lattice, run.us)
    most = STEP_FRACTION if case is ROLLING else 1.1 * STEP_FRACTION
    assert STEP_FRACTION / 5 < h_omega <= most


def test_a_stencil_has_weights_a_bond_and_knows_free_displacements():
    weights = jnp.linspace(0.5, 1.5, N)
    stencil = Stencil([(None, 0, weights), (None, 1, -weights)], "periodic")
    uneven = _bead(Bond(stencil, Linear(1.0)))
    got = linearised(uneven, 0.0, jnp.zeros(N)).force(0.0, jnp.eye(N), jnp.zeros((N, N)))
    assert_allclose(got, -dense(uneven, jnp.zeros(N)), atol=1e-14)
    thirds = Stencil([(None, 0, 1.0), *((None, k, -1 / 3) for k in (1, 2, 3))], "periodic")
    assert shifts(_bead(Bond(thirds, Linear(1.0)))).shape[1] == 1


@pytest.mark.slow
def test_damping_does_not_shorten_the_step_of_a_shock():
    toda = gx.scenes.toda(200)
    damped = Lattice(1.0, (*toda.terms, gx.Damping(1e-6)), sites=200)
    steps = [
        float(gx.simulate(x, gx.states.velocity_step(x, 0.5), 1.0).stats["step"])
        for x in (toda, damped)
    ]
    assert steps[0] == pytest.approx(steps[1], rel=1e-12)
