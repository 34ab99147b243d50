"""The system that continuation solves at every point: corrector, tangents, the branch between two points."""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.optimize import brentq

from ..newton import evaluated, newton
from ..types import Count, Numbers, Pytree, Scalar

MOST_NEWTON = 10


class Point(NamedTuple):
    """A corrected point: derivatives (n, n + 1), tangent, sign of det of the two, which changes at branch points."""

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
        f, in_x, *in_p = self.slopes(x, p, inner)
        if not in_p:
            in_p = [jax.jvp(lambda p: self.function(x, p, inner), (p,), (jnp.ones_like(p),))[1]]
        return f, jnp.column_stack([in_x, *in_p])


@eqx.filter_jit
def _second(function, z, v, w, args):
    f = lambda z: function(z[:-1], z[-1], args)
    return jax.jvp(lambda z: jax.jvp(f, (z,), (v,))[1], (z,), (w,))[1]


class System:
    """Corrector and tangents of one problem."""

    def __init__(
        self,
        residual: Callable,
        linearise: Callable | None = None,
        args: Pytree = None,
        tolerance: Scalar = 1e-10,
    ):
        self.augmented = Bordered(residual, linearise)
        self.args, self.tolerance = args, tolerance
        self.scale = None

    def correct(
        self,
        guess: np.ndarray,
        border: np.ndarray,
        before: np.ndarray,
        most: Count = MOST_NEWTON,
        share: float = 1.0,
    ) -> tuple[Point | None, str]:
        """A `Point` in the plane through a guess across `border`, or `None` and why not.

        `before`: a tangent in the direction of the branch. `share`: of the tolerance, to which it goes on if it can.
        """
        guess = jnp.asarray(guess)
        root = newton(
            self.augmented.residual,
            guess,
            (self.args, jnp.asarray(border), guess),
            tolerance=share * self.tolerance,
            max_steps=most,
            linearise=self.augmented.linearise,
            throw=False,
            finish=False,
        )
        if not root.residual <= self.tolerance:
            return None, root.outcome.rstrip(".")
        jacobian = np.asarray(root.jacobian)[:-1]
        tangent, sign, size = _tangent(jacobian, before)
        # relative to the first point's, so that its size means how near to zero it is
        self.scale = size if self.scale is None else self.scale
        sign = float(sign * np.exp(np.clip(size - self.scale, -200, 200)))
        return Point(np.asarray(root.x), tangent, jacobian, sign, int(root.iterations)), ""

    def second(self, z: np.ndarray, v: np.ndarray, w: np.ndarray) -> np.ndarray:
        """D^2 F [v, w]."""
        return np.asarray(_second(self.augmented.function, *map(jnp.asarray, (z, v, w)), self.args))


def _tangent(jacobian, border):
    """The unit tangent of derivatives (n, n + 1) with border . tangent > 0, and slogdet of the two together."""
    square = np.vstack([jacobian, border])
    try:
        tangent = np.linalg.solve(square, np.eye(len(square))[-1])
    except np.linalg.LinAlgError:
        return np.full(len(square), np.nan), np.nan, np.nan
    tangent = tangent / np.linalg.norm(tangent)
    return tangent, *np.linalg.slogdet(np.vstack([jacobian, tangent]))


class Between:
    """The branch between two of its points, over the length s along a direction from the first.

    `direction`: a unit vector (n + 1,), by default the tangent at the first point. `share`: of the tolerance, to which
    Newton's method goes on if it can.
    """

    def __init__(
        self,
        system: System,
        here: Point,
        there: Point,
        direction: np.ndarray | None = None,
        share: float = 1.0,
    ):
        self.system, self.begin, self.share = system, here.z, share
        self.direction = here.tangent if direction is None else direction
        self.length = float((there.z - here.z) @ self.direction)
        self.known = {0.0: here, self.length: there}

    def at(self, s: float) -> Point:
        """The point in the plane across the direction at s. **Raises** RuntimeError where Newton's method fails."""
        if s not in self.known:
            predicted = self.begin + s * self.direction
            point, reason = self.system.correct(
                predicted, self.direction, self.direction, share=self.share
            )
            if point is None:
                raise RuntimeError(reason)
            self.known[s] = point
        return self.known[s]

    def zero(self, test: Callable[[Point], float], accuracy: float = 1e-13) -> Point:
        """Where a function of the point changes its sign, by Brent's method, to an accuracy of the length."""
        # no number at a branch point itself, where there is no tangent
        value = lambda s: np.nan_to_num(test(self.at(s)))
        try:
            return self.at(brentq(value, 0.0, self.length, xtol=accuracy * abs(self.length)))
        except RuntimeError:  # Newton's method failed on the way: as near as it came
            return self.at(min(self.known, key=lambda s: abs(value(s))))
