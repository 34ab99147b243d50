"""Batches whose lanes are run separately.

Each lane of an adaptive run has its own steps. A fixed step is shared, and groups of lanes are run
one after another so that their arrays fit the processor's nearest cache.
"""

import math
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..base.arrays import trailing
from ..base.checks import refuse
from ..base.programs import library
from ..base.tuning import lanes_abreast
from ..base.types import AnyArray, Number, Pytree, Scalar, StateLike
from ..lattice import Lattice
from ..terms import Term
from .arguments import facts
from .run import Found

# The largest relative cost of the idle lanes that fill up the last group.
FILLING = 0.1
# The most displacements of a group. A group of 64 lanes of 1024 sites takes 0.9 of the time of all
# lanes together, of 4096 sites 1.2 times as long.
LARGEST = 2**17


def each_lane(
    function: Callable, lattice: Lattice, state: StateLike, records: dict, t0: Number
) -> Found:
    """Apply `function(lattice, state, records)` to each lane, one after another."""
    parts, build = apart(lattice, state, records)

    def one(parts):
        member = build(parts)
        refuse_lanes_within(t0, member, (lattice, state, records))
        return function(*member)

    found = jax.lax.map(one, [jnp.moveaxis(x, -1, 0) for x in parts])
    lanes = lattice.lanes
    return together(
        jax.tree.map(lambda x: jnp.moveaxis(x, 0, -1).reshape(x.shape[1:] + lanes), found)
    )


def by_groups(function: Callable, lattice: Lattice, *others: Pytree) -> tuple | None:
    """Apply `function(lattice, *others)` to some lanes at a time.

    It returns a tree of arrays with lanes last, and a tree that lanes share. The result is `None`
    where groups do not pay off (few lanes, or a processor that was not measured), or where a
    user-defined term might mix lanes.
    """
    width = lanes_abreast()
    count = math.prod(lattice.lanes)
    groups = -(-count // width) if width else 0
    filled = groups * width > (1 + FILLING) * count
    large = width * facts(lattice).numbers > LARGEST * count
    if groups < 2 or filled or large or _has_foreign_term(lattice):
        return None
    parts, build = apart(lattice, *others)

    def folded(x):
        fill = jnp.broadcast_to(x[..., -1:], (*x.shape[:-1], groups * width - count))
        x = jnp.concatenate([x, fill], -1) if fill.size else x
        return jnp.moveaxis(x.reshape(*x.shape[:-1], groups, width), -2, 0)

    def unfolded(x):
        x = jnp.moveaxis(x, 0, -2)
        return x.reshape(*x.shape[:-2], -1)[..., :count].reshape(*x.shape[:-2], *lattice.lanes)

    own, shared = jax.lax.map(
        lambda some: function(*build(some)), [folded(jnp.asarray(x)) for x in parts]
    )
    return jax.tree.map(unfolded, own), jax.tree.map(lambda x: jnp.max(x, 0), shared)


def _has_foreign_term(lattice):
    def foreign(x):
        return isinstance(x, Term) and not type(x).__module__.startswith("granjax.")

    return any(map(foreign, jax.tree.leaves(lattice.terms, is_leaf=foreign)))


def apart(lattice: Lattice, *others: Pytree) -> tuple[list[AnyArray], Callable]:
    """Return the arrays that differ between lanes, with all lanes in one last axis, and a builder.

    The builder makes trees of such arrays, for some lanes, or for one lane without that axis.
    Arrays have lanes as they broadcast, by their last axes. Those without all of them are shared.
    """
    lanes = lattice.lanes
    mark = lattice._mark
    # The mark has the axes of a site. It has lanes too, unless only some of the parameters have
    # lanes.
    axes = lattice.axes + (lattice.dimension is not None) + len(lanes)
    lattice = eqx.tree_at(lambda x: x._mark, lattice, trailing(mark, axes))
    leaves, structure = jax.tree.flatten((lattice, *others))
    parts = [_over_lanes(x, lanes) for x in leaves]

    def build(some):
        some = iter(some)
        return jax.tree.unflatten(
            structure, [x if part is None else next(some) for x, part in zip(leaves, parts)]
        )

    return [part for part in parts if part is not None], build


def _over_lanes(x, lanes):
    # The array with its lanes in one last axis; `None` where it has no lanes.
    shape = np.shape(x)
    if not shape:
        return None
    shape = (1,) * (len(lanes) - len(shape)) + shape
    own = shape[: len(shape) - len(lanes)]
    last = shape[len(shape) - len(lanes) :]
    if any(n not in (1, count) for n, count in zip(last, lanes)):
        return None
    xp = library(x)
    return xp.broadcast_to(xp.reshape(x, shape), own + lanes).reshape(own + (-1,))


def together(run: Found) -> Found:
    """Replace the times of each lane (T, lanes...) by times that all lanes share.

    A lane that stopped early has NaN at times that only others reached.
    """
    over = tuple(range(1, run.ts.ndim))
    xp = library(run.ts)
    reached = xp.max(xp.where(xp.isfinite(run.ts), run.ts, -xp.inf), axis=over)
    ts = xp.where(xp.isfinite(reached), reached, xp.inf)
    there = run.ts == trailing(ts, run.ts.ndim)

    def seen(x):
        return xp.where(
            there.reshape(there.shape[:1] + (1,) * (x.ndim - there.ndim) + there.shape[1:]),
            x,
            xp.nan,
        )

    us, vs = jax.tree.map(seen, (run.us, run.vs))
    return run._replace(ts=ts, us=us, vs=vs)


def refuse_lanes_within(t0: Scalar, one: tuple, every: tuple) -> None:
    """Refuse user-defined functions that hold lanes themselves, or mix lanes.

    `one`, `every`: (lattice, state, records) of one lane, and of all.
    """
    remedy = "Put what differs from lane to lane into a field of a Module, or give step=, which all lanes share."
    try:
        one[0].check_terms()
    except ValueError as error:
        refuse(
            "lattice",
            "terms that work on a single lane, since each lane has its own steps",
            str(error).rstrip("."),
            remedy,
        )
    for name, record in one[2].items():
        wanted = _shapes(record, t0, *every[:2])
        try:
            got = _shapes(record, t0, *one[:2])
        except (ValueError, TypeError, AttributeError, KeyError, IndexError) as error:
            got = None
            said = f"an error: {error}"
        else:
            said = f"shape {got} for one and {wanted} for all"
        if got is None or [shape + every[0].lanes for shape in got] != wanted:
            wanted = "a quantity of a single lane, since each lane has its own steps"
            refuse(f"record[{name!r}]", wanted, said.rstrip("."), remedy)


def _shapes(record, t, lattice, y):
    value = jax.eval_shape(lambda: record.value(jnp.asarray(t), y, lattice))
    return [x.shape for x in jax.tree.leaves(value)]
