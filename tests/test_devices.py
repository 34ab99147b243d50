"""Devices of the gallery: what their scripts leave, beside other methods and further numbers."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from gallery import left_by
from scipy.integrate import solve_ivp

import granjax as gx

DAMPING = 1 / 1.75e-3


@pytest.mark.study
def test_left_is_right_at_small_amplitude():
    device = left_by("rectifier")
    chain, modes = device.with_defect(6)
    drives = np.array([1e-11, 1e-10, 1e-9])
    # in the band, and in the gap just below the defect's mode
    for omega in (float(modes[2]), 0.98 * float(modes[-1])):
        left, right, again = (
            np.array([device.passed(chain, omega, end, a, steps) for a in drives])
            for end, steps in (("left", 96), ("right", 96), ("left", 192))
        )
        asymmetry, error = left / right - 1, np.abs(left / again - 1)
        assert abs(asymmetry[0]) < 1e-8 and error[0] < 1e-8
        # beyond, the difference grows as the square of the amplitude, and is known
        assert abs(asymmetry[2]) > 1e3 * error[2]
        assert asymmetry[2] == pytest.approx(100 * asymmetry[1], rel=0.1)
        assert left[0] == pytest.approx(1e-11 * linear_gain(chain, omega), rel=1e-7)


def linear_gain(chain, omega):
    """Force on the far wall over the displacement of the near one: k_0 (K - omega^2 M + i omega C)^{-1}_{1N} k_N."""
    law, m = chain.terms[0].law, np.asarray(chain.mass)
    k = 1.5 * np.asarray(law.stiffness) ** (2 / 3) * np.asarray(law.precompression) ** (1 / 3)
    D = np.diag(k[:-1] + k[1:] - omega**2 * m + 1j * omega * DAMPING * m)
    D = D - np.diag(k[1:-1], 1) - np.diag(k[1:-1], -1)
    return abs(k[0] * np.linalg.inv(D)[0, -1] * k[-1])


@pytest.mark.study
def test_a_defect_beside_the_driver_rectifies():
    device = left_by("rectifier")
    # from the defect's side the motion ceases to be periodic at 0.177 um (at 0.175 it settles after 7165 periods, and
    # from their numbers at 0.155 ... 0.17 the rate vanishes at 0.178)
    assert (
        device.ceased == pytest.approx(0.177e-6, rel=0.02) and device.branch.verdict[0] == "stable"
    )
    # of a motion that does not repeat the mean over 60 periods changes by a part of it, which leaves a bound below
    last = jax.tree.map(lambda x: jnp.asarray(x[-1]), device.near.states)
    lattice = device.from_left(device.drives[-1])
    dissipated = gx.Integral(lambda t, y, c: DAMPING * jnp.sum((c.mass * y.v**2)[10:]))
    later, start = [], last
    for i in range(3):
        span = 60 * device.period
        run = gx.simulate(
            lattice,
            start,
            (i + 1) * span,
            t0=i * span,
            solver=gx.SRKN11b(),
            step=device.period / 64,
            record={"work": dissipated},
        )
        later.append(float(run.recorded["work"]) / span)
        start = run.final
    error = max(abs(x - device.near.response[-1]) for x in later)
    assert 0 < error < np.inf
    assert (device.near.response[-1] - error) / (
        device.far.response[-1] + device.far.response_error[-1]
    ) > 1e11
    assert gx.chaos.lyapunov(lattice, last, device.period, periods=1000).chaotic


@pytest.mark.slow
def test_gates():
    device = left_by("gates")
    assert device.output[3] == pytest.approx(
        by_scipy(device.steel, [0.1e-6, 0.1e-6], device.gap), abs=device.error[3]
    )
    assert device.error[3] < 0.01 * device.output[3]
    # what the difference carries is proportional to either
    _, output, _ = device.outputs(device.steel, np.array([[0.05e-6, 0.1e-6]]), device.gap[None])
    assert output[0] == pytest.approx(device.output[3] / 2, rel=0.1)
    # a switch: as much as both signals of the gate give, at first proportional to the control and then more than that
    on = device.output[device.on]
    assert on[4] == pytest.approx(device.output[3], rel=1e-12)
    assert on[2] / on[1] == pytest.approx(2, rel=0.05) and on[8] > 2.2 * on[4]
    assert 250 < device.low[device.on][8] / device.high[device.on][0] < on[8] / on[0]


def by_scipy(chain, amplitudes, omegas):
    """Root mean square velocity of the last bead, by an integrator and forces of its own."""
    law, m = chain.terms[0].law, np.asarray(chain.mass)
    A, F0 = (np.broadcast_to(x, (len(m) + 1,)) for x in (law.stiffness, law.precompression))
    overlap = (F0 / A) ** (2 / 3)

    def rate(t, y):
        u, v = np.split(y, 2)
        wall = np.sum(amplitudes * np.sin(omegas * t))
        force = A * np.maximum(overlap - np.diff(u, prepend=wall, append=0.0), 0) ** 1.5
        return np.append(v, -np.diff(force) / m - DAMPING * v)

    run = solve_ivp(
        rate,
        (0, 40e-3),
        np.zeros(2 * len(m)),
        method="DOP853",
        rtol=1e-9,
        atol=1e-13,
        t_eval=np.linspace(20e-3, 40e-3, 8193),
    )
    return np.sqrt(np.mean(run.y[-1, :-1] ** 2))


class Cubic(gx.Law):
    """F(e) = k e + c e^2 + d e^3, a law of the user's own, in SI."""

    k: jax.Array
    c: jax.Array
    d: jax.Array

    def force(self, e):
        return e * (self.k + e * (self.c + e * self.d))

    def energy(self, e):
        return e * e * (self.k / 2 + e * (self.c / 3 + e * self.d / 4))


@pytest.mark.slow
def test_gates_of_a_law_of_ones_own():
    """The contact's Taylor series carries the difference too, and is at work where the law is no contact."""
    device = left_by("gates")
    k2, k3, k4 = (jnp.asarray(x) for x in gx.laws.taylor(device.steel.terms[0].law))
    own = gx.Lattice(
        device.steel.mass, gx.Bond(gx.Shift(1, "fixed"), Cubic(k2, k3, k4)), units="SI"
    )
    omegas = np.tile(device.gap, (4, 1))
    (_, found, error), (_, hertz, _) = (
        device.outputs(chain, 2e-8 * device.rows, omegas) for chain in (own, device.steel)
    )
    assert (found - error)[3] > (found + error)[:3].max()
    assert abs(found[3] - hertz[3]) < 0.01 * hertz[3]


@pytest.mark.slow
def test_walls_that_move_the_same_way_make_an_antinode():
    found = left_by("driven_dark_breather").settled(0.05e-6, (0.0, 0.0))
    speed = np.asarray(found.amplitude)
    background = speed[np.abs(np.arange(21) - 10) > 5].mean()
    assert found.multiple == 1 and 1 - speed[10] / background == pytest.approx(-0.455, abs=0.01)
    assert np.argmax(speed[10:] > background / 2) == 0


@pytest.mark.slow
def test_contacts_of_the_dark_breather():
    device = left_by("driven_dark_breather")
    wall = 0.2e-6 * np.cos(2 * np.pi * 7290 * np.asarray(device.dark.ts))[:, None]
    strain = np.abs(np.diff(np.concatenate([wall, device.u, -wall], 1), axis=1)).max(0)
    assert np.argmin(strain) in (10, 11) and strain.max() < 0.55e-6
