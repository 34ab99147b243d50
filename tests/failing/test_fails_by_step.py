"""The step: varied, too long, too short for the floating type, set by light masses or by no linear time scale."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from refusals import refused

import granjax as gx

slow = pytest.mark.slow

N = 8
FRAMES = 33


def dimer(ratio, F0):
    """Between walls; F0 is an array, so that every scene here is compiled once."""
    return gx.scenes.dimer(N, ratio=ratio, precompression=jnp.asarray(F0, float))


CHAIN = dimer(1.0, 1.0)
STATE = gx.states.random(CHAIN, 1, displacement=0.3)  # contacts stay closed
START = np.array(STATE)
# of a chain between walls, stiffness 3/2: the highest frequency
OMEGA = np.sqrt(6) * np.cos(np.pi / (2 * (N + 1)))
VERLET = gx.VelocityVerlet()
LIMIT = VERLET.stability_limit() / OMEGA


# the same chain by hand --------------------------------------------------------------------------------------------


def acceleration(u):
    force = np.maximum(1 - np.diff(u, prepend=0.0, append=0.0), 0) ** 1.5
    return force[:-1] - force[1:]


def energy_errors(states):
    u, v = np.moveaxis(np.asarray(states), 1, 0)
    e = -np.diff(u, prepend=0.0, append=0.0)
    bonds = 0.4 * np.maximum(1 + e, 0) ** 2.5 - 0.4 - e
    energies = (v**2).sum(1) / 2 + bonds.sum(1)
    return np.abs(energies / energies[0] - 1)


def runge_kutta(y, h, count):
    """The classical method of order 4, four forces a step."""
    field = lambda y: np.array([y[1], acceleration(y[0])])
    states = [y]
    for _ in range(count):
        k1 = field(y)
        k2 = field(y + h / 2 * k1)
        k3 = field(y + h / 2 * k2)
        k4 = field(y + h * k3)
        y = y + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        states.append(y)
    return states


def verlet(start, t1, h, step=lambda a0, a1, h: h):
    """Velocity Verlet, whose next step is `step(a0, a1, h)`."""
    u, v = start
    t = 0.0
    states = [(u, v)]
    a0 = acceleration(u)
    while t < t1:
        u = u + h * v + h * h / 2 * a0
        a1 = acceleration(u)
        v = v + h / 2 * (a0 + a1)
        states.append((u, v))
        t = t + h
        h = step(a0, a1, h)
        a0 = a1
    return states


def largest(states):
    return np.abs(np.asarray(states)[:, 0]).max()


# symplectic or not -------------------------------------------------------------------------------------------------


@slow
def test_energy_of_a_method_that_is_not_symplectic_drifts():
    t1 = 400.0
    h = 0.1
    drift = energy_errors(runge_kutta(START, h, round(t1 / h)))
    # as many forces: eleven a step instead of four
    run = gx.simulate(CHAIN, STATE, t1, step=11 / 4 * h, save_at=FRAMES)
    band = energy_errors(np.stack([run.us, run.vs], 1))
    assert run.stats["force_evaluations"] < 1.02 * 4 * t1 / h
    assert drift.max() > 3e-3 and 1.8 < drift.max() / drift[: len(drift) // 2].max() < 2.2
    assert band.max() < 3e-8 and band.max() < 1.2 * band[: FRAMES // 2].max()
    assert float(run.energy_error) == pytest.approx(band.max(), rel=1e-3)


def test_adaptive_steps_destroy_a_symplectic_method():
    t1 = 400.0
    tolerance = 1e-4

    def controlled(a0, a1, h):
        error = h * h * np.abs(a1 - a0).max() / 6  # third order: h^3 u'''/6
        return h * np.clip(0.9 * (tolerance / error) ** (1 / 3), 0.5, 2)

    varied = energy_errors(verlet(START, t1, 0.1, controlled))
    half = len(varied) // 2
    fixed = energy_errors(verlet(START, t1, t1 / (len(varied) - 1)))
    assert varied.max() > 10 * fixed.max() and varied.max() > 1.5 * varied[:half].max()
    assert fixed.max() < 1.1 * fixed[:half].max()
    with refused("a fixed step with VelocityVerlet.*A symplectic method loses its virtue"):
        gx.simulate(CHAIN, STATE, t1, solver=VERLET, tolerance=tolerance)


# too long ----------------------------------------------------------------------------------------------------------


@slow
def test_a_step_beyond_stability_grows_and_is_refused():
    quiet = START * [[1e-6], [1.0]]
    growth = lambda h: largest(verlet(quiet, 50 * h, h)) / largest([quiet])
    assert growth(0.99 * LIMIT) < 10 and growth(1.01 * LIMIT) > 1e5
    run = gx.simulate(CHAIN, gx.State(*quiet), 1000 * LIMIT, solver=VERLET, step=0.99 * LIMIT)
    assert np.abs(run.final.u).max() < 10 * largest([quiet])
    with refused(f"at most {LIMIT:.3f}.*where VelocityVerlet is stable"):
        gx.simulate(CHAIN, gx.State(*quiet), 1.0, solver=VERLET, step=1.01 * LIMIT)


# too short ---------------------------------------------------------------------------------------------------------


@slow
def test_float32_has_a_floor():
    small = jax.tree.map(lambda x: x.astype("float32"), (CHAIN, STATE))
    exact = np.asarray(gx.simulate(CHAIN, STATE, 24.0, step=0.01, save_at=FRAMES).final.u)

    def error(scene, step):
        run = gx.simulate(*scene, 24.0, step=step, save_at=FRAMES)
        return np.abs(np.asarray(run.final.u, float) - exact).max()

    coarse, fine, coarse32, fine32 = (
        error(scene, h) for scene in ((CHAIN, STATE), small) for h in (0.375, 0.375 / 16)
    )
    assert coarse / fine > 1e6
    assert fine32 > 1e-7 and fine32 > coarse32 / 3 and fine32 < 1e-5
    with refused("tolerance: expected at least 1.9e-06, what float32 holds"):
        gx.simulate(*small, 1.0, tolerance=1e-6)


# light masses ------------------------------------------------------------------------------------------------------


@slow
def test_light_masses_set_the_step():
    scenes = [(chain, gx.states.impact(chain)) for chain in (dimer(1.0, 1.0), dimer(0.01, 1.0))]
    by_hand = [gx.simulate(*scene, 100.0, save_at=FRAMES, step=0.17) for scene in scenes]
    chosen = [gx.simulate(*scene, 100.0, save_at=FRAMES) for scene in scenes]
    naive, ours = ([float(run.energy_error) for run in runs] for runs in (by_hand, chosen))
    assert naive[1] > 1e4 * naive[0] and max(ours) < 1e-9
    # what it costs: the highest frequency goes as (1 + 1/ratio)^(1/2)
    steps = [int(run.stats["steps"]) for run in chosen]
    assert steps[1] / steps[0] == pytest.approx(np.sqrt(101 / 2), rel=0.05)
    with refused("SRKN11b is stable"):
        gx.simulate(*scenes[1], 100.0, step=0.2)


# no linear time scale ----------------------------------------------------------------------------------------------


@slow
def test_a_sonic_vacuum_has_no_linear_time_scale():
    chain = dimer(0.5, 0.0)
    assert float(gx.flow.linear_frequency(chain)) == 0.0
    # the bound comes from the energy instead: forces of degree 3/2 have a time scale v^(-1/5)
    steps = []
    errors = []
    for v in (1e-6, 1.0, 1e6):
        run = gx.simulate(chain, gx.states.impact(chain, velocity=v), 20 / v**0.2, save_at=FRAMES)
        steps.append(float(run.stats["step"]) * v**0.2)
        errors.append(float(run.energy_error))
    assert max(errors) < 3e-5 and np.ptp(steps) < 0.02 * steps[0]
    with refused("Nothing is stiff at this energy .a sonic vacuum at rest"):
        gx.simulate(chain, gx.states.rest(chain), 1.0)
