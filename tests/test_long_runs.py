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

slow = pytest.mark.slow

march = sys.modules["granjax.flow.march"]


@pytest.fixture
def soon(monkeypatch):
    """What takes 1e-5 s already takes long; a list that grows by one with each piece."""
    counted = []
    one = march._piece
    monkeypatch.setattr(march, "_piece", lambda *arguments: counted.append(1) or one(*arguments))

    def shorten():
        for name, value in (("LONG", 1e-5), ("PIECE", 1e-5), ("SHORT", 0.0)):
            monkeypatch.setattr(march, name, value)
        return counted

    return shorten


def chain(boundary="fixed"):
    lattice = gx.scenes.monomer(6, precompression=1.0, boundary=boundary)
    return lattice, gx.states.impact(lattice, velocity=0.3)


def rattling():
    lattice = gx.scenes.fput(4, alpha=0.25)
    return lattice, gx.states.impact(lattice, velocity=0.3)


def assert_pieces_are_whole(soon, scene, t1, tolerance, **how):
    """By many pieces the same as by one; both runs."""
    whole = gx.simulate(*scene, t1, **how)
    counted = soon()
    parts = gx.simulate(*scene, t1, **how)
    assert len(counted) > 1 and parts.outcome == whole.outcome and parts.choice == whole.choice
    told = ((r.ts, r.us, r.vs, r.final, r.recorded, r.energy_error) for r in (whole, parts))
    for a, b in zip(*map(jax.tree.leaves, told), strict=True):
        assert_allclose(a, b, rtol=tolerance, atol=tolerance)
    shapes = ({k: np.shape(x) for k, x in run.stats.items()} for run in (whole, parts))
    assert next(shapes) == next(shapes)
    return whole, parts


@slow
def test_pieces_of_equal_steps_are_one_run_with_its_records_and_errors(soon):
    record = {"sum": gx.Integral(gx.measures.contact_force)}
    times = [0.0, 0.35, 2.0, 2.01, 2.02, 5.0]
    how = dict(step=0.1, save_at=times, record=record, confirm=True)
    whole, parts = assert_pieces_are_whole(soon, chain(), 5.0, 1e-10, **how)
    assert parts.opening == whole.opening
    assert_allclose(parts._margin, whole._margin, rtol=1e-10, atol=1e-10)
    errors = parts.error.records["sum"], whole.error.records["sum"]
    assert_allclose(*errors, rtol=1e-4, atol=1e-12)


@slow
def test_pieces_of_a_batch_with_jumps_in_time(soon):
    def scene(stiffness):
        bond = gx.Bond(gx.Shift(1, "fixed"), gx.Hertz(stiffness, 1.0))
        jump = gx.Modulated(bond, lambda t: jnp.where(t < 1.23, 1.0, 1.5), breaks=[1.23])
        return gx.Lattice(1.0, jump, sites=5)

    lattice = jax.vmap(scene, out_axes=-1)(jnp.array([1.0, 1.1]))
    state = gx.states.impact(lattice, velocity=0.3)
    assert_pieces_are_whole(soon, (lattice, state), 3.0, 1e-7, step=0.02, save_at=4)


@slow
def test_pieces_of_an_adaptive_run(soon):
    how = {"tolerance": 1e-9, "save_at": 7}
    whole = gx.simulate(*rattling(), 20.0, **how)
    counted = soon()
    parts = gx.simulate(*rattling(), 20.0, **how)
    assert len(counted) > 1 and parts.completed
    for name in ("ts", "us", "vs", "energy_error"):
        assert_allclose(getattr(parts, name), getattr(whole, name), rtol=1e-6, atol=1e-6)
    spent = gx.simulate(*rattling(), 20.0, max_steps=32, throw=False, **how)
    assert "Stopped after 32 steps" in spent.outcome
    assert np.isinf(spent.ts[-1]) and np.isfinite(spent.ts[0]), "what was not reached is told so"


@slow
def test_what_fails_in_a_piece_is_located(soon):
    soon()
    lattice = gx.scenes.fput(4, alpha=-3.0)
    state = gx.states.impact(lattice, velocity=5.0)
    with pytest.raises(RuntimeError, match="not finite .first between t = .* and .*, at sites"):
        gx.simulate(lattice, state, 50.0, step=0.05)
    run = gx.simulate(lattice, state, 50.0, step=0.05, save_at=6, throw=False)
    assert_allclose(run.ts, [0.0, 10.0, 20.0, 30.0, 40.0, 50.0])
    assert np.isnan(run.us[-1]).all() and np.isnan(run.energy_error)


