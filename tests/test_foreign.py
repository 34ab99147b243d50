"""Kinds of a user's own, written with `force` and `energy` alone: each gets what the library's own kinds get."""

from typing import NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import few
from jax.flatten_util import ravel_pytree
from refusals import refused

import granjax as gx
from granjax.flow.steps import STEP_FRACTION, frequency_bound
from granjax.lattice import linearised
from granjax.orbits.asked import shifts

N = 8


class LongRange(gx.Term):
    """All neighbours of a ring by FFT: F_n = k sum_m (u_{n+m} - u_n)/m^a, the m up to half of the ring."""

    strength: jax.Array
    exponent: float = eqx.field(static=True, default=3.0)

    def _pull(self, u):
        m = np.minimum(np.arange(N), N - np.arange(N))
        kernel = np.where(m > 0, 1.0 / np.maximum(m, 1) ** self.exponent, 0.0)
        symbol = np.real(np.fft.fft(kernel)) - kernel.sum()
        last = jnp.moveaxis(u, 0, -1)
        return self.strength * jnp.moveaxis(
            jnp.real(jnp.fft.ifft(symbol * jnp.fft.fft(last))), -1, 0
        )

    def force(self, t, u, v, mass):
        return self._pull(u)

    def energy(self, t, u):
        return -u * self._pull(u) / 2


class Adhesive(gx.Law):
    """F(e) = a (exp(2 b e) - exp(b e)): repels in compression, sticks in tension, lets go far away."""

    strength: jax.Array
    rate: jax.Array

    def force(self, e):
        x = jnp.exp(self.rate * e)
        return self.strength * x * (x - 1)

    def energy(self, e):
        return self.strength / (2 * self.rate) * (jnp.exp(self.rate * e) - 1) ** 2


class Bend(gx.Term):
    """A chain that resists bending: energy k c^2/2 + c^4/4 with c = u_{n-1} - 2 u_n + u_{n+1}."""

    stiffness: jax.Array

    def energy(self, t, u):
        c = u[:-2] - 2 * u[1:-1] + u[2:]
        return self.stiffness * c**2 / 2 + c**4 / 4

    def force(self, t, u, v, mass):
        return -jax.grad(lambda u: self.energy(t, u).sum())(u)


class ShearRotation(gx.Term):
    """Beads of a ring that shear and roll: e = u_n - u_{n+1} + R (theta_n + theta_{n+1}), energy k e^2/2 + e^4/4."""

    stiffness: jax.Array
    radius: float = eqx.field(static=True, default=0.5)

    def energy(self, t, x):
        u, theta = x["u"], x["theta"]
        e = u - jnp.roll(u, -1, 0) + self.radius * (theta + jnp.roll(theta, -1, 0))
        return self.stiffness * e**2 / 2 + e**4 / 4

    def force(self, t, x, v, mass):
        return jax.tree.map(jnp.negative, jax.grad(lambda x: self.energy(t, x).sum())(x))


class Friction(gx.Term):
    """Drag without memory: -c v |v|."""

    coefficient: jax.Array

    def force(self, t, u, v, mass):
        return -self.coefficient * v * jnp.abs(v)


RING = gx.Bond(gx.Shift(1, "periodic"), gx.Polynomial(1.0, 0.0, 1.0))
CHAIN = gx.Bond(gx.Shift(1, "free"), gx.Polynomial(1.0, 0.0, 1.0))
NAMED = gx.Bond(gx.Shift(1, "periodic", "u"), gx.Linear(0.3)), gx.OnSite(gx.Linear(0.2), "theta")


class Case(NamedTuple):
    """A lattice as a function of one parameter; whether it conserves; multipliers at +1 of a breather; how it moves."""

    name: str
    make: object
    conserves: bool = True
    at_one: int = 4
    size: float = 0.3


def _bead(*terms):
    return gx.Lattice(1.0, terms, sites=N)


def _rolling(k):
    return gx.Lattice({"u": 1.0, "theta": 0.4}, (ShearRotation(k), *NAMED), sites=N)


