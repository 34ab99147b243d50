"""The default step where energy is spread over many sites: short enough, and not much shorter."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import eigvalsh_tridiagonal

import granjax as gx
from granjax.flow.steps import STEP_FRACTION

pytestmark = pytest.mark.slow

N = 200
T1 = 40.0
TODA = gx.scenes.toda(N)
VACUUM = gx.scenes.monomer(N)
LOADED = gx.scenes.monomer(N, precompression=1.0, boundary="free")
SOFT = gx.scenes.monomer(N, exponent=0.5, precompression=1.0, boundary="free")
MAGNETS = gx.Lattice(np.ones(N), gx.Bond(gx.Shift(1, "free"), gx.PowerLaw(0.05, -4.0, 0.05)))


def highest_frequency(lattice, us):
    """The largest eigenfrequency of any frame, of a chain of equal beads, from the law alone."""
    bonds = lattice.terms[0]
    law = bonds.law
    boundary = bonds.strain_map.boundary[0]
    pad = [(0, 0), (1, 1)]
    ends = np.pad(us, pad) if boundary == "fixed" else us
    k = np.asarray(law.derivative(jnp.asarray(ends[:, :-1] - ends[:, 1:])))
    k = k if boundary == "fixed" else np.pad(k, pad)
    return np.sqrt(max(eigvalsh_tridiagonal(row[:-1] + row[1:], -row[1:-1]).max() for row in k))


@pytest.mark.parametrize(
    ("lattice", "step"),
    [
        (TODA, lambda: gx.states.velocity_step(TODA, 2.0)),
        (TODA, lambda: gx.states.velocity_step(TODA, -0.3)),
        (LOADED, lambda: gx.states.strain_step(LOADED, 0.3)),
        (VACUUM, lambda: gx.states.velocity_step(VACUUM, 0.3)),
        (SOFT, lambda: gx.states.velocity_step(SOFT, 0.2)),
    ],
    ids=["Toda", "Toda rarefaction", "granular strain", "sonic vacuum", "softening"],
)
def test_a_shock_takes_at_most_three_times_the_steps_of_what_it_reaches(lattice, step):
    """h omega between 1/6 and 1/2 (and a tenth) with the frequencies of 41 frames; energy kept to 1e-8."""
    run = gx.simulate(lattice, step(), T1, save_at=41)
    h_omega = float(run.stats["step"]) * highest_frequency(lattice, np.asarray(run.us))
    assert STEP_FRACTION / 3 <= h_omega <= 1.1 * STEP_FRACTION
    assert float(run.stats["step"] * run.stats["omega"]) >= h_omega * (1 - 1e-9)
    assert float(run.energy_error) < 1e-8


def test_energy_that_a_drive_brings_is_noticed_and_the_run_taken_again():
    """A hard chain driven in its band takes up far more than a slow push of that force would store."""
    drive = gx.Drive(gx.Harmonic(2.0, 1.5), 10)
    lattice = gx.Lattice(1.0, (*gx.scenes.fput(20, 0.0, 1.0).terms, drive), sites=20)
    run = gx.simulate(lattice, gx.states.rest(lattice), 60.0, save_at=121)
    h_omega = float(run.stats["step"]) * highest_frequency(lattice, np.asarray(run.us))
    assert "taken again" in run.choice and h_omega <= 1.1 * STEP_FRACTION


@pytest.mark.parametrize(
    ("lattice", "make"),
    [
        (TODA, lambda: gx.shocks.velocity_shock(TODA, -2.0)),
        (TODA, lambda: gx.shocks.piston(TODA, 10.0)),
        (MAGNETS, lambda: gx.shocks.piston(MAGNETS, 2.0)),
        (LOADED, lambda: gx.shocks.step(LOADED, 0.6)),
    ],
    ids=["Toda parts", "Toda piston", "magnets piston", "granular held"],
)
def test_what_extends_only_is_not_taken_to_be_pressed_together(lattice, make):
    """Rarefactions, pistons and held steps: the same, until their waves come to an end of the chain."""
    problem = make()
    run = problem.run(save_at=41)
    us = np.asarray(run.us)
    y = np.asarray(problem.strain(us))
    if problem.kind == "piston":
        y = np.append(y, 2 * float(problem.c) * np.asarray(run.ts) - us[:, 0])
    reached = 2 * float(jnp.max(lattice.terms[0].law.derivative(jnp.asarray(y)))) ** 0.5
    assert STEP_FRACTION / 3 <= float(run.stats["step"]) * reached <= 1.1 * STEP_FRACTION


def test_what_extension_would_stiffen_does_not_shorten_the_steps_of_what_is_pressed():
    """F' = 1 - e + 0.3 e^2 falls where a piston presses from rest: nothing is faster than the beads ahead, at 2."""
    chain = gx.Lattice(np.ones(100), gx.Bond(gx.Shift(1, "free"), gx.Polynomial(1.0, -0.5, 0.1)))
    run = gx.shocks.piston(chain, 0.5).run(save_at=2)
    assert 0.95 * STEP_FRACTION <= 2 * float(run.stats["step"]) <= STEP_FRACTION
