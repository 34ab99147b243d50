"""Where lattices rest: magnets between ends, loads, saddles, terms of one's own."""

import os
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from refusals import refused
from scipy.optimize import fsolve, root

import granjax as gx

N = 9
P = -4.0


def pair_forces(x, p=P):
    """The force on each magnet at positions x."""
    away = x[:, None] - x
    np.fill_diagonal(away, np.inf)
    return np.sum(np.sign(away) * np.abs(away) ** p, 1)


def rest_of(p, sites, boundary):
    return gx.scenes.magnets(sites, p, boundary=boundary).terms[0].rest


def positions(rest, boundary):
    """Where magnets are, with those that stay beyond fixed ends."""
    x = np.arange(len(rest)) + np.asarray(rest)
    return np.concatenate([[-1.0], x, [len(x)]]) if boundary == "fixed" else x


# ---- magnets


@pytest.mark.slow
@pytest.mark.parametrize("boundary", ["fixed", "free"])
def test_magnets_between_ends_rest(boundary):
    lattice = gx.scenes.magnets(N, P, boundary=boundary)
    forces = pair_forces(positions(lattice.terms[0].rest, boundary))
    assert np.abs(forces[1:-1]).max() < 1e-13 * np.abs(forces).max()
    found = gx.equilibrium(lattice)
    assert_allclose(found.ends, [-forces[0], forces[-1]], rtol=1e-12)
    assert found.residual <= 1e-13 * found.largest and found.verdict == "stable"
    assert_allclose(found.state.u, 0, atol=1e-14)
    assert_array_equal(lattice.force(0.0, lattice.zeros(), lattice.zeros()), 0)


@pytest.mark.slow
def test_equal_spacings_are_no_rest_and_the_outcome_says_so():
    magnets = gx.LongRange(np.arange(1.0, N) ** P, gx.PowerLaw(1.0, P, 1.0), "free", takes="strain")
    found = gx.equilibrium(gx.Lattice(np.linspace(1, 2, N), magnets, sites=N))
    assert_allclose(found.state.u, rest_of(P, N, "free"), atol=1e-14)
    assert "only loads on inner sites hold" in found.outcome
    there = found.lattice
    u = jnp.asarray(0.01 * np.random.default_rng(2).normal(size=N))
    x = np.arange(N) + np.asarray(found.state.u)
    force = there.force(0.0, u, u)
    assert_allclose(force, pair_forces(x + np.asarray(u)) - pair_forces(x), atol=1e-14)
    slope = jax.grad(lambda u: there.potential_energy(0.0, u))(u)
    assert_allclose(slope, -force, rtol=0, atol=1e-13)


@pytest.mark.slow
@pytest.mark.parametrize("sites, boundary", [(6, "free"), (5, "fixed")])
def test_magnets_of_a_traced_exponent_rest_where_they_do(sites, boundary):
    exponents = jnp.array([-4.5, -4.0, -2.7])

    def own(p):
        return rest_of(p, sites, boundary)

    def expected(p):
        """Where magnets of force r^p rest between the outermost two, by SciPy."""
        x = positions(np.zeros(sites), boundary)
        inner = lambda between: pair_forces(np.r_[x[0], between, x[-1]], p)[1:-1]
        x[1:-1] = root(inner, x[1:-1], tol=1e-14).x
        return (x if boundary == "free" else x[1:-1]) - np.arange(sites)

    found = jax.jit(jax.vmap(own, out_axes=-1))(exponents)
    for lane, p in enumerate(exponents):
        assert_allclose(found[:, lane], expected(float(p)), atol=1e-13)
        assert_allclose(own(p), expected(float(p)), atol=1e-13)
    slope = (expected(-2.7 + 1e-4) - expected(-2.7 - 1e-4)) / 2e-4
    for mode in (jax.jacfwd, jax.jacrev):
        assert_allclose(mode(own)(-2.7), slope, atol=1e-7)
    bend = (expected(-2.7 + 1e-3) - 2 * expected(-2.7) + expected(-2.7 - 1e-3)) / 1e-6
    assert_allclose(jax.jacfwd(jax.jacrev(own))(-2.7), bend, atol=1e-6)


