"""Where lattices rest: magnets between ends, loads, saddles, terms of one's own."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_array_equal
from refusals import refused

import granjax as gx

N, P = 9, -4.0


def pair_forces(x):
    """The force on each magnet at positions x."""
    away = x[:, None] - x
    np.fill_diagonal(away, np.inf)
    return np.sum(np.sign(away) * np.abs(away) ** P, 1)


@pytest.mark.study
@pytest.mark.parametrize(
    "boundary, length", [("fixed", N + 1), pytest.param("free", N - 1, marks=pytest.mark.slow)]
)
def test_magnets_between_ends_rest(boundary, length):
    lattice = gx.scenes.magnets(N, P, boundary=boundary)
    x = np.arange(N) + np.asarray(lattice.terms[0].rest)
    x = np.concatenate([[-1.0], x, [N]]) if boundary == "fixed" else x
    forces = pair_forces(x)
    assert np.abs(forces[1:-1]).max() < 1e-13 * np.abs(forces).max()
    assert x[-1] - x[0] == length
    found = gx.equilibrium(lattice)
    np.testing.assert_allclose(found.ends, [-forces[0], forces[-1]], rtol=1e-12)
    assert found.residual <= 1e-13 * found.largest and found.verdict == "stable"
    np.testing.assert_allclose(found.state.u, 0, atol=1e-14)
    assert_array_equal(lattice.force(0.0, lattice.zeros(), lattice.zeros()), 0)


@pytest.mark.study
def test_equal_spacings_are_no_rest_and_the_outcome_says_so():
    magnets = gx.LongRange(np.arange(1.0, N) ** P, gx.PowerLaw(1.0, P, 1.0), "free", takes="strain")
    lattice = gx.Lattice(np.linspace(1, 2, N), magnets, sites=N)
    found = gx.equilibrium(lattice)
    np.testing.assert_allclose(
        found.state.u, gx.scenes.magnets(N, P, boundary="free").terms[0].rest, atol=1e-14
    )
    assert "only loads on inner sites hold" in found.outcome
    there = found.lattice
    u = jnp.asarray(0.01 * np.random.default_rng(2).normal(size=N))
    x = np.arange(N) + np.asarray(found.state.u)
    np.testing.assert_allclose(
        there.force(0.0, u, u), pair_forces(x + np.asarray(u)) - pair_forces(x), atol=1e-14
    )
    slope = jax.grad(lambda u: there.potential_energy(0.0, u))(u)
    np.testing.assert_allclose(slope, -there.force(0.0, u, u), rtol=0, atol=1e-13)


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
    np.testing.assert_allclose(saddle.stiffness, -2e3, rtol=1e-12)
    found = gx.equilibrium(lattice, guess=jnp.full(4, 0.7e-3))
    assert found.verdict == "stable"
    np.testing.assert_allclose(found.state.u, 1e-3, rtol=1e-13)


@pytest.mark.slow
def test_loads_and_their_derivative():
    lattice = gx.scenes.monomer(5, precompression=1.0)
    weight = jnp.full(5, 0.02)

    def lowest(stiffness):
        chain = gx.scenes.monomer(5, stiffness=stiffness, precompression=1.0)
        return gx.equilibrium(chain, loads=weight).state.u[-1]

    found = gx.equilibrium(lattice, loads=weight)
    forces = gx.measures.contact_force(lattice, found.state)
    np.testing.assert_allclose(np.diff(forces), 0.02, rtol=1e-12)
    np.testing.assert_allclose(found.ends, forces[jnp.asarray([0, -1])], rtol=1e-14)
    h = 1e-4
    np.testing.assert_allclose(
        jax.grad(lowest)(1.0), (lowest(1 + h) - lowest(1 - h)) / (2 * h), rtol=1e-6
    )


def test_loads_that_stay_are_those_of_the_preloads_and_without_any_it_falls_apart():
    law = gx.laws.Strained(gx.Polynomial(1.0, 0.3, 0.5), 0.1)
    chain = gx.Lattice(1.0, gx.Bond(gx.Shift(1, "free"), law), sites=5)
    held = gx.equilibrium(chain, hold="loads")
    np.testing.assert_allclose(held.state.u, 0, atol=1e-15)
    np.testing.assert_allclose(held.loads, [law.preload, 0, 0, 0, -law.preload], atol=1e-15)
    np.testing.assert_allclose(held.ends, [law.preload] * 2, rtol=1e-13)
    push = jnp.asarray([0.02, 0, 0, 0, -0.02])
    pressed = gx.equilibrium(chain, hold="loads", loads=push)
    forces = gx.measures.contact_force(chain, pressed.state)
    np.testing.assert_allclose(forces, law.preload + 0.02, rtol=1e-12)
    apart = gx.equilibrium(chain, hold="nothing")
    np.testing.assert_allclose(np.diff(apart.state.u), 0.1, rtol=1e-12)
    assert_array_equal(apart.loads, 0)
    assert abs(np.mean(apart.state.u)) < 1e-15


@pytest.mark.slow
def test_fields_that_no_term_joins_keep_their_means_each():
    bonds = tuple(gx.Bond(gx.Shift(1, "free", fields=name), gx.Hertz(1.0, 1.0)) for name in "ab")
    lattice = gx.Lattice({"a": 1.0, "b": 2.0}, bonds, sites=4)
    loads = {"a": jnp.array([0.1, 0, 0, -0.1]), "b": jnp.array([0.0, 0.2, -0.2, 0.0])}
    rest = gx.equilibrium(lattice, loads=loads)
    assert rest.verdict == "stable"
    for u in rest.state.u.values():
        np.testing.assert_allclose(u, -u[::-1], atol=1e-14)
    # the contact carries the preload and the load: (1 + y)^{3/2} = 1.1
    squeeze = 1.1 ** (2 / 3) - 1
    np.testing.assert_allclose(-np.diff(rest.state.u["a"]), squeeze, rtol=1e-12)


@pytest.mark.slow
def test_a_lattice_with_fields_and_its_gradient():
    lattice = gx.scenes.mass_in_mass(4, 0.5, 2.0, precompression=1.0)
    load = {"bead": jnp.full(4, 0.02), "resonator": jnp.full(4, 0.01)}
    found = gx.equilibrium(lattice, loads=load)
    swing = found.state.u["resonator"] - found.state.u["bead"]
    np.testing.assert_allclose(swing, 0.01 / 2.0, rtol=1e-12)
    assert found.ends is None and found.verdict == "stable"
    slope = jax.grad(
        lambda k: gx.equilibrium(
            gx.scenes.mass_in_mass(4, 0.5, k, precompression=1.0), loads=load
        ).state.u["resonator"][1]
    )(2.0)
    np.testing.assert_allclose(slope, -0.01 / 2.0**2, rtol=1e-10)


@pytest.mark.slow
def test_the_plane():
    h = 0.75**0.5
    bonds = [
        gx.Bond(
            gx.Stretch(gx.Shift(offset, "free"), vector),
            gx.Polynomial(1.0, 0.3) + gx.Hertz(0.5, 0.2),
        )
        for offset, vector in (((1, 0), [1.0, 0.0]), ((0, 1), [0.5, h]), ((-1, 1), [-0.5, h]))
    ]
    lattice = gx.Lattice(1.0, bonds, sites=(4, 4), dimension=2)
    loads = 0.02 * jnp.asarray(np.random.default_rng(7).normal(size=(4, 4, 2)))
    found = gx.equilibrium(lattice, loads=loads)
    u = np.asarray(found.state.u)
    left = lattice.force(0.0, found.state.u, lattice.zeros()) + lattice.unbalanced() + found.loads
    assert np.abs(left).max() <= 1e-13 * found.largest and found.verdict == "stable"
    # the edges are held by what loads they need, the inner sites by those given
    assert np.abs(u[1:3, 1:3]).min() > 1e-4 and np.count_nonzero(u) == 8
    assert_array_equal(found.loads[1:3, 1:3], loads[1:3, 1:3])


def test_refusals():
    with refused("apart"):
        gx.equilibrium(gx.scenes.magnets(N, P), guess=jnp.zeros(N).at[3].set(3.0))
    with refused("one lattice"):
        gx.equilibrium(jax.vmap(lambda m: gx.scenes.monomer(5, m), out_axes=-1)(jnp.ones(2)))
    with refused("hold: expected one of"):
        gx.equilibrium(gx.scenes.monomer(5, boundary="free"), hold="end")
    with refused("These touch"):
        gx.scenes.magnets(N, P, spacing=1.0, diameter=1.2)
    with refused("repel less further apart"):
        gx.scenes.magnets(N, 1.5)


def chain_at_rest(positions, p, boundary):
    """Where magnets of force r^p rest between the outermost two, by SciPy."""
    from scipy.optimize import root

    x = np.array(positions, float)

    def forces(inner):
        x[1:-1] = inner
        away = x[:, None] - x
        np.fill_diagonal(away, np.inf)
        return np.sum(np.sign(away) * np.abs(away) ** p, 1)[1:-1]

    found = root(forces, x[1:-1], tol=1e-14)
    x[1:-1] = found.x
    return x if boundary == "free" else x[1:-1]


def rest_of(p, sites, boundary):
    return gx.scenes.magnets(sites, p, boundary=boundary).terms[0].rest


@pytest.mark.parametrize("sites, boundary", [(6, "free"), (5, "fixed")])
def test_magnets_of_a_traced_exponent_rest_where_they_do(sites, boundary):
    exponents = jnp.array([-4.5, -4.0, -2.7])
    ends = np.arange(sites) if boundary == "free" else np.arange(-1, sites + 1)

    def expected(p):
        return chain_at_rest(ends, p, boundary) - np.arange(sites)

    found = jax.jit(jax.vmap(lambda p: rest_of(p, sites, boundary), out_axes=-1))(exponents)
    for lane, p in enumerate(exponents):
        np.testing.assert_allclose(found[:, lane], expected(float(p)), atol=1e-13)
        np.testing.assert_allclose(rest_of(p, sites, boundary), expected(float(p)), atol=1e-13)
    slope = (expected(-2.7 + 1e-4) - expected(-2.7 - 1e-4)) / 2e-4
    for mode in (jax.jacfwd, jax.jacrev):
        np.testing.assert_allclose(
            mode(lambda p: rest_of(p, sites, boundary))(-2.7), slope, atol=1e-7
        )
    bend = (expected(-2.7 + 1e-3) - 2 * expected(-2.7) + expected(-2.7 - 1e-3)) / 1e-6
    found = jax.jacfwd(jax.jacrev(lambda p: rest_of(p, sites, boundary)))(-2.7)
    np.testing.assert_allclose(found, bend, atol=1e-6)


def test_magnets_that_are_felt_far_away_rest_or_are_refused():
    """Plain steps of Newton's method pass one magnet through the next where p is about -1 and above."""
    for p, sites in ((-1.0, 10), (-0.5, 6)):
        x = np.concatenate(
            [[-1.0], np.arange(sites) + np.asarray(rest_of(p, sites, "fixed")), [sites]]
        )
        away = x[:, None] - x
        np.fill_diagonal(away, np.inf)
        assert (np.diff(x) > 0).all()
        assert np.abs(np.sum(np.sign(away) * np.abs(away) ** p, 1)[1:-1]).max() < 1e-12
    with refused("Take fewer magnets"):
        gx.scenes.magnets(200, -0.1)


