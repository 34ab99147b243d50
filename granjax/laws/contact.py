"""Contacts: the power law A [d0 + e]_+^p and its special case, Hertz."""

import abc

import equinox as eqx
import jax
import jax.numpy as jnp

from ..base.checks import concrete, parameter, positive, require
from ..base.types import Parameter
from .base import Law, checked_preload
from .power import plus_power
from .real_power import cube_root


def _precompression(F0):
    return checked_preload(
        "precompression", F0, "The static force F0 pushes; a chain under tension falls apart."
    )


class _Contact(Law):
    """F(e) = A ([d0 + e]_+^p - d0^p) for p > 0; F(e) = A ((d0 - e)^p - d0^p) for p < 0."""

    stiffness: eqx.AbstractVar[jax.Array]
    precompression: eqx.AbstractVar[jax.Array | None]

    @property
    @abc.abstractmethod
    def exponent(self):
        """The exponent p."""

    @property
    def repels(self):
        """Whether p < 0; `None` while unknown in tracing."""
        return False

    @property
    def power_law(self):
        return self.stiffness, self.exponent

    @property
    def preload(self):
        return 0.0 if self.precompression is None else self.precompression

    @property
    def rest_overlap(self):
        """d0 = (F0/A)^(1/p)."""
        if self.precompression is None:
            return None
        ratio = self.precompression / self.stiffness
        if isinstance(self.exponent, float) and self.exponent == _HERTZ:
            return cube_root(ratio) ** 2
        return plus_power(ratio, 1 / self.exponent)

    def overlap(self, e):
        if self.repels is None:
            e = jnp.sign(self.exponent) * e
        elif self.repels:
            e = -e
        return e if self.precompression is None else self.rest_overlap + e

    def room(self, e):
        if self.repels is None:
            return jnp.where(self.exponent < 0, self.overlap(e), jnp.inf)
        return self.overlap(e) if self.repels else None

    def _difference(self, e, p):
        power = self._power(self.overlap(e), p)
        return power if self.precompression is None else power - self._power(self.rest_overlap, p)

    def _power(self, s, p):
        if self.repels is None:
            s = jnp.where((s <= 0) & (self.exponent < 0), jnp.nan, s)
        elif self.repels:
            s = jnp.where(s <= 0, jnp.nan, s)
        return plus_power(s, p)

    def force(self, e):
        return self.stiffness * self._difference(e, self.exponent)

    def energy(self, e):
        p = self.exponent
        if self.precompression is None:
            return self.stiffness / (p + 1) * self._difference(e, p + 1)
        whole = self._repulsion_energy(e) if self.repels else self._contact_energy(e)
        if self.repels is None:
            whole = jnp.where(p < 0, self._repulsion_energy(e), whole)
        return self._near_rest(e, whole)

    def _contact_energy(self, e):
        p = self.exponent
        q = p + 1 if self.repels is False else jnp.where(p < 0, 1, p + 1)
        return self.stiffness / q * self._difference(e, p + 1) - self.precompression * e

    def _near_rest(self, e, energy):
        # Use the binomial series for |e| < d0/50, where the closed form loses digits.
        p = self.exponent
        d0 = self.rest_overlap
        near = (jnp.abs(e) < 0.02 * d0) & (d0 > 0)
        x = jnp.where(near, e, 0) / jnp.where(d0 > 0, d0, 1)
        sign = -1 if self.repels else 1 if self.repels is False else jnp.sign(p)
        binomial = 1.0
        terms = []
        for k in range(1, 9):
            binomial = binomial * sign * (p - k + 1) / k
            terms.append(binomial / (k + 1))
        series = terms[-1]
        for term in terms[-2::-1]:
            series = series * x + term
        return jnp.where(near, self.precompression * d0 * x * x * series, energy)

    def _repulsion_energy(self, e):
        q = self.exponent + 1
        far = isinstance(q, float) and abs(q) > 0.5
        work = -self._difference(e, q) / q if far else self._near_inverse(e, q)
        return self.stiffness * work - self.precompression * e

    def _near_inverse(self, e, q):
        # Near x = q log(s/d0) = 0 use the series of expm1(x)/x, where the difference of powers loses
        # digits.
        d0 = self.rest_overlap
        s = self.overlap(e)
        log = jnp.log(jnp.where(s > 0, s, d0) / d0)
        near = (s > 0) & (jnp.abs(q * log) < 0.5)
        x = jnp.where(near, q * log, 0)
        series = 1.0
        for k in range(18, 1, -1):
            series = 1 + series * x / k
        powers = self._difference(e, q) / jnp.where(near, 1, q)
        return -jnp.where(near, plus_power(d0, q) * log * series, powers)


# The exponent of Hertz's law for elastic spheres.
_HERTZ = 1.5