def test_magnets_that_are_felt_far_away_rest_or_are_refused():
    # plain steps of Newton's method pass one magnet through the next where p is about -1 and above
    for p, sites in ((-1.0, 10), (-0.5, 6)):
        x = positions(rest_of(p, sites, "fixed"), "fixed")
        assert (np.diff(x) > 0).all() and np.abs(pair_forces(x, p)[1:-1]).max() < 1e-12
    with refused("Take fewer magnets"):
        gx.scenes.magnets(200, -0.1)


@pytest.mark.slow
def test_magnets_of_swept_exponents_push_as_alone_and_are_differentiated():
    u = jnp.array([0.1, 0.0, -0.05, 0.02])

    def push(p):
        return gx.scenes.magnets(4, p).force(0.0, u, 0 * u)

    # the first three are a difference
    h = 1e-4
    exponents = jnp.array([-4.0 - h, -4.0, -4.0 + h, -2.7])

    @jax.jit
    def in_lanes(exponents):
        lanes = jax.vmap(lambda p: gx.scenes.magnets(4, p), out_axes=-1)(exponents)
        return lanes.force(0.0, jnp.stack([u] * 4, -1), jnp.zeros((4, 4)))

    together = in_lanes(exponents)
    ways = push, jax.jacfwd(push), jax.jacrev(push)
    alone, *slopes = jax.jit(lambda p: [way(p) for way in ways])(-4.0)
    assert_allclose(together[:, 1], alone, rtol=0, atol=1e-12)
    for slope in slopes:
        assert_allclose(slope, (together[:, 2] - together[:, 0]) / (2 * h), rtol=1e-5)


# ---- saddles


class Wells(gx.Term):
    """Double wells of a user's own: energy k (u^2 - a^2)^2/(4 a^2)."""

    stiffness: jax.Array
    width: jax.Array

    def energy(self, t, u):
        return self.stiffness * (u**2 - self.width**2) ** 2 / (4 * self.width**2)

    def force(self, t, u, v, mass):
        return -jax.grad(lambda u: self.energy(t, u).sum())(u)


def test_a_saddle_is_called_one_and_a_guess_finds_the_minimum():
    wells = Wells(jnp.asarray(2.0e3), jnp.asarray(1e-3))
    lattice = gx.Lattice(1.0, (wells, gx.Bond(gx.Shift(1, "free"), gx.Linear(100.0))), sites=4)
    saddle = gx.equilibrium(lattice)
    assert saddle.verdict == "unstable" and "saddle" in saddle.outcome
    assert_allclose(saddle.stiffness, -2e3, rtol=1e-12)
    found = gx.equilibrium(lattice, guess=jnp.full(4, 0.7e-3))
    assert found.verdict == "stable"
    assert_allclose(found.state.u, 1e-3, rtol=1e-13)


@pytest.mark.parametrize("near, verdict", [(6.0, "stable"), (3.0, "unstable")])
def test_a_well_away_from_the_origin_is_found_where_all_forces_are_rounding(near, verdict):
    for length in (1.0, 1e-6):
        bond = gx.Bond(gx.Shift(1, "free"), gx.Linear(0.2 / length))
        lattice = gx.Lattice(1.0, (gx.OnSite(gx.Sine(1.0, 1 / length)), bond), sites=4)
        found = gx.equilibrium(lattice, guess=jnp.full(4, near * length))
        assert found.verdict == verdict and "rounding of the displacements" in found.outcome
        assert_allclose(found.state.u, length * np.pi * round(near / np.pi), rtol=1e-14)


BEADS = """
import granjax as gx
row = gx.scenes.beads("steel 316", 9.53e-3, precompression=10.0, cells=5, boundary="fixed")
found = gx.equilibrium(row)
print(*map(float, (found.residual, found.ends[0], found.stiffness, found.error)), sep="\\n")
print(found.outcome)
"""


