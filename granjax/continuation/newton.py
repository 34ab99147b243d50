"""Newton's method for a square system, with outcomes as values and implicit derivatives."""

import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..base.checks import described, refuse, traced
from ..base.programs import compiled, in_numpy
from ..base.types import Count, Counts, Flags, Numbers, Parameter, Scalar
from ..results import Result, array

__all__ = ["Root", "newton"]

CONVERGED, STALLED, SPENT, NOT_FINITE = range(4)
# The least fraction of a step that is tried before the iteration counts as stalled.
LEAST_FRACTION = 2.0**-8
# After Newton's step has failed, directions with singular values below this, relative to the norm,
# are not trusted.
FLAT = 1e-6


class Root(Result):
    """The end of Newton's method: its best iterate.

    `code`: 0 converged, 1 stalled, 2 steps spent, 3 not finite.
    """

    x: Numbers = array("The iterate.", axes="unknown")
    jacobian: Numbers = array("dF/dx at the iterate.", axes="equation unknown")
    residual: Numbers = array("max |F(x)| of the iterate before the finishing step.")
    first: Numbers = array("max |F(x)| of the guess.")
    iterations: Counts = array("The number of Jacobians that were evaluated.")
    code: Counts = array("How the iteration ended.")
    tolerance: Numbers = array("The tolerance of the residual.")

    @property
    def converged(self) -> Flags:
        """Whether the residual came below the tolerance."""
        return in_numpy(self.code) == CONVERGED

    @property
    def outcome(self) -> str:
        """How the iteration ended, in one sentence (the worst of several)."""
        parts = self.code, self.iterations, self.first, self.residual, self.tolerance
        if traced(parts):
            return "traced"
        parts = np.broadcast_arrays(*map(np.asarray, parts))
        worst = int(np.argmax(parts[0]))
        code, iterations, first, last, tolerance = (x.ravel()[worst].item() for x in parts)
        went = f"the residual went from {first:.1e} to {last:.1e} in {int(iterations)} steps"
        if code == CONVERGED:
            return f"Converged: {went}."
        wanted = f"{tolerance:.1e} was asked for"
        why = {
            STALLED: "no fraction of the step lowered it further (a poor guess, a fold, or the floor of rounding)",
            SPENT: "the steps were spent",
            NOT_FINITE: "the next residual was not finite",
        }[code]
        return f"Newton did not converge: {went}, {wanted}; {why}."


def newton(
    residual: Callable[[Any, Any], Any],
    guess: Parameter,
    args: Any = None,
    *,
    tolerance: Scalar = 1e-10,
    max_steps: Count = 20,
    linearise: Callable[[Any, Any], Any] | None = None,
    throw: bool | None = None,
    finish: bool = True,
) -> Root:
    r"""Find a root of F(x, args) = 0 by Newton's method with halved steps.

    x <- x - lambda J^{-1} F with lambda = 1, 1/2, ... until max |F| falls. After a full step fails,
    J^{-1} is that of Levenberg and Marquardt: where the derivative is almost singular along a
    family of almost-roots, such as a soliton that may stand anywhere, Newton's step would turn
    rounding into large steps. The root is differentiable in `args`, in both modes and to any order:
    dx = -J^{-1} (dF/d args). Inside `jit` and `vmap` it is one loop.

    **Arguments:**

    - `residual`: F(x, args), arrays (n,) to (n,). `guess`: the first iterate. `args`: any pytree.
    - `tolerance`: of max |F|, in the units of F. `max_steps`: the most Jacobians.
    - `linearise`: (x, args) -> (F, J), if that is cheaper than `jax.jacfwd`.
    - `throw`: raise if it does not converge; `None` does so outside of transformations.
    - `finish`: from a converged root take one more step with the derivative there, which costs
      nothing.

    **Returns:** `Root`, with the best iterate. **Raises** ValueError for a guess that is not a row
    of numbers, a tolerance that is infinite or below zero; RuntimeError if `throw` and it did not
    converge, with the residuals.

    **Example:**

    >>> root = gx.newton.newton(lambda x, a: x**2 - a, [1.0], 2.0)
    >>> round(float(root.x[0]), 6)
    1.414214
    """
    # device_put, because a conversion is a program to compile.
    known = not (isinstance(guess, jax.Array) or traced(guess))
    x0 = jax.device_put(np.array(guess)) if known else jnp.asarray(guess)
    if x0.ndim != 1:
        refuse("guess", "a vector of unknowns, shape (n,)", f"shape {x0.shape}")
    if not traced(tolerance) and not 0 <= float(tolerance) < np.inf:
        refuse("tolerance", "one finite number not below zero", repr(tolerance))
    x0 = x0.astype(jnp.result_type(x0, float)) if not jnp.issubdtype(x0.dtype, jnp.floating) else x0
    # A plain number is an input of the compiled program, not a part of it.
    args = jax.tree.map(lambda leaf: jnp.asarray(leaf) if isinstance(leaf, float) else leaf, args)
    inputs = (
        residual,
        linearise,
        x0,
        args,
        _number(tolerance, x0.dtype),
        _number(max_steps, int),
        finish,
    )
    # Without tracers there is no differentiation. A function may hide tracers, which the result
    # then shows.
    root = None if traced(inputs) else _solved(*inputs, differentiable=False)
    if root is None or traced(root):
        root = _solved(*inputs, differentiable=True)
    if not traced(root) and (throw is None or throw) and not np.all(root.converged):
        raise RuntimeError(root.outcome)
    return root