CASES = (
    Case("long range", lambda k: _bead(RING, LongRange(k))),
    Case(
        "adhesive",
        lambda k: _bead(gx.Bond(gx.Shift(1, "periodic"), Adhesive(k, jnp.asarray(1.0)))),
        size=0.1,
    ),
    Case("bend", lambda k: _bead(CHAIN, Bend(k))),
    Case("shear and rotation", _rolling),
    Case(
        "friction", lambda k: _bead(RING, Friction(k), gx.OnSite(gx.Linear(0.1))), conserves=False
    ),
)
over = pytest.mark.parametrize("case", CASES, ids=[case.name for case in CASES])
# the first and the last stand for those between
conservative = pytest.mark.parametrize(
    "case",
    [
        pytest.param(case, marks=pytest.mark.slow if 0 < i < 3 else (), id=case.name)
        for i, case in enumerate(CASES[:4])
    ],
)
K = jnp.asarray(0.7)


def moving(case, seed=0):
    random = np.random.default_rng(seed)
    draw = lambda s: jnp.asarray(case.size * random.normal(size=s.shape))
    template = case.make(K).template()
    return gx.State(jax.tree.map(draw, template), jax.tree.map(draw, template))


def dense(lattice, u):
    """M^-1/2 K M^-1/2 about u, from the force alone."""
    flat, unravel = ravel_pytree(u)
    zeros = jax.tree.map(jnp.zeros_like, u)
    force = lambda x: ravel_pytree(lattice.force(0.0, unravel(x), zeros))[0]
    mass = ravel_pytree(jax.tree.map(lambda m, u: jnp.broadcast_to(m, u.shape), lattice.mass, u))[0]
    slope = jax.linearize(force, flat)[1]
    # row by row: an FFT's batches are compiled in some memory layouts only
    return -jax.lax.map(slope, jnp.eye(flat.size)) / jnp.sqrt(mass[:, None] * mass)


@over
def test_what_the_force_reads_is_found(case):
    lattice = case.make(K)
    assert lattice.conserves == case.conserves
    assert lattice.reads_velocity == (case.name == "friction") and not lattice.reads_time


@pytest.mark.study
@conservative
def test_default_step_holds_along_the_run(case):
    """h omega <= 1/2 with the eigenvalues at every frame; SRKN11b, as for the library's own kinds."""
    lattice = case.make(K)
    run = gx.simulate(lattice, moving(case), 20.0, save_at=101)
    reached = jax.lax.map(lambda u: jnp.linalg.eigvalsh(dense(lattice, u)).max(), run.us)
    assert run.solver == "SRKN11b" and float(run.energy_error) < 1e-6
    h_omega = float(run.stats["step"]) * np.sqrt(float(reached.max()))
    assert STEP_FRACTION / 5 < h_omega <= STEP_FRACTION


def test_friction_gets_a_solver_that_reads_velocities():
    case = CASES[-1]
    lattice = case.make(K)
    run = gx.simulate(lattice, moving(case), 5.0)
    assert run.solver == "Dopri8" and np.isnan(float(run.energy_error))
    with refused("Friction"):
        gx.simulate(lattice, moving(case), 5.0, solver=gx.SRKN11b(), step=0.1)


@pytest.mark.parametrize(
    "case", [pytest.param(CASES[2], marks=pytest.mark.slow), CASES[4]], ids=["bend", "friction"]
)
def test_a_tolerance_suits_every_kind(case):
    """A tolerance, alone and with a longest step, against another method."""
    lattice, state = case.make(K), moving(case)
    best = gx.simulate(lattice, state, 3.0, tolerance=1e-12, solver=diffrax.Dopri8())
    for how in ({}, {"step": 0.05}):
        run = gx.simulate(lattice, state, 3.0, tolerance=1e-9, **how)
        gap = jax.tree.map(lambda a, b: float(jnp.abs(a - b).max()), run.final, best.final)
        assert max(jax.tree.leaves(gap)) < 1e-7


class Pushed(gx.OnSite):
    """What inherits that it keeps the energy, and does not."""

    def force(self, t, u, v, mass):
        return -jnp.cos(t) * self.law.force(u)


class Slowed(gx.OnSite):
    """What inherits that it reads no velocity, and does."""

    def force(self, t, u, v, mass):
        return -self.law.force(u) - 0.1 * v


class Circling(gx.Term):
    """A force that is no gradient, with an energy all the same."""

    strength: jax.Array

    def force(self, t, u, v, mass):
        return self.strength * jnp.roll(u, 1, 0)

    def energy(self, t, u):
        return -self.strength * u**2 / 2