@pytest.mark.slow
def test_a_row_of_beads_at_rest_in_float32():
    # at u = 0 each force is the difference of two of 10 N, which differ by rounding where they are compiled as a user's
    own = {
        k: x
        for k, x in os.environ.items()
        if k not in ("XLA_FLAGS", "JAX_DISABLE_MOST_OPTIMIZATIONS")
    }
    call = [sys.executable, "-c", BEADS]
    short, exact = (
        subprocess.run(
            call, env=own | {"JAX_ENABLE_X64": x}, capture_output=True, text=True, check=True
        ).stdout.splitlines()
        for x in "01"
    )
    residual, end, stiffness, error = map(float, short[:4])
    assert residual < 1e-6 and end == 10
    assert abs(stiffness - float(exact[2])) < error < 1e-3 * stiffness
    assert short[4].startswith("A stable state of rest") and "of the largest force" in short[4]


@pytest.mark.slow
def test_the_least_stiffness_has_derivatives_in_both_modes():
    # F = u + u^3 on each site, pushed by a load p: the stiffness is 1 + 3 u^2
    bond = gx.Bond(gx.Shift(1, "free"), gx.Linear(0.2))
    lattice = gx.Lattice(1.0, (gx.OnSite(gx.Polynomial(1.0, 0.0, 1.0)), bond), sites=3)
    least = lambda p: gx.equilibrium(lattice, loads=p * jnp.ones(3), hold="nothing").stiffness
    for derivative in (jax.jacfwd, jax.jacrev):
        # at p = 2 they rest at u = 1
        assert_allclose(derivative(least)(2.0), 6 / 4, rtol=1e-9)


@pytest.mark.slow
def test_the_least_stiffness_has_second_derivatives():
    """Its mode turns with the load: against differences of the dense matrix."""
    pushes = np.array([0.0, 0.2, -0.3, 0.1])

    def least(load):
        bond = gx.Bond(gx.Shift(1, "free"), gx.Polynomial(1.2, 0.3, 1.0))
        lattice = gx.Lattice(1.0, bond, sites=4)
        return gx.equilibrium(lattice, loads=load * pushes, hold=[0])

    def dense(load):
        e = -np.diff(least(load).state.u)
        k = 1.2 + 0.6 * e + 3 * e**2
        return np.linalg.eigvalsh(
            np.diag(k + np.append(k[1:], 0)) - np.diag(k[1:], 1) - np.diag(k[1:], -1)
        )[0]

    h = 1e-3
    near, here, after = (dense(1 + i * h) for i in (-1, 0, 1))
    second = jax.jacfwd(jax.jacfwd(lambda load: least(load).stiffness))(1.0)
    assert_allclose(second, (near + after - 2 * here) / h**2, rtol=1e-5)


# ---- loads


@pytest.mark.slow
@pytest.mark.parametrize("boundary, tolerance", [("free", 1e-3), ("periodic", 1e-4)])
def test_second_derivatives_of_the_least_stiffness_in_float32(boundary, tolerance):
    """What is held lies apart from the spectrum, near enough for its gaps to be more than rounding."""
    loads = 0.1 * np.cos(np.arange(80.0) ** 2)
    loads -= loads.mean()

    def least(K2, kind):
        bond = gx.Bond(gx.Shift(1, boundary), gx.Polynomial(K2, 0.3, 1.0))
        lattice = gx.Lattice(1.0, bond, sites=80).astype(kind)
        return gx.equilibrium(lattice, loads=loads.astype(kind)).stiffness

    low, high = (jax.grad(jax.grad(least))(1.0, kind) for kind in (np.float32, np.float64))
    assert_allclose(low, high, rtol=tolerance)


@pytest.mark.slow
def test_forces_of_contacts_carry_the_loads():
    chain = gx.scenes.monomer(5, precompression=1.0)
    found = gx.equilibrium(chain, loads=jnp.full(5, 0.02))
    forces = gx.measures.contact_force(chain, found.state)
    assert_allclose(np.diff(forces), 0.02, rtol=1e-12)
    assert_allclose(found.ends, forces[jnp.asarray([0, -1])], rtol=1e-14)


