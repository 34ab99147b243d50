"""The scenes of shocks against each other, closed forms and conservation."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose
from refusals import refused

import granjax as gx
from granjax.shocks import piston, space_time, step, velocity_shock
from granjax.shocks.given import problem_of

pytestmark = pytest.mark.slow
CHAINS = {
    "toda": gx.scenes.toda(161),
    "vacuum": gx.scenes.monomer(161),
    # shocks of a law that softens are those of rarefaction
    "softening": gx.scenes.fput(160, alpha=-0.25),
}


def hertz(sites=161):
    return gx.scenes.monomer(sites, precompression=0.3)


def free(sites, *terms):
    return gx.Lattice(np.ones(sites), (gx.Bond(gx.Shift(1, "free"), gx.Toda()), *terms))


@pytest.mark.parametrize(
    "name, c", [("toda", 0.2), ("vacuum", 0.2), ("vacuum", -0.2), ("softening", -0.2)]
)
def test_nothing_comes_from_the_ends(name, c):
    """Far states stay at rest, or translate, to rounding until `until()`, and the default step is not far too fine."""
    chain = CHAINS[name]
    for problem in (velocity_shock(chain, c), step(chain, max(c, 0.0), max(-c, 0.0))):
        if name == "vacuum" and problem.kind == "velocity" and c < 0:
            assert problem.until() == np.inf
            with refused("t1: expected a time, got None. None is found here: nothing moves"):
                problem.run()
            continue
        run = problem.run()
        moved = np.asarray(problem.strain(run.us))[0] - problem.strain(problem.state.u)
        size = abs(c)
        assert run.completed and run.energy_error < 1e-8
        assert np.abs(np.concatenate([moved[:3], moved[-3:]])).max() < 1e-11 * size
        assert np.abs(moved).max() > 0.2 * size


def test_a_step_replaces_the_contacts_with_walls():
    """Those of beads of steel with steel walls are stiffer by 2^(1/2)."""
    beads = lambda ends: gx.scenes.beads("steel 316", 0.0095, 20.0, cells=20, boundary=ends)
    fixed, free = (gx.shocks.step(beads(ends), 2e-6, centre=9) for ends in ("fixed", "free"))
    force = np.asarray(fixed.lattice.force(0.0, *fixed.state))
    assert np.flatnonzero(force).tolist() == [9]
    np.testing.assert_array_equal(force, free.lattice.force(0.0, *free.state))


def test_a_step_is_the_ramp_without_the_ramp():
    chain = hertz()
    left = 0.3
    right = 0.05
    problem = step(chain, left, right)
    inner = slice(50, -50)
    there = np.asarray(problem.strain(problem.run(12.0, step=0.05).us))[0][inner]
    loose = velocity_shock(chain, 0.1).lattice
    ramp = gx.simulate(loose, gx.states.strain_step(loose, left, right), 12.0, step=0.05)
    assert np.abs(there + np.diff(ramp.final.u)[inner]).max() < 1e-13 and np.ptp(there) > 0.2


def test_a_piston_is_half_of_a_velocity_shock():
    """In the frame of the piston, for a chain that is precompressed and whose contacts differ."""
    sites = 61
    c = 0.15
    t1 = 12.0
    stiffness = np.random.default_rng(0).uniform(0.9, 1.1, sites // 2)
    both = np.concatenate([stiffness[::-1], stiffness])
    one = np.append(stiffness, 1.0)
    how = dict(precompression=0.3)
    shock = velocity_shock(gx.scenes.monomer(sites, stiffness=both, boundary="free", **how), c)
    pushed = piston(gx.scenes.monomer(sites // 2, stiffness=one, **how), 2 * c)
    assert pushed.c == c and pushed.centre == -1.5
    u = np.asarray(shock.run(t1, step=0.1).final.u)
    moved = np.asarray(pushed.run(t1, step=0.1).final.u) - 2 * c * t1
    assert u[sites // 2] == 0 and np.abs(moved - u[sites // 2 + 1 :]).max() < 1e-12


def test_the_binary_oscillation_of_toda():
    """From c = 1 on the strain behind the shock has period two: it oscillates between two values for ever.

    B. L. Holian, H. Flaschka, D. W. McLaughlin, Phys. Rev. A 24, 2595 (1981).
    """
    problem = velocity_shock(gx.scenes.toda(400), 2.0, centre=199.5)
    run = problem.run(60.0, save_at=np.linspace(40.0, 60.0, 81))
    y = np.asarray(problem.strain(run.us))[:, 180:220]
    swing = np.ptp(y, axis=0)
    second = y[:, 2:] - y[:, :-2]
    least = swing.min()
    # every bond swings between the same two values, in antiphase with its neighbours, and no less towards the end
    assert least > 1.0 and np.ptp(swing) < 0.1 * least and np.abs(second).max() < 0.05 * least
    assert np.abs(np.diff(y, axis=1)).max() > 0.9 * least
    early, late = (np.ptp(half, axis=0).min() for half in (y[:41], y[40:]))
    assert abs(early / late - 1) < 0.05


def test_shocks_of_a_sonic_vacuum_are_one():
    """y -> c^{2/(p+1)}, t -> c^{(1-p)/(p+1)}, while rounding, which grows there, stays below."""
    exponent = 2.5
    found = []
    steps = []
    for c in (0.05, 0.7):
        problem = velocity_shock(gx.scenes.monomer(161, exponent=exponent), c)
        t1 = 25.0 * c ** ((1 - exponent) / (1 + exponent))
        assert t1 < problem.until()
        run = problem.run(t1)
        found.append(np.asarray(problem.strain(run.us))[0] / c ** (2 / (exponent + 1)))
        steps.append(int(run.stats["steps"]))
    assert steps[0] == steps[1] and found[0].max() > 0.5
    assert np.abs(found[1] - found[0]).max() < 1e-9 * found[0].max()


def test_left_becomes_right_where_the_chain_is_turned_round():
    right, turned = (
        np.asarray(step(free(80), *y, centre=n).run(15.0, step=0.1).final.u)
        for y, n in (((0.1, 0.4), 40), ((0.4, 0.1), 39))
    )
    assert np.abs(right[::-1] + turned).max() < 1e-13 and np.abs(right).max() > 0.1


def test_dashpots_and_rings():
    """Dashpots wash the front out, which `until` knows; a ring is cut, with one stiffness less."""
    alone = step(gx.scenes.toda(60), 0.3).until()
    for damping, least in ((0.5, 0.1), (2.0, 0.01)):
        problem = step(free(60, gx.Dashpot(gx.Shift(1, "free"), damping)), 0.3)
        y = np.asarray(problem.strain(problem.run(tolerance=1e-9).us))[0]
        assert np.abs(y[:2] - 0.3).max() < 1e-12 and np.abs(y[-2:]).max() < 1e-12
        assert least < y[29] < 0.2 and problem.until() < alone
    stiffness = np.linspace(1, 2, 40)
    ring = gx.scenes.monomer(40, stiffness=stiffness, precompression=1.0, boundary="periodic")
    cut = velocity_shock(ring, 0.1).lattice.terms[0]
    assert np.array_equal(cut.law.stiffness, stiffness[:-1])
    assert cut.strain_map.boundary == ("free",)


def test_the_stiffest_of_bonds_that_differ_sets_the_time_to_the_ends():
    times = [
        velocity_shock(
            gx.Lattice(1.0, gx.Bond(gx.Shift(1, "free"), gx.Linear(stiffness)), sites=60), 0.1
        ).until()
        for stiffness in (np.where(np.arange(59) % 2, 1.0, 4.0), 4.0)
    ]
    assert times[0] == times[1] > 0


@pytest.mark.parametrize(("left", "right"), [(0.6, 0.0), (0.1, 0.6)])
def test_a_step_is_recognised_in_the_displacements(left, right):
    chain = gx.scenes.toda(60)
    problem = step(chain, left, right, centre=28)
    u = -np.append(0.0, np.cumsum(np.where(np.arange(59) < 28, left, right)))
    seen = problem_of(gx.simulate(chain, gx.State(u, np.zeros(60)), 1.0), None)
    assert seen.kind == "strain" and seen.centre == problem.centre
    assert seen.c == pytest.approx(float(problem.c), rel=1e-12)
    assert_allclose(seen.strain(seen.state.u), problem.strain(problem.state.u), atol=1e-14)
    # so are halves that collide, about a site that rests or between two
    for centre in 28, 28.5, 29:
        problem = velocity_shock(chain, left, centre=centre)
        seen = problem_of(gx.simulate(problem.lattice, problem.state, 1.0), None)
        assert (seen.kind, seen.centre, seen.c) == ("velocity", problem.centre, left)


def mapped(problem, sites):
    """A map, its numbers checked against a run that saves all."""
    found = space_time(problem, 10.0, 4, sites)
    wanted = np.asarray(problem.strain(problem.run(10.0, save_at=4).us))[:, found.bonds]
    assert np.abs(found.strain - wanted).max() < 1e-11 and np.ptp(wanted) > 0.2
    return found


def test_a_map_loses_the_energy_that_the_run_loses():
    # steps so long that the error is far above rounding
    problem = velocity_shock(hertz(61), -0.2)
    run = problem.run(10.0, step=0.5, save_at=4)
    found = space_time(problem, 10.0, 4, step=0.5)
    assert found.energy_error == pytest.approx(float(run.energy_error), rel=1e-6)
    assert run.energy_error > 1e-7
    assert found.to_xarray().attrs["c_units"] in ("m/s", "scaled")


def test_a_map_is_what_the_run_shows():
    problem = step(hertz(61), 0.5, 0.1)
    found = mapped(problem, 20)
    assert np.array_equal(found.bonds, np.arange(0, 60, 3))
    assert np.array_equal(found.places, found.bonds - 29.5)
    data = found.to_xarray()
    assert data.strain.dims == ("time", "bond") and data.kind == "strain"
    with refused("sites: expected how many bonds"):
        space_time(problem, 20.0, sites=[60])
    with refused("sites: expected how many bonds"):
        space_time(problem, 20.0, sites=[1.7])
    with refused("sites: expected a whole number not below 1"):
        space_time(problem, 20.0, sites=0)
    with refused("frames: expected a whole number not below 2"):
        space_time(problem, 20.0, frames=1)
    pistons = jax.vmap(lambda v: piston(gx.scenes.toda(61), v), out_axes=-1)(jnp.array([0.4, 0.6]))
    found = mapped(pistons, [0, 1, 59])
    assert found.bonds.tolist() == [0, 1, 59] and found.strain.shape == (4, 3, 2)
    assert found.energy_error.shape == (2,) and found.places.shape == (3, 2)


@pytest.mark.parametrize("make", [velocity_shock, step, piston])
def test_a_batch_is_one_problem(make):
    values = np.array([0.2, 0.4])
    chain = gx.scenes.toda(61)
    batch = jax.vmap(lambda x: make(chain, x), out_axes=-1)(jnp.asarray(values))
    one = make(chain, values[1])
    assert batch.until().shape == (2,)
    assert batch.until()[1] == pytest.approx(float(one.until()), rel=1e-12)
    strains, single = (problem.strain(problem.run(10.0, step=0.1).us) for problem in (batch, one))
    assert strains.shape == (1, 60, 2) and np.abs(strains[..., 1] - single).max() < 1e-13
    if make is velocity_shock:
        assert np.array_equal(make(batch.lattice, values).state.v, batch.state.v)


def test_a_step_differentiates():
    def middle(left):
        problem = step(gx.scenes.toda(61), left)
        return problem.strain(gx.simulate(*problem, 10.0, step=0.1).us)[0, 30]

    near = 1e-5
    slope = float(middle(0.3 + near) - middle(0.3 - near)) / (2 * near)
    assert float(jax.grad(middle)(0.3)) == pytest.approx(slope, rel=1e-7)


TIED = gx.OnSite(gx.Linear(0.1))
MAGNETS = gx.PowerLaw(0.05, -4.0, 0.05)


@pytest.mark.parametrize(
    "use, said",
    [
        (lambda: step(free(50), 0.1, 0.1), "left: expected another strain than right"),
        (lambda: velocity_shock(free(50), 0.1, centre=48.5), "centre: expected a place with two"),
        (lambda: step(free(50, TIED), 0.1), "lattice: expected a chain of bonds between"),
        (lambda: velocity_shock(free(50, TIED), 0.1), "lattice: expected a chain whose halves"),
        (
            lambda: velocity_shock(free(9, gx.Damping(0.1)), 0.1),
            "Damping.*, which acts on its ends",
        ),
        (
            lambda: step(gx.scenes.monomer(50, stiffness=np.linspace(1, 2, 51)), 0.1),
            "lattice: expected bonds th",
        ),
        (
            lambda: step(gx.Lattice(1.0, gx.Bond(gx.Shift(1, "free"), MAGNETS), sites=50), 100.0),
            "left: expected a strain at which the law has a force",
        ),
    ],
)
def test_chains_without_such_a_shock_are_refused(use, said):
    with refused(said):
        use()
