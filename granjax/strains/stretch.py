"""Bonds between vectors, in the plane or in space: distances, fixed directions, slips of beads that turn."""

from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp

from ..checks import parameter, positive, refuse
from ..types import Parameter
from ..units import PART
from .maps import LinearMap, TwoEnds, VectorMap


class Directed(VectorMap):
    """Bonds between sites whose places differ by a vector at rest: what distances and slips have in common."""

    pairs: TwoEnds
    vector: jax.Array
    components: int = eqx.field(static=True)

    def __init__(self, pairs: TwoEnds, vector: Parameter):
        self.pairs = pairs
        self.vector = parameter("vector", vector)
        if self.vector.ndim == 0:
            refuse("vector", "a vector of two or three components, from tail to head", repr(vector))
        self.components = self.vector.shape[-1]
        positive("vector", jnp.linalg.norm(self.vector, axis=-1), "A bond at rest has a length.")

    def _geometry(self, u):
        """Components of D and R, and numbers of each bond: |R|, R . D, D . D, |R - D|, and |R| less that.

        Component by component: an array whose last axis has two entries is several times as slow to go through.
        """
        whole = self.pairs.strain(u)
        D = [
            jax.lax.index_in_dim(whole, i, self.pairs.axes, keepdims=False)
            for i in range(self.components)
        ]
        R = self._vectors(D[0].shape)
        rest = jnp.sqrt(sum(r * r for r in R))
        along = sum(r * d for r, d in zip(R, D))
        square = sum(d * d for d in D)
        length = jnp.sqrt(rest * rest - 2 * along + square)
        # |R| - |R - D| without cancellation
        e = (2 * along - square) / (rest + length)
        return D, R, rest, along, square, length, e

    def _vectors(self, bonds):
        """The components of R, for bonds (and lanes) of a shape."""
        axis = self.pairs.axes
        R = self.vector
        if R.ndim == 1:
            return [R[i] for i in range(self.components)]
        R = jnp.broadcast_to(R, bonds[:axis] + (self.components,) + bonds[axis:])
        return [jax.lax.index_in_dim(R, i, axis, keepdims=False) for i in range(self.components)]


class Stretch(Directed):
    r"""Bonds as distances in the plane or in space, with the geometry's own nonlinearity and the prestress.

    With D = u_tail - u_head and the vector R from tail to head at rest: length |R - D|, compression
    e = |R| - |R - D|, direction n = (R - D)/|R - D|. The sites feel the total force F0 + F(e) along n less F0 along
    n0 = R/|R|, so that the preload turns with the bond and gives the transverse stiffness -F0/|R|.

    **Arguments:** `pairs`: a `Shift` or `Pairs` that says which sites are joined. `vector`: R, shape (d,) or
    (bonds..., d) [m], not zero.

    **Shapes:** `u` (sites..., d, lanes...) to `e` (bonds..., lanes...); components of `u` beyond the vector's, such as
    a rotation, are left alone. **Raises** ValueError for a vector of length zero or a map that is neither Shift nor
    Pairs. That the preloads balance at u = 0, with the boundary's loads, is the user's: `Lattice.unbalanced()` gives
    what is left over.

    **Example:**

    >>> bond = gx.Stretch(gx.Shift(1, "free"), (3.0, 4.0))
    >>> bond.strain(jnp.array([[0.0, 0.0], [0.0, -4.0]]))   # from length 5 to 3
    Array([2.], dtype=float64)
    """

    dimensions = {"pairs": PART, "vector": (0, 1, 0)}

    def strain(self, u):
        return self._geometry(u)[-1]

    def load(self, u, law):
        D, R, rest, _, _, length, e = self._geometry(u)
        # F0 (n - n0) = (F0/|R|) (n e - D), as |R| n0 = R and |R - D| = |R| - e
        tension = law.preload / rest
        push = (law.force(e) + tension * e) / length
        axis = self.pairs.axes
        parts = [(r - d) * push - d * tension for r, d in zip(R, D)]
        more = jax.tree.leaves(u)[0].shape[axis] - self.components
        return self.pairs.gather(jnp.stack(parts + [jnp.zeros_like(parts[0])] * more, axis))

    def energy(self, u, law):
        _, _, rest, along, square, length, e = self._geometry(u)
        bend = (along * e - square * rest) / (rest * (rest + length))
        return law.energy(e) + law.preload * bend

    def stiffness_bound(self, lattice, k):
        return self.pairs.stiffness_bound(lattice, k)

    def turning(self, lattice, law):
        axis = max(self.vector.ndim - 1 - len(lattice.lanes), 0)
        return jnp.max(jnp.abs(law.preload)) / jnp.min(jnp.linalg.norm(self.vector, axis=axis))


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
