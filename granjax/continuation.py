"""Branches of solutions of F(x, p) = 0 by pseudo-arclength continuation. It knows no physics."""

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .checks import one_of, refuse
from .newton import newton

TARGET, MOST_NEWTON = 4, 10
LEAST_COSINE = 0.9
LOCATE = 40


class Special(NamedTuple):
    """A point found on a branch: `kind` "fold" or "branch point", `x`, `p`, and `after`, the index of the point before.

    `directions`: unit tangents (x, p) of the branches that meet at a branch point, the traced one first.
    """

    kind: str
    x: np.ndarray
    p: float
    after: int
    directions: np.ndarray


class Curve(NamedTuple):
    """A branch: `x` (P, n), `p` (P,), unit tangents (P, n + 1), what was found on it, and why it ended.

    `newton`: Jacobians taken in all. `outcome`: a sentence.
    """

    x: np.ndarray
    p: np.ndarray
    tangents: np.ndarray
    special: tuple[Special, ...]
    newton: int
    outcome: str

    @property
    def folds(self):
        """Values of the parameter at the folds."""
        return np.array([s.p for s in self.special if s.kind == "fold"])

    @property
    def branch_points(self):
        """Values of the parameter where another branch crosses."""
        return np.array([s.p for s in self.special if s.kind == "branch point"])


def continuation(
    residual, x0, p0, *, args=None, until=None, direction=1.0, step=0.01, least_step=None, longest_step=None,
    points=200, tolerance=1e-10, linearise=None, veto=None, stop=None, find=("fold", "branch point"),
):
    r"""Follow F(x, p) = 0 from (x0, p0) by pseudo-arclength.

    Each point is predicted along the tangent, at a distance s in the plain norm of (x, p), and corrected by Newton's
    method in the plane across it; so the branch is followed through folds, where dp = 0. The step grows where Newton
    needs few iterations and shrinks where it needs many, fails, or turns by more than 25 degrees.

    **Arguments:**

    - `residual`: F(x, p, args), (n,) to (n,). `x0`, `p0`: a solution, or near one: it is corrected first.
    - `until`: end where p reaches this value (a pair: either of two); the last point lies exactly there.
    - `direction`: +-1, the way p changes first; or a tangent (n + 1,), as in `Special.directions`: then `x0`, `p0` is a
      branch point, and the first point is sought beside it.
    - `step`, `least_step`, `longest_step`: first, least (step/1e4) and longest (10 step) length along the branch.
    - `points`: the most points. `tolerance`: of max |F|.
    - `linearise`: (x, p, args) -> (F, dF/dx), where that is cheaper than `jax.jacfwd`.
    - `veto`: (x, p, x_before, p_before) -> a reason to take a shorter step instead, or `None`.
    - `stop`: (x, p) -> a reason to end the branch there, or `None`.
    - `find`: which special points are located, of "fold" and "branch point".

    **Returns:** `Curve`; `outcome` says why it ended. **Raises** ValueError for input that cannot be meant,
    RuntimeError where the first point does not converge.
    """
    for kind in find:
        one_of("find", kind, ("fold", "branch point"))
    if not step > 0:
        refuse("step", "a length above zero", repr(step))
    least_step, longest_step = least_step or step * 1e-4, longest_step or step * 10
    bounds = () if until is None else tuple(np.atleast_1d(np.asarray(until, float)))
    system = _System(residual, linearise, args, tolerance)
    here = system.first(np.asarray(x0, float), float(p0), direction, step)
    trace, special, outcome = [here], [], f"The {points} points that were asked for."
    newton_steps, reason = here.steps, ""
    while len(trace) < points:
        if step < least_step:
            outcome = f"The step fell below {least_step:.1e}: {reason}."
            break
        here = trace[-1]
        there, reason = _advance(system, here, step, veto)
        if there is None:
            step /= 2
            continue
        bound, near = _met(system, here, there, bounds)
        if near is not None:
            there = system.at(near.z, bound, near.tangent)
            if there is None:
                reason, step = f"Newton failed at p = {bound:.6g}", step / 2
                continue
        special += [_located(system, kind, here, there, len(trace) - 1) for kind in find if here.crosses(there, kind)]
        trace.append(there)
        newton_steps += there.steps
        if near is not None:
            outcome = f"p reached {bound:.6g}."
            break
        why = None if stop is None else stop(there.x, there.p)
        if why:
            outcome = f"Stopped: {why}."
            break
        if _closed(trace, step):
            outcome = "The branch closed upon itself."
            break
        step = float(np.clip(step * 2.0 ** ((TARGET - there.steps) / 2), least_step, longest_step))
    z = np.stack([point.z for point in trace])
    tangents = np.stack([point.tangent for point in trace])
    return Curve(z[:, :-1], z[:, -1], tangents, tuple(special), newton_steps, outcome)


