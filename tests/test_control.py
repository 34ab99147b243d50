"""Step control: errors below tolerance at contact loss, nothing wasted, and honest ends."""

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import granjax as gx
from granjax.flow.control import Scales, StepControl


def test_the_norm_takes_each_by_its_scale_and_sees_what_is_not_finite():
    norm = Scales(jnp.asarray(2.0), jnp.asarray(0.5))
    assert float(norm((jnp.asarray([1.0, -4.0]), jnp.asarray([0.1])))) == 2.0
    assert (
        float(
            norm(({"a": jnp.ones(2), "b": 8 * jnp.ones(3)}, {"a": jnp.zeros(2), "b": jnp.zeros(3)}))
        )
        == 4.0
    )
    # XLA's maximum loses a NaN in an array as long as this
    long = jnp.zeros(10_000).at[5_001].set(jnp.nan)
    assert float(jax.jit(lambda y: norm(y))((long, jnp.zeros(3)))) == np.inf


def _after(error, refused, h=0.1):
    control = StepControl(
        jnp.asarray(1e-6), Scales(jnp.asarray(1.0), jnp.asarray(1.0)), jnp.asarray(1.0)
    )
    errors = (jnp.asarray([error]), jnp.zeros(1))
    t0 = jnp.asarray(2.0)
    keep, start, end, _, now_refused, _ = control.adapt_step_size(
        t0, t0 + h, None, None, None, errors, 7, jnp.asarray(refused)
    )
    return bool(keep), float(start), float(end - start) / h, bool(now_refused)


def _rounded(factor):
    return 2 ** (round(8 * np.log2(factor)) / 8)


@pytest.mark.parametrize(
    "error, refused, factor",
    [
        (1e-6 * 0.9, False, _rounded(0.8 * 0.9 ** (-1 / 7))),
        (1e-12, False, 3.0),
        (0.0, False, 3.0),
        (1e-12, True, 1.0),
        (5e-6, False, _rounded(0.8 * 5 ** (-1 / 7))),
        (1e6, False, 0.2),
        (np.nan, False, 0.2),
        (np.inf, True, 0.2),
    ],
)
def test_the_next_step(error, refused, factor):
    keep, start, got, now_refused = _after(error, refused)
    assert keep == (error < 1e-6) and now_refused != keep
    assert start == (2.1 if keep else 2.0)
    assert got == pytest.approx(factor, rel=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_the_last_digit_does_not_decide_how_contacts_that_open_are_met(seed):
    # every force differs in its last digits; 12 contacts open and close many times, and a step too many would show
    rng = np.random.default_rng(seed)
    chain, state = gx.scenes.dimer(8, ratio=0.4), gx.State(np.zeros(8), rng.uniform(-1, 1, 8))
    moved = gx.State(state.u, np.nextafter(state.v, 2 * rng.integers(0, 2, 8) - 1))
    one, other = (gx.simulate(chain, y, 4.0, tolerance=1e-9) for y in (state, moved))
    assert one.contact_opened
    assert one.stats["steps"] == other.stats["steps"] > 50
    np.testing.assert_allclose(other.final.u, one.final.u, rtol=0, atol=1e-11)


def test_a_step_that_time_does_not_resolve_ends_the_run():
    control = StepControl(
        jnp.asarray(1e-6), Scales(jnp.asarray(1.0), jnp.asarray(1.0)), jnp.asarray(1.0)
    )
    t0 = jnp.asarray(1e6)
    *_, result = control.adapt_step_size(
        t0, t0 + 1e-10, None, None, None, (jnp.ones(1), jnp.ones(1)), 7, jnp.asarray(False)
    )
    assert result == diffrax.RESULTS.dt_min_reached


@pytest.mark.study
@pytest.mark.parametrize("scene", ["wall to wall", "free", "dimer"])
def test_contact_loss_is_resolved_and_few_steps_are_refused(scene):
    chain = {
        "wall to wall": gx.scenes.monomer(30),
        "free": gx.scenes.monomer(30, boundary="free"),
        "dimer": gx.scenes.dimer(31, ratio=0.5),
    }[scene]
    state = gx.states.impact(chain)
    best = gx.simulate(chain, state, 30.0, tolerance=1e-13)
    for tolerance in (1e-7, 1e-9, 1e-11):
        run = gx.simulate(chain, state, 30.0, tolerance=tolerance)
        # a local error at each of some hundred events, carried along
        assert float(jnp.abs(run.final.u - best.final.u).max()) < 1e4 * tolerance
        assert int(run.stats["rejected"]) < 0.5 * int(run.stats["steps"])


@pytest.mark.study
def test_magnets_that_meet_end_the_run_with_a_sentence():
    # an exponent above -1: the energy that keeps them apart is finite
    chain = gx.scenes.monomer(6, exponent=-0.5, precompression=1.0)
    with pytest.raises(RuntimeError, match="Magnets met in bond . of terms.0. near t = 0.1"):
        gx.simulate(chain, gx.states.impact(chain, velocity=10.0), 5.0, tolerance=1e-8)
