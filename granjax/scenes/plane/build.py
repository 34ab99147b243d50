"""Build a lattice from a cell: masses, bonds, walls, grounding springs."""

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ...base.checks import non_negative, one_of, plain_zero, positive, refuse, whole
from ...base.programs import compiled
from ...base.types import Count, Parameter, Scalar
from ...base.units import SCALED
from ...lattice import Lattice
from ...laws import Law, Linear, Strained
from ...strains import BOUNDARIES, Along, Pairs, Shift, Slip, Stretch
from ...terms import Bond, Grip, OnSite
from ..chains import contact, number
from .cells import CrystalCell
from .outline import cut, positions_of

# moment of inertia of a sphere about its centre, in m R^2
SPHERE = 0.4
_at_rest = compiled(lambda law: law.derivative(jnp.zeros(())))


def mindlin(poisson: Any) -> Any:
    """Return Mindlin's k_t/k_n for two bodies of one material, 2 (1 - nu)/(2 - nu)."""
    return 2 * (1 - poisson) / (2 - poisson)


def crystal(
    cell: CrystalCell,
    n: Count | Sequence[Count],
    m: Count | None = None,
    *,
    mass: Parameter | dict[str, Parameter] = 1.0,
    stiffness: Parameter | Sequence[Parameter] = 1.0,
    exponent: Parameter = 1.0,
    precompression: Parameter = 0.0,
    law: Law | Callable[[Any], Law] | Sequence[Law] | None = None,
    spacing: Scalar = 1.0,
    boundary: str | Sequence[str] = "fixed",
    outline: str | Callable = "cells",
    out_of_plane: bool = False,
    rotation: bool = False,
    tangential: Scalar | Law | None = None,
    bending: Scalar | Law = 0.0,
    attraction: Scalar = 0.0,
    inertia: Scalar = SPHERE,
    ground: Scalar | None = None,
    on_site: Law | None = None,
    equal: bool = False,
    units: str = SCALED,
) -> Lattice:
    r"""Build a lattice in the plane or in space, or a chain, from a cell.

    m u'' = sum over neighbours j of [F(|R| - |R + u_j - u|) times the bond's direction]

    See `gx.Stretch`. `square`, `fcc`, `ssh` and others are built in this way.

    **Arguments:**

    - `cell`: a `gx.scenes.CrystalCell` of `vectors`, `sites` and `ties`, in bond lengths.
    - `n`, `m`: cells along the two axes; with `m=None` n along every axis. In space n may be three
      numbers. A cell with one vector makes a chain of n cells.
    - `mass`: a number, which the lattice keeps as one (`gx.lattice.spread_mass`), or an array (n,
      m); with several sites also a dict of these.
    - `stiffness`: K; `precompression`: F0 of each bond, of either sign; numbers, or one per bond of
      the cell (a `stiffness` also an array over all bonds of its kind). `exponent`: 1 for springs,
      which push and pull; otherwise contacts A [d0 + e]_+^p, such as 3/2, with A the `stiffness`.
      `law`: in their place one law, one per bond of the cell, or a function from the pairs of one
      kind of bond (a `gx.Shift`, see its `joins`) to their law.
    - `spacing`: |R|, the bond length, twice the radius of a bead.
    - `boundary`: `"fixed"` (beads at rest all around), `"free"` (the static load is held on the
      sites at the edge), `"periodic"`; or one per axis: ("periodic", "free") is a strip.
    - `outline`: `"cells"`, a parallelogram of n x m cells, on a grid; or a graph, u of shape
      (sites, 2): `"rectangle"` (m rows of n cells), `"hexagon"` (n rings of cells around one), or a
      function of positions (..., 2) in bond lengths that selects sites of the parallelogram. A
      graph has no bands. `boundary` applies to the outer rim; the edge of a hole is always free.
    - `out_of_plane`: one displacement per site, normal to the plane, u of shape (n, m); bonds have
      e = u_i - u_j.
    - `rotation`: u of shape (n, m, 3), (u_x, u_y, R theta) with R = |R|/2, theta anticlockwise. The
      contacts then have a tangential spring `tangential`: k_t, a law of the slip
      (`gx.strains.Slip`), or `None` for Mindlin's 0.82 K2 of nu = 0.3. `bending` and `attraction`:
      as in `rotating_chain`; `inertia`: of a bead in m R^2, 2/5 for a sphere, 1/2 for a disk. A
      contact that opens loses these springs (`gx.terms.Grip`). Sliding is not modelled: check
      `gx.measures.slip_ratio`.
    - `ground`: an on-site spring on every component of u; `on_site`: a further law there, such as
      `gx.Polynomial(0, 0, 1.0)`; both make a Klein-Gordon lattice. `equal`: whether, with either of
      them, sites with weaker bonds get stronger springs, so that the springs of every site have the
      same sum.

    **Returns:** a `Lattice` with `positions`, with a field for each site of the cell if there are
    several. All numbers but n, m are differentiable; for a batch use `jax.vmap(..., out_axes=-1)`.
    **Raises** ValueError for a boundary, an outline or masses that do not fit, or `rotation` out of
    plane.

    **Example:**

    >>> ties = tuple(gx.scenes.Tie("a", "a", offset) for offset in ((1, 0), (0, 1), (1, 1), (1, -1)))
    >>> cell = gx.scenes.CrystalCell(((1.0, 0.0), (0.0, 1.0)), {"a": (0.0, 0.0)}, ties)
    >>> crystal = gx.scenes.crystal(cell, 6, boundary="periodic")   # a square lattice with diagonals
    >>> gx.linear.dispersion(crystal, [np.pi, 0.0]).omega_squared.round(6)   # 4 K and 8 K
    Array([4., 8.], dtype=float64)
    """
    axes = len(cell.vectors)
    counts = (n, m) if m is not None else tuple(n) if np.ndim(n) else (n,) * axes
    if len(counts) != axes:
        wanted = f"{axes} numbers of cells, one for each vector of the cell"
        refuse("n, m", wanted, repr(counts))
    counts = tuple(whole("n, m", count, 1) for count in counts)
    spacing = positive("spacing", number("spacing", spacing), "It is the length of a bond.")
    laws = _laws(cell, law, stiffness, exponent, precompression)
    space = len(cell.vectors[0]) > 2
    if rotation and (out_of_plane or space) or space and outline != "cells":
        wanted = "False and 'cells' in space, and False where sites move out of the plane"
        refuse("rotation, outline", wanted, f"{rotation}, {outline!r}")
    if rotation:
        tangential, rolling, pull = _turning(laws[0], tangential, bending, attraction)
    elif tangential is not None or not (plain_zero(bending) and plain_zero(attraction)):
        refuse(
            "tangential, bending, attraction",
            "none without rotation=True",
            f"{tangential}, {bending}, {attraction}",
            "Beads that do not turn do not slip.",
        )
    if isinstance(outline, str) and outline == "cells":
        boundaries = _boundaries(boundary, axes)
        sites = dict.fromkeys(cell.sites, counts)
        pairs = [
            Shift(tie.offset, boundaries, None if cell.alone else (tie.tail, tie.head))
            for tie in cell.ties
        ]
        positions = positions_of(cell, counts)
    else:
        one_of("boundary", boundary, ("fixed", "free"))
        found = cut(cell, counts, outline)
        sites = {name: (found.count(name),) for name in cell.sites}
        pairs = _graph(cell, found, boundary)
        positions = found.positions
    masses = _masses(cell, mass, sites, positive("inertia", inertia) if rotation else None)
    terms = []
    for joined, own, vector in zip(pairs, laws, spacing * cell.spans()):
        if joined is None:
            continue
        own = own if isinstance(own, Law) else own(joined)
        _check_bonds(joined, own, sites, cell.alone)
        bond = Bond(joined if out_of_plane else Stretch(joined, vector), own)
        terms.append(bond)
        if rotation:
            terms.append(Grip(Slip(joined, vector), tangential, bond))
            if rolling is not None:
                terms.append(Grip(Along(joined, (0.0, 0.0, 1.0)), rolling, bond))
            if pull is not None:
                terms.append(Bond(bond.strain_map, pull))
    if ground is not None or on_site is not None:
        springs = _springs(cell, laws, 0.0 if ground is None else ground, equal)
        for name, spring in springs.items():
            held = spring if on_site is None else spring + on_site
            terms.append(OnSite(held, None if cell.alone else name))
    positions = {name: spacing * x for name, x in positions.items()}
    masses, positions = (x["a"] if cell.alone else x for x in (masses, positions))
    return Lattice(
        masses,
        terms,
        sites=next(iter(sites.values())) if len(set(sites.values())) == 1 else None,
        dimension=None if out_of_plane else 3 if rotation or space else 2,
        positions=positions,
        units=units,
    )


