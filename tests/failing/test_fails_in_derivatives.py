"""Derivatives: of the force at a contact, of an impact that misses, of a flow on an adaptive mesh."""

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import expm

import granjax as gx

# at a contact ------------------------------------------------------------------------------------------------------

NAIVE = {
    "x**1.5": lambda x: x**1.5,
    "where": lambda x: jnp.where(x > 0, x**1.5, 0.0),
    "where, sqrt": lambda x: jnp.where(x > 0, x * jnp.sqrt(x), 0.0),
    "maximum": lambda x: jnp.maximum(x, 0.0) ** 1.5,
    "maximum, sqrt": lambda x: jnp.maximum(x, 0.0) * jnp.sqrt(jnp.maximum(x, 0.0)),
}
OVERLAPS = np.array([-0.3, 0.0, 0.3])  # open, touching, closed
EXACT = np.array([1.5 * 0.3**0.5, 0.75 * 0.3**-0.5, -0.375 * 0.3**-1.5])


def derivatives(force):
    """Orders 1 to 3 (rows) by reverse mode at open, touching and closed contact (columns)."""

    @jax.jit
    def all_orders(x):
        orders, f = [], force
        for _ in range(3):
            f = jax.grad(f)
            orders.append(jax.vmap(f)(x))
        return jnp.stack(orders)

    return np.asarray(all_orders(OVERLAPS))


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
    state = gx.State(jnp.array([-0.5, 0.0, 0.0, 0.0]), velocity * jnp.array([1.0, 0.0, 0.0, 0.0]))
    record = {
        "force": gx.Peak(lambda t, y, lattice: gx.measures.contact_force(lattice, y)),
        "overlap": gx.Peak(lambda t, y, lattice: gx.measures.overlap(lattice, y)),
    }
    run = gx.simulate(chain, state, 3.0, step=0.05, record=record)
    return run.final.v[-1], run.recorded


@pytest.mark.study
def test_an_impact_that_misses_has_no_gradient():
    derivative = jax.jit(jax.jacrev(thrown))
    short, hit = derivative(0.1), derivative(1.0)
    # a gradient that is zero to the last bit, while a faster bead would arrive: no descent starts from here
    assert short[0] == 0.0 and hit[0] > 0.1
    # how to recognise it: no contact carried a force; what to descend on: the gap still left, -1/2 + 3 v
    _, recorded = thrown(0.1)
    assert recorded["force"][0] == 0.0
    assert recorded["overlap"][0] == pytest.approx(-0.2, abs=1e-13)
    assert short[1]["overlap"][0] == pytest.approx(3.0, abs=1e-12)


# tangents ----------------------------------------------------------------------------------------------------------

N, PERIOD = 8, 2 * np.pi
# all beads swing together with frequency 1, and the contacts, 24 times as fast, stay at rest: a linear tangent flow
RING = gx.Lattice(
    1.0,
    (gx.Bond(gx.Shift(1, "periodic"), gx.Hertz(1000.0, 1.0)), gx.OnSite(gx.Linear(1.0))),
    sites=N,
)
SWING = np.concatenate([np.full(N, 0.5), np.zeros(N)])
J = np.block([[np.zeros((N, N)), np.eye(N)], [-np.eye(N), np.zeros((N, N))]])
TOLERANCE = 1e-8


@pytest.fixture(scope="module")
def exact():
    """The monodromy matrix and the highest frequency, from the linear chain."""
    stiffness = -np.asarray(jax.jacfwd(lambda u: RING.acceleration(0.0, u, u))(jnp.zeros(N)))
    generator = np.block([[np.zeros((N, N)), np.eye(N)], [-stiffness, np.zeros((N, N))]])
    return expm(PERIOD * generator), np.sqrt(np.linalg.eigvalsh(stiffness).max())


def end(z, **how):
    run = gx.simulate(RING, gx.State(z[:N], z[N:]), PERIOD, adjoint=diffrax.ForwardMode(), **how)
    return jnp.concatenate([run.final.u, run.final.v])


def monodromy(**how):
    return np.asarray(jax.jacfwd(lambda z: end(z, **how))(SWING))


def defect(M):
    return np.abs(M.T @ J @ M - J).max()


@pytest.mark.study
def test_tangents_through_an_adaptive_mesh_are_garbage(exact):
    M, omega = exact
    # the mesh follows the state, and its steps are beyond stability for the tangents
    assert np.abs(end(SWING, tolerance=TOLERANCE) - SWING).max() < 1e-9
    assert not np.abs(monodromy(tolerance=TOLERANCE) - M).max() < 100
    # a fixed symplectic step that the highest linear frequency sets
    assert np.abs(monodromy(step=0.5 / omega) - M).max() < 3e-6


@pytest.mark.slow
def test_tangents_inside_the_error_norm_hold(exact):
    M, _ = exact

    def variational(t, y, args):
        (u, U), (v, V) = y
        a = lambda u: RING.acceleration(t, u, u)
        return (v, V), (
            a(u),
            jax.vmap(lambda d: jax.jvp(a, (u,), (d,))[1], in_axes=-1, out_axes=-1)(U),
        )

    eye = np.eye(N), np.zeros((N, N))
    y = (jnp.asarray(SWING[:N]), jnp.hstack(eye)), (jnp.asarray(SWING[N:]), jnp.hstack(eye[::-1]))
    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(variational),
        gx.RKN86(),
        0.0,
        PERIOD,
        None,
        y,
        adjoint=diffrax.ForwardMode(),
        max_steps=None,
        stepsize_controller=diffrax.PIDController(rtol=TOLERANCE, atol=TOLERANCE),
    )
    (_, U), (_, V) = solution.ys
    assert np.abs(np.vstack([U[0], V[0]]) - M).max() < 1e-5


@pytest.mark.slow
def test_the_symplectic_defect_is_blind_to_the_error_of_the_step(exact):
    M, omega = exact
    coarse, fine = (monodromy(step=fraction / omega) for fraction in (2.5, 1.25))
    error = np.abs(coarse - M).max()
    assert defect(coarse) < 1e-13
    assert error > 1e-2
    # two step sizes tell
    assert 0.8 < np.abs(coarse - fine).max() / error < 1.25
