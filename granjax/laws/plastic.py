"""Plastic contacts, whose force also reads the largest overlap so far."""

import abc

import jax
import jax.numpy as jnp

from ..base.checks import concrete, positive, require, show
from ..base.types import Number, Numbers, Parameter
from ..base.units import PART, Dimensional
from .base import Law
from .power import plus_power
from .real_power import root


class PlasticLaw(Dimensional):
    """A contact with a history: force F(s, P) at overlap s, with the largest overlap so far P >= s.

    It loads at s = P; below P it unloads and reloads along one curve. A new law needs four methods,
    elementwise. `stored(s, P)` is the integral of F(., P) up to s, and `lost(P)` that of F(x, x) up
    to P, minus stored(P, P), so that d(stored + lost) = F ds on both branches. `left(P)` is the
    overlap at which an unloaded contact opens.

    **Example:**

    >>> class Dead(gx.PlasticLaw):
    ...     def force(self, s, largest): return jnp.where(s >= largest, s, 0.0)
    ...     def stored(self, s, largest): return 0.0 * s
    ...     def lost(self, largest): return largest**2 / 2
    ...     def left(self, largest): return largest
    >>> chain = gx.Lattice(1.0, gx.PlasticContact(gx.Shift(1, "free"), Dead()), sites=2)
    >>> float(Dead().lost(2.0))
    2.0
    """

    @abc.abstractmethod
    def force(self, s: Number, largest: Number) -> Numbers:
        """Return the total contact force [N], zero for an open contact."""

    @abc.abstractmethod
    def stored(self, s: Number, largest: Number) -> Numbers:
        """Return the energy that unloading gives back [J]."""

    @abc.abstractmethod
    def lost(self, largest: Number) -> Numbers:
        """Return the energy dissipated so far [J]."""

    @abc.abstractmethod
    def left(self, largest: Number) -> Numbers:
        """Return the permanent indentation: the overlap at which the unloaded contact opens [m]."""

    def _wrapped(self, units):
        return _InOtherUnits(self, units.length, units.force)


class WaltonBraun(PlasticLaw):
    r"""Walton and Braun's bilinear contact: F = k1 s in loading, k2 [s - (1 - k1/k2) P]_+ below P.

    **Arguments:** `loading`: k1 > 0 [N/m]; `unloading`: k2 >= k1 [N/m]; numbers or one per contact.
    The restitution is sqrt(k1/k2) at every speed. Typical: k2/k1 = 1.2 ... 6. **Raises** ValueError
    for k1 <= 0 or k2 < k1. Source: O. R. Walton, R. L. Braun, J. Rheol. 30, 949 (1986).

    **Example:**

    >>> law = gx.WaltonBraun(loading=1.0, unloading=4.0)
    >>> float(law.force(1.0, 1.0)), round(float(law.force(0.9, 1.0)), 4), float(law.left(1.0))
    (1.0, 0.6, 0.75)
    """

    dimensions = {"loading": (1, -1, 0), "unloading": (1, -1, 0)}
    loading: jax.Array
    unloading: jax.Array

    def __init__(self, loading: Parameter, unloading: Parameter):
        self.loading = positive("loading", loading)
        self.unloading = positive("unloading", unloading)
        k1 = concrete(self.loading)
        require(
            "unloading",
            self.unloading,
            lambda k2: k1 is None or k2 >= k1,
            f"a stiffness not below that of loading, {show(loading)}",
            "A contact that unloads along a softer line gives back more than it took.",
        )

    def left(self, largest):
        return (1 - self.loading / self.unloading) * largest

    def force(self, s, largest):
        return self.unloading * plus_power(s - self.left(largest), 1)

    def stored(self, s, largest):
        return self.unloading / 2 * plus_power(s - self.left(largest), 2)

    def lost(self, largest):
        return self.loading / 2 * (1 - self.loading / self.unloading) * plus_power(largest, 2)


