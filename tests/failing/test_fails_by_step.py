"""The step: varied, too long, too short for the floating type, set by light masses or by no linear time scale."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from refusals import refused

import granjax as gx

N = 8
FRAMES = 33


def dimer(ratio, F0):
    """Between walls; F0 is an array, so that every scene here is compiled once."""
    return gx.scenes.dimer(N, ratio=ratio, precompression=jnp.asarray(F0, float))


CHAIN = dimer(1.0, 1.0)
STATE = gx.states.random(CHAIN, 1, displacement=0.3)  # contacts stay closed
START = np.asarray(STATE.u), np.asarray(STATE.v)
OMEGA = np.sqrt(6) * np.cos(
    np.pi / (2 * (N + 1))
)  # of a chain between walls, stiffness 3/2: the highest


# the same chain by hand --------------------------------------------------------------------------------------------


def acceleration(u):
    force = np.maximum(1 - np.diff(u, prepend=0.0, append=0.0), 0) ** 1.5
    return force[:-1] - force[1:]


def energy(u, v):
    e = -np.diff(u, prepend=0.0, append=0.0)
    return v @ v / 2 + np.sum(0.4 * np.maximum(1 + e, 0) ** 2.5 - 0.4 - e)


def energy_errors(states):
    energies = np.array([energy(u, v) for u, v in states])
    return np.abs(energies / energies[0] - 1)


def runge_kutta(u, v, h, count):
    """The classical method of order 4, four forces a step."""
    states = [(u, v)]
    for _ in range(count):
        a1 = acceleration(u)
        v2 = v + h / 2 * a1
        a2 = acceleration(u + h / 2 * v)
        v3 = v + h / 2 * a2
        a3 = acceleration(u + h / 2 * v2)
        v4 = v + h * a3
        a4 = acceleration(u + h * v3)
        u, v = u + h / 6 * (v + 2 * v2 + 2 * v3 + v4), v + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
        states.append((u, v))
    return states


def verlet(u, v, t1, step):
    """Velocity Verlet at `step(a0, a1, h)`, asked for after every step."""
    states, t, h = [(u, v)], 0.0, 0.1
    a0 = acceleration(u)
    while t < t1:
        u = u + h * v + h * h / 2 * a0
        a1 = acceleration(u)
        v = v + h / 2 * (a0 + a1)
        states.append((u, v))
        t, h, a0 = t + h, step(a0, a1, h), a1
    return states


# symplectic or not -------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_energy_of_a_method_that_is_not_symplectic_drifts():
    t1, h = 400.0, 0.1
    drift = energy_errors(runge_kutta(*START, h, round(t1 / h)))
    half = len(drift) // 2
    # as many forces: eleven a step instead of four
    run = gx.simulate(CHAIN, STATE, t1, step=11 / 4 * h, save_at=FRAMES)
    band = energy_errors(zip(np.asarray(run.us), np.asarray(run.vs)))
    assert run.stats["force_evaluations"] < 1.02 * 4 * t1 / h
    assert drift.max() > 3e-3 and 1.8 < drift.max() / drift[:half].max() < 2.2
    assert band.max() < 3e-8 and band.max() < 1.2 * band[: FRAMES // 2].max()
    assert float(run.energy_error) == pytest.approx(band.max(), rel=1e-3)


def test_adaptive_steps_destroy_a_symplectic_method():
    t1, tolerance = 400.0, 1e-4

    def controlled(a0, a1, h):
        error = h * h * np.abs(a1 - a0).max() / 6  # third order: h^3 u'''/6
        return h * np.clip(0.9 * (tolerance / error) ** (1 / 3), 0.5, 2)

    varied = energy_errors(verlet(*START, t1, controlled))
    h = t1 / (len(varied) - 1)
    fixed = energy_errors(verlet(*START, t1, lambda a0, a1, _: h))
    half = len(varied) // 2
    assert varied.max() > 10 * fixed.max() and varied.max() > 1.5 * varied[:half].max()
    assert fixed.max() < 1.1 * fixed[:half].max()
    with refused("a fixed step with VelocityVerlet.*A symplectic method loses its virtue"):
        gx.simulate(CHAIN, STATE, t1, solver=gx.VelocityVerlet(), tolerance=tolerance)


# too long ----------------------------------------------------------------------------------------------------------


def test_a_step_beyond_stability_grows_and_is_refused():
    quiet = 1e-6 * START[0], START[1]
    limit = gx.VelocityVerlet.stability_limit() / OMEGA

    def growth(h):
        states = verlet(*quiet, 50 * h, lambda a0, a1, _: h)
        return max(np.abs(u).max() for u, _ in states) / np.abs(quiet[0]).max()

    assert growth(0.99 * limit) < 10 and growth(1.01 * limit) > 1e5
    with refused(f"at most {limit:.3f}.*where VelocityVerlet is stable"):
        gx.simulate(CHAIN, gx.State(*quiet), 1.0, solver=gx.VelocityVerlet(), step=1.01 * limit)


@pytest.mark.slow
def test_a_step_inside_stability_holds():
    quiet = gx.State(1e-6 * STATE.u, STATE.v)
    limit = gx.VelocityVerlet.stability_limit() / OMEGA
    run = gx.simulate(CHAIN, quiet, 1000 * limit, solver=gx.VelocityVerlet(), step=0.99 * limit)
    assert np.abs(run.final.u).max() < 10 * np.abs(quiet.u).max()


@pytest.mark.slow
def test_a_blow_that_stiffens_the_chain_past_the_step_is_noticed():
    # stable for small waves, while this blow reaches 2.6 times their frequency
    hard = gx.states.impact(CHAIN, velocity=100.0)
    step = 0.8 * gx.VelocityVerlet.stability_limit() / OMEGA
    with pytest.raises((RuntimeError, ValueError), match="not finite .first between|is stable"):
        gx.simulate(CHAIN, hard, 100.0, solver=gx.VelocityVerlet(), step=step)
    assert float(gx.simulate(CHAIN, hard, 100.0).energy_error) < 1e-3


# too short ---------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_float32_has_a_floor():
    small = jax.tree.map(lambda x: x.astype("float32"), (CHAIN, STATE))
    steps = (0.375, 0.375 / 16)
    exact = np.asarray(gx.simulate(CHAIN, STATE, 24.0, step=0.01, save_at=FRAMES).final.u)
    errors = {}
    for name, (chain, state) in {"float64": (CHAIN, STATE), "float32": small}.items():
        runs = [gx.simulate(chain, state, 24.0, step=h, save_at=FRAMES) for h in steps]
        errors[name] = [np.abs(np.asarray(run.final.u, float) - exact).max() for run in runs]
    (coarse, fine), (coarse32, fine32) = errors["float64"], errors["float32"]
    assert coarse / fine > 1e6
    assert fine32 > 1e-7 and fine32 > coarse32 / 3 and fine32 < 1e-5
    with refused("tolerance: expected at least 1.9e-06, what float32 holds"):
        gx.simulate(*small, 1.0, tolerance=1e-6)


# light masses ------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_light_masses_set_the_step():
    equal, light = dimer(1.0, 1.0), dimer(0.01, 1.0)

    def runs(**how):
        return [
            gx.simulate(chain, gx.states.impact(chain), 100.0, save_at=FRAMES, **how)
            for chain in (equal, light)
        ]

    by_hand, chosen = runs(step=0.17), runs()
    naive, ours = ([float(run.energy_error) for run in both] for both in (by_hand, chosen))
    assert naive[1] > 1e4 * naive[0]
    assert max(ours) < 1e-9
    # what it costs: the highest frequency goes as (1 + 1/ratio)^(1/2)
    steps = [int(run.stats["steps"]) for run in chosen]
    assert steps[1] / steps[0] == pytest.approx(np.sqrt(101 / 2), rel=0.05)
    with refused("SRKN11b is stable"):
        gx.simulate(light, gx.states.impact(light), 100.0, step=0.2)


# no linear time scale ----------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_sonic_vacuum_has_no_linear_time_scale():
    chain = dimer(0.5, 0.0)
    with np.errstate(divide="ignore"):
        naive = 0.5 / np.asarray(gx.flow.linear_frequency(chain))
    assert np.isinf(naive)
    # the bound comes from the energy instead: forces of degree 3/2 have a time scale v^(-1/5)
    steps, errors = [], []
    for v in (1e-6, 1.0, 1e6):
        run = gx.simulate(chain, gx.states.impact(chain, velocity=v), 20 / v**0.2, save_at=FRAMES)
        steps.append(float(run.stats["step"]) * v**0.2)
        errors.append(float(run.energy_error))
    assert max(errors) < 3e-5 and np.ptp(steps) < 0.02 * steps[0]
    with refused("Nothing is stiff at this energy .a sonic vacuum at rest"):
        gx.simulate(chain, gx.states.rest(chain), 1.0)