@pytest.mark.slow
def test_contacts_within_another_term_keep_their_forces_where_they_are_measured_from_rest():
    contacts = gx.Bond(gx.Shift(1, "fixed"), gx.Hertz(1.0, 0.5))
    chain = gx.Lattice(1.0, gx.Modulated(contacts, gx.Harmonic(0.2, 1.0)), sites=4)
    found = gx.equilibrium(chain, loads=jnp.full(4, 0.05))
    moves = jnp.array([0.05, -0.1, 0.3, 0.0])
    here, there = (gx.State(u, 0 * u) for u in (found.state.u + moves, moves))
    forces = gx.measures.contact_force(chain, here)
    assert_allclose(gx.measures.contact_force(found.lattice, there), forces, rtol=1e-12, atol=1e-14)
    assert np.ptp(forces) > 0.1


@pytest.mark.slow
@pytest.mark.parametrize("beyond", [None, 1])
def test_walls_push_back_with_all_bonds_that_reach_beyond_an_end(beyond):
    """The sum over the bonds across either end, of displacements that are not measured from a rest."""
    kernel = [1.0, 0.4, 0.3]
    law = gx.Hertz(1.0, 0.5)
    term = gx.LongRange(kernel, law, "fixed", beyond=beyond)
    loads = 0.1 * jnp.array([1.0, -0.5, 0.2, 0.3, 0.6])
    found = gx.equilibrium(gx.Lattice(1.0, term, sites=5), loads=loads)
    n = beyond or 3
    x = np.pad(found.state.u, n)
    wanted = [
        sum(
            c * float(law.force(x[i] - x[i + m]) + law.preload)
            for m, c in enumerate(kernel, 1)
            for i in range(len(x) - m)
            if i < end <= i + m
        )
        for end in (n, n + 5)
    ]
    assert_allclose(found.ends, wanted, rtol=1e-12)
    assert_allclose(wanted[1] - wanted[0], loads.sum(), rtol=1e-11)


@pytest.mark.slow
def test_loads_that_stay_are_those_of_the_preloads_and_without_any_it_falls_apart():
    law = gx.laws.Strained(gx.Polynomial(1.0, 0.3, 0.5), 0.1)
    chain = gx.Lattice(1.0, gx.Bond(gx.Shift(1, "free"), law), sites=5)
    held = gx.equilibrium(chain, hold="loads")
    assert_allclose(held.state.u, 0, atol=1e-15)
    assert_allclose(held.loads, [law.preload, 0, 0, 0, -law.preload], atol=1e-15)
    assert_allclose(held.ends, [law.preload] * 2, rtol=1e-13)
    push = jnp.asarray([0.02, 0, 0, 0, -0.02])
    pressed = gx.equilibrium(chain, hold="loads", loads=push)
    forces = gx.measures.contact_force(chain, pressed.state)
    assert_allclose(forces, law.preload + 0.02, rtol=1e-12)
    apart = gx.equilibrium(chain, hold="nothing")
    assert_allclose(np.diff(apart.state.u), 0.1, rtol=1e-12)
    assert_array_equal(apart.loads, 0)
    assert abs(np.mean(apart.state.u)) < 1e-15


COLUMN = 20
WEIGHT = 0.28


def column(preload, factor=1.0):
    """Where a row of beads rests under weights that may open its top."""
    beads = gx.scenes.beads("steel 316", 9.53e-3, preload, cells=COLUMN)
    return gx.equilibrium(beads, loads=jnp.full(COLUMN, factor * WEIGHT))


def column_below(preload):
    """Its displacements where contact n carries n beads, and their derivatives by the factor."""
    beads = gx.scenes.beads("steel 316", 9.53e-3, preload, cells=COLUMN)
    stiffness = np.asarray(beads.terms[0].law.stiffness)
    overlaps = (WEIGHT * np.arange(COLUMN + 1) / stiffness) ** (2 / 3)
    squeezed = overlaps - (preload / stiffness) ** (2 / 3)
    # from the wall below upwards
    return [np.cumsum(x[:0:-1])[::-1] for x in (squeezed, 2 / 3 * overlaps)]


@pytest.mark.slow
def test_contacts_below_one_that_weights_open_carry_the_weights_above():
    for preload in (0.5, 1.4, 2.0):
        found = column(preload)
        assert found.verdict == "stable"
        assert_allclose(found.state.u, column_below(preload)[0], rtol=1e-11)


