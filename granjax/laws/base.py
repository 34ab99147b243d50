"""The base class of force laws, derived laws, and Taylor coefficients."""

import abc
import functools
from collections.abc import Sequence
from typing import ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from ..base.checks import non_negative, plain_zero
from ..base.derivatives import with_slope
from ..base.printing import told
from ..base.programs import compiled
from ..base.types import Number, Numbers, Parameter
from ..base.units import PART, Dimensional


class Law(Dimensional):
    """A force law of bonds or sites: force against compression, from static equilibrium.

    `force(e)` is positive in compression and `force(0) = 0`; `energy(e)` is its integral with
    `energy(0) = 0`. `preload` is the force in equilibrium; the total contact force is
    `preload + force(e)`. `overlap(e)` is positive while the contact is closed
    (or magnets are apart), or `None`; a law that cannot open says `opens = False`.

    All methods are elementwise: `e` has the shape of the bonds (then lanes), parameters are scalars
    or arrays over them. A new law needs `force` and `energy`, with arrays as parameters
    (plain numbers recompile for each value). `law + law` is a sum.

    **Example:**

    >>> class Cubic(gx.Law):
    ...     k: jax.Array
    ...     def force(self, e): return self.k * e**3
    ...     def energy(self, e): return self.k * e**4 / 4
    >>> gx.laws.taylor(Cubic(jnp.array(2.0)))
    Taylor(K2=0, K3=0, K4=2)
    """

    is_linear: ClassVar[bool] = False

    @abc.abstractmethod
    def force(self, e: Number) -> Numbers:
        """Return the force beyond the preload at compression `e`."""

    @abc.abstractmethod
    def energy(self, e: Number) -> Numbers:
        """Return the potential energy at compression `e`, without the work of the preload."""

    @property
    def preload(self):
        """Force at equilibrium, F0."""
        return 0.0

    def overlap(self, e: Number) -> Numbers | None:
        """Return a length that is positive while the contact is closed; `None` without a limit."""
        return None

    def room(self, e: Number) -> Numbers | None:
        """Return a length that is positive where the law has a force (magnets apart), or `None`."""
        return None

    @property
    def opens(self):
        """Whether a contact can open: `True` (see `overlap`), `False`, or `None` if unknown.

        Unknown for a law that defines neither `overlap` nor `opens = False`.
        """
        return None if type(self).overlap is Law.overlap else True

    def derivative(self, e: Number) -> Numbers:
        """Return the stiffness F'(e), elementwise."""
        return with_slope(self.force, jnp.asarray(e))[1]

    @property
    def parts(self):
        """The laws in parallel that make up this one; itself for a simple one."""
        return (self,)

    @property
    def softens(self):
        """Whether a re-opening contact is infinitely stiff, so that no step bound exists there."""
        return False

    @property
    def power_law(self):
        """(A, p) of a contact A [d0 + e]^p, or `None`."""
        return None

    @property
    def powers(self):
        """{k: K_k} of a polynomial F(e) = sum K_k e^k, or `None`."""
        return None

    def _wrapped(self, units):
        return Scaled(self, 1 / units.force, 1 / units.length)

    def __add__(self, law: "Law") -> "Law":
        return Sum(self.parts + law.parts)


def checked_preload(argument: str, F0: Parameter, remedy: str):
    """Return a checked array; `None` for a plain zero, which then costs no operation."""
    if plain_zero(F0):
        return None
    return non_negative(argument, F0, remedy)


class Sum(Law):
    """Laws in parallel: F = sum of F_k. Write `law + law`.

    Typical: a coated bead or an O-ring, `Hertz(1.0) + PowerLaw(0.2, 2.5)`; a nonlinear site
    potential plus a linear one. The overlap is the smallest of the parts.

    **Example:**

    >>> law = gx.Hertz(1.0) + gx.PowerLaw(0.2, 2.5)
    >>> isinstance(law, gx.laws.Sum), round(float(law.force(1.0)), 4)
    (True, 1.2)
    """

    dimensions = {"_parts": PART}
    _parts: tuple[Law, ...]

    def __init__(self, parts: Sequence[Law]):
        self._parts = tuple(parts)

    def __repr__(self) -> str:
        return " + ".join(map(repr, self._parts))

    @property
    def parts(self):
        return self._parts

    @property
    def softens(self):
        return any(part.softens for part in self.parts)

    @property
    def opens(self):
        known = {part.opens for part in self.parts}
        return None if None in known else True in known

    @property
    def powers(self):
        found = [part.powers for part in self.parts]
        if None in found:
            return None
        return {k: sum(own[k] for own in found if k in own) for k in sorted(set().union(*found))}

    def force(self, e):
        return sum(part.force(e) for part in self.parts)

    def energy(self, e):
        return sum(part.energy(e) for part in self.parts)

    @property
    def preload(self):
        return sum(part.preload for part in self.parts)

    def overlap(self, e):
        return _smallest([part.overlap(e) for part in self.parts])

    def room(self, e):
        return _smallest([part.room(e) for part in self.parts])


def _smallest(lengths):
    known = [x for x in lengths if x is not None]
    return functools.reduce(jnp.minimum, known) if known else None


