"""A result does not depend on the units in which a scene is written: forces, energies, frequencies and runs."""

import jax
import numpy as np
import pytest
from cases import ALL_LATTICES, SCENES, over, random_like
from numpy.testing import assert_allclose

import granjax as gx

# the first leaves every number as it is: both lattices are written by the library, and share one program
PLAIN = gx.Units()
OTHER = gx.Units(mass=3e-3, length=2e-6, time=5e-5)


@pytest.mark.slow
@over(ALL_LATTICES)
def test_one_result_in_two_systems_of_units(case):
    lattice = case.lattice
    state = gx.State(random_like(lattice.template(), 3), random_like(lattice.template(), 4))
    found = []
    for units in PLAIN, OTHER:
        written = gx.scenes.scaled(lattice, units=units).lattice
        y = units.state_from_si(state)
        still = lattice.conserves and not lattice.reads_time
        squared = gx.linear.normal_modes(written).omega_squared if still else ()
        force = written.force(0.7 / units.time, *y)
        energy = written.energy(0.7 / units.time, *y)
        # by equal steps a run follows from its forces
        if case in SCENES:
            run = gx.simulate(written, y, 2.0 / units.time, step=0.1 / units.time)
            assert run.completed
            y = run.final
        found.append((force, energy, squared, y.u, y.v))
    sizes = OTHER.force, OTHER.energy, OTHER.time**-2, OTHER.length, OTHER.velocity
    for here, there, unit in zip(*found, sizes, strict=True):
        for a, b in zip(jax.tree.leaves(there), jax.tree.leaves(here), strict=True):
            scale = np.abs(b).max(initial=0)
            assert_allclose(a * float(unit), b, rtol=0, atol=1e-12 * scale)