class Thornton(PlasticLaw):
    r"""Thornton's elastic, perfectly plastic spheres.

    Loading: Hertz, A s^{3/2}, up to the overlap s_y where the central pressure reaches its limit,
    then the tangent, A s_y^{3/2} (3 s/s_y - 1)/2. Unloading from P > s_y: Hertz with the larger
    radius of the flattened contact, F = F_P [(s - s_P)/(P - s_P)]_+^{3/2},
    P - s_P = F_P/(A P^{1/2}).

    **Arguments:** `stiffness`: A > 0 [N/m^{3/2}]; `yield_overlap`: s_y > 0 [m], (pi p_y/(2 E*))^2
    R* for a limiting pressure p_y (about 1.6 to 3 times the yield stress), reduced modulus E* and
    radius R*. A pair of reduced mass m yields from the speed V_y = (4 A s_y^{5/2}/(5 m))^{1/2} on
    (`gx.theory.restitution`); steel beads of 1 cm from some cm/s. **Raises** ValueError for values
    that are not positive. Source: C. Thornton, J. Appl. Mech. 64, 383 (1997).

    **Example:**

    >>> law = gx.Thornton(stiffness=1.0, yield_overlap=0.01)
    >>> round(float(law.force(0.01, 0.01)), 6), round(float(law.left(0.04)), 6)
    (0.001, 0.0125)
    """

    dimensions = {"stiffness": (1, -1.5, 0), "yield_overlap": (0, 1, 0)}
    stiffness: jax.Array
    yield_overlap: jax.Array

    def __init__(self, stiffness: Parameter, yield_overlap: Parameter):
        self.stiffness = positive("stiffness", stiffness)
        self.yield_overlap = positive("yield_overlap", yield_overlap)

    def _turn(self, largest):
        # (P/s_y, at least 1; A s_y^{3/2}; the depth P - s_P; the force at P).
        y = self.yield_overlap
        x = jnp.where(largest > y, largest, y) / y
        unit = self.stiffness * y * root(y)
        force = unit * (3 * x - 1) / 2
        return x, unit, y * (3 * x - 1) / (2 * root(x)), force

    def left(self, largest):
        x, _, depth, _ = self._turn(largest)
        return x * self.yield_overlap - depth

    def force(self, s, largest):
        _, _, depth, force = self._turn(largest)
        return force * plus_power((s - self.left(largest)) / depth, 1.5)

    def stored(self, s, largest):
        _, _, depth, force = self._turn(largest)
        return 0.4 * force * depth * plus_power((s - self.left(largest)) / depth, 2.5)

    def lost(self, largest):
        x, unit, _, _ = self._turn(largest)
        return (
            unit
            * self.yield_overlap
            * (0.75 * x * x - x / 2 + 0.15 - 0.1 * (3 * x - 1) ** 2 / root(x))
        )


class _InOtherUnits(PlasticLaw):
    law: PlasticLaw
    length: jax.Array
    unit: jax.Array

    def force(self, s, largest):
        return self.law.force(self.length * s, self.length * largest) / self.unit

    def stored(self, s, largest):
        return self.law.stored(self.length * s, self.length * largest) / (self.unit * self.length)

    def lost(self, largest):
        return self.law.lost(self.length * largest) / (self.unit * self.length)

    def left(self, largest):
        return self.law.left(self.length * largest) / self.length


class Indented(Law):
    """A plastic law at a known largest overlap, measured from equilibrium at the overlap `rest`.

    **Example:**

    >>> law = gx.PlasticContact(gx.Shift(1, "free"), gx.WaltonBraun(1.0, 4.0), largest=1.0).law
    >>> isinstance(law, gx.laws.Indented), round(float(law.force(0.9)), 4), float(law.lost())
    (True, 0.6, 0.375)
    """

    dimensions = {"law": PART, "rest": (0, 1, 0), "largest": (0, 1, 0)}
    law: PlasticLaw
    rest: jax.Array
    largest: jax.Array

    def __init__(self, law: PlasticLaw, rest: Parameter, largest: Parameter):
        self.law = law
        self.rest = rest
        self.largest = largest

    def _overlaps(self, e):
        s = self.rest + e
        return s, jnp.where(s >= self.largest, s, self.largest)

    @property
    def preload(self):
        return self.law.force(self.rest, self.rest)

    def force(self, e):
        return self.law.force(*self._overlaps(e)) - self.preload

    def energy(self, e):
        s, largest = self._overlaps(e)
        spent = self.law.stored(self.rest, self.rest) + self.law.lost(self.rest)
        return self.law.stored(s, largest) + self.law.lost(largest) - spent - self.preload * e

    def overlap(self, e):
        s, largest = self._overlaps(e)
        return s - self.law.left(largest)

    def lost(self) -> Numbers:
        """Return the energy dissipated since equilibrium [J]."""
        return self.law.lost(self.largest) - self.law.lost(self.rest)
