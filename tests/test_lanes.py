"""Batches: lanes of an adaptive run by steps of their own, lanes of a fixed step some at a time; each as if alone."""

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose
from refusals import refused

import granjax as gx
from granjax.flow import march as marching
from granjax.strains import Shift

slow = pytest.mark.slow

SITES = 6
END = 6.0
HOW = {"tolerance": 1e-8}
RATIOS = np.random.default_rng(3).uniform(0.2, 1.0, 5)
TIMES = jnp.array([1.0, 2.5, END])


def dimer(ratio):
    return gx.scenes.dimer(SITES, ratio=ratio)


def batch(make, values):
    lattice = jax.vmap(make, out_axes=-1)(jnp.asarray(values))
    return lattice, gx.states.impact(lattice)


def lane(tree, k):
    return jax.tree.map(lambda x: np.asarray(x)[(..., *np.atleast_1d(k))], tree)


def agree(run, k, lattice, *how, state=None, **more):
    """That lane k of a batch is the run of that lane alone, which is returned."""
    one = gx.simulate(lattice, gx.states.impact(lattice) if state is None else state, *how, **more)
    held = lambda r: (r.us, r.vs, r.final, r.recorded, r.stats, r.energy_error, r.code, r._margin)
    mine = lane(held(run), k)
    other = held(one)
    for x, y in zip(*map(jax.tree.leaves, (mine, other)), strict=True):
        assert_allclose(x, y, rtol=1e-12, atol=1e-13)
    np.testing.assert_array_equal(run.ts, one.ts)
    return one


# steps of their own ------------------------------------------------------------------------------------------------


def test_a_lane_that_is_not_a_number_is_not_called_soft():
    vacuum = lambda mass: gx.Lattice(mass, gx.Bond(Shift(1), gx.Hertz()), sites=3)
    with refused("lattice: expected finite parameters"):
        gx.simulate(*batch(vacuum, [1.0, np.nan]), END)


@slow
def test_each_lane_is_the_run_of_that_lane_with_its_records_and_errors(monkeypatch):
    """Contacts open and close in every dimer; three lanes in programs of two, which overlap."""
    monkeypatch.setattr(marching, "ABREAST", 2)

    def how(threshold):
        arrival = gx.Arrival(lambda t, y, lattice: y.v, threshold)
        return dict(save_at=TIMES, record={"arrival": arrival}, confirm=True, **HOW)

    scene = batch(dimer, RATIOS[:3])
    thresholds = np.linspace(0.05, 0.1, 3)
    run = gx.simulate(*scene, END, **how(thresholds))
    assert run.us.shape == (3, SITES, 3) and run.ts.shape == (3,)
    assert all(x.shape == (3,) for x in (run.code, *run.stats.values()))
    assert run.recorded["arrival"].shape == run.error.records["arrival"].shape == (SITES, 3)
    assert len(set(run.stats["steps"].tolist())) == 3 and "lane by lane" in repr(run)
    assert np.all(run.completed) and np.all(run.contact_opened) and np.max(run.energy_error) < 1e-6
    for k in (0, 2):
        one = agree(run, k, dimer(RATIOS[k]), END, **how(thresholds[k]))
        errors = run.error.records["arrival"][..., k], one.error.records["arrival"]
        assert_allclose(*errors, rtol=1e-6, atol=1e-6 * np.max(errors[1]))

    def pressed(run):
        raise KeyboardInterrupt

    monkeypatch.setattr(marching, "wait", pressed)
    with pytest.raises(KeyboardInterrupt, match="interrupted at lane 0 of 3"):
        gx.simulate(*scene, END, **HOW)


@slow
def test_lanes_that_take_long_go_one_by_one(monkeypatch):
    scene = batch(dimer, RATIOS)
    expected = gx.simulate(*scene, END, **HOW)
    monkeypatch.setattr(marching, "LONG", 1e-4)
    monkeypatch.setattr(marching, "EXPECTED", 1)
    run = gx.simulate(*scene, END, **HOW)
    # by pieces, each of which starts with a short step
    assert_allclose(run.final.u, expected.final.u, atol=1e-6)
    assert run.code.shape == (5,) and np.all(run.stats["steps"] >= expected.stats["steps"])


ONE = batch(dimer, RATIOS[:1])


@slow
def test_a_batch_of_one_float32_lane():
    alone = dimer(RATIOS[0])
    run, one = (
        gx.simulate(*jax.tree.map(lambda x: x.astype("float32"), scene), 1.0, tolerance=1e-4)
        for scene in (ONE, (alone, gx.states.impact(alone)))
    )
    assert run.final.u.shape == (SITES, 1) and run.final.u.dtype == np.float32
    eps = np.finfo(np.float32).eps
    assert_allclose(run.final.u[:, 0], one.final.u, rtol=0, atol=10 * eps)


