"""The reference orbits belong to the lattices of `known_orbits`, and their maker makes them."""

import jax.numpy as jnp
import numpy as np
import pytest
from known_orbits import LATTICES, reference
from references import integrators, orbits

extended_only = pytest.mark.skipif(
    np.finfo(np.longdouble).precision < integrators.FEWEST_DIGITS,
    reason="numpy.longdouble has no more than 15 digits here",
)
SOUGHT = {orbit.name: orbit for orbit in orbits.orbits()}


@pytest.mark.parametrize("name", LATTICES)
def test_the_maker_s_forces_are_the_lattice_s(name):
    known, scene = reference(name), SOUGHT[name].scene
    rng = np.random.default_rng(0)
    for t, u, v in ((0.0, known.u, known.v), (0.3, *rng.normal(size=(2, len(known.u))))):
        y = jnp.asarray(u), jnp.asarray(v)
        np.testing.assert_allclose(
            known.lattice.acceleration(t, *y), scene.acceleration(t, u, v), atol=1e-13
        )
        assert float(known.lattice.energy(t, *y)) == pytest.approx(scene.energy(t, u, v), rel=1e-13)
        step = 1e-6 * rng.normal(size=(2, len(u), 1))
        ahead, behind = (
            scene.acceleration(t, u + s * step[0][:, 0], v + s * step[1][:, 0]) for s in (1, -1)
        )
        np.testing.assert_allclose(
            scene.linearised(t, u, v, *step)[:, 0], (ahead - behind) / 2, atol=2e-11
        )


@extended_only
@pytest.mark.parametrize("name", ["hard_pair", "forced_branch", "forced_opening"])
def test_the_cheapest_orbits_are_made_again(name):
    known, made = reference(name), orbits.made(SOUGHT[name])
    assert (
        np.abs(made["u"] - known.u).max() < known.error
        and np.abs(made["v"] - known.v).max() < 2 * known.error
    )
    assert made["energy"] == pytest.approx(known.energy, abs=known.energy_error)
    assert made["opened"] == known.opened


def test_what_trials_said_of_them():
    assert reference("light_centred").energy == pytest.approx(2.341574, abs=1e-6)
    assert np.abs(reference("hard_pair").multipliers).max() == pytest.approx(1.260834, abs=1e-6)
