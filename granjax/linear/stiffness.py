"""The stiffness of a lattice at rest: products K w by `jax.jvp`, and the blocks of K between near sites."""

from collections.abc import Callable
from itertools import product
from typing import Any, NoReturn

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

from ..checks import refuse, traced
from ..lattice import Lattice, spread_mass
from ..lattice.model import refuse_memory
from ..programs import compiled, concretely
from ..terms.reach import reads, time_of, used
from ..terms.sites import with_still_walls
from ..types import AnyArray, Displacements, Number, Numbers

# times at which a force that reads time and velocities is looked at: of every scale, none of them a simple fraction
GENERIC = (0.618 * 10.0 ** np.arange(-6, 5)).tolist()


def undriven(lattice: Any, lanes: bool = False) -> Lattice:
    """The lattice without its drives, and with every moving wall held still.

    **Raises** ValueError for a batch, unless `lanes` allows one.
    """
    if lattice.lanes and not lanes:
        refuse(
            "lattice",
            "one lattice",
            f"a batch with lanes {lattice.lanes}",
            "Use jax.vmap(function, in_axes=-1)(lattice), and give cell=... where a unit cell is needed.",
        )
    refuse_memory(lattice)
    return with_still_walls(lattice)


def at_rest(lattice: Any, lanes: bool = False) -> Lattice:
    """The lattice `undriven`, of a stiffness that is constant in time.

    **Raises** ValueError where `undriven` does, for stiffness that changes in time, and for forces that turn
    velocities (gyroscopic ones), since their waves are not those of the stiffness.
    """
    still = _of_constant_stiffness(lattice, lanes)
    for i, _ in turning_terms(still):
        _refuse_turning(still, i)
    return still


def turning_at_rest(lattice: Any) -> tuple[Lattice, bool]:
    """The lattice `at_rest`, with forces that turn velocities, and whether there are some.

    **Raises** ValueError as `at_rest`; of these forces for those alone that change in time.
    """
    still = _of_constant_stiffness(lattice)
    found = turning_terms(still)
    for i, reads_time in found:
        if reads_time:
            _refuse_turning(still, i)
    return still, bool(found)


def _refuse_turning(lattice, i):
    refuse(
        f"terms[{i}] ({type(lattice.terms[i]).__name__})",
        "a force that damps or does not read the velocity",
        "a gyroscopic one, which turns velocities (its matrix -d force/dv is not symmetric)",
        "It needs waves of the stiffness alone. granjax.linear.dispersion and normal_modes follow such a force "
        "where it is constant in time, granjax.linear.floquet_bands where it is not.",
    )


def _of_constant_stiffness(lattice, lanes=False):
    still = undriven(lattice, lanes)
    for i, term in enumerate(still.terms):
        if reads(term, still).time and _stiffness_changes(term, still):
            refuse(
                f"terms[{i}] ({type(term).__name__})",
                "a stiffness that is constant in time",
                "one that changes",
                "Modes in time do not exist then: take the lattice with the term that is modulated, or "
                "granjax.linear.floquet_bands, which follows the modulation over its period.",
            )
    return still


def _stiffness_changes(term, lattice):
    """Whether dF/du at rest depends on time."""

    def slope(term, t, u, w, v, mass):
        return jax.jvp(lambda u: term.force(t, u, v, mass), (u,), (w,))[1]

    u = lattice.template()
    return used(slope, (term, time_of(lattice), u, u, u, lattice.mass))[2]


def turning_terms(lattice: Lattice) -> list[tuple[int, bool]]:
    """The places of the terms -C v whose C is not symmetric, and whether they read the time.

    They change frequencies to first order, as damping does not. Where C is traced random numbers stand in for it.
    """
    plain, _ = stand_in(lattice)
    found = []
    for i, term in enumerate(plain.terms):
        read = reads(term, plain)
        if not read.velocity:
            continue
        alone = eqx.tree_at(lambda x: x.terms, plain, (term,))
        times = np.asarray(GENERIC if read.time else [0.0], plain.dtype)
        if max(concretely(_turning, alone, t) for t in times) > 1e3 * np.finfo(plain.dtype).eps:
            found.append((i, read.time))
    return found


