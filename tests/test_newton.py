import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import brentq

from granjax.continuation.newton import newton


def meeting(x, args):
    """A circle of radius sqrt(a) meets the curve e^x + b y = 1."""
    a, b = args
    return jnp.stack([x[0] ** 2 + x[1] ** 2 - a, jnp.exp(x[0]) + b * x[1] - 1.0])


GUESS, ARGS = jnp.array([1.0, -1.0]), jnp.array([4.0, 1.0])


def test_the_error_is_squared_at_every_step():
    a = 4.0  # e^x = 1 + sqrt(a - x^2), to rounding by bisection
    exact = brentq(lambda x: np.exp(x) - 1 - np.sqrt(a - x**2), 0.5, 1.5, xtol=1e-15, rtol=1e-15)
    exact = np.array([exact, -np.sqrt(a - exact**2)])
    roots = [
        newton(meeting, GUESS, ARGS, max_steps=k, tolerance=1e-15, throw=False) for k in range(1, 7)
    ]
    errors = np.array([np.abs(r.x - exact).max() for r in roots])
    assert np.all(errors[:4] > 1e-6) and errors[5] < 1e-15
    constants = (
        errors[2:5] / errors[1:4] ** 2
    )  # of one size, while the errors fall from 0.2 to 2e-10
    assert 0.2 < constants.min() and constants.max() < 0.6
    assert [int(r.iterations) for r in roots][:5] == [1, 2, 3, 4, 5]


def test_halved_steps_save_a_guess_that_full_steps_lose():
    f = lambda x, a: jnp.arctan(x - a)
    x = 3.0
    for _ in range(5):
        x = x - np.arctan(x) * (1 + x**2)
    assert abs(x) > 1e6
    root = newton(f, [3.0], 0.0, tolerance=1e-14)
    assert (
        abs(root.x[0]) < 1e-13
        and root.first == pytest.approx(np.arctan(3.0))
        and root.iterations < 10
    )
    # where a full step leaves the domain: log x from x = 3 would go to -0.3
    assert newton(lambda x, a: jnp.log(x), [3.0]).x[0] == pytest.approx(1.0, abs=1e-10)


@pytest.mark.slow
def test_a_family_of_almost_roots_is_not_left_by_rounding():
    # x on the unit circle, the angle held by 1e-14 alone: J^{-1} makes steps of rounding along the circle
    def f(x, a):
        r = jnp.sqrt(x @ x)
        return jnp.stack([jnp.log(r) + a * jnp.sin(3 * x[0]), 1e-15 * x[1] + a * 1e-13 * (r - 1)])

    guess, x = jnp.array([0.9, 0.7]), np.array([0.9, 0.7])
    for _ in range(12):
        x = x - np.linalg.solve(jax.jacfwd(f)(x, 0.3), f(x, 0.3))
    assert not np.abs(f(x, 0.3)).max() < 1e-12
    root = newton(f, guess, 0.3, tolerance=1e-12)
    assert np.abs(f(root.x, 0.3)).max() < 1e-12 and np.abs(root.x - guess).max() < 1


CASES = {
    0: (meeting, GUESS, ARGS, 20, "Converged: the residual went from 2.0e+00 to"),
    1: (lambda x, a: x**2 + 1.0, [0.5], None, 40, "no fraction of the step lowered it further"),
    2: (meeting, GUESS, ARGS, 2, "in 2 steps, 1.0e-10 was asked for; the steps were spent"),
    3: (lambda x, a: jnp.sqrt(x), [-1.0], None, 20, "the next residual was not finite"),
}


@pytest.mark.parametrize("code", CASES)
def test_outcomes_are_sentences(code):
    f, guess, args, most, words = CASES[code]
    root = newton(f, guess, args, max_steps=most, throw=False)
    assert root.code == code and root.converged == (code == 0)
    assert words in root.outcome and root.outcome.endswith(".")
    if code:
        for throw in (None, True):
            with pytest.raises(
                RuntimeError, match="Newton did not converge: the residual went from"
            ):
                newton(f, guess, args, max_steps=most, throw=throw)
    else:
        assert newton(f, guess, args, max_steps=most).x == pytest.approx(root.x)


