"""Forces between sites: bonds, and terms whose stiffness changes in time."""

from collections.abc import Callable
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..checks import plain_zero
from ..laws import Law, Linear, Scaled
from ..programs import compiled, concretely
from ..strains import StrainMap
from ..types import Displacements, Number, Numbers, Parameter, Waveform
from ..units import PART, Signal
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

    **Arguments:** `strain_map`, such as `Shift(1, "fixed")`; `law`, such as `Hertz()`.
    **Raises** ValueError where these are no strain map or no law.

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
        self.strain_map, self.law = strain_map, law

    def compression(self, t: Number, u: Displacements) -> Numbers:
        """Compression of every bond."""
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
        if isinstance(bound, jax.Array):  # of de/du at rest, which is not all of a user-defined map
            bound = jnp.maximum(bound, largest * largest_eigenvalue(self, lattice, reach))
        return bound


def spring(law: Law, e: Number):
    """The linear spring of a law's stiffness at compressions e, one lane wider."""
    # not by the constructor, whose checks cost time at every step that is not compiled
    return eqx.tree_at(lambda spring: spring.stiffness, Linear(), law.derivative(e)[..., None])


class Grip(Bond):
    r"""A tangential spring of a contact, which it lets go of: energy V(x) g(s/|x|), s the contact's overlap.

    g = 1 while |x| <= s: the contact grips, by the law's own force. Where it has moved along by more than it is pressed
    in, g = z^3 (10 - 15 z + 6 z^2) of z = s/|x|, and g = 0 where it is open. So the force -dE/du, of which a part is
    along the line of centres, is continuous, keeps the energy and both momenta, and asks for nothing of the past: an
    open contact has no tangential force, and it grips again where the beads come back to within s of where they touched
    at rest. With k_t and k_n of a contact s^p it lets go at |T|/N = p k_t/k_n, 1.2 for Mindlin's spheres, which real
    contacts reach by sliding, with friction: there is none here (`gx.measures.slip_ratio`).

    **Arguments:** `strain_map`: x, a `gx.strains.Slip`, or the `gx.strains.Along` of two turns that roll; `law`: V and
    its force; `contact`: the `Bond` along the line of centres, with as many bonds, whose law says the overlap. A law
    that cannot open (a spring, glue) never lets go.
    """

    dimensions = {"strain_map": PART, "law": PART, "contact": PART}
    linear_in: ClassVar[str | None] = None
    contact: Bond

    def __init__(self, strain_map: StrainMap, law: Law, contact: Bond):
        super().__init__(strain_map, law)
        self.contact = contact

    def _stored(self, x, overlap):
        """V(x) g(s/|x|), elementwise."""
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
        x, overlap = self.strain_map.strain(u), self._overlap(u)
        total = jax.grad(lambda x: jnp.sum(self._stored(x, overlap)))(x)
        own = self.law.preload + self.law.force(x)
        part = jnp.where(own == 0, 1, total / jnp.where(own == 0, 1, own))
        return (Compression(Scaled(self.law, part), x),)


class Modulated(Altered):
    """A term whose force changes in time: F -> g(t) F.

    The factor multiplies the force measured from equilibrium, so that u = 0 stays an equilibrium.

    **Arguments:** `term`: any term that stores energy or dissipates it: a `Bond`, an `OnSite`, a `Wall`, a `Dashpot`,
    one of your own; `modulation`: g(t), a function or Module such as `Harmonic(0.1, omega, mean=1.0)`; it may return
    an array over the bonds (a travelling modulation).
    `breaks`: the times at which g or a derivative of it jumps, a list or `Breaks(times, period)`; steps end there, and
    see g from one side. Without them every method is of order 2 at best there. `None`: those that the modulation knows
    itself, by an attribute `breaks`, as `Square` does.
    **Raises** ValueError for no term, a modulation that cannot be called, or breaks that are not finite.

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
        self.term, self.modulation = term, as_module(modulation)
        self.breaks = checked_breaks(breaks)

    def at(self, t: Number) -> Term:
        """The term with the stiffness it has at time t."""
        return times(self.term, self.modulation(t))

    def force(self, t, u, v, mass):
        return self.at(t).force(t, u, v, mass)

    def energy(self, t, u):
        return self.at(t).energy(t, u)

    def compressions(self, t, u):
        return self.at(t).compressions(t, u)

    def linearised(self, lattice, t, u, v):
        return self.at(t).linearised(lattice, t, u, v)

    def excitation(self, lattice, ts):
        return self.term.excitation(lattice, ts)

    def stiffness_bound(self, lattice, reach, factor=1.0):
        largest = jnp.max(jnp.abs(jax.vmap(self.modulation)(reach.ts)), axis=0)
        return self.term.stiffness_bound(lattice, reach, factor * largest)
