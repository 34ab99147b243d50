"""Derivatives: of the force at a contact, of an impact that misses, of a flow on an adaptive mesh."""

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import expm

import granjax as gx

slow = pytest.mark.slow

# at a contact ------------------------------------------------------------------------------------------------------

NAIVE = {
    "x**1.5": lambda x: x**1.5,
    "where": lambda x: jnp.where(x > 0, x**1.5, 0.0),
    "maximum": lambda x: jnp.maximum(x, 0.0) * jnp.sqrt(jnp.maximum(x, 0.0)),
}
OVERLAPS = np.array([-0.3, 0.0, 0.3])  # open, touching, closed
EXACT = np.array([1.5 * 0.3**0.5, 0.75 * 0.3**-0.5, -0.375 * 0.3**-1.5])


def derivatives(force):
    """Orders 1 to 3 (rows) by reverse mode at open, touching and closed contact (columns)."""
    first = jax.grad(force)
    orders = first, jax.grad(first), jax.grad(jax.grad(first))
    return np.asarray(jax.jit(lambda x: jnp.stack([jax.vmap(f)(x) for f in orders]))(OVERLAPS))


@pytest.mark.parametrize("form", NAIVE)
def test_naive_forces_have_no_derivative_at_an_open_or_touching_contact(form):
    found = derivatives(NAIVE[form])
    assert not np.isfinite(found[:, :2]).all()
    assert np.allclose(found[:, 2], EXACT, rtol=1e-13)


def test_hertz_has_derivatives_of_every_order():
    found = derivatives(gx.Hertz().force)
    assert np.array_equal(found[:, :2], np.zeros((3, 2)))
    assert np.allclose(found[:, 2], EXACT, rtol=1e-13)


# an impact that misses ---------------------------------------------------------------------------------------------


def thrown(velocity):
    """A bead at distance 1/2 is thrown at three others: speed of the last one at t = 3, and the run."""
    chain = gx.scenes.monomer(4, boundary="free")
    first = jnp.array([1.0, 0.0, 0.0, 0.0])
    measures = {"force": gx.measures.contact_force, "overlap": gx.measures.overlap}
    record = {name: gx.Peak(measure) for name, measure in measures.items()}
    state = gx.State(-0.5 * first, velocity * first)
    run = gx.simulate(chain, state, 3.0, step=0.05, record=record)
    return run.final.v[-1], run.recorded


@slow
def test_an_impact_that_misses_has_no_gradient():
    derivative = jax.jit(lambda velocity: jax.jvp(thrown, (velocity,), (1.0,)))
    (_, recorded), short = derivative(0.1)
    # a gradient that is zero to the last bit, while a faster bead would arrive: no descent starts from here
    assert short[0] == 0.0 and derivative(1.0)[1][0] > 0.1
    # how to recognise it: no contact carried a force; what to descend on: the gap still left, -1/2 + 3 v
    assert recorded["force"][0] == 0.0
    assert recorded["overlap"][0] == pytest.approx(-0.2, abs=1e-13)
    assert short[1]["overlap"][0] == pytest.approx(3.0, abs=1e-12)


# tangents ----------------------------------------------------------------------------------------------------------

N = 8
PERIOD = 2 * np.pi
# all beads swing together with frequency 1, and the contacts, 24 times as fast, stay at rest: a linear tangent flow
BOND = gx.Bond(gx.Shift(1, "periodic"), gx.Hertz(1000.0, 1.0))
RING = gx.Lattice(1.0, (BOND, gx.OnSite(gx.Linear(1.0))), sites=N)
SWING = np.concatenate([np.full(N, 0.5), np.zeros(N)])
J = np.kron([[0, 1], [-1, 0]], np.eye(N))
TOLERANCE = 1e-8


@pytest.fixture(scope="module")
def exact():
    """The monodromy matrix and the highest frequency, from the linear chain."""
    stiffness = -np.asarray(jax.jacfwd(lambda u: RING.acceleration(0.0, u, u))(jnp.zeros(N)))
    generator = np.kron([[0, 1], [0, 0]], np.eye(N)) - np.kron([[0, 0], [1, 0]], stiffness)
    return expm(PERIOD * generator), np.sqrt(np.linalg.eigvalsh(stiffness).max())


def end(z, **how):
    run = gx.simulate(RING, gx.State(z[:N], z[N:]), PERIOD, adjoint=diffrax.ForwardMode(), **how)
    return jnp.concatenate([run.final.u, run.final.v])


def error_of_tangents(M, **how):
    """Of a run's monodromy matrix, and its symplectic defect."""
    found = np.asarray(jax.jacfwd(lambda z: end(z, **how))(SWING))
    return np.abs(found - M).max(), np.abs(found.T @ J @ found - J).max()


@slow
def test_tangents_through_an_adaptive_mesh_are_garbage(exact):
    M, omega = exact
    # the mesh follows the state, and its steps are beyond stability for the tangents
    assert np.abs(end(SWING, tolerance=TOLERANCE) - SWING).max() < 1e-9
    assert not error_of_tangents(M, tolerance=TOLERANCE)[0] < 100
    # a fixed symplectic step that the highest linear frequency sets
    assert error_of_tangents(M, step=0.5 / omega)[0] < 3e-6


@slow
def test_the_symplectic_defect_is_blind_to_the_error_of_the_step(exact):
    M, omega = exact
    coarse = 2.5 / omega
    fine = 1.25 / omega
    error, defect = error_of_tangents(M, step=coarse)
    assert defect < 1e-13 and error > 1e-2
    # two step sizes tell
    apart = jax.jacfwd(lambda z: end(z, step=coarse) - end(z, step=fine))(SWING)
    assert 0.8 < np.abs(apart).max() / error < 1.25