@pytest.mark.study
def test_an_energy_that_is_not_kept_has_no_error():
    for term in (Pushed(gx.Linear(0.5)), Slowed(gx.Linear(0.5)), Circling(K)):
        lattice = _bead(RING, term)
        run = gx.simulate(lattice, moving(CASES[0]), 5.0)
        assert np.isnan(run.energy_error) and "no energy is kept" in repr(run)
        said = "The force of Circling is not the slope of its `energy`" in run.outcome
        assert said == lattice.conserves == (type(term) is Circling)
        assert lattice.reads_time == (type(term) is Pushed)
        if type(term) is Slowed:
            assert run.solver == "Dopri8" and lattice.reads_velocity
            with refused("Slowed"):
                gx.simulate(lattice, moving(CASES[0]), 5.0, solver=gx.SRKN11b(), step=0.1)


@pytest.mark.slow
@over
def test_linear_theory_is_the_dense_one(case):
    lattice = case.make(K)
    want = np.linalg.eigvalsh(np.asarray(dense(lattice, lattice.zeros())))
    np.testing.assert_allclose(
        gx.linear.normal_modes(lattice).omega_squared, want, rtol=0, atol=1e-13 * want.max()
    )


def test_bands_of_a_long_range_ring():
    """omega^2 = 4 sin^2(k/2) + 2 k_0 sum_m (1 - cos k m)/m^3 at the phases that fit a ring of 8."""
    k = 2 * np.pi * np.arange(N) / N
    m = np.arange(1, N)
    distance = np.minimum(m, N - m)
    squared = 4 * np.sin(k / 2) ** 2 + 0.7 * ((1 - np.cos(np.outer(k, m))) / distance**3).sum(1)
    got = gx.linear.normal_modes(CASES[0].make(K)).omega_squared
    np.testing.assert_allclose(got, np.sort(squared), atol=1e-13)


def test_an_adhesive_contact_is_measured():
    lattice, state = CASES[1].make(K), moving(CASES[1])
    e = np.asarray(state.u) - np.roll(state.u, -1)
    np.testing.assert_allclose(gx.measures.strain(lattice, state), e, atol=1e-15)
    np.testing.assert_allclose(
        gx.measures.contact_force(lattice, state), 0.7 * np.exp(e) * (np.exp(e) - 1), atol=1e-15
    )
    with refused("Adhesive"):
        gx.measures.overlap(lattice, state)


@over
def test_energies_of_sites_add_up(case):
    lattice, state = case.make(K), moving(case)
    share = gx.measures.site_energy(lattice, state)
    total = sum(float(jnp.sum(x)) for x in jax.tree.leaves(share))
    np.testing.assert_allclose(total, float(gx.measures.energy(lattice, state)), rtol=1e-13)


@over
def test_uniform_displacements(case):
    """One costs nothing on rings and free chains; rolling beads keep their angle, friction's sites are tied."""
    lattice = case.make(K)
    moves = np.asarray(shifts(lattice))
    assert moves.shape[1] == (1 if case.conserves else 0)
    if moves.size:
        u = jax.tree.map(jnp.zeros_like, lattice.zeros())
        uniform = {"u": jnp.ones(N), "theta": u["theta"]} if isinstance(u, dict) else jnp.ones(N)
        np.testing.assert_array_equal(moves[:, 0], ravel_pytree(uniform)[0])


@pytest.mark.slow
@conservative
def test_a_breather_and_its_multipliers(case):
    """The nonlinear continuation of the highest mode: closed, of finite size, with four multipliers at +1."""
    lattice = case.make(K)
    modes = gx.linear.normal_modes(lattice)
    shape = jax.tree.map(lambda x: 0.3 * x[..., -1], modes.modes)
    omega = 1.01 * float(modes.omega[-1])
    guess = gx.State(shape, jax.tree.map(jnp.zeros_like, shape))
    found = gx.breathers.breather(lattice, omega, guess, check=False, steps=80)
    assert float(found.energy) > 1e-3
    floquet = found.floquet()
    near = np.abs(np.asarray(floquet.multipliers) - 1) < 1e-3
    assert near.sum() == floquet.expected == case.at_one


@pytest.mark.study
def test_a_driven_orbit_with_friction():
    lattice = _bead(
        CHAIN, gx.OnSite(gx.Linear(0.3)), Friction(K), gx.Drive(gx.Harmonic(0.5, 1.1), 0)
    )
    orbit = gx.forced.forced_orbit(lattice, 2 * np.pi / 1.1, transient=40, steps=200)
    assert orbit.converged
    floquet = orbit.floquet()
    assert floquet.expected == 0 and np.abs(floquet.multipliers).max() < 1