@pytest.mark.slow
def test_contacts_that_weights_open_in_batches_and_derivatives():
    preloads = jnp.array([0.5, 1.4, 2.0])
    lanes = jax.jit(jax.vmap(column))(preloads)
    for u, preload in zip(lanes.state.u, preloads):
        assert_allclose(u, column_below(float(preload))[0], rtol=1e-11)
    for mode in (jax.jacfwd, jax.jacrev):
        slope = jax.jit(mode(lambda factor: column(2.0, factor).state.u))(1.0)
        assert_allclose(slope, column_below(2.0)[1], rtol=1e-11)


@pytest.mark.slow
def test_a_bead_that_is_pulled_off_has_no_state_of_rest():
    row = gx.scenes.beads("steel 316", 9.53e-3, 1.0, cells=4, boundary="free")
    with pytest.raises(RuntimeError, match="No state of rest"):
        gx.equilibrium(row, loads=np.array([0, 0, 0, 9.0]), hold=[0])


@pytest.mark.slow
def test_loads_on_the_ends_act_where_they_balance_and_are_borne_elsewhere():
    chain = gx.scenes.fput(5, alpha=0.0, boundary="free")
    found = gx.equilibrium(chain, loads=jnp.array([1.0, 0.2, 0, 0, 0]))
    # a straight line from the load to either end, both of which stay
    assert_allclose(found.state.u, [0, 0.15, 0.1, 0.05, 0], atol=1e-14)
    assert "bears the loads given on them" in found.outcome
    assert "bears" not in gx.equilibrium(chain, loads=jnp.array([0, 0.2, 0, 0, 0])).outcome
    # what is under a preload takes more of it, on top of what holds it
    chain = gx.scenes.monomer(4, precompression=1.0, boundary="free")
    pressed = gx.equilibrium(chain, loads=jnp.array([0.5, 0, 0, -0.5]))
    u = np.asarray(pressed.state.u)
    assert_allclose(-np.diff(u), 1.5 ** (2 / 3) - 1, rtol=1e-12)
    assert_allclose(pressed.loads, [1.5, 0, 0, -1.5], rtol=1e-13)
    assert_allclose(pressed.ends, 1.5, rtol=1e-13)
    assert pressed.verdict == "stable" and abs(np.mean(u)) < 1e-15


def springs(boundary, k, *terms):
    law = gx.Polynomial(k, 0.3 * k, 0.2 * k) if boundary == "fixed" else gx.Polynomial(k, 0.0, k)
    return gx.Lattice(1.0, (gx.Bond(gx.Shift(1, boundary), law), *terms), sites=4)


@pytest.mark.slow
@pytest.mark.parametrize(
    "make, push, floats",
    [
        (lambda k: springs("fixed", k), [0.3, 0.0, -0.1, 0.2], False),
        (lambda k: springs("free", k, gx.OnSite(gx.Linear(1.0))), [0.3, 0.0, -0.1, 0.2], False),
        (lambda k: springs("free", k), [0.4, 0.1, -0.3, -0.2], True),
    ],
)
def test_rest_under_transformations_is_that_of_scipy(make, push, floats):
    push = jnp.array(push)

    def rest(k):
        return gx.equilibrium(make(k), loads=push).state.u

    def alone(k):
        lattice = make(k)
        force = jax.jit(lambda u: lattice.force(0.0, u, jnp.zeros(4)))
        # the mean of a chain that floats stays
        left = lambda u: np.asarray(force(u) + push) - floats * u.mean()
        return fsolve(left, np.zeros(4), xtol=1e-13)

    ks = jnp.array([0.8, 1.0, 1.7])
    found = jax.jit(jax.vmap(rest))(ks)
    assert_allclose(found, [alone(float(k)) for k in ks], atol=1e-9)
    assert_allclose(jax.jit(rest)(1.0), rest(1.0), atol=1e-14)
    slope = (alone(1.0 + 1e-4) - alone(1.0 - 1e-4)) / 2e-4
    for mode in (jax.jacfwd, jax.jacrev):
        assert_allclose(jax.jit(mode(rest))(1.0), slope, atol=1e-6)


