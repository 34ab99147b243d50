"""What every term is, and what the rest of the library asks of one."""

import abc
from collections.abc import Callable, Iterator
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..laws import Law, Scaled
from ..printing import told
from ..types import Displacements, Number, Numbers, Pytree
from ..units import PART, Dimensional
from .reach import Dependence, Reach, answers_to, largest_eigenvalue, reads, stand_in
from .waveforms import Breaks, own_breaks, signal_of


class Compression(NamedTuple):
    """What a law of a term acts on at a time: `compression` [m] of all its bonds, or of its sites.

    `place`: "bond" (between sites), "wall" (a site and a wall: one value) or "site" (no contact).
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
        """Overlap [m], positive where closed; `None` for a law that cannot open."""
        return self.law.overlap(self.compression)

    @property
    def room(self):
        """Length [m], positive where the law has a force; `None` for a law that has one everywhere."""
        return self.law.room(self.compression)


class Excitation(NamedTuple):
    """The largest `force` [N] of a drive, `displacement` [m] and `speed` [m/s] of a moving wall."""

    force: jax.Array
    displacement: jax.Array
    speed: jax.Array
    __repr__ = told


class Term(Dimensional):
    r"""One contribution to the force on the sites.

    Write `force`, and `energy` where the term stores any; add one line to the tests' list of cases. All else is found
    by automatic differentiation, and a term overrides what it knows better: its linearisation, a bound on its
    stiffness, the displacements that it does not resist. Of a term's own contacts the library learns by `compressions`.

    - `force(t, u, v, mass)` has the structure of `u`, or is a dict of those fields that the term acts on.
    - `energy(t, u)`: from equilibrium, an array over bonds, sites or whatever it sums over, lanes last.

    **Example:**

    >>> class Gravity(gx.Term):
    ...     g: jax.Array
    ...     def force(self, t, u, v, mass): return self.g * mass * jnp.ones_like(u)
    ...     def energy(self, t, u): return -self.g * u
    >>> chain = gx.Lattice(1.0, (gx.Bond(gx.Shift(1, "free"), gx.Hertz()), Gravity(jnp.array(9.81))), sites=3)
    >>> gx.vector_field(0.0, gx.states.rest(chain), chain)[1]
    Array([9.81, 9.81, 9.81], dtype=float64)
    """

    # the name of the law or number that the force is proportional to, where one is
    linear_in: ClassVar[str | None] = None
    # the variables of the past that the force reads, and their units in SI
    memory: ClassVar[dict[str, str]] = {}
    # whether arrays over the sites hold for every component of a vector there
    per_site: ClassVar[bool] = False
    # sites along each axis that it couples, () for single ones, `None` where that is not known
    span: ClassVar[tuple[int, ...] | None] = None
    # the ends of a chain that it ties to a wall
    walls: ClassVar[tuple[str, ...]] = ()

    @abc.abstractmethod
    def force(
        self, t: Number, u: Displacements, v: Displacements, mass: Displacements | Number
    ) -> Displacements:
        """Force on the sites at time t."""

    def energy(self, t: Number, u: Displacements) -> Any:
        """Potential energy, one value per bond or site, from equilibrium; `None` for a term that stores none."""
        return None

    def preload_force(self, u: Displacements) -> Displacements | None:
        """Force of the preloads of bonds and walls on the sites at rest, or `None`; `u` gives the shapes."""
        t, rest = jnp.zeros(()), jax.tree.map(jnp.zeros_like, u)
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
        """What the term's laws act on."""
        return ()

    def jumps(self) -> tuple[Breaks, ...]:
        """The `Breaks` of its functions of time, where steps end; by default of the one that its `dimensions` name."""
        own = own_breaks(self)
        return () if own is None else (own,)

    def excitation(self, lattice: Any, ts: Numbers) -> Excitation:
        """What drives the lattice from outside during the times `ts`: by default the largest force at rest."""
        zero = jnp.zeros((), lattice.dtype)
        if not reads(self, lattice).time:
            return Excitation(zero, zero, zero)
        rest = lattice.zeros()

        def largest(t):
            force = jax.tree.leaves(self.force(t, rest, rest, lattice.mass))
            return jnp.max(jnp.stack([jnp.max(jnp.abs(f)) for f in force]))

        return Excitation(jnp.max(jax.vmap(largest)(ts)), zero, zero)

    def check(self, name: str, lattice: Any) -> None:
        """Refuse a lattice that has no place for the term."""

    def linearised(self, lattice: Any, t: Number, u: Displacements, v: Displacements) -> Any:
        """The term's tangent about a state, as a term of one more trailing lane; `None` where it has none."""
        found = reads(self, lattice)
        return (
            Tangent(self, t, u, v, lattice.mass, found)
            if found.displacement or found.velocity
            else None
        )

    def exact_damping(self) -> tuple | None:
        """(field, rate) of a linear damping of sites, which a splitting solver takes exactly, or `None`."""
        return None

    def resists(self, lattice: Any, moves: list) -> np.ndarray:
        """How the force answers uniform displacements: columns (n, k), one for each of `moves`, zero for a free one.

        By default dF/du at random displacements of all sizes, each relative to the answer to a random displacement.
        """
        if not reads(self, lattice).displacement:
            return np.zeros((0, len(moves)))
        term, mass = jax.tree.map(stand_in, (self, lattice.mass))
        return np.asarray(answers_to(moves, term, mass, lattice.template())).reshape(-1, len(moves))

    def stiffness_bound(self, lattice: Any, reach: Reach, factor: Number = 1.0) -> Any:
        """A bound on the stiffness at what the motion may reach, times a factor.

        A function that takes w > 0 on the sites to |K| w, with |K| no less than |dF/du| entry by entry; or a number,
        no less than the eigenvalues of M^{-1/2} dF/du M^{-1/2}. By default the latter, estimated at rest and at
        displacements of the energy that `reach` allows: of single sites, of neighbours in antiphase, of a step, of all.
        """
        if not reads(self, lattice).displacement:
            return jnp.zeros((), lattice.dtype)
        return jnp.max(jnp.abs(jnp.asarray(factor, lattice.dtype))) * largest_eigenvalue(
            self, lattice, reach
        )

    def _wrapped(self, units):
        return InOtherUnits(self, units)


