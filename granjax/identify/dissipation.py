"""Terms that read the velocity in a nonlinear way: candidates of a regression."""

from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp

from ..checks import non_negative, positive
from ..laws import plus_power
from ..strains import StrainMap
from ..terms import Term


class ViscousContact(Term):
    r"""Viscoelastic contacts: force -(de/du)^T c [d0 + e]_+^q de/dt.

    **Arguments:** `strain_map`; `coefficient`: c >= 0, scalar or one per bond; `exponent`: q > 0, 1/2 for
    viscoelastic spheres; `overlap`: d0 >= 0 at equilibrium [m]. **Raises** ValueError for c, d0 < 0 or q <= 0.
    `simulate` needs a `step`, and one of diffrax's solvers.
    Source: Kuwabara, Kono, Jpn. J. Appl. Phys. 26, 1230 (1987).
    """

    conserves: ClassVar[bool] = False
    reads_velocity: ClassVar[bool] = True
    strain_map: StrainMap
    coefficient: jax.Array
    overlap: jax.Array
    exponent: float = eqx.field(static=True)

    def __init__(self, strain_map, coefficient, exponent=0.5, overlap=0.0):
        self.strain_map = strain_map
        self.coefficient, self.overlap = non_negative("coefficient", coefficient), non_negative("overlap", overlap)
        self.exponent = float(positive("exponent", exponent))

    def force(self, t, u, v, mass):
        e, rate = jax.jvp(self.strain_map.strain, (u,), (v,))
        pull = jax.vjp(self.strain_map.strain, u)[1]
        push = self.coefficient * plus_power(self.overlap + e, self.exponent) * rate
        return jax.tree.map(jnp.negative, pull(push)[0])


class Drag(Term):
    """Quadratic drag of each site: force -c v|v|.

    **Arguments:** `coefficient`: c >= 0 [kg/m], scalar or one per site. **Raises** ValueError for c < 0. `simulate`
    needs a `step`, and one of diffrax's solvers.
    """

    conserves: ClassVar[bool] = False
    reads_velocity: ClassVar[bool] = True
    coefficient: jax.Array

    def __init__(self, coefficient):
        self.coefficient = non_negative("coefficient", coefficient)

    def force(self, t, u, v, mass):
        return jax.tree.map(lambda v: -self.coefficient * v * jnp.abs(v), v)
