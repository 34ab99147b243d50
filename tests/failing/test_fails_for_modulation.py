"""Where steps fall in with a modulation: growth that is not seen."""

import numpy as np
import pytest

import granjax as gx


@pytest.mark.slow
def test_a_step_that_resonates_with_the_modulation_misses_the_growth():
    """Verlet by half periods of sin sees the mean stiffness alone, and a wave of the k-gap that never grows."""
    omega = 2 * np.sqrt(3.0)  # twice the frequency of k = 2 pi/3, all that moves in a ring of three
    period = 2 * np.pi / omega
    ring = gx.scenes.modulated(3, 0.2, omega, phase=-np.pi / 2)
    found = gx.linear.floquet_bands(ring, 2 * np.pi / 3, period)
    growth = np.abs(found.multipliers[0])
    assert growth > 1.15

    def naive(steps):
        _, monodromy = gx.Flow(steps, gx.VelocityVerlet()).derivative(
            gx.State(ring.zeros(), ring.zeros()), 0.0, period, ring
        )
        return np.abs(np.linalg.eigvals(np.asarray(monodromy))).max()

    # a stable step, of half a radian each way: on the unit circle but for the rounding of the double +1 of k = 0
    assert abs(naive(2) - 1) < 1e-6
    assert abs(naive(200) - growth) < 1e-3
    # of the same few steps ours see the modulation, and say how far they may be off
    few = gx.linear.floquet_bands(ring, 2 * np.pi / 3, period, steps=2)
    off = np.abs(few.multipliers[0]) - growth
    assert abs(off) < 0.01 and abs(off) <= few.error[0]
    run = gx.simulate(ring, found.state(ring), 10 * period)
    grown = np.linalg.norm(np.asarray(run.final.u)) / np.linalg.norm(
        np.asarray(found.state(ring).u)
    )
    assert abs(np.log(grown) / 10 - np.log(growth)) < 1e-6
