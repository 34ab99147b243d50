"""The base classes of all terms, and operations that hold for every term."""

import abc
from collections.abc import Callable, Iterator
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..base.arrays import most
from ..base.printing import told
from ..base.types import Displacements, Number, Numbers, Pytree
from ..base.units import PART, Dimensional
from ..laws import Law, Scaled
from ..strains.maps import get, put
from .reach import Dependence, Reach, answers_to, largest_eigenvalue, reads, stand_in
from .waveforms import Breaks, own_breaks, signal_of


class Compression(NamedTuple):
    """The law of a term and the `compression` [m] of all its bonds or sites.

    `place`: "bond", "wall" (between a site and a wall: one value) or "site" (no contact).
    """

    law: Law
    compression: jax.Array
    place: str = "bond"
    __repr__ = told

    @property
    def force(self):
        """Total contact force F0 + F(e) [N]."""
        force = self.law.force(self.compression)
        return force + jnp.asarray(self.law.preload).astype(force.dtype)

    @property
    def overlap(self):
        """Overlap [m], positive where the contact is closed; `None` for a law that cannot open."""
        return self.law.overlap(self.compression)

    @property
    def room(self):
        """Length [m], positive where the law has a force; `None` if it has one everywhere."""
        return self.law.room(self.compression)


class Excitation(NamedTuple):
    """The largest `force` [N] of drives, `displacement` [m] and `speed` [m/s] of moving walls."""

    force: Number = 0.0
    displacement: Number = 0.0
    speed: Number = 0.0
    __repr__ = told


class Term(Dimensional):
    r"""One contribution to the force on the sites.

    Write `force`, and `energy` if the term stores any. The rest is found by automatic
    differentiation; a term may override what it knows better.

    - `force(t, u, v, mass)` has the structure of `u`, or is a dict of the fields that the term acts
      on.
    - `energy(t, u)`: from equilibrium, an array over bonds, sites or another index, lanes last.
    - `compressions(t, u)`: the contacts of the term, if it has any; where their forces depend on
      velocities, `moving(u, v)` returns a term whose contacts have these forces.

    **Example:**

    >>> class Gravity(gx.Term):
    ...     g: jax.Array
    ...     def force(self, t, u, v, mass): return self.g * mass * jnp.ones_like(u)
    ...     def energy(self, t, u): return -self.g * u
    >>> chain = gx.Lattice(1.0, (gx.Bond(gx.Shift(1, "free"), gx.Hertz()), Gravity(jnp.array(9.81))), sites=3)
    >>> gx.vector_field(0.0, gx.states.rest(chain), chain)[1]
    Array([9.81, 9.81, 9.81], dtype=float64)
    """

    # The field with the law or number that the force is proportional to, if there is one.
    linear_in: ClassVar[str | None] = None
    # The memory variables that the force reads, and their units in SI.
    memory: ClassVar[dict[str, str]] = {}
    # Whether a parameter array over the sites applies to every component of a vector there.
    per_site: ClassVar[bool] = False
    # Range of the coupling in sites along each axis; () for single sites, `None` if unknown.
    span: ClassVar[tuple[int, ...] | None] = None
    # The ends of a chain that the term ties to a wall.
    walls: ClassVar[tuple[str, ...]] = ()

    @abc.abstractmethod
    def force(
        self, t: Number, u: Displacements, v: Displacements, mass: Displacements | Number
    ) -> Displacements:
        """Return the force on the sites at time t."""

    def energy(self, t: Number, u: Displacements) -> Any:
        """Return the energy from equilibrium per bond or site; `None` if the term stores none."""
        return None

    def preload_force(self, u: Displacements) -> Displacements | None:
        """Return the force of the preloads on the sites at rest; `u` gives the shapes."""
        t = jnp.zeros(())
        rest = jax.tree.map(jnp.zeros_like, u)
        contacts = [c for c in self.compressions(t, rest) if c.place != "site"]
        if not contacts:
            return None

        def squeezed(u):
            return [c.compression for c in self.compressions(t, u) if c.place != "site"]

        found, transpose = jax.vjp(squeezed, rest)
        preloads = [
            jnp.broadcast_to(c.law.preload, e.shape).astype(e.dtype)
            for c, e in zip(contacts, found)
        ]
        return jax.tree.map(jnp.negative, transpose(preloads)[0])

    def compressions(self, t: Number, u: Displacements) -> tuple[Compression, ...]:
        """Return a `Compression` for each law of the term."""
        return ()

    def moving(self, u: Displacements, v: Displacements) -> Any:
        """Return the term with the forces of its `compressions` at velocities `v`."""
        return self

    def jumps(self) -> tuple[Breaks, ...]:
        """Return the `Breaks` of the functions of time, where time steps end."""
        own = own_breaks(self)
        return () if own is None else (own,)

    def excitation(self, lattice: Any, ts: Numbers) -> Excitation:
        """Return the excitation during the times `ts`: by default the largest force at rest."""
        if not reads(self, lattice).time:
            return Excitation()
        rest = lattice.zeros()

        def largest(t):
            return most(jax.tree.map(jnp.abs, self.force(t, rest, rest, lattice.mass)))

        return Excitation(jnp.max(jax.vmap(largest)(ts)))

    def check(self, name: str, lattice: Any) -> None:
        """Raise ValueError for a lattice that the term cannot act on."""

    def linearised(self, lattice: Any, t: Number, u: Displacements, v: Displacements) -> Any:
        """Return the tangent about a state as a term with one more trailing lane, or `None`."""
        found = reads(self, lattice)
        return (
            Tangent(self, t, u, v, lattice.mass, found)
            if found.displacement or found.velocity
            else None
        )

    def exact_damping(self) -> tuple | None:
        """Return (field, rate) of linear damping that splitting solvers take exactly, or `None`."""
        return None

    def resists(self, lattice: Any, moves: list) -> np.ndarray:
        """Return the response of the force to uniform displacements: columns (n, k), one per move.

        Zero for a free one. By default dF/du at random displacements of all sizes, relative to the
        response to a random displacement.
        """
        if not reads(self, lattice).displacement:
            return np.zeros((0, len(moves)))
        term, mass = jax.tree.map(stand_in, (self, lattice.mass))
        return np.asarray(answers_to(moves, term, mass, lattice.template())).reshape(-1, len(moves))

    def stiffness_bound(self, lattice: Any, reach: Reach, factor: Number = 1.0) -> Any:
        """Return a bound on the stiffness within `reach`, times a factor.

        A function from w > 0 on the sites to |K| w, with |K| no less than |dF/du| entry by entry;
        or a number no less than the eigenvalues of M^{-1/2} dF/du M^{-1/2}, by default an estimate.
        """
        if not reads(self, lattice).displacement:
            return jnp.zeros((), lattice.dtype)
        return jnp.max(jnp.abs(jnp.asarray(factor, lattice.dtype))) * largest_eigenvalue(
            self, lattice, reach
        )

    def _wrapped(self, units):
        return InOtherUnits(self, units)