@pytest.mark.slow
def test_the_best_iterate_is_returned():
    # no root: |x^2 + 1| is least, 1, at 0
    root = newton(lambda x, a: x**2 + 1.0, [0.5], max_steps=40, throw=False)
    assert root.residual == root.x[0] ** 2 + 1 and 1 <= root.residual < 1.01 and root.first == 1.25
    # a singular Jacobian: not one step
    root = newton(lambda x, a: x**2 - 1.0, [0.0], throw=False)
    assert root.x[0] == 0.0 and root.residual == 1.0 and not root.converged
    # a tolerance below rounding: stalled at the root
    root = newton(lambda x, a: x**2 - a, [1.0], 2.0, tolerance=0.0, max_steps=40, throw=False)
    assert abs(root.x[0] - 2**0.5) < 1e-15 and (root.code == 1 or root.residual == 0)


def test_a_root_as_guess_costs_one_jacobian():
    root = newton(lambda x, a: x - a, [2], 2.0)
    assert root.iterations == 1 and root.residual == 0 and root.x.dtype == float


def differences(f, x, h):
    shifted = x + h * np.concatenate([np.eye(len(x)), -np.eye(len(x))])
    plus, minus = np.split(np.asarray(jax.jit(jax.vmap(f))(shifted)), 2)
    return np.moveaxis(plus - minus, 0, -1) / (2 * h)


@pytest.mark.slow
def test_derivatives_of_the_root_in_the_arguments():
    root = lambda args: newton(meeting, GUESS, args, tolerance=1e-13).x
    first = differences(root, ARGS, 1e-5)
    forward, reverse = jax.jacfwd(root), jax.jacrev(root)
    assert_allclose(forward(ARGS), first, rtol=0, atol=1e-9)
    assert_allclose(reverse(ARGS), first, rtol=0, atol=1e-9)
    second = differences(forward, ARGS, 1e-5)
    for way in (jax.jacfwd(forward), jax.jacrev(forward)):
        assert_allclose(jax.jit(way)(ARGS), second, rtol=0, atol=1e-9)
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
    assert_allclose(roots.x[0], one.x, rtol=0, atol=1e-13)
    assert_allclose(roots.x[1], find(several[1]).x, rtol=0, atol=1e-13)
    assert roots.iterations[0] == one.iterations
    assert "Newton did not converge" in roots.outcome  # the worst of them
    assert_allclose(
        jax.vmap(jax.jacrev(lambda a: find(a).x))(several[:2])[0],
        jax.jacfwd(lambda a: find(a).x)(ARGS),
        rtol=0,
        atol=1e-12,
    )
    assert jax.eval_shape(find, ARGS).x.shape == (2,)


@pytest.mark.slow
def test_a_given_linearisation_is_used():
    calls = []

    def linearise(x, args):
        calls.append(0)
        return meeting(x, args), jax.jacfwd(meeting)(x, args)

    root = newton(meeting, GUESS, ARGS, linearise=linearise)
    assert calls and np.array_equal(root.x, newton(meeting, GUESS, ARGS).x)
    # a wrong slope converges slower, to the same root: the derivative is that of the residual
    half = lambda x, args: (meeting(x, args), 2 * jax.jacfwd(meeting)(x, args))
    slow = lambda args: newton(meeting, GUESS, args, linearise=half, max_steps=60).x
    assert_allclose(slow(ARGS), root.x, rtol=0, atol=1e-9)
    assert_allclose(
        jax.jacfwd(slow)(ARGS),
        jax.jacfwd(lambda a: newton(meeting, GUESS, a).x)(ARGS),
        rtol=0,
        atol=1e-8,
    )


@pytest.mark.parametrize(
    "bad, named",
    [
        (dict(tolerance=np.inf), "tolerance"),
        (dict(tolerance=np.nan), "tolerance"),
        (dict(tolerance=-1.0), "tolerance"),
    ],
)
def test_what_cannot_be_meant_is_refused(bad, named):
    with pytest.raises(ValueError, match=f"^{named}: expected"):
        newton(lambda x, args: x - 1, **{"guess": [2.0]} | bad)