class Hertz(_Contact):
    r"""Hertz contact of elastic spheres.

    F(e) = A ([d0 + e]_+^{3/2} - d0^{3/2}),   d0 = (F0/A)^{2/3};
    energy A (2/5) ([d0 + e]_+^{5/2} - d0^{5/2}) - F0 e.

    **Arguments:** `stiffness`: A > 0 [N/m^{3/2}], scalar or one per contact
    (`granjax.materials.hertz_coefficient`). `precompression`: static force F0 >= 0 [N]; a plain 0
    costs nothing. Typical: steel beads of 9.53 mm radius A = 9.8e9 N/m^{3/2}, F0 = 1 ... 20 N;
    scaled A = 1, F0 = 0 or 1.

    **Raises** ValueError for A <= 0, F0 < 0 or values that are not finite. Source: H. Hertz, J.
    reine angew. Math. 92, 156 (1881); Nesterenko, Dynamics of Heterogeneous Materials (2001).

    **Example:**

    >>> law = gx.Hertz(stiffness=1.0, precompression=1.0)
    >>> law.force(jnp.array([3.0, -2.0]))
    Array([ 7., -1.], dtype=float64)
    >>> gx.laws.taylor(law)
    Taylor(K2=1.5, K3=0.375, K4=-0.0625)
    """

    dimensions = {"stiffness": (1, -_HERTZ, 0), "precompression": (1, 0, 0)}
    stiffness: jax.Array
    precompression: jax.Array | None

    def __init__(self, stiffness: Parameter = 1.0, precompression: Parameter = 0.0):
        self.stiffness = positive("stiffness", stiffness, "The contact coefficient A is positive.")
        self.precompression = _precompression(precompression)

    @property
    def exponent(self):
        return _HERTZ


class PowerLaw(_Contact):
    r"""Power law of any exponent p != 0.

    p > 0:  F(e) = A ([d0 + e]_+^p - d0^p), a contact that opens;
    p < 0:  F(e) = A ((d0 - e)^p - d0^p), repelling magnets at rest distance d0, no plus part;
    d0 = (F0/A)^{1/p}.

    Where magnets meet (d0 - e <= 0) force and energy are NaN. For 0 < p < 1 a re-opening contact is
    infinitely stiff: no step is small enough there.

    **Arguments:** `stiffness`: A > 0. `exponent`: p; a Python number is static
    (1, 3/2, 2, 5/2, 3 are fast), an array that broadcasts over the bonds can be swept and
    differentiated. `precompression`: F0 >= 0; p < 0 needs F0 > 0 for an equilibrium.

    Typical: p = 3/2 spheres, 3 ... 4 cylinders and O-rings, 1/2 strain softening, -3 dipole ring
    magnets. **Raises** ValueError for p = 0 or not finite, A <= 0, F0 < 0, F0 = 0 with p < 0, or p
    of both signs. Source: Chong & Kevrekidis, Dynamics of Nonlinear Lattices, and references there.

    **Example:**

    >>> magnets = gx.PowerLaw(stiffness=1.0, exponent=-3.0, precompression=1.0)
    >>> round(float(magnets.force(0.5)), 4)
    7.0
    """

    dimensions = {
        "stiffness": lambda law: (1, -law.exponent, 0),
        "precompression": (1, 0, 0),
        "_free_exponent": (0, 0, 0),
    }
    _shown = {"stiffness": "stiffness", "exponent": "exponent", "precompression": "precompression"}
    stiffness: jax.Array
    precompression: jax.Array | None
    _fixed_exponent: float | None = eqx.field(static=True)
    _free_exponent: jax.Array | None
    _repels: bool | None = eqx.field(static=True)

    def __init__(
        self, stiffness: Parameter = 1.0, exponent: Parameter = 1.5, precompression: Parameter = 0.0
    ):
        self.stiffness = positive("stiffness", stiffness, "The contact coefficient A is positive.")
        self.precompression = _precompression(precompression)
        array = require(
            "exponent",
            parameter("exponent", exponent),
            lambda p: p != 0,
            "p != 0",
            "p = 1 is a linear spring, p = 3/2 Hertz, p < 0 magnets.",
        )
        require(
            "exponent",
            array,
            lambda p: (p < 0).any() == (p < 0).all(),
            "values of one sign",
            "Contacts and magnets are two laws; use two bonds.",
        )
        value = concrete(array)
        self._repels = None if value is None else bool((value < 0).all())
        static = isinstance(exponent, (int, float))
        self._fixed_exponent = float(exponent) if static else None
        self._free_exponent = None if static else array
        if self._repels:
            require(
                "exponent and precompression",
                self.preload,
                lambda F0: F0 > 0,
                "F0 > 0 for p < 0",
                "Repelling magnets rest only under a static force.",
            )

    @property
    def exponent(self):
        return self._free_exponent if self._fixed_exponent is None else self._fixed_exponent

    @property
    def repels(self):
        return self._repels

    @property
    def softens(self):
        exponent = concrete(self.exponent)
        return exponent is not None and bool(((exponent > 0) & (exponent < 1)).any())