class Remembering(Term):
    """A term whose force reads the past through internal variables, which a run carries.

    `memory`: their names and SI units. A term without `variables` needs a solver of its own.
    """

    def variables(self, lattice: Any) -> dict[str, Numbers] | None:
        """Return the internal variables that the term holds, or `None`."""
        return None

    def recalling(self, variables: dict[str, Numbers]) -> Any:
        """Return the term with these internal variables."""
        return self

    def advanced(
        self, variables: dict[str, Numbers], step: Number, y0: Any, y1: Any
    ) -> dict[str, Numbers]:
        """Return the internal variables after a time step from y0 to y1."""
        return variables

    def lost(self, variables: dict[str, Numbers]) -> Any:
        """Return the energy dissipated so far, an array over bonds, or `None`."""
        return None


class Altered(Term):
    """A term that changes the force of another."""

    term: eqx.AbstractVar[Term]

    def _now(self, t):
        # The term whose force, energy and contacts it has at time t, and that term's time.
        return self.term, t

    def force(self, t, u, v, mass):
        term, t = self._now(t)
        return term.force(t, u, v, mass)

    def energy(self, t, u):
        term, t = self._now(t)
        return term.energy(t, u)

    def compressions(self, t, u):
        term, t = self._now(t)
        return term.compressions(t, u)

    def linearised(self, lattice, t, u, v):
        term, t = self._now(t)
        return term.linearised(lattice, t, u, v)

    def check(self, name, lattice):
        self.term.check(name, lattice)

    def preload_force(self, u):
        return self.term.preload_force(u)

    def moving(self, u, v):
        term = self.term.moving(u, v)
        return self if term is self.term else eqx.tree_at(lambda x: x.term, self, term)

    def resists(self, lattice, moves):
        return self.term.resists(lattice, moves)

    def jumps(self):
        return super().jumps() + self.term.jumps()


class Clipped(Altered):
    """A term whose time is clipped to [`low`, `high`]."""

    term: Term
    low: Number
    high: Number

    def _now(self, t):
        return self.term, jnp.clip(t, self.low, self.high)


