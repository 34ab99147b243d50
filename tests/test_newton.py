"""Newton's method with halved steps: roots, outcomes, derivatives of roots."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose
from refusals import refused
from scipy.optimize import brentq

from granjax.continuation.newton import newton


def meeting(x, args):
    """A circle of radius sqrt(a) meets the curve e^x + b y = 1."""
    a, b = args
    return jnp.stack([x[0] ** 2 + x[1] ** 2 - a, jnp.exp(x[0]) + b * x[1] - 1.0])


def rootless(x, args):
    return x**2 + 1.0


GUESS = jnp.array([1.0, -1.0])
ARGS = jnp.array([4.0, 1.0])


def test_the_error_is_squared_at_every_step():
    a = 4.0  # e^x = 1 + sqrt(a - x^2), to rounding by bisection
    exact = brentq(lambda x: np.exp(x) - 1 - np.sqrt(a - x**2), 0.5, 1.5, xtol=1e-15, rtol=1e-15)
    exact = np.array([exact, -np.sqrt(a - exact**2)])
    roots = [
        newton(meeting, GUESS, ARGS, max_steps=k, tolerance=1e-15, throw=False) for k in range(1, 7)
    ]
    errors = np.array([np.abs(r.x - exact).max() for r in roots])
    assert np.all(errors[:4] > 1e-6) and errors[5] < 1e-15
    # of one size, while the errors fall from 0.2 to 2e-10
    constants = errors[2:5] / errors[1:4] ** 2
    assert 0.2 < constants.min() and constants.max() < 0.6
    assert [int(r.iterations) for r in roots][:5] == [1, 2, 3, 4, 5]


def test_halved_steps_save_a_guess_that_full_steps_lose():
    x = 3.0
    for _ in range(5):
        x = x - np.arctan(x) * (1 + x**2)
    assert abs(x) > 1e6
    root = newton(lambda x, a: jnp.arctan(x - a), [3.0], 0.0, tolerance=1e-14)
    assert abs(root.x[0]) < 1e-13 and root.iterations < 10
    assert root.first == pytest.approx(np.arctan(3.0))
    # where a full step leaves the domain: log x from x = 3 would go to -0.3
    assert newton(lambda x, a: jnp.log(x), [3.0]).x[0] == pytest.approx(1.0, abs=1e-10)


@pytest.mark.slow
def test_a_family_of_almost_roots_is_not_left_by_rounding():
    # x on the unit circle, the angle held by 1e-14 alone: J^{-1} makes steps of rounding along the circle
    def f(x, a):
        r = jnp.sqrt(x @ x)
        return jnp.stack([jnp.log(r) + a * jnp.sin(3 * x[0]), 1e-15 * x[1] + a * 1e-13 * (r - 1)])

    guess = jnp.array([0.9, 0.7])
    x = np.array([0.9, 0.7])
    for _ in range(12):
        x = x - np.linalg.solve(jax.jacfwd(f)(x, 0.3), f(x, 0.3))
    assert not np.abs(f(x, 0.3)).max() < 1e-12
    root = newton(f, guess, 0.3, tolerance=1e-12)
    assert np.abs(f(root.x, 0.3)).max() < 1e-12 and np.abs(root.x - guess).max() < 1


CASES = {
    0: (meeting, GUESS, ARGS, 20, "Converged: the residual went from 2.0e+00 to"),
    1: (rootless, [0.5], None, 40, "no fraction of the step lowered it further"),
    2: (meeting, GUESS, ARGS, 2, "in 2 steps, 1.0e-10 was asked for; the steps were spent"),
    3: (lambda x, a: jnp.sqrt(x), [-1.0], None, 20, "the next residual was not finite"),
}


@pytest.mark.parametrize("code", CASES)
def test_outcomes_are_sentences(code):
    f, guess, args, most, words = CASES[code]
    root = newton(f, guess, args, max_steps=most, throw=False)
    assert root.code == code and root.converged == (code == 0)
    assert words in root.outcome and root.outcome.endswith(".")
    for throw in (None, True) if code else ():
        with pytest.raises(RuntimeError, match="Newton did not converge: the residual went from"):
            newton(f, guess, args, max_steps=most, throw=throw)


def test_the_best_iterate_is_returned():
    # no root: |x^2 + 1| is least, 1, at 0
    root = newton(rootless, [0.5], max_steps=40, throw=False)
    assert root.residual == root.x[0] ** 2 + 1 and 1 <= root.residual < 1.01 and root.first == 1.25
    # a singular Jacobian: not one step
    root = newton(lambda x, a: x**2 - 1.0, [0.0], throw=False)
    assert root.x[0] == 0.0 and root.residual == 1.0 and not root.converged
    # a tolerance below rounding: stalled at the root
    root = newton(lambda x, a: x**2 - a, [1.0], 2.0, tolerance=0.0, max_steps=40, throw=False)
    assert abs(root.x[0] - 2**0.5) < 1e-15 and (root.code == 1 or root.residual == 0)
    # a root as guess costs one Jacobian
    root = newton(lambda x, a: x - a, [2], 2.0)
    assert root.iterations == 1 and root.residual == 0 and root.x.dtype == float


@pytest.mark.slow
def test_derivatives_of_the_root_in_the_arguments():
    root = jax.jit(lambda args: newton(meeting, GUESS, args, tolerance=1e-13).x)
    forward = jax.jit(jax.jacfwd(root))
    reverse = jax.jacrev(root)

    def differences(f):
        return np.stack([f(ARGS + x) - f(ARGS - x) for x in 1e-5 * np.eye(2)], -1) / 2e-5

    first = differences(root)
    second = differences(forward)
    for way in (forward, reverse):
        assert_allclose(way(ARGS), first, rtol=0, atol=1e-9)
    for way in (jax.jacfwd(forward), jax.jacrev(forward)):
        assert_allclose(way(ARGS), second, rtol=0, atol=1e-9)
    assert np.abs(first).min() > 0.05 and np.abs(second).min() > 0.005


@pytest.mark.slow
def test_inside_jit_and_vmap():
    find = lambda args: newton(meeting, GUESS, args)
    one = find(ARGS)
    assert np.array_equal(jax.jit(find)(ARGS).x, one.x)
    # lanes of their own, the third without a root (e^x + b y = 1 does not reach a circle of negative radius)
    several = jnp.stack([ARGS, jnp.array([9.0, 0.5]), jnp.array([-1.0, 1.0])])
    roots = jax.jit(jax.vmap(find))(several)
    assert list(roots.converged) == [True, True, False]
    for lane in (0, 1):
        assert_allclose(roots.x[lane], find(several[lane]).x, rtol=0, atol=1e-13)
    assert roots.iterations[0] == one.iterations
    assert "Newton did not converge" in roots.outcome  # the worst of them


@pytest.mark.slow
def test_a_given_linearisation_is_used_for_the_root_and_not_for_its_derivative():
    # a wrong slope converges slower, to the same root: the derivative is that of the residual
    half = lambda x, args: (meeting(x, args), 2 * jax.jacfwd(meeting)(x, args))

    def slow(args):
        root = newton(meeting, GUESS, args, linearise=half, max_steps=60)
        return root.x, root.iterations

    root, steps = slow(ARGS)
    slope = jax.jacfwd(lambda args: slow(args)[0])
    own = newton(meeting, GUESS, ARGS)
    assert steps > 2 * own.iterations
    assert_allclose(root, own.x, rtol=0, atol=1e-9)
    plain = jax.jacfwd(lambda args: newton(meeting, GUESS, args).x)
    assert_allclose(slope(ARGS), plain(ARGS), rtol=0, atol=1e-8)


def test_a_tolerance_that_cannot_be_meant_is_refused():
    for tolerance in (np.nan, -1.0):
        with refused("^tolerance: expected"):
            newton(lambda x, args: x - 1, [2.0], tolerance=tolerance)
