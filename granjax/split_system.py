"""What a splitting method sees, and all that it knows of the equation: a split system.

A system that can do a whole step better than stage by stage offers `compose(w, table, t, step)` in place of
`by_stages`, and then needs no `refresh`, `kick` and `drift`.
"""

import abc
from typing import Any

import equinox as eqx
import jax
import numpy as np

from .printing import told
from .types import Number, Pytree, StateLike, VectorField


def pair(like: StateLike, u: Pytree, v: Pytree) -> StateLike:
    """(u, v) in the form of another state: a pair or a named tuple."""
    return type(like)(u, v) if hasattr(like, "_fields") else type(like)((u, v))


class Split(eqx.Module):
    """H = T(v) + V(t, u) in the plain working form w = (u, v, a), free flight in between.

    `start` evaluates the force, `enter` and `leave` change between the state and the working form, `kick` and `drift`
    are the two exact flows, `refresh` evaluates the force at a new place and time, `acceleration` reads it off for
    dense output. The force that ends one step opens the next.
    """

    __repr__ = told

    @abc.abstractmethod
    def start(self, t: Number, y: StateLike) -> Pytree:
        """The acceleration at (t, u), without what the drift takes."""

    def enter(self, y: StateLike, cache: Pytree) -> Pytree:
        """The working form of a state and what `start` or `leave` gave."""
        u, v = y
        return u, v, cache

    def leave(self, w: Pytree, like: StateLike) -> tuple:
        """The state, in the form of another one, and the force that opens the next step."""
        u, v, a = w
        return pair(like, u, v), a

    def refresh(self, w: Pytree, t: Number) -> Pytree:
        """The working form with the force at its place, at time t."""
        u, v, _ = w
        return u, v, self.start(t, (u, v))

    def kick(self, w: Pytree, bh: Number) -> Pytree:
        """The flow of the potential energy over a time bh: v += bh a."""
        u, v, a = w
        return u, jax.tree.map(lambda v, a: v + bh.astype(v.dtype) * a, v, a), a

    def drift(self, w: Pytree, ah: Number) -> Pytree:
        """The flow of the kinetic energy over a time ah: u += ah v."""
        u, v, a = w
        return jax.tree.map(lambda u, v: u + ah.astype(u.dtype) * v, u, v), v, a

    def acceleration(self, y: StateLike, cache: Pytree) -> Pytree:
        """The acceleration at a state, from what `leave` gave with it."""
        return cache


class FieldSplit(Split):
    """The split system of a plain vector field f(t, (u, v), args) = (v, a(t, u)); a must not depend on v."""

    field: VectorField = eqx.field(static=True)
    args: Any

    def start(self, t, y):
        return self.field(t, y, self.args)[1]


def by_stages(split: Any, w: Pytree, table: Any, t: Number, step: Number) -> Pytree:
    """The working form after a step from time t by a method's `table` of kicks and drifts, one after the other."""
    ah, bh, times = table.a * step, table.b * step, t + np.cumsum(table.a) * step
    kicks_last = table.b[-1] != 0
    if table.b[0] != 0:
        w = split.kick(w, bh[0])

    def stage(w, x):
        ah, bh, time = x
        return split.kick(split.refresh(split.drift(w, ah), time), bh), None

    count = len(ah) if kicks_last else len(ah) - 1
    w, _ = jax.lax.scan(stage, w, (ah[:count], bh[1 : count + 1], times[:count]))
    return w if kicks_last else split.drift(w, ah[-1])