# ---- forces at rest, and drives


class Weight(gx.Term):
    """A force that reads nothing but the mass."""

    g: jax.Array

    def force(self, t, u, v, mass):
        return self.g * mass * jnp.ones_like(u)

    def energy(self, t, u):
        return -self.g * 2.0 * u


class Wind(gx.Term):
    """The drag of a medium that moves: it reads velocities alone."""

    rate: jax.Array
    speed: jax.Array

    def force(self, t, u, v, mass):
        return -self.rate * (v - self.speed)


class Pump(gx.Term):
    """A drive of a user's own."""

    push: jax.Array

    def force(self, t, u, v, mass):
        return jnp.zeros_like(u).at[0].set(self.push * jnp.cos(t))


class Swing(gx.Term):
    """A drive of a user's own that reads where the first site is."""

    push: jax.Array

    def force(self, t, u, v, mass):
        return jnp.zeros_like(u).at[0].set(self.push * jnp.cos(t) * (1 + u[0] / 2))

    def energy(self, t, u):
        return -self.push * jnp.cos(t) * (u[:1] + u[:1] ** 2 / 4)


def wall(side, motion=None):
    return gx.Wall(gx.Hertz(1.0, 1.0), side, motion)


PUSH = jnp.array(0.02)
HEAVY = Weight(PUSH / 2)


@pytest.mark.slow
@pytest.mark.parametrize(
    "ends, terms, load, driven",
    [
        ("fixed", [gx.Drive(gx.Harmonic(0.02, 1.0)), gx.Drive(lambda t: 0.01)], 0.0, 0.03),
        ("fixed", [Pump(PUSH), HEAVY], 0.02, 0.02),
        ("fixed", [Swing(PUSH), HEAVY], 0.02, None),
        ("fixed", [gx.Damping(0.1), Wind(PUSH, jnp.array(1.0))], 0.02, 0.0),
        pytest.param(
            *("free", [wall("left", lambda t: 0.1 * jnp.sin(t)), wall("right"), HEAVY], 0.02, 0.0),
            marks=pytest.mark.slow,
        ),
    ],
)
def test_forces_at_rest_count_once_and_drives_stay(ends, terms, load, driven):
    """`load` is the force on each site at rest, `driven` that of a drive on the first at t = 0.

    It is `None` for a drive that reads displacements, which counts as at t = 0.
    """
    lattice = gx.Lattice(2.0, (gx.Bond(gx.Shift(1, ends), gx.Hertz(1.0, 1.0)), *terms), sites=4)
    found = gx.equilibrium(lattice)
    there = found.lattice
    zero = there.zeros()
    contacts = [term for term in lattice.terms if isinstance(term, gx.Bond)]
    held = lattice.sum_forces(0.0, found.state.u, zero, contacts)
    pumped = PUSH * (1 + 0.5 * found.state.u[0]) if driven is None else 0.0
    assert_allclose(-held, load + pumped * np.eye(4)[0], rtol=0, atol=1e-13)
    at_rest = there.force(0.0, zero, zero)
    assert_allclose(at_rest, (driven or 0.0) * np.eye(4)[0], rtol=0, atol=1e-15)
    assert len(there.terms) == len(lattice.terms)
    # all forces, at any time, are those of the lattice that it was, with the same energy
    u, v = 0.01 * jnp.asarray(np.random.default_rng(3).normal(size=(2, 4)))
    force = there.force(1.3, u, v)
    assert_allclose(force, lattice.force(1.3, found.state.u + u, v), rtol=0, atol=1e-15)
    storing = [term for term in there.terms if term.energy(0.0, u) is not None]
    slope = jax.grad(lambda u: sum(term.energy(1.3, u).sum() for term in storing))(u)
    assert_allclose(slope, -there.sum_forces(1.3, u, v, storing), rtol=0, atol=1e-15)
    # what holds it at rest counts as its preload
    assert_allclose(there.unbalanced(), 0, rtol=0, atol=1e-13)


