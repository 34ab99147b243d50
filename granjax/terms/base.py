"""What every term is, and what the rest of the library asks of one."""

import abc
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..checks import refuse
from ..laws import Law, Scaled, Strained
from ..printing import told
from ..types import Displacements, Number, Numbers, Pytree
from ..units import PART, Dimensional
from .reach import Reach, Reached, largest_eigenvalue
from .tracing import Dependence, answers_to, stand_in, time_of, traced, used

DENSE = 4000


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
    by automatic differentiation, and a term overrides what it knows better: what its force reads, its linearisation,
    a bound on its stiffness, the displacements that it does not resist, its form in other units. Of a term's own
    contacts the library learns by `compressions`.

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

    @abc.abstractmethod
    def force(
        self, t: Number, u: Displacements, v: Displacements, mass: Displacements | Number
    ) -> Displacements:
        """Force on the sites at time t."""

    def energy(self, t: Number, u: Displacements) -> Any:
        """Potential energy, one value per bond or site, from equilibrium; `None` for a term that stores none."""
        return None

    def site_energy(self, lattice: Any, t: Number, u: Displacements) -> Any:
        """Potential energy shared out to sites, of the structure of `u` (or of some of its fields).

        By default an array over the sites stays as it is, and another one is shared out as the squares of its
        derivatives weigh the sites; dense, and refused for a large lattice.
        """
        energy = self.energy(t, u)
        if energy is None or not isinstance(u, dict) and energy.shape == u.shape:
            return energy
        size = sum(x.size for x in jax.tree.leaves(u))
        if size > DENSE:
            refuse(
                "lattice",
                f"at most {DENSE} displacements where {type(self).__name__} has no `site_energy`",
                f"{size}",
                "Write its `site_energy`.",
            )
        lanes, own = len(lattice.lanes), energy.ndim - len(lattice.lanes)
        # lanes do not mix, so the derivatives of their sum are those of each
        slopes = jax.jacrev(lambda u: self.energy(t, u).sum(tuple(range(own, own + lanes))))(u)
        weights = jax.tree.map(lambda x: x * x + jnp.finfo(x.dtype).tiny, slopes)
        whole = sum(w.sum(tuple(range(own, w.ndim - lanes))) for w in jax.tree.leaves(weights))
        share = energy / whole
        return jax.tree.map(
            lambda w: jnp.sum(
                share.reshape(share.shape[:own] + (1,) * (w.ndim - lanes - own) + share.shape[own:])
                * w,
                tuple(range(own)),
            ),
            weights,
        )

    def energy_gap(self, lattice: Any, t: Number, u: Displacements) -> Numbers:
        """How far the force is from the slope of the energy, relative: |dE + F.w|/(sum of |dE| and |F w|), along one w.

        Zero, to rounding (also that of the preloads), for a force that keeps the energy; w is irregular. Shape of the
        lanes.
        """
        lanes = len(lattice.lanes)

        def total(x):
            return x.sum(tuple(range(x.ndim - lanes)))

        def along(force):
            return (
                [force[name] * w[name] for name in force]
                if isinstance(force, dict)
                else [force * w]
            )

        w = jax.tree.map(lambda x: _irregular(x, x.ndim - lanes), u)
        _, change = jax.jvp(lambda u: self.energy(t, u), (u,), (w,))
        # displacements are known to their rounding alone, and a motion all alike has no force beyond what that makes
        far = jnp.max(
            jnp.stack(
                [jnp.max(jnp.abs(x), tuple(range(x.ndim - lanes))) for x in jax.tree.leaves(u)]
            ),
            0,
        )
        still = jax.tree.map(jnp.zeros_like, u)
        force, uncertain = jax.jvp(
            lambda u: self.force(t, u, still, lattice.mass),
            (u,),
            (jax.tree.map(lambda x: far * x, w),),
        )
        parts = jax.tree.leaves(change) + along(force)
        size = sum(total(jnp.abs(x)) for x in parts)
        held = [
            jnp.broadcast_to(c.law.preload, c.compression.shape) for c in self.compressions(t, u)
        ]
        rounded = sum(total(jnp.abs(x)) for x in held + along(uncertain))
        rounding = 16 * jnp.finfo(size.dtype).eps * rounded
        missed = jnp.maximum(jnp.abs(sum(total(x) for x in parts)) - rounding, 0)
        return missed / jnp.where(size > 0, size, 1)

    def preload_force(self, u: Displacements) -> Displacements | None:
        """Force of the preloads on the sites at rest, or `None`; `u` gives the shapes."""
        return None

    def compressions(self, t: Number, u: Displacements) -> tuple[Compression, ...]:
        """What the term's laws act on."""
        return ()

    def ends(self, places: Displacements, u: Displacements) -> tuple:
        """Of each of the `compressions` the present places of tails and heads, or `None` where that is not known."""
        return ()

    def opens(self, lattice: Any) -> bool | None:
        """Whether a contact of the term can open: by its laws; `None` where that is not known.

        A term that says nothing of `compressions` does not know, where its force reads displacements.
        """
        found = []

        def look(t, u):
            for c in self.compressions(t, u):
                opens = None if c.law.opens and c.overlap is None else c.law.opens
                found.append(False if c.place == "site" else opens)

        # traced, so that nothing is computed for what the laws know
        jax.eval_shape(look, time_of(lattice), lattice.template())
        if not found:
            return None if self.dependence(lattice).displacement else False
        return None if None in found else True in found

    def at(self, t: Number) -> Any:
        """The term as it stands at time t, where its parameters change in time."""
        return self

    def jumps(self) -> tuple:
        """The `Breaks` of its functions of time, where steps end."""
        return ()

    def between(self, low: Number, high: Number) -> Any:
        """The term with its functions of time, where they have breaks, held beyond two times at what they are there."""
        return self

    def for_run(self, lattice: Any) -> Any:
        """The term with what its force needs and no state changes: made once, at the start of what calls it often."""
        return self

    def undriven(self) -> Any:
        """The term with what moves it from outside held still."""
        return self

    def scaled(self, factor: Number) -> Any:
        """The term with its force times a factor: a number, or an array over its bonds where it has bonds."""
        return Multiplied(self, jnp.asarray(factor))

    def measured_from(self, lattice: Any, u: Displacements) -> Any:
        """The term with its forces beyond those at displacements `u`, which are counted from there."""
        return MeasuredFrom(self, u) if self.dependence(lattice).displacement else self

    def check(self, name: str, lattice: Any) -> None:
        """Refuse a lattice that has no place for the term."""

    def per_vector(self, axes: int) -> Any:
        """The term for displacements that are vectors: parameters over `axes` axes of sites with one axis more."""
        return self

    def linearised(self, lattice: Any, t: Number, u: Displacements, v: Displacements) -> Any:
        """The term's tangent about a state, as a term of one more trailing lane; `None` where it has none."""
        reads = self.dependence(lattice)
        return (
            Tangent(self, t, u, v, lattice.mass, reads)
            if reads.displacement or reads.velocity
            else None
        )

    def exact_damping(self) -> tuple | None:
        """(field, rate) of a linear damping of sites, which a splitting solver takes exactly, or `None`."""
        return None

    def next_neighbours(self, field: str | None = None) -> Any:
        """(law, boundary) of bonds from each site of a chain to the next, or `None`; `field`: of a cell of several."""
        return None

    def next_dashpots(self) -> Any:
        """The coefficient of linear dashpots from each site of a chain to the next, or `None`."""
        return None

    def remembers(self) -> dict[str, str]:
        """What of the past the force reads: names of variables and their units in SI; empty for most terms."""
        return {}

    def variables(self, lattice: Any) -> dict[str, Numbers] | None:
        """The internal variables of a term that remembers by some, as it holds them; `None` where there are none."""
        return None

    def recalling(self, variables: dict[str, Numbers]) -> Any:
        """The term that holds these internal variables."""
        return self

    def advanced(
        self, variables: dict[str, Numbers], step: Number, y0: Any, y1: Any
    ) -> dict[str, Numbers]:
        """The internal variables after a time step from the state y0 to y1."""
        return variables

    def fractional_damping(self) -> tuple | None:
        """(field, order, coefficient) of a damping by Caputo's derivative, which has a solver, or `None`."""
        return None

    def lost(self, variables: dict[str, Numbers]) -> Any:
        """The energy dissipated so far, which these variables say, an array over bonds; `None` where none is."""
        return None

    def walls(self) -> tuple[str, ...]:
        """The ends of a chain that the term ties to a wall: of "left" and "right"."""
        return ()

    def wall_loads(self, u: Displacements) -> Any:
        """The total forces with which rigid walls press on the left and right end of a chain, (2,) and lanes.

        `None` where the term reaches none, or does not know.
        """
        return None

    def without_walls(self, lattice: Any, field: str | None = None) -> tuple | None:
        """(the term between free ends, law at the left wall, law at the right wall), or `None` where there are none."""
        return None

    def span(self) -> tuple[int, ...] | None:
        """Sites along each axis that the term couples; () for single sites, `None` where that is not known."""
        return None

    def dependence(self, lattice: Any) -> Dependence:
        """What the force reads, traced."""
        return traced(self, lattice)[1]

    def stiffness_changes(self, lattice: Any) -> bool:
        """Whether dF/du at rest depends on time."""

        def slope(term, t, u, w, v, mass):
            return jax.jvp(lambda u: term.force(t, u, v, mass), (u,), (w,))[1]

        u = lattice.template()
        return used(slope, (self, time_of(lattice), u, u, u, lattice.mass))[2]

    def resists(self, lattice: Any, moves: list) -> np.ndarray:
        """How the force answers uniform displacements: columns (n, k), one for each of `moves`, zero for a free one.

        By default dF/du at random displacements of all sizes, each relative to the answer to a random displacement.
        """
        if not self.dependence(lattice).displacement:
            return np.zeros((0, len(moves)))
        term, mass = jax.tree.map(stand_in, (self, lattice.mass))
        return np.asarray(answers_to(moves, term, mass, lattice.template())).reshape(-1, len(moves))

    def stiffness_bound(self, lattice: Any, reach: Reach | Reached, factor: Number = 1.0) -> Any:
        """A bound on the stiffness at what the motion may reach, times a factor.

        A function that takes w > 0 on the sites to |K| w, with |K| no less than |dF/du| entry by entry; or a number,
        no less than the eigenvalues of M^{-1/2} dF/du M^{-1/2}. By default the latter, estimated at rest and at
        displacements of the energy that `reach` allows: of single sites, of neighbours in antiphase, of a step, of all.
        """
        if not self.dependence(lattice).displacement:
            return jnp.zeros((), lattice.dtype)
        return jnp.max(jnp.abs(jnp.asarray(factor, lattice.dtype))) * largest_eigenvalue(
            self, lattice, reach
        )

    def excitation(self, lattice: Any, ts: Numbers) -> Excitation:
        """What drives the lattice from outside during the times `ts`."""
        zero = jnp.zeros((), lattice.dtype)
        if not self.dependence(lattice).time:
            return Excitation(zero, zero, zero)
        rest = lattice.zeros()

        def largest(t):
            force = jax.tree.leaves(self.force(t, rest, rest, lattice.mass))
            return jnp.max(jnp.stack([jnp.max(jnp.abs(f)) for f in force]))

        return Excitation(jnp.max(jax.vmap(largest)(ts)), zero, zero)

    def energy_times(self, lattice: Any, ts: Numbers) -> Numbers:
        """The times at which the energy of the initial state is looked at: all where the stiffness changes."""
        return ts if self.dependence(lattice).time else ts[:1]

    def _wrapped(self, units):
        return InOtherUnits(self, units)


