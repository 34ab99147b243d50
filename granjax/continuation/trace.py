"""The walk along a branch."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ..checks import one_of, positive, refuse
from ..types import Count, Parameter, Scalar
from .curve import Curve
from .locate import bound_met, located
from .system import System

TARGET = 4
LEAST_COSINE = 0.9


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
    here = system.first(x0, float(p0), direction, arclength)
    trace, special, outcome = [here], [], f"The {points} points that were asked for."
    iterations, reason = here.iterations, ""
    while len(trace) < points:
        if arclength < least_arclength:
            outcome = f"The step along the branch fell below {least_arclength:.1e}: {reason}."
            break
        here = trace[-1]
        there, reason = _advance(system, here, arclength, veto)
        if there is None:
            arclength /= 2
            continue
        bound, near = bound_met(system, here, there, bounds)
        if near is not None:
            there = system.at(near.z, bound, near.tangent)
            if there is None:
                reason, arclength = f"Newton failed at p = {bound:.6g}", arclength / 2
                continue
        special += [
            located(system, kind, here, there, len(trace) - 1)
            for kind in find
            if here.crosses(there, kind)
        ]
        trace.append(there)
        iterations += there.iterations
        if near is not None:
            outcome = f"p reached {bound:.6g}."
            break
        why = None if stop is None else stop(there.x, there.p)
        if why:
            outcome = f"Stopped: {why}."
            break
        if _closed(trace, arclength):
            outcome = "The branch closed upon itself."
            break
        factor = 2.0 ** ((TARGET - there.iterations) / 2)
        arclength = float(np.clip(factor * arclength, least_arclength, longest_arclength))
    z = np.stack([point.z for point in trace])
    tangents = np.stack([point.tangent for point in trace])
    return Curve(z[:, :-1], z[:, -1], tangents, tuple(special), iterations, outcome)


def _advance(system, here, arclength, veto):
    there, reason = system.correct(here.z + arclength * here.tangent, here.tangent, here.tangent)
    if there is None:
        return None, reason
    # no tangent (NaN) where the step has met a branch point itself
    if not there.tangent @ here.tangent >= LEAST_COSINE:
        return None, "the branch turns faster than the step resolves, or another branch was met"
    why = None if veto is None else veto(there.x, there.p, here.x, here.p)
    return (None, f"vetoed, {why}") if why else (there, "")


def _closed(trace, arclength):
    if len(trace) < 4:
        return False
    away = np.array([np.linalg.norm(point.z - trace[0].z) for point in trace])
    crossed = (
        (trace[-2].z - trace[0].z) @ trace[0].tangent
        < 0
        <= (trace[-1].z - trace[0].z) @ trace[0].tangent
    )
    return bool(
        crossed
        and away[-1] < 2 * arclength
        and away.max() > 4 * away[-1]
        and trace[-1].tangent @ trace[0].tangent > LEAST_COSINE
    )
