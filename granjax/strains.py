"""Strain maps: from displacements to the compression of every bond, and back by the transpose.

Compression is positive: the bond between a tail and a head site has e = u_tail - u_head. A linear map carries the
pair `strain(u)` and `gather(f)`, where `gather` is the transpose, so that the force on the sites is
`-gather(law.force(strain(u)))`. A map of one's own needs `strain` alone: `jax.vjp` supplies the rest.
"""

import abc

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .checks import one_of, parameter, positive, refuse, whole

BOUNDARIES = ("fixed", "free", "periodic")


class StrainMap(eqx.Module):
    """A map from displacements to one compression per bond; `axes` leading axes count the bonds, lanes follow."""

    @property
    def axes(self):
        """Number of leading axes of the array over bonds."""
        return 1

    @abc.abstractmethod
    def strain(self, u):
        """Compression of every bond, measured from equilibrium."""

    def load(self, u, law):
        """What the bonds take from the sites: (de/du)^T F(e), the preload counted only where e(u) is not linear.

        The force on the sites is minus this.
        """
        e, transpose = jax.vjp(self.strain, u)
        (now,) = transpose(jnp.broadcast_to(law.preload + law.force(e), e.shape))
        _, transpose = jax.vjp(self.strain, jax.tree.map(jnp.zeros_like, u))
        (rest,) = transpose(jnp.broadcast_to(law.preload, e.shape).astype(e.dtype))
        return jax.tree.map(jnp.subtract, now, rest)

    def push(self, u, law):
        """Force on the sites, -load."""
        return jax.tree.map(jnp.negative, self.load(u, law))

    def energy(self, u, law):
        """Energy of every bond, measured from equilibrium: energy(e) + F0 (e - its linear part)."""
        e = self.strain(u)
        _, linear = jax.jvp(self.strain, (jax.tree.map(jnp.zeros_like, u),), (u,))
        return law.energy(e) + law.preload * (e - linear)

    def split(self, bonds, u):
        """A quantity of the bonds shared out to their sites as |de/du| at rest weighs these; dense, bonds x sites."""
        weights = jax.tree.map(jnp.abs, jax.jacfwd(self.strain)(jax.tree.map(jnp.zeros_like, u)))
        whole = sum(w.sum(tuple(range(bonds.ndim, w.ndim))) for w in jax.tree.leaves(weights))
        return jax.tree.map(lambda w: jnp.tensordot(bonds / whole, w, bonds.ndim), weights)


class _Linear(StrainMap):
    """A map e = tail - head, by two selections of sites and their transposes."""

    fields: eqx.AbstractVar[tuple[str, str] | None]

    @abc.abstractmethod
    def _select(self, x, end):
        """The sites of one array at the tails (end 0) or heads (end 1) of all bonds; zero at a wall."""

    @abc.abstractmethod
    def _return(self, f, end):
        """Transpose of `_select`."""

    def _ends(self, u):
        if self.fields is None:
            return self._select(u, 0), self._select(u, 1)
        tail, head = self.fields
        return self._select(u[tail], 0), self._select(u[head], 1)

    def _gather(self, f, combine, alone=lambda x: x):
        at_tail, at_head = self._return(f, 0), self._return(f, 1)
        if self.fields is None:
            return combine(at_tail, at_head)
        tail, head = self.fields
        if tail == head:
            return {tail: combine(at_tail, at_head)}
        return {tail: alone(at_tail), head: combine(jnp.zeros_like(at_head), at_head)}

    def strain(self, u):
        tail, head = self._ends(u)
        return tail - head

    def gather(self, f):
        """Transpose of `strain`: an array over bonds to the sites (a dict of the fields that it touches)."""
        return self._gather(f, jnp.subtract)

    def reach(self, w):
        """|de/du| w: the sum, instead of the difference, over the two ends of every bond."""
        tail, head = self._ends(w)
        return tail + head

    def reach_back(self, f):
        """Transpose of `reach`."""
        return self._gather(f, jnp.add)

    def load(self, u, law):
        return self.gather(law.force(self.strain(u)))

    def push(self, u, law):
        # head less tail, instead of minus (tail less head): one operation less
        return self._gather(law.force(self.strain(u)), lambda tail, head: head - tail, jnp.negative)

    def energy(self, u, law):
        return law.energy(self.strain(u))

    def split(self, bonds, u):
        return jax.tree.map(lambda s: s / 2, self.reach_back(bonds))


def _fields(fields):
    if fields is None:
        return None
    if isinstance(fields, str):
        return fields, fields
    named = isinstance(fields, (tuple, list)) and all(isinstance(f, str) for f in fields)
    if not named or len(fields) != 2:
        refuse("fields", "a name, or the names of tail and head", repr(fields), 'Write fields=("bead", "resonator").')
    return tuple(fields)