def test_a_modulated_bond_under_weight_rests_at_all_times():
    bond = gx.Bond(gx.Shift(1, "fixed"), gx.Hertz(1.0, 1.0))
    modulated = gx.Modulated(bond, gx.Harmonic(0.1, 2.0, mean=1.0))
    there = gx.equilibrium(gx.Lattice(2.0, (modulated, HEAVY), sites=4)).lattice
    for t in (0.0, 0.7):
        assert_allclose(there.force(t, there.zeros(), there.zeros()), 0, rtol=0, atol=1e-15)


def test_a_modulated_drive_that_reads_displacements_drives_the_lattice_at_rest():
    modulated = gx.Modulated(Swing(PUSH), gx.Harmonic(0.1, 2.0, mean=1.0))
    bond = gx.Bond(gx.Shift(1, "fixed"), gx.Hertz(1.0, 1.0))
    lattice = gx.Lattice(2.0, (bond, modulated), sites=4)
    found = gx.equilibrium(lattice)
    zero = lattice.zeros()
    swing = lambda t: Swing(PUSH).force(t, found.state.u, zero, 2.0)
    for t in (0.0, 0.7, 1.3):
        driven = (1 + 0.1 * np.cos(2 * t)) * (swing(t) - swing(0.0))
        assert_allclose(found.lattice.force(t, zero, zero), driven, rtol=0, atol=1e-15)


# ---- fields and the plane


@pytest.mark.slow
def test_fields_that_no_term_joins_keep_their_means_each():
    bonds = tuple(gx.Bond(gx.Shift(1, "free", fields=name), gx.Hertz(1.0, 1.0)) for name in "ab")
    lattice = gx.Lattice({"a": 1.0, "b": 2.0}, bonds, sites=4)
    loads = {"a": jnp.array([0.1, 0, 0, -0.1]), "b": jnp.array([0.0, 0.2, -0.2, 0.0])}
    rest = gx.equilibrium(lattice, loads=loads)
    assert rest.verdict == "stable"
    for u in rest.state.u.values():
        assert_allclose(u, -u[::-1], atol=1e-14)
    # the contact carries the preload and the load: (1 + y)^{3/2} = 1.1
    squeeze = 1.1 ** (2 / 3) - 1
    assert_allclose(-np.diff(rest.state.u["a"]), squeeze, rtol=1e-12)


@pytest.mark.slow
def test_resonators_hang_from_their_beads():
    chain = gx.scenes.mass_in_mass(4, 0.5, 2.0, precompression=1.0)
    load = {"bead": jnp.full(4, 0.02), "resonator": jnp.full(4, 0.01)}
    found = gx.equilibrium(chain, loads=load)
    swing = found.state.u["resonator"] - found.state.u["bead"]
    assert_allclose(swing, 0.01 / 2.0, rtol=1e-12)
    assert found.ends is None and found.verdict == "stable"


@pytest.mark.slow
def test_edges_of_the_plane_stay_and_loads_move_the_inner_sites():
    lattice = gx.scenes.triangular(4, 4, boundary="free")
    loads = 0.02 * jnp.asarray(np.random.default_rng(7).normal(size=(4, 4, 2)))
    found = gx.equilibrium(lattice, loads=loads)
    u = np.asarray(found.state.u)
    left = lattice.force(0.0, found.state.u, lattice.zeros()) + lattice.unbalanced() + found.loads
    assert np.abs(left).max() <= 1e-13 * found.largest and found.verdict == "stable"
    # the edges are held by what loads they need, the inner sites by those given
    assert np.abs(u[1:3, 1:3]).min() > 1e-4 and np.count_nonzero(u) == 8
    assert_array_equal(found.loads[1:3, 1:3], loads[1:3, 1:3])


@pytest.mark.slow
@pytest.mark.parametrize("components", [2, 3])
def test_positions_move_with_the_sites_whatever_space_they_are_in(components):
    places = np.stack([np.arange(4.0), *np.zeros((components - 1, 4))], -1)
    bond = gx.Bond(gx.Stretch(gx.Shift(1, "fixed"), (1.0, 0.0)), gx.Hertz(1.0, 0.3))
    lattice = gx.Lattice(1.0, bond, sites=4, dimension=2, positions=places)
    found = gx.equilibrium(lattice, loads=np.array([[0, 0], [0.1, 0], [-0.1, 0], [0, 0]]))
    moved = np.asarray(found.lattice.positions) - places
    assert np.abs(found.state.u).max() > 0.01
    assert_allclose(moved[:, :2], found.state.u, rtol=0, atol=1e-15)
    assert not moved[:, 2:].any()


