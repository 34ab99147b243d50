"""Numbers of the literature and closed forms, through `simulate`."""

import jax
import numpy as np
import pytest

import granjax as gx

FORCES = gx.Peak(lambda t, y, lattice: gx.measures.contact_force(lattice, y))


@pytest.mark.slow
def test_dimer_contact_forces():
    # converged: SRKN11b, RKN 8(6) and scipy's DOP853 at 1e-12 agree on these to 1e-8. A published table has 0.301903
    # at contact 20, which is 1.8e-6 below; 0.257407 and 0.230943 at 40 and 60 agree to its last digit
    chain = gx.scenes.dimer(101, ratio=0.5)
    run = gx.simulate(chain, gx.states.impact(chain), 90.0, step=0.02, record={"peak": FORCES})
    peak = np.asarray(run.recorded["peak"])[[21, 41, 61]]
    assert np.max(np.abs(peak - [0.30190477, 0.25740781, 0.23094347])) < 2e-8


@pytest.mark.slow
def test_the_energy_of_the_first_fput_mode_comes_back():
    # a = 1; first recurrence t = 9376.5 (E1/H = 0.9813), minimum 0.0882 at t = 6275.5
    chain = gx.scenes.fput(31, alpha=0.25)
    times = np.arange(0.0, 10000.25, 0.25)
    mode = np.sin(np.pi * np.arange(1, 32) / 32)
    run = gx.simulate(chain, gx.State(mode, 0 * mode), 10000.0, step=0.125, save_at=len(times))
    a = run.us @ mode / 4
    b = run.vs @ mode / 4
    energy = np.asarray(b * b + 4 * np.sin(np.pi / 64) ** 2 * a * a) / 2
    assert abs(energy[0] - 0.0770443732448498) < 1e-14
    share = energy / energy[0]
    late = np.argmax(np.where(times > 8000, share, 0))
    for i, time, value in ((late, 9376.5, 0.9813), (np.argmin(share), 6275.5, 0.0882)):
        assert abs(times[i] - time) <= 0.5 and abs(share[i] - value) < 1e-4


@pytest.mark.slow
def test_a_rigid_wall_reflects_like_a_mirror_pulse():
    # a bead on a rigid plane meets its mirror image: the contact with the plane has half the overlap of the pair's,
    # and so 2^{3/2} times the coefficient
    half = 12
    bond = gx.Bond(gx.Shift(1, "free"), gx.Hertz(1.0, 0.3))
    mirror = gx.Lattice(1.0, bond, sites=2 * half)
    walled = gx.Lattice(1.0, (bond, gx.Wall(gx.Hertz(2**1.5, 0.3), side="right")), sites=half)
    v = np.zeros(2 * half)
    v[0], v[-1] = 1.0, -1.0
    both, one = (
        gx.simulate(chain, gx.State(0 * v, v), 30.0, step=0.02, save_at=20)
        for chain, v in ((mirror, v), (walled, v[:half]))
    )
    assert np.max(np.abs(both.us[:, :half] - one.us)) < 1e-10
    assert np.max(np.abs(both.vs[:, :half] - one.vs)) < 1e-10
    assert np.max(np.abs(both.us[:, ::-1] + both.us)) < 1e-10
    assert np.min(one.vs) < -0.5


@pytest.mark.slow
def test_the_energy_of_a_precompressed_chain_stays_in_a_band():
    # N = 128, A = d0 = m = 1, displacements uniform in +-0.1, t = 1e5: a band, and no slope beyond it
    chain = gx.scenes.monomer(128, precompression=1.0)
    state = gx.states.random(chain, 0, displacement=0.1)
    run = gx.simulate(chain, state, 1e5, solver=gx.SRKN11b(), step=0.5, save_at=2001)
    assert not run.contact_opened
    energy = jax.vmap(lambda u, v: chain.energy(0.0, u, v))(run.us, run.vs)
    relative = np.asarray(energy / energy[0] - 1)
    assert np.max(np.abs(relative)) < 1e-6
    slope = np.polyfit(np.asarray(run.ts), relative, 1)[0]
    assert abs(slope) * 1e5 < np.ptp(relative)
