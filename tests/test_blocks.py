"""Long chains in blocks: the same as stage by stage, and so are their derivatives."""

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import few

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


def chain(sites, boundary, even, damping):
    """A Hertz chain with numbers that are alike along it, or one for each bond and site."""
    rng = np.random.default_rng(sites)
    along = lambda count: 1.2 if even else rng.uniform(0.6, 1.8, count)
    terms = (gx.Bond(gx.Shift(1, boundary), gx.Hertz(along(sites + BONDS[boundary]), 1.0)),)
    if damping:
        terms = (*terms, gx.Damping(0.1 if even else rng.uniform(0.1, 0.3, sites)))
    return gx.Lattice(along(sites), terms, sites=sites)


def state(sites):
    rng = np.random.default_rng(1)
    return gx.State(*(jnp.asarray(rng.uniform(-0.3, 0.3, sites)) for _ in "uv"))


def steps(lattice, y, solver, field=gx.vector_field):
    """Three steps, through diffrax as in any run."""
    return diffrax.diffeqsolve(
        diffrax.ODETerm(field),
        solver,
        0.0,
        0.6,
        0.2,
        y,
        args=lattice,
        max_steps=4,
        adjoint=diffrax.DirectAdjoint(),
    ).ys


def by_stages(t, y, lattice):
    return gx.vector_field(t, y, lattice)


by_stages.split_system = split_system

FIRST = [(143, "fixed", False, True, gx.SRKN14a()), (191, "periodic", True, True, gx.SRKN6b())]
MORE = [
    (130, "fixed", True, False, gx.SRKN6b()),
    (144, "free", True, True, gx.VelocityVerlet()),
    (145, "free", False, False, gx.SRKN6b()),
    (192, "periodic", False, True, gx.SRKN14a()),
]
CASES = [FIRST[0], *(pytest.param(*case, marks=pytest.mark.slow) for case in (FIRST[1], *MORE))]


@pytest.mark.parametrize(("sites", "boundary", "even", "damping", "solver"), CASES)
def test_a_chain_in_blocks_is_the_chain(short, sites, boundary, even, damping, solver):
    """Contacts that open included; at every place of the last block's end and of a wall in it."""
    lattice, y = chain(sites, boundary, even, damping), state(sites)
    assert isinstance(blocks.in_blocks(lattice, y), blocks.BlockSplit)
    got, want = steps(lattice, y, solver), steps(lattice, y, solver, by_stages)
    for a, b in zip(got, want):
        np.testing.assert_allclose(a, b, rtol=0, atol=2e-15)


@pytest.mark.slow
def test_derivatives_through_blocks_are_those_without(short):
    lattice, y = chain(130, "periodic", False, True), state(130)
    weights = state(130)

    def value(field):
        def of(stiffness, y):
            bond = gx.Bond(lattice.terms[0].strain_map, gx.Hertz(stiffness, 1.0))
            made = gx.Lattice(lattice.mass, (bond, *lattice.terms[1:]), sites=130)
            return sum(
                jnp.vdot(w, x) for w, x in zip(weights, steps(made, y, gx.VelocityVerlet(), field))
            )

        return of

    at, direction = (lattice.terms[0].law.stiffness, y), (jnp.ones(130), state(130))
    forward = [jax.jvp(value(field), at, direction)[1] for field in (gx.vector_field, by_stages)]
    np.testing.assert_allclose(*forward, rtol=1e-12)
    reverse = [
        jax.grad(value(field), argnums=(0, 1))(*at) for field in (gx.vector_field, by_stages)
    ]
    for a, b in zip(*map(jax.tree.leaves, reverse)):
        np.testing.assert_allclose(a, b, rtol=0, atol=1e-12 * np.abs(b).max())


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


@pytest.mark.study
@pytest.mark.parametrize(
    "law",
    few(
        [
            gx.Linear(1.3),
            gx.Hertz(1.0, 1.0) + gx.Linear(0.2),
            Softened(jnp.linspace(0.5, 1.5, 131), jnp.ones(1)),
        ],
        -1,
    ),
    ids=["linear", "sum", "own"],
)
def test_any_law_in_blocks_through_a_whole_run(monkeypatch, law):
    """Frames, records, energy and openings of `simulate` are those without blocks."""
    lattice, y = gx.Lattice(1.0, (gx.Bond(gx.Shift(1, "fixed"), law),), sites=130), state(130)
    record = {"peak": gx.Peak(lambda t, y, lattice: y.u), "work": gx.Integral(gx.measures.energy)}
    monkeypatch.setattr(blocks, "BLOCK", 48)
    runs = []
    for long in (1000, 100):
        monkeypatch.setattr(blocks, "LONG", long)
        assert (blocks.in_blocks(lattice, y) is None) == (long == 1000)
        gx.clear()
        runs.append(
            gx.simulate(lattice, y, 2.0, solver=gx.SRKN6b(), step=0.2, save_at=4, record=record)
        )
    for a, b in zip(*[jax.tree.leaves((r.us, r.vs, r.recorded, r.energy_error)) for r in runs]):
        np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-14)
    assert runs[0].opening == runs[1].opening


def test_what_is_no_long_chain_goes_by_stages(short):
    y = state(130)
    for lattice in (
        gx.Lattice(
            1.0, (gx.Bond(gx.Shift(1, "fixed"), Tabulated(jnp.linspace(-1, 1, 61))),), sites=130
        ),
        gx.Lattice(1.0, (gx.Bond(gx.Shift(2, "fixed"), gx.Hertz()),), sites=130),
        gx.Lattice(
            1.0, (gx.Bond(gx.Shift(1, "fixed"), gx.Hertz()), gx.OnSite(gx.Linear(1.0))), sites=130
        ),
        gx.Lattice(jnp.ones((130, 2)), (gx.Bond(gx.Shift(1, "fixed"), gx.Hertz()),)),
    ):
        assert blocks.in_blocks(lattice, y) is None
    assert blocks.in_blocks(chain(130, "fixed", True, False), state(99)) is None
