"""The rectifier of the gallery beyond the onset: a chaotic motion passes from one side alone.

Run by hand: pytest benchmarks/long
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from gallery import left_by

import granjax as gx

DAMPING = 1 / 1.75e-3


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
    later = []
    start = last
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
