"""The lattice: masses, terms, and their equation of motion."""

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..base.checks import described, held_in_memory, letter, parameter, positive, refuse, whole
from ..base.printing import text, told
from ..base.types import Count, Displacements, Number, Parameter, Site
from ..base.units import SCALED, SI
from ..base.units.names import counted_in, mark_of
from ..terms import LongRange, Term
from ..terms.base import get, memory_of, within
from ..terms.reach import per_lane, reads, traced

# What a force that branches on its strain is told.
_NO_BRANCH = "A force acts on all sites at once: write jnp.where(e > 0, ..., ...) instead of if."
# What a force that calls NumPy is told.
_NO_NUMPY = "JAX traces a force: write it with jax.numpy instead of numpy."


class State(NamedTuple):
    """Displacements and velocities, arrays (or dicts of arrays) of one shape: a diffrax state.

    **Example:**

    >>> state = gx.State(u=jnp.zeros(20), v=jnp.zeros(20).at[0].set(1.0))
    >>> chain = gx.scenes.monomer(20)
    >>> float(gx.measures.energy(chain, state))
    0.5
    """

    u: object
    v: object
    __repr__ = told


class Lattice(eqx.Module):
    r"""Masses and terms: m_i a_i = sum over terms of force_i(t, u, v).

    **Arguments:**

    - `mass`: m > 0 [kg], one per site, an array (N,), or (N1, N2) on a grid; or one number together
      with `sites`; or a dict of those, one per named field of a cell, such as
      `{"bead": m, "resonator": M}`. `lattice.mass` keeps one number as it is, of shape (), which is
      faster; `gx.lattice.spread_mass(lattice)` returns the mass of every site.
    - `terms`: a tuple of `Bond`, `OnSite`, `Damping`, `Dashpot`, `ViscousContact`, `Drag`, `Drive`,
      `Wall`, `Modulated`.
    - `sites`: the number of sites (a tuple on a grid), if `mass` is one number.
    - `dimension`: `None` for scalar displacements; 2 or 3 for vectors, in a trailing axis of `u`. A
      mass may have that axis too, one per component, as for beads that rotate.
    - `positions` [m]: the places of the sites at rest, (N, d) or (N1, N2, d), or a dict of those,
      for pictures; `None` for a chain. Forces do not use them.
    - `units`: `"SI"`, or `"scaled"` for other units. Pictures and files show it; nothing is
      converted. `gx.scenes.beads` is in SI.

    Displacements `u` have the shape `lattice.shape`: (N,), (N1, N2, d), or a dict of those. A batch
    of lattices is `jax.vmap(make, out_axes=-1)(parameters)`; its lanes are trailing axes of
    everything.

    **Raises** ValueError for a mass that is not positive and finite, fewer than two sites, a term
    of another type, or parameters that do not fit the number of bonds or sites, naming the term.

    **Example:**

    >>> bond = gx.Bond(gx.Shift(1, "fixed"), gx.Hertz(precompression=1.0))
    >>> chain = gx.Lattice(1.0, (bond, gx.Damping(0.1)), sites=20)
    >>> chain.shape, chain.conserves
    ((20,), False)
    """

    # A lattice never changes, so that `programs.parted` flattens it only once.
    settled: ClassVar[bool] = True
    mass: object
    terms: tuple[Term, ...]
    positions: object
    _mark: jax.Array
    # Name (`None` for a plain array), shape of the sites, and whether each has a mass of its own.
    _cell: tuple[tuple[str | None, tuple[int, ...], bool], ...] = eqx.field(static=True)
    dimension: int | None = eqx.field(static=True)

    def __init__(
        self,
        mass: Parameter | dict[str, Parameter],
        terms: Term | Sequence[Term],
        *,
        sites: Site | None = None,
        dimension: Count | None = None,
        positions: Parameter | dict[str, Parameter] | None = None,
        units: str = SCALED,
    ):
        self.dimension = None if dimension is None else whole("dimension", dimension, 1)
        masses = {}
        fields = []
        for name, m in (mass if isinstance(mass, dict) else {None: mass}).items():
            argument = "mass" if name is None else f"mass[{name!r}]"
            masses[name], *own = self._one_mass(argument, m, sites)
            fields.append((name, *own))
        self.mass = masses.get(None, masses)
        self._cell = tuple(sorted(fields))
        count = sum(math.prod(shape) for _, shape, _ in fields)
        self.positions = None if positions is None else self._places(positions)
        if count < 2:
            refuse("mass", "at least two sites", f"{count}", "A lattice has bonds.")
        terms = (terms,) if isinstance(terms, Term) else terms
        self.terms = tuple(terms)
        for i, term in enumerate(self.terms):
            if not isinstance(term, Term):
                refuse(
                    f"terms[{i}]",
                    "a term",
                    f"a {type(term).__name__}",
                    "A law needs a Bond, a Wall or an OnSite.",
                )
        self._mark = _one(self.axes + (self.dimension is not None), mark_of(units))
        if self.dimension is not None:
            self.terms = tuple(_per_vector(term, self.axes) for term in self.terms)
        self.check_terms()

    def __repr__(self) -> str:
        try:
            lanes = self.lanes
            kilogram = "kg" if self.units == SI else ""
        except (AttributeError, TypeError, ValueError):  # JAX put other leaves into the tree.
            lanes = ()
            kilogram = ""
        rows = [
            (
                "sites",
                text(self.sites)
                if isinstance(self.sites, dict)
                else " x ".join(map(str, self.sites)),
            )
        ]
        rows += [("vectors of", f"{self.dimension} components")] if self.dimension else []
        rows += [("lanes", " x ".join(map(str, lanes)))] if lanes else []
        rows += [
            ("mass", text(self.mass, kilogram)),
            *(("term", repr(term)) for term in self.terms),
        ]
        return "\n".join(f"{name:<15}{value}".replace("\n", f"\n{'':15}") for name, value in rows)

    def _one_mass(self, name, mass, sites):
        mass = positive(name, mass, "A site needs a mass.")
        per_site = mass.ndim > 0
        if sites is None and not per_site:
            refuse(
                name,
                "an array, one mass per site",
                "one number",
                "Or say how many sites: Lattice(..., sites=N).",
            )
        shape = mass.shape if sites is None else tuple(sites) if np.ndim(sites) else (sites,)
        shape = tuple(whole("sites", n, 1) for n in shape)
        each = self.dimension is not None and per_site and mass.shape == (*shape, self.dimension)
        if per_site and mass.shape != shape and not each:
            refuse(name, f"shape {shape}, one mass per site", f"shape {mass.shape}")
        count = math.prod(shape)
        held_in_memory("sites", count)
        if per_site and self.dimension is not None and not each:
            mass = mass[..., None]
        return mass, shape, per_site

    def _places(self, positions):
        each = positions if isinstance(positions, dict) else {None: positions}
        each = {name: parameter("positions", x) for name, x in each.items()}
        places = each.get(None, each)
        shapes = jax.tree.map(lambda x: x.shape[:-1], places)
        if shapes != self.sites or any(x.shape[-1] not in (1, 2, 3) for x in each.values()):
            given = jax.tree.map(lambda x: x.shape, places)
            refuse(
                "positions", f"places of 1 to 3 numbers for sites {self.sites}", f"shape {given}"
            )
        return places

    def check_terms(self) -> None:
        """Refuse terms whose parameters do not fit the sites, naming them."""
        u = self.template()
        for i, term in enumerate(self.terms):
            name = f"terms[{i}] ({type(term).__name__})"
            term.check(name, self)
            try:
                got, _ = traced(term, self)
            except KeyError as error:
                refuse(
                    name,
                    f"fields among {sorted(self.fields or ())}",
                    str(error),
                    "Check the names of the fields.",
                )
            except (TypeError, ValueError, IndexError, AttributeError) as error:
                wanted = f"parameters that fit a lattice of shape {self.shape}"
                said = str(error)
                remedy = ""
                numpy = isinstance(error, jax.errors.TracerArrayConversionError)
                tracing = isinstance(error, jax.errors.ConcretizationTypeError)
                if numpy or tracing or "truth value" in said:
                    # JAX goes on for a page
                    said = said.partition("\n")[0]
                    remedy = _NO_NUMPY if numpy else _NO_BRANCH
                refuse(name, wanted, f"an error: {said.rstrip('.')}", remedy)
            wanted = (
                u if not isinstance(got, dict) or self.fields is None else {k: u[k] for k in got}
            )
            got, wanted = (jax.tree.map(lambda x: x.shape, shapes) for shapes in (got, wanted))
            if got != wanted:
                remedy = "Its parameters do not fit the lattice."
                refuse(name, f"a force of shape {self.shape}", f"{got}", remedy)

    @property
    def fields(self):
        """The names of the fields of a cell, or `None` for a plain array."""
        return tuple(self.mass) if isinstance(self.mass, dict) else None

    @property
    def sites(self):
        """The shape of the sites without vectors and lanes: (N,), (N1, N2), or a dict of those."""
        sites = {name: shape for name, shape, _ in self._cell}
        return sites.get(None, sites)

    @property
    def axes(self):
        """The number of leading axes that count sites."""
        return len(self._cell[0][1])

    @property
    def space(self):
        """The number of site axes, and of components of a vector (0 for scalars)."""
        return self.axes, self.dimension or 0

    @property
    def origin(self):
        """What results keep of their lattice: its units and axes."""
        return {"_mark": self._mark, "_space": self.space}

    @property
    def lanes(self):
        """The trailing shape of a batch of lattices; () for one.

        **Raises** ValueError for lanes in leading axes, as `jax.vmap` makes them without
        `out_axes=-1`.
        """
        name, sites, per_site = self._cell[0]
        own = self.axes + (self.dimension is not None)
        # With as many sites as lanes the shape of the masses is ambiguous.
        shape = get(self.mass, name).shape
        if (
            self._mark.shape[:own] != (1,) * own
            and _has_sites(self, own)
            or per_site
            and shape[: len(sites)] != sites
        ):
            refuse(
                "lattice",
                "lanes behind the sites",
                f"masses of shape {shape} on sites of shape {sites}",
                "Write jax.vmap(make, out_axes=-1).",
            )
        return shape[own if per_site else 0 :]

    @property
    def shape(self):
        """The shape of the displacements of one lattice (a dict if a cell has several fields)."""
        vector = () if self.dimension is None else (self.dimension,)
        shapes = {name: shape + vector for name, shape, _ in self._cell}
        return shapes.get(None, shapes)

    @property
    def dtype(self):
        """The floating type of the parameters."""
        arrays = [x for x in jax.tree.leaves((self.mass, self.terms)) if hasattr(x, "dtype")]
        kinds = {x.dtype for x in arrays if jnp.issubdtype(x.dtype, jnp.floating)}
        return kinds.pop() if len(kinds) == 1 else jnp.result_type(*kinds)

    @property
    def units(self):
        """The units of the numbers, "SI" or "scaled"; `None` while traced."""
        return counted_in(self._mark)

    def counted_in(self, units: str) -> Any:
        """Return the same lattice labelled `"SI"` or `"scaled"`, without conversion."""
        mark = mark_of(units)
        return eqx.tree_at(lambda x: x._mark, self, jnp.full_like(self._mark, mark))

    def template(self) -> Any:
        """Return `jax.ShapeDtypeStruct`s of the displacements, lanes included."""
        lanes = self.lanes
        dtype = jnp.result_type(*jax.tree.leaves(self.mass))
        like = lambda own: jax.ShapeDtypeStruct(own + lanes, dtype)
        return jax.tree.map(like, self.shape, is_leaf=lambda x: isinstance(x, tuple))

    def zeros(self) -> Displacements:
        """Return zero displacements (or velocities), lanes included."""
        return jax.tree.map(lambda s: jnp.zeros(s.shape, s.dtype), self.template())

    def astype(self, dtype: Any) -> Any:
        """Return the lattice with its floating parameters in another type, for a float32 run."""
        if not jnp.issubdtype(dtype, jnp.floating):
            refuse("dtype", "a floating type, such as numpy.float32", f"{dtype}")

        cast = lambda x: x.astype(dtype) if eqx.is_inexact_array(x) else x
        return jax.tree.map(cast, self)

    def force(self, t: Number, u: Displacements, v: Displacements) -> Displacements:
        """Return the sum of the forces on the sites, with the structure of `u`.

        `u` and `v` have the lattice's shape, followed by lanes or tangents.
        """
        check_shape(self, "u", u)
        check_shape(self, "v", v)
        return self.sum_forces(t, u, v, self.terms)

    def sum_forces(
        self, t: Number, u: Displacements, v: Displacements, terms: Sequence[Term]
    ) -> Displacements:
        """Return the sum of the forces of some terms, with the structure of `u`."""
        return self.total([term.force(t, u, v, self.mass) for term in terms], u)

    def total(self, parts: Sequence[Displacements | None], u: Displacements) -> Displacements:
        """Return the sum of arrays over the sites, or of dicts of fields; `None` counts as zero."""
        parts = [part for part in parts if part is not None]
        if isinstance(u, dict):
            return {
                name: _sum([part[name] for part in parts if name in part], x)
                for name, x in u.items()
            }
        return _sum(parts, u)

    def acceleration(self, t: Number, u: Displacements, v: Displacements) -> Displacements:
        """Return a = force/m."""
        return jax.tree.map(jnp.divide, self.force(t, u, v), self.mass)

    def potential_energy(self, t: Number, u: Displacements) -> Number:
        """Return the potential energy relative to equilibrium, in the shape of the lanes."""
        check_shape(self, "u", u)
        energies = [term.energy(t, u) for term in self.terms]
        return sum((per_lane(e, len(self.lanes)) for e in energies if e is not None), 0.0)

    def kinetic_energy(self, v: Displacements) -> Number:
        """Return the sum of m v^2/2, in the shape of the lanes."""
        check_shape(self, "v", v)
        kinetic = jax.tree.map(lambda m, v: m * v * v / 2, self.mass, v)
        return per_lane(kinetic, len(self.lanes))

    def energy(self, t: Number, u: Displacements, v: Displacements) -> Number:
        """Return the kinetic plus potential energy, in the shape of the lanes."""
        return self.kinetic_energy(v) + self.potential_energy(t, u)

    @property
    def conserves(self):
        """Whether every term conserves the energy."""
        return not self.unkept()

    def unkept(self) -> tuple[str, ...]:
        """Return the names of the terms that do not conserve the energy."""
        return tuple(type(term).__name__ for term in self.terms if not reads(term, self).conserves)

    @property
    def reads_time(self):
        """Whether some force depends on time."""
        return any(reads(term, self).time for term in self.terms)

    @property
    def reads_velocity(self):
        """Whether some force depends on velocities."""
        return any(reads(term, self).velocity for term in self.terms)

    @property
    def breaks(self):
        """The `Breaks` of all terms, where time steps end."""
        return tuple(b for term in self.terms for b in term.jumps())

    def for_run(self) -> Any:
        """Return the lattice with precomputed parts of its forces, e.g. transforms of kernels."""
        own = [term.for_run(self) if isinstance(term, LongRange) else term for term in self.terms]
        return eqx.tree_at(lambda x: x.terms, self, tuple(own))

    def unbalanced(self) -> Displacements:
        """Return the force on each site at rest, from the contact forces including preloads.

        It is zero where the preloads balance. At an end held by a static load, such as F0 at a free
        end, it is that load: +-F0 there and zero elsewhere is an equilibrium.
        """
        u = self.zeros()
        return self.total([term.preload_force(u) for term in self.terms], u)


