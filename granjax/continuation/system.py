"""The system that continuation solves at every point: corrector, tangents, derivatives."""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ..newton import CONVERGED, evaluated, newton
from ..types import Numbers, Parameter, Pytree, Scalar

MOST_NEWTON = 10


class Point(NamedTuple):
    """A corrected point: derivatives (n, n + 1), tangent, sign of det of the two, which changes at branch points."""

    z: Float[np.ndarray, " n_and_p"]
    jacobian: Float[np.ndarray, "n n_and_p"]
    tangent: Float[np.ndarray, " n_and_p"]
    sign: float
    iterations: int

    @property
    def x(self) -> np.ndarray:
        return self.z[:-1]

    @property
    def p(self) -> float:
        return float(self.z[-1])

    def test(self, kind: str) -> float:
        return self.tangent[-1] if kind == "fold" else self.sign

    def crosses(self, other: "Point", kind: str) -> bool:
        return bool(self.test(kind) * other.test(kind) < 0)


class Bordered(eqx.Module):
    """F(x, p) = 0 and border . (z - z_predicted) = 0, for Newton."""

    function: Callable
    slopes: Callable | None

    def residual(self, z: Numbers, args: Any) -> Numbers:
        """F and what is missing along the border."""
        inner, border, predicted = args
        return jnp.append(evaluated(self.function, z[:-1], z[-1], inner), border @ (z - predicted))

    def linearise(self, z: Numbers, args: Any) -> tuple:
        """The residual and its derivatives."""
        inner, border, predicted = args
        f, jacobian = self.jacobian(z, inner)
        return jnp.append(f, border @ (z - predicted)), jnp.vstack([jacobian, border])

    def jacobian(self, z: Numbers, inner: Pytree) -> tuple:
        """F and (dF/dx, dF/dp), (n, n + 1)."""
        x, p = z[:-1], z[-1]
        if self.slopes is None:
            twice = lambda z: (evaluated(self.function, z[:-1], z[-1], inner),) * 2
            jacobian, f = jax.jacfwd(twice, has_aux=True)(z)
            return f, jacobian
        found = self.slopes(x, p, inner)
        f, in_x, *in_p = found
        if not in_p:
            in_p = [jax.jvp(lambda p: self.function(x, p, inner), (p,), (jnp.ones_like(p),))[1]]
        return f, jnp.column_stack([in_x, *in_p])


def tangent_at(jacobian: np.ndarray, border: np.ndarray) -> tuple:
    """The unit tangent of derivatives (n, n + 1) with border . tangent > 0, and slogdet of the two together."""
    square = np.vstack([jacobian, border])
    try:
        tangent = np.linalg.solve(square, np.eye(len(square))[-1])
    except np.linalg.LinAlgError:
        return np.full(len(square), np.nan), np.nan, np.nan
    tangent = tangent / np.linalg.norm(tangent)
    return tangent, *np.linalg.slogdet(np.vstack([jacobian, tangent]))


@eqx.filter_jit
def _second(function, z, v, w, args):
    f = lambda z: function(z[:-1], z[-1], args)
    return jax.jvp(lambda z: jax.jvp(f, (z,), (v,))[1], (z,), (w,))[1]


def _converged(root):
    return int(root.code) == CONVERGED


class System:
    """Corrector and tangents of one problem."""

    def __init__(self, residual, linearise, args, tolerance):
        self.augmented = Bordered(residual, linearise)
        self.args, self.tolerance = args, tolerance
        self.scale = None

    def first(self, x0: np.ndarray, p0: float, direction: Parameter, arclength: Scalar) -> Point:
        z = np.append(x0, p0)
        if np.ndim(direction):
            tangent = np.asarray(direction, float) / np.linalg.norm(direction)
            point, reason = self.correct(z + arclength * tangent, tangent, tangent)
            if point is None:
                raise RuntimeError(f"No solution beside the branch point: {reason}.")
            return point
        only_p = np.append(np.zeros_like(x0), 1.0)
        root = self._newton(z, only_p, z, 2 * MOST_NEWTON)
        if not _converged(root):
            raise RuntimeError(f"The first point: {root.outcome}")
        return self._point(root, direction * only_p)

    def correct(self, predicted: np.ndarray, border: np.ndarray, before: np.ndarray) -> tuple:
        """A `Point` in the plane across `border`, or `None` and why not."""
        root = self._newton(predicted, border, predicted, MOST_NEWTON)
        if not _converged(root):
            return None, root.outcome.rstrip(".")
        return self._point(root, before), ""

    def at(self, z: np.ndarray, p: Scalar, before: np.ndarray) -> Point | None:
        """The point with this p, or `None`."""
        only_p = np.append(np.zeros(len(z) - 1), 1.0)
        guess = np.append(z[:-1] + before[:-1] * np.clip((p - z[-1]) / (before[-1] or 1), -1, 1), p)
        root = self._newton(guess, only_p, guess, MOST_NEWTON)
        return self._point(root, before) if _converged(root) else None

    def second(self, z: np.ndarray, v: np.ndarray, w: np.ndarray) -> np.ndarray:
        """D^2 F [v, w]."""
        return np.asarray(
            _second(
                self.augmented.function, jnp.asarray(z), jnp.asarray(v), jnp.asarray(w), self.args
            )
        )

    def _newton(self, guess, border, predicted, most):
        arguments = self.args, jnp.asarray(border), jnp.asarray(predicted)
        return newton(
            self.augmented.residual,
            jnp.asarray(guess),
            arguments,
            tolerance=self.tolerance,
            max_steps=most,
            linearise=self.augmented.linearise,
            throw=False,
            finish=False,
        )

    def _point(self, root, before):
        jacobian = np.asarray(root.jacobian)[:-1]
        tangent, sign, size = tangent_at(jacobian, before)
        # relative to the first point's, so that its size means how near to zero it is
        self.scale = size if self.scale is None else self.scale
        sign = sign * np.exp(np.clip(size - self.scale, -200, 200))
        return Point(np.asarray(root.x), jacobian, tangent, float(sign), int(root.iterations))