@pytest.mark.slow
@over
def test_derivatives_in_both_modes(case):
    """d/dk of a scalar of a run: forward, reverse and a difference of order 6."""
    state = moving(case)

    def scalar(k):
        run = gx.simulate(case.make(k), state, 2.0, step=0.05)
        return sum(jnp.sum(x**2) for x in jax.tree.leaves(run.final))

    forward = jax.jit(jax.jacfwd(scalar))(K)
    reverse = jax.jit(jax.grad(scalar))(K)
    h, value = 1e-2, jax.jit(scalar)
    weights = {1: 3 / 4, 2: -3 / 20, 3: 1 / 60}
    difference = sum(w * (value(K + i * h) - value(K - i * h)) for i, w in weights.items()) / h
    np.testing.assert_allclose([forward, reverse], float(difference), rtol=1e-6)
    np.testing.assert_allclose(forward, reverse, rtol=1e-9)


@pytest.mark.study
@pytest.mark.parametrize("case", few(CASES, 1, 3), ids=lambda case: case.name)
def test_a_fit_finds_the_parameter(case):
    state, named = moving(case), case.name == "shear and rotation"
    times = np.linspace(0.0, 4.0, 41)
    run = gx.simulate(case.make(K), state, 4.0, save_at=times, tolerance=1e-10)
    data = np.asarray(run.vs["u"] if named else run.vs)[:, :2]
    traces = gx.Traces(
        times=times, velocity=data, sites=[0, 1], sigma=1e-4, field="u" if named else None
    )
    found = gx.fit(lambda p: case.make(p["k"]), {"k": 0.5}, traces, state=lambda p, lattice: state)
    np.testing.assert_allclose(found.parameters["k"], 0.7, rtol=1e-4)


@conservative
def test_other_units(case):
    """In other units the term gives the same force, whatever its parameters mean."""
    lattice, state = case.make(K), moving(case)
    units = gx.scenes.Units(3e-3, 2e-6, 5e-5)
    scaled = gx.scenes.scaled(lattice, units=units).lattice
    there = scaled.force(0.0, *units.state_from_si(state))
    want = jax.tree.map(lambda f: f / units.force, lattice.force(0.0, *state))
    size = max(float(jnp.abs(x).max()) for x in jax.tree.leaves(want))
    for got, w in zip(jax.tree.leaves(there), jax.tree.leaves(want)):
        np.testing.assert_allclose(got, w, atol=1e-13 * size)


def test_the_library_s_stencils_are_the_same_lattices():
    """Shear with rotation and bending by `Stencil`, the sum of (field, offset, weight), against the terms above."""
    law, state = gx.Polynomial(0.7, 0.0, 1.0), moving(CASES[3])
    parts = [("u", 0, 1.0), ("u", 1, -1.0), ("theta", 0, 0.5), ("theta", 1, 0.5)]
    bond = gx.Bond(gx.strains.Stencil(parts, "periodic"), law)
    own = gx.Lattice({"u": 1.0, "theta": 0.4}, (bond, *NAMED), sites=N)
    for got, want in zip(
        jax.tree.leaves(own.force(0.0, *state)), jax.tree.leaves(_rolling(K).force(0.0, *state))
    ):
        np.testing.assert_allclose(got, want, atol=1e-14)
    assert np.array_equal(shifts(own), shifts(_rolling(K)))
    bend = gx.Bond(
        gx.strains.Stencil([(None, 0, 1.0), (None, 1, -2.0), (None, 2, 1.0)], "free"), law
    )
    state = moving(CASES[2])
    np.testing.assert_allclose(
        _bead(bend).force(0.0, *state), _bead(Bend(K)).force(0.0, *state), atol=1e-14
    )


class OwnContacts(Bend):
    """A term with contacts of its own, that says which."""

    def compressions(self, t, u):
        return (gx.terms.Compression(gx.Hertz(self.stiffness), u[:-1] - u[1:]),)


@pytest.mark.slow
def test_contacts_of_a_term_of_ones_own_modulated_or_not():
    u = moving(CASES[2]).u
    for term, factor in (
        (OwnContacts(K), 1.0),
        (gx.Modulated(OwnContacts(K), lambda t: 2.0 + 0 * t), 2.0),
    ):
        lattice, state = _bead(CHAIN, term), gx.State(u, jnp.zeros(N))
        want = factor * 0.7 * np.maximum(np.asarray(u[:-1] - u[1:]), 0) ** 1.5
        np.testing.assert_allclose(
            gx.measures.contact_force(lattice, state, bond=1), want, atol=1e-15
        )
        assert bool(gx.simulate(lattice, state, 0.1, step=0.05).contact_opened)
        share = float(jnp.sum(gx.measures.site_energy(lattice, state)))
        np.testing.assert_allclose(share, float(gx.measures.energy(lattice, state)), rtol=1e-13)


