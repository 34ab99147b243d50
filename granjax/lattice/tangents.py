"""The variational equation of a state and its tangents, split or as a vector field.

The extended state is ((u, U), (v, V)), where U and V have the shape of u with a trailing axis, one
entry per tangent.
"""

import equinox as eqx

from ..base.types import Number, StateLike
from .linearised import linearised
from .model import Lattice
from .split import refuse_velocity, split_system, vector_field


class TangentSplit(eqx.Module):
    """Kicks and drifts of a lattice and of the lattice linearised at the last force evaluation.

    The linearised lattice travels with the working form and with what is kept between steps.
    """

    lattice: Lattice

    @property
    def _inner(self):
        return split_system(self.lattice)

    def _outer(self, t, u):
        return split_system(linearised(self.lattice, t, u))

    def start(self, t, y):
        (u, U), (v, V) = y
        outer = self._outer(t, u)
        return self._inner.start(t, (u, v)), outer.start(t, (U, V)), outer

    def enter(self, y, cache):
        (u, U), (v, V) = y
        inner, many, outer = cache
        return self._inner.enter((u, v), inner), outer.enter((U, V), many), outer

    def leave(self, w, like):
        one, many, outer = w
        (u, v), kept = self._inner.leave(one, (None, None))
        (U, V), kept_too = outer.leave(many, (None, None))
        return ((u, U), (v, V)), (kept, kept_too, outer)

    def refresh(self, w, t):
        one, many, _ = w
        (u, _), _ = self._inner.leave(one, (None, None))
        outer = self._outer(t, u)
        return self._inner.refresh(one, t), outer.refresh(many, t), outer

    def kick(self, w, bh):
        one, many, outer = w
        return self._inner.kick(one, bh), outer.kick(many, bh), outer

    def drift(self, w, ah):
        one, many, outer = w
        return self._inner.drift(one, ah), outer.drift(many, ah), outer

    def acceleration(self, y, cache):
        (u, U), (v, V) = y
        inner, many, outer = cache
        return self._inner.acceleration((u, v), inner), outer.acceleration((U, V), many)


def variational(t: Number, y: tuple[StateLike, StateLike], lattice: Lattice) -> tuple:
    """Return dy/dt of the state and its tangents: f(t, y, args), with the lattice as `args`."""
    (u, U), (v, V) = y
    a = lattice.acceleration(t, u, v)
    return (v, V), (a, linearised(lattice, t, u, v).acceleration(t, U, V))


variational.split_system = TangentSplit
variational.refuse_velocity = refuse_velocity
vector_field.variational = variational
