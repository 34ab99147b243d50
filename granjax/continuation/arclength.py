"""Solutions of F(x, p) = 0: branches by pseudo-arclength continuation, and deflation.

Deflation finds several solutions from one guess. The module contains no physics.
"""

import abc
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy
from jaxtyping import Float

from ..base.checks import one_of, positive, refuse
from ..base.derivatives import with_slope
from ..base.printing import told
from ..base.programs import compiled
from ..base.types import Count, Numbers, Parameter, Pytree, Scalar
from ..results import Result, array, hidden
from .newton import by_forward_mode, newton

__all__ = ["Curve", "Point", "Problem", "Special", "System", "another", "continuation"]

# The least cosine between the tangents at both ends of a step; a step with a smaller one is halved.
# A closed curve has a larger one between its first and its last tangent.
LEAST_COSINE = 0.9
# Where another branch crosses, the determinant vanishes up to this part of that at the ends of a
# step. Beyond a jump to a branch that does not cross, as over the gap of an imperfect pitchfork, it
# only changes its sign.
VANISHED = 1e-3
# A special point is where this function of a `Point` changes its sign.
TESTS = {"fold": lambda point: point.tangent[-1], "branch point": lambda point: point.sign}
# The share of the tolerance to which Newton's method goes on beside a special point, if it can.
# Beside a branch point the derivative is almost singular, and the residual that is left decides
# where the point is found.
CLOSER = {"fold": 1.0, "branch point": 1e-3}


class Problem(eqx.Module):
    """F(x, p) = 0, with as many equations as unknowns x, and a parameter p. Write `residual`."""

    @abc.abstractmethod
    def residual(self, x: Numbers, p: Scalar) -> Numbers:
        """Return F(x, p), (n,)."""

    def linearise(self, x: Numbers, p: Scalar) -> tuple:
        """Return (F, dF/dx), or (F, dF/dx, dF/dp) if that costs no more.

        The default is forward mode.
        """
        return by_forward_mode(self.residual, x, p)


class _Given(Problem):
    function: Callable
    args: Pytree
    slopes: Callable | None

    def residual(self, x, p):
        return self.function(x, p, self.args)

    def linearise(self, x, p):
        return super().linearise(x, p) if self.slopes is None else self.slopes(x, p, self.args)


class Special(NamedTuple):
    """A special point of a branch.

    `kind`: "fold" or "branch point". `x`, `p`: where it is. `after`: the index of the point before.
    `directions`: unit tangents (x, p) of the branches that meet at a branch point, the traced one
    first.
    """

    kind: str
    x: Float[np.ndarray, " n"]
    p: float
    after: int
    directions: Float[np.ndarray, "branches n_and_p"]
    __repr__ = told


def places(events: Sequence, kind: str) -> Float[np.ndarray, " place"]:
    """Return where the events of a kind are."""
    return np.array([event.p for event in events if event.kind == kind])


class Curve(Result):
    """A branch, the special points on it, and why it ended."""

    x: Float[np.ndarray, "point unknown"] = array("The unknowns of every point.")
    p: Float[np.ndarray, " point"] = array("The parameter of every point.")
    tangents: Float[np.ndarray, "point tangent"] = array("Unit tangents.")
    special: tuple[Special, ...] = array("The special points, in the order of the branch.")
    newton: int = array("The number of Jacobians that were evaluated.")
    end: str = array(
        'Why the branch ended: "p", "points", "stop", "step", "closed" or "other".', static=True
    )
    reason: str = hidden("More about the end.", static=True)

    @property
    def folds(self) -> Float[np.ndarray, " F"]:
        """Values of the parameter at the folds."""
        return places(self.special, "fold")

    @property
    def branch_points(self) -> Float[np.ndarray, " B"]:
        """Values of the parameter where another branch crosses."""
        return places(self.special, "branch point")

    @property
    def steps(self) -> list[tuple["Point", "Point"]]:
        """Pairs of neighbouring points."""
        zs = np.column_stack([self.x, self.p])
        points = [Point(z, tangent) for z, tangent in zip(zs, self.tangents)]
        return list(zip(points[:-1], points[1:]))

    @property
    def outcome(self) -> str:
        """Why the branch ended."""
        return {
            "p": f"p reached {self.p[-1]:.6g}.",
            "points": f"The {len(self.p)} points that were asked for.",
            "stop": f"Stopped: {self.reason}.",
            "step": f"The step along the branch fell below {self.reason}.",
            "closed": "The branch closed upon itself.",
            "other": f"Ended: {self.reason}.",
        }[self.end]


