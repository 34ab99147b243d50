"""Fitting: a chaotic record, contacts that never close, a product of parameters, a way back that is lost."""

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import granjax as gx
from granjax.fit.problem import prepared

# a chaotic record --------------------------------------------------------------------------------------------------

BEADS = 6


def vacuum(p):
    return gx.scenes.monomer(BEADS, stiffness=p["stiffness"])


def two_strokes(p, chain):
    state = gx.states.impact(chain, 1.0)
    return gx.State(state.u, state.v.at[3].set(-0.6))


@pytest.fixture(scope="module")
def chaotic():
    """Velocities of six beads without precompression between walls, some eighty collision times, with 1 % noise."""

    def rate(t, y):
        u, v = y[:BEADS], y[BEADS:]
        force = np.maximum(np.concatenate([[-u[0]], u[:-1] - u[1:], [u[-1]]]), 0) ** 1.5
        return np.concatenate([v, force[:-1] - force[1:]])

    times = np.linspace(0.0, 240.0, 961)
    start = np.zeros(2 * BEADS)
    start[BEADS], start[BEADS + 3] = 1.0, -0.6
    v = (
        solve_ivp(rate, (0, 240.0), start, method="DOP853", rtol=1e-12, atol=1e-13, t_eval=times)
        .y[BEADS:]
        .T
    )
    data = v + 0.01 * np.random.default_rng(0).normal(size=v.shape)
    return gx.Traces(times, velocity=data, sites=range(BEADS), sigma=0.01)


@pytest.mark.study
def test_one_long_window_has_a_useless_gradient_and_windows_succeed(chaotic):
    problem = prepared(vacuum, {"stiffness": 1.2}, chaotic, state=two_strokes)
    slope = jax.jit(
        lambda x: (lambda value, matrix, _: matrix[:, 0] @ value)(*problem.linearise(x))
    )
    slopes = np.array([slope(jnp.array([x / 1.2])) for x in np.linspace(-0.18, 0.0, 24)])
    # everywhere above the true parameter the slope should be positive; it is, by chance, at every second place
    assert 4 < np.count_nonzero(slopes > 0) < 20 and np.abs(slopes).min() > 1e6
    one = gx.fit(vacuum, {"stiffness": 1.2}, chaotic, state=two_strokes, throw=False)
    assert one.reduced_chi_square > 100 and abs(float(one.parameters["stiffness"]) - 1) > 0.1
    many = gx.fit(vacuum, {"stiffness": 1.2}, chaotic, state=two_strokes, windows=40)
    assert many.reduced_chi_square < 1.1
    assert (
        abs(float(many.parameters["stiffness"]) - 1)
        < 3 * float(many.deviations["stiffness"])
        < 2e-3
    )


# contacts that never close -----------------------------------------------------------------------------------------


def apart(p):
    return gx.scenes.monomer(4, stiffness=p["stiffness"], boundary="free")


@pytest.mark.study
def test_a_fit_whose_contacts_never_close_says_so():
    # the beads fly apart: nothing that is measured depends on the contacts
    state = gx.State(jnp.zeros(4), jnp.array([-0.3, -0.1, 0.1, 0.3]))
    times = np.linspace(0.0, 10.0, 40)
    data = np.broadcast_to(np.asarray(state.v), (40, 4)) + 0.01
    traces = gx.Traces(times, velocity=data, sites=range(4), sigma=0.01)
    residuals = lambda A: (
        gx.simulate(apart({"stiffness": A}), state, 10.0, step=0.1).final.v - data[-1]
    )
    assert not np.any(jax.jacfwd(residuals)(1.0)) and np.any(residuals(1.0)), (
        "the naive way: no step, no word"
    )
    with pytest.raises(
        RuntimeError, match="do not depend on the parameters.*Contacts 0, 1, 2 of .* never close"
    ):
        gx.fit(apart, {"stiffness": 1.0}, traces, state=state)
    fit = gx.fit(apart, {"stiffness": 1.0}, traces, state=state, throw=False)
    assert not fit.converged and np.isnan(fit.covariance).all()


# a product of parameters -------------------------------------------------------------------------------------------


def coated(p):
    return gx.scenes.monomer(6, stiffness=p["modulus"] * p["width"], precompression=1.0)


@pytest.mark.study
def test_two_parameters_that_only_occur_as_a_product():
    state = gx.states.impact(coated({"modulus": 2.0, "width": 0.5}), 0.5)
    run = gx.simulate(coated({"modulus": 2.0, "width": 0.5}), state, 15.0, step=0.02, save_at=151)
    data = np.asarray(run.vs)[:, [2, 4]] + 1e-3 * np.random.default_rng(1).normal(size=(151, 2))
    traces = gx.Traces(run.ts, velocity=data, sites=[2, 4], sigma=1e-3)
    fit = gx.fit(coated, {"modulus": 1.8, "width": 0.6}, traces, state=state, throw=False)
    p = {name: float(x) for name, x in fit.parameters.items()}
    # a perfect fit and a product that is right, with factors that mean nothing
    assert fit.reduced_chi_square < 1.2 and p["modulus"] * p["width"] == pytest.approx(
        1.0, rel=1e-3
    )
    assert abs(p["modulus"] - 2.0) > 0.05
    (said, known) = fit.undetermined
    assert (
        "modulus and width apart" in said
        and "the direction modulus width^-1.00 is known not at all" in said
    )
    assert "A p d0^(p-1)" in known
    assert np.isinf(np.diag(fit.covariance)).all()


# a way back that is lost -------------------------------------------------------------------------------------------


def last_velocity(stiffness, adjoint, steps):
    chain = gx.scenes.monomer(20, stiffness=stiffness)
    run = gx.simulate(
        chain, gx.states.impact(chain), 0.1 * steps, step=0.1, adjoint=adjoint, throw=False
    )
    return run.final.v[7]


@pytest.mark.study
def test_integrating_backwards_in_a_sonic_vacuum_does_not_return():
    chain = gx.scenes.monomer(20)
    state = gx.states.impact(chain)
    missed = [
        float(gx.flow.return_error(chain, state, 0.0, 0.1 * n, n, gx.SRKN11b()))
        for n in (1000, 10_000)
    ]
    assert missed[0] < 1e-8 and missed[1] > 1e-2
    short, back = jax.grad(lambda A, adjoint: last_velocity(A, adjoint, 1000), (0, 1))(
        1.0, gx.Reversible()
    )
    kept = jax.grad(lambda A: last_velocity(A, diffrax.RecursiveCheckpointAdjoint(), 1000))(1.0)
    assert float(short) == pytest.approx(float(kept), rel=1e-6) and back.return_error < 1e-8
    # trusted blindly, a way back that leads elsewhere gives a number; the default gives none
    naive = jax.grad(lambda A: last_velocity(A, gx.Reversible(tolerance=1e9), 10_000))(1.0)
    kept = jax.grad(lambda A: last_velocity(A, diffrax.RecursiveCheckpointAdjoint(), 10_000))(1.0)
    assert np.isfinite(naive) and abs(float(naive / kept) - 1) > 1e-3
    held, back = jax.grad(lambda A, adjoint: last_velocity(A, adjoint, 10_000), (0, 1))(
        1.0, gx.Reversible()
    )
    assert np.isnan(held) and back.return_error > 1e-2