class Remembering(Term):
    """A term whose force reads the past, by variables of its own; a run carries them.

    `memory`: their names, and their units in SI. A term that has no `variables` needs a solver of its own.
    """

    def variables(self, lattice: Any) -> dict[str, Numbers] | None:
        """The internal variables as the term holds them; `None` where it has none."""
        return None

    def recalling(self, variables: dict[str, Numbers]) -> Any:
        """The term that holds these internal variables."""
        return self

    def advanced(
        self, variables: dict[str, Numbers], step: Number, y0: Any, y1: Any
    ) -> dict[str, Numbers]:
        """The internal variables after a time step from the state y0 to y1."""
        return variables

    def lost(self, variables: dict[str, Numbers]) -> Any:
        """The energy dissipated so far, which these variables say, an array over bonds."""
        return None


class Altered(Term):
    """A term that gives what another one gives, changed."""

    term: eqx.AbstractVar[Term]

    def check(self, name, lattice):
        self.term.check(name, lattice)

    def preload_force(self, u):
        return self.term.preload_force(u)

    def resists(self, lattice, moves):
        return self.term.resists(lattice, moves)

    def jumps(self):
        return super().jumps() + self.term.jumps()


def layers(term: Term) -> Iterator[Term]:
    """The term, then what it alters, and so on."""
    yield term
    if isinstance(term, Altered):
        yield from layers(term.term)


def within(term: Term) -> Term:
    """The term that others alter, or the term itself."""
    *_, inner = layers(term)
    return inner


def functions_of_time(term: Term) -> list[Callable]:
    """The functions of time of a term and of those that it alters, of which no breaks are known."""
    return [
        getattr(part, name)
        for part in layers(term)
        if (name := signal_of(part)) is not None and not part.jumps()
    ]


def memory_of(term: Term) -> dict[str, str]:
    """What of the past the force reads: names of variables and their units in SI; empty for most terms."""
    return within(term).memory


def get(u: Displacements, field: str | None) -> Number:
    """A field of the displacements, or all where they have none."""
    return u if field is None else u[field]


def put(x: Number, field: str | None) -> Displacements:
    """A force on a field, or on all sites."""
    return x if field is None else {field: x}


def wider(tree: Pytree):
    """Arrays with a trailing axis for tangents; single numbers as they are."""
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
        return each_tangent(slope, self.reads)(u, v)


def each_tangent(function: Callable, reads: Dependence, axis: int = -1):
    """A linear function for many tangents along an axis: at once, or one by one where that cannot be compiled."""
    if not reads.transforms:
        return jax.vmap(function, in_axes=axis, out_axes=axis)

    def one_by_one(*tangents):
        first = jax.tree.map(lambda x: jnp.moveaxis(x, axis, 0), tangents)
        return jax.tree.map(
            lambda x: jnp.moveaxis(x, 0, axis), jax.lax.map(lambda x: function(*x), first)
        )

    return one_by_one


def times(term: Term, factor: Number) -> Term:
    """The term with its force times a factor: a number, or an array over its bonds where it has bonds."""
    if term.linear_in is None:
        return Multiplied(term, jnp.asarray(factor))
    own = getattr(term, term.linear_in)
    scaled = Scaled(own, factor) if term.linear_in == "law" else factor * own
    return eqx.tree_at(lambda x: getattr(x, x.linear_in), term, scaled)


class Multiplied(Altered):
    """A term with its force and energy times a factor."""

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
    """A term with all that it reads and gives counted in other units."""

    term: Term
    units: object

    def force(self, t, u, v, mass):
        mass = _times(mass, self.units.mass)
        state = self.units.state_to_si((u, v))
        return _times(self.term.force(t * self.units.time, *state, mass), 1 / self.units.force)

    def energy(self, t, u):
        energy = self.term.energy(t * self.units.time, _times(u, self.units.length))
        return _times(energy, 1 / self.units.energy)

    def preload_force(self, u):
        return _times(self.term.preload_force(u), 1 / self.units.force)

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
