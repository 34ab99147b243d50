"""Adaptive runs of batches: every lane by steps of its own, as in a call by itself."""

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from refusals import refused

import granjax as gx
from granjax.flow import march as marching
from granjax.measures import contact_force
from granjax.strains import Shift

SITES, END, HOW = 6, 6.0, {"tolerance": 1e-8}
RATIOS = np.random.default_rng(3).uniform(0.2, 1.0, 5)
TIMES = jnp.array([1.0, 2.5, END])


def dimer(ratio):
    return gx.scenes.dimer(SITES, ratio=ratio)


def batch(make, values):
    lattice = jax.vmap(make, out_axes=-1)(jnp.asarray(values))
    return lattice, gx.states.impact(lattice)


def record(threshold):
    return {
        "peak": gx.Peak(contact_force),
        "arrival": gx.Arrival(lambda t, y, lattice: y.v, threshold),
        "kinetic": gx.Integral(lambda lattice, y: lattice.kinetic_energy(y.v)),
        "low": gx.Lowest(contact_force),
    }


def lane(tree, k):
    return jax.tree.map(lambda x: np.asarray(x)[(..., *np.atleast_1d(k))], tree)


def agree(run, k, one, atol=1e-13):
    """That lane k of a batch is the run of that lane alone."""
    held = lambda r: (r.us, r.vs, r.final, r.recorded, r.stats, r.energy_error, r.code, r._margin)
    mine, other = lane(held(run), k), held(one)
    for x, y in zip(*map(jax.tree.leaves, (mine, other)), strict=True):
        np.testing.assert_allclose(x, y, rtol=1e-12, atol=atol)
    np.testing.assert_array_equal(run.ts, one.ts)


@pytest.mark.study
def test_records_and_their_errors_are_those_of_each_lane():
    lattice, state = batch(dimer, RATIOS)
    thresholds = np.linspace(0.05, 0.1, 5)
    run = gx.simulate(
        lattice, state, END, save_at=TIMES, record=record(thresholds), confirm=True, **HOW
    )
    assert run.recorded["peak"].shape == run.error.records["peak"].shape == (SITES + 1, 5)
    assert run.contact_opened.shape == (5,) and run.opening == "yes"
    for k in (0, 4):
        alone = dimer(RATIOS[k])
        one = gx.simulate(
            alone,
            gx.states.impact(alone),
            END,
            save_at=TIMES,
            record=record(thresholds[k]),
            confirm=True,
            **HOW,
        )
        agree(run, k, one)
        for name, error in one.error.records.items():
            np.testing.assert_allclose(
                run.error.records[name][..., k], error, rtol=1e-6, atol=1e-6 * np.max(error)
            )


@pytest.mark.slow
def test_each_lane_is_the_run_of_that_lane(monkeypatch):
    """Contacts open and close in every dimer; five lanes in programs of two, which overlap."""
    monkeypatch.setattr(marching, "ABREAST", 2)
    lattice, state = batch(dimer, RATIOS)
    kinetic = {"kinetic": record(0.0)["kinetic"]}
    run = gx.simulate(lattice, state, END, save_at=TIMES, record=kinetic, **HOW)
    assert run.us.shape == (3, SITES, 5) and run.ts.shape == (3,) and run.code.shape == (5,)
    assert run.recorded["kinetic"].shape == (5,)
    assert (
        all(x.shape == (5,) for x in run.stats.values())
        and len(set(run.stats["steps"].tolist())) > 3
    )
    assert np.all(run.completed) and np.all(run.contact_opened) and np.max(run.energy_error) < 1e-6
    assert "lane by lane" in repr(run)
    for k in (0, 3, 4):
        alone = dimer(RATIOS[k])
        agree(
            run,
            k,
            gx.simulate(alone, gx.states.impact(alone), END, save_at=TIMES, record=kinetic, **HOW),
        )

    def pressed(run):
        raise KeyboardInterrupt

    monkeypatch.setattr(marching, "wait", pressed)
    with pytest.raises(KeyboardInterrupt, match="interrupted at lane 0 of 5"):
        gx.simulate(lattice, state, END, save_at=TIMES, record=kinetic, **HOW)


