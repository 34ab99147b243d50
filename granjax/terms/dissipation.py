"""Forces that read velocities: damping, dashpots, viscoelastic contacts, drag."""

from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp

from ..checks import non_negative, positive, refuse
from ..laws import plus_power
from ..strains import StrainMap
from .base import Term


class Damping(Term):
    """Linear damping of each site: acceleration -gamma v, force -gamma m v; gamma = 1/tau.

    **Arguments:** `rate`: gamma >= 0 [1/s], scalar or one per site; `field`: as in `OnSite`, `None` for all.
    Splitting solvers take it exactly, in the drift. Typical: tau = 0.2 ... 5 ms for steel beads, gamma = 0.01 ... 0.1
    in scaled units. **Raises** ValueError for gamma < 0.
    """

    conserves: ClassVar[bool] = False
    reads_velocity: ClassVar[bool] = True
    rate: jax.Array
    field: str | None = eqx.field(static=True)

    def __init__(self, rate, field=None):
        self.rate, self.field = non_negative("rate", rate, "A negative rate would feed the lattice."), field

    def force(self, t, u, v, mass):
        if self.field is None:
            return jax.tree.map(lambda v, m: -self.rate * m * v, v, mass)
        return {self.field: -self.rate * mass[self.field] * v[self.field]}


class Dashpot(Term):
    """Dashpots between sites: force -(de/du)^T c de/dt, on the velocity difference of the ends.

    **Arguments:** `strain_map`: which sites are joined; `coefficient`: c >= 0 [N s/m], scalar or one per bond.
    Its force reads the velocities of neighbours, so splitting solvers refuse it: use diffrax's Tsit5 or Dopri8.
    **Raises** ValueError for c < 0.
    """

    conserves: ClassVar[bool] = False
    reads_velocity: ClassVar[bool] = True
    strain_map: StrainMap
    coefficient: jax.Array

    def __init__(self, strain_map, coefficient):
        self.strain_map = _checked_map(strain_map)
        self.coefficient = non_negative("coefficient", coefficient)

    def force(self, t, u, v, mass):
        rate, pull = jax.linearize(self.strain_map.strain, u)[1], jax.vjp(self.strain_map.strain, u)[1]
        return jax.tree.map(jnp.negative, pull(self.coefficient * rate(v))[0])


class ViscousContact(Term):
    r"""Viscoelastic contacts: force -(de/du)^T c [d0 + e]_+^q de/dt.

    **Arguments:** `strain_map`; `coefficient`: c >= 0, scalar or one per bond; `exponent`: q > 0, 1/2 for
    viscoelastic spheres; `overlap`: d0 >= 0 at equilibrium [m]. **Raises** ValueError for c, d0 < 0 or q <= 0.
    Splitting solvers refuse it, as they do a dashpot. Source: Kuwabara, Kono, Jpn. J. Appl. Phys. 26, 1230 (1987).
    """

    conserves: ClassVar[bool] = False
    reads_velocity: ClassVar[bool] = True
    strain_map: StrainMap
    coefficient: jax.Array
    overlap: jax.Array
    exponent: float = eqx.field(static=True)

    def __init__(self, strain_map, coefficient, exponent=0.5, overlap=0.0):
        self.strain_map = _checked_map(strain_map)
        self.coefficient, self.overlap = non_negative("coefficient", coefficient), non_negative("overlap", overlap)
        self.exponent = float(positive("exponent", exponent))

    def force(self, t, u, v, mass):
        e, rate = jax.jvp(self.strain_map.strain, (u,), (v,))
        pull = jax.vjp(self.strain_map.strain, u)[1]
        push = self.coefficient * plus_power(self.overlap + e, self.exponent) * rate
        return jax.tree.map(jnp.negative, pull(push)[0])


class Drag(Term):
    """Quadratic drag of each site: force -c v|v|.

    **Arguments:** `coefficient`: c >= 0 [kg/m], scalar or one per site. **Raises** ValueError for c < 0. Splitting
    solvers refuse it.
    """

    conserves: ClassVar[bool] = False
    reads_velocity: ClassVar[bool] = True
    coefficient: jax.Array

    def __init__(self, coefficient):
        self.coefficient = non_negative("coefficient", coefficient)

    def force(self, t, u, v, mass):
        return jax.tree.map(lambda v: -self.coefficient * v * jnp.abs(v), v)


def _checked_map(strain_map):
    if not isinstance(strain_map, StrainMap):
        refuse("strain_map", "a strain map, such as Shift(1, 'fixed')", repr(strain_map))
    return strain_map
