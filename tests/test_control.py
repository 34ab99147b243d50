"""Step control: errors below tolerance at contact loss, nothing wasted, and honest ends."""

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import granjax as gx
from granjax.flow.control import Scales, StepControl

slow = pytest.mark.slow


def test_the_norm_takes_each_by_its_scale_and_sees_what_is_not_finite():
    norm = Scales(jnp.asarray(2.0), jnp.asarray(0.5))
    assert float(norm((jnp.asarray([1.0, -4.0]), jnp.asarray([0.1])))) == 2.0
    fields = {"a": jnp.ones(2), "b": 8 * jnp.ones(3)}
    assert float(norm((fields, jax.tree.map(jnp.zeros_like, fields)))) == 4.0
    # XLA's maximum loses a NaN in an array as long as this
    long = jnp.zeros(10_000).at[5_001].set(jnp.nan)
    assert float(jax.jit(lambda y: norm(y))((long, jnp.zeros(3)))) == np.inf


def after(error, refused=False, t0=2.0, h=0.1, size=1.0):
    """What the control makes of a step from t0 with this error, of order 7, at a tolerance of 1e-6."""
    one = jnp.asarray(1.0)
    t0 = jnp.asarray(t0)
    control = StepControl(jnp.asarray(1e-6), Scales(one, one), one)
    errors = jnp.asarray([error]), jnp.zeros(1)
    y0 = jnp.zeros(1), jnp.asarray([size])
    return control.adapt_step_size(t0, t0 + h, y0, y0, None, errors, 7, jnp.asarray(refused))


def rounded(factor):
    return 2 ** (round(8 * np.log2(factor)) / 8)


@pytest.mark.parametrize(
    "error, refused, factor",
    [
        (1e-6 * 0.9, False, rounded(0.8 * 0.9 ** (-1 / 7))),
        (0.0, False, 3.0),
        (1e-12, True, 1.0),
        (5e-6, False, rounded(0.8 * 5 ** (-1 / 7))),
        (1e6, False, 0.2),
        (np.nan, True, 0.2),
    ],
)
def test_the_next_step(error, refused, factor):
    keep, start, end, _, now_refused, _ = after(error, refused)
    assert bool(keep) == (error < 1e-6) != bool(now_refused)
    assert float(start) == (2.1 if keep else 2.0)
    assert float(end - start) / 0.1 == pytest.approx(factor, rel=1e-12)


def test_a_step_that_time_does_not_resolve_ends_the_run():
    assert after(1.0, t0=1e6, h=1e-10)[-1] == diffrax.RESULTS.dt_min_reached
    # a failed step of one unit in the last place, which a shorter one is rounded up to
    assert after(2e-6, t0=1.0, h=2.3e-16)[-1] == diffrax.RESULTS.dt_min_reached


@pytest.mark.parametrize("error, stops", [(2e-6, True), (5e-7, False)])
def test_a_motion_whose_rounding_is_far_above_the_tolerance_ends_at_a_failed_step(error, stops):
    known = diffrax.RESULTS.dt_min_reached if stops else diffrax.RESULTS.successful
    assert after(error, size=1e15, h=1e-10)[-1] == known
    assert after(error, size=1e12, h=1e-10)[-1] == diffrax.RESULTS.successful
    assert after(error, size=1e15)[-1] == diffrax.RESULTS.successful


@slow
def test_a_motion_that_grows_far_but_not_without_bound_goes_on():
    """From 1e-10 beside the top of a double well u'' = u - u^3: the separatrix's 2^(1/2)/cosh."""
    wells = gx.Lattice(1.0, gx.OnSite(gx.Polynomial(-1.0, 0.0, 1.0)), sites=2)
    begin = jnp.full(2, 1e-10)
    run = gx.simulate(wells, (begin, begin), 27.0, tolerance=1e-12)
    top = np.log(2**1.5 / 1e-10)
    assert_allclose(run.final.u, np.sqrt(2) / np.cosh(27 - top), rtol=1e-6)