@compiled
def _turning(lattice, t):
    """How far C = -d force/dv is from symmetric: (a C b - b C a)/(|a C b| + |b C a|) of random velocities a, b."""
    flat, unravel = ravel_pytree(lattice.zeros())
    a, b = np.random.default_rng(3).normal(size=(2, flat.size)).astype(flat.dtype)
    damping = linear_map(lattice, t, velocity=True)
    forth, back = (x * ravel_pytree(damping(unravel(y)))[0] for x, y in ((a, b), (b, a)))
    size = jnp.sum(jnp.abs(forth) + jnp.abs(back))
    return jnp.abs(jnp.sum(forth - back)) / jnp.where(size > 0, size, 1)


def stand_in(lattice: Lattice) -> tuple:
    """The lattice with concrete values, and whether they are its own.

    Where only derivatives are traced the values are there; elsewhere random ones keep the pattern of the stiffness.
    """
    random = np.random.default_rng(0)
    known = True

    def settle(x):
        nonlocal known
        if not traced(x) or not eqx.is_inexact_array(x):
            return x
        x = jax.lax.stop_gradient(x)
        if traced(x):
            known = False
            x = random.uniform(1, 2, x.shape).astype(x.dtype)
        return x

    return jax.tree.map(settle, lattice), known


def refuse_one_way() -> NoReturn:
    """Refuse forces that come from no energy."""
    refuse(
        "lattice",
        "forces that come from an energy (symmetric stiffness)",
        "stiffness that is not symmetric",
        "Bonds push both ends alike; look for a term of your own that does not.",
    )


def linear_map(lattice: Lattice, t: Number = 0.0, velocity: bool = False) -> Callable:
    """The map w -> K w = -(d force/du) w at rest, or w -> C w = -(d force/dv) w, of displacements as the lattice's."""
    zeros, time = lattice.zeros(), jnp.asarray(t, lattice.dtype)
    _, slope = jax.linearize(
        lambda x: lattice.force(time, zeros, x) if velocity else lattice.force(time, x, zeros),
        zeros,
    )
    return lambda w: jax.tree.map(jnp.negative, slope(w))


def pack(lattice: Lattice, u: Displacements) -> Numbers:
    """Displacements as one array (sites..., components): the fields in alphabetical order, each with its vector."""
    leaves = [x.reshape(x.shape[: lattice.axes] + (-1,)) for x in jax.tree.leaves(u)]
    return jnp.concatenate(leaves, -1)


def unpack(x: AnyArray, fields: tuple[str, ...] | None, dimension: int | None) -> Displacements:
    """Inverse of `pack`, for any leading axes."""
    vector = () if dimension is None else (dimension,)
    if fields is None:
        return x.reshape(x.shape[:-1] + vector)
    names = sorted(fields)
    parts = jnp.split(x, len(names), -1)
    return {name: part.reshape(part.shape[:-1] + vector) for name, part in zip(names, parts)}


def unpack_waves(
    x: AnyArray, cell: tuple[int, ...], fields: tuple[str, ...] | None, dimension: int | None
) -> Displacements:
    """Vectors (..., P, bands) over a cell as displacements (..., cell..., [vector], bands), or a dict of such."""
    x = jnp.moveaxis(x, -2, -1)
    x = x.reshape(x.shape[:-1] + cell + (-1,))
    back = -1 - len(cell) - (dimension is not None)
    return jax.tree.map(lambda x: jnp.moveaxis(x, back, -1), unpack(x, fields, dimension))


def grid(lattice: Lattice) -> tuple[int, ...]:
    """Sites along each axis.

    **Raises** ValueError where the fields of a cell have different numbers of sites.
    """
    shapes = set(lattice.sites.values()) if lattice.fields else {lattice.sites}
    if len(shapes) > 1:
        refuse(
            "lattice",
            "fields with one number of sites",
            f"{lattice.sites}",
            "Use granjax.linear.normal_modes.",
        )
    return shapes.pop()


def components(lattice: Lattice) -> int:
    """Degrees of freedom of one site."""
    return (len(lattice.fields) if lattice.fields else 1) * (lattice.dimension or 1)


def masses(lattice: Lattice) -> Any:
    """Mass of every degree of freedom, (sites..., components)."""
    return pack(lattice, spread_mass(lattice))