def _turning(law, tangential, bending, attraction):
    if not isinstance(tangential, Law):
        if tangential is None:
            tangential = mindlin(0.3) * _at_rest(law)
        remedy = "Without static load contacts slide: give F0 > 0."
        tangential = Linear(positive("tangential", tangential, remedy))
    if plain_zero(bending):
        bending = None
    elif not isinstance(bending, Law):
        bending = Linear(non_negative("bending", bending))
    pull = None if plain_zero(attraction) else _Pull(non_negative("attraction", attraction))
    return tangential, bending, pull


class _Pull(Law):
    """A constant pull: the preload is -T, without stiffness."""

    dimensions = {"tension": (1, 0, 0)}
    opens = False
    is_linear = True
    tension: jnp.ndarray

    @property
    def preload(self):
        return -self.tension

    def force(self, e):
        return 0 * self.tension * e

    def energy(self, e):
        return 0 * self.tension * e


def _check_bonds(pairs, law, sites, alone):
    template = {name: jax.ShapeDtypeStruct(shape, float) for name, shape in sites.items()}
    wanted = jax.eval_shape(pairs.strain, template["a"] if alone else template).shape
    for x in jax.tree.leaves(law):
        if np.ndim(x) and np.shape(x) != wanted:
            refuse(
                "stiffness", f"one number, or one per bond, shape {wanted}", f"shape {np.shape(x)}"
            )