class Shift(_Linear):
    r"""Bonds between each site and the site `offset` further on: e_n = u_n - u_{n+offset}. The normal form.

    **Arguments:**

    - `offset`: a whole number, or a tuple of them, one per axis of the lattice; 0 only between two fields.
    - `boundary`: `"fixed"` (rigid walls; N + |offset| bonds), `"free"` (N - |offset|) or `"periodic"` (N); a tuple
      for one per axis.
    - `fields`: name of the field, or the pair (tail, head), where a cell holds several; `None` for a plain array.

    **Shapes:** `u` (N,) to `e` (N + 1,), (N - 1,) or (N,) for offset 1; trailing axes (vectors, lanes) pass through.
    **Raises** ValueError for an unknown boundary, an offset that is no whole number, or 0 within one field.
    """

    offset: tuple[int, ...] = eqx.field(static=True)
    boundary: tuple[str, ...] = eqx.field(static=True)
    fields: tuple[str, str] | None = eqx.field(static=True)

    def __init__(self, offset=1, boundary="fixed", fields=None):
        offsets = tuple(offset) if isinstance(offset, (tuple, list)) else (offset,)
        if not offsets or any(isinstance(k, bool) or not isinstance(k, (int, np.integer)) for k in offsets):
            refuse("offset", "a whole number, or one per axis", repr(offset))
        boundaries = tuple(boundary) if isinstance(boundary, (tuple, list)) else (boundary,) * len(offsets)
        if len(boundaries) != len(offsets):
            refuse("boundary", f"{len(offsets)} names, one per axis", repr(boundary))
        self.offset = tuple(int(k) for k in offsets)
        self.boundary = tuple(one_of("boundary", b, BOUNDARIES) for b in boundaries)
        self.fields = _fields(fields)
        if not any(self.offset) and (self.fields is None or self.fields[0] == self.fields[1]):
            refuse("offset", "a step that is not zero within one field", repr(offset), "A site has no bond to itself.")

    @property
    def axes(self):
        """Number of leading axes of the lattice that the bonds keep."""
        return len(self.offset)

    def _select(self, x, end):
        for axis, (k, boundary) in enumerate(zip(self.offset, self.boundary)):
            x = _select_axis(x, axis, k, boundary, end)
        return x

    def _return(self, f, end):
        for axis, (k, boundary) in enumerate(zip(self.offset, self.boundary)):
            f = _return_axis(f, axis, k, boundary, end)
        return f


def _cut(x, axis, start, stop):
    return jax.lax.slice_in_dim(x, start, stop, axis=axis)


def _pad(x, axis, low, high):
    widths = [(0, 0)] * x.ndim
    widths[axis] = (low, high)
    return jnp.pad(x, widths)


def _select_axis(x, axis, k, boundary, end):
    """Tails (end 0) or heads (end 1) along one axis; a head lies k sites after its tail."""
    if k == 0:
        return x
    if boundary == "periodic":
        return x if end == 0 else jnp.roll(x, -k, axis)
    ahead = (k > 0) == (end == 0)
    if boundary == "fixed":
        return _pad(x, axis, abs(k), 0) if ahead else _pad(x, axis, 0, abs(k))
    size = x.shape[axis]
    return _cut(x, axis, 0, size - abs(k)) if ahead else _cut(x, axis, abs(k), size)


def _return_axis(f, axis, k, boundary, end):
    if k == 0:
        return f
    if boundary == "periodic":
        return f if end == 0 else jnp.roll(f, k, axis)
    ahead = (k > 0) == (end == 0)
    if boundary == "fixed":
        size = f.shape[axis]
        return _cut(f, axis, abs(k), size) if ahead else _cut(f, axis, 0, size - abs(k))
    return _pad(f, axis, 0, abs(k)) if ahead else _pad(f, axis, abs(k), 0)


WALL = -1


