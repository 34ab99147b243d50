"""The modulus of a wall from the wave that it reflects, against traces of another integrator and right-hand side."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp

import granjax as gx
from granjax.identify.wall import wall_modulus

N, RADIUS, SPEED = 20, 9.525e-3, 0.4
YOUNG, POISSON, DENSITY = 193e9, 0.30, 8000.0
STEEL = gx.materials.Material("steel", YOUNG, POISSON, DENSITY)
CHAIN = gx.scenes.beads(STEEL, RADIUS, cells=N, boundary="free")
TIMES = np.arange(0.0, 1.5e-3, 2e-6)


def measured(wall_young, wall_poisson):
    """Velocities (T, N) and contact forces (T, N), the last one the wall's, by SciPy's DOP853."""
    mass = 4 / 3 * np.pi * RADIUS**3 * DENSITY
    inner = YOUNG * np.sqrt(2 * RADIUS) / (3 * (1 - POISSON**2))
    outer = (
        4 / 3 * np.sqrt(RADIUS) / ((1 - POISSON**2) / YOUNG + (1 - wall_poisson**2) / wall_young)
    )

    def forces(u):
        return np.append(inner * np.maximum(u[:-1] - u[1:], 0) ** 1.5, outer * max(u[-1], 0) ** 1.5)

    def motion(t, y):
        f = forces(y[:N])
        return np.concatenate([y[N:], (np.append(0, f[:-1]) - f) / mass])

    start = np.zeros(2 * N)
    start[N] = SPEED
    y = solve_ivp(
        motion, (0, TIMES[-1]), start, method="DOP853", rtol=1e-10, atol=1e-16, t_eval=TIMES
    ).y
    return y[N:].T, np.array([forces(u) for u in y[:N].T])


@pytest.mark.slow
@pytest.mark.parametrize(
    "young, poisson, kind, off", [(3.3e9, 0.35, "velocity", 3.0), (15e9, 0.3, "force", 1 / 3)]
)
def test_modulus_from_a_start_that_is_three_times_off(young, poisson, kind, off):
    """Polymer and bone, from one trace without noise: 3e-6 and 4e-7 off."""
    velocities, forces = measured(young, poisson)
    if kind == "velocity":
        traces = gx.Traces(TIMES, velocity=velocities[:, 12], sites=12)
    else:
        traces = gx.Traces(TIMES, force=forces[:, 12], contacts=12)
    found = wall_modulus(
        CHAIN,
        traces,
        state=gx.states.impact(CHAIN, SPEED),
        material=STEEL,
        radius=RADIUS,
        start=off * young,
        poisson=poisson,
    )
    assert found.fit.converged
    assert_allclose(found.modulus, young, rtol=1e-5)
    assert_allclose(found.plane_modulus, young / (1 - poisson**2), rtol=1e-5)
    reduced = 1 / ((1 - POISSON**2) / YOUNG + (1 - poisson**2) / young)
    assert_allclose(found.reduced_modulus, reduced, rtol=1e-5)
    assert_allclose(found.stiffness, 4 / 3 * reduced * np.sqrt(RADIUS), rtol=1e-5)
    # dE*/E* = s dE/E
    share = reduced * (1 - poisson**2) / young
    assert_allclose(found.relative[1:], share * found.relative[0], rtol=1e-4)


@pytest.mark.slow
def test_noise_and_an_unknown_velocity_of_impact():
    """With 2 % noise and the velocity of impact fitted too, the modulus is known to 0.31 %, and 0.23 % off."""
    velocities, _ = measured(3.3e9, 0.35)
    sigma = 0.02 * np.abs(velocities[:, 12]).max()
    data = velocities[:, 12] + sigma * np.random.default_rng(0).normal(size=TIMES.size)
    found = wall_modulus(
        CHAIN,
        gx.Traces(TIMES, velocity=data, sites=12, sigma=sigma),
        material=STEEL,
        radius=RADIUS,
        state=lambda p, chain: gx.states.impact(chain, p["velocity"]),
        start=10e9,
        poisson=0.35,
        others={"velocity": 0.45},
    )
    assert_allclose(found.deviation / found.modulus, 3.1e-3, rtol=0.05)
    assert abs(found.modulus - 3.3e9) < 3 * found.deviation
    assert abs(float(found.fit.parameters["velocity"]) - SPEED) < 3 * float(
        found.fit.deviations["velocity"]
    )
    assert "f64" not in repr(found) and found.to_xarray().chi_square.dims == ("scanned",)
    assert 0.8 < found.fit.reduced_chi_square < 1.2
    assert found.outcome.startswith(f"E = {found.modulus:.4g} +- ")


@pytest.mark.parametrize(
    "message, keywords",
    [
        ("poisson: expected numbers in", {"poisson": 0.6}),
        ("others: expected parameters beside 'modulus'", {"others": {"modulus": 1e9}}),
        (
            "lattice: expected no contact with a wall at its left end, got one",
            {
                "side": "left",
                "lattice": gx.Lattice(
                    CHAIN.mass, (*CHAIN.terms, gx.Wall(gx.Hertz(), "left")), sites=N
                ),
            },
        ),
        (
            "lattice: expected no contact with a wall",
            {"lattice": gx.scenes.beads(STEEL, RADIUS, cells=N)},
        ),
    ],
)
def test_what_cannot_be_meant_is_refused(message, keywords):
    given = {"lattice": CHAIN, "start": 3e9, "material": STEEL, "radius": RADIUS, **keywords}
    traces = gx.Traces(TIMES, velocity=TIMES, sites=12)
    with pytest.raises(ValueError, match=message):
        wall_modulus(given.pop("lattice"), traces, state=gx.states.impact(CHAIN, SPEED), **given)
