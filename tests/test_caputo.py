"""Caputo's derivative in time: the Mittag-Leffler function, relaxation, lattices damped with a history."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from refusals import refused
from scipy.special import erfcx

import granjax as gx

RATE = 0.3


def relax(t, y, args):
    return -y


def test_mittag_leffler():
    x = np.array([0.0, 1e-8, 0.1, 1.0, 5.0, 50.0, 1e4])
    assert np.abs(gx.theory.mittag_leffler(-x, 0.5) - erfcx(x)).max() < 2e-14
    assert np.abs(gx.theory.mittag_leffler(-x, 1.0) - np.exp(-x)).max() < 2e-14
    # of the series, in 40 digits
    for order, second, z, wanted in (
        (0.6, 2.0, -1.0, 0.5688844609374945),
        (0.9, 3.0, -4.0, 0.17768294015796038),
        (0.2, 1.7, -0.01, 1.0902445724385463),
    ):
        assert abs(gx.theory.mittag_leffler(z, order, second) - wanted) < 1e-11
    slope = jax.grad(lambda z: gx.theory.mittag_leffler(z, 0.5))(-1.0)
    assert abs(slope - (2 / np.sqrt(np.pi) - 2 * erfcx(1.0))) < 1e-12


def test_relaxation_is_of_order_two_less_the_order():
    def errors(order, t1, steps, **how):
        run = gx.caputo(relax, 1.0, t1, order=order, steps=steps, **how)
        assert run.residual < 1e-13
        true = np.abs(run.ys - gx.theory.mittag_leffler(-(run.ts**order), order)).max()
        assert true < run.error < 3 * true
        return true

    for order in (0.4, 0.8):
        coarse, fine = (errors(order, 2.0, steps) for steps in (200, 400))
        assert abs(np.log2(coarse / fine) - (2 - order)) < 0.08
    # errors of the first steps count: equal steps, and an order at which the grading ends
    for order, grading in ((0.4, 1.0), (0.05, 1.0), (0.05, None)):
        errors(order, 1.0, 200, grading=grading)


@pytest.mark.slow
def test_relaxation_from_another_time_of_several_with_derivatives_in_both_modes():
    def end(rate):
        def field(t, y, args):
            return {"a": -args * y["a"], "b": t - y["b"] ** 3}

        start = {"a": jnp.array([1.0, 2.0]), "b": 0.0}
        run = gx.caputo(field, start, 3.0, order=0.5, steps=100, t0=1.0, args=rate)
        assert run.ys["a"].shape == (101, 2) and run.ts[0] == 1 and run.ts[-1] == 3
        return run.ys["a"][-1]

    got, slope = jax.jvp(end, (1.3,), (1.0,))
    x = 1.3 * np.sqrt(2.0)
    # the equation's solution is E_a(-rate t^a)
    assert np.allclose(got, erfcx(x) * np.array([1, 2]), rtol=1e-3)
    wanted = np.sqrt(2.0) * (2 * x * erfcx(x) - 2 / np.sqrt(np.pi))
    assert np.allclose(slope, wanted * np.array([1, 2]), rtol=3e-3)
    assert abs(slope[0] - (end(1.3001) - end(1.2999))[0] / 2e-4) < 1e-8
    assert abs(jax.grad(lambda rate: end(rate)[0])(1.3) - slope[0]) < 1e-14


def oscillator(t, order, struck=0, count=60):
    """u'' + c D^a u + u = 0, u(0) = 1, or u'(0) = 1: the inverse Laplace transform on Talbot's contour."""
    theta = (2 * np.arange(-count // 2, count // 2) + 1) * np.pi / count
    s = count * (0.5017 * theta / np.tan(0.6407 * theta) - 0.6122 + 0.2645j * theta)
    bend = 0.5017 * 0.6407 * theta / np.sin(0.6407 * theta) ** 2
    slope = 0.5017 / np.tan(0.6407 * theta) - bend + 0.2645j
    p = s / t
    transformed = (1 if struck else p + RATE * p ** (order - 1)) / (p**2 + RATE * p**order + 1)
    return (np.sum(np.exp(s) * transformed * slope) / (1j * t)).real


def damped(order, *terms, rate=RATE):
    own = gx.OnSite(gx.Linear(1.0)), gx.CaputoDamping(rate, order)
    return gx.Lattice(1.0, (*own, *terms), sites=2)


START = gx.State(np.array([1.0, 0.0]), np.zeros(2))


def test_a_damped_oscillator_is_its_laplace_transform():
    # a damping that begins as t^{1-a}
    struck = gx.State(START.v, START.u)
    for order, start, slack in (
        (0.3, struck, 0.2),
        (0.95, struck, 0.2),
        (0.3, START, 0.05),
        (0.8, START, 0.05),
    ):
        errors = []
        for step in (0.04, 0.02):
            run = gx.simulate(damped(order), start, 4.0, step=step)
            errors.append(abs(run.final.u[0] - oscillator(4.0, order, start is struck)))
            assert run.lattice is None and run.memory is None and run.by_term == ()
            if start is START:
                assert run.energy_error < step**2 and run.work[-1] < 0 and run.final.u[1] == 0
        assert abs(np.log2(errors[0] / errors[1]) - 2) < slack
        assert start is struck or errors[1] < 3e-5


@pytest.mark.slow
def test_lanes_frames_and_both_modes_of_derivatives():
    orders = jnp.array([0.3, 0.8])
    times = [1.013, 4.0]
    batch = jax.vmap(damped, out_axes=-1)(orders)
    start = gx.State(np.ones((2, 2)), np.zeros((2, 2)))
    run = gx.simulate(batch, start, 4.0, step=0.02, save_at=times)
    exact = [[oscillator(t, a) for a in orders] for t in times]
    assert np.allclose(run.us[:, 0], exact, atol=4e-5) and run.work.shape == (2, 2)
    assert "history" in run.choice

    # traced times before the start, after the end or out of order
    traced = jax.jit(lambda ts: gx.simulate(damped(0.5), START, 4.0, step=0.04, save_at=ts))
    for ts in ([-1.0, 2.0], [2.0, 5.0], [2.0, 1.0]):
        run = traced(jnp.array(ts))
        assert not run.completed and np.isnan(run.us).all() and np.isnan(run.work).all()
    assert traced(jnp.array([1.0, 4.0])).completed

    def end(rate):
        return gx.simulate(damped(0.5, rate=rate), START, 4.0, step=0.04).final.u[0]

    forward = jax.jvp(end, (RATE,), (1.0,))[1]
    reverse = jax.grad(end)(RATE)
    assert abs(forward - reverse) < 1e-12
    assert abs(forward - (end(RATE + 1e-4) - end(RATE - 1e-4)) / 2e-4) < 1e-6


@pytest.mark.slow
def test_what_cannot_be_meant_is_refused():
    plastic = gx.PlasticContact(gx.Shift(1, "free"), gx.WaltonBraun(1.0, 2.0))

    def run(*terms, t1=1.0, **how):
        return gx.simulate(damped(0.5, *terms), START, t1, **how)

    def pulsed(t):
        return gx.Drive(lambda now: jnp.where(now < t, 1.0, 0.0), 0, breaks=t)

    for call, said in (
        (lambda: gx.theory.mittag_leffler(0.1, 0.5), "z"),
        (lambda: gx.theory.mittag_leffler(-1.0, 1.5), "order"),
        (lambda: gx.theory.mittag_leffler(-1.0, 0.5, -1.0), "second"),
        (lambda: gx.theory.mittag_leffler(-1.0, 0.5, 3.1), "second.*too coarse for larger b"),
        (lambda: gx.caputo(relax, 1.0, 1.0, order=1.0), "order"),
        (lambda: gx.caputo(relax, 1.0, 1.0, order=0.5, steps=7), "steps"),
        (lambda: gx.caputo(relax, 1.0, -1.0, order=0.5), "t1"),
        (lambda: damped(np.array([0.2, 0.3])), "one order"),
        (lambda: run(tolerance=1e-6), "tolerance"),
        (lambda: run(t1=9.0, step=3.0), "step"),
        (lambda: run(gx.Drag(0.1)), "Drag"),
        (lambda: run(plastic), "side by side"),
        (
            lambda: jax.grad(lambda t: run(pulsed(t)).final.u[0])(0.5),
            "no derivative by times of breaks",
        ),
        (lambda: gx.floquet.floquet(damped(0.5), START, 1.0), "remembers the velocity"),
        (
            lambda: gx.fit(
                lambda p: damped(p["order"]),
                {"order": 0.5},
                gx.Traces([1.0, 2.0], displacement=[0.0, 0.1], sites=0),
                state=START,
            ),
            "scene: expected a lattice without CaputoDamping",
        ),
        (lambda: gx.states.stored(damped(0.5), run().to_xarray()), "got CaputoDamping"),
    ):
        with refused(said):
            call()
    assert run(pulsed(0.5)).choice.endswith("error ~ h where forces jump within steps")

    def end(t, height):
        # Other derivatives than by the times, and compiled programs.
        drive = gx.Drive(lambda now: jnp.where(now < t, height, 0.0), 0, breaks=t)
        return run(drive, step=0.02).final.u[0]

    np.testing.assert_allclose(jax.jit(end)(0.5, 1.0), end(0.5, 1.0), rtol=1e-13)
    slope = jax.grad(end, 1)(0.5, 1.0)
    np.testing.assert_allclose(slope, (end(0.5, 1.1) - end(0.5, 0.9)) / 0.2, rtol=1e-9)
