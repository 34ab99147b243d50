"""A monotone cubic spline: a force law without a formula, to be found from data."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import nnls

from ..checks import concrete, non_negative, parameter, refuse, show
from ..types import Parameter, Values
from .base import Law, checked_preload


class Spline(Law):
    r"""A force law as a cubic spline that never falls: F(e) = int_0^e k(x) dx, k(x) = sum_j k_j B_j(x) >= 0.

    The stiffness k(e) = F'(e) is a quadratic spline; its coefficients k_j >= 0 are those of B-splines, which are
    positive and sum to one. F is then monotone (an I-spline), twice differentiable between the ends and linear in
    every k_j: fitted to forces, it is a linear least-squares problem. k_0 and the last k_j are the stiffness at the
    end knots and beyond them, where F goes on as a straight line; each of the others is nearly the stiffness midway
    between two knots. k_0 = 0 makes a contact that opens at the first knot.

    **Arguments:** `knots`: (K,) compressions that increase, with first <= 0 <= last [m]; plain numbers, static.
    `stiffness`: k_j >= 0 [N/m], (K + 1,), or (K + 1, bonds) for one law per bond; what a fit moves, with the bounds
    (0, None). `preload`: F0 >= 0 [N], the force at equilibrium.

    Typical: 4 to 12 knots over the compressions that occur; the law is known only where the data have been.
    **Raises** ValueError for knots that do not increase or lie on one side of 0, a stiffness below 0 or of another
    length, F0 < 0. Source: J. O. Ramsay, Statistical Science 3, 425 (1988).

    **Example:**

    >>> law = gx.Spline(knots=[-1.0, 0.0, 1.0], stiffness=[0.0, 1.0, 1.0, 1.0])
    >>> law.force(jnp.array([-1.0, 1.0])).round(4)
    Array([-0.6667,  1.    ], dtype=float64)
    """

    positive = ("coefficients",)
    held = ("preload",)
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
        # a leaf for each: scalars, or arrays over the bonds, as the parameters of any law
        self._coefficients = tuple(stiffness)
        self._preload = checked_preload("preload", preload, "A contact can only push.")

    @classmethod
    def fitted(cls, knots, e, force, preload=0.0):
        """The spline nearest, in least squares, to forces measured at some compressions: a static test.

        **Arguments:** `knots`, `preload`: as for `Spline`; `e`, `force`: (n,) compressions and forces beyond the
        preload, n > K. **Raises** ValueError for too few points or lists of different length.
        """
        e, force = np.asarray(parameter("e", e)), np.asarray(parameter("force", force))
        knots = _checked_knots(knots)
        if e.ndim != 1 or e.shape != force.shape or len(np.unique(e)) <= len(knots):
            got = f"{len(np.unique(e))} different ones of shape {e.shape}, forces of shape {force.shape}"
            refuse(
                "e",
                f"more than {len(knots)} compressions, one per force",
                got,
                "Each coefficient needs a point.",
            )
        # the force is linear in every k_j: of one bond each
        columns = cls(knots, np.eye(len(knots) + 1)).force(jnp.asarray(e)[:, None])
        return cls(knots, nnls(np.asarray(columns), force)[0], preload)

    @property
    def stiffness(self):
        """The coefficients k_j, (K + 1,)."""
        return jnp.stack(self._coefficients)

    @property
    def preload(self):
        return 0.0 if self._preload is None else self._preload

    def force(self, e):
        x, F, _, k, slope, curve = self._piece(e)
        return F + x * (k + x * (slope / 2 + x * (curve / 3)))

    def energy(self, e):
        x, F, E, k, slope, curve = self._piece(e)
        return E + x * (F + x * (k / 2 + x * (slope / 6 + x * (curve / 12))))

    def _piece(self, e):
        """What holds at e: e less an anchor, the force, energy and stiffness there, and the latter's derivatives.

        Pieces are laid outwards from equilibrium, so that no digits are lost near it.
        """
        dtype = jnp.result_type(e, *self._coefficients)
        zero = jnp.zeros((), dtype)
        chosen = None
        for sign in (1, -1):
            F, E, end = zero, zero, 0.0
            side = []
            for start, end, k, slope, curve in self._outwards(sign):
                side.append((start, (F, E, k, slope, curve)))
                h = end - start
                E = E + h * (F + h * (k / 2 + h * (slope / 6 + h * (curve / 12))))
                F = F + h * (k + h * (slope / 2 + h * (curve / 3)))
            side.append((end, (F, E, self._coefficients[-1 if sign > 0 else 0], zero, zero)))
            for anchor, values in side:
                new = (jnp.asarray(anchor, dtype), *values)
                here = e >= anchor if sign > 0 else e < anchor
                chosen = (
                    new
                    if chosen is None
                    else tuple(jnp.where(here, a, b) for a, b in zip(new, chosen))
                )
        return (e - chosen[0], *chosen[1:])

    def _outwards(self, sign):
        """The intervals on one side of 0, outwards: where they start and end, k, k', k''/2 at the start."""
        middle = self._coefficients[1:-1]
        ends = [self._coefficients[0], *self._inner_ends(), self._coefficients[-1]]
        intervals = list(zip(self.knots, self.knots[1:], ends, middle, ends[1:]))
        for low, high, at_low, between, at_high in intervals[::sign]:
            start, end = (max(low, 0.0), high) if sign > 0 else (min(high, 0.0), low)
            if sign * (end - start) <= 0:
                continue
            h = high - low
            slope, curve = 2 * (between - at_low) / h, (at_low - 2 * between + at_high) / h**2
            x = start - low
            k = at_high if start == high else at_low + x * (slope + x * curve)
            yield start, end, k, slope + 2 * x * curve, curve

    def _inner_ends(self):
        """Stiffness at the inner knots: between its neighbours, so that its slope is continuous."""
        h = np.diff(self.knots).tolist()
        k = self._coefficients[1:-1]
        return [(h[i + 1] * k[i] + h[i] * k[i + 1]) / (h[i] + h[i + 1]) for i in range(len(h) - 1)]


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