class _Point(NamedTuple):
    """A corrected point: tangent, sign of det of (dF; tangent), which changes where branches cross."""

    z: np.ndarray
    tangent: np.ndarray
    sign: float
    steps: int

    @property
    def x(self):
        return self.z[:-1]

    @property
    def p(self):
        return float(self.z[-1])

    def test(self, kind):
        return self.tangent[-1] if kind == "fold" else self.sign

    def crosses(self, other, kind):
        return self.test(kind) * other.test(kind) < 0


class Bordered(eqx.Module):
    """F(x, p) = 0 and border . (z - z_predicted) = 0, for Newton."""

    function: Callable
    slopes: Callable | None

    def residual(self, z, args):
        inner, border, predicted = args
        return jnp.append(self.function(z[:-1], z[-1], inner), border @ (z - predicted))

    def linearise(self, z, args):
        inner, border, predicted = args
        f, jacobian = self.jacobian(z, inner)
        return jnp.append(f, border @ (z - predicted)), jnp.vstack([jacobian, border])

    def jacobian(self, z, inner):
        """F and (dF/dx, dF/dp), (n, n + 1)."""
        x, p = z[:-1], z[-1]
        if self.slopes is None:
            twice = lambda z: (self.function(z[:-1], z[-1], inner),) * 2
            jacobian, f = jax.jacfwd(twice, has_aux=True)(z)
            return f, jacobian
        f, in_x = self.slopes(x, p, inner)
        _, in_p = jax.jvp(lambda p: self.function(x, p, inner), (p,), (jnp.ones_like(p),))
        return f, jnp.column_stack([in_x, in_p])


@eqx.filter_jit
def tangent_at(augmented, z, args, border):
    """The unit tangent with border . tangent > 0, and the logarithm and sign of the bordered determinant."""
    _, jacobian = augmented.jacobian(z, args)
    square = jnp.vstack([jacobian, border])
    tangent = jnp.linalg.solve(square, jnp.zeros_like(z).at[-1].set(1.0))
    tangent = tangent / jnp.linalg.norm(tangent)
    sign, size = jnp.linalg.slogdet(jnp.vstack([jacobian, tangent]))
    return tangent, sign, size, jacobian