def get(u: Displacements, field: str | None):
    """A field of the displacements, or all where they have none."""
    return u if field is None else u[field]


def put(x: Number, field: str | None):
    """A force on a field, or on all sites."""
    return x if field is None else {field: x}


def _irregular(like, axes):
    """Numbers between -1 and 1 without pattern over the leading axes, of the shape of an array."""
    size = int(np.prod(like.shape[:axes]))
    x = np.cos(np.arange(size) ** 2 * 0.6180339887498949 + np.arange(size)).reshape(
        like.shape[:axes]
    )
    return jnp.broadcast_to(x.reshape(x.shape + (1,) * (like.ndim - axes)), like.shape).astype(
        like.dtype
    )


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

    def dependence(self, lattice):
        return self.reads._replace(time=False, energy=False)


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


class MeasuredFrom(Term):
    """A term whose displacements are counted from others, and whose forces from those that it has there."""

    dimensions = {"term": PART, "start": (0, 1, 0)}
    term: Term
    start: Any

    def _moved(self, u):
        return jax.tree.map(
            lambda s, x: (
                jnp.broadcast_to(s.reshape(s.shape + (1,) * (x.ndim - s.ndim)), x.shape) + x
            ),
            self.start,
            u,
        )

    def force(self, t, u, v, mass):
        still = jax.tree.map(jnp.zeros_like, u)
        held = self.term.force(t, self._moved(still), still, mass)
        return jax.tree.map(jnp.subtract, self.term.force(t, self._moved(u), v, mass), held)

    def energy(self, t, u):
        energy = self.term.energy(t, self._moved(u))
        if energy is None:
            return None
        start = self._moved(jax.tree.map(jnp.zeros_like, u))
        held, work = jax.jvp(lambda u: self.term.energy(t, u), (start,), (u,))
        return jax.tree.map(lambda e, held, work: e - held - work, energy, held, work)

    def preload_force(self, u):
        still = jax.tree.map(jnp.zeros_like, u)
        force, held = (
            self.term.force(jnp.zeros(()), self._moved(still), still, 1.0),
            self.term.preload_force(u),
        )
        return force if held is None else jax.tree.map(jnp.add, force, held)

    def compressions(self, t, u):
        start = self._moved(jax.tree.map(jnp.zeros_like, u))
        found = zip(self.term.compressions(t, self._moved(u)), self.term.compressions(t, start))
        return tuple(
            c._replace(
                law=Strained(c.law, s.compression), compression=c.compression - s.compression
            )
            for c, s in found
        )

    def linearised(self, lattice, t, u, v):
        return self.term.linearised(lattice, t, self._moved(u), v)

    def at(self, t):
        return MeasuredFrom(self.term.at(t), self.start)

    def check(self, name, lattice):
        self.term.check(name, lattice)

    def remembers(self):
        return self.term.remembers()

    def jumps(self):
        return self.term.jumps()

    def span(self):
        return self.term.span()

    def walls(self):
        return self.term.walls()


