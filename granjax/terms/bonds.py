"""Forces between sites: bonds, tangential contact springs, time-modulated terms."""

from collections.abc import Callable
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..base.checks import plain_zero
from ..base.programs import compiled, concretely
from ..base.types import Displacements, Number, Numbers, Parameter, Waveform
from ..base.units import PART, Signal
from ..laws import Law, Linear, Scaled
from ..strains import StrainMap
from .base import Altered, Compression, Term, times, wider
from .reach import RESISTS, largest_eigenvalue, stand_in
from .waveforms import Breaks, as_module, checked_breaks

_strain = compiled(lambda strain_map, move: strain_map.strain(move))


class Joined(Term):
    """A term that joins sites by a strain map."""

    strain_map: eqx.AbstractVar[StrainMap]

    def resists(self, lattice, moves):
        # directions that are traced differ from bond to bond, as those of a crystal do
        directions = np.random.default_rng([int(term is self) for term in lattice.terms])
        strain_map = jax.tree.map(lambda x: stand_in(x, directions), self.strain_map)
        answers = np.stack([np.ravel(concretely(_strain, strain_map, move)) for move in moves], -1)
        random = np.random.default_rng(0)
        other = jax.tree.map(lambda x: random.uniform(0.5, 1.5, x.shape).astype(x.dtype), moves[0])
        size = np.max(np.abs(concretely(_strain, strain_map, other)), initial=0.0)
        return np.where(np.abs(answers) > RESISTS * size, answers, 0)


class Bond(Joined):
    """Bonds of one kind: a strain map and a law. Force on the sites: -(de/du)^T law.force(e).

    **Arguments:** `strain_map`, such as `Shift(1, "fixed")`; `law`, such as `Hertz()`. **Raises**
    ValueError where these are no strain map or no law.

    **Example:**

    >>> bond = gx.Bond(gx.Shift(1, "free"), gx.Hertz())
    >>> bond.force(0.0, jnp.array([4.0, 0.0]), jnp.zeros(2), 1.0)
    Array([-8.,  8.], dtype=float64)
    >>> gx.Lattice(1.0, bond, sites=20).shape
    (20,)
    """

    dimensions = {"strain_map": PART, "law": PART}
    linear_in: ClassVar[str | None] = "law"
    strain_map: StrainMap
    law: Law

    def __init__(self, strain_map: StrainMap, law: Law):
        self.strain_map = strain_map
        self.law = law

    def compression(self, t: Number, u: Displacements) -> Numbers:
        """Return the compression of every bond."""
        return self.strain_map.strain(u)

    def force(self, t, u, v, mass):
        return self.strain_map.push(u, self.law)

    def energy(self, t, u):
        return self.strain_map.energy(u, self.law)

    def compressions(self, t, u):
        return (Compression(self.law, self.compression(t, u)),)

    def linearised(self, lattice, t, u, v):
        if self.linear_in is None or not self.strain_map.linear:
            return super().linearised(lattice, t, u, v)
        springs = spring(self.law, self.compression(t, u))
        return eqx.tree_at(lambda term: term.law, wider(self), springs)

    def stiffness_bound(self, lattice, reach, factor=1.0):
        k = factor * reach.stiffest(self.law, 0)
        axes = self.strain_map.axes
        axes = lattice.axes if axes is None else axes
        if lattice.dimension is not None and jnp.ndim(k) > axes + len(lattice.lanes):
            k = jnp.max(k, axis=axes)
        largest = jnp.max(jnp.asarray(factor, lattice.dtype))
        k = k + largest * self.strain_map.turning(lattice, self.law)
        bound = self.strain_map.stiffness_bound(lattice, k)
        if isinstance(bound, jax.Array):  # of de/du at rest only; a user-defined map may vary
            bound = jnp.maximum(bound, largest * largest_eigenvalue(self, lattice, reach))
        return bound


def spring(law: Law, e: Number):
    """Return the linear spring of a law's stiffness at compressions e, with one more lane."""
    # The constructor is avoided: its checks cost time at every uncompiled step.
    return eqx.tree_at(lambda spring: spring.stiffness, Linear(), law.derivative(e)[..., None])


