"""The plane: prestress left out, a phase of vectors without a smooth gauge, unequal sites."""

import numpy as np
import pytest

import granjax as gx
from granjax import linear, scenes, topology

K = np.array([2 * np.pi / 3, 4 * np.pi / 3])


@pytest.mark.slow
def test_a_static_force_is_more_than_the_stiffness_that_it_gives():
    """The bands of contacts under load, by the stiffness of each alone: wrong by the transverse -F0/L."""
    F0 = 0.2
    stiffness = 1.5 * F0 ** (1 / 3)
    ours, naive = (
        linear.dispersion(scenes.triangular(6, 6, boundary="periodic", **own), K)
        for own in ({"exponent": 1.5, "precompression": F0}, {"stiffness": stiffness})
    )
    assert np.abs(ours.omega_squared - 4.5 * (stiffness - F0)).max() < 1e-12
    assert (naive.omega_squared / ours.omega_squared - 1).min() > 0.25


def test_a_phase_of_vectors_that_are_taken_as_they_come():
    """A sum of -Im <q|dq> over vectors whose phases are arbitrary is no phase of the band."""
    chain = scenes.ssh(8, 1.0, 2.0, boundary="periodic")
    cell = linear.unit_cell(chain)
    rng = np.random.default_rng(3)
    k = 2 * np.pi * np.arange(64) / 64
    D = np.array([cell.dynamical_matrix(np.array([x])) for x in k])
    found = []
    for _ in range(3):
        q = np.linalg.eigh(D)[1][..., 0] * np.exp(2j * np.pi * rng.uniform(size=(64, 1)))
        slope = (np.roll(q, -1, 0) - np.roll(q, 1, 0)) / 2
        found.append(-np.imag((q.conj() * slope).sum()))
    assert np.ptp(found) > 0.1
    assert abs(abs(topology.zak(chain).phase[0]) - np.pi) < 1e-10


@pytest.mark.slow
def test_a_compact_state_is_lost_where_sites_are_not_equal():
    equal, unequal = (scenes.stub(12, ground=0.3, equal=x) for x in (True, False))
    start = linear.flat_bands(equal).state(equal)

    def outside(chain):
        u = gx.simulate(chain, start, 60.0, step=0.1).final.u
        return max(np.abs(u[name])[np.equal(x, 0)].max() for name, x in start.u.items())

    assert outside(equal) < 1e-13 and outside(unequal) > 1e-2
