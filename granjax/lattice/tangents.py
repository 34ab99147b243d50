"""A state and its tangents as one system: the variational equation, split for the splitting solvers or as a field.

The extended state is ((u, U), (v, V)), where U and V have the shape of u with a trailing axis, one entry a tangent.
"""

import equinox as eqx
import jax
import jax.numpy as jnp

from .linearised import linearised
from .model import Lattice
from .split import acceleration_only, split_system, vector_field


class TangentSplit(eqx.Module):
    """Kicks and drifts of a lattice and of the lattice linearised about where it is."""

    lattice: Lattice

    @property
    def _inner(self):
        return split_system(self.lattice)

    def _outer(self, t, u):
        return split_system(linearised(self.lattice, t, u))

    def _moving(self, u):
        """For what does not read the stiffness."""
        return self._outer(0.0, u)

    def start(self, t, y):
        (u, U), (v, V) = y
        return self._inner.start(t, (u, v)), self._outer(t, u).start(t, (U, V))

    def enter(self, y, cache):
        (u, U), (v, V) = y
        return self._inner.enter((u, v), cache[0]), self._moving(u).enter((U, V), cache[1])

    def leave(self, w, like):
        one, many = w
        (u, v), kept = self._inner.leave(one, (None, None))
        (U, V), kept_too = self._moving(u).leave(many, (None, None))
        return ((u, U), (v, V)), (kept, kept_too)

    def refresh(self, w, t):
        one, many = w
        (u, _), _ = self._inner.leave(one, (None, None))
        return self._inner.refresh(one, t), self._outer(t, u).refresh(many, t)

    def kick(self, w, bh):
        return self._inner.kick(w[0], bh), self._moving(self._position(w)).kick(w[1], bh)

    def drift(self, w, ah):
        return self._inner.drift(w[0], ah), self._moving(self._position(w)).drift(w[1], ah)

    def _position(self, w):
        return self._inner.leave(w[0], (None, None))[0][0]

    def acceleration(self, y, cache):
        (u, U), (v, V) = y
        inner, outer = self._inner, self._moving(u)
        return inner.acceleration((u, v), cache[0]), outer.acceleration((U, V), cache[1])


def variational(t, y, lattice):
    """dy/dt of the state and its tangents: f(t, y, args), with the lattice as `args`."""
    (u, U), (v, V) = y
    return (v, V), _accelerations(lattice, t, u, U, v, V)


def _accelerations(lattice, t, u, U, v, V):
    return lattice.acceleration(t, u, v), linearised(lattice, t, u, v).acceleration(t, U, V)


def _of_positions(lattice):
    acceleration_only(lattice)  # refuses, naming the term

    def accelerations(t, uU):
        zero = jax.tree.map(jnp.zeros_like, uU)
        return _accelerations(lattice, t, *uU, *zero)

    return accelerations


variational.split_system = TangentSplit
variational.acceleration_only = _of_positions
vector_field.variational = variational