def _number(x, dtype):
    return jnp.asarray(x, dtype) if traced(x) else jax.device_put(np.asarray(x, dtype))


@compiled
def _solved(residual, linearise, x0, args, tolerance, max_steps, finish, differentiable):
    both = functools.partial(by_forward_mode, residual) if linearise is None else linearise
    if not differentiable:
        x, rest = _iterate(both, x0, args, tolerance, max_steps, finish)
        return Root(x, *rest, tolerance)

    def solve(f, x0):
        del f
        x, rest = _iterate(both, x0, jax.lax.stop_gradient(args), tolerance, max_steps, finish)
        # Integers have no tangents of a kind that `custom_root` could give them.
        return x, tuple(jnp.asarray(part, x0.dtype) for part in rest)

    def tangent_solve(g, y):
        return jnp.linalg.solve(jax.jacfwd(g)(jnp.zeros_like(y)), y)

    x, (*rest, steps, code) = jax.lax.custom_root(
        lambda x: evaluated(residual, x, args), x0, solve, tangent_solve, has_aux=True
    )
    return Root(x, *rest, steps.astype(int), code.astype(int), tolerance)


def by_forward_mode(residual: Callable, x: Numbers, *others: Any) -> tuple:
    """Return (F, dF/dx) of F(x, ...), in one pass."""
    both = lambda x: (evaluated(residual, x, *others),) * 2
    jacobian, value = jax.jacfwd(both, has_aux=True)(x)
    return value, jacobian


def evaluated(residual: Callable, x: Numbers, *others: Any) -> Numbers:
    """Return F(x, ...), as many numbers as unknowns."""
    found = residual(x, *others)
    if not isinstance(found, (jax.Array, np.ndarray)) or found.shape != x.shape:
        refuse(
            "residual",
            f"a function that gives an array of shape {x.shape}",
            f"one that gives {described(found)}",
        )
    return found


def _size(f):
    return jnp.where(jnp.all(jnp.isfinite(f)), jnp.max(jnp.abs(f)), jnp.inf)


def _gentle(jacobian, f):
    # The step of Levenberg and Marquardt, which leaves out directions to which the derivative is
    # almost blind.
    damping = (FLAT * jnp.linalg.norm(jacobian)) ** 2 * jnp.eye(f.size, dtype=f.dtype)
    return -jnp.linalg.solve(jacobian.T @ jacobian + damping, jacobian.T @ f)


def _iterate(both, x0, args, tolerance, max_steps, finish):
    # Returns (x, (jacobian, residual, first, steps, code)). The first turn of the loop evaluates
    # the guess.

    def going(carry):
        size = carry["size"]
        steps = carry["steps"]
        unfinished = (size > tolerance) & jnp.isfinite(size) & (carry["fraction"] >= LEAST_FRACTION)
        return (steps == 0) | unfinished & (steps < max_steps)

    def body(c):
        tried = c["x"] + c["fraction"] * c["step"]
        f, jacobian = both(tried, args)
        new = _size(f)
        better = new < c["size"]
        best = {"x": tried, "f": f, "jacobian": jacobian, "size": new}
        best = {name: jnp.where(better, value, c[name]) for name, value in best.items()}
        # Newton's step, or the gentle one if the first has failed, or half of that.
        again = ~better & ~c["gentle"]
        step = jax.lax.cond(
            better | again,
            lambda: jax.lax.cond(
                better,
                lambda: -jnp.linalg.solve(jacobian, f),
                lambda: _gentle(best["jacobian"], best["f"]),
            ),
            lambda: c["step"],
        )
        fraction = jnp.where(better | again, 1.0, c["fraction"] / 2).astype(x0.dtype)
        first = jnp.where(c["steps"] == 0, new, c["first"])
        return {
            **best,
            "step": step,
            "gentle": ~better,
            "fraction": fraction,
            "first": first,
            "last": new,
            "steps": c["steps"] + 1,
        }

    one = jnp.ones((), x0.dtype)
    n = x0.size
    start = {
        "x": x0,
        "f": 0 * x0,
        "jacobian": jnp.full((n, n), jnp.nan, x0.dtype),
        "size": jnp.inf * one,
        "step": 0 * x0,
        "gentle": jnp.zeros((), bool),
        "fraction": one,
        "first": one,
        "last": one,
        "steps": jnp.zeros((), int),
    }
    end = jax.lax.while_loop(going, body, start)
    code = jnp.where(end["fraction"] < LEAST_FRACTION, STALLED, SPENT)
    code = jnp.where(jnp.isfinite(end["last"]), code, NOT_FINITE)
    code = jnp.where(end["size"] <= tolerance, CONVERGED, code)
    x = end["x"]
    if finish:
        moved = nearby(x, -jnp.linalg.solve(end["jacobian"], end["f"]))
        x = jnp.where(code == CONVERGED, moved, x)
    return x, (end["jacobian"], end["size"], end["first"], end["steps"], code)


def nearby(x: Numbers, step: Numbers) -> Numbers:
    """Return x + step if the step is finite and a small part of x, else x."""
    small = jnp.max(jnp.abs(step), initial=0) <= FLAT * jnp.max(jnp.abs(x), initial=0)
    return jnp.where(small, x + step, x)