@pytest.mark.study
def test_lanes_that_take_long_go_one_by_one(monkeypatch):
    lattice, state = batch(dimer, RATIOS)
    expected = gx.simulate(lattice, state, END, **HOW)
    monkeypatch.setattr(marching, "LONG", 1e-4)
    monkeypatch.setattr(marching, "EXPECTED", 1)
    run = gx.simulate(lattice, state, END, **HOW)
    # by pieces, each of which starts with a short step
    np.testing.assert_allclose(run.final.u, expected.final.u, atol=1e-6)
    assert run.code.shape == (5,) and np.all(run.stats["steps"] >= expected.stats["steps"])


@pytest.mark.parametrize("dtype", [float, jnp.float32])
def test_a_batch_of_one_and_what_it_refuses(dtype):
    """One lane goes by itself, and so does nothing else than lanes among others."""
    lattice, state = jax.tree.map(lambda x: x.astype(dtype), batch(dimer, RATIOS[:1]))
    alone, start = jax.tree.map(
        lambda x: x.astype(dtype), (dimer(RATIOS[0]), gx.states.impact(dimer(RATIOS[0])))
    )
    run, one = (
        gx.simulate(lattice, state, 1.0, tolerance=1e-4),
        gx.simulate(alone, start, 1.0, tolerance=1e-4),
    )
    assert run.final.u.shape == (SITES, 1) and run.final.u.dtype == lattice.dtype == dtype
    np.testing.assert_allclose(
        run.final.u[:, 0], one.final.u, rtol=0, atol=10 * np.finfo(dtype).eps
    )
    for within in (lambda t, y, lattice: y.u[:, 0], lambda t, y, lattice: y.u.sum(-1)):
        with refused(r"record\['x'\]: expected a quantity of each lane"):
            gx.simulate(lattice, state, 1.0, record={"x": gx.Peak(within)}, tolerance=1e-4)


@pytest.mark.study
@pytest.mark.parametrize("mode", [jax.jacfwd, jax.jacrev])
def test_derivatives_are_those_of_each_lane(mode):
    ratios, weights = jnp.asarray(RATIOS[:3]), jnp.linspace(1.0, 2.0, SITES)

    def end(lattice):
        run = gx.simulate(lattice, gx.states.impact(lattice), END, **HOW)
        return weights @ run.final.u

    found = jax.jit(mode(lambda ratios: end(jax.vmap(dimer, out_axes=-1)(ratios))))(ratios)
    one = jax.jit(mode(lambda ratio: end(dimer(ratio))))
    np.testing.assert_allclose(
        found, np.diag([one(ratio) for ratio in ratios]), rtol=1e-12, atol=1e-12
    )


class Pull(gx.terms.Term):
    """A term of a user's own, with a parameter per lane or site and one that all share."""

    strength: jax.Array
    power: jax.Array

    def force(self, t, u, v, mass):
        return -self.strength * u * jnp.abs(u) ** self.power - 0.1 * jnp.tanh(v)

    def energy(self, t, u):
        return None


@pytest.mark.study
@pytest.mark.parametrize("solver", [None, pytest.param(diffrax.Tsit5(), marks=pytest.mark.slow)])
def test_lanes_in_some_of_the_leaves_two_axes_of_them_and_solvers_that_are_not_ours(solver):
    """Lanes (2, 3): masses have them, a bond's stiffness one axis of them, the rest is shared."""
    mass = np.linspace(1.0, 2.0, 2 * 3 * SITES).reshape(SITES, 2, 3)
    pull = Pull(jnp.array(0.3), jnp.array(0.5))
    lattice = gx.Lattice(mass[:, 0, 0], (gx.Bond(Shift(1, "fixed"), gx.Hertz(1.0)), pull))
    parts, strengths = lambda x: (x.mass, x.terms[1].strength), jnp.array([0.1, 0.2, 0.3])
    some = eqx.tree_at(parts, lattice, (jnp.asarray(mass), strengths))
    state = gx.states.impact(some)
    run = gx.simulate(some, state, 3.0, solver=solver, tolerance=1e-7)
    assert run.final.u.shape == (SITES, 2, 3) and run.code.shape == (2, 3)
    for i, j in ((0, 0), (1, 2)):
        one = eqx.tree_at(parts, lattice, (jnp.asarray(mass[:, i, j]), strengths[j]))
        agree(
            run, (i, j), gx.simulate(one, gx.states.impact(one), 3.0, solver=solver, tolerance=1e-7)
        )