class Grip(Bond):
    r"""A tangential contact spring that can release: energy V(x) g(s/|x|), s the normal overlap.

    g = 1 while |x| <= s: the contact grips with the law's own force. Beyond, g = z^3
    (10 - 15 z + 6 z^2), z = s/|x|; g = 0 for an open contact. The force -dE/du, which has a part
    along the line of centres, is continuous, conserves energy and both momenta, and has no memory:
    a contact grips again once the beads return to within s of where they touched at rest. For a
    normal force s^p it releases at |T|/N = p k_t/k_n, 1.2 for Mindlin's spheres. Real contacts
    reach it by sliding with friction, absent here (`gx.measures.slip_ratio`).

    **Arguments:** `strain_map`: x, a `gx.strains.Slip`, or the `gx.strains.Along` of two rotations
    that roll; `law`: V and its force; `contact`: the `Bond` along the line of centres, with as many
    bonds, whose law gives the overlap. If that law cannot open (a spring, glue), the spring never
    releases.
    """

    dimensions = {"strain_map": PART, "law": PART, "contact": PART}
    linear_in: ClassVar[str | None] = None
    contact: Bond

    def __init__(self, strain_map: StrainMap, law: Law, contact: Bond):
        super().__init__(strain_map, law)
        self.contact = contact

    def _stored(self, x, overlap):
        whole = self.law.energy(x) + self.law.preload * x
        if overlap is None:
            return whole
        size = jnp.abs(x)
        slides = (overlap > 0) & (size > overlap)
        z = jnp.where(slides, overlap, 0) / jnp.where(slides, size, 1)
        return whole * jnp.where(size <= overlap, 1, z**3 * (10 - 15 * z + 6 * z**2))

    def _overlap(self, u):
        return self.contact.law.overlap(self.contact.strain_map.strain(u))

    def force(self, t, u, v, mass):
        return jax.tree.map(jnp.negative, jax.grad(lambda u: jnp.sum(self.energy(t, u)))(u))

    def energy(self, t, u):
        x = self.strain_map.strain(u)
        stored = self._stored(x, self._overlap(u))
        if plain_zero(self.law.preload):
            return stored
        _, linear = jax.jvp(self.strain_map.strain, (jax.tree.map(jnp.zeros_like, u),), (u,))
        return stored - self.law.preload * linear

    def compressions(self, t, u):
        x = self.strain_map.strain(u)
        overlap = self._overlap(u)
        total = jax.grad(lambda x: jnp.sum(self._stored(x, overlap)))(x)
        own = self.law.preload + self.law.force(x)
        part = jnp.where(own == 0, 1, total / jnp.where(own == 0, 1, own))
        return (Compression(Scaled(self.law, part), x),)


class Modulated(Altered):
    """A term whose force changes in time: F -> g(t) F.

    The factor multiplies the force measured from equilibrium, so u = 0 stays an equilibrium.

    **Arguments:** `term`: any term that stores or dissipates energy, such as `Bond`, `OnSite`,
    `Wall`, `Dashpot`; `modulation`: g(t), a function or Module such as
    `Harmonic(0.1, omega, mean=1.0)`, which may return an array over the bonds. `breaks`: the times
    at which g or a derivative of it jumps, a list or `Breaks(times, period)`. Steps end there;
    otherwise every method is at best of order 2. `None`: the attribute `breaks` of the modulation,
    which `Square` has.
    **Raises** ValueError for no term, a modulation that cannot be called, or breaks that are not
    finite.

    **Example:**

    >>> bond = gx.Bond(gx.Shift(1, "free"), gx.Linear())
    >>> modulated = gx.Modulated(bond, gx.Harmonic(0.1, omega=2.0, mean=1.0))
    >>> modulated.force(0.0, jnp.array([1.0, 0.0]), jnp.zeros(2), 1.0)
    Array([-1.1,  1.1], dtype=float64)
    >>> gx.Lattice(1.0, modulated, sites=20).reads_time
    True
    """

    dimensions = {"term": PART, "modulation": Signal((0, 0, 0)), "breaks": PART}
    term: Term
    modulation: Callable
    breaks: Breaks | None

    def __init__(self, term: Term, modulation: Waveform, breaks: Parameter | Breaks | None = None):
        self.term = term
        self.modulation = as_module(modulation)
        self.breaks = checked_breaks(breaks)

    def at(self, t: Number) -> Term:
        """Return the term with its stiffness at time t."""
        return times(self.term, self.modulation(t))

    def _now(self, t):
        return self.at(t), t

    def excitation(self, lattice, ts):
        return self.term.excitation(lattice, ts)

    def stiffness_bound(self, lattice, reach, factor=1.0):
        largest = jnp.max(jnp.abs(jax.vmap(self.modulation)(reach.ts)), axis=0)
        return self.term.stiffness_bound(lattice, reach, factor * largest)
