"""A step in the strain as a ramp in the displacements: its rounding grows with the length of the chain."""

import numpy as np
import pytest

import granjax as gx

LEFT = 0.3
RIGHT = 0.1


def both(sites, dtype):
    """The step as a ramp of a chain with free ends, and held in the law, with the strain of each at u."""
    chain = gx.scenes.toda(sites, boundary="free").astype(dtype)
    held = gx.shocks.step(chain, LEFT, RIGHT)
    ramp = gx.states.strain_step(chain, LEFT, RIGHT)
    return (chain, ramp, lambda u: u[:-1] - u[1:]), (*held, held.strain)


@pytest.mark.slow
def test_a_ramp_loses_the_strain_in_float32():
    """Twenty thousand sites: a ramp of height 3000 is rounded to 2e-4, a thousandth of the strain, everywhere."""
    sites = 20001
    ends = []
    for lattice, state, strain in both(sites, np.float32):
        final = gx.simulate(lattice, state, 10.0, step=0.125, solver=gx.SRKN6b()).final
        ends.append((np.asarray(strain(final.u), float), np.asarray(final.v, float)))
    (ramp, ramp_v), (held, held_v) = ends
    # far from the step, and from the loose ends of the ramp, nothing moves
    quiet = slice(100, sites // 2 - 100)
    assert not held_v[quiet].any() and np.ptp(held[quiet]) == 0
    assert np.abs(ramp_v[quiet]).max() > 1e-5
    inner = slice(sites // 4, 3 * sites // 4)
    assert 1e-4 < np.abs(ramp - held)[inner].max() < 1e-2


def test_a_ramp_loses_the_strain_at_a_million_sites():
    """Height 1.5e5: the strain is known to 1e-11 and sites that should rest are pushed, where held in the law not."""
    sites = 10**6
    far = np.r_[1000 : sites // 2 - 1, sites // 2 + 1 : sites - 1000]
    wanted = np.where(np.arange(sites - 1) < (sites - 1) // 2, LEFT, RIGHT)
    found = []
    for lattice, state, strain in both(sites, np.float64):
        pushed = np.abs(np.asarray(lattice.acceleration(0.0, *state)))
        assert pushed[1000:-1000].max() == pytest.approx(np.exp(LEFT) - np.exp(RIGHT), rel=1e-9)
        lost = np.abs(np.asarray(strain(state.u)) - wanted).max()
        found.append((lost, pushed[far].max()))
    assert all(1e-12 < x < 1e-10 for x in found[0]) and found[1] == (0, 0)
