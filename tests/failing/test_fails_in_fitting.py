"""Fitting: a chaotic record, contacts that never close, a way back that is lost."""

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import granjax as gx
from granjax.fit.problem import prepared

BEADS = 6


def vacuum(p):
    return gx.scenes.monomer(BEADS, stiffness=p["stiffness"])


@pytest.fixture(scope="module")
def chaotic():
    """Velocities of six beads without precompression between walls, some eighty collision times, with 1 % noise."""

    def rate(t, y):
        force = np.maximum(-np.diff(y[:BEADS], prepend=0.0, append=0.0), 0) ** 1.5
        return np.concatenate([y[BEADS:], force[:-1] - force[1:]])

    times = np.linspace(0.0, 240.0, 961)
    start = np.zeros(2 * BEADS)
    start[BEADS], start[BEADS + 3] = 1.0, -0.6
    v = solve_ivp(rate, (0, 240.0), start, "DOP853", times, rtol=1e-12, atol=1e-13).y[BEADS:].T
    data = v + 0.01 * np.random.default_rng(0).normal(size=v.shape)
    traces = gx.Traces(times, velocity=data, sites=range(BEADS), sigma=0.01)
    return {"traces": traces, "state": gx.State(start[:BEADS], start[BEADS:])}


@pytest.mark.slow
def test_one_long_window_has_a_useless_gradient_and_windows_succeed(chaotic, optimised):
    problem = prepared(vacuum, {"stiffness": 1.2}, **chaotic)
    linearise = jax.jit(lambda x: problem.linearise(x)[:2])
    places = ([x / 1.2] for x in np.linspace(-0.18, 0.0, 24))
    slopes = np.array(
        [matrix[:, 0] @ value for value, matrix in map(linearise, map(jnp.array, places))]
    )
    # everywhere above the true parameter the slope should be positive; it is, by chance, at every second place
    assert 4 < np.count_nonzero(slopes > 0) < 20 and np.abs(slopes).min() > 1e6
    one = gx.fit(vacuum, {"stiffness": 1.2}, **chaotic, max_steps=30, throw=False)
    assert one.reduced_chi_square > 100 and abs(float(one.parameters["stiffness"]) - 1) > 0.1
    many = gx.fit(vacuum, {"stiffness": 1.2}, **chaotic, windows=40)
    off = abs(float(many.parameters["stiffness"]) - 1)
    deviation = float(many.deviations["stiffness"])
    assert many.reduced_chi_square < 1.1 and off < 3 * deviation < 2e-3


def apart(p):
    return gx.scenes.monomer(4, stiffness=p["stiffness"], boundary="free")


@pytest.mark.slow
def test_a_fit_whose_contacts_never_close_says_so():
    """The beads fly apart: nothing that is measured depends on the contacts, and the naive derivative is zero."""
    state = gx.State(jnp.zeros(4), jnp.array([-0.3, -0.1, 0.1, 0.3]))
    end = lambda A: gx.simulate(apart({"stiffness": A}), state, 10.0, step=0.1).final.v
    assert not np.any(jax.jacfwd(end)(1.0))
    data = np.broadcast_to(np.asarray(state.v), (40, 4)) + 0.01
    traces = gx.Traces(np.linspace(0.0, 10.0, 40), velocity=data, sites=range(4), sigma=0.01)
    said = "do not depend on the parameters.*Contacts 0, 1, 2 of .* never close"
    with pytest.raises(RuntimeError, match=said):
        gx.fit(apart, {"stiffness": 1.0}, traces, state=state)
    fit = gx.fit(apart, {"stiffness": 1.0}, traces, state=state, throw=False)
    assert not fit.converged and np.isnan(fit.covariance).all()


def last_velocity(stiffness, adjoint, steps):
    chain = gx.scenes.monomer(20, stiffness=stiffness)
    how = dict(step=0.1, adjoint=adjoint, throw=False)
    return gx.simulate(chain, gx.states.impact(chain), 0.1 * steps, **how).final.v[7]


@pytest.mark.slow
def test_integrating_backwards_in_a_sonic_vacuum_does_not_return():
    """Trusted blindly, a way back that leads elsewhere gives a number; the default gives none."""
    chain = gx.scenes.monomer(20)
    state = gx.states.impact(chain)

    def slopes(steps, tolerance):
        kept = jax.grad(last_velocity)(1.0, diffrax.RecursiveCheckpointAdjoint(), steps)
        back = jax.grad(last_velocity, (0, 1))(1.0, gx.Reversible(**tolerance), steps)
        missed = gx.flow.return_error(chain, state, 0.0, 0.1 * steps, steps, gx.SRKN11b())
        return float(kept), float(back[0]), float(back[1].return_error), float(missed)

    kept, short, error, missed = slopes(1000, {})
    assert short == pytest.approx(kept, rel=1e-6) and max(error, missed) < 1e-8
    kept, naive, error, missed = slopes(10_000, {"tolerance": 1e9})
    assert np.isfinite(naive) and abs(naive / kept - 1) > 1e-3 and missed > 1e-2
    held, back = jax.grad(last_velocity, (0, 1))(1.0, gx.Reversible(), 10_000)
    assert np.isnan(held) and back.return_error > 1e-2
