"""Runs within a function that is written for one scene: seen from outside, and with their lanes last under `jax.vmap`.

`jax.vmap` of a run moves its lanes to the front of every loop, which is up to three times slower than lanes that come
last. Within `lifting()` a run has a batching rule of its own, by which `jax.vmap` of a function of parameters makes one
lattice with lanes last of all its scenes. It has no reverse mode: derivatives are taken without it.
"""

import functools
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
from jax.custom_batching import custom_vmap

from ..lattice import Lattice
from ..programs import joined, parted
from ..types import Number, StateLike
from .run import COMPLETED, NOT_FINITE


class Asked(BaseException):
    """A run is asked for, within `asking`: `scene` is what for, (lattice, state, t1, keywords)."""

    def __init__(self, *scene):
        super().__init__()
        self.scene = scene


class ErrorsRead(BaseException):
    """A function reads the errors of a run's records, which are computed with the run where that is known before."""


class Lift:
    """What has been seen of runs: a code for each, of every lane, as far as they are traced together."""

    def __init__(self, errors: bool = False, last: bool = True):
        self.errors, self.last, self.codes = errors, last, []

    def __call__(self, simulate: Callable, lattice: Lattice, state: StateLike, t1: Number, keywords: dict) -> Any:
        """The run, whose lanes come last where this is traced by `jax.vmap`."""
        if not self.last:
            with quietly():
                found = simulate(lattice, state, t1, **keywords)
            self.codes.append(jnp.max(found.code))
            return found
        record = keywords.pop("record", None)
        # nothing is differentiated from without
        keywords["adjoint"] = diffrax.ForwardMode() if keywords["adjoint"] is None else keywords["adjoint"]
        rest, numbers = parted((t1, keywords))
        own, arrays = parted((lattice, state, record))
        static, template = [], []

        def run(arrays, numbers):
            (lattice, state, record), (t1, keywords) = joined(own, arrays), joined(rest, numbers)
            with quietly():
                found = simulate(lattice, state, t1, record=record, **keywords)
                known = found.record_error if self.errors and record else {}
            code = _code_of_each(found.code, found.final, lattice.lanes)
            found = eqx.tree_at(lambda run: run.code, found, code)
            kept, parts = parted((found, known))
            static[:] = [kept]
            return parts, code

        def lanes_last(count, batched, arrays, numbers):
            if any(jax.tree.leaves(batched[1])):
                # times of their own: no loop that lanes share
                found = jax.vmap(run, in_axes=(_axes(batched[0]), _axes(batched[1])))(arrays, numbers)
                return found, jax.tree.map(lambda _: True, found)
            wanted = jax.tree.leaves(template[0])
            together = [_behind(x, own, count) for x, own in zip(arrays, batched[0])]
            found, tree = jax.tree.flatten(run(together, numbers))
            over = [jnp.ndim(x) > len(one.shape) for x, one in zip(found, wanted)]
            found = [jnp.moveaxis(x, -1, 0) if own else x for x, own in zip(found, over)]
            return jax.tree.unflatten(tree, found), jax.tree.unflatten(tree, over)

        template[:] = [jax.eval_shape(run, arrays, numbers)]
        lifted = custom_vmap(run)
        lifted.def_vmap(lanes_last)
        parts, code = lifted(arrays, numbers)
        self.codes.append(code)
        found, known = joined(static[0], parts)
        object.__setattr__(found, "_known_error" if self.errors else "_confirmation", known if self.errors else _Unread)
        return found


class _Unread:
    """In place of what finds the errors of records: they are not told unless they are asked for."""

    tells = False

    @staticmethod
    def errors(*_):
        raise ErrorsRead


_lift: ContextVar[Any] = ContextVar("lift", default=None)


def lift() -> Any:
    """What runs are given to, `None` for themselves."""
    return _lift.get()


@contextmanager
def lifting(errors: bool = False, last: bool = True) -> Iterator[Lift]:
    """Runs within have their lanes last under `jax.vmap`, unless `last` is false. `errors`: with those of records."""
    yield from _within(Lift(errors, last))


@contextmanager
def quietly() -> Iterator[None]:
    """Runs within are themselves."""
    yield from _within(None)


@contextmanager
def asking() -> Iterator[None]:
    """The first run within is not made: `Asked` is raised, with what it would be of."""

    def asked(simulate, *scene):
        raise Asked(*scene)

    yield from _within(asked)


def _within(x):
    token = _lift.set(x)
    try:
        yield x
    finally:
        _lift.reset(token)


def _code_of_each(code, final, lanes):
    """A code for each lane: one whose state is not finite says nothing of the others, which went on."""
    over = [jnp.all(jnp.isfinite(x), axis=tuple(range(jnp.ndim(x) - len(lanes)))) for x in jax.tree.leaves(final)]
    own = functools.reduce(jnp.logical_and, over)
    return jnp.where(own, jnp.where(code == NOT_FINITE, COMPLETED, code), NOT_FINITE)


def _axes(batched):
    return [0 if own else None for own in batched]


def _behind(x, batched, count):
    """An array with its lanes last; what all lanes share has them too."""
    return jnp.moveaxis(x, 0, -1) if batched else jnp.broadcast_to(jnp.asarray(x)[..., None], (*jnp.shape(x), count))


def scene_of(function: Callable, *arguments: Any, **named: Any) -> tuple | None:
    """What a function asks `simulate` for first, (lattice, state, t1, keywords); `None` where it asks for nothing."""
    try:
        with asking():
            function(*arguments, **named)
    except Asked as asked:
        return asked.scene
    return None
