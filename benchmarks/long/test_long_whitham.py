"""Shocks of the lattice that come to Whitham's equations like 1/t; run by hand: pytest benchmarks/long."""

import numpy as np
from numpy.testing import assert_allclose
from test_whitham import HERTZ

import granjax as gx


def test_what_is_measured_extrapolates_to_it():
    """Crests and windows of two runs: what they are off falls like 1/t."""
    found = gx.shocks.whitham(HERTZ, 0.5)
    seen = []
    for t in (1000.0, 2000.0):
        chain = gx.Lattice(1.0, gx.Bond(gx.Shift(1, "free"), HERTZ), sites=int(1.24 * t))
        seen.append(gx.shocks.measure(gx.shocks.piston(chain, 1.0).run(t)))
    early, late = seen
    limit = lambda name: 2 * getattr(late, name) - getattr(early, name)
    assert abs(limit("leading_speed") - found.leading_speed) < 1e-5
    assert abs(limit("amplitude") - found.amplitude) < 3e-4
    assert abs(late.mean - found.mean) < 1e-6
    heights = found.crests - found.troughs
    off = [np.abs(x.amplitudes - np.interp(x.s, found.s, heights))[2:-1] for x in seen]
    assert off[1].max() < 0.01 * heights.max() and off[1].mean() < 0.6 * off[0].mean()
    # the trailing edge moves with the group velocity of linear waves on the plateau; fitting is near it
    k = np.polyfit(late.amplitudes[1:6], 2 * np.pi / late.wavelengths[1:6], 2)[-1]
    group = (2 * (0.5 + found.mean)) ** 0.25 * np.cos(k / 2)
    edges = gx.theory.shock_edges(HERTZ, 0.5)
    assert_allclose(late.leading_speed, edges.leading_speed, rtol=0.01)
    assert abs(late.trailing_speed - group) < 0.01
    assert abs(late.trailing_speed - edges.trailing_speed) < 0.08
