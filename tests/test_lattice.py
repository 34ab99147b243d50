import re
from collections import Counter
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import (
    ALL_LATTICES,
    MASS_IN_MASS,
    SAME_LATTICES,
    assert_ulps,
    over,
    random_like,
    scaled_leaves,
)
from numpy.testing import assert_allclose

import granjax as gx
from granjax.laws.real_power import root
from granjax.terms.energies import site_energy

T = 0.3
FACTORS = (1.0, 1.1, 0.9)


def terms_with_energy(lattice, u):
    return tuple(term for term in lattice.terms if term.energy(T, u) is not None)


@cache
def _facts(name):
    """State, and everything about one lattice from one compilation."""
    lattice = next(case.lattice for case in ALL_LATTICES if case.name == name)
    u, v = random_like(lattice.template(), 0, 0.2), random_like(lattice.template(), 1)

    def all_of(lattice, u, v):
        return dict(
            a=lattice.acceleration(T, u, v),
            force=lattice.force(T, u, v),
            stored=lattice.sum_forces(T, u, v, terms_with_energy(lattice, u)),
            gradient=jax.grad(lambda u: jnp.asarray(lattice.potential_energy(T, u)))(u),
            potential=jnp.asarray(lattice.potential_energy(T, u)),
            total=jnp.asarray(lattice.energy(T, u, v)),
            site=[site_energy(term, lattice, T, u) for term in lattice.terms],
        )

    return lattice, u, v, jax.jit(all_of)(lattice, u, v)


def facts(case):
    return _facts(case.name)


def size(tree):
    return 1.0 + max(float(jnp.max(jnp.abs(x))) for x in jax.tree.leaves(tree))


@over(ALL_LATTICES)
def test_force_is_minus_the_gradient_of_the_potential_energy(case):
    _, _, _, x = facts(case)
    assert_ulps(x["stored"], jax.tree.map(jnp.negative, x["gradient"]), 128, size(x["stored"]))


@over([case for case in ALL_LATTICES if case.inner])
def test_inner_forces_sum_to_zero(case):
    lattice, _, _, x = facts(case)
    total = np.asarray(x["force"]).sum(tuple(range(lattice.axes)))
    assert_allclose(total, 0, atol=1e-14 * size(x["force"]))


@pytest.mark.study
@over(ALL_LATTICES, SAME_LATTICES)
def test_acceleration_is_force_over_mass_under_jit_as_eagerly(case):
    lattice, u, v, x = facts(case)
    eager = lattice.acceleration(T, u, v)
    assert_ulps(x["a"], eager, 64, size(eager))
    assert_ulps(jax.tree.map(jnp.multiply, x["a"], lattice.mass), x["force"], 8, size(x["force"]))


@pytest.mark.slow
@over(ALL_LATTICES)
def test_energies_add_up(case):
    lattice, u, v, x = facts(case)
    kinetic = sum(
        np.sum(np.asarray(m) * np.asarray(w) ** 2) / 2
        for m, w in zip(jax.tree.leaves(lattice.mass), jax.tree.leaves(v))
    )
    assert_allclose(x["total"] - x["potential"], kinetic, rtol=1e-13, atol=1e-14)
    shared = sum(float(s.sum()) for s in jax.tree.leaves(x["site"]))
    assert_allclose(shared, x["potential"], rtol=1e-13, atol=1e-14)


@pytest.mark.slow
@over(ALL_LATTICES, SAME_LATTICES)
def test_a_batch_of_lattices_is_a_loop(case):
    """`jax.vmap(make, out_axes=-1)` is one Lattice with lanes: acceleration and energy, lane by lane."""
    lattice, u, v, _ = facts(case)
    batch = jax.vmap(lambda f: scaled_leaves(lattice, f), out_axes=-1)(jnp.array(FACTORS))
    assert batch.lanes == (3,) and batch.shape == lattice.shape

    def lanes(x):
        return jax.tree.map(lambda x: jnp.stack([f * x for f in FACTORS], -1), x)

    assert jax.tree.map(jnp.shape, batch.zeros()) == jax.tree.map(jnp.shape, lanes(u))

    def both(lattice, u, v):
        return lattice.acceleration(T, u, v), jnp.asarray(lattice.energy(T, u, v))

    run = jax.jit(both)
    got = run(batch, lanes(u), lanes(v))
    each = [run(scaled_leaves(lattice, f), *jax.tree.map(lambda x: f * x, (u, v))) for f in FACTORS]
    want = jax.tree.map(lambda *x: jnp.stack(x, -1), *each)
    assert_ulps(got, want, 128, size(want))
    mapped = jax.jit(jax.vmap(both, in_axes=-1, out_axes=-1))(batch, lanes(u), lanes(v))
    assert_ulps(mapped, want, 128, size(want))