def continuation(
    residual: Callable[[Any, Any, Any], Any] | Problem,
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

    Each point is predicted along the tangent, at a distance s in the plain norm of (x, p), and
    corrected by Newton's method in the plane across the tangent. So it passes folds, where dp = 0.
    The step grows if Newton needs few iterations. It shrinks if Newton needs many or fails, the
    branch turns by more than 25 degrees, or the step jumps to another.

    **Arguments:**

    - `residual`: F(x, p, args), (n,) to (n,), or a `Problem`.
    - `x0`, `p0`: a solution, or near one, corrected first.
    - `until`: end where p reaches this value (a pair: either of two); the last point lies exactly
      there.
    - `direction`: +-1, the direction in which p changes first. Or a tangent (n + 1,), as in
      `Special.directions`: then `x0`, `p0` is a branch point, and the first point is sought beside
      it.
    - `arclength`, `least_arclength`, `longest_arclength`: first, least (arclength/1e4) and longest
      (10 arclength) step along the branch.
    - `points`: the most points. `tolerance`: of max |F|.
    - `args`, `linearise`: for a function: its arguments, and (x, p, args) -> (F, dF/dx) or (F,
      dF/dx, dF/dp), if that is cheaper than `jax.jacfwd`. A `Problem` has its own.
    - `veto`: (x, p, x_before, p_before) -> a reason to take a shorter step instead, or `None`.
    - `stop`: (x, p) -> a reason to end the branch there, or `None`.
    - `find`: which special points to locate, of "fold" and "branch point".

    **Returns:** `Curve`; `outcome` says why it ended. **Raises** ValueError for invalid input,
    RuntimeError if the first point does not converge.

    **Example:**

    >>> curve = gx.continuation.continuation(lambda x, p, args: x**2 + p - 1, [1.0], 0.0, until=(-1.0, 2.0))
    >>> curve.folds.round(4), curve.outcome
    (array([1.]), 'p reached -1.')
    """
    for kind in find:
        one_of("find", kind, TESTS)
    arclength = float(positive("arclength", arclength))
    least_arclength = 1e-4 * arclength if least_arclength is None else least_arclength
    longest_arclength = 10 * arclength if longest_arclength is None else longest_arclength
    bounds = () if until is None else tuple(np.atleast_1d(np.asarray(until, float)))
    x0 = np.atleast_1d(np.asarray(x0, float))
    if x0.ndim != 1:
        refuse("x0", "a vector of unknowns, shape (n,)", f"shape {x0.shape}")
    direction = np.asarray(direction, float)
    if direction.shape not in ((), (x0.size + 1,)) or not direction.any():
        wanted = f"1, -1 or a tangent of shape ({x0.size + 1},)"
        refuse("direction", wanted, f"shape {direction.shape}")
    if not isinstance(residual, Problem):
        residual = _Given(residual, args, linearise)
    system = System(residual, tolerance)
    only_p = np.eye(x0.size + 1)[-1]
    z = np.append(x0, float(p0))
    if direction.ndim:
        tangent = direction / np.linalg.norm(direction)
        first = z + arclength * tangent, tangent, tangent
        said = "No solution beside the branch point"
    else:
        first = z, only_p, direction * only_p, 20
        said = "The first point"
    try:
        here = system.correct(*first)
    except NotFound as failed:
        raise RuntimeError(f"{said}: {failed}.") from None
    zs = [here.z]
    tangents = [here.tangent]
    special = []
    farthest = 0.0
    end = "points"
    reason = ""
    iterations = here.iterations
    while len(zs) < points:
        if arclength < least_arclength:
            end = "step"
            reason = f"{least_arclength:.1e}: {reason}"
            break
        try:
            there = _advance(system, here, arclength, veto)
            bound, near = _bound_met(system, here, there, bounds)
            if near is not None:
                there = system.correct(np.append(near.x, bound), only_p, near.tangent)
        except NotFound as failed:
            reason = str(failed)
            arclength /= 2
            continue
        met = {
            kind: system.zero(here, there, test, share=CLOSER[kind])
            for kind, test in TESTS.items()
            if kind in (*find, "branch point") and test(here) * test(there) < 0
        }
        crossing = met.get("branch point")
        vanished = VANISHED * max(abs(here.sign), abs(there.sign))
        # With the least step, what is left is the tolerance of the points.
        if crossing and abs(crossing.sign) > vanished and arclength / 2 >= least_arclength:
            arclength /= 2
            continue
        for kind in find:
            if kind in met:
                ways = directions(system, kind, met[kind], here.tangent)
                special.append(Special(kind, met[kind].x, met[kind].p, len(zs) - 1, ways))
        here = there
        zs.append(here.z)
        tangents.append(here.tangent)
        iterations += here.iterations
        if near is not None:
            end = "p"
            break
        why = None if stop is None else stop(here.x, here.p)
        if why:
            end = "stop"
            reason = why
            break
        farthest = max(farthest, float(np.linalg.norm(here.z - zs[0])))
        if len(zs) > 3 and _closed(zs, tangents, arclength, farthest):
            end = "closed"
            break
        # Four iterations of Newton's method are the target.
        factor = 2.0 ** ((4 - here.iterations) / 2)
        arclength = float(np.clip(factor * arclength, least_arclength, longest_arclength))
    z = np.stack(zs)
    return Curve(z[:, :-1], z[:, -1], np.stack(tangents), tuple(special), iterations, end, reason)


class NotFound(RuntimeError):
    """Newton's method found no point of the branch where one was sought."""


class Point(NamedTuple):
    """A corrected point of a branch.

    `jacobian`: (n, n + 1). `sign`: that of det of the Jacobian and the tangent, which changes at
    branch points.
    """

    z: Float[np.ndarray, " n_and_p"]
    tangent: Float[np.ndarray, " n_and_p"]
    jacobian: Float[np.ndarray, "n n_and_p"] | None = None
    sign: float = np.nan
    iterations: int = 0

    @property
    def x(self) -> np.ndarray:
        return self.z[:-1]

    @property
    def p(self) -> float:
        return float(self.z[-1])


class _Bordered(eqx.Module):
    # F(x, p) = 0 and border . (z - z_predicted) = 0, for Newton's method.

    problem: Problem

    def residual(self, z, args):
        return self.linearise(z, args)[0]

    def linearise(self, z, args):
        border, predicted = args
        return bordered(self.problem, lambda z: border @ (z - predicted), z)


def bordered(problem: Problem, condition: Callable, z: Numbers) -> tuple:
    """Return F and a condition at z = (x, p), and their derivative."""
    x = z[:-1]
    p = z[-1]
    f, in_x, *in_p = problem.linearise(x, p)
    if not in_p:
        in_p = [with_slope(lambda p: problem.residual(x, p), p)[1]]
    value, row = jax.value_and_grad(condition)(z)
    return jnp.append(f, value), jnp.vstack([jnp.column_stack([in_x, *in_p]), row])


class System:
    """The system that continuation solves at every point of a branch."""

    def __init__(self, problem: Problem, tolerance: Scalar):
        self.bordered = _Bordered(problem)
        self.tolerance = tolerance
        self.scale = None

    def correct(
        self,
        guess: np.ndarray,
        border: np.ndarray,
        before: np.ndarray,
        most: Count = 10,
        share: float = 1.0,
    ) -> Point:
        """Return the `Point` in the plane through a guess across `border`, or raise `NotFound`.

        `before`: a tangent in the direction of the branch. `share`: of the tolerance, to which it
        goes on if it can.
        """
        guess, border = jax.device_put((guess, border))
        root = newton(
            self.bordered.residual,
            guess,
            (border, guess),
            tolerance=share * self.tolerance,
            max_steps=most,
            linearise=self.bordered.linearise,
            throw=False,
            finish=False,
        )
        if not float(root.residual) <= self.tolerance:
            raise NotFound(root.outcome.rstrip("."))
        jacobian = np.asarray(root.jacobian)[:-1]
        square = np.vstack([jacobian, before])
        sign = np.nan
        size = np.nan
        try:
            tangent = np.linalg.solve(square, np.eye(len(square))[-1])
            tangent = tangent / np.linalg.norm(tangent)
            sign, size = np.linalg.slogdet(np.vstack([jacobian, tangent]))
        except np.linalg.LinAlgError:
            tangent = np.full(len(square), np.nan)
        # Relative to the first point's, so that its size tells how near to zero it is.
        self.scale = size if self.scale is None else self.scale
        sign = float(sign * np.exp(np.clip(size - self.scale, -200, 200)))
        return Point(np.asarray(root.x), tangent, jacobian, sign, int(root.iterations))

    def zero(
        self,
        here: Point,
        there: Point,
        test: Callable[[Point], float],
        accuracy: float = 1e-13,
        direction: np.ndarray | None = None,
        share: float = 1.0,
    ) -> Point:
        """Return where a function changes its sign between two points, by Brent's method.

        `direction`: a unit vector (n + 1,) across which points are sought, by default the tangent
        at the first point. `accuracy`: relative to the length along it. `share`: of the tolerance,
        to which Newton's method goes on if it can.
        """
        direction = here.tangent if direction is None else direction
        length = float((there.z - here.z) @ direction)
        known = {0.0: here, length: there}
        # Not a number at a branch point itself, where there is no tangent.
        value = lambda point: np.nan_to_num(test(point))

        def at(s):
            if s not in known:
                guess = here.z + s * direction
                known[s] = self.correct(guess, direction, direction, share=share)
            return known[s]

        try:
            return at(
                scipy.optimize.brentq(
                    lambda s: value(at(s)), 0.0, length, xtol=accuracy * abs(length)
                )
            )
        except NotFound:  # Take the nearest point.
            return min(known.values(), key=lambda point: abs(value(point)))


def _advance(system, here, arclength, veto):
    there = system.correct(here.z + arclength * here.tangent, here.tangent, here.tangent)
    # There is no tangent (NaN) if the step has met a branch point itself.
    if not there.tangent @ here.tangent >= LEAST_COSINE:
        said = "the branch turns faster than the step resolves, or another branch was met"
        raise NotFound(said)
    why = None if veto is None else veto(there.x, there.p, here.x, here.p)
    if why:
        raise NotFound(f"vetoed, {why}")
    return there


def _bound_met(system, here, there, bounds):
    # The bound that p meets first between two points, and a point of the branch near it.
    if not bounds:
        return None, None
    # p may turn back on the way. Up to the fold, and from there on, it is monotone.
    test = TESTS["fold"]
    turn = [system.zero(here, there, test)] if test(here) * test(there) < 0 else []
    for a, b in zip([here, *turn], [*turn, there]):
        between = [bound for bound in bounds if (a.p - bound) * (b.p - bound) < 0 or b.p == bound]
        if between:
            bound = min(between, key=lambda bound: abs(bound - a.p))
            return bound, system.zero(a, b, lambda point: point.p - bound)
    return None, None


@compiled
def _second(problem, z, v, w):
    # D^2 F [v, w].
    f = lambda z: problem.residual(z[:-1], z[-1])
    return jax.jvp(lambda z: jax.jvp(f, (z,), (v,))[1], (z,), (w,))[1]


def directions(
    system: System, kind: str, point: Point, before: np.ndarray
) -> Float[np.ndarray, "branches n_and_p"]:
    """Return tangents of the branches at a special point, the nearest to `before` first."""
    if kind == "fold":
        return point.tangent[None]
    # dF has two null vectors and a left one, psi. A tangent v lies in their plane and satisfies psi
    # . D^2 F [v, v] = 0.
    left, _, right = np.linalg.svd(point.jacobian)
    plane = right[-2:]
    psi = left[:, -1]
    second = lambda v, w: np.asarray(_second(system.bordered.problem, point.z, v, w))
    form = np.array([[psi @ second(v, w) for v in plane] for w in plane])
    (low, high), axes = np.linalg.eigh((form + form.T) / 2)
    if low < 0 < high:
        both = (
            np.stack(
                [np.sqrt(high) * axes[:, 0] + sign * np.sqrt(-low) * axes[:, 1] for sign in (1, -1)]
            )
            @ plane
        )
        both /= np.linalg.norm(both, axis=1, keepdims=True)
    else:  # No two branches cross: the traced one, and what is orthogonal to it.
        own = plane @ before / np.linalg.norm(plane @ before)
        both = np.stack([own, [-own[1], own[0]]]) @ plane
    both = both[np.argsort(-np.abs(both @ before), kind="stable")]
    return both * np.where(both @ before < 0, -1, 1)[:, None]


def _closed(zs, tangents, arclength, farthest):
    # Whether the last step passed the first point, from afar and in its direction.
    before, now = ((z - zs[0]) @ tangents[0] for z in zs[-2:])
    far = np.linalg.norm(zs[-1] - zs[0])
    return bool(
        before < 0 <= now
        and far < 2 * arclength
        and farthest > 4 * far
        and tangents[-1] @ tangents[0] > LEAST_COSINE
    )


# The residual that Newton's method with deflation leaves, relative to the size of the guesses times
# the largest entry of the derivative at the start. An unknown below this part of the size counts as
# zero. Numbers of a type leave some units of rounding.
LEFT = 1e-11
UNITS = 50
# The least distance of two solutions, relative to the size of the guesses.
APART = 1e-5
# The longest step of Newton's method with deflation, relative to the size.
LONGEST = 0.3
# In the second half of its steps Newton's method with deflation begins again beside the guess each
# time that this many have passed.
CYCLE = 25


@compiled
def linearised(problem: Problem, x: Numbers, p: Scalar) -> tuple:
    """Return (F, dF/dx) of a problem."""
    return problem.linearise(x, p)[:2]


def solve(problem: Problem, root: np.ndarray, others: Sequence[np.ndarray], size: float) -> list:
    """Return which unknowns solve F(x, 0) = 0 as well as a root that `another` finds."""
    slope = np.abs(linearised(problem, root, np.float64(0))[1]).max()
    left = [np.abs(residual_of(problem, x, np.float64(0))).max() for x in others]
    return [bool(x <= 1e2 * _left(slope) * size * slope) for x in left]


def _left(x):
    return max(LEFT, UNITS * float(np.finfo(x.dtype).eps))


@compiled
def residual_of(problem: Problem, x: Numbers, p: Scalar) -> Numbers:
    """Return F(x, p) of a problem."""
    return problem.residual(x, p)


def another(
    problem: Problem,
    guess: np.ndarray,
    known: Sequence[np.ndarray],
    size: float,
    max_steps: Count = 400,
) -> np.ndarray | None:
    """Return a solution of F(x, 0) = 0 other than the known ones, by deflation, or `None`.

    Newton's method is applied to F times the product of 1 + (size/|x - x_j|)^2 over the known
    solutions x_j, which are not roots of it. Its step is Newton's own times a number.
    Source: Farrell, Birkisson, Funke, SIAM J. Sci. Comput. 37, A2026 (2015).
    """
    known_here = lambda x: any(np.abs(x - other).max() <= APART * size for other in known)
    x = guess
    largest = None
    random = np.random.default_rng(0)
    for i in range(max_steps):
        again = max(i - max_steps // 2, 0)
        # Next to a known solution the product has no direction of its own; the way may be a cycle.
        if known_here(x) if i == 0 else again and again % CYCLE == 0:
            x = guess + (1 + again / CYCLE) * LONGEST / 2 * size * random.uniform(-1, 1, guess.size)
        f, jacobian = map(np.asarray, linearised(problem, x, np.float64(0)))
        if not (np.isfinite(f).all() and np.isfinite(jacobian).all()):
            return None
        largest = np.abs(jacobian).max() if largest is None else largest
        least = _left(f) * size
        if np.abs(f).max() <= least * largest:
            return None if known_here(x) else np.where(np.abs(x) > least, x, 0)
        away = [(x - other) / size for other in known]
        slope = sum(-2 * d / (d @ d * (d @ d + 1)) for d in away) / size
        step = np.linalg.lstsq(jacobian, -f)[0]
        step = step / (1 - np.dot(slope, step))
        # The step is not halved: on its way to another solution the product rises and falls.
        x = x + step * min(1, LONGEST * size / np.abs(step).max())
    return None