@slow
@pytest.mark.parametrize("dtype, tolerance", [("float64", 1e-8), ("float32", 1e-5)])
def test_a_motion_that_reaches_infinity_ends_where_it_does(dtype, tolerance):
    """u'' = 2 u^3 has the solution 1/(1 - t)."""
    chain = gx.Lattice(1.0, gx.OnSite(gx.Polynomial(0.0, 0.0, -2.0)), sites=2).astype(dtype)
    one = jnp.ones(2, dtype)
    run = gx.simulate(chain, (one, one), 10.0, tolerance=tolerance, throw=False)
    assert "without bound" in run.outcome and "near t = " in run.outcome
    assert_allclose(run.ts, 1, atol=1e-3)
    assert run.stats["steps"] < 2e5


@slow
def test_the_last_digit_does_not_decide_how_contacts_that_open_are_met():
    # every force differs in its last digits; 12 contacts open and close many times, and a step too many would show
    rng = np.random.default_rng(1)
    chain = gx.scenes.dimer(8, ratio=0.4)
    state = gx.State(np.zeros(8), rng.uniform(-1, 1, 8))
    moved = gx.State(state.u, np.nextafter(state.v, 2 * rng.integers(0, 2, 8) - 1))
    one, other = (gx.simulate(chain, y, 4.0, tolerance=1e-9) for y in (state, moved))
    assert one.contact_opened
    assert one.stats["steps"] == other.stats["steps"] > 50
    np.testing.assert_allclose(other.final.u, one.final.u, rtol=0, atol=1e-11)


@slow
def test_contact_loss_is_resolved_and_few_steps_are_refused():
    chain = gx.scenes.dimer(31, ratio=0.5)
    run = lambda tolerance: gx.simulate(chain, gx.states.impact(chain), 30.0, tolerance=tolerance)
    best = run(1e-13)
    for tolerance in (1e-7, 1e-9, 1e-11):
        found = run(tolerance)
        # a local error at each of some hundred events, carried along
        assert float(jnp.abs(found.final.u - best.final.u).max()) < 1e4 * tolerance
        assert int(found.stats["rejected"]) < 0.5 * int(found.stats["steps"])


@slow
@pytest.mark.parametrize(
    "terms",
    [
        lambda unit: (),
        lambda unit: (gx.Drive(lambda t: 0.3 * unit * jnp.sin(1.3 * t), 0),),
        lambda unit: (gx.Wall(gx.Toda(unit, 1 / unit), "left", lambda t: 0.3 * unit * t),),
    ],
    ids=["forces at the start", "drive", "wall"],
)
def test_what_moves_from_rest_is_resolved_in_any_unit_of_length(terms):
    """The scale of the tolerance is not one metre per second."""
    runs = []
    for unit in (1.0, 1e-9):
        bond = gx.Bond(gx.Shift(1, "free"), gx.Toda(unit, 1 / unit))
        chain = gx.Lattice(1.0, (bond, *terms(unit)), sites=20)
        start = gx.states.rest(chain)
        if len(chain.terms) == 1:
            step = gx.shocks.step(chain, 0.5 * unit, 0.0)
            chain, start = step.lattice, step.state
        runs.append(gx.simulate(chain, start, 8.0, tolerance=1e-9))
    one, other = runs
    assert int(one.stats["steps"]) == int(other.stats["steps"])
    assert_allclose(other.final.u / 1e-9, one.final.u, rtol=0, atol=1e-11)


@slow
def test_a_tolerance_takes_few_steps_where_the_law_has_no_floor():
    """The bound on the frequencies, 1e12 here, is no scale for the errors of displacements."""
    law = gx.Polynomial(1.0, 0.0, -1.0)
    step = gx.shocks.step(gx.Lattice(1.0, gx.Bond(gx.Shift(1, "free"), law), sites=100), 0.2, 0.1)
    run = step.run(30.0, tolerance=1e-9)
    assert int(run.stats["steps"]) < 300
    assert_allclose(run.final.u, step.run(30.0, step=0.05).final.u, rtol=0, atol=1e-8)


@slow
def test_magnets_that_meet_end_the_run_with_a_sentence():
    # an exponent above -1: the energy that keeps them apart is finite
    chain = gx.scenes.monomer(6, exponent=-0.5, precompression=1.0)
    with pytest.raises(RuntimeError, match="Magnets met in bond . of terms.0. near t = 0.1"):
        gx.simulate(chain, gx.states.impact(chain, velocity=10.0), 5.0, tolerance=1e-8)
