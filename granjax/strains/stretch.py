"""Bonds between vectors in the plane or in space: distances, directions, slips."""

from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp

from ..base.arrays import most, trailing
from ..base.checks import parameter, positive, refuse
from ..base.types import Parameter
from ..base.units import PART
from .maps import LinearMap, TwoEnds, VectorMap


class Directed(VectorMap):
    """Bonds between sites separated by a vector at rest."""

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
        """Components of D and R; per bond |R|, R . D, D . D, |R - D|, and |R| - |R - D|.

        It works component by component, since an array whose last axis has two entries is several
        times slower.
        """
        whole = self.pairs.strain(u)
        D = [self._component(whole, i) for i in range(self.components)]
        R = self._vectors(D[0].shape)
        rest = jnp.sqrt(sum(r * r for r in R))
        along = sum(r * d for r, d in zip(R, D))
        square = sum(d * d for d in D)
        length = jnp.sqrt(rest * rest - 2 * along + square)
        # |R| - |R - D| without cancellation
        e = (2 * along - square) / (rest + length)
        return D, R, rest, along, square, length, e

    def _vectors(self, bonds):
        axis = self.pairs.axes
        R = self.vector
        if R.ndim == 1:
            return [R[i] for i in range(self.components)]
        R = jnp.broadcast_to(R, bonds[:axis] + (self.components,) + bonds[axis:])
        return [self._component(R, i) for i in range(self.components)]


class Stretch(Directed):
    r"""Bonds as distances in the plane or in space, with geometric nonlinearity and prestress.

    With D = u_tail - u_head and the vector R from tail to head at rest: length |R - D|, compression
    e = |R| - |R - D|, direction n = (R - D)/|R - D|. The sites feel the total force F0 + F(e) along
    n minus F0 along n0 = R/|R|: the preload rotates with the bond and gives the transverse
    stiffness -F0/|R|.

    **Arguments:** `pairs`: a `Shift` or `Pairs` that joins the sites. `vector`: R, shape (d,) or
    (bonds..., d) [m], not zero.

    **Shapes:** `u` (sites..., d, lanes...) to `e` (bonds..., lanes...); further components of `u`,
    such as a rotation, are ignored. **Raises** ValueError for a vector of length zero or a map that
    is neither Shift nor Pairs. The user must balance the preloads and the boundary's loads at
    u = 0: `Lattice.unbalanced()` gives the remainder.

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
    r"""The component of a difference of vectors along a fixed direction: e = d . (u_tail - u_head).

    With the unit vector d from tail to head, a `Stretch` without geometric nonlinearity; with d the
    axis of rotation, (0, 0, 1), rolling resistance.

    **Arguments:** `pairs`: a `Shift` or `Pairs` that joins the sites. `direction`: d,
    (components,), not zero, dimensionless.

    **Shapes:** `u` (sites..., components, lanes...) to `e` (bonds..., lanes...). **Raises**
    ValueError for a direction that is no vector.
    """

    dimensions = {"pairs": PART, "direction": (0, 0, 0)}
    pairs: TwoEnds
    direction: jnp.ndarray

    def __init__(self, pairs: TwoEnds, direction: Parameter):
        self.pairs = pairs
        self.direction = parameter("direction", direction)
        if self.direction.ndim != 1:
            refuse("direction", "a vector, one number per component of u", repr(direction))

    def strain(self, u):
        return self._along(self.pairs.strain(u), self.direction)

    def gather(self, f):
        direction = trailing(self.direction, f.ndim + 1 - self.axes)
        return self.pairs.gather(direction * jnp.expand_dims(f, self.axes))

    def reach(self, w):
        return self._along(self.pairs.reach(w), jnp.abs(self.direction))

    def stiffness_bound(self, lattice, k):
        return self.pairs.stiffness_bound(lattice, k * jnp.sum(self.direction**2))

    def _along(self, D, direction):
        return jnp.sum(trailing(direction, D.ndim - self.axes) * D, self.axes)


class Slip(Directed):
    r"""The slip of two beads at their contact, in the plane.

    Beads have (u_x, u_y, s): s = R theta [m], the path of a point of the rim, R the bead's radius,
    anticlockwise. With the vector L from tail to head at rest, |L| the sum of the radii, and phi
    the rotation of the line of centres:

    e = s_tail + s_head - |L| phi,   phi = angle from L to L - (u_tail - u_head).

    Positions give phi only up to full turns; the turn nearest to the beads' rotation is taken, so e
    is signed and lies between -pi |L| and pi |L|. Two beads may circle each other any number of
    times. A rigid rotation has no slip, so the force conserves both momenta. For small
    displacements |L| phi is the component of u_head - u_tail along L turned by 90 degrees; with a
    linear law it is Mindlin's tangential stiffness about the static load.

    **Arguments:** as `Stretch`, with a vector of two components. **Shapes:** `u`
    (sites..., 3, lanes...) to `e` (bonds..., lanes...). **Raises** ValueError for a vector not in
    the plane. Source: Mindlin, J. Appl. Mech. 16, 259 (1949); Merkel, Tournat, Gusev, Phys. Rev. E
    82, 031305 (2010).
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
        # Positions do not determine full turns. An e of less than half a turn stays exact.
        return e - 2 * jnp.pi * rest * jax.lax.round(e / (2 * jnp.pi * rest))

    def stiffness_bound(self, lattice, k):
        # A bead's inertia is J m R^2. With weights J w of its displacements and w of its
        # rotation, both rows of |B|^T k |B| w are at most (1 + J) k (w_tail + w_head) over the
        # smaller of its masses.
        axis = lattice.axes
        parts = [
            jnp.min(m, axis) / jnp.max(m, axis)
            for m in jax.tree.leaves(lattice.mass)
            if jnp.ndim(m) > axis
        ]
        J = most(parts) if parts else 1.0
        return self.pairs.stiffness_bound(lattice, (1 + J) * k)