@slow
def test_derivatives_are_those_of_each_lane():
    weights = jnp.linspace(1.0, 2.0, SITES)

    def end(lattice):
        return weights @ gx.simulate(lattice, gx.states.impact(lattice), 1.0, **HOW).final.u

    found = jax.jit(jax.jacfwd(lambda ratios: end(jax.vmap(dimer, out_axes=-1)(ratios))))
    one = jax.jit(jax.jacfwd(lambda ratio: end(dimer(ratio))))
    expected = np.diag([one(ratio) for ratio in RATIOS[:2]])
    assert_allclose(found(RATIOS[:2]), expected, rtol=1e-12, atol=1e-12)


class Pull(gx.Term):
    """A term of a user's own, with a parameter per lane or site and one that all share."""

    strength: jax.Array
    power: jax.Array

    def force(self, t, u, v, mass):
        return -self.strength * u * jnp.abs(u) ** self.power - 0.1 * jnp.tanh(v)

    def energy(self, t, u):
        return None


@slow
def test_lanes_in_some_of_the_leaves_two_axes_of_them_and_a_solver_that_is_not_ours():
    """Lanes (2, 3): masses have them, a term's strength one axis of them, the rest is shared."""
    mass = np.linspace(1.0, 2.0, 2 * 3 * SITES).reshape(SITES, 2, 3)
    pull = Pull(jnp.array(0.3), jnp.array(0.5))
    lattice = gx.Lattice(mass[:, 0, 0], (gx.Bond(Shift(1, "fixed"), gx.Hertz(1.0)), pull))
    parts = lambda x: (x.mass, x.terms[1].strength)
    strengths = jnp.array([0.1, 0.2, 0.3])
    some = eqx.tree_at(parts, lattice, (jnp.asarray(mass), strengths))
    how = dict(solver=diffrax.Tsit5(), tolerance=1e-7)
    run = gx.simulate(some, gx.states.impact(some), 3.0, **how)
    assert run.final.u.shape == (SITES, 2, 3) and run.code.shape == (2, 3)
    for i, j in ((0, 0), (1, 2)):
        one = eqx.tree_at(parts, lattice, (jnp.asarray(mass[:, i, j]), strengths[j]))
        agree(run, (i, j), one, 3.0, **how)


@slow
def test_a_batch_under_vmap_of_its_steps_has_an_outcome():
    batch = jax.vmap(lambda a: gx.scenes.fput(4, alpha=a), out_axes=-1)(jnp.array([-0.25, 0.1]))
    state = gx.states.impact(batch, velocity=0.1)
    run = lambda step: gx.simulate(batch, state, 5.0, step=step, max_steps=400)
    found = jax.vmap(run)(jnp.array([0.1, 0.05, 0.04]))
    assert found.completed.shape == (3, 2) and found.completed.all()
    assert found.outcome == "Completed at t = 5 after 125 steps." and found.outcome in repr(found)


@slow
def test_a_lane_that_fails_leaves_the_others():
    """The middle one runs out of its well to infinity; and lanes that may take no more steps."""

    def make(speed):
        bond = gx.Bond(Shift(1, "fixed"), gx.Polynomial(1.0, 0.0, -1.0))
        lattice = gx.Lattice(1.0, bond, sites=SITES)
        return lattice, gx.states.impact(lattice, velocity=speed)

    scene = jax.vmap(make, out_axes=-1)(jnp.array([0.01, 10.0, 0.02]))
    how = HOW | {"save_at": 3, "max_steps": 2000}
    run = gx.simulate(*scene, 2.0, throw=False, **how)
    assert run.completed.tolist() == [True, False, True] and run.stats["steps"][1] == 2000
    assert run.outcome.startswith("1 of 3 lanes did not complete. Lane 1: Stopped after 2000 steps")
    assert run.ts.tolist() == [0, 1, 2] and np.all(np.isfinite(run.us[..., [0, 2]]))
    assert np.all(np.isnan(run.us[1:, :, 1])) and np.all(np.isfinite(run.final.u))
    lattice, state = make(0.02)
    agree(run, 2, lattice, 2.0, state=state, **how)
    with pytest.raises(RuntimeError, match="Lane 1"):
        gx.simulate(*scene, 2.0, **how)


@slow
def test_what_holds_lanes_itself_is_refused():
    scene = batch(dimer, RATIOS[:3])
    held = jnp.array([1.0, 2.0, 3.0])
    first = lambda t, y, lattice: y.u[:, 0]
    for lanes, within in ((scene, lambda t, y, lattice: held * y.u), (scene, first), (ONE, first)):
        with refused(r"record\['x'\]: expected a quantity of a single lane"):
            gx.simulate(*lanes, 1.0, record={"x": gx.Peak(within)}, **HOW)
    lattice, state = scene
    with refused("save_at: expected times, where each lane has steps of its own"):
        gx.simulate(lattice, state, 1.0, save_at="steps", **HOW)

    class Held(gx.Term):
        def force(self, t, u, v, mass):
            return -held * u

    outer = eqx.tree_at(lambda x: x.terms, lattice, (*lattice.terms, Held()))
    with refused("lattice: expected terms that work on a single lane"):
        gx.simulate(outer, state, 1.0, **HOW)
    assert gx.simulate(outer, state, 0.1, step=0.1).final.u.shape == (SITES, 3)


