"""The lattice as a split system, for the splitting solvers.

Linear damping of the sites is part of the drift, exactly.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from ..base.arrays import padded
from ..base.checks import refuse
from ..base.types import Number, StateLike
from ..laws import Law
from ..solvers.split_system import Split, pair
from ..terms import chain
from ..terms.base import get, replaced
from ..terms.reach import reads
from .model import Lattice, check_shape, refuse_memory

# The numbers in the longest vector register.
VECTOR = 8
# From this number of sites on, an incomplete vector does not matter.
SHORT = 2000


class PlainSplit(Split):
    """Any lattice: w = (u, v, a)."""

    lattice: Lattice

    def start(self, t, y):
        def acceleration(t, u, v):
            forces = self.lattice.sum_forces(t, u, v, _without_velocity(self.lattice))
            return jax.tree.map(jnp.divide, forces, self.lattice.mass)

        # A gradient would keep all numbers of a force between vectors, hundreds of arrays, each
        # with a function of its own to compile.
        in_space = self.lattice.dimension is not None
        return (jax.checkpoint(acceleration) if in_space else acceleration)(t, *y)

    def drift(self, w, ah):
        u, v, a = w
        for name, rate in damping_rates(self.lattice, u):
            moved, slowed = damped_flight(get(u, name), get(v, name), rate, ah)
            u = replaced(u, name, moved)
            v = replaced(v, name, slowed)
        return u, v, a

    def acceleration(self, y, cache):
        return _slowed(self.lattice, cache, y[1])


class ChainSplit(eqx.Module):
    """The fast form of a damped chain with one bond to the next site: w = (u, v, f).

    `u` has a resting ghost site at each wall. `f` has one entry more than there are bonds (walls),
    or a zero at each end (free ends), so that an update never covers the whole buffer. Between
    walls `spare` ghosts may make the bonds whole vectors.
    """

    # XLA evaluates a fused force once for each reader, twice per bond. Written by
    # `dynamic_update_slice` into a buffer that the loop carries, the force is evaluated once.
    # 101 bonds took 1.14 times as long as 104, which are whole vectors.
    lattice: Lattice
    law: Law
    boundary: str = eqx.field(static=True)
    spare: int = eqx.field(static=True, default=0)

    @property
    def _walls(self):
        return self.boundary == "fixed"

    def _write(self, f, u):
        return self._put(f, self.law.force(u[:-1] - u[1:]))

    def _put(self, f, force):
        first = 0 if self._walls else 1
        return jax.lax.dynamic_update_slice_in_dim(f, force.astype(f.dtype), first, 0)

    def compression(self, w):
        """Return the compressions of all bonds."""
        return w[0][:-1] - w[0][1:]

    def spread(self, pulled, of_force, idle):
        """Return cotangents of the working form before its force was evaluated.

        `of_force` pulls back the cotangent of the force. Like the force, it is written into a
        buffer (`idle`) that the loop carries, so that it is evaluated once.
        """
        u, v, f = pulled
        first = 0 if self._walls else 1
        bonds = u.shape[0] - 1
        change, c = of_force(f[first : first + bonds])
        idle = self._put(idle, c)
        c = idle[first : first + bonds]
        return change, (u + padded(c, 0, 1) - padded(c, 1, 0), v, idle)

    def _pull(self, f):
        n = f.shape[0] - 1 - self.spare
        return (f[: n - 1] - f[1:n]) if self._walls else f[:-1] - f[1:]

    def _inner(self, u):
        return u[1 : u.shape[0] - 1 - self.spare] if self._walls else u

    def _padded(self, u):
        return padded(u, 1, 1 + self.spare) if self._walls else u

    def start(self, t, y):
        u, _ = y
        more = 2 + self.spare if self._walls else 1
        return self._write(jnp.zeros((u.shape[0] + more,) + u.shape[1:], u.dtype), self._padded(u))

    def enter(self, y, cache):
        u, v = y
        return self._padded(u), v, cache

    def leave(self, w, like):
        u, v, f = w
        return pair(like, self._inner(u), v), f

    def refresh(self, w, t):
        u, v, f = w
        return u, v, self._write(f, u)

    def kick(self, w, bh):
        u, v, f = w
        return u, v + bh.astype(v.dtype) * (1 / self.lattice.mass) * self._pull(f), f

    def drift(self, w, ah):
        u, v, f = w
        ((_, rate),) = damping_rates(self.lattice, u)
        inner, v = damped_flight(self._inner(u), v, rate, ah)
        u = jax.lax.dynamic_update_slice_in_dim(u, inner, 1, 0) if self._walls else inner
        return u, v, f

    def acceleration(self, y, cache):
        return _slowed(self.lattice, (1 / self.lattice.mass) * self._pull(cache), y[1])


class SpringSplit(eqx.Module):
    """A chain like `ChainSplit` with linear springs, such as one of tangents: w = (u, v).

    The force is cheap enough to be evaluated for each reader. `u` has a resting ghost site at each
    end, so that a kick is one pass over three neighbours: v_n += bh/m_n (k_{n-1} (u_{n-1} - u_n) -
    k_n (u_n - u_{n+1})).
    """

    lattice: Lattice
    law: Law
    boundary: str = eqx.field(static=True)

    def start(self, t, y):
        return ()

    def enter(self, y, cache):
        u, v = y
        return padded(u, 1, 1), v

    def leave(self, w, like):
        return pair(like, w[0][1:-1], w[1]), ()

    def refresh(self, w, t):
        return w

    def kick(self, w, bh):
        u, v = w
        return u, v + self._pull(u, bh.astype(v.dtype))

    def drift(self, w, ah):
        u, v = w
        ((_, rate),) = damping_rates(self.lattice, u)
        inner, v = damped_flight(u[1:-1], v, rate, ah)
        return jax.lax.dynamic_update_slice_in_dim(u, inner, 1, 0), v

    def acceleration(self, y, cache):
        u, v = y
        a = self._pull(self.enter(y, ())[0], jnp.ones((), u.dtype))
        return _slowed(self.lattice, a, v)

    def _pull(self, u, bh):
        sites = u.shape[0] - 2
        free = self.boundary == "free"
        one = jnp.ones((sites - 1 if free else sites + 1,) + (1,) * (u.ndim - 1), u.dtype)
        k = self.law.force(one).astype(u.dtype)
        k = padded(k, 1, 1) if free else k
        left = (bh / self.lattice.mass) * k[:-1]
        right = (bh / self.lattice.mass) * k[1:]
        return left * u[:-2] - (left + right) * u[1:-1] + right * u[2:]


def split_system(lattice: Lattice) -> Any:
    """Return the lattice as kicks and drifts for a splitting solver.

    **Raises** ValueError naming the term where a force depends on the velocity in another way than
    linear damping of each site, for which there are no exact flows; and for lanes in front of the
    sites.
    """
    refuse_memory(lattice)
    lattice.lanes  # Refuses lanes in front of the sites.
    for i, term in enumerate(lattice.terms):
        if term.exact_damping() is None and reads(term, lattice).velocity:
            refuse(
                "solver",
                "forces that depend on positions and time, beside linear Damping of each site",
                f"terms[{i}] ({type(term).__name__}), which reads the velocity",
                "Use solver=diffrax.Tsit5() or diffrax.Dopri8() with tolerance=..., or replace the term by Damping.",
            )
    found = next_neighbours(lattice)
    if found is None or found[1] == "periodic":
        return PlainSplit(lattice)
    law, boundary = found
    if law.is_linear:
        return SpringSplit(lattice, law, boundary)
    return ChainSplit(lattice, law, boundary, _spare(lattice, law) if boundary == "fixed" else 0)


def _spare(lattice, law):
    # Spare bonds fill up the last vector of a short chain without lanes whose bonds are all alike.
    (sites,) = lattice.sites
    alike = not lattice.lanes and not any(jnp.ndim(x) for x in jax.tree.leaves(law))
    return -(sites + 1) % VECTOR if alike and sites < SHORT else 0


def next_neighbours(lattice: Lattice) -> tuple[Law, str] | None:
    """Return (law, boundary) if the only bonds of a chain are to the next site, else `None`.

    The chain may have damping.
    """
    forces = _without_velocity(lattice)
    plain = lattice.fields is None and lattice.dimension is None and lattice.axes == 1
    return chain.next_neighbours(forces[0]) if plain and len(forces) == 1 else None


def refuse_velocity(lattice: Lattice) -> None:
    """Refuse terms whose force reads the velocity, which Nystrom pairs do not take."""
    refuse_memory(lattice)
    for i, term in enumerate(lattice.terms):
        if reads(term, lattice).velocity:
            refuse(
                "solver",
                "forces that depend on positions and time alone",
                f"terms[{i}] ({type(term).__name__}), which reads the velocity",
                "Use solver=diffrax.Dopri8() with tolerance=..., or a splitting solver if the term is Damping.",
            )


def vector_field(t: Number, y: StateLike, lattice: Lattice) -> StateLike:
    """Return dy/dt = (v, a), in diffrax's form f(t, y, args) with the lattice as `args`.

    `y` is a `State` (or a pair (u, v)); the result has its structure.

    **Example:**

    >>> chain = gx.Lattice(1.0, gx.Bond(gx.Shift(1, "free"), gx.Hertz()), sites=2)
    >>> v, a = gx.vector_field(0.0, gx.State(jnp.array([4.0, 0.0]), jnp.array([1.0, 2.0])), chain)
    >>> v, a
    (Array([1., 2.], dtype=float64), Array([-8.,  8.], dtype=float64))
    """
    u, v = y
    refuse_memory(lattice)
    for name, x in zip("uv", y):
        check_shape(lattice, f"y.{name}", x)
    return pair(y, v, lattice.acceleration(t, u, v))


vector_field.split_system = split_system
vector_field.refuse_velocity = refuse_velocity
vector_field.breaks = lambda lattice: lattice.breaks


def damped_flight(u, v, rate, ah):
    """Return the exact flow of u' = v, v' = -rate v over ah of any sign; rate `None` is zero."""
    ah = ah.astype(v.dtype)
    if rate is None:
        return u + ah * v, v
    x = rate * ah
    small = jnp.abs(x) < 1e-8
    weight = jnp.where(small, 1 - x / 2, -jnp.expm1(-x) / jnp.where(small, 1, x))
    # The factor exp(-x) itself, near 1, would be rounded alike in every step.
    return u + ah * weight * v, v + jnp.expm1(-x) * v


def _without_velocity(lattice):
    return tuple(term for term in lattice.terms if term.exact_damping() is None)


def _slowed(lattice, a, v):
    # The acceleration with that of the damping.
    for name, rate in damping_rates(lattice, v):
        if rate is not None:
            a = replaced(a, name, get(a, name) - rate * get(v, name))
    return a


def damping_rates(lattice, u):
    """Yield (field, total rate or `None`) for every field of the displacements."""
    damping = [term.exact_damping() for term in lattice.terms]
    for name in tuple(u) if isinstance(u, dict) else (None,):
        rates = [found[1] for found in damping if found is not None and found[0] in (None, name)]
        yield name, (sum(rates[1:], rates[0]) if rates else None)
