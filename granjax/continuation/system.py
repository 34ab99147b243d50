"""The system that continuation solves at every point: corrector, tangents, derivatives."""

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..newton import newton

MOST_NEWTON = 10


class Point(NamedTuple):
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


@eqx.filter_jit
def _second(function, z, v, w, args):
    f = lambda z: function(z[:-1], z[-1], args)
    return jax.jvp(lambda z: jax.jvp(f, (z,), (v,))[1], (z,), (w,))[1]


class System:
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
        """A `Point` in the plane across `border`, or `None` and why not."""
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

    def second(self, z, v, w):
        """D^2 F [v, w]."""
        return np.asarray(_second(self.augmented.function, jnp.asarray(z), jnp.asarray(v), jnp.asarray(w), self.args))

    def _newton(self, guess, border, predicted, most):
        arguments = self.args, jnp.asarray(border), jnp.asarray(predicted)
        return newton(self.augmented.residual, jnp.asarray(guess), arguments, tolerance=self.tolerance,
                      max_steps=most, linearise=self.augmented.linearise, throw=False)

    def _point(self, z, before, steps):
        tangent, sign, size, _ = tangent_at(self.augmented, jnp.asarray(z), self.args, jnp.asarray(before))
        # relative to the first point's, so that its size means how near to zero it is
        self.scale = float(size) if self.scale is None else self.scale
        return Point(z, np.asarray(tangent), float(sign * jnp.exp(jnp.clip(size - self.scale, -200, 200))), steps)