def _per_vector(term, axes):
    # Parameters of each site get a trailing axis for the components of a vector.
    inner = within(term)
    if not inner.per_site:
        return term
    inner = jax.tree.map(lambda x: x[..., None] if jnp.ndim(x) == axes else x, inner)
    return eqx.tree_at(within, term, inner)


@lru_cache
def _one(axes, mark):
    # A number with an axis for each axis of a site. It shows where `jax.vmap` puts lanes, and
    # stores the units. Programs do not read it, so they are shared between lattices in SI and
    # scaled units.
    with jax.ensure_compile_time_eval():
        return jax.device_put(np.full((1,) * axes, mark))


def _has_sites(lattice, own):
    # Whether some parameter has more axes than the lanes. For single numbers the place of the lanes
    # does not matter.
    return any(
        np.ndim(x) > lattice._mark.ndim - own
        for x in jax.tree.leaves((lattice.mass, lattice.terms))
    )


def check_shape(lattice: Any, name: str, x: Displacements) -> None:
    """Refuse arrays that are not real or lack an entry for a site or lane; more axes may follow."""
    sites = lattice.shape
    lanes = lattice.lanes
    sites = sites if isinstance(sites, dict) else {None: sites}
    given = x if isinstance(x, dict) else {None: x}
    wanted = {field: own + lanes for field, own in sites.items()}
    got = {field: np.shape(array) for field, array in given.items()}
    if wanted.keys() != got.keys() or not all(
        len(got[field]) >= len(shape)
        # One lane serves many, such as the tangents of a lattice.
        and all(
            w == g or w == 1 and i >= len(sites[field])
            for i, (w, g) in enumerate(zip(shape, got[field]))
        )
        for field, shape in wanted.items()
    ):
        wanted, got = (shapes.get(None, shapes) for shapes in (wanted, got))
        remedy = "Start from lattice.zeros()."
        refuse(name, f"shape {wanted}, that of the lattice", f"shape {got}", remedy)
    for array in given.values():
        if letter(array) == "c":
            remedy = "Real and imaginary part move for themselves."
            refuse(name, "real numbers", described(array), remedy)


def refuse_memory(lattice: Lattice) -> None:
    """Refuse terms whose force depends on the past."""
    for i, term in enumerate(lattice.terms):
        if memory := memory_of(term):
            refuse(
                f"terms[{i}] ({type(term).__name__})",
                "a force that depends on the present state alone",
                f"one that remembers the {', '.join(memory).replace('_', ' ')}",
                "Use gx.simulate(lattice, state, t1), which has a solver for it.",
            )


def _sum(parts, like):
    return sum(parts[1:], parts[0]) if parts else jnp.zeros_like(like)


def spread_mass(lattice: Lattice) -> Displacements:
    """Return the mass of every degree of freedom, with the structure of the displacements."""
    return jax.tree.map(lambda m, u: jnp.broadcast_to(m, u.shape), lattice.mass, lattice.zeros())
