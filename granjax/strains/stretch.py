"""Bonds as distances in the plane or in space."""

import equinox as eqx
import jax
import jax.numpy as jnp

from ..checks import parameter, positive, refuse
from ..types import Parameter
from ..units import PART
from .maps import TwoEnds, VectorMap


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
