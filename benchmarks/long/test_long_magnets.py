"""A driven light magnet in a chain of magnets; run by hand: pytest benchmarks/long."""

import numpy as np

import granjax as gx


def test_a_light_magnet_that_is_driven_carries_a_breather():
    chain = gx.scenes.magnets(11, -4.0, mass=np.where(np.arange(11) == 5, 0.4, 1.0))
    below, omega = map(float, gx.linear.normal_modes(chain).omega[-2:])
    terms = gx.Damping(0.02), gx.Drive(gx.Harmonic(0.004, 1.01 * omega), 5)
    driven = gx.Lattice(chain.mass, (*chain.terms, *terms))
    orbit = gx.forced.forced_orbit(driven, 2 * np.pi / (1.01 * omega), steps=48)
    v = np.abs(np.asarray(orbit.run(8).vs)).max(0)
    assert below < 0.85 * omega and orbit.floquet().verdict == "stable"
    # each magnet moves by less than a third of the one before, to the ends
    assert (v[1:6] > 3 * v[:5]).all() and float(np.max(orbit.error.state.u)) < 1e-6 * v[5]
