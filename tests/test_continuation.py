"""Branches of solutions by arclength: folds, branch points, and the ways in which a branch ends."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

from granjax.continuation import continuation


def circle(x, p, args):
    return x**2 + p**2 - 1.0


def cubic(x, p, args):
    return x**3 - x - p


def pitchfork(x, p, args):
    return p * x - x**3


def transcritical(x, p, args):
    return p * x - x**2


DOWN = {"direction": -1, "until": -2.0, "arclength": 0.1}


def check(f, curve, tolerance=1e-10, args=None):
    """Every point is a solution, with a unit tangent that points along the branch."""
    for x, p, tangent in zip(curve.x, curve.p, curve.tangents):
        assert np.abs(f(jnp.asarray(x), p, args)).max() <= tolerance
        along = jnp.asarray(tangent[:-1]), tangent[-1]
        slope = jax.jvp(lambda x, p: f(x, p, args), (jnp.asarray(x), p), along)[1]
        assert np.abs(slope).max() < 1e-11 and abs(np.linalg.norm(tangent) - 1) < 1e-14
    steps = np.diff(np.column_stack([curve.x, curve.p]), axis=0)
    assert np.all(np.sum(steps * curve.tangents[:-1], axis=1) > 0)


# folds --------------------------------------------------------------------------------------------------------------


def test_a_circle_closes_upon_itself():
    curve = continuation(circle, [1.0], 0.0, arclength=0.1)
    check(circle, curve)
    assert curve.outcome == "The branch closed upon itself."
    assert_allclose(curve.folds, [1.0, -1.0], rtol=0, atol=1e-10)
    assert [s.kind for s in curve.special] == ["fold", "fold"] and not len(curve.branch_points)
    for fold in curve.special:
        assert abs(fold.x[0]) < 1e-8 and (curve.x[fold.after, 0]) * curve.x[fold.after + 1, 0] < 0
        assert abs(fold.directions[0, 1]) < 1e-8


def test_folds_of_a_cubic():
    curve = continuation(cubic, [1.5], 1.875, **DOWN)
    check(cubic, curve)
    fold = 2 / (3 * np.sqrt(3))
    assert_allclose(curve.folds, [-fold, fold], rtol=0, atol=1e-12)
    assert_allclose([s.x[0] for s in curve.special], [3**-0.5, -(3**-0.5)], rtol=0, atol=1e-7)
    # few Jacobians for each point: the tangent predicts, steps adapt
    assert curve.newton < 5 * len(curve.p) and np.abs(np.diff(curve.x[:, 0])).max() > 0.1
    given = lambda x, p, args: (cubic(x, p, args), jnp.diag(3 * x**2 - 1))
    same = continuation(cubic, [1.5], 1.875, linearise=given, **DOWN)
    assert_allclose(same.x, curve.x, rtol=0, atol=1e-11)
    assert_allclose(same.folds, curve.folds, rtol=0, atol=1e-12)


def chebyshev(n):
    """Nodes on [0, 1], and the second derivative of what vanishes at both ends (Trefethen, Spectral Methods, cheb)."""
    x = np.cos(np.pi * np.arange(n + 1) / n)
    c = np.r_[2, np.ones(n - 1), 2] * (-1) ** np.arange(n + 1)
    d = np.outer(c, 1 / c) / (x[:, None] - x + np.eye(n + 1))
    d -= np.diag(d.sum(1))
    return (x[1:-1] + 1) / 2, 4 * (d @ d)[1:-1, 1:-1]


@pytest.mark.slow
def test_bratu():
    # u'' + p e^u = 0, u(0) = u(1) = 0: p = 8 (s^2 - 1) at the fold, where s tanh s = 1
    s = 1.0
    for _ in range(60):
        s = 1 / np.tanh(s)
    exact = 8 * (s**2 - 1)
    assert exact == pytest.approx(3.513830719, abs=1e-9)
    x, second = chebyshev(32)
    bratu = lambda u, p, second: second @ u + p * jnp.exp(u)
    curve = continuation(
        bratu,
        np.zeros(len(x)),
        0.0,
        args=second,
        arclength=0.2,
        until=-1.0,
        points=25,
        tolerance=1e-9,
        stop=lambda u, p: "far beyond the fold" if u.max() > 4 else None,
    )
    check(bratu, curve, 1e-9, second)
    assert len(curve.folds) == 1 and abs(curve.folds[0] - exact) < 1e-8
    assert curve.outcome == "Stopped: far beyond the fold."
    assert curve.x[-2].max() <= 4 < curve.x[-1].max() and curve.p[-1] < 1.5
    # u = 2 log(cosh(theta/4)/cosh(theta (x - 1/2)/2)) with theta^2 = 2 p cosh(theta/4)^2, on both sides of the fold
    middle = np.maximum(curve.x[:, len(x) // 2], 0)
    assert abs(x[len(x) // 2] - 0.5) < 1e-15 and len(curve.p) > 8
    own = 8 * np.arccosh(np.exp(middle / 2)) ** 2 / np.exp(middle)
    assert_allclose(own, curve.p, rtol=0, atol=1e-7)


# branch points ------------------------------------------------------------------------------------------------------


def test_a_pitchfork_and_its_other_branch():
    curve = continuation(pitchfork, [0.0], -1.0, until=1.0, arclength=0.11)
    check(pitchfork, curve)
    assert [s.kind for s in curve.special] == ["branch point"]
    assert abs(curve.branch_points[0]) < 1e-10
    point = curve.special[0]
    assert curve.p[point.after] < 0 < curve.p[point.after + 1]
    way = point.directions[1]
    assert_allclose(point.directions, [[0, 1], [np.sign(way[0]), 0]], atol=1e-8)
    other = continuation(pitchfork, point.x, point.p, direction=-way, until=1.0, arclength=0.1)
    check(pitchfork, other)
    assert_allclose(other.x[:, 0] ** 2, other.p, rtol=0, atol=1e-9)
    assert other.p[-1] == 1.0 and np.sign(other.x[-1, 0]) == -np.sign(way[0])
    # through the pitchfork along the parabola: it turns there (a fold), and the line crosses
    whole = continuation(pitchfork, [1.0], 1.0, direction=-1, until=(1.5,), arclength=0.07)
    assert whole.x[-1, 0] == pytest.approx(-(1.5**0.5), abs=1e-9)
    assert [s.kind for s in whole.special] == ["fold", "branch point"]
    # |F| <= 1e-10 leaves x to its cube root there, and p = x^2
    assert abs(whole.folds[0]) < 1e-6 and abs(whole.branch_points[0]) < 1e-6
    assert_allclose(whole.special[1].directions, [[-1, 0], [0, -1]], atol=5e-3)


def test_a_transcritical_crossing():
    curve = continuation(transcritical, [0.0], -1.0, until=1.0, arclength=0.13)
    check(transcritical, curve)
    assert abs(curve.branch_points[0]) < 1e-10 and len(curve.special) == 1
    point = curve.special[0]
    assert_allclose(point.directions, [[0, 1], [0.5**0.5, 0.5**0.5]], rtol=0, atol=1e-9)


def test_a_step_that_lands_on_a_branch_point_itself():
    # at p = 0 there is no tangent
    curve = continuation(pitchfork, [0.0], -1.0, until=1.0, arclength=0.25, longest_arclength=0.25)
    check(pitchfork, curve)
    assert curve.p[-1] == 1.0 and abs(curve.branch_points[0]) < 1e-10
    assert np.all(curve.x == 0) and not np.any(curve.p == 0)


def imperfect(x, p, e):
    return p * x - x**3 + e


@pytest.mark.slow
def test_no_branch_crosses_in_the_gap_of_an_imperfect_pitchfork():
    # p = x^2 - e/x is smooth; the other solution beyond the gap, x = -e/p, is not connected
    for e in 10.0 ** np.arange(-8, -1):
        curve = continuation(imperfect, [0.0], -1.0, args=e, until=1.0)
        assert not curve.special and np.all(curve.x > 0) and curve.p[-1] == 1.0
        assert curve.x[-1, 0] == pytest.approx(np.roots([-1, 0, 1, e]).max(), abs=1e-10)
    # also where branch points are not asked for
    curve = continuation(imperfect, [0.0], -1.0, args=1e-4, until=1.0, find=())
    assert np.all(curve.x > 0)


def test_a_gap_below_the_tolerance_is_a_branch_point():
    for e in (0.0, 1e-13, 1e-12):
        for arclength in (0.003, 0.01, 0.07):
            curve = continuation(imperfect, [0.0], -1.0, args=e, until=1.0, arclength=arclength)
            assert curve.p[-1] == 1.0 and abs(curve.x[-1, 0]) < 1e-9
            assert len(curve.branch_points) == 1 and abs(curve.branch_points[0]) < 1e-6


def test_kinds_that_are_not_asked_for_are_not_sought():
    assert not continuation(circle, [1.0], 0.0, arclength=0.1, find=("branch point",)).special
    straight = continuation(pitchfork, [0.0], -1.0, until=1.0, arclength=0.11, find=("fold",))
    assert not straight.special


# ends ---------------------------------------------------------------------------------------------------------------


def test_until_is_met_exactly_and_before_the_fold():
    until = 1 - 1e-9
    curve = continuation(circle, [1.0], 0.0, arclength=0.1, until=until)
    check(circle, curve)
    assert curve.p[-1] == until and curve.outcome == f"p reached {until:.6g}."
    assert curve.x[-1, 0] > 0 and curve.x[-1, 0] ** 2 == pytest.approx(1 - until**2, abs=1e-10)
    assert not len(curve.folds)


def test_either_of_two_values_ends_a_branch_also_beyond_a_fold():
    # from x = 0.6, p = 0.8 up to the fold and back, on the other side
    curve = continuation(circle, [0.6], 0.8, arclength=0.1, until=(0.5, 1.1))
    assert curve.p[-1] == 0.5 and curve.x[-1, 0] == pytest.approx(-np.sqrt(0.75), abs=1e-9)
    assert_allclose(curve.folds, [1.0], atol=1e-10)
    back = continuation(pitchfork, [0.0], 0.1, direction=-1, until=(-0.3, 0.4), arclength=0.03)
    assert back.p[-1] == -0.3


def test_a_veto_shortens_the_steps_and_says_why_where_none_is_short_enough():
    far = lambda x, p, x0, p0: "too far" if abs(x - x0)[0] > 0.02 else None
    curve = continuation(cubic, [1.5], 1.875, veto=far, points=400, **DOWN)
    check(cubic, curve)
    assert np.abs(np.diff(curve.x[:, 0])).max() <= 0.02
    assert curve.p[-1] == -2.0 and len(curve.folds) == 2
    wall = lambda x, p, *_: "a wall" if p > 2 else None
    curve = continuation(cubic, [1.5], 1.875, arclength=0.1, veto=wall)
    assert curve.outcome == "The step along the branch fell below 1.0e-05: vetoed, a wall."
    assert 2 - 1e-4 < curve.p[-1] <= 2


def test_a_branch_that_ends():
    # x = (1 - p)^{3/2} ends at p = 1
    ending = lambda x, p, a: x - (1 - p) ** 1.5
    curve = continuation(ending, [1.0], 0.0, arclength=0.1, longest_arclength=0.1)
    assert "fell below 1.0e-05: Newton did not converge: the residual went from" in curve.outcome
    assert 0.999 < curve.p[-1] <= 1


def test_points_and_steps_are_limited():
    line = lambda x, p, a: x - p
    curve = continuation(line, [0.0], 0.0, arclength=0.1, longest_arclength=0.3, points=7)
    assert curve.outcome == "The 7 points that were asked for." and len(curve.p) == 7
    lengths = np.linalg.norm(np.diff(np.column_stack([curve.x, curve.p]), axis=0), axis=1)
    assert lengths[0] == pytest.approx(0.1) and lengths.max() == pytest.approx(0.3)


def test_what_cannot_be_continued_is_refused():
    for name, value in (("arclength", 0.0), ("arclength", np.nan), ("find", ("hopf",))):
        with pytest.raises(ValueError, match=f"^{name}: expected"):
            continuation(circle, [1.0], 0.0, **{name: value})
    with pytest.raises(RuntimeError, match="The first point: Newton did not converge"):
        continuation(circle, [1.0], 3.0)
