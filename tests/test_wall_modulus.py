"""The modulus of a wall from the wave that it reflects, against traces of another integrator and right-hand side."""

import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp

import granjax as gx

N = 20
RADIUS = 9.525e-3
SPEED = 0.4
YOUNG = 193e9
POISSON = 0.30
DENSITY = 8000.0
STEEL = gx.materials.Material("steel", YOUNG, POISSON, DENSITY)
CHAIN = gx.scenes.beads(STEEL, RADIUS, cells=N, boundary="free")
TIMES = np.arange(0.0, 1.5e-3, 2e-6)


def measured(wall_young, wall_poisson):
    """Velocities (T, N) and contact forces (T, N), the last one the wall's, by SciPy's DOP853."""
    mass = 4 / 3 * np.pi * RADIUS**3 * DENSITY
    inner = YOUNG * np.sqrt(2 * RADIUS) / (3 * (1 - POISSON**2))
    compliance = (1 - POISSON**2) / YOUNG + (1 - wall_poisson**2) / wall_young
    outer = 4 / 3 * np.sqrt(RADIUS) / compliance

    def forces(u):
        return np.append(inner * np.maximum(u[:-1] - u[1:], 0) ** 1.5, outer * max(u[-1], 0) ** 1.5)

    def motion(t, y):
        f = forces(y[:N])
        return np.concatenate([y[N:], (np.append(0, f[:-1]) - f) / mass])

    start = np.zeros(2 * N)
    start[N] = SPEED
    how = dict(method="DOP853", rtol=1e-10, atol=1e-16, t_eval=TIMES)
    y = solve_ivp(motion, (0, TIMES[-1]), start, **how).y
    return y[N:].T, np.array([forces(u) for u in y[:N].T])


def fitted(traces, start, poisson, **how):
    """A chain that ends at a wall, fitted from several starts as the gallery's script does."""

    def leaning(p):
        wall = gx.materials.Material("wall", p["modulus"], poisson, 1.0)
        contact = gx.Hertz(gx.materials.hertz_coefficient(STEEL, RADIUS, wall, jnp.inf))
        terms = (*CHAIN.terms, gx.Wall(contact, "right"))
        return gx.Lattice(CHAIN.mass, terms, sites=N, units="SI")

    bounds = {"modulus": (0, None)}
    return gx.fit(leaning, start, traces, bounds=bounds, starts=5, spread=1.0, **how)


@pytest.mark.slow
def test_modulus_of_bone_from_the_force_in_one_contact():
    """From one trace without noise and a start that is three times off."""
    _, forces = measured(15e9, 0.3)
    traces = gx.Traces(TIMES, force=forces[:, 12], contacts=12)
    found = fitted(traces, {"modulus": 5e9}, 0.3, state=gx.states.impact(CHAIN, SPEED))
    assert found.converged
    assert_allclose(found.parameters["modulus"], 15e9, rtol=1e-5)


@pytest.mark.slow
def test_noise_and_an_unknown_velocity_of_impact():
    """With 2 % noise and the velocity of impact fitted too, the modulus is known to 0.31 %, and 0.23 % off."""
    velocities, _ = measured(3.3e9, 0.35)
    sigma = 0.02 * np.abs(velocities[:, 12]).max()
    data = velocities[:, 12] + sigma * np.random.default_rng(0).normal(size=TIMES.size)
    traces = gx.Traces(TIMES, velocity=data, sites=12, sigma=sigma)
    state = lambda p, chain: gx.states.impact(chain, p["velocity"])
    found = fitted(traces, {"velocity": 0.45, "modulus": 10e9}, 0.35, state=state)
    modulus = found.parameters["modulus"]
    deviation = found.deviations["modulus"]
    assert_allclose(deviation / modulus, 3.1e-3, rtol=0.05)
    assert abs(modulus - 3.3e9) < 3 * deviation
    assert abs(found.parameters["velocity"] - SPEED) < 3 * found.deviations["velocity"]
    assert 0.8 < found.reduced_chi_square < 1.2
