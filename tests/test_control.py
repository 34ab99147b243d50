"""Step control: errors below tolerance at contact loss, nothing wasted, and honest ends."""

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest

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


def after(error, refused=False, t0=2.0, h=0.1):
    """What the control makes of a step from t0 with this error, of order 7, at a tolerance of 1e-6."""
    one = jnp.asarray(1.0)
    t0 = jnp.asarray(t0)
    control = StepControl(jnp.asarray(1e-6), Scales(one, one), one)
    errors = jnp.asarray([error]), jnp.zeros(1)
    more = None, None, None, errors, 7, jnp.asarray(refused)
    return control.adapt_step_size(t0, t0 + h, *more)


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
def test_magnets_that_meet_end_the_run_with_a_sentence():
    # an exponent above -1: the energy that keeps them apart is finite
    chain = gx.scenes.monomer(6, exponent=-0.5, precompression=1.0)
    with pytest.raises(RuntimeError, match="Magnets met in bond . of terms.0. near t = 0.1"):
        gx.simulate(chain, gx.states.impact(chain, velocity=10.0), 5.0, tolerance=1e-8)