def _boundaries(boundary, axes):
    given = (boundary,) * axes if isinstance(boundary, str) else tuple(boundary)
    if len(given) != axes:
        refuse("boundary", f"one word, or {axes}, one per axis", repr(boundary))
    return tuple(one_of("boundary", b, BOUNDARIES) for b in given)


def _graph(cell, found, boundary):
    every = []
    for tie in cell.ties:
        tail, head = found.bonds(tie, boundary == "fixed")
        fields = None if cell.alone else (tie.tail, tie.head)
        count = (found.count(tie.tail), found.count(tie.head))
        every.append(Pairs(tail, head, sites=count, fields=fields) if len(tail) else None)
    return every


def _masses(cell, mass, sites, inertia):
    given = mass if isinstance(mass, dict) else dict.fromkeys(cell.sites, mass)
    found = {}
    alike = len(set(sites.values())) == 1
    for name, shape in sites.items():
        m = given[name]
        m = positive("mass" if m is mass else f"mass[{name!r}]", m, "A bead needs a mass.")
        if m.ndim and m.shape != shape:
            refuse("mass", f"one number, or one per site, shape {shape}", f"shape {m.shape}")
        if not alike or inertia is not None:
            m = jnp.broadcast_to(m, shape)
        found[name] = m if inertia is None else jnp.stack([m, m, inertia * m], -1)
    return found


def _laws(cell, law, stiffness, exponent, precompression):
    count = len(cell.ties)
    if law is not None:
        return _each("law", law, count)
    numbers = {"stiffness": stiffness, "exponent": exponent, "precompression": precompression}
    return tuple(_law(*x) for x in zip(*(_each(name, x, count) for name, x in numbers.items())))


def _each(name, x, count):
    if isinstance(x, Law) or callable(x) or not isinstance(x, Sequence) and np.ndim(x) == 0:
        return (x,) * count
    if len(x) != count:
        refuse(name, f"one, or {count}, one per bond of the cell", f"{len(x)}")
    return tuple(x)


def _law(stiffness, exponent, precompression):
    if not (isinstance(exponent, (int, float)) and exponent == 1):
        return contact(stiffness, exponent, precompression)
    stiffness = positive("stiffness", stiffness, "A bond without stiffness is left out.")
    if plain_zero(precompression):
        return Linear(stiffness)
    return Strained(Linear(stiffness), precompression / stiffness)


def _springs(cell, laws, ground, equal):
    held = dict.fromkeys(cell.sites, 0.0)
    for tie, law in zip(cell.ties, laws):
        k = _at_rest(law)
        held[tie.tail] = held[tie.tail] + k
        held[tie.head] = held[tie.head] + k
    ground = non_negative("ground", ground)
    most = jnp.max(jnp.stack([jnp.asarray(k) for k in held.values()]))
    return {name: Linear(ground + (most - k if equal else 0)) for name, k in held.items()}