@slow
def test_lanes_of_long_runs_outlive_those_that_are_lost(soon):
    """Two lanes leave their wells, the second of them later; the others reach the end as alone."""
    alone = lambda alpha, speed: (
        gx.scenes.fput(4, alpha=alpha),
        gx.State(jnp.zeros(4), speed * jnp.eye(4)[0]),
    )
    scenes = ((-0.25, 0.3), (-1.0, 1.5), (-3.0, 5.0), (0.25, 0.5))
    batch = jax.vmap(alone, out_axes=-1)(*jnp.array(scenes).T)
    how = {"step": 0.05, "save_at": 6, "throw": False}
    whole = gx.simulate(*batch, 50.0, **how)
    counted = soon()
    run = gx.simulate(*batch, 50.0, **how)
    assert len(counted) > 1
    assert run.completed.tolist() == [True, False, False, True]
    assert "2 of 4 lanes did not complete. Lane 1: The state is not finite" in run.outcome
    for found in (run, whole):
        before, after, _ = found.failed_at
        assert 13.6 < before < after < 13.7
    for lane in (0, 3):
        one = gx.simulate(*alone(*scenes[lane]), 50.0, **how)
        assert_allclose(run.us[..., lane], one.us, rtol=1e-11, atol=1e-11)
        assert_allclose(run.final.v[:, lane], one.final.v, rtol=1e-11, atol=1e-11)
        assert_allclose(run.energy_error[lane], one.energy_error, rtol=0, atol=1e-12)


@slow
def test_pieces_keep_the_floating_type_and_their_number_of_steps(soon):
    soon()
    small = jax.tree.map(lambda x: x.astype("float32"), chain())
    run = gx.simulate(*small, 100.0, step=0.05, save_at=5)
    assert run.ts.dtype == run.us.dtype == np.float32 and run.stats["steps"] == 2000


@slow
def test_a_long_run_shows_its_progress(soon, capsys):
    soon()
    gx.simulate(*chain(), 5.0, step=0.1, progress=True)
    assert "100%" in capsys.readouterr().err


@slow
def test_derivatives_batches_and_programs_know_nothing_of_pieces(soon):
    counted = soon()
    lattice, (u, v) = chain()

    def end(v):
        return gx.simulate(lattice, (u, v), 1.0, step=0.1).final.u

    both = jnp.stack([v, v])
    jax.jvp(jax.vmap(end), (both,), (both,))
    inside = jax.jit(lambda x: x * end(v))(2.0)
    assert not counted
    assert_allclose(inside, 2 * end(v), rtol=1e-5)


def test_what_takes_more_than_a_day_is_refused():
    lattice, state = chain()
    with refused(r"t1: expected a run of a day at most, got 1e\+13 steps, which take .* days"):
        gx.simulate(lattice, state, 1e12, step=0.1)
    with refused("years"):
        gx.simulate(lattice, state, 1e8, step=1e-7, save_at=5)
    plan = Plan(gx.SRKN11b(), 0.1, None, None, {}, diffrax.ForwardMode())
    refuse_endless(lattice, plan, 10**13, 10**13, False)
    with refused("t1: expected at most 2147483647 steps under a transformation"):
        jax.jit(lambda v: gx.simulate(lattice, (state.u, v), 1e9, step=0.1).final)(state.v)
    with refused("t1: expected at most 2147483647 steps .*, with an adjoint"):
        gx.simulate(lattice, state, 1e9, step=0.1, adjoint=diffrax.DirectAdjoint())


def test_what_will_take_long_is_told_early(soon, monkeypatch):
    """The steps that are left and the time that they take, from the second piece of many; not where a bar shows it."""
    counted = soon()
    monkeypatch.setattr(march, "TOLD", 0.0)
    with pytest.warns(UserWarning, match="about .* more steps to t = 20, which take") as told:
        run = gx.simulate(*rattling(), 20.0, step=0.1)
    steps = float(str(told[0].message).split("about ")[1].split()[0])
    assert len(told) == 1 and 0.5 < steps / float(run.stats["steps"]) < 1.5
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        gx.simulate(*rattling(), 20.0, progress=True, step=0.1)
        # the first piece, which is compiled, tells nothing of the pace
        counted.clear()
        with pytest.raises(UserWarning, match="more steps"):
            gx.simulate(*rattling(), 20.0, step=0.1)
        assert len(counted) == 2


def test_a_run_of_one_program_tells_its_steps_and_the_least_time(monkeypatch):
    monkeypatch.setattr(march, "TOLD", 1e-6)
    with pytest.warns(UserWarning, match="takes 200 steps, which take .* seconds at the least"):
        gx.simulate(*rattling(), 20.0, step=0.1)


@slow
def test_lanes_of_which_one_takes_pieces(monkeypatch, soon):
    counted = soon()
    monkeypatch.setattr(march, "LONG", 1e-4)
    scene = lambda beta: gx.scenes.fput(4, beta=beta)
    betas = jnp.asarray([0.5, 400.0, 0.1])
    both = jax.vmap(scene, out_axes=-1)(betas)
    both = gx.simulate(both, gx.states.impact(both, velocity=1.0), 20.0, tolerance=1e-9)
    assert counted
    monkeypatch.setattr(march, "LONG", 2.0)
    for lane, beta in enumerate(betas):
        one = scene(beta)
        one = gx.simulate(one, gx.states.impact(one, velocity=1.0), 20.0, tolerance=1e-9)
        assert_allclose(both.final.u[:, lane], one.final.u, atol=1e-9)
