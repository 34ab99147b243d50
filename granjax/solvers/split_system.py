"""The split system of an equation of motion, which is all that a splitting method uses.

A system that has a better way to take a whole step than stage by stage offers
`compose(w, table, t, step)` in place of `by_stages`, and then needs no `refresh`, `kick` and
`drift`.
"""

import abc
from typing import Any

import equinox as eqx
import jax
import numpy as np

from ..base.printing import told
from ..base.types import Number, Pytree, StateLike, VectorField


def pair(like: StateLike, u: Pytree, v: Pytree) -> StateLike:
    """Return (u, v) in the form of another state: a pair or a named tuple."""
    return type(like)(u, v) if hasattr(like, "_fields") else type(like)((u, v))


class Split(eqx.Module):
    """H = T(v) + V(t, u) with free flight, in the working form w = (u, v, a).

    `start` evaluates the force; `enter` and `leave` convert between state and working form; `kick`
    and `drift` are the two exact flows; `refresh` evaluates the force anew; `acceleration` returns
    it for dense output. The last force of a step is the first of the next.
    """

    __repr__ = told

    @abc.abstractmethod
    def start(self, t: Number, y: StateLike) -> Pytree:
        """Return the acceleration at (t, u), without the part that the drift contains."""

    def enter(self, y: StateLike, cache: Pytree) -> Pytree:
        """Return the working form of a state and the cache from `start` or `leave`."""
        u, v = y
        return u, v, cache

    def leave(self, w: Pytree, like: StateLike) -> tuple:
        """Return the state, in the form of `like`, and the force for the next step."""
        u, v, a = w
        return pair(like, u, v), a

    def refresh(self, w: Pytree, t: Number) -> Pytree:
        """Return the working form with the force at its place, at time t."""
        u, v, _ = w
        return u, v, self.start(t, (u, v))

    def kick(self, w: Pytree, bh: Number) -> Pytree:
        """Apply the flow of the potential energy over a time bh: v += bh a."""
        u, v, a = w
        return u, jax.tree.map(lambda v, a: v + bh.astype(v.dtype) * a, v, a), a

    def drift(self, w: Pytree, ah: Number) -> Pytree:
        """Apply the flow of the kinetic energy over a time ah: u += ah v."""
        u, v, a = w
        return jax.tree.map(lambda u, v: u + ah.astype(u.dtype) * v, u, v), v, a

    def acceleration(self, y: StateLike, cache: Pytree) -> Pytree:
        """Return the acceleration at a state, from the cache of `leave`."""
        return cache


class FieldSplit(Split):
    """The split system of a field f(t, (u, v), args) = (v, a(t, u)); a must not depend on v."""

    field: VectorField = eqx.field(static=True)
    args: Any

    def start(self, t, y):
        return self.field(t, y, self.args)[1]


def by_stages(split: Any, w: Pytree, table: Any, t: Number, step: Number) -> Pytree:
    """Return the working form after a step from time t, by a `table` of kicks and drifts."""
    ah = table.a * step
    bh = table.b * step
    times = t + np.cumsum(table.a) * step
    kicks_last = table.b[-1] != 0
    if table.b[0] != 0:
        w = split.kick(w, bh[0])

    def stage(w, x):
        ah, bh, time = x
        return split.kick(split.refresh(split.drift(w, ah), time), bh), None

    count = len(ah) if kicks_last else len(ah) - 1
    w, _ = jax.lax.scan(stage, w, (ah[:count], bh[1 : count + 1], times[:count]))
    return w if kicks_last else split.drift(w, ah[-1])
