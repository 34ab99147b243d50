"""Records by long adaptive steps, with their stated errors. By hand: pytest -c /dev/null benchmarks/long."""

import jax.numpy as jnp
import numpy as np

import granjax as gx

T1 = 30.0
THRESHOLDS = np.array([0.9, 0.99, 0.9999])


def place(t, y, lattice):
    return y.u[0]


def thrice(t, y, lattice):
    return jnp.stack([y.u[0]] * 3)


def square(t, y, lattice):
    return y.u[0] ** 2


def test_a_crossing_that_rises_and_falls_within_one_step_is_found():
    """A site that moves as -sin t, at tolerance 1e-6: the stated error of the integral is 1.05e-6, above its bound."""
    lattice = gx.Lattice(1.0, (gx.OnSite(gx.Linear(1.0)),), sites=2)
    state = gx.State(jnp.zeros(2), jnp.array([-1.0, 0.0]))
    record = {
        "arrival": gx.Arrival(thrice, THRESHOLDS),
        "peak": gx.Peak(place),
        "integral": gx.Integral(square),
    }
    how = dict(solver=gx.RKN1210(), tolerance=1e-6)
    run = gx.simulate(lattice, state, T1, record=record, confirm=True, **how)
    true = {
        "arrival": np.pi + np.arcsin(THRESHOLDS),
        "peak": 1.0,
        "integral": T1 / 2 - np.sin(2 * T1) / 4,
    }
    for name, expected in true.items():
        gap, error = np.abs(run.recorded[name] - expected), run.error.records[name]
        most = 1e-6 * (100 if name == "arrival" else 1)
        assert np.all(gap < error) and np.all(error < most), (name, gap, error)
