"""The walk along a branch."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ..checks import one_of, positive, refuse
from ..types import Count, Parameter, Scalar
from .curve import Curve, Special
from .system import MOST_NEWTON, Between, System

TARGET = 4
LEAST_COSINE = 0.9
# of the tolerance, to which points beside a branch point are solved if they can be: the derivative is almost singular
# there, and what is left of the residual decides where it is found
CLOSER = {"fold": 1.0, "branch point": 1e-3}


def continuation(
    residual: Callable[[Any, Any, Any], Any],
    x0: Parameter,
    p0: Scalar,
    *,
    args: Any = None,
    until: Parameter | None = None,
    direction: Parameter = 1.0,
    arclength: Scalar = 0.01,
    least_arclength: Scalar | None = None,
    longest_arclength: Scalar | None = None,
    points: Count = 200,
    tolerance: Scalar = 1e-10,
    linearise: Callable[[Any, Any, Any], Any] | None = None,
    veto: Callable[[Any, Any, Any, Any], Any] | None = None,
    stop: Callable[[Any, Any], Any] | None = None,
    find: Sequence[str] = ("fold", "branch point"),
) -> Curve:
    r"""Follow F(x, p) = 0 from (x0, p0) by pseudo-arclength.

    Each point is predicted along the tangent, at a distance s in the plain norm of (x, p), and corrected by Newton's
    method in the plane across it; so the branch is followed through folds, where dp = 0. The step grows where Newton
    needs few iterations and shrinks where it needs many, fails, or turns by more than 25 degrees.

    **Arguments:**

    - `residual`: F(x, p, args), (n,) to (n,). `x0`, `p0`: a solution, or near one: it is corrected first.
    - `until`: end where p reaches this value (a pair: either of two); the last point lies exactly there.
    - `direction`: +-1, the way p changes first; or a tangent (n + 1,), as in `Special.directions`: then `x0`, `p0` is a
      branch point, and the first point is sought beside it.
    - `arclength`, `least_arclength`, `longest_arclength`: first, step along the branch, least
      (arclength/1e4) and longest (10 arclength).
    - `points`: the most points. `tolerance`: of max |F|.
    - `linearise`: (x, p, args) -> (F, dF/dx) or (F, dF/dx, dF/dp), where that is cheaper than `jax.jacfwd`.
    - `veto`: (x, p, x_before, p_before) -> a reason to take a shorter step instead, or `None`.
    - `stop`: (x, p) -> a reason to end the branch there, or `None`.
    - `find`: which special points are located, of "fold" and "branch point".

    **Returns:** `Curve`; `outcome` says why it ended. **Raises** ValueError for input that cannot be meant,
    RuntimeError where the first point does not converge.

    **Example:**

    >>> curve = gx.continuation.continuation(lambda x, p, args: x**2 + p - 1, [1.0], 0.0, until=(-1.0, 2.0))
    >>> curve.folds.round(4), curve.outcome
    (array([1.]), 'p reached -1.')
    """
    for kind in find:
        one_of("find", kind, ("fold", "branch point"))
    arclength = float(positive("arclength", arclength))
    least_arclength = 1e-4 * arclength if least_arclength is None else least_arclength
    longest_arclength = 10 * arclength if longest_arclength is None else longest_arclength
    bounds = () if until is None else tuple(np.atleast_1d(np.asarray(until, float)))
    x0 = np.atleast_1d(np.asarray(x0, float))
    if x0.ndim != 1:
        refuse("x0", "a row of unknowns, shape (n,)", f"shape {x0.shape}")
    direction = np.asarray(direction, float)
    if direction.shape not in ((), (x0.size + 1,)) or not direction.any():
        refuse(
            "direction", f"1, -1 or a tangent of shape ({x0.size + 1},)", f"shape {direction.shape}"
        )
    system = System(residual, linearise, args, tolerance)
    here = _first(system, np.append(x0, float(p0)), direction, arclength)
    zs, tangents, special, farthest = [here.z], [here.tangent], [], 0.0
    outcome, iterations, reason = f"The {points} points that were asked for.", here.iterations, ""
    while len(zs) < points:
        if arclength < least_arclength:
            outcome = f"The step along the branch fell below {least_arclength:.1e}: {reason}."
            break
        there, reason = _advance(system, here, arclength, veto)
        if there is None:
            arclength /= 2
            continue
        bound, near = _bound_met(system, here, there, bounds)
        if near is not None:
            there, _ = system.correct(np.append(near.x, bound), _only_p(x0.size), near.tangent)
            if there is None:
                reason, arclength = f"Newton failed at p = {bound:.6g}", arclength / 2
                continue
        for kind in find:
            if here.crosses(there, kind):
                way = Between(system, here, there, share=CLOSER[kind])
                best = way.zero(lambda point: point.test(kind))
                ways = _directions(system, kind, best, here.tangent)
                special.append(Special(kind, best.x, best.p, len(zs) - 1, ways))
        here = there
        zs.append(here.z)
        tangents.append(here.tangent)
        iterations += here.iterations
        if near is not None:
            outcome = f"p reached {bound:.6g}."
            break
        why = None if stop is None else stop(here.x, here.p)
        if why:
            outcome = f"Stopped: {why}."
            break
        farthest = max(farthest, float(np.linalg.norm(here.z - zs[0])))
        if len(zs) > 3 and _closed(zs, tangents, arclength, farthest):
            outcome = "The branch closed upon itself."
            break
        factor = 2.0 ** ((TARGET - here.iterations) / 2)
        arclength = float(np.clip(factor * arclength, least_arclength, longest_arclength))
    z = np.stack(zs)
    return Curve(z[:, :-1], z[:, -1], np.stack(tangents), tuple(special), iterations, outcome)


def _only_p(size):
    return np.append(np.zeros(size), 1.0)


def _first(system, z, direction, arclength):
    """The first point: that with the p of z, or at a length beside z in a direction."""
    if direction.ndim:
        tangent = direction / np.linalg.norm(direction)
        point, reason = system.correct(z + arclength * tangent, tangent, tangent)
        said = "No solution beside the branch point"
    else:
        only_p = _only_p(z.size - 1)
        point, reason = system.correct(z, only_p, direction * only_p, 2 * MOST_NEWTON)
        said = "The first point"
    if point is None:
        raise RuntimeError(f"{said}: {reason}.")
    return point


def _advance(system, here, arclength, veto):
    there, reason = system.correct(here.z + arclength * here.tangent, here.tangent, here.tangent)
    if there is None:
        return None, reason
    # no tangent (NaN) where the step has met a branch point itself
    if not there.tangent @ here.tangent >= LEAST_COSINE:
        return None, "the branch turns faster than the step resolves, or another branch was met"
    why = None if veto is None else veto(there.x, there.p, here.x, here.p)
    return (None, f"vetoed, {why}") if why else (there, "")


def _bound_met(system, here, there, bounds):
    """The bound that p meets first between two points, and a point of the branch near it."""
    if not bounds:
        return None, None
    # p may turn back on the way: up to the fold and from there on it is monotone
    turns = here.crosses(there, "fold")
    turn = [Between(system, here, there).zero(lambda point: point.test("fold"))] if turns else []
    for a, b in zip([here, *turn], [*turn, there]):
        between = [bound for bound in bounds if (a.p - bound) * (b.p - bound) < 0 or b.p == bound]
        if between:
            bound = min(between, key=lambda bound: abs(bound - a.p))
            return bound, Between(system, a, b).zero(lambda point: point.p - bound)
    return None, None


def _directions(system, kind, point, before):
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


def _closed(zs, tangents, arclength, farthest):
    """Whether the last step went past the first point, from afar and in its direction."""
    before, now = ((z - zs[0]) @ tangents[0] for z in zs[-2:])
    far = np.linalg.norm(zs[-1] - zs[0])
    return bool(
        before < 0 <= now
        and far < 2 * arclength
        and farthest > 4 * far
        and tangents[-1] @ tangents[0] > LEAST_COSINE
    )
