"""The stiffness of a lattice at rest: products K w, and blocks of K between nearby sites."""

from collections.abc import Callable
from itertools import product
from typing import Any, NoReturn

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

from ..base.checks import refuse, traced
from ..base.programs import compiled, concretely
from ..base.types import AnyArray, Displacements, Number, Numbers
from ..lattice import Lattice, spread_mass
from ..lattice.model import refuse_memory
from ..terms.reach import reads, time_of, used
from ..terms.reach import stand_in as drawn
from ..terms.sites import with_still_walls

# times at which a force of time and velocity is sampled: on every scale, and no simple fractions
GENERIC = (0.618 * 10.0 ** np.arange(-6, 5)).tolist()


def undriven(lattice: Any, lanes: bool = False) -> Lattice:
    """Return the lattice without drives and with every moving wall held still.

    **Raises** ValueError for a batch unless `lanes` allows one, and for forces with a memory.
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
    """Return the `undriven` lattice, checked for a stiffness that is constant in time.

    **Raises** ValueError where it changes, for gyroscopic forces, whose waves are not those of the
    stiffness, and where `undriven` does.
    """
    return turning_at_rest(lattice, lanes, turning=False)[0]


def turning_at_rest(
    lattice: Any, lanes: bool = False, turning: bool = True
) -> tuple[Lattice, bool]:
    """As `at_rest`, but allow constant gyroscopic forces, and return whether there are any."""
    still = undriven(lattice, lanes)
    for i, term in enumerate(still.terms):
        if reads(term, still).time and _stiffness_changes(term, still):
            refuse(
                f"terms[{i}] ({type(term).__name__})",
                "a stiffness that is constant in time",
                "one that changes",
                "Normal modes do not exist then: remove the modulation, or use granjax.linear.floquet_bands, "
                "which follows it over a period.",
            )
    # A gyroscopic force is -C v with a C that is not symmetric. It changes frequencies to first
    # order, as damping does not.
    plain, _ = stand_in(still)
    turns = False
    for i, term in enumerate(plain.terms):
        read = reads(term, plain)
        if not read.velocity:
            continue
        alone = eqx.tree_at(lambda x: x.terms, plain, (term,))
        times = np.asarray(GENERIC if read.time else [0.0], plain.dtype)
        if max(concretely(_turning, alone, t) for t in times) <= 1e3 * np.finfo(plain.dtype).eps:
            continue
        turns = True
        if read.time or not turning:
            refuse(
                f"terms[{i}] ({type(term).__name__})",
                "a force that damps or does not read the velocity",
                "a gyroscopic one, which turns velocities (its matrix -d force/dv is not symmetric)",
                "It needs waves of the stiffness alone. granjax.linear.dispersion and normal_modes follow such a "
                "force where it is constant in time, granjax.linear.floquet_bands where it is not.",
            )
    return still, turns


def _stiffness_changes(term, lattice):
    def slope(term, t, u, w, v, mass):
        return jax.jvp(lambda u: term.force(t, u, v, mass), (u,), (w,))[1]

    u = lattice.template()
    return used(slope, (term, time_of(lattice), u, u, u, lattice.mass))[2]


@compiled
def _turning(lattice, t):
    # the asymmetry of C = -d force/dv: (a C b - b C a)/(|a C b| + |b C a|) for random velocities a,
    # b
    flat, unravel = ravel_pytree(lattice.zeros())
    a, b = np.random.default_rng(3).normal(size=(2, flat.size)).astype(flat.dtype)
    damping = linear_map(lattice, t, velocity=True)
    forth, back = (x * ravel_pytree(damping(unravel(y)))[0] for x, y in ((a, b), (b, a)))
    size = jnp.sum(jnp.abs(forth) + jnp.abs(back))
    return jnp.abs(jnp.sum(forth - back)) / or_one(size)


def stand_in(lattice: Lattice) -> tuple:
    """Return the lattice with concrete values, and whether these are its own.

    Random values, which keep the pattern of the stiffness, replace traced ones; derivatives alone
    are dropped.
    """
    plain = without_derivatives(lattice)
    random = np.random.default_rng(0)
    some = lambda x: drawn(x, random) if eqx.is_inexact_array(x) else x
    return jax.tree.map(some, plain), not traced(plain)


def without_derivatives(tree: Any) -> Any:
    """Return a tree whose values are concrete where derivatives alone are traced."""
    return jax.tree.map(lambda x: jax.lax.stop_gradient(x) if traced(x) else x, tree)


def refuse_one_way() -> NoReturn:
    """Refuse forces that do not derive from an energy."""
    refuse(
        "lattice",
        "forces that come from an energy (symmetric stiffness)",
        "stiffness that is not symmetric",
        "Bonds push both ends alike; look for a term of your own that does not.",
    )


def linear_map(lattice: Lattice, t: Number = 0.0, velocity: bool = False) -> Callable:
    """Return the map w -> K w = -(d force/du) w at rest, or w -> C w = -(d force/dv) w."""
    zeros = lattice.zeros()
    time = jnp.asarray(t, lattice.dtype)
    _, slope = jax.linearize(
        lambda x: lattice.force(time, zeros, x) if velocity else lattice.force(time, x, zeros),
        zeros,
    )
    return lambda w: jax.tree.map(jnp.negative, slope(w))


def pack(lattice: Lattice, u: Displacements) -> Numbers:
    """Stack displacements as (sites..., components), fields in alphabetical order."""
    leaves = [x.reshape(x.shape[: lattice.axes] + (-1,)) for x in jax.tree.leaves(u)]
    return jnp.concatenate(leaves, -1)


def unpack(x: AnyArray, fields: tuple[str, ...] | None, dimension: int | None) -> Displacements:
    """Invert `pack`, for any leading axes."""
    vector = () if dimension is None else (dimension,)
    if fields is None:
        return x.reshape(x.shape[:-1] + vector)
    names = sorted(fields)
    parts = jnp.split(x, len(names), -1)
    return {name: part.reshape(part.shape[:-1] + vector) for name, part in zip(names, parts)}


def unpack_waves(
    x: AnyArray, cell: tuple[int, ...], fields: tuple[str, ...] | None, dimension: int | None
) -> Displacements:
    """Unpack vectors (..., P, bands) over a cell to (..., cell..., [vector], bands)."""
    x = jnp.moveaxis(x, -2, -1)
    x = x.reshape(x.shape[:-1] + cell + (-1,))
    back = -1 - len(cell) - (dimension is not None)
    return jax.tree.map(lambda x: jnp.moveaxis(x, back, -1), unpack(x, fields, dimension))


def grid(lattice: Lattice) -> tuple[int, ...]:
    """Return the number of sites along each axis.

    **Raises** ValueError where fields differ in it.
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
    """Return the degrees of freedom of one site."""
    return (len(lattice.fields) if lattice.fields else 1) * (lattice.dimension or 1)


