import re
from collections import Counter
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import ALL_LATTICES, SCENES, assert_ulps, over, random_like, scaled_leaves
from numpy.testing import assert_allclose

import granjax as gx
from granjax.laws.real_power import root
from granjax.terms.energies import site_energy

T = 0.3
FACTORS = (1.0, 1.1, 0.9)


@cache
def _facts(name):
    """State, and everything about one lattice from one compilation."""
    lattice = next(case.lattice for case in ALL_LATTICES if case.name == name)
    u = random_like(lattice.template(), 0, 0.2)
    v = random_like(lattice.template(), 1)

    def all_of(lattice, u, v):
        stored = tuple(term for term in lattice.terms if term.energy(T, u) is not None)
        return dict(
            a=lattice.acceleration(T, u, v),
            force=lattice.force(T, u, v),
            stored=lattice.sum_forces(T, u, v, stored),
            gradient=jax.grad(lambda u: jnp.asarray(lattice.potential_energy(T, u)))(u),
            potential=jnp.asarray(lattice.potential_energy(T, u)),
            total=jnp.asarray(lattice.energy(T, u, v)),
            site=[site_energy(term, lattice, T, u) for term in lattice.terms],
        )

    return lattice, u, v, jax.jit(all_of)(lattice, u, v)


def size(tree):
    return 1.0 + max(float(jnp.max(jnp.abs(x))) for x in jax.tree.leaves(tree))


@over(ALL_LATTICES)
def test_force_is_minus_the_gradient_of_the_potential_energy(case):
    lattice, _, _, x = _facts(case.name)
    assert_ulps(x["stored"], jax.tree.map(jnp.negative, x["gradient"]), 128, size(x["stored"]))
    assert_ulps(jax.tree.map(jnp.multiply, x["a"], lattice.mass), x["force"], 8, size(x["force"]))


@over([case for case in ALL_LATTICES if case.inner])
def test_inner_forces_sum_to_zero(case):
    lattice, _, _, x = _facts(case.name)
    total = np.asarray(x["force"]).sum(tuple(range(lattice.axes)))
    assert_allclose(total, 0, atol=1e-14 * size(x["force"]))


@pytest.mark.slow
@over(ALL_LATTICES)
def test_energies_add_up(case):
    lattice, _, v, x = _facts(case.name)
    masses = zip(jax.tree.leaves(lattice.mass), jax.tree.leaves(v))
    kinetic = sum(float(jnp.sum(m * w**2)) / 2 for m, w in masses)
    assert_allclose(x["total"] - x["potential"], kinetic, rtol=1e-13, atol=1e-14)
    shared = sum(float(s.sum()) for s in jax.tree.leaves(x["site"]))
    assert_allclose(shared, x["potential"], rtol=1e-13, atol=1e-14)


@pytest.mark.slow
@over(ALL_LATTICES)
def test_a_batch_of_lattices_is_a_loop(case):
    """`jax.vmap(make, out_axes=-1)` is one Lattice with lanes: acceleration and energy, lane by lane."""
    lattice, u, v, _ = _facts(case.name)
    batch = jax.vmap(lambda f: scaled_leaves(lattice, f), out_axes=-1)(jnp.array(FACTORS))
    lanes = jax.tree.map(lambda x: jnp.stack([f * x for f in FACTORS], -1), (u, v))
    assert batch.lanes == (3,) and batch.shape == lattice.shape
    assert jax.tree.map(jnp.shape, batch.zeros()) == jax.tree.map(jnp.shape, lanes[0])

    def both(lattice, u, v):
        return lattice.acceleration(T, u, v), jnp.asarray(lattice.energy(T, u, v))

    run = jax.jit(both)
    each = [run(*scaled_leaves((lattice, u, v), f)) for f in FACTORS]
    want = jax.tree.map(lambda *x: jnp.stack(x, -1), *each)
    for together in run, jax.jit(jax.vmap(both, in_axes=-1, out_axes=-1)):
        assert_ulps(together(batch, *lanes), want, 128, size(want))


