"""The base classes of strain maps."""

import abc
from collections.abc import Callable, Sequence
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..base.arrays import trailing
from ..base.checks import plain_zero
from ..base.types import Displacements, Number, Numbers
from ..base.units import Dimensional

# The steps of power iteration for the largest eigenvalue.
POWER_STEPS = 40
# A safety factor for the convergence of this iteration from a random start.
MARGIN = 1.1
BOUNDARIES = ("fixed", "free", "periodic")
BOTH = ("left", "right")


def get(cell: Any, field: str | None) -> Any:
    """Return what belongs to one field of a cell, or to all."""
    return cell if field is None else cell[field]


def put(x: Number | Displacements, field: str | None) -> Displacements:
    """Return a force on one field, or on all sites."""
    return x if field is None else {field: x}


class StrainMap(Dimensional):
    """A map from displacements to one compression per bond.

    The bonds have `axes` leading axes, then lanes. A map needs `strain`; the rest follows by
    automatic differentiation, and may be overridden. `linear`: the strain is linear in the
    displacements. `tangential`: it is the slip of a contact.

    **Example:**

    >>> class Swing(gx.StrainMap):   # next sites joined by slanting springs of length 1
    ...     def strain(self, u):
    ...         return 1 - jnp.sqrt(1 + jnp.diff(u) ** 2)
    >>> chain = gx.Lattice(1.0, gx.Bond(Swing(), gx.Linear(1.0)), sites=4)
    >>> round(float(chain.potential_energy(0.0, jnp.array([0.0, 0.75, 0.75, 0.75]))), 6)
    0.03125
    """

    linear: ClassVar[bool] = False
    tangential: ClassVar[bool] = False

    # Sites along each axis between the ends of the longest bond; `None` if unknown.
    span: ClassVar[tuple[int, ...] | None] = None
    # The ends of a chain where bonds connect to a wall.
    walls: ClassVar[tuple[str, ...]] = ()

    @property
    def axes(self):
        """Number of leading axes of the array over bonds."""
        return 1

    @abc.abstractmethod
    def strain(self, u: Displacements) -> Numbers:
        """Return the compression of every bond, measured from equilibrium."""

    def rate(self, u: Displacements, v: Displacements) -> Numbers:
        """Return de/dt of every bond."""
        return jax.jvp(self.strain, (u,), (v,))[1]

    def pull(self, u: Displacements, f: Numbers) -> Displacements:
        """Return (de/du)^T f on the sites, for f over the bonds."""
        return jax.vjp(self.strain, u)[1](f)[0]

    def load(self, u: Displacements, law: Any) -> Displacements:
        """Return (de/du)^T F(e), the negative of the force on the sites.

        The preload counts only where e(u) is not linear.
        """
        if self.linear:
            return self.pull(u, law.force(self.strain(u)))
        e, transpose = jax.vjp(self.strain, u)
        if plain_zero(law.preload):
            return transpose(law.force(e))[0]
        (now,) = transpose(jnp.broadcast_to(law.preload + law.force(e), e.shape))
        _, transpose = jax.vjp(self.strain, jax.tree.map(jnp.zeros_like, u))
        (rest,) = transpose(jnp.broadcast_to(law.preload, e.shape).astype(e.dtype))
        return jax.tree.map(jnp.subtract, now, rest)

    def push(self, u: Displacements, law: Any) -> Displacements:
        """Return the force on the sites, -load."""
        return jax.tree.map(jnp.negative, self.load(u, law))

    def energy(self, u: Displacements, law: Any) -> Numbers:
        """Return the energy of every bond from equilibrium: energy(e) + F0 (e - linear part)."""
        e = self.strain(u)
        if self.linear:
            return law.energy(e)
        _, linear = jax.jvp(self.strain, (jax.tree.map(jnp.zeros_like, u),), (u,))
        return law.energy(e) + law.preload * (e - linear)

    def split(self, bonds: Numbers, u: Displacements) -> Displacements:
        """Distribute a bond quantity to the sites by |de/du| at rest, or at u where that is zero."""

        # dense, bonds x sites
        def weights(u):
            return jax.tree.map(jnp.abs, jax.jacobian(self.strain)(u))

        def whole(weights):
            return sum(w.sum(tuple(range(bonds.ndim, w.ndim))) for w in jax.tree.leaves(weights))

        rest = weights(jax.tree.map(jnp.zeros_like, u))
        flat = whole(rest) == 0

        def at(u):
            choose = lambda now, rest: jnp.where(trailing(flat, rest.ndim), now, rest)
            return jax.tree.map(choose, weights(u), rest)

        own = jax.lax.cond(jnp.any(flat), at, lambda u: rest, u)
        size = whole(own)
        # A quantity that no site takes is NaN.
        share = bonds / jnp.where((size > 0) | (bonds != 0), size, 1)
        return jax.tree.map(lambda w: jnp.tensordot(share, w, bonds.ndim), own)

    def stiffness_bound(self, lattice: Any, k: Numbers) -> Any:
        """Return a bound on B^T k B for stiffnesses k >= 0 of the bonds, with B = de/du at rest.

        Either a function from w > 0, one number per site, to |B|^T k |B| w; or, as here by power
        iteration, a number no less than the eigenvalues of M^{-1/2} B^T k B M^{-1/2}.
        """
        rest = lattice.zeros()
        return spectral_radius(lambda w: self.pull(rest, k * self.rate(rest, w)), lattice)

    def turning(self, lattice: Any, law: Any) -> Number:
        """Return the transverse stiffness from the preload of rotating bonds."""
        return 0.0

    def _wrapped(self, units):
        return InOtherUnits(self, units.length)


