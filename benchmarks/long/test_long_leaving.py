"""A doubled orbit that a run of 20 000 periods comes to; run by hand: pytest benchmarks/long."""

import numpy as np
import pytest

import granjax as gx
from granjax.driven import driven_chain
from granjax.forced import forced_branch, forced_orbit


def test_a_doubled_orbit_of_steel_beads_is_where_a_run_settles():
    # two beads of 9.5 mm between walls, precompressed, of which the left one shakes at 2.449 omega_0
    stiffness = 6.0e9
    mass = 3.6e-3
    load = 20.0
    d0 = (load / stiffness) ** (2 / 3)
    rate = np.sqrt(stiffness * np.sqrt(d0) / mass)
    chain = gx.scenes.monomer(2, mass=mass, stiffness=stiffness, precompression=load)
    make = lambda a: driven_chain(chain, a * d0, 2.449 * rate, ends="left", damping=0.05 * rate)
    T = 2 * np.pi / (2.449 * rate)
    branch = forced_branch(make, 0.1, 0.18, period=T)
    (event,) = branch.bifurcations
    assert event.kind == "period doubling" and event.p == pytest.approx(0.1628306, rel=1e-6)
    doubled = branch.switch(0, points=60, longest_arclength=0.5)
    assert branch.normal_form(0).criticality == "supercritical" and doubled.verdict[-1] == "stable"
    lattice = make(doubled.p[-1])
    u = doubled.states.u[-1]
    end = gx.Flow(60 * 20000)(gx.State(1.05 * u, doubled.states.v[-1]), 0.0, 20000 * T, lattice)
    later = gx.Flow(60)(end, 0.0, T, lattice)
    away = [np.abs(np.asarray(y.u) - u).max() / d0 for y in (end, later)]
    assert min(away) < 1e-7 < 1e-3 < max(away)
    twice = forced_orbit(lattice, 2 * T, end)
    assert np.abs(twice.state.u - end.u).max() < 1e-5 * np.abs(end.u).max()
    assert np.abs(twice.harmonics(1)[1]).max() > 0.01 * d0