@over(ALL_LATTICES)
def test_float32_stays_float32(case):
    lattice, u, v, _ = _facts(case.name)
    single = lattice.astype(jnp.float32)
    cast = jax.tree.map(lambda x: x.astype(jnp.float32), (u, v))
    a = jax.eval_shape(single.acceleration, jnp.float32(T), *cast)
    assert all(x.dtype == jnp.float32 for x in jax.tree.leaves(a))
    assert single.dtype == jnp.float32 and lattice.dtype == jnp.float64


@pytest.mark.slow
@over(SCENES)
def test_vector_field_is_velocity_and_acceleration(case):
    lattice, u, v, x = _facts(case.name)
    field = gx.vector_field(T, gx.State(u, v), lattice)
    assert isinstance(field, gx.State) and type(gx.vector_field(T, (u, v), lattice)) is tuple
    assert_ulps(field.u, v, 0)
    # compiled and not
    assert_ulps(field.v, x["a"], 64, size(x["a"]))


def test_chain_by_hand():
    mass = np.array([1.0, 2.0, 4.0])
    chain = gx.Lattice(mass, (gx.Bond(gx.Shift(1, "fixed"), gx.Hertz(2.0)),))
    u = jnp.array([-0.09, -0.25, 0.16])
    # compressions 0.09, 0.16, -0.41, 0.16: forces 0.054, 0.128, 0, 0.128
    want = np.array([0.054 - 0.128, (0.128 - 0) / 2, (0 - 0.128) / 4])
    assert_ulps(chain.acceleration(0.0, u, jnp.zeros(3)), want, 16)
    energy = 2 * 0.4 * (0.09**2.5 + 2 * 0.16**2.5)
    assert_allclose(chain.potential_energy(0.0, u), energy, rtol=1e-14)
    assert_allclose(chain.energy(0.0, u, jnp.ones(3)), energy + 3.5, rtol=1e-14)


def _bond(boundary, F0=0.7):
    return gx.Bond(gx.Shift(1, boundary), gx.Hertz(1.2, F0))


LEFT, RIGHT = (gx.Wall(gx.Hertz(3.0, 0.7), side) for side in ("left", "right"))


@pytest.mark.parametrize(
    "terms, want",
    [
        (_bond("periodic"), np.zeros(5)),
        (_bond("free"), [-0.7, 0, 0, 0, 0.7]),
        ((_bond("free"), LEFT, RIGHT), np.zeros(5)),
        ((_bond("free"), LEFT), [0, 0, 0, 0, 0.7]),
        (gx.Modulated(_bond("free"), lambda t: 1.0), [-0.7, 0, 0, 0, 0.7]),
        (_bond("fixed", np.array([1.0, 1.0, 1.0, 2.0, 2.0, 2.0])), [0, 0, -1, 0, 0]),
    ],
    ids=["periodic", "free", "walls", "left wall", "modulated", "jump in the load"],
)
def test_unbalanced_shows_what_no_term_holds(terms, want):
    assert_allclose(gx.Lattice(1.0, terms, sites=5).unbalanced(), want, atol=1e-14)


def test_a_prestressed_periodic_crystal_is_balanced():
    assert_allclose(_facts("triangular")[0].unbalanced(), 0, atol=1e-14)


def opcodes(f, *args):
    """How often each operation occurs in the program that XLA has compiled."""
    text = jax.jit(f).lower(*args).compile().as_text()
    return Counter(re.findall(r"^\s*(?:ROOT )?\S+ = (?:\([^)]*\)|\S+) ([\w-]+)\(", text, re.M))


def test_the_compiled_program_is_the_one_written_by_hand():
    def by_hand(lattice, u):
        s = jnp.maximum(u[:-1] - u[1:], 0)
        f = lattice.terms[0].law.stiffness * (s * root(s))
        return (jnp.pad(f, (1, 0)) - jnp.pad(f, (0, 1))) / lattice.mass

    rest = jnp.zeros(50)
    chain = gx.Lattice(jnp.linspace(1.0, 2.0, 50), gx.Bond(gx.Shift(1, "free"), gx.Hertz(1.3)))
    got = opcodes(lambda lattice, u: lattice.acceleration(0.0, u, rest), chain, rest)
    want = opcodes(by_hand, chain, rest)
    # the reading of the text has found the operations; which root there is depends on the processor
    assert want["shift-right-logical"] + want["sqrt"] >= 1 and want["divide"] == 1
    assert got == want
