"""Points between two points of a branch: folds, branch points, given values of the parameter."""

from collections.abc import Callable

import numpy as np

from .curve import Special
from .system import Point, System

MOST_TRIALS = 40


def bound_met(system: System, here: Point, there: Point, bounds: tuple | np.ndarray) -> tuple:
    """The bound that p meets first between two points, and a point of the branch near it."""
    if bounds:
        # p may turn back on the way: up to the fold and from there on it is monotone
        turn = (
            [zero(system, here, there, lambda point: point.test("fold"))]
            if here.crosses(there, "fold")
            else []
        )
        for a, b in zip([here, *turn], [*turn, there]):
            between = [
                bound for bound in bounds if (a.p - bound) * (b.p - bound) < 0 or b.p == bound
            ]
            if between:
                bound = min(between, key=lambda bound: abs(bound - a.p))
                return bound, zero(system, a, b, lambda point: point.p - bound)
    return None, None


def located(system: System, kind: str, here: Point, there: Point, after: int) -> Special:
    """A fold or branch point between two points, and the tangents there."""
    best = zero(system, here, there, lambda point: point.test(kind))
    return Special(kind, best.x, best.p, after, directions(system, kind, best, here.tangent))


def zero(system: System, here: Point, there: Point, test: Callable) -> Point:
    """Where a function of the point changes its sign, by the method of Illinois on the length along the tangent."""
    low, high = 0.0, (there.z - here.z) @ here.tangent
    f_low, f_high = test(here), test(there)
    best = min((here, there), key=lambda point: abs(test(point)))
    for _ in range(MOST_TRIALS):
        s = high - f_high * (high - low) / (f_high - f_low)
        point, _ = system.correct(here.z + s * here.tangent, here.tangent, here.tangent)
        if point is None:
            break
        f, best = test(point), point
        if f * f_high <= 0:
            low, f_low = high, f_high
        else:
            f_low /= 2
        high, f_high = s, f
        if (
            not f
            or np.isnan(f)
            or abs(high - low) <= 1e-13 * abs(np.linalg.norm(there.z - here.z))
            or f_high == f_low
        ):
            break
    return best


def directions(system: System, kind: str, point: Point, before: np.ndarray) -> np.ndarray:
    """Tangents of the branches that meet at a special point, the one nearest to `before` first."""
    if kind == "fold":
        return point.tangent[None]
    # dF has two null vectors and one from the left, psi: a tangent v is in their plane, and psi . D^2 F [v, v] = 0
    left, _, right = np.linalg.svd(point.jacobian)
    plane, psi = right[-2:], left[:, -1]
    form = np.array([[psi @ system.second(point.z, v, w) for v in plane] for w in plane])
    (low, high), axes = np.linalg.eigh((form + form.T) / 2)
    if low < 0 < high:
        both = (
            np.stack(
                [np.sqrt(high) * axes[:, 0] + sign * np.sqrt(-low) * axes[:, 1] for sign in (1, -1)]
            )
            @ plane
        )
        both /= np.linalg.norm(both, axis=1, keepdims=True)
    else:  # no two branches that cross: the traced one, and what is orthogonal to it in the plane
        own = plane @ before / np.linalg.norm(plane @ before)
        both = np.stack([own, [-own[1], own[0]]]) @ plane
    both = both[np.argsort(-np.abs(both @ before), kind="stable")]
    return both * np.where(both @ before < 0, -1, 1)[:, None]
