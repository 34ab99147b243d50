"""Bonds that read one direction of vectors: linear springs in the plane, guided beads, rolling."""

import jax.numpy as jnp

from ..checks import parameter, refuse
from ..types import Parameter
from ..units import PART
from .maps import LinearMap, TwoEnds, VectorMap


class Along(VectorMap, LinearMap):
    r"""The part of a difference of vectors along a fixed direction: e = d . (u_tail - u_head).

    `Stretch` without the geometry's nonlinearity, where d is the unit vector from tail to head; the resistance to
    rolling, where d is that of the rotation, (0, 0, 1).

    **Arguments:** `pairs`: a `Shift` or `Pairs` that says which sites are joined. `direction`: d, (components,), of
    any length but zero, dimensionless.

    **Shapes:** `u` (sites..., components, lanes...) to `e` (bonds..., lanes...). **Raises** ValueError for a direction
    that is no vector.
    """

    dimensions = {"pairs": PART, "direction": (0, 0, 0)}
    pairs: TwoEnds
    direction: jnp.ndarray

    def __init__(self, pairs: TwoEnds, direction: Parameter):
        self.pairs, self.direction = pairs, parameter("direction", direction)
        if self.direction.ndim != 1:
            refuse("direction", "a vector, one number per component of u", repr(direction))

    def strain(self, u):
        return self._along(self.pairs.strain(u), self.direction)

    def gather(self, f):
        return self.pairs.gather(
            self._shaped(self.direction, f.ndim + 1) * jnp.expand_dims(f, self.axes)
        )

    def reach(self, w):
        return self._along(self.pairs.reach(w), jnp.abs(self.direction))

    def stiffness_bound(self, lattice, k):
        return self.pairs.stiffness_bound(lattice, k * jnp.sum(self.direction**2))

    def _along(self, D, direction):
        return jnp.sum(self._shaped(direction, D.ndim) * D, self.axes)

    def _shaped(self, direction, axes):
        """The direction with axes for the lanes that it lacks."""
        return direction.reshape(direction.shape + (1,) * (axes - self.axes - direction.ndim))
