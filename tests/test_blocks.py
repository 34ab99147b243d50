"""Long chains in blocks: the same as stage by stage, and so are their derivatives."""

from functools import partial

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import granjax as gx
from granjax.lattice import blocks, split_system

BONDS = {"fixed": 1, "free": -1, "periodic": 0}


@pytest.fixture(autouse=True)
def any_processor(monkeypatch):
    """Blocks are tested on processors, too, where they are not taken."""
    monkeypatch.setattr(blocks, "blocks_win", lambda: True)


@pytest.fixture
def short(monkeypatch):
    """Blocks so short that a chain of 130 sites has some."""
    monkeypatch.setattr(blocks, "BLOCK", 48)
    monkeypatch.setattr(blocks, "LONG", 100)


def chain(sites, boundary, even, damping, *more):
    """A Hertz chain with numbers that are alike along it, or one for each bond and site; and more laws."""
    rng = np.random.default_rng(sites)
    along = lambda count: 1.2 if even else rng.uniform(0.6, 1.8, count)
    law = sum(more, gx.Hertz(along(sites + BONDS[boundary]), 1.0))
    terms = (gx.Bond(gx.Shift(1, boundary), law),)
    if damping:
        terms = (*terms, gx.Damping(0.1 if even else rng.uniform(0.1, 0.3, sites)))
    return gx.Lattice(along(sites), terms, sites=sites)


def state(sites):
    rng = np.random.default_rng(1)
    return gx.State(*(jnp.asarray(rng.uniform(-0.3, 0.3, sites)) for _ in "uv"))


def steps(lattice, y, solver, field=gx.vector_field):
    """Three steps, through diffrax as in any run."""
    how = dict(args=lattice, max_steps=4, adjoint=diffrax.DirectAdjoint())
    return diffrax.diffeqsolve(diffrax.ODETerm(field), solver, 0.0, 0.6, 0.2, y, **how).ys


def by_stages(t, y, lattice):
    return gx.vector_field(t, y, lattice)


by_stages.split_system = split_system
SLOW = [
    (191, "periodic", True, True, gx.SRKN6b()),
    (145, "free", False, False, gx.VelocityVerlet()),
]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("sites", "boundary", "even", "damping", "solver"),
    [
        (143, "fixed", False, True, gx.SRKN14a()),
        *(pytest.param(*case, marks=pytest.mark.slow) for case in SLOW),
    ],
)
def test_a_chain_in_blocks_is_the_chain(short, sites, boundary, even, damping, solver):
    """Contacts that open included; at every place of the last block's end and of a wall in it."""
    lattice = chain(sites, boundary, even, damping)
    y = state(sites)
    assert isinstance(blocks.in_blocks(lattice, y), blocks.BlockSplit)
    got = steps(lattice, y, solver)
    want = steps(lattice, y, solver, by_stages)
    assert_allclose(got, want, rtol=0, atol=2e-15)


@pytest.mark.slow
def test_derivatives_through_blocks_are_those_without(short):
    lattice = chain(130, "periodic", False, True)
    y = state(130)

    def value(stiffness, y, field):
        bond = gx.Bond(lattice.terms[0].strain_map, gx.Hertz(stiffness, 1.0))
        made = gx.Lattice(lattice.mass, (bond, *lattice.terms[1:]), sites=130)
        ends = steps(made, y, gx.VelocityVerlet(), field)
        return jnp.vdot(state(130).u, ends.u) + jnp.vdot(state(130).v, ends.v)

    at = (lattice.terms[0].law.stiffness, y)
    direction = (jnp.ones(130), state(130))
    forward = []
    reverse = []
    for field in (gx.vector_field, by_stages):
        own = partial(value, field=field)
        forward.append(jax.jvp(own, at, direction)[1])
        reverse.append(jax.grad(own, argnums=(0, 1))(*at))
    assert_allclose(*forward, rtol=1e-12)
    for a, b in zip(*map(jax.tree.leaves, reverse)):
        assert_allclose(a, b, rtol=0, atol=1e-12 * np.abs(b).max())


class Tabulated(gx.Law):
    """A law of one's own with a table that all bonds share."""

    table: jax.Array

    def force(self, e):
        return jnp.interp(e, jnp.linspace(-1, 1, len(self.table)), self.table)

    def energy(self, e):
        return jnp.full_like(e, jnp.nan)


class Softened(gx.Law):
    """A law of one's own with a number for each bond and one for all."""

    stiffness: jax.Array
    size: jax.Array

    def force(self, e):
        return self.stiffness * self.size * jnp.tanh(e / self.size)

    def energy(self, e):
        return self.stiffness * self.size**2 * jnp.log(jnp.cosh(e / self.size))


@pytest.mark.slow
def test_a_chain_of_a_sum_of_laws_in_blocks_is_the_chain(short):
    own = Softened(jnp.linspace(0.5, 1.5, 131), jnp.ones(1))
    lattice = chain(130, "fixed", True, False, own)
    y = state(130)
    assert isinstance(blocks.in_blocks(lattice, y), blocks.BlockSplit)
    got, want = (steps(lattice, y, gx.SRKN6b(), field) for field in (gx.vector_field, by_stages))
    assert_allclose(got, want, rtol=0, atol=2e-15)


def test_what_is_no_long_chain_goes_by_stages(short):
    hertz = gx.Bond(gx.Shift(1, "fixed"), gx.Hertz())
    for terms in (
        gx.Bond(gx.Shift(1, "fixed"), Tabulated(jnp.linspace(-1, 1, 61))),
        gx.Bond(gx.Shift(2, "fixed"), gx.Hertz()),
        (hertz, gx.OnSite(gx.Linear(1.0))),
    ):
        assert blocks.in_blocks(gx.Lattice(1.0, terms, sites=130), state(130)) is None
    assert blocks.in_blocks(gx.Lattice(jnp.ones((130, 2)), hertz), state(130)) is None
    assert blocks.in_blocks(chain(130, "fixed", True, False), state(99)) is None