class _System:
    """Corrector and tangents of one problem."""

    def __init__(self, residual, linearise, args, tolerance):
        self.augmented, self.args, self.tolerance = Bordered(residual, linearise), args, tolerance
        self.scale = None

    def first(self, x0, p0, direction, step):
        z = np.append(x0, p0)
        if np.ndim(direction):
            tangent = np.asarray(direction, float) / np.linalg.norm(direction)
            point, reason = self.correct(z + step * tangent, tangent, tangent)
            if point is None:
                raise RuntimeError(f"No solution beside the branch point: {reason}.")
            return point
        only_p = np.append(np.zeros_like(x0), 1.0)
        root = self._newton(z, only_p, z, 2 * MOST_NEWTON)
        if not root.converged:
            raise RuntimeError(f"The first point: {root.outcome}")
        return self._point(np.asarray(root.x), direction * only_p, int(root.steps))

    def correct(self, predicted, border, before):
        """A `_Point` in the plane across `border`, or `None` and why not."""
        root = self._newton(predicted, border, predicted, MOST_NEWTON)
        if not root.converged:
            return None, root.outcome.rstrip(".")
        return self._point(np.asarray(root.x), before, int(root.steps)), ""

    def at(self, z, p, before):
        """The point with this p, or `None`."""
        only_p = np.append(np.zeros(len(z) - 1), 1.0)
        guess = np.append(z[:-1] + before[:-1] * np.clip((p - z[-1]) / (before[-1] or 1), -1, 1), p)
        root = self._newton(guess, only_p, guess, MOST_NEWTON)
        return self._point(np.asarray(root.x), before, int(root.steps)) if root.converged else None

    def jacobian(self, z):
        return np.asarray(eqx.filter_jit(self.augmented.jacobian)(jnp.asarray(z), self.args)[1])

    def _newton(self, guess, border, predicted, most):
        arguments = self.args, jnp.asarray(border), jnp.asarray(predicted)
        return newton(self.augmented.residual, jnp.asarray(guess), arguments, tolerance=self.tolerance,
                      max_steps=most, linearise=self.augmented.linearise, throw=False)

    def _point(self, z, before, steps):
        tangent, sign, size, _ = tangent_at(self.augmented, jnp.asarray(z), self.args, jnp.asarray(before))
        # relative to the first point's, so that its size means how near to zero it is
        self.scale = float(size) if self.scale is None else self.scale
        return _Point(z, np.asarray(tangent), float(sign * jnp.exp(jnp.clip(size - self.scale, -200, 200))), steps)


def _advance(system, here, step, veto):
    there, reason = system.correct(here.z + step * here.tangent, here.tangent, here.tangent)
    if there is None:
        return None, reason
    # no tangent (NaN) where the step has met a branch point itself
    if not there.tangent @ here.tangent >= LEAST_COSINE:
        return None, "the branch turns faster than the step resolves, or another branch was met"
    why = None if veto is None else veto(there.x, there.p, here.x, here.p)
    return (None, f"vetoed, {why}") if why else (there, "")


def _met(system, here, there, bounds):
    """The bound that p meets first between two points, and a point of the branch near it."""
    if bounds:
        # p may turn back on the way: up to the fold and from there on it is monotone
        turn = [_zero(system, here, there, lambda point: point.test("fold"))] if here.crosses(there, "fold") else []
        for a, b in zip([here, *turn], [*turn, there]):
            met = [bound for bound in bounds if (a.p - bound) * (b.p - bound) < 0 or b.p == bound]
            if met:
                bound = min(met, key=lambda bound: abs(bound - a.p))
                return bound, _zero(system, a, b, lambda point: point.p - bound)
    return None, None


def _located(system, kind, here, there, after):
    best = _zero(system, here, there, lambda point: point.test(kind))
    return Special(kind, best.x, best.p, after, _directions(system, kind, best, here.tangent))


def _zero(system, here, there, test):
    """Where a function of the point changes its sign, by the method of Illinois on the length along the tangent."""
    low, high = 0.0, (there.z - here.z) @ here.tangent
    f_low, f_high = test(here), test(there)
    best = min((here, there), key=lambda point: abs(test(point)))
    for _ in range(LOCATE):
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
        if not f or np.isnan(f) or abs(high - low) <= 1e-13 * abs(np.linalg.norm(there.z - here.z)) or f_high == f_low:
            break
    return best


def _directions(system, kind, point, before):
    if kind == "fold":
        return point.tangent[None]
    # at a simple branch point dF has two null vectors: the branch's own tangent, and what is orthogonal to it
    null = np.linalg.svd(system.jacobian(point.z))[2][-2:]
    own = null.T @ (null @ before)
    own /= np.linalg.norm(own)
    other = null - np.outer(null @ own, own)
    other = other[np.argmax(np.linalg.norm(other, axis=1))]
    return np.stack([own, other / np.linalg.norm(other)])


def _closed(trace, step):
    if len(trace) < 4:
        return False
    away = np.array([np.linalg.norm(point.z - trace[0].z) for point in trace])
    crossed = (trace[-2].z - trace[0].z) @ trace[0].tangent < 0 <= (trace[-1].z - trace[0].z) @ trace[0].tangent
    return bool(crossed and away[-1] < 2 * step and away.max() > 4 * away[-1] and
                trace[-1].tangent @ trace[0].tangent > LEAST_COSINE)
