"""Runs that take long go in pieces, between which Ctrl-C is heard; what would take more than a day is refused."""

import sys
import warnings

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose
from refusals import refused

import granjax as gx
from granjax.flow.integrate import Plan
from granjax.flow.march import refuse_endless

march = sys.modules["granjax.flow.march"]
RECORD = {"sum": gx.Integral(gx.measures.contact_force)}


@pytest.fixture
def soon(monkeypatch):
    """What takes 1e-5 s already takes long."""
    for name, value in (("LONG", 1e-5), ("PIECE", 1e-5), ("SHORT", 0.0)):
        monkeypatch.setattr(march, name, value)


def chain(**keywords):
    return gx.scenes.monomer(6, precompression=1.0, **keywords)


def pieces(monkeypatch):
    """How many pieces run from now on, in a list."""
    counted, one = [], march._piece
    monkeypatch.setattr(march, "_piece", lambda *arguments: counted.append(1) or one(*arguments))
    return counted


def assert_same(a, b, tolerance=1e-10):
    # how near a contact came at the ends of steps is a matter of the mesh
    margins = (r._margin if tolerance < 1e-8 else () for r in (a, b))
    told = ((r.ts, r.us, r.vs, r.final, r.recorded, r.energy_error, next(margins)) for r in (a, b))
    for x, y in zip(*map(jax.tree.leaves, told), strict=True):
        assert_allclose(x, y, rtol=tolerance, atol=tolerance)
    assert {k: np.shape(x) for k, x in a.stats.items()} == {
        k: np.shape(x) for k, x in b.stats.items()
    }


@pytest.mark.study
@pytest.mark.parametrize("save_at", [7, [0.0, 0.35, 2.0, 2.01, 2.02, 5.0]], ids=["frames", "times"])
def test_pieces_of_equal_steps_are_one_run(save_at, request, monkeypatch):
    lattice = chain()
    state = gx.states.impact(lattice, velocity=0.3)
    keywords = {"step": 0.1, "save_at": save_at, "record": RECORD if save_at == 7 else None}
    keywords["confirm"] = save_at == 7
    whole = gx.simulate(lattice, state, 5.0, **keywords)
    request.getfixturevalue("soon")
    counted = pieces(monkeypatch)
    parts = gx.simulate(lattice, state, 5.0, **keywords)
    assert len(counted) > 3
    assert_same(whole, parts)
    assert (
        parts.outcome == whole.outcome
        and parts.choice == whole.choice
        and parts.opening == whole.opening
    )
    for name, error in parts.error.records.items() if parts.error else ():
        assert_allclose(error, whole.error.records[name], rtol=1e-4, atol=1e-12)


@pytest.mark.study
def test_pieces_of_a_batch_with_jumps_in_time(request):
    def scene(stiffness):
        bond = gx.Bond(gx.Shift(1, "fixed"), gx.Hertz(stiffness, 1.0))
        return gx.Lattice(
            1.0,
            (gx.Modulated(bond, lambda t: jnp.where(t < 1.23, 1.0, 1.5), breaks=[1.23]),),
            sites=5,
        )

    lattice = jax.vmap(scene, out_axes=-1)(jnp.array([1.0, 1.1]))
    state = gx.states.impact(lattice, velocity=0.3)
    whole = gx.simulate(lattice, state, 3.0, step=0.02, save_at=4)
    request.getfixturevalue("soon")
    assert_same(whole, gx.simulate(lattice, state, 3.0, step=0.02, save_at=4), 1e-7)


@pytest.mark.study
def test_pieces_of_an_adaptive_run(request, monkeypatch):
    lattice = gx.scenes.fput(4, alpha=0.25)
    state = gx.states.impact(lattice, velocity=0.3)
    keywords = {"tolerance": 1e-9, "save_at": 7}
    whole = gx.simulate(lattice, state, 20.0, **keywords)
    request.getfixturevalue("soon")
    counted = pieces(monkeypatch)
    parts = gx.simulate(lattice, state, 20.0, **keywords)
    assert len(counted) > 1 and parts.completed
    assert_same(whole, parts, 1e-6)
    spent = gx.simulate(lattice, state, 20.0, max_steps=32, throw=False, **keywords)
    assert "Stopped after 32 steps" in spent.outcome
    assert np.isinf(spent.ts[-1]) and np.isfinite(spent.ts[0]), "what was not reached is told so"


@pytest.mark.slow
def test_what_fails_in_a_piece_is_located(soon):
    lattice = gx.scenes.fput(4, alpha=-3.0)
    state = gx.states.impact(lattice, velocity=5.0)
    with pytest.raises(
        RuntimeError, match="not finite .first between t = [0-9.]+ and [0-9.]+, at sites"
    ):
        gx.simulate(lattice, state, 50.0, step=0.05)
    run = gx.simulate(lattice, state, 50.0, step=0.05, save_at=6, throw=False)
    assert_allclose(run.ts, [0.0, 10.0, 20.0, 30.0, 40.0, 50.0])
    assert np.isnan(run.us[-1]).all() and np.isnan(run.energy_error)


