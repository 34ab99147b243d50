"""The scenes of shocks against each other, closed forms and conservation."""

import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import Mirrored
from refusals import refused

import granjax as gx


def hertz(sites=161, F0=0.3, boundary="fixed"):
    return gx.scenes.monomer(sites, precompression=F0, boundary=boundary)


def polynomial(sites=160):
    """A law that softens: shocks are those of rarefaction."""
    return gx.scenes.fput(sites, alpha=-0.25)


def magnets(sites=160):
    return gx.Lattice(np.ones(sites), gx.Bond(gx.Shift(1, "free"), gx.PowerLaw(0.05, -4.0, 0.05)))


class Softer(gx.Law):
    """tanh e, a law of one's own."""

    rate: jax.Array

    def force(self, e):
        return jnp.tanh(self.rate * e)

    def energy(self, e):
        return jnp.log(jnp.cosh(self.rate * e)) / self.rate


def own(sites=160):
    return gx.Lattice(np.ones(sites), gx.Bond(gx.Shift(1, "free"), Softer(jnp.asarray(0.8))))


CHAINS = {
    "toda": lambda: gx.scenes.toda(161),
    "hertz": hertz,
    "vacuum": lambda: hertz(F0=0),
    "softening": polynomial,
    "magnets": magnets,
    "own": own,
}


FAST, SLOW = {("vacuum", -0.2)}, {("toda", 0.2), ("vacuum", 0.2), ("own", 0.2), ("softening", -0.2)}


def speed_of(case):
    return () if case in FAST else pytest.mark.slow if case in SLOW else pytest.mark.study


@pytest.mark.study
@pytest.mark.parametrize(
    "name, c",
    [pytest.param(name, c, marks=speed_of((name, c))) for name in CHAINS for c in (0.2, -0.2)],
)
def test_nothing_comes_from_the_ends(name, c):
    """Far states stay at rest, or translate, to rounding until `until()`, and the default step is not far too fine."""
    for problem in (
        gx.shocks.velocity_shock(CHAINS[name](), c),
        gx.shocks.step(CHAINS[name](), max(c, 0.0), max(-c, 0.0)),
    ):
        if name == "vacuum" and problem.kind == "velocity" and c < 0:
            assert problem.until() == np.inf
            with refused("t1: expected a time, got None. None is found here: nothing moves"):
                problem.run()
            continue
        run = problem.run()
        y = np.asarray(problem.strain(run.us))[0]
        size = abs(c)
        assert run.completed and run.energy_error < 1e-8
        assert np.abs(y[:3] - problem.strain(problem.state.u)[:3]).max() < 1e-11 * size
        assert np.abs(y[-3:] - problem.strain(problem.state.u)[-3:]).max() < 1e-11 * size
        assert np.abs(y - problem.strain(problem.state.u)).max() > 0.2 * size


@pytest.mark.study
@pytest.mark.parametrize(
    "name", ["toda", *(pytest.param(name, marks=pytest.mark.slow) for name in ("hertz", "own"))]
)
def test_a_step_is_the_ramp_without_the_ramp(name):
    chain, left, right = CHAINS[name](), 0.3, 0.05
    problem = gx.shocks.step(chain, left, right)
    run = problem.run(12.0, step=0.05)
    free = gx.shocks.velocity_shock(chain, 0.1).lattice
    ramp = gx.simulate(free, gx.states.strain_step(free, left, right), 12.0, step=0.05)
    inner = slice(50, -50)
    there = np.asarray(problem.strain(run.us))[0][inner]
    u = np.asarray(ramp.us)[0]
    assert np.abs(there - (u[:-1] - u[1:])[inner]).max() < 1e-13
    assert np.ptp(there) > 0.2