class Derived(Law):
    """A law based on another one; it is open, or without force, where that one is."""

    law: eqx.AbstractVar[Law]

    @property
    def parts(self):
        return tuple(eqx.tree_at(lambda own: own.law, self, part) for part in self.law.parts)

    @property
    def preload(self):
        return self.law.preload

    def _moved(self, e):
        return e

    @property
    def softens(self):
        return self.law.softens

    @property
    def opens(self):
        return self.law.opens

    def _own(self, x):
        # A length of the other law, or `None`, converted to this law.
        return x

    def overlap(self, e):
        return self._own(self.law.overlap(self._moved(e)))

    def room(self, e):
        return self._own(self.law.room(self._moved(e)))


class Scaled(Derived):
    """A law times a factor, F = g F_law(e), for stiffness that varies in time or along the chain.

    With a length l it is also stretched, F = g F_law(e/l), as l bonds in series. **Arguments:**
    `law`; `factor`: g, and `length`: l > 0, numbers or arrays over bonds, dimensionless; `None` for
    1.

    **Example:**

    >>> law = gx.laws.Scaled(gx.Hertz(precompression=1.0), 2.0)
    >>> float(law.force(3.0)), float(law.preload)
    (14.0, 2.0)
    """

    dimensions = {"law": PART, "factor": (0, 0, 0), "length": (0, 0, 0)}
    law: Law
    factor: object
    length: object

    def __init__(self, law: Law, factor: Number, length: Number | None = None):
        self.law = law
        self.factor = factor
        self.length = length

    @property
    def power_law(self):
        found = self.law.power_law
        if found is None or self.length is not None:
            return None
        return self.factor * found[0], found[1]

    @property
    def powers(self):
        found = self.law.powers
        if found is None:
            return None
        length = 1 if self.length is None else self.length
        return {k: self.factor / length**k * K for k, K in found.items()}

    def _moved(self, e):
        return e if self.length is None else e / self.length

    def _own(self, x):
        return x if x is None or self.length is None else x * self.length

    def force(self, e):
        return self.factor * self.law.force(self._moved(e))

    def energy(self, e):
        return self.factor * self._own(self.law.energy(self._moved(e)))

    @property
    def preload(self):
        return self.factor * self.law.preload


class Strained(Derived):
    """A law about another equilibrium, the strain s: F(e) = F_law(e + s) - F_law(r).

    It gives a ring with periodic displacements a mean strain, such as the shortening by a solitary
    wave. With one r for bonds of several s, the far states of a shock are at u = 0, without a ramp;
    the force at e = 0 is then that of the law from r to s.

    **Arguments:** `law`; `strain`: s [m], number or array over bonds; `reference`: r [m], the
    strain of zero force and energy, `None` for s.

    **Example:**

    >>> law = gx.laws.Strained(gx.Hertz(), strain=1.0)
    >>> float(law.force(3.0)), float(law.preload)
    (7.0, 1.0)
    """

    dimensions = {"law": PART, "strain": (0, 1, 0), "reference": (0, 1, 0)}
    law: Law
    strain: object
    reference: object

    def __init__(self, law: Law, strain: Number, reference: Number | None = None):
        self.law = law
        self.strain = strain
        self.reference = reference

    @property
    def _zero(self):
        return jnp.asarray(self.strain if self.reference is None else self.reference)

    @property
    def preload(self):
        return self.law.preload + self.law.force(self._zero)

    def force(self, e):
        return self.law.force(e + self.strain) - self.law.force(self._zero)

    def energy(self, e):
        zero = self._zero
        moved = e if self.reference is None else e + (self.strain - zero)
        return (
            self.law.energy(e + self.strain) - self.law.energy(zero) - self.law.force(zero) * moved
        )

    def _moved(self, e):
        return e + self.strain


class Taylor(NamedTuple):
    """F(e) = K2 e + K3 e^2 + K4 e^3 + ...

    **Example:**

    >>> K2, K3, K4 = gx.laws.taylor(gx.Toda())
    >>> round(float(K3), 4)
    0.5
    """

    K2: jax.Array
    K3: jax.Array
    K4: jax.Array
    __repr__ = told


def taylor(law: Law, e: Number = 0.0) -> Taylor:
    """Return the Taylor coefficients of a law about a compression, by nested derivatives.

    K2 = F'(e), K3 = F''(e)/2, K4 = F'''(e)/6. For Hertz with d0 = A = 1: 3/2, 3/8, -1/16.

    **Arguments:** `law`; `e`: compression, 0 at equilibrium. **Returns:** `Taylor(K2, K3, K4)`, of
    the shape of the law's parameters. In a sonic vacuum (Hertz without precompression) all are
    zero: no linear limit.

    **Example:**

    >>> gx.laws.taylor(gx.Hertz(precompression=1.0))
    Taylor(K2=1.5, K3=0.375, K4=-0.0625)
    """
    return _taylor(law, jnp.asarray(e, float))


@compiled
def _taylor(law, e):
    at = jnp.zeros(jax.eval_shape(law.force, e).shape) + e
    # of the force alone: a derivative of the user's own may be a table
    first = lambda e: with_slope(law.force, e)[1]
    second = lambda e: with_slope(first, e)[1]
    return Taylor(first(at), second(at) / 2, with_slope(second, at)[1] / 6)
