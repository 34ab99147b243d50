"""Caputo's derivative in time: the Mittag-Leffler function, relaxation, lattices damped with a history."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from refusals import refused
from scipy.special import erfcx

import granjax as gx

RATE = 0.3


def mittag_leffler(t, order):
    return np.asarray(gx.theory.mittag_leffler(-(np.asarray(t) ** order), order))


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
    for wrong in ((0.1, 0.5), (-1.0, 1.5), (-1.0, 0.0), (-1.0, 0.5, -1.0)):
        with refused("z|order|second"):
            gx.theory.mittag_leffler(*wrong)


def test_relaxation_is_of_order_two_less_the_order():
    for order in (0.4, 0.8):
        errors = []
        for steps in (200, 400):
            run = gx.caputo(relax, 1.0, 2.0, order=order, steps=steps)
            errors.append(np.abs(run.ys - mittag_leffler(run.ts, order)).max())
            assert errors[-1] < run.error < 3 * errors[-1] and run.residual < 1e-13
        assert abs(np.log2(errors[0] / errors[1]) - (2 - order)) < 0.08
    # errors of the first steps count: equal steps, and an order at which the grading ends
    for order, grading in ((0.4, 1.0), (0.8, 1.0), (0.05, 1.0), (0.05, None)):
        run = gx.caputo(relax, 1.0, 1.0, order=order, steps=200, grading=grading)
        true = np.abs(run.ys - mittag_leffler(run.ts, order)).max()
        assert true < run.error < 3 * true


@pytest.mark.slow
def test_relaxation_from_another_time_of_several_with_a_derivative():
    def end(rate):
        def field(t, y, args):
            return {"a": -args * y["a"], "b": t - y["b"] ** 3}

        run = gx.caputo(
            field,
            {"a": jnp.array([1.0, 2.0]), "b": 0.0},
            3.0,
            order=0.5,
            steps=100,
            t0=1.0,
            args=rate,
        )
        assert run.ys["a"].shape == (101, 2) and run.ts[0] == 1 and run.ts[-1] == 3
        return run.ys["a"][-1]

    got, slope = jax.jvp(end, (1.3,), (1.0,))
    x = 1.3 * np.sqrt(2.0)
    # the equation's solution is E_a(-rate t^a)
    assert np.allclose(got, erfcx(x) * np.array([1, 2]), rtol=1e-3)
    wanted = np.sqrt(2.0) * (2 * x * erfcx(x) - 2 / np.sqrt(np.pi))
    assert np.allclose(slope, wanted * np.array([1, 2]), rtol=3e-3)


def test_relaxation_differentiates_in_both_modes():
    def end(rate):
        return gx.caputo(
            lambda t, y, args: -args * y**3, np.ones(2), 2.0, order=0.5, steps=20, args=rate
        ).ys[-1, 0]

    forward, reverse = jax.jvp(end, (0.7,), (1.0,))[1], jax.grad(end)(0.7)
    assert (
        abs(forward - reverse) < 1e-14 and abs(forward - (end(0.7001) - end(0.6999)) / 2e-4) < 1e-8
    )


def oscillator(t, order, struck=0, count=60):
    """u'' + c D^a u + u = 0, u(0) = 1, or u'(0) = 1: the inverse Laplace transform on Talbot's contour."""
    theta = (2 * np.arange(-count // 2, count // 2) + 1) * np.pi / count
    s = count * (0.5017 * theta / np.tan(0.6407 * theta) - 0.6122 + 0.2645j * theta)
    slope = (
        0.5017 / np.tan(0.6407 * theta)
        - 0.5017 * 0.6407 * theta / np.sin(0.6407 * theta) ** 2
        + 0.2645j
    )
    p = s / t
    transformed = (1 if struck else p + RATE * p ** (order - 1)) / (p**2 + RATE * p**order + 1)
    return (np.sum(np.exp(s) * transformed * slope) / (1j * t)).real


def damped(order, rate=RATE):
    return gx.Lattice(1.0, (gx.OnSite(gx.Linear(1.0)), gx.CaputoDamping(rate, order)), sites=2)


START = gx.State(np.array([1.0, 0.0]), np.zeros(2))


def test_a_damped_oscillator_is_its_laplace_transform():
    struck = START[::-1]
    for order in (0.3, 0.8, 0.95):
        # a damping that begins as t^{1-a}
        errors = [
            abs(
                gx.simulate(damped(order), gx.State(*struck), 4.0, step=step).final.u[0]
                - oscillator(4.0, order, 1)
            )
            for step in (0.04, 0.02)
        ]
        assert abs(np.log2(errors[0] / errors[1]) - 2) < 0.2
    for order in (0.3, 0.8):
        errors = []
        for step in (0.04, 0.02):
            run = gx.simulate(damped(order), START, 4.0, step=step)
            errors.append(abs(run.final.u[0] - oscillator(4.0, order)))
            assert run.energy_error < step**2 and run.work[-1] < 0 and run.final.u[1] == 0
        assert errors[1] < 3e-5 and abs(np.log2(errors[0] / errors[1]) - 2) < 0.05


@pytest.mark.study
def test_lanes_frames_and_both_modes_of_derivatives():
    orders = jnp.array([0.3, 0.5, 0.8])
    batch = jax.vmap(damped, out_axes=-1)(orders)
    run = gx.simulate(
        batch, gx.State(np.ones((2, 3)), np.zeros((2, 3))), 4.0, step=0.02, save_at=[1.013, 4.0]
    )
    assert np.allclose(
        run.us[-1, 0], [oscillator(4.0, a) for a in orders], atol=4e-5
    ) and run.work.shape == (2, 3)
    assert np.allclose(run.us[0, 0], [oscillator(1.013, a) for a in orders], atol=4e-5)

    def end(rate):
        return gx.simulate(damped(0.5, rate), START, 4.0, step=0.04).final.u[0]

    forward, reverse = jax.jvp(end, (RATE,), (1.0,))[1], jax.grad(end)(RATE)
    assert (
        abs(forward - reverse) < 1e-12
        and abs(forward - (end(RATE + 1e-4) - end(RATE - 1e-4)) / 2e-4) < 1e-6
    )
    assert "history" in run.choice


def test_what_cannot_be_meant_is_refused():
    lattice = damped(0.5)
    for call, said in (
        (lambda: gx.caputo(relax, 1.0, 1.0, order=1.0), "order"),
        (lambda: gx.caputo(relax, 1.0, 1.0, order=0.5, steps=7), "steps"),
        (lambda: gx.caputo(relax, 1.0, -1.0, order=0.5), "t1"),
        (
            lambda: gx.Lattice(1.0, gx.CaputoDamping(1.0, np.array([0.2, 0.3])), sites=2),
            "one order",
        ),
        (lambda: gx.simulate(lattice, START, 1.0, tolerance=1e-6), "tolerance"),
        (lambda: gx.simulate(lattice, START, 9.0, step=3.0), "step"),
        (lambda: gx.floquet.floquet(lattice, START, 1.0), "remembers the velocity"),
        (
            lambda: gx.simulate(
                gx.Lattice(1.0, (*lattice.terms, gx.Drag(0.1)), sites=2), START, 1.0
            ),
            "Drag",
        ),
        (
            lambda: gx.simulate(
                gx.Lattice(
                    1.0,
                    (
                        *lattice.terms,
                        gx.PlasticContact(gx.Shift(1, "free"), gx.WaltonBraun(1.0, 2.0)),
                    ),
                    sites=2,
                ),
                START,
                1.0,
            ),
            "side by side",
        ),
    ):
        with refused(said):
            call()