# a fixed step, by groups of lanes ----------------------------------------------------------------------------------

# a program of its own each time: the same scene, and another bound on the steps
BOUNDS = {0: 900, 4: 901}


def damped(ratio, precompression=0.3, *terms):
    chain = gx.scenes.dimer(SITES, ratio=ratio, precompression=precompression, boundary="free")
    wall = gx.Wall(gx.Hertz(precompression=precompression), side="left")
    return gx.Lattice(chain.mass, (*chain.terms, gx.Damping(0.01), wall, *terms))


@pytest.fixture
def together_and_grouped(monkeypatch):
    """Two runs: of all lanes together, and of four lanes at a time."""

    def both(lattice, state, **how):
        monkeypatch.setattr("granjax.flow.lanes.FILLING", 1.0)
        for width, bound in BOUNDS.items():
            monkeypatch.setattr("granjax.flow.lanes.lanes_abreast", lambda: width)
            yield gx.simulate(lattice, state, 3.0, step=0.05, max_steps=bound, **how)

    return both


def eleven(make=damped, lanes=(11,)):
    ratios = jnp.linspace(0.3, 1.0, np.prod(lanes)).reshape(lanes)
    for _ in lanes:
        make = jax.vmap(make, out_axes=-1)
    lattice = make(ratios)
    u = jnp.asarray(np.random.default_rng(1).uniform(-0.2, 0.2, lattice.zeros().shape))
    return lattice, gx.State(u, 0.1 * u[::-1])


def assert_close(trees, atol=1e-14):
    for a, b in zip(*map(jax.tree.leaves, trees), strict=True):
        assert_allclose(a, b, rtol=1e-12, atol=atol)


@slow
@pytest.mark.parametrize(
    ("lanes", "how"),
    [
        ((3, 4), {"save_at": jnp.array([1.0, 2.2])}),
        ((11,), {"record": {"p": gx.Peak(lambda t, y, _: y.u - y.u.mean(-1, keepdims=True))}}),
    ],
    ids=["two axes", "a record from lane to lane"],
)
def test_groups_are_all_lanes_together(together_and_grouped, lanes, how):
    runs = list(together_and_grouped(*eleven(lanes=lanes), **how))
    assert_close(runs)
    assert runs[0].outcome == runs[1].outcome and runs[0].opening == runs[1].opening


@slow
def test_derivatives_of_groups_are_those_of_all_lanes_together(together_and_grouped):
    _, state = eleven()

    def ends(u, precompression):
        lattice, _ = eleven(lambda ratio: damped(ratio, precompression))
        return [run.final.u for run in together_and_grouped(lattice, gx.State(u, 0 * u))]

    at = state.u, 0.3
    forward = jax.jvp(ends, at, (state.v, 1.0))[1]
    assert_close(forward, 1e-12 * np.abs(forward[0]).max())
    pull = jax.vjp(ends, *at)[1]
    nothing = jnp.zeros_like(state.v)
    reverse = pull([state.v, nothing]), pull([nothing, state.v])
    assert_close(reverse, 1e-12 * max(np.abs(x).max() for x in reverse[0]))


@slow
def test_a_lane_that_fails_says_so_for_all(together_and_grouped):
    bond = gx.Bond(Shift(1, "fixed"), gx.PowerLaw(1.0, -3.0, 1.0))
    lattice, state = eleven(lambda mass: gx.Lattice(jnp.full(SITES, mass), bond))
    met = gx.State(state.u.at[2, 5].set(3.0), state.v)
    runs = list(together_and_grouped(lattice, met, throw=False))
    assert runs[0].outcome == runs[1].outcome
    assert "Magnets met in bond 3 of terms[0] near t = 0 of lane 5" in runs[0].outcome
    assert_allclose(runs[0].final.u, runs[1].final.u, rtol=1e-12)


class Mean(gx.Term):
    """A force towards the mean of all lanes: what no lane knows alone."""

    def force(self, t, u, v, mass):
        return 0.2 * (u.mean(-1, keepdims=True) - u)

    def energy(self, t, u):
        return jnp.zeros(u.shape[1:])


@slow
def test_terms_of_the_users_own_see_all_lanes(together_and_grouped):
    runs = together_and_grouped(*eleven(lambda ratio: damped(ratio, 0.3, Mean())))
    assert_close([run.final.u for run in runs])