@pytest.mark.slow
def test_loads_move_all_sites_of_a_ring_in_the_plane():
    # no site of a ring is an end that is held: the displacements are those of the dense stiffness
    ring = gx.scenes.triangular(4, 4, boundary="periodic")
    loads = 1e-6 * np.random.default_rng(0).normal(size=(4, 4, 2))
    loads -= loads.mean((0, 1))
    found = gx.equilibrium(ring, loads=jnp.asarray(loads))
    flat = lambda x: ring.force(0.0, x.reshape(4, 4, 2), ring.zeros()).ravel()
    stiffness = -np.asarray(jax.jacfwd(flat)(jnp.zeros(32)))
    u = np.linalg.lstsq(stiffness, loads.ravel(), rcond=1e-10)[0]
    assert_allclose(found.state.u.ravel(), u, rtol=0, atol=1e-4 * np.abs(u).max())


@pytest.mark.slow
def test_rest_at_zero_is_found_from_a_guess_beside_it():
    # forces vanish with the displacements, so none of them has a size at the end
    for guess in (1e-9, 0.01, 0.1):
        found = gx.equilibrium(gx.scenes.klein_gordon(6, 0.1), guess=guess * jnp.arange(6))
        assert found.verdict == "stable" and abs(found.state.u).max() < 1e-25 * guess


@pytest.mark.slow
def test_a_batch_says_how_many_lanes_rest():
    """Of sites in a well k u^2/2 + u^4/4 under no load: a valley, a hill, and none for a steady push."""
    make = lambda k, cube: gx.Lattice(1.0, gx.OnSite(gx.Polynomial(k, 0.0, cube)), sites=2)
    wells = jax.vmap(make, out_axes=-1)(jnp.array([1.0, -1.0, 0.0]), jnp.array([1.0, 1.0, 0.0]))
    loads = jnp.array([[0.5], [0.0], [0.5]]) * jnp.ones(2)
    find = lambda well, load: gx.equilibrium(well, loads=load, hold="nothing")
    found = jax.vmap(find, in_axes=(-1, 0))(wells, loads)
    assert found.found.tolist() == [True, True, False]
    assert found.verdict.tolist()[:2] == ["stable", "unstable"]
    sentence = "A state of rest was found in 2 of 3 lanes, a stable one in 1."
    assert found.outcome == sentence and sentence in str(found)


# ---- refusals


def test_what_cannot_rest_is_refused():
    batch = jax.vmap(lambda m: gx.scenes.monomer(5, m), out_axes=-1)(jnp.ones(2))
    touching = jnp.zeros(N).at[3].set(3.0)
    for call, message in (
        (lambda: gx.equilibrium(gx.scenes.magnets(N, P), guess=touching), "apart"),
        (lambda: gx.equilibrium(batch), "one lattice"),
        (lambda: gx.equilibrium(gx.scenes.monomer(5, boundary="free"), hold="end"), "hold: expect"),
        (lambda: gx.scenes.magnets(N, P, spacing=1.0, diameter=1.2), "These touch"),
        (lambda: gx.scenes.magnets(N, 1.5), "repel less further apart"),
    ):
        with refused(message):
            call()
    # beads that only touch resist nothing at first
    stack = gx.scenes.monomer(3)
    weights = np.full(3, 0.1)
    with pytest.raises(RuntimeError, match="meet no resistance.* contacts are closed"):
        gx.equilibrium(stack, loads=weights)
    found = gx.equilibrium(stack, loads=weights, guess=np.array([0.5, 0.4, 0.3]))
    shares = np.cumsum(weights) ** (2 / 3)
    assert_allclose(found.state.u, np.cumsum(shares[::-1])[::-1], rtol=1e-13)