@over(ALL_LATTICES)
def test_float32_stays_float32(case):
    lattice, u, v, _ = facts(case)
    single = lattice.astype(jnp.float32)
    cast = jax.tree.map(lambda x: x.astype(jnp.float32), (u, v))
    a = jax.eval_shape(single.acceleration, jnp.float32(T), *cast)
    assert all(x.dtype == jnp.float32 for x in jax.tree.leaves(a))
    assert single.dtype == jnp.float32 and lattice.dtype == jnp.float64


@over(ALL_LATTICES)
def test_vector_field_has_the_structure_of_the_state(case):
    lattice, u, v, x = facts(case)
    assert isinstance(jax.eval_shape(gx.vector_field, T, gx.State(u, v), lattice), gx.State)
    got = jax.eval_shape(gx.vector_field, T, (u, v), lattice)
    assert type(got) is tuple
    assert jax.tree.map(jnp.shape, got) == jax.tree.map(jnp.shape, (v, x["a"]))


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


# ------------------------------------------------------------------------------------------------ equilibrium


def _bond(boundary, F0=0.7):
    return gx.Bond(gx.Shift(1, boundary), gx.Hertz(1.2, F0))


@pytest.mark.parametrize(
    "terms, want",
    [
        ((_bond("fixed"),), np.zeros(5)),
        ((_bond("periodic"),), np.zeros(5)),
        ((_bond("free"),), np.array([-0.7, 0, 0, 0, 0.7])),
        ((_bond("free", 0.0),), np.zeros(5)),
        (
            (
                _bond("free"),
                gx.Wall(gx.Hertz(3.0, 0.7), "left"),
                gx.Wall(gx.Hertz(3.0, 0.7), "right"),
            ),
            np.zeros(5),
        ),
        ((_bond("free"), gx.Wall(gx.Hertz(3.0, 0.7), "left")), np.array([0, 0, 0, 0, 0.7])),
        ((gx.Modulated(_bond("free"), lambda t: 1.0),), np.array([-0.7, 0, 0, 0, 0.7])),
        (
            (
                gx.Bond(
                    gx.Shift(1, "fixed"), gx.Hertz(1.0, np.array([1.0, 1.0, 1.0, 2.0, 2.0, 2.0]))
                ),
            ),
            np.array([0, 0, -1.0, 0, 0]),
        ),
    ],
    ids=[
        "fixed",
        "periodic",
        "free",
        "free_no_load",
        "walls",
        "left_wall",
        "modulated",
        "jump_in_load",
    ],
)
def test_unbalanced_shows_what_no_term_holds(terms, want):
    assert_allclose(gx.Lattice(np.ones(5), terms).unbalanced(), want, atol=1e-14)


# ------------------------------------------------------------------------------------------ absent terms cost nothing


def hand_written(mass, stiffness):
    def acceleration(u):
        s = jnp.maximum(u[:-1] - u[1:], 0)
        f = stiffness * (s * root(s))
        return (jnp.pad(f, (1, 0)) - jnp.pad(f, (0, 1))) / mass

    return acceleration


def _programs():
    mass, u = jnp.linspace(1.0, 2.0, 50), jnp.zeros(50)
    lattice = gx.Lattice(mass, (gx.Bond(gx.Shift(1, "free"), gx.Hertz(1.3)),))
    rest = jnp.zeros(50)
    return (
        lambda lattice, u: lattice.acceleration(0.0, u, rest),
        lambda lattice, u: hand_written(lattice.mass, lattice.terms[0].law.stiffness)(u),
        lattice,
        u,
    )


def test_a_prestressed_periodic_crystal_is_balanced():
    lattice = next(case.lattice for case in ALL_LATTICES if case.name == "triangular")
    assert_allclose(lattice.unbalanced(), 0, atol=1e-14)


def test_vector_field_is_velocity_and_acceleration():
    lattice = MASS_IN_MASS
    u, v = random_like(lattice.template(), 0), random_like(lattice.template(), 1)
    du, dv = gx.vector_field(T, gx.State(u, v), lattice)
    assert_ulps(du, v, 0)
    assert_ulps(dv, lattice.acceleration(T, u, v), 0)
    assert lattice.fields == ("bead", "resonator") and lattice.sites == {
        "bead": (6,),
        "resonator": (6,),
    }


def opcodes(f, *args):
    """How often each operation occurs in the program that XLA has compiled."""
    text = jax.jit(f).lower(*args).compile().as_text()
    return Counter(re.findall(r"^\s*(?:ROOT )?\S+ = (?:\([^)]*\)|\S+) ([\w-]+)\(", text, re.M))


def test_the_compiled_program_is_the_one_written_by_hand():
    ours, hand, *args = _programs()
    got, want = opcodes(ours, *args), opcodes(hand, *args)
    # the reading of the text has found the operations; which root there is depends on the processor
    assert want["shift-right-logical"] + want["sqrt"] >= 1 and want["divide"] == 1
    assert got == want
