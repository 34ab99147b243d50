"""Forces that read velocities: damping, dashpots, viscoelastic contacts, drag."""

import equinox as eqx
import jax
import jax.numpy as jnp

from ..checks import non_negative, positive, refuse
from ..entry import checked
from ..laws import plus_power
from ..strains import StrainMap
from ..types import Parameter, Scalar
from ..units import PART
from .base import Term, wider
from .bonds import Joined
from .sites import one_a_vector
from .tracing import Dependence


class Damping(Term):
    """Linear damping of each site: acceleration -gamma v, force -gamma m v; gamma = 1/tau.

    **Arguments:** `rate`: gamma >= 0 [1/s], scalar or one per site; `field`: as in `OnSite`, `None` for all.
    Splitting solvers take it exactly, in the drift. Typical: tau = 0.2 ... 5 ms for steel beads, gamma = 0.01 ... 0.1
    in scaled units. **Raises** ValueError for gamma < 0.
    """

    dimensions = {"rate": (0, 0, -1)}
    rate: jax.Array
    field: str | None = eqx.field(static=True)

    @checked
    def __init__(self, rate: Parameter, field: str | None = None):
        self.rate, self.field = non_negative("rate", rate, "A negative rate would feed the lattice."), field

    def force(self, t, u, v, mass):
        if self.field is None:
            return jax.tree.map(lambda v, m: -self.rate * m * v, v, mass)
        return {self.field: -self.rate * mass[self.field] * v[self.field]}

    def dependence(self, lattice):
        return Dependence(velocity=True)

    def span(self):
        return ()

    def exact_damping(self):
        return self.field, self.rate

    def linearised(self, lattice, t, u, v):
        return wider(self)

    def per_vector(self, axes):
        return one_a_vector(self, axes)

    def scaled(self, factor):
        return eqx.tree_at(lambda term: term.rate, self, factor * self.rate)


class _Viscous(Joined):
    """Bonds whose force reads the rate of strain, in proportion to a coefficient."""

    coefficient: eqx.AbstractVar[jax.Array]

    def dependence(self, lattice):
        return Dependence(displacement=True, velocity=True)

    def scaled(self, factor):
        return eqx.tree_at(lambda term: term.coefficient, self, factor * self.coefficient)

    def opens(self, lattice):
        return False  # what opens is the contact beside it

    def stiffness_bound(self, lattice, reach, factor=1.0):
        return jnp.zeros((), lattice.dtype)


class Dashpot(_Viscous):
    """Dashpots between sites: force -(de/du)^T c de/dt, on the velocity difference of the ends.

    **Arguments:** `strain_map`: which sites are joined; `coefficient`: c >= 0 [N s/m], scalar or one per bond.
    Its force reads the velocities of neighbours, so splitting solvers refuse it: use diffrax's Tsit5 or Dopri8.
    **Raises** ValueError for c < 0.
    """

    dimensions = {"strain_map": PART, "coefficient": (1, -1, 1)}
    strain_map: StrainMap
    coefficient: jax.Array

    @checked
    def __init__(self, strain_map: StrainMap, coefficient: Parameter):
        self.strain_map = strain_map
        self.coefficient = non_negative("coefficient", coefficient)

    def force(self, t, u, v, mass):
        pull = self.strain_map.pull(u, self.coefficient * self.strain_map.rate(u, v))
        return jax.tree.map(jnp.negative, pull)

    def linearised(self, lattice, t, u, v):
        return wider(self) if self.strain_map.linear else super().linearised(lattice, t, u, v)

    def next_dashpots(self):
        return None if self.strain_map.next_neighbours() is None else self.coefficient


class ViscousContact(_Viscous):
    r"""Viscoelastic contacts: force -(de/du)^T c [d0 + e]_+^q de/dt.

    **Arguments:** `strain_map`; `coefficient`: c >= 0, scalar or one per bond; `exponent`: q > 0, 1/2 for
    viscoelastic spheres; `overlap`: d0 >= 0 at equilibrium [m]. **Raises** ValueError for c, d0 < 0 or q <= 0.
    Splitting solvers refuse it, as they do a dashpot. Source: Kuwabara, Kono, Jpn. J. Appl. Phys. 26, 1230 (1987).
    """

    dimensions = {
        "strain_map": PART, "coefficient": lambda term: (1, -1 - term.exponent, 1), "overlap": (0, 1, 0),
    }
    strain_map: StrainMap
    coefficient: jax.Array
    overlap: jax.Array
    exponent: float = eqx.field(static=True)

    @checked
    def __init__(
        self, strain_map: StrainMap, coefficient: Parameter, exponent: Scalar = 0.5, overlap: Parameter = 0.0,
    ):
        self.strain_map = strain_map
        self.coefficient, self.overlap = non_negative("coefficient", coefficient), non_negative("overlap", overlap)
        self.exponent = float(positive("exponent", exponent))

    def force(self, t, u, v, mass):
        open_or_not = plus_power(self.overlap + self.strain_map.strain(u), self.exponent)
        pull = self.strain_map.pull(u, self.coefficient * open_or_not * self.strain_map.rate(u, v))
        return jax.tree.map(jnp.negative, pull)


class Drag(Term):
    """Quadratic drag of each site: force -c v|v|.

    **Arguments:** `coefficient`: c >= 0 [kg/m], scalar or one per site. **Raises** ValueError for c < 0. Splitting
    solvers refuse it.
    """

    dimensions = {"coefficient": (1, -2, 2)}
    coefficient: jax.Array

    @checked
    def __init__(self, coefficient: Parameter):
        self.coefficient = non_negative("coefficient", coefficient)

    def dependence(self, lattice):
        return Dependence(velocity=True)

    def check(self, name, lattice):
        if lattice.dimension is not None:
            refuse(name, "a lattice with scalar displacements", f"vectors of {lattice.dimension}",
                   "In the plane drag couples the components: write a term of your own.")

    def span(self):
        return ()

    def force(self, t, u, v, mass):
        return jax.tree.map(lambda v: -self.coefficient * v * jnp.abs(v), v)
