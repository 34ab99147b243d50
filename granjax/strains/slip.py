"""Tangential contacts of beads that turn in the plane."""

from typing import ClassVar

import jax
import jax.numpy as jnp

from ..checks import refuse
from ..types import Parameter
from ..units import PART
from .maps import TwoEnds
from .stretch import Directed


class Slip(Directed):
    r"""How far two beads have slipped past each other at their contact, in the plane.

    Beads have (u_x, u_y, s): s = R theta [m], the way of a point of the rim, R the bead's radius, anticlockwise. With
    the vector L from tail to head at rest, |L| the sum of the radii, and phi the angle by which the line of centres has
    turned:

    e = s_tail + s_head - |L| phi,   phi = angle from L to L - (u_tail - u_head).

    Places tell phi up to whole turns. The turn is the one nearest to how far the beads have turned, so that e is signed
    and lies between -pi |L| and pi |L|: two beads may circle each other as often as they like, and a rigid rotation by
    any angle slips nowhere, so that the force keeps both momenta. For small
    displacements |L| phi is the part of u_head - u_tail along L turned by 90 degrees. A linear law of it is Mindlin's
    tangential stiffness about the static load.

    **Arguments:** as of `Stretch`, with a vector of two components.
    **Shapes:** `u` (sites..., 3, lanes...) to `e` (bonds..., lanes...). **Raises** ValueError for a vector that is none
    of the plane. Source: Mindlin, J. Appl. Mech. 16, 259 (1949); Merkel, Tournat, Gusev, Phys. Rev. E 82, 031305
    (2010).
    """

    dimensions = {"pairs": PART, "vector": (0, 1, 0)}
    tangential: ClassVar[bool] = True

    def __init__(self, pairs: TwoEnds, vector: Parameter):
        super().__init__(pairs, vector)
        if self.components != 2:
            refuse(
                "vector",
                "a vector of two components",
                f"{self.components}",
                "Beads turn in the plane alone.",
            )

    def strain(self, u):
        D, R, rest, along, *_ = self._geometry(u)
        turned = jnp.arctan2(R[1] * D[0] - R[0] * D[1], rest * rest - along)
        e = self.pairs.reach(self._component(u, 2)) - rest * turned
        # places do not tell whole turns; an e of less than half a turn stays as it is, to the last digit
        return e - 2 * jnp.pi * rest * jax.lax.round(e / (2 * jnp.pi * rest))

    def stiffness_bound(self, lattice, k):
        # a bead's inertia is J in m R^2: with weights J w of its displacements and w of its turning, both rows of
        # |B|^T k |B| w are at most (1 + J) k (w_tail + w_head) over the smaller of its masses
        axis = lattice.axes
        parts = [
            jnp.min(m, axis) / jnp.max(m, axis)
            for m in jax.tree.leaves(lattice.mass)
            if jnp.ndim(m) > axis
        ]
        J = jnp.max(jnp.stack([jnp.max(x) for x in parts])) if parts else 1.0
        return self.pairs.stiffness_bound(lattice, (1 + J) * k)