@pytest.mark.slow
def test_eight_magnets_of_swept_exponents_run_as_alone_and_are_differentiated():
    def final(chain):
        return gx.simulate(chain, gx.states.impact(chain, velocity=0.1), 2.0, step=0.05).final.u

    def of(p):
        return final(gx.scenes.magnets(4, p))

    # the third to fifth are a difference
    p, h = -4.0, 1e-4
    exponents = jnp.array([-4.5, -4.2, p - h, p, p + h, -3.5, -3.1, -2.7])
    together = final(jax.vmap(lambda p: gx.scenes.magnets(4, p), out_axes=-1)(exponents))
    np.testing.assert_allclose(together[:, 3], of(p), rtol=0, atol=1e-12)
    value, forwards = jax.jit(lambda p: jax.jvp(of, (p,), (1.0,)))(p)
    np.testing.assert_allclose(together[:, 3], value, rtol=0, atol=1e-12)
    slope = (together[:, 4] - together[:, 2]) / (2 * h)
    np.testing.assert_allclose(forwards, slope, rtol=1e-5)
    np.testing.assert_allclose(jax.jit(jax.grad(lambda p: of(p)[2]))(p), slope[2], rtol=1e-5)


@pytest.mark.slow
def test_the_exponent_of_magnets_is_fitted():
    chain = gx.scenes.magnets(4, -3.3)
    state, ts = gx.states.impact(chain, velocity=0.2), np.linspace(0.2, 3.0, 15)
    data = gx.simulate(chain, state, 3.0, step=0.05, save_at=ts).vs
    found = gx.fit(
        lambda q: gx.scenes.magnets(4, q["exponent"]),
        {"exponent": -4.0},
        gx.Traces(times=ts, velocity=data, sites=[0, 1, 2, 3], sigma=1e-4),
        state=state,
    )
    assert float(found.parameters["exponent"]) == pytest.approx(-3.3, abs=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize(
    "make, loads",
    [
        # u by hand: a chain between walls, springs in a row
        (
            lambda k: gx.Lattice(
                1.0, gx.Bond(gx.Shift(1, "fixed"), gx.Polynomial(k, 0.3 * k, 0.2 * k)), sites=4
            ),
            None,
        ),
        (
            lambda k: gx.Lattice(
                1.0,
                (gx.Bond(gx.Shift(1, "free"), gx.Toda(k, 1.0)), gx.OnSite(gx.Linear(1.0))),
                sites=4,
            ),
            None,
        ),
        (
            lambda k: gx.Lattice(
                1.0, gx.Bond(gx.Shift(1, "free"), gx.Polynomial(k, 0.0, k)), sites=4
            ),
            jnp.array([0.4, 0.1, -0.3, -0.2]),
        ),
    ],
)
def test_rest_under_transformations(make, loads):
    """jit, vmap, both modes and curvature, against SciPy on the forces written out."""
    from scipy.optimize import fsolve

    push = jnp.array([0.3, 0.0, -0.1, 0.2]) if loads is None else loads

    def rest(k):
        return gx.equilibrium(make(k), loads=push).state.u

    def alone(k):
        lattice = make(k)
        force = jax.jit(lambda u: lattice.force(0.0, u, jnp.zeros(4)))
        if loads is None:
            return fsolve(lambda u: np.asarray(force(u) + push), np.zeros(4), xtol=1e-13)
        # e (k + k e^2) of each spring is what pushes from the left; the mean stays
        squeezed = [np.roots([k, 0, k, -f])[-1].real for f in np.cumsum(push)[:-1]]
        u = -np.concatenate([[0], np.cumsum(squeezed)])
        return u - u.mean()

    ks = jnp.array([0.8, 1.0, 1.7])
    found = jax.jit(jax.vmap(rest))(ks)
    np.testing.assert_allclose(found, [alone(float(k)) for k in ks], atol=1e-9)
    np.testing.assert_allclose(jax.jit(rest)(1.0), rest(1.0), atol=1e-14)
    slope = (alone(1.0 + 1e-4) - alone(1.0 - 1e-4)) / 2e-4
    for mode in (jax.jacfwd, jax.jacrev):
        np.testing.assert_allclose(jax.jit(mode(rest))(1.0), slope, atol=1e-6)


def test_loads_on_the_ends_of_a_free_chain_act_where_they_balance():
    chain = gx.scenes.fput(5, alpha=0.25, boundary="free")
    found = gx.equilibrium(chain, loads=jnp.array([1.0, 0, 0, 0, -1.0]))
    e = (np.sqrt(2) - 1) * 2  # e + e^2/4 = 1
    np.testing.assert_allclose(-np.diff(found.state.u), e, rtol=1e-13)
    np.testing.assert_allclose(found.loads, [1.0, 0, 0, 0, -1.0])
    np.testing.assert_allclose(found.ends, 1.0)
    assert found.verdict == "stable" and abs(float(np.mean(found.state.u))) < 1e-15
    traced = jax.jit(
        lambda f: gx.equilibrium(chain, loads=f * jnp.array([1.0, 0, 0, 0, -1.0])).state.u
    )
    np.testing.assert_allclose(traced(1.0), found.state.u, atol=1e-14)


def test_loads_that_do_not_balance_are_borne_and_the_outcome_says_so():
    chain = gx.scenes.fput(5, alpha=0.0, boundary="free")
    found = gx.equilibrium(chain, loads=jnp.array([1.0, 0.2, 0, 0, 0]))
    # a straight line from the load to either end, both of which stay
    np.testing.assert_allclose(found.state.u, [0, 0.15, 0.1, 0.05, 0], atol=1e-14)
    assert "bears the loads given on them" in found.outcome
    assert "bears" not in gx.equilibrium(chain, loads=jnp.array([0, 0.2, 0, 0, 0])).outcome
    # what is under a preload takes more of it, on top of what holds it
    chain = gx.scenes.monomer(4, precompression=1.0, boundary="free")
    pressed = gx.equilibrium(chain, loads=jnp.array([0.5, 0, 0, -0.5]))
    np.testing.assert_allclose(-np.diff(pressed.state.u), 1.5 ** (2 / 3) - 1, rtol=1e-12)
    np.testing.assert_allclose(pressed.ends, 1.5, rtol=1e-13)


@pytest.mark.slow
def test_lanes_by_vmap():
    stiffness = jnp.asarray([1.0, 2.0, 4.0])
    batch = jax.vmap(lambda A: gx.scenes.monomer(5, stiffness=A, precompression=1.0), out_axes=-1)(
        stiffness
    )
    found = jax.vmap(
        lambda lattice: gx.equilibrium(lattice, loads=jnp.full(5, 0.02)).state.u,
        in_axes=-1,
        out_axes=-1,
    )(batch)
    for lane, A in enumerate(stiffness):
        alone = gx.equilibrium(
            gx.scenes.monomer(5, stiffness=A, precompression=1.0), loads=jnp.full(5, 0.02)
        )
        np.testing.assert_allclose(found[:, lane], alone.state.u, rtol=1e-11)


def test_loads_move_all_sites_of_a_ring_in_the_plane():
    """No site of a ring is an end that is held: the displacements are those of the dense stiffness."""
    ring = gx.scenes.triangular(4, 4, boundary="periodic")
    loads = 1e-6 * np.random.default_rng(0).normal(size=(4, 4, 2))
    loads -= loads.mean((0, 1))
    found = gx.equilibrium(ring, loads=jnp.asarray(loads))
    flat = lambda x: ring.force(0.0, x.reshape(4, 4, 2), ring.zeros()).ravel()
    stiffness = -np.asarray(jax.jacfwd(flat)(jnp.zeros(32)))
    u = np.linalg.lstsq(stiffness, loads.ravel(), rcond=1e-10)[0]
    np.testing.assert_allclose(found.state.u.ravel(), u, rtol=0, atol=1e-4 * np.abs(u).max())