class Pairs(_Linear):
    """Bonds listed one by one, on any graph: e_b = u[tail_b] - u[head_b]. The escape hatch.

    **Arguments:** `tail`, `head`: site indices along the first axis, one of each per bond; -1 is a rigid wall.
    `sites`: number of sites, where the last ones have no bond (a pair for two fields). `fields`: as in `Shift`.

    **Shapes:** `u` (N,) to `e` (bonds,). **Raises** ValueError for indices that are no whole numbers, lists of
    different length, an index outside the lattice, or a bond from a site to itself.
    """

    tail: tuple[int, ...] = eqx.field(static=True)
    head: tuple[int, ...] = eqx.field(static=True)
    sites: tuple[int, int] = eqx.field(static=True)
    fields: tuple[str, str] | None = eqx.field(static=True)

    def __init__(self, tail, head, *, sites=None, fields=None):
        self.fields = _fields(fields)
        self.tail, self.head = _indices("tail", tail), _indices("head", head)
        if len(self.tail) != len(self.head):
            refuse("head", f"{len(self.tail)} indices, as many as tails", f"{len(self.head)}")
        within = self.fields is None or self.fields[0] == self.fields[1]
        if within and any(t == h for t, h in zip(self.tail, self.head)):
            refuse("head", "another site than the tail", "the same", "A site has no bond to itself.")
        least = max(self.tail) + 1, max(self.head) + 1
        if within:
            least = (max(least),) * 2
        given = least if sites is None else tuple(sites) if isinstance(sites, (tuple, list)) else (sites,) * 2
        given = tuple(whole("sites", g) for g in given)
        if len(given) != 2 or any(g < n for g, n in zip(given, least)):
            refuse("sites", f"at least {max(least)}, the largest index and one", repr(sites))
        self.sites = given

    @property
    def axes(self):
        """Number of leading axes of the lattice that the bonds keep."""
        return 1

    def _select(self, x, end):
        index = np.array((self.tail, self.head)[end])
        sites = self.sites[end]
        if x.shape[0] != sites:
            refuse("sites", f"{x.shape[0]}, the lattice's number of sites", f"{sites}", "Give Pairs(..., sites=...).")
        chosen = x[np.where(index == WALL, 0, index)]
        if (index == WALL).any():
            there = (index != WALL).astype(x.dtype).reshape((-1,) + (1,) * (x.ndim - 1))
            chosen = chosen * there
        return chosen

    def _return(self, f, end):
        index = np.array((self.tail, self.head)[end])
        sites = self.sites[end]
        # a wall's share goes to one site too many, which is then cut off
        spread = jnp.zeros((sites + 1,) + f.shape[1:], f.dtype)
        return spread.at[np.where(index == WALL, sites, index)].add(f)[:sites]


def _indices(name, x):
    try:
        x = np.asarray(x)
    except ValueError:
        refuse(name, "a list of site indices (-1 for a wall)", repr(x))
    if x.ndim != 1 or x.size == 0 or x.dtype.kind not in "iu" or x.min() < WALL:
        refuse(name, "a list of site indices (-1 for a wall)", np.array2string(x, threshold=6))
    return tuple(int(i) for i in x)


class Stretch(StrainMap):
    r"""Bonds as distances in the plane or in space, with the geometry's own nonlinearity and the prestress.

    With D = u_tail - u_head and the vector R from tail to head at rest: length |R - D|, compression
    e = |R| - |R - D|, direction n = (R - D)/|R - D|. The sites feel the total force F0 + F(e) along n less F0 along
    n0 = R/|R|, so that the preload turns with the bond and gives the transverse stiffness -F0/|R|.

    **Arguments:** `pairs`: a `Shift` or `Pairs` that says which sites are joined. `vector`: R, shape (d,) or
    (bonds..., d) [m], not zero.

    **Shapes:** `u` (sites..., d, lanes...) to `e` (bonds..., lanes...). **Raises** ValueError for a vector of length
    zero or a map that is neither Shift nor Pairs. That the preloads balance at u = 0, with the boundary's loads, is
    the user's: `Lattice.unbalanced()` gives what is left over.
    """

    pairs: _Linear
    vector: jax.Array

    def __init__(self, pairs, vector):
        if not isinstance(pairs, _Linear):
            refuse("pairs", "a Shift or Pairs", repr(pairs))
        self.pairs = pairs
        self.vector = parameter("vector", vector)
        if self.vector.ndim == 0:
            refuse("vector", "a vector of two or three components, from tail to head", repr(vector))
        positive("vector", jnp.linalg.norm(self.vector, axis=-1), "A bond at rest has a length.")

    def _geometry(self, u):
        D = self.pairs.strain(u)
        axis = self.pairs.axes
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

    def strain(self, u):
        return self._geometry(u)[-1]

    def load(self, u, law):
        D, R, rest, _, _, length, e = self._geometry(u)
        # F0 (n - n0) = (F0/|R|) (n e - D), as |R| n0 = R and |R - D| = |R| - e
        tension = law.preload / rest
        normal = (R - D) / jnp.expand_dims(length, self.pairs.axes)
        along = normal * jnp.expand_dims(law.force(e) + tension * e, self.pairs.axes)
        return self.pairs.gather(along - D * jnp.expand_dims(tension, self.pairs.axes))

    def energy(self, u, law):
        _, _, rest, along, square, length, e = self._geometry(u)
        bend = (along * e - square * rest) / (rest * (rest + length))
        return law.energy(e) + law.preload * bend

    def split(self, bonds, u):
        return self.pairs.split(bonds, u)


def _align(vector, D, axis):
    """Bring R of shape (d,) or (bonds..., d) or with lanes to the shape of D, whose vector axis is `axis`."""
    if vector.ndim == 1:
        return jnp.broadcast_to(vector.reshape((-1,) + (1,) * (D.ndim - axis - 1)), D.shape)
    return jnp.broadcast_to(vector, D.shape)