@pytest.mark.slow
def test_pieces_keep_the_floating_type_and_their_number_of_steps(soon):
    lattice = chain()
    state = jax.tree.map(lambda x: x.astype("float32"), gx.states.impact(lattice, velocity=0.3))
    run = gx.simulate(lattice.astype("float32"), state, 100.0, step=0.05, save_at=5)
    assert run.ts.dtype == run.us.dtype == np.float32 and run.stats["steps"] == 2000


@pytest.mark.study
def test_a_run_that_a_program_closes_over_is_a_part_of_it(soon):
    lattice = chain()
    state = gx.states.impact(lattice, velocity=0.3)
    for how in ({}, {"step": 0.1}, {"tolerance": 1e-6}):

        def end(x):
            return x * gx.simulate(lattice, state, 1.0, **how).final.u

        assert_allclose(jax.jit(end)(2.0), end(2.0), rtol=1e-5)
        assert jax.eval_shape(end, 2.0).shape == (6,)


@pytest.mark.slow
def test_a_long_run_shows_its_progress(soon, capsys):
    lattice = chain()
    gx.simulate(lattice, gx.states.impact(lattice, velocity=0.3), 5.0, step=0.1, progress=True)
    assert "100%" in capsys.readouterr().err


def test_derivatives_and_batches_know_nothing_of_pieces(soon, monkeypatch):
    counted = pieces(monkeypatch)
    lattice = chain()
    u, v = gx.states.impact(lattice, velocity=0.3)

    def end(v):
        return gx.simulate(lattice, (u, v), 1.0, step=0.1).final.u

    both = jnp.stack([v, v])
    jax.jvp(jax.vmap(end), (both,), (both,))
    assert not counted


def test_what_takes_more_than_a_day_is_refused():
    lattice = chain()
    state = gx.states.impact(lattice, velocity=0.3)
    with refused(
        r"t1: expected a run of a day at most, got 1e\+13 steps, which take .* days",
    ):
        gx.simulate(lattice, state, 1e12, step=0.1)
    with refused("years"):
        gx.simulate(lattice, state, 1e8, step=1e-7, save_at=5)
    plan = Plan(gx.SRKN11b(), 0.1, None, None, {}, diffrax.ForwardMode())
    refuse_endless(lattice, plan, 10**13, 10**13, False)
    refuse_endless(lattice, plan, 10**13, 1000, False)
    with refused("t1: expected at most 2147483647 steps under a transformation"):
        jax.jit(lambda v: gx.simulate(lattice, (state.u, v), 1e9, step=0.1).final)(state.v)
    with refused("t1: expected at most 2147483647 steps .*, with an adjoint"):
        gx.simulate(lattice, state, 1e9, step=0.1, adjoint=diffrax.DirectAdjoint())


@pytest.mark.parametrize("how", [{"step": 0.1}, {"tolerance": 1e-9}], ids=["equal", "adaptive"])
def test_what_will_take_long_is_told_early(how, soon, monkeypatch):
    """The steps that are left and the time that they take, from the second piece of many; not where a bar shows it."""
    monkeypatch.setattr(march, "TOLD", 0.0)
    lattice = gx.scenes.fput(4, alpha=0.25)
    state = gx.states.impact(lattice, velocity=0.3)
    with pytest.warns(
        UserWarning, match="The run takes about .* more steps to t = 20, which take about"
    ) as told:
        run = gx.simulate(lattice, state, 20.0, **how)
    steps = float(str(told[0].message).split("about ")[1].split()[0])
    assert len(told) == 1 and 0.5 < steps / float(run.stats["steps"]) < 1.5
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        gx.simulate(lattice, state, 20.0, progress=True, **how)


def test_a_run_of_one_program_tells_its_steps_and_the_least_time(monkeypatch):
    monkeypatch.setattr(march, "TOLD", 1e-6)
    lattice = gx.scenes.fput(4, alpha=0.25)
    with pytest.warns(
        UserWarning, match="The run takes 200 steps, which take .* seconds at the least"
    ):
        gx.simulate(lattice, gx.states.impact(lattice, velocity=0.3), 20.0, step=0.1)


def test_times_are_told_in_words():
    told = {
        3.0: "3 seconds",
        150.0: "2.5 minutes",
        7200.0: "2 hours",
        4e5: "4.6 days",
        1e9: "32 years",
    }
    assert {x: march._spoken(x) for x in told} == told