def layers(term: Term) -> Iterator[Term]:
    """Yield the term, the term that it wraps, and so on."""
    yield term
    if isinstance(term, Altered):
        yield from layers(term.term)


def within(term: Term) -> Term:
    """Return the innermost wrapped term, or itself."""
    *_, inner = layers(term)
    return inner


def functions_of_time(term: Term) -> list[Callable]:
    """Return the functions of time of all layers of a term without known breaks."""
    return [
        getattr(part, name)
        for part in layers(term)
        if (name := signal_of(part)) is not None and not part.jumps()
    ]


def memory_of(term: Term) -> dict[str, str]:
    """Return the memory variables of a term and their SI units."""
    return within(term).memory


def only(u: Displacements, field: str | None) -> Displacements:
    """Return a dict of one field of the displacements, or all."""
    return put(get(u, field), field)


def replaced(u: Displacements, field: str | None, x: Number) -> Displacements:
    """Return the displacements with those of one field, or all, replaced."""
    return x if field is None else {**u, field: x}


def wider(tree: Pytree):
    """Append an axis for tangents to all arrays, not to numbers."""
    return jax.tree.map(lambda x: x[..., None] if jnp.ndim(x) else x, tree)


class Tangent(Term):
    """The derivative of any term, lane by lane."""

    term: Term
    t: jax.Array
    u: object
    v: object
    mass: object
    reads: Dependence = eqx.field(static=True)

    def force(self, t, u, v, mass):
        _, slope = jax.linearize(
            lambda u, v: self.term.force(self.t, u, v, self.mass), self.u, self.v
        )
        if not self.reads.transforms:
            return jax.vmap(slope, -1, -1)(u, v)
        # One by one, since `vmap` changes the memory layout, with which XLA's transforms fail.
        first = jax.tree.map(lambda x: jnp.moveaxis(x, -1, 0), (u, v))
        found = jax.lax.map(lambda x: slope(*x), first)
        return jax.tree.map(lambda x: jnp.moveaxis(x, 0, -1), found)


def times(term: Term, factor: Number) -> Term:
    """Return the term with its force times a number, or an array over its bonds."""
    if term.linear_in is None:
        return Multiplied(term, jnp.asarray(factor))
    own = getattr(term, term.linear_in)
    scaled = Scaled(own, factor) if term.linear_in == "law" else factor * own
    return eqx.tree_at(lambda x: getattr(x, x.linear_in), term, scaled)


class Multiplied(Altered):
    """A term times a factor."""

    dimensions = {"term": PART, "factor": (0, 0, 0)}
    term: Term
    factor: jax.Array

    def force(self, t, u, v, mass):
        return _times(self.term.force(t, u, v, mass), self.factor)

    def energy(self, t, u):
        return _times(self.term.energy(t, u), self.factor)

    def preload_force(self, u):
        return _times(self.term.preload_force(u), self.factor)

    def compressions(self, t, u):
        found = self.term.compressions(t, u)
        return tuple(c._replace(law=Scaled(c.law, self.factor)) for c in found)

    def linearised(self, lattice, t, u, v):
        inner = self.term.linearised(lattice, t, u, v)
        return None if inner is None else Multiplied(inner, wider(self.factor))

    def stiffness_bound(self, lattice, reach, factor=1.0):
        return self.term.stiffness_bound(lattice, reach, factor * self.factor)


class InOtherUnits(Altered):
    """A term in other units."""

    term: Term
    units: object
    linearised = Term.linearised

    def force(self, t, u, v, mass):
        mass = _times(mass, self.units.mass)
        state = self.units.state_to_si((u, v))
        return _times(self.term.force(t * self.units.time, *state, mass), 1 / self.units.force)

    def energy(self, t, u):
        energy = self.term.energy(t * self.units.time, _times(u, self.units.length))
        return _times(energy, 1 / self.units.energy)

    def preload_force(self, u):
        return _times(self.term.preload_force(u), 1 / self.units.force)

    def moving(self, u, v):
        return super().moving(*self.units.state_to_si((u, v)))

    def compressions(self, t, u):
        found = self.term.compressions(t * self.units.time, _times(u, self.units.length))
        return tuple(
            c._replace(
                law=c.law.in_units(self.units), compression=c.compression / self.units.length
            )
            for c in found
        )

    def jumps(self):
        return tuple(b.in_units(self.units) for b in self.term.jumps())


def _times(tree, factor):
    return jax.tree.map(lambda x: x * factor, tree)