class InOtherUnits(StrainMap):
    """A map in another unit of length."""

    strain_map: StrainMap
    length: jax.Array

    @property
    def axes(self):
        return self.strain_map.axes

    def strain(self, u):
        return self.strain_map.strain(jax.tree.map(lambda x: self.length * x, u)) / self.length


def spectral_radius(product: Callable, lattice: Any):
    """Return the largest |eigenvalue| of M^{-1/2} K M^{-1/2}, where product(w) = K w."""
    root = jax.tree.map(jnp.sqrt, lattice.mass)
    w = jax.tree.map(
        lambda s: np.random.default_rng(0).normal(size=s.shape).astype(s.dtype), lattice.template()
    )

    def power(_, state):
        w, _ = state
        # A product may hold only some of the fields.
        pulled = lattice.total([product(jax.tree.map(jnp.divide, w, root))], w)
        w = jax.tree.map(jnp.divide, pulled, root)
        size = jnp.sqrt(sum(jnp.sum(x * x) for x in jax.tree.leaves(w)))
        return jax.tree.map(lambda x: x / jnp.where(size > 0, size, 1), w), size

    norm = np.sqrt(sum(np.sum(x * x) for x in jax.tree.leaves(w)))
    start = (
        jax.tree.map(lambda x: jnp.asarray(x / norm.astype(x.dtype)), w),
        jnp.zeros((), lattice.dtype),
    )
    return MARGIN * jax.lax.fori_loop(0, POWER_STEPS, power, start)[1]


class LinearMap(StrainMap):
    """A map that is a weighted sum of selected sites, and its transpose."""

    linear: ClassVar[bool] = True

    @abc.abstractmethod
    def gather(self, f: Numbers) -> Displacements:
        """Return the transpose of `strain`, from bonds to sites (or a dict of fields)."""

    @abc.abstractmethod
    def reach(self, w: Displacements) -> Numbers:
        """Return |de/du| w: the sum over the ends of every bond with positive weights."""

    def rate(self, u, v):
        return self.strain(v)

    def pull(self, u, f):
        return self.gather(f)

    def split(self, bonds, u):
        whole, back = jax.vjp(self.reach, jax.tree.map(jnp.ones_like, u))
        return back((bonds / jnp.where(whole > 0, whole, 1)).astype(whole.dtype))[0]

    def stiffness_bound(self, lattice, k):
        def bound(w):
            reached, back = jax.vjp(self.reach, w)
            return back((k * reached).astype(reached.dtype))[0]

        return bound