def mesh(*lines: Any) -> Any:
    """Return the points (..., axes) of a mesh of lines."""
    return np.stack(np.meshgrid(*lines, indexing="ij"), -1)


def offsets(reach: Any) -> list:
    """Return the offsets within a reach, in the order of the blocks."""
    return list(product(*[range(-r, r + 1) for r in reach]))


def _colours(size, reach):
    # sites of equal number lie more than twice the reach apart, around a ring too
    spacing = 2 * reach + 1
    index = np.arange(size)
    whole = spacing * (size // spacing)
    return np.where(index < whole, index % spacing, spacing + index - whole)


@compiled
def blocks(lattice: Lattice, reach: Any, ts: Any, damped: bool = False) -> tuple:
    """Return blocks of K at times `ts`, (sites..., offsets, components, components, maps, times).

    They act on site n from site n + offset; the maps are K, or K and C if `damped`. Also returned
    are the largest entry of each map (maps,), 1 where it has none; the relative error of the blocks
    on random displacements; and the masses (sites..., components). Sites of one colour are
    displaced together: the cost is a few force evaluations for any length. Offsets wrap around the
    ends of an open lattice, where blocks are zero.
    """
    sites = grid(lattice)
    width = components(lattice)
    near = offsets(reach)
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
    # half way around a ring both directions reach the same site, so each gets half of its block
    both = (np.array(sites) == 2 * np.array(reach)) & (np.abs(near) == reach)
    twice = np.prod(np.where(both, 0.5, 1.0), axis=1)
    if np.any(twice != 1):
        found = found * twice.reshape(-1, 1, 1, 1, 1).astype(lattice.dtype)
    size = or_one(largest(found))
    summed = jnp.einsum("...oabmt,...ob->...amt", found, moved(random))
    return found, size, (largest(pulled - summed) / size).max(), pack(lattice, spread_mass(lattice))


def or_one(size: Any) -> Any:
    """Return a size that numbers are divided by, 1 where it is zero."""
    return jnp.where(size > 0, size, 1)


def largest(x: Any) -> Any:
    """Return the largest entry of each map, (maps,), of an array (..., maps, times)."""
    return abs(x).max(axis=(*range(x.ndim - 2), x.ndim - 1))


def each(function: Callable, x: Any, at_once: int) -> Any:
    """Return `jax.vmap(function)(x)`, of `at_once` rows at a time to save memory."""
    groups = -(-len(x) // at_once)
    if groups <= 1:
        return jax.vmap(function)(x)
    # Equal groups: eigenproblems of a remainder would be a second part of the program, and XLA's
    # threads may deadlock where two run side by side.
    many = -(-len(x) // groups)
    padded = jnp.concatenate([x, jnp.repeat(x[-1:], groups * many - len(x), axis=0)])
    found = jax.lax.map(function, padded, batch_size=many)
    return jax.tree.map(lambda y: y[: len(x)], found)


def in_groups(function: Callable, points: Any, count: int) -> Any:
    """Evaluate a function of points (n, axes) by batches, with one program for any n."""
    groups = -(-len(points) // count)
    axes = points.shape[1]
    padded = np.zeros((groups, count, axes), points.dtype)
    padded.reshape(-1, axes)[: len(points)] = points
    return np.concatenate([function(x) for x in padded])[: len(points)]
