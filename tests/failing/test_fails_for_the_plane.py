"""The plane: prestress left out, a phase of vectors without a smooth gauge, unequal sites, a wave that spreads."""

import numpy as np
import pytest

import granjax as gx

K = np.array([2 * np.pi / 3, 4 * np.pi / 3])


def test_a_static_force_is_more_than_the_stiffness_that_it_gives():
    """The bands of contacts under load, by the stiffness of each alone: wrong by the transverse -F0/L."""
    F0 = 0.2
    stiffness = 1.5 * F0 ** (1 / 3)
    under, springs = (
        gx.scenes.triangular(6, 6, boundary="periodic", **own)
        for own in ({"exponent": 1.5, "precompression": F0}, {"stiffness": stiffness})
    )
    ours, naive = (np.asarray(gx.linear.dispersion(x, K).omega_squared) for x in (under, springs))
    assert np.abs(ours - 4.5 * (stiffness - F0)).max() < 1e-12
    assert (naive / ours - 1).min() > 0.25


def test_a_phase_of_vectors_that_are_taken_as_they_come():
    """A sum of -Im <q|dq> over vectors whose phases are arbitrary is no phase of the band."""
    chain = gx.scenes.ssh(8, 1.0, 2.0, boundary="periodic")
    cell, rng = gx.linear.unit_cell(chain), np.random.default_rng(3)
    k = 2 * np.pi * np.arange(64) / 64
    found = []
    for _ in range(3):
        q = [np.linalg.eigh(np.asarray(cell.dynamical_matrix(np.array([x]))))[1][:, 0] for x in k]
        q = np.array(q) * np.exp(2j * np.pi * rng.uniform(size=(64, 1)))
        slope = (np.roll(q, -1, 0) - np.roll(q, 1, 0)) / 2
        found.append(-np.imag((q.conj() * slope).sum()))
    assert np.ptp(found) > 0.1
    assert abs(abs(gx.topology.zak(chain).phase[0]) - np.pi) < 1e-10


@pytest.mark.slow
def test_a_compact_state_is_lost_where_sites_are_not_equal():
    equal, unequal = (gx.scenes.stub(12, ground=0.3, equal=x) for x in (True, False))
    start = gx.linear.flat_bands(equal).state(equal)
    kept, lost = (gx.simulate(x, start, 60.0, step=0.1) for x in (equal, unequal))

    def outside(run):
        return max(
            np.abs(np.asarray(u))[np.asarray(start.u[name]) == 0].max()
            for name, u in run.final.u.items()
        )

    assert outside(kept) < 1e-13 and outside(lost) > 1e-2


@pytest.mark.study
def test_what_travels_alone_in_a_chain_spreads_in_the_plane():
    """One bead is struck in a sonic vacuum: the chain's pulse keeps its speed, the hexagon's front decays."""
    chain = gx.simulate(
        gx.scenes.monomer(40), gx.states.impact(gx.scenes.monomer(40)), 40.0, save_at=801
    )
    peaks = np.abs(np.asarray(chain.vs)).max(0)[10:30]
    assert np.ptp(peaks) < 1e-3 * peaks.mean()
    crystal = gx.scenes.hexagon(8, exponent=1.5)
    middle = crystal.shape[0] // 2
    run = gx.simulate(crystal, gx.states.impact(crystal, [0.3, 0.0], site=middle), 25.0, save_at=51)
    x = np.asarray(crystal.positions) - np.asarray(crystal.positions)[middle]
    ahead = (x[:, 0] > 0.5) & (np.abs(x[:, 1]) < 0.1)
    order = np.argsort(x[ahead, 0])
    fastest = np.linalg.norm(np.asarray(run.vs), axis=-1).max(0)[ahead][order][:7]
    exponent = np.polyfit(np.log(np.arange(1, 8)), np.log(fastest), 1)[0]
    # along a row of beads, where it decays least
    assert exponent < -0.2