def mesh(*lines: Any) -> Any:
    """The points of a mesh (..., axes) of some lines, one array of places an axis."""
    return np.stack(np.meshgrid(*lines, indexing="ij"), -1)


def offsets(reach: Any) -> list:
    """The offsets between sites that a reach spans, in the order of the blocks."""
    return list(product(*[range(-r, r + 1) for r in reach]))


def _colours(size, reach):
    """Numbers for the sites of one axis, so that equal ones lie further apart than twice the reach, around a ring."""
    spacing, index = 2 * reach + 1, np.arange(size)
    whole = spacing * (size // spacing)
    return np.where(index < whole, index % spacing, spacing + index - whole)


@compiled
def blocks(lattice: Lattice, reach: Any, ts: Any, damped: bool = False) -> tuple:
    """Blocks of K at some times, (sites..., offsets, components, components, maps, times): on n from n + offset.

    There are two maps, K and C, where the lattice is looked at as a `damped` one. With the blocks come the largest
    entry of each map (maps,), 1 where there is none; by how much the blocks miss what the maps make of random
    displacements, relative to these; and the masses (sites..., components).

    Sites of one colour are displaced together, so the cost is that of a few forces, however long the chain. Offsets
    go around the ends of an open lattice too, where the blocks are zero.
    """
    sites, width, near = grid(lattice), components(lattice), offsets(reach)
    axes = range(len(sites))
    colours = [_colours(n, r) for n, r in zip(sites, reach)]
    many = [a.max() + 1 for a in colours]
    colour = np.ravel_multi_index(np.meshgrid(*colours, indexing="ij"), many)
    unit = jnp.eye(width, dtype=lattice.dtype)
    random = np.random.default_rng(1).uniform(-1, 1, sites + (width,)).astype(lattice.dtype)
    moved = lambda x: np.stack([np.roll(x, [-o for o in way], axes) for way in near], len(sites))

    def at(t):
        maps = [linear_map(lattice, t, velocity) for velocity in (False, True)[: 1 + damped]]

        def made_of(w):
            w = unpack(w, lattice.fields, lattice.dimension)
            return jnp.stack([pack(lattice, one(w)) for one in maps], -1)

        def answer(number, component):
            return made_of(jnp.where((colour == number)[..., None], unit[component], 0))

        each_one = jax.vmap(jax.vmap(answer, (None, 0), -2), (0, None), -3)
        answers = each_one(np.arange(colour.max() + 1), np.arange(width))
        answers = jnp.expand_dims(answers, len(sites))
        there = moved(colour)[..., None, None, None, None]
        found = jnp.take_along_axis(answers, there, -3)[..., 0, :, :]
        return found, made_of(random)

    found, pulled = jax.vmap(at, out_axes=-1)(ts)
    # half way around a ring is one place for both ways
    both = (np.array(sites) == 2 * np.array(reach)) & (np.abs(near) == reach)
    twice = np.prod(np.where(both, 0.5, 1.0), axis=1)
    if np.any(twice != 1):
        found = found * twice.reshape(-1, 1, 1, 1, 1).astype(lattice.dtype)
    size = largest(found)
    size = jnp.where(size > 0, size, 1)
    summed = jnp.einsum("...oabmt,...ob->...amt", found, moved(random))
    return found, size, (largest(pulled - summed) / size).max(), masses(lattice)


def largest(x: Any) -> Any:
    """The largest entry of each map, (maps,), of an array (..., maps, times)."""
    return abs(x).max(axis=(*range(x.ndim - 2), x.ndim - 1))


def each(function: Callable, x: Any, at_once: int) -> Any:
    """`jax.vmap(function)(x)`, of as many rows at a time as memory holds."""
    if len(x) <= at_once:
        return jax.vmap(function)(x)
    return jax.lax.map(function, x, batch_size=at_once)


def in_groups(function: Callable, points: Any, count: int) -> Any:
    """A function of points (n, axes), `count` at a time, so that one program does for any number of them."""
    groups, axes = -(-len(points) // count), points.shape[1]
    padded = np.zeros((groups, count, axes), points.dtype)
    padded.reshape(-1, axes)[: len(points)] = points
    return np.concatenate([function(x) for x in padded])[: len(points)]
