"""The reference orbits belong to the lattices of `known_orbits`, and their maker makes them."""

import jax.numpy as jnp
import numpy as np
import pytest
from known_orbits import LATTICES, reference
from numpy.testing import assert_allclose
from references import integrators, orbits

extended_only = pytest.mark.skipif(
    np.finfo(np.longdouble).precision < integrators.FEWEST_DIGITS,
    reason="numpy.longdouble has no more than 15 digits here",
)
SOUGHT = {orbit.name: orbit for orbit in orbits.orbits()}


@pytest.mark.parametrize("name", LATTICES)
def test_the_maker_s_forces_are_the_lattice_s(name):
    known = reference(name)
    scene = SOUGHT[name].scene
    rng = np.random.default_rng(0)
    for t, u, v in ((0.0, known.u, known.v), (0.3, *rng.normal(size=(2, len(known.u))))):
        y = (jnp.asarray(u), jnp.asarray(v))
        force = scene.acceleration
        assert_allclose(known.lattice.acceleration(t, *y), force(t, u, v), atol=1e-13)
        assert float(known.lattice.energy(t, *y)) == pytest.approx(scene.energy(t, u, v), rel=1e-13)
        du, dv = 1e-6 * rng.normal(size=(2, len(u)))
        change = (force(t, u + du, v + dv) - force(t, u - du, v - dv)) / 2
        found = scene.linearised(t, u, v, du[:, None], dv[:, None])
        assert_allclose(found[:, 0], change, atol=2e-11)


@pytest.mark.slow
@extended_only
@pytest.mark.parametrize("name", ["hard_pair", "forced_branch", "forced_opening"])
def test_the_cheapest_orbits_are_made_again(name):
    known = reference(name)
    made = orbits.made(SOUGHT[name])
    assert np.abs(made["u"] - known.u).max() < known.error
    assert np.abs(made["v"] - known.v).max() < 2 * known.error
    assert made["energy"] == pytest.approx(known.energy, abs=known.energy_error)
    assert made["opened"] == known.opened


def test_what_trials_said_of_them():
    assert reference("light_centred").energy == pytest.approx(2.341574, abs=1e-6)
    assert np.abs(reference("hard_pair").multipliers).max() == pytest.approx(1.260834, abs=1e-6)