@pytest.mark.slow
def test_a_cell_of_two_fields():
    def cell(k):
        bond = gx.Bond(Shift(1, "fixed", "bead"), gx.Hertz(1.0, 0.4))
        inner = gx.Bond(Shift(0, "free", ("bead", "resonator")), gx.Linear(k))
        return gx.Lattice({"bead": jnp.ones(4), "resonator": jnp.full(4, 0.3)}, (bond, inner))

    lattice = jax.vmap(cell, out_axes=-1)(jnp.array([0.5, 0.9]))
    state = gx.states.random(lattice, 2, displacement=0.1)
    run = gx.simulate(lattice, state, 3.0, **HOW)
    for k, value in enumerate((0.5, 0.9)):
        agree(run, k, gx.simulate(cell(value), gx.State(*lane(tuple(state), k)), 3.0, **HOW))


@pytest.mark.study
def test_a_lane_that_fails_leaves_the_others():
    """The middle one runs out of its well to infinity; and lanes that may take no more steps."""

    def make(speed):
        bond = gx.Bond(Shift(1, "fixed"), gx.Polynomial(1.0, 0.0, -1.0))
        lattice = gx.Lattice(1.0, bond, sites=SITES)
        return lattice, gx.states.impact(lattice, velocity=speed)

    lattice, state = jax.vmap(make, out_axes=-1)(jnp.array([0.01, 10.0, 0.02]))
    how = HOW | {"save_at": 3, "max_steps": 2000}
    run = gx.simulate(lattice, state, 2.0, throw=False, **how)
    assert run.completed.tolist() == [True, False, True] and run.stats["steps"][1] == 2000
    assert run.outcome.startswith("1 of 3 lanes did not complete. Lane 1: Stopped after 2000 steps")
    assert run.ts.tolist() == [0, 1, 2] and np.all(np.isfinite(run.us[..., [0, 2]]))
    assert np.all(np.isnan(run.us[1:, :, 1])) and np.all(np.isfinite(run.final.u))
    agree(run, 2, gx.simulate(*make(0.02), 2.0, **how))
    with pytest.raises(RuntimeError, match="Lane 1"):
        gx.simulate(lattice, state, 2.0, **how)


@pytest.mark.slow
def test_what_holds_lanes_itself_is_refused():
    lattice, state = batch(dimer, RATIOS[:3])
    held = jnp.array([1.0, 2.0, 3.0])
    with refused(r"record\['x'\]: expected a quantity of each lane"):
        gx.simulate(
            lattice, state, 1.0, record={"x": gx.Peak(lambda t, y, lattice: held * y.u)}, **HOW
        )
    with refused(r"record\['x'\]: expected a quantity of each lane"):
        gx.simulate(
            lattice, state, 1.0, record={"x": gx.Peak(lambda t, y, lattice: y.u[:, 0])}, **HOW
        )
    with refused("save_at: expected times, where each lane has steps of its own"):
        gx.simulate(lattice, state, 1.0, save_at="steps", **HOW)

    class Held(gx.terms.Term):
        def force(self, t, u, v, mass):
            return -held * u

    outer = eqx.tree_at(lambda x: x.terms, lattice, (*lattice.terms, Held()))
    with refused("lattice: expected terms that work on one lane"):
        gx.simulate(outer, state, 1.0, **HOW)
    assert gx.simulate(outer, state, 0.1, step=0.1).final.u.shape == (SITES, 3)