class Sites(LinearMap):
    """The displacements of the sites, or of one field, for on-site forces."""

    dimensions = {}
    axes = None  # as many as the lattice has
    span: ClassVar[tuple[int, ...] | None] = ()
    field: str | None = eqx.field(static=True, default=None)

    def strain(self, u):
        return get(u, self.field)

    def gather(self, f):
        return put(f, self.field)

    def reach(self, w):
        return self.strain(w)


class End(StrainMap):
    """The displacement of an end site of a chain towards a wall, (1,)."""

    dimensions = {}
    linear: ClassVar[bool] = True
    span: ClassVar[tuple[int, ...] | None] = ()
    side: str = eqx.field(static=True)
    field: str | None = eqx.field(static=True, default=None)

    @property
    def walls(self):
        return (self.side,)

    def strain(self, u):
        x = get(u, self.field)
        return -x[:1] if self.side == "left" else x[-1:]

    def split(self, bonds, u):
        return self.pull(u, -bonds if self.side == "left" else bonds)

    def stiffness_bound(self, lattice, k):
        return lambda w: self.pull(w, k * self.strain(w))


class TwoEnds(LinearMap):
    """e = tail - head, with two selections of sites and their transposes."""

    fields: eqx.AbstractVar[tuple[str, str] | None]

    @abc.abstractmethod
    def _select(self, x, end):
        """The sites at the tails (end 0) or heads (end 1) of all bonds; zero at a wall."""

    @abc.abstractmethod
    def _return(self, f, end):
        """Transpose of `_select`."""

    def joins(self, numbers: Any) -> tuple[np.ndarray, np.ndarray]:
        """Return the site numbers (NumPy arrays) at the tails and heads of all bonds; -1: wall."""
        ends = self.ends(jax.tree.map(lambda x: x + 1, numbers))
        return tuple(np.asarray(end) - 1 for end in ends)

    def ends(self, x: Any) -> tuple:
        """Return the values at the tails and heads of all bonds; zero at a wall."""
        tail, head = (x, x) if self.fields is None else (x[name] for name in self.fields)
        return self._select(tail, 0), self._select(head, 1)

    def gather(self, f):
        at_tail = self._return(f, 0)
        at_head = self._return(f, 1)
        if self.fields is None:
            return at_tail - at_head
        tail, head = self.fields
        return {tail: at_tail - at_head} if tail == head else {tail: at_tail, head: -at_head}

    def push(self, u, law):
        if self.fields is not None:
            return super().push(u, law)
        # head - tail instead of -(tail - head): one operation less.
        f = law.force(self.strain(u))
        return self._return(f, 1) - self._return(f, 0)

    def strain(self, u):
        tail, head = self._weighted(u)
        return tail - head

    def reach(self, w):
        tail, head = self._weighted(w)
        return tail + head

    def _weighted(self, x):
        return self.ends(x)


class VectorMap(StrainMap):
    """A map of bonds between vectors; `pairs` gives the joined sites."""

    pairs: eqx.AbstractVar[TwoEnds]

    @property
    def axes(self):
        return self.pairs.axes

    @property
    def span(self):
        return self.pairs.span

    @property
    def walls(self):
        return self.pairs.walls

    def split(self, bonds, u):
        return self.pairs.split(bonds, self._component(u, 0))

    def _component(self, u, i):
        return jax.tree.map(lambda x: jax.lax.index_in_dim(x, i, self.axes, keepdims=False), u)


def checked_fields(fields: str | Sequence[str] | None):
    """Return `None`, or the field names of tail and head."""
    if fields is None:
        return None
    if isinstance(fields, str):
        return fields, fields
    tail, head = fields
    return tail, head
