"""The algebraic tail of a breather of magnets: by hand, pytest benchmarks/long."""

import numpy as np

import granjax as gx


def light_magnet(sites, mass=0.4):
    """A chain of dipoles with a light one in the middle; the frequency and shape of its mode."""
    chain = gx.scenes.magnets(sites, -4.0, mass=np.where(np.arange(sites) == sites // 2, mass, 1.0))
    modes = gx.linear.normal_modes(chain)
    return chain, float(modes.omega[-1]), modes


def test_a_breather_of_magnets_has_the_tail_of_their_stiffness():
    """A r^-4 has the stiffness 4 A r^-5; what does not oscillate, the stretch of the chain, falls more slowly."""
    chain, omega, _ = light_magnet(161)
    family = gx.breathers.family(chain, amplitude=0.02, steps=32, stability=False)
    v = np.abs(np.asarray(family.orbit(-1).run(8).vs)[2])
    n = np.arange(15, 50)
    assert abs(np.polyfit(np.log(n), np.log(v[80 + n]), 1)[0] + 5) < 0.05
    assert float(family.omega[-1]) < omega
