"""Experiments on driven chains, from rest."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import granjax as gx
from granjax import driven, studies


@pytest.mark.slow
def test_walls_that_push_together_make_a_dark_breather():
    chain = studies.steel_chain()
    found = studies.dark_by_interference(chain)
    assert float(chain.terms[0].law.stiffness) == pytest.approx(1.0114e10, rel=1e-4)
    assert found.attractor.multiple == 1 and found.highest_mode == pytest.approx(7350.3, abs=0.1)
    # the middle bead is at rest to 2e-8, its neighbours alternate, the ends stand at 0.89 of the largest speed
    assert found.depth > 1 - 1e-6 and found.staggering < -0.99
    assert found.background == pytest.approx(0.01111, rel=1e-3) and found.width == pytest.approx(3.678, abs=0.01)
    assert found.velocity[0] > 0.88 * found.velocity.max()
    # one frequency: what lies at its multiples is below half a percent
    assert found.harmonics[1:].max() == pytest.approx(4.8e-3 * found.harmonics[0].max(), rel=0.05)
    assert np.argmin(found.strain) in (10, 11) and found.strain.max() < 0.55e-6
    # a tenth of the drive makes the arches of a sine, which end at 0.38 of the largest
    linear = studies.dark_by_interference(chain, amplitude=0.02e-6)
    assert linear.velocity[0] == pytest.approx(0.380 * linear.velocity.max(), rel=0.01)


@pytest.mark.slow
def test_walls_that_move_the_same_way_make_an_antinode():
    found = studies.dark_by_interference(phase=0.0, amplitude=0.05e-6)
    assert found.attractor.multiple == 1 and found.depth == pytest.approx(-0.455, abs=0.01) and found.width == 0


@pytest.mark.study
def test_a_shaken_dimer_leaves_a_bright_breather_in_the_gap():
    found = studies.bright_by_instability()
    assert found.localised, found.outcome
    assert found.least_fraction > 0.5 and found.gap[0] < found.frequency < 0.99 * found.gap[1]
    # not while the drive is on: the wave fills the chain first
    assert found.fraction[found.driven_for // 2 : found.driven_for].min() < 0.4


@pytest.mark.study
def test_a_defect_beside_the_driver_rectifies():
    amplitudes = np.linspace(0.05e-6, 0.35e-6, 7)
    found = studies.rectifier(amplitudes)
    assert found.cutoff < found.frequency < found.defect
    # from the defect's side the motion ceases to be periodic at 0.177 um (at 0.175 it settles after 7165 periods, and
    # from their numbers at 0.155 ... 0.17 the rate vanishes at 0.178), from the other it always is
    assert found.threshold_near == pytest.approx(0.177e-6, rel=0.02) and found.threshold_far == np.inf
    assert (found.far.up.multiple == 1).all()
    # milliwatts against femtowatts
    assert found.near.up.response[-2:].min() > 1e-4 and found.far.up.response.max() < 1e-13
    # of a motion that does not repeat the mean over 60 periods changes by a part of it, which leaves a bound below
    assert 0 < found.asymmetry_error[-1] < np.inf
    assert np.nanmax(found.asymmetry - found.asymmetry_error) > 1e11
    assert found.outcome.startswith("From the defect's side up to at least ") and "at all amplitudes" in found.outcome
    last = jax.tree.map(lambda x: jnp.asarray(x[-1]), found.near.up.states)
    omega, radii = 2 * np.pi * found.frequency, np.full(20, 9.53e-3)
    radii[1] = 7e-3
    chain = gx.scenes.beads("steel 316", radii, 8.0)
    lattice = driven.driven_chain(chain, amplitudes[-1], omega, ends="left", damping=1 / 1.75e-3)
    # that is where a pair of multipliers leaves the unit circle: two methods that share nothing but the forces
    branch = studies.rectifier_branch(0.16e-6, 0.19e-6, transient=600, arclength=0.5)
    (onset,) = branch.bifurcations
    assert onset.kind == "Neimark-Sacker" and onset.p == pytest.approx(0.17919e-6, rel=1e-4)
    assert found.threshold_near == pytest.approx(onset.p, rel=0.02) and branch.verdict[0] == "stable"
    assert driven.lyapunov(lattice, last, 2 * np.pi / omega, periods=1000).chaotic