class Multiplied(Term):
    """A term with its force and energy times a factor."""

    dimensions = {"term": PART, "factor": (0, 0, 0)}
    term: Term
    factor: jax.Array

    def force(self, t, u, v, mass):
        return jax.tree.map(lambda f: self.factor * f, self.term.force(t, u, v, mass))

    def energy(self, t, u):
        energy = self.term.energy(t, u)
        return None if energy is None else _times(energy, self.factor)

    def remembers(self):
        return self.term.remembers()

    def site_energy(self, lattice, t, u):
        energy = self.term.site_energy(lattice, t, u)
        return None if energy is None else jax.tree.map(lambda e: self.factor * e, energy)

    def preload_force(self, u):
        force = self.term.preload_force(u)
        return None if force is None else jax.tree.map(lambda f: self.factor * f, force)

    def compressions(self, t, u):
        return tuple(
            c._replace(law=Scaled(c.law, self.factor)) for c in self.term.compressions(t, u)
        )

    def stiffness_bound(self, lattice, reach, factor=1.0):
        return self.term.stiffness_bound(lattice, reach, factor * self.factor)

    def span(self):
        return self.term.span()

    def jumps(self):
        return self.term.jumps()

    def between(self, low, high):
        return eqx.tree_at(lambda x: x.term, self, self.term.between(low, high))

    def opens(self, lattice):
        return self.term.opens(lattice)

    def walls(self):
        return self.term.walls()

    def dependence(self, lattice):
        return self.term.dependence(lattice)


class InOtherUnits(Term):
    """A term with all that it reads and gives counted in other units."""

    term: Term
    units: object

    def remembers(self):
        return self.term.remembers()

    def force(self, t, u, v, mass):
        force = self.term.force(
            t * self.units.time, *self.units.state_to_si((u, v)), _times(mass, self.units.mass)
        )
        return _times(force, 1 / self.units.force)

    def energy(self, t, u):
        energy = self.term.energy(t * self.units.time, _times(u, self.units.length))
        return None if energy is None else _times(energy, 1 / self.units.energy)

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

    def between(self, low, high):
        inner = self.term.between(low * self.units.time, high * self.units.time)
        return eqx.tree_at(lambda x: x.term, self, inner)

    def span(self):
        return self.term.span()


def _times(tree, factor):
    return jax.tree.map(lambda x: x * factor, tree)