@pytest.mark.study
def test_a_piston_is_half_of_a_velocity_shock():
    """In the frame of the piston, for a chain that is precompressed and one whose contacts differ."""
    sites, c, t1 = 101, 0.15, 25.0
    stiffness = np.random.default_rng(0).uniform(0.9, 1.1, sites // 2)
    whole = gx.scenes.monomer(
        sites,
        stiffness=np.concatenate([stiffness[::-1], stiffness]),
        precompression=0.3,
        boundary="free",
    )
    half = gx.scenes.monomer(sites // 2, stiffness=np.append(stiffness, 1.0), precompression=0.3)
    for chains in ((gx.scenes.toda(sites), gx.scenes.toda(sites // 2)), (whole, half)):
        shock, piston = gx.shocks.velocity_shock(chains[0], c), gx.shocks.piston(chains[1], 2 * c)
        assert piston.c == c and piston.centre == -1.5
        u = np.asarray(shock.run(t1, step=0.1).us)[0]
        moved = np.asarray(piston.run(t1, step=0.1).us)[0] - 2 * c * t1
        assert u[sites // 2] == 0
        assert np.abs(moved - u[sites // 2 + 1 :]).max() < 1e-12


@pytest.mark.study
def test_the_binary_oscillation_of_toda():
    """From c = 1 on the strain behind the shock has period two: it oscillates between two values for ever.

    B. L. Holian, H. Flaschka, D. W. McLaughlin, Phys. Rev. A 24, 2595 (1981).
    """
    problem = gx.shocks.velocity_shock(gx.scenes.toda(400), 2.0, centre=199.5)
    run = problem.run(60.0, save_at=np.linspace(40.0, 60.0, 81))
    y = np.asarray(problem.strain(run.us))[:, 180:220]
    neighbours, second = np.diff(y, axis=1), y[:, 2:] - y[:, :-2]
    swing = np.ptp(y, axis=0)
    # every bond swings between the same two values, in antiphase with its neighbours, and no less towards the end
    assert swing.min() > 1.0 and np.ptp(swing) < 0.1 * swing.min()
    assert (
        np.abs(second).max() < 0.05 * swing.min() and np.abs(neighbours).max() > 0.9 * swing.min()
    )
    assert np.ptp(y[:41], axis=0).min() == pytest.approx(np.ptp(y[40:], axis=0).min(), rel=0.05)
    below = gx.shocks.velocity_shock(gx.scenes.toda(400), 0.5)
    y = np.asarray(below.strain(below.run(60.0, save_at=[59.0, 60.0]).us))[:, 190:210]
    assert np.abs(y - 2 * np.log(1.5)).max() < 0.2


@pytest.mark.slow
@pytest.mark.parametrize("exponent", [1.5, pytest.param(2.5, marks=pytest.mark.slow)])
def test_shocks_of_a_sonic_vacuum_are_one(exponent):
    """y -> c^{2/(p+1)}, t -> c^{(1-p)/(p+1)}, while rounding, which grows there, stays below."""

    def scaled(c):
        problem = gx.shocks.velocity_shock(gx.scenes.monomer(161, exponent=exponent), c)
        t1 = 25.0 * c ** ((1 - exponent) / (1 + exponent))
        assert t1 < problem.until()
        run = problem.run(t1)
        return np.asarray(problem.strain(run.us))[0] / c ** (2 / (exponent + 1)), int(
            run.stats["steps"]
        )

    one, other = scaled(0.05), scaled(0.7)
    assert other[1] == one[1] and one[0].max() > 0.5
    assert np.abs(other[0] - one[0]).max() < 1e-9 * one[0].max()


@pytest.mark.study
def test_the_mirrored_law_has_the_mirrored_shock():
    """Strains of the other sign: a shock of compression becomes one of rarefaction, to the last bit."""
    c = 0.2
    chains = [
        gx.Lattice(np.ones(80), gx.Bond(gx.Shift(1, "free"), law))
        for law in (gx.Toda(), Mirrored(gx.Toda()))
    ]
    for make, one, other in ((gx.shocks.velocity_shock, c, -c), (gx.shocks.step, 2 * c, -2 * c)):
        runs = [make(chain, x).run(15.0, step=0.1) for chain, x in zip(chains, (one, other))]
        assert np.array_equal(runs[0].us, -runs[1].us) and np.abs(runs[0].us).max() > c
    # and left becomes right where the chain is turned round
    left, right = (
        gx.shocks.step(chains[0], *y, centre=40).run(15.0, step=0.1)
        for y in ((0.4, 0.1), (0.1, 0.4))
    )
    turned = gx.shocks.step(chains[0], 0.4, 0.1, centre=39).run(15.0, step=0.1)
    assert np.abs(np.asarray(right.us)[0, ::-1] + np.asarray(turned.us)[0]).max() < 1e-13
    assert np.abs(np.asarray(left.us)).max() > 0.1


@pytest.mark.slow
def test_dashpots_and_rings():
    """Dashpots wash the front out, which `until` knows; a ring is cut, with one stiffness less."""
    dash = gx.Lattice(
        np.ones(60), (gx.Bond(gx.Shift(1, "free"), gx.Toda()), gx.Dashpot(gx.Shift(1, "free"), 0.5))
    )
    problem = gx.shocks.step(dash, 0.3)
    y = np.asarray(problem.strain(problem.run(tolerance=1e-9).us))[0]
    assert np.abs(y[:2] - 0.3).max() < 1e-12 and np.abs(y[-2:]).max() < 1e-12 and 0.1 < y[29] < 0.2
    assert problem.until() < gx.shocks.step(gx.scenes.toda(60), 0.3).until()
    ring = gx.scenes.monomer(
        40, stiffness=np.linspace(1, 2, 40), precompression=1.0, boundary="periodic"
    )
    cut = gx.shocks.velocity_shock(ring, 0.1).lattice.terms[0]
    assert np.array_equal(
        cut.law.stiffness, np.linspace(1, 2, 40)[:-1]
    ) and cut.strain_map.boundary == ("free",)


def mapped(problem, sites):
    """A map, its numbers checked against a run that saves all."""
    found = gx.shocks.space_time(problem, 20.0, 6, sites)
    wanted = np.asarray(problem.strain(problem.run(20.0, save_at=6).us))[:, found.bonds]
    assert np.abs(found.strain - wanted).max() < 1e-11 and np.ptp(wanted) > 0.2
    return found


@pytest.mark.study
def test_a_map_is_what_the_run_shows():
    problem = gx.shocks.step(hertz(101), 0.5, 0.1)
    found = mapped(problem, 20)
    assert np.array_equal(found.bonds, np.arange(0, 100, 5)) and np.array_equal(
        found.places, found.bonds - 49.5
    )
    data = found.to_xarray()
    assert data.strain.dims == ("time", "bond") and data.kind == "strain"
    with refused("sites: expected how many bonds"):
        gx.shocks.space_time(problem, 20.0, sites=[100])


@pytest.mark.study
def test_maps_of_a_piston_and_of_a_batch():
    assert mapped(gx.shocks.piston(hertz(101), 0.4), [0, 1, 99]).bonds.tolist() == [0, 1, 99]
    many = jax.vmap(lambda c: gx.shocks.velocity_shock(gx.scenes.toda(101), c), out_axes=-1)(
        jnp.asarray([0.1, 0.2])
    )
    found = mapped(many, 10)
    assert (
        found.strain.shape == (6, 10, 2)
        and found.energy_error.shape == (2,)
        and found.places.shape == (10, 2)
    )


MILLION = """
from pathlib import Path
import granjax as gx
chain = gx.scenes.monomer(10**6, precompression=1.0)
problem = gx.shocks.{problem}
assert gx.shocks.space_time(problem, 0.6, 3, 1000).strain.shape == (3, 1000)
# of this process alone: what it was started from does not count
told = Path("/proc/self/status").read_text()
print(int(told.split("VmHWM:")[1].split()[0]) / 1e6)
"""


@pytest.mark.study
@pytest.mark.parametrize(
    "problem",
    ["velocity_shock(chain, 0.3)", pytest.param("step(chain, 0.5, 0.1)", marks=pytest.mark.study)],
)
def test_a_million_sites_need_less_than_two_gigabytes(problem):
    script = MILLION.format(problem=problem)
    found = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    assert float(found.stdout) < 2


BATCHES = {
    "velocity": (gx.shocks.velocity_shock, [0.1, 0.2]),
    "step": (lambda chain, y: gx.shocks.step(chain, y, 0.1), [0.2, 0.4]),
    "piston": (gx.shocks.piston, [0.2, 0.4]),
}


@pytest.mark.slow
@pytest.mark.parametrize(
    "kind", ["velocity", *(pytest.param(k, marks=pytest.mark.slow) for k in ("step", "piston"))]
)
def test_a_batch_is_one_problem(kind):
    make, values = BATCHES[kind]
    chain = gx.scenes.toda(101)
    batch, one = (
        jax.vmap(lambda x: make(chain, x), out_axes=-1)(jnp.asarray(values)),
        make(chain, values[1]),
    )
    assert batch.until().shape == (2,) and batch.until()[1] == pytest.approx(
        float(one.until()), rel=1e-12
    )
    run, single = batch.run(20.0, step=0.1), one.run(20.0, step=0.1)
    assert batch.strain(run.us).shape == (1, 100, 2)
    assert np.abs(batch.strain(run.us)[..., 1] - one.strain(single.us)).max() < 1e-13
    if kind == "velocity":
        assert np.array_equal(make(batch.lattice, np.array(values)).state.v, batch.state.v)


@pytest.mark.slow
def test_a_step_differentiates():
    def middle(left):
        problem = gx.shocks.step(gx.scenes.toda(61), left)
        return problem.strain(gx.simulate(*problem, 10.0, step=0.1).us)[0, 30]

    near = 1e-5
    slope = float(middle(0.3 + near) - middle(0.3 - near)) / (2 * near)
    assert float(jax.grad(middle)(0.3)) == pytest.approx(slope, rel=1e-7)


def tied():
    """Every site on a spring of its own."""
    return gx.Lattice(
        np.ones(50), (gx.Bond(gx.Shift(1, "free"), gx.Toda()), gx.OnSite(gx.Linear(0.1)))
    )


REFUSED = (
    (
        lambda: gx.shocks.step(gx.scenes.toda(50), 0.1, 0.1),
        "left: expected another strain than right",
    ),
    (
        lambda: gx.shocks.velocity_shock(gx.scenes.toda(50), 0.1, centre=48.5),
        "centre: expected a place with two sites",
    ),
    (lambda: gx.shocks.step(tied(), 0.1), "lattice: expected a chain of bonds between"),
    (lambda: gx.shocks.velocity_shock(tied(), 0.1), "lattice: expected a chain whose halves"),
    (
        lambda: gx.shocks.step(gx.scenes.monomer(50, stiffness=np.linspace(1, 2, 51)), 0.1),
        "lattice: expected bonds th",
    ),
    (
        lambda: gx.shocks.step(magnets(50), 100.0),
        "left: expected a strain at which the law has a force",
    ),
    (
        lambda: gx.shocks.velocity_shock(
            gx.Lattice(np.ones(9), (gx.Bond(gx.Shift(1, "free"), gx.Toda()), gx.Damping(0.1))), 0.1
        ),
        "Damping.*, which acts on its ends",
    ),
)


@pytest.mark.parametrize("use, said", REFUSED, ids=[said[:40] for _, said in REFUSED])
def test_what_is_refused(use, said):
    with refused(said):
        use()