def test_a_modulated_term_of_ones_own():
    """g(t) F, a period's monodromy with g = 1 + 0.1 cos(2 t): nothing is expected at +1 but the free displacement."""
    lattice = _bead(RING, gx.Modulated(LongRange(K), gx.Harmonic(0.1, 2.0, mean=1.0)))
    state = moving(CASES[0])
    want = RING.force(0.0, *state, 1.0) + 1.1 * LongRange(K).force(0.0, *state, 1.0)
    np.testing.assert_allclose(lattice.force(0.0, *state), want, atol=1e-14)
    assert lattice.reads_time and not lattice.conserves
    found = gx.floquet.floquet(lattice, gx.states.rest(lattice), np.pi)
    assert found.expected == 2 and (np.abs(np.asarray(found.multipliers) - 1) < 1e-3).sum() == 2
    with refused("constant in time"):
        gx.linear.normal_modes(lattice)


@pytest.mark.slow
def test_what_hides_from_a_rule_of_thumb():
    """A drive whose period divides the samples, lanes, a bent strain map, weights a bond: the bound holds for all."""
    t1 = 256 * 2 * np.pi / 1.5
    driven = _bead(RING, gx.Drive(gx.Harmonic(20.0, 1.5, phase=-np.pi / 2), 4))
    assert frequency_bound(driven, gx.states.rest(driven), 0.0, t1) > 8
    stiff = jnp.ones(N - 2).at[0].set(1e3)
    rest = gx.State(jnp.zeros(N), jnp.zeros(N).at[0].set(1.0))
    one = _bead(CHAIN, Bend(stiff))
    alone = float(frequency_bound(one, rest, 0.0, 1.0))
    both = jax.vmap(lambda f: _bead(CHAIN, Bend(f * stiff)), out_axes=-1)(jnp.ones(2))
    lanes = gx.State(*(jnp.stack([x, x], -1) for x in rest))
    assert float(frequency_bound(both, lanes, 0.0, 1.0)) == pytest.approx(alone, rel=0.1)
    assert alone >= np.sqrt(float(jnp.linalg.eigvalsh(dense(one, one.zeros())).max()))


class Squared(gx.StrainMap):
    """A strain that is not linear."""

    def strain(self, u):
        return (u[:-1] - u[1:]) ** 2


@pytest.mark.slow
def test_a_bent_strain_map_and_weights_a_bond():
    lattice = _bead(CHAIN, gx.Bond(Squared(), gx.Linear(100.0)))
    state = gx.State(jnp.zeros(N), jnp.zeros(N).at[3].set(1.0))
    run = gx.simulate(lattice, state, 5.0, save_at=51)
    reached = jax.lax.map(lambda u: jnp.linalg.eigvalsh(dense(lattice, u)).max(), run.us)
    assert float(run.stats["step"]) * np.sqrt(float(reached.max())) <= 1.1 * STEP_FRACTION
    weights = jnp.linspace(0.5, 1.5, N)
    uneven = _bead(
        gx.Bond(
            gx.strains.Stencil([(None, 0, weights), (None, 1, -weights)], "periodic"),
            gx.Linear(1.0),
        )
    )
    tangents = jnp.eye(N)
    got = linearised(uneven, 0.0, jnp.zeros(N)).force(0.0, tangents, 0 * tangents)
    np.testing.assert_allclose(got, -dense(uneven, jnp.zeros(N)), atol=1e-14)
    thirds = [(None, 0, 1.0), *((None, k, -1 / 3) for k in (1, 2, 3))]
    assert (
        shifts(_bead(gx.Bond(gx.strains.Stencil(thirds, "periodic"), gx.Linear(1.0)))).shape[1] == 1
    )


@pytest.mark.slow
def test_damping_does_not_shorten_the_step_of_a_shock():
    lattice = gx.scenes.toda(200)
    damped = gx.Lattice(1.0, (*lattice.terms, gx.Damping(1e-6)), sites=200)
    steps = [
        float(gx.simulate(x, gx.states.velocity_step(x, 0.5), 1.0).stats["step"])
        for x in (lattice, damped)
    ]
    assert steps[0] == pytest.approx(steps[1], rel=1e-12)
