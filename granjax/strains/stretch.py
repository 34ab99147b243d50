"""Bonds as distances in the plane or in space."""

import equinox as eqx
import jax
import jax.numpy as jnp

from ..checks import parameter, positive, refuse
from ..entry import checked
from ..types import Parameter
from ..units import PART
from .maps import StrainMap, TwoEnds


class Directed(StrainMap):
    """Bonds between sites whose places differ by a vector at rest: what distances and slips have in common."""

    pairs: TwoEnds
    vector: jax.Array
    components: int = eqx.field(static=True)

    @checked
    def __init__(self, pairs: TwoEnds, vector: Parameter):
        self.pairs = pairs
        self.vector = parameter("vector", vector)
        if self.vector.ndim == 0:
            refuse("vector", "a vector of two or three components, from tail to head", repr(vector))
        self.components = self.vector.shape[-1]
        positive("vector", jnp.linalg.norm(self.vector, axis=-1), "A bond at rest has a length.")

    def _geometry(self, u):
        axis = self.pairs.axes
        D = jax.lax.slice_in_dim(self.pairs.strain(u), 0, self.components, axis=axis)
        R = _align(self.vector, D, axis)
        rest = jnp.sqrt(jnp.sum(R * R, axis))
        along = jnp.sum(R * D, axis)
        square = jnp.sum(D * D, axis)
        length = jnp.sqrt(rest * rest - 2 * along + square)
        # |R| - |R - D| without cancellation
        e = (2 * along - square) / (rest + length)
        return D, R, rest, along, square, length, e

    @property
    def axes(self):
        return self.pairs.axes

    def split(self, bonds, u):
        return self.pairs.split(bonds, u)

    def span(self):
        return self.pairs.span()

    def walls(self):
        return self.pairs.walls()


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
    """

    dimensions = {"pairs": PART, "vector": (0, 1, 0)}

    def strain(self, u):
        return self._geometry(u)[-1]

    def load(self, u, law):
        D, R, rest, _, _, length, e = self._geometry(u)
        # F0 (n - n0) = (F0/|R|) (n e - D), as |R| n0 = R and |R - D| = |R| - e
        tension = law.preload / rest
        normal = (R - D) / jnp.expand_dims(length, self.pairs.axes)
        along = normal * jnp.expand_dims(law.force(e) + tension * e, self.pairs.axes)
        return self.pairs.gather(self._with_rest(along - D * jnp.expand_dims(tension, self.pairs.axes), u))

    def _with_rest(self, load, u):
        """A vector for each bond, with zeros for the components that the bond does not read."""
        more = jax.tree.leaves(u)[0].shape[self.pairs.axes] - self.components
        if not more:
            return load
        return jnp.pad(load, [(0, more if i == self.pairs.axes else 0) for i in range(load.ndim)])

    def energy(self, u, law):
        _, _, rest, along, square, length, e = self._geometry(u)
        bend = (along * e - square * rest) / (rest * (rest + length))
        return law.energy(e) + law.preload * bend

    def ends(self, places, u):
        D, R, *_ = self._geometry(u)
        (tail, head), axis = self.pairs._ends(places), self.pairs.axes
        there, _ = self.pairs._ends(jax.tree.map(jnp.ones_like, places))
        moved, pushed = (jax.lax.slice_in_dim(x, 0, self.components, axis=axis) for x in self.pairs._ends(u))
        # of a bond around a ring the head is where the bond leads, of a wall at the tail where it comes from
        tail = jnp.where(there > 0, tail + moved, head + pushed - (R - D))
        return tail, tail + R - D

    def stiffness_bound(self, lattice, k):
        return self.pairs.stiffness_bound(lattice, k)

    def turning(self, lattice, law):
        axis = max(self.vector.ndim - 1 - len(lattice.lanes), 0)
        return jnp.max(jnp.abs(law.preload)) / jnp.min(jnp.linalg.norm(self.vector, axis=axis))


def _align(vector, D, axis):
    """Bring R of shape (d,) or (bonds..., d) or with lanes to the shape of D, whose vector axis is `axis`."""
    if vector.ndim == 1:
        return jnp.broadcast_to(vector.reshape((-1,) + (1,) * (D.ndim - axis - 1)), D.shape)
    return jnp.broadcast_to(vector, D.shape)
