"""A result does not depend on the units in which a scene is written: forces, energies, frequencies and runs."""

import jax
import numpy as np
import pytest
from cases import ALL_LATTICES, SAME_LATTICES, random_like

import granjax as gx

# the first leaves every number as it is: both lattices are written by the library, and share one program
PLAIN, OTHER = gx.Units(), gx.Units(mass=3e-3, length=2e-6, time=5e-5)
PLACES = 1e-12


def same(there, here, unit):
    """`there` in units of this size is `here` in the plain ones: each array by its largest entry."""
    for a, b in zip(jax.tree.leaves(there), jax.tree.leaves(here), strict=True):
        b = np.asarray(b)
        scale = np.abs(b).max(initial=0)
        np.testing.assert_allclose(np.asarray(a) * float(unit), b, rtol=0, atol=PLACES * scale)


def cases():
    """Every kind of lattice; whole scenes in each run of the tests, kinds whose code another runs in a study."""
    fast = {"grid_scalar", "mass_in_mass"}
    for case in ALL_LATTICES:
        mark = pytest.mark.study if case.name in SAME_LATTICES else pytest.mark.slow
        yield pytest.param(case.lattice, id=case.name, marks=() if case.name in fast else mark)


@pytest.mark.parametrize("lattice", [*cases()])
def test_one_result_in_two_systems_of_units(lattice):
    state = gx.State(random_like(lattice.template(), 3), random_like(lattice.template(), 4))
    found = []
    for units in (PLAIN, OTHER):
        written, y = gx.scenes.scaled(lattice, units=units).lattice, units.state_from_si(state)
        run = gx.simulate(written, y, 2.0 / units.time, step=0.1 / units.time)
        assert run.completed
        still = lattice.conserves and not lattice.reads_time
        squared = gx.linear.normal_modes(written).omega_squared if still else ()
        force, energy = written.force(0.7 / units.time, *y), written.energy(0.7 / units.time, *y)
        found.append((force, energy, squared, run.final.u, run.final.v))
    sizes = OTHER.force, OTHER.energy, OTHER.time**-2, OTHER.length, OTHER.velocity
    for here, there, unit in zip(*found, sizes, strict=True):
        same(there, here, unit)
