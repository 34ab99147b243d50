"""A monotone cubic spline: a force law fitted to data."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..base.checks import concrete, non_negative, parameter, refuse, show
from ..base.types import Parameter, Values
from .base import Law, checked_preload


class Spline(Law):
    r"""A monotone cubic spline: F(e) = int_0^e k(x) dx, k(x) = sum_j k_j B_j(x) >= 0.

    The stiffness k(e) = F'(e) is a quadratic spline; its coefficients k_j >= 0 belong to B-splines,
    which are positive and sum to one. F is an I-spline, twice differentiable between the ends and
    linear in every k_j: `scipy.optimize.nnls` fits them to measured forces. k_0 and the last k_j
    are the stiffness at the end knots and beyond, where F is straight; each other k_j is nearly the
    stiffness midway between two knots. With k_0 = 0 the contact opens at the first knot.

    **Arguments:** `knots`: (K,) increasing compressions, first <= 0 <= last [m], plain numbers,
    static. `stiffness`: k_j >= 0 [N/m], (K + 1,), or (K + 1, bonds) for one law per bond; fit it
    with the bounds (0, None). `preload`: F0 >= 0 [N], the force at equilibrium. Typical: 4 to 12
    knots over the compressions that occur; the law is known only within the data.

    **Raises** ValueError for knots that do not increase or lie on one side of 0, a stiffness below
    0 or of another length, F0 < 0. Source: J. O. Ramsay, Statistical Science 3, 425 (1988).

    **Example:**

    >>> law = gx.Spline(knots=[-1.0, 0.0, 1.0], stiffness=[0.0, 1.0, 1.0, 1.0])
    >>> law.force(jnp.array([-1.0, 1.0])).round(4)
    Array([-0.6667,  1.    ], dtype=float64)

    Least squares: the force is the sum of k_j times that of one bond each.

    >>> from scipy.optimize import nnls
    >>> knots, e = np.linspace(0.0, 1.0, 5), np.linspace(0.0, 1.0, 50)
    >>> columns = gx.Spline(knots, np.eye(6)).force(e[:, None])
    >>> law = gx.Spline(knots, nnls(np.asarray(columns), e**1.5)[0])
    >>> round(float(law.force(0.64)), 2)
    0.51
    """

    _shown = {"knots": "knots", "stiffness": "_coefficients", "preload": "_preload"}
    _coefficients: tuple[jax.Array, ...]
    _preload: jax.Array | None
    knots: tuple[float, ...] = eqx.field(static=True)

    def __init__(self, knots: Values, stiffness: Parameter, preload: Parameter = 0.0):
        self.knots = _checked_knots(knots)
        stiffness = non_negative("stiffness", stiffness, "Where it is negative the force falls.")
        if stiffness.ndim == 0 or stiffness.shape[0] != len(self.knots) + 1:
            refuse(
                "stiffness",
                f"{len(self.knots) + 1} numbers, one more than knots",
                f"shape {stiffness.shape}",
            )
        # One leaf for each, scalars or arrays over the bonds, as in every law.
        self._coefficients = tuple(stiffness)
        self._preload = checked_preload("preload", preload, "A contact can only push.")

    @property
    def stiffness(self):
        """The coefficients k_j, (K + 1,)."""
        return jnp.stack(self._coefficients)

    @property
    def preload(self):
        return 0.0 if self._preload is None else self._preload

    def force(self, e):
        return sum(h * _mean_stiffness(h, *k) for h, _, *k in self._pieces(e))

    def energy(self, e):
        total = 0.0
        for h, beyond, k, slope, curve in self._pieces(e):
            within = h * h * (k / 2 + h * (slope / 6 + h * curve / 12))
            total = total + within + beyond * (h * _mean_stiffness(h, k, slope, curve))
        return total

    def _pieces(self, e):
        """Yield, per interval, the distances to e within and beyond it; k, k', k''/2 at its start.

        The start is the point nearest to equilibrium, so that no digits are lost near there.
        """
        middle = self._coefficients[1:-1]
        ends = [self._coefficients[0], *self._inner_ends(), self._coefficients[-1]]
        pieces = [
            (-np.inf, self.knots[0], self.knots[0], ends[0], 0.0, 0.0),
            (self.knots[-1], np.inf, self.knots[-1], ends[-1], 0.0, 0.0),
        ]
        for low, high, at_low, between, at_high in zip(
            self.knots, self.knots[1:], ends, middle, ends[1:]
        ):
            h = high - low
            start = min(max(low, 0.0), high)
            slope = 2 * (between - at_low) / h
            curve = (at_low - 2 * between + at_high) / h**2
            x = start - low
            k = at_high if start == high else at_low + x * (slope + x * curve)
            pieces.append((low, high, start, k, slope + 2 * x * curve, curve))
        for low, high, start, *k in pieces:
            there = jnp.where(e >= high, high, jnp.where(e < low, low, e))
            yield there - start, e - there, *k

    def _inner_ends(self):
        h = np.diff(self.knots).tolist()
        k = self._coefficients[1:-1]
        return [(h[i + 1] * k[i] + h[i] * k[i + 1]) / (h[i] + h[i + 1]) for i in range(len(h) - 1)]


def _mean_stiffness(h, k, slope, curve):
    return k + h * (slope / 2 + h * curve / 3)


def _checked_knots(knots):
    array = parameter("knots", knots)
    value = concrete(array)
    if value is None:
        refuse("knots", "plain numbers", "traced ones", "Knots are static: close over them.")
    if (
        value.ndim != 1
        or len(value) < 2
        or not (np.diff(value) > 0).all()
        or not value[0] <= 0 <= value[-1]
    ):
        remedy = "The force is measured from equilibrium, e = 0."
        refuse(
            "knots", "at least two numbers that increase, first <= 0 <= last", show(value), remedy
        )
    return tuple(value.tolist())
