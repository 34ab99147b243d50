"""The initial data of a shock, and the time until its waves meet the ends of the chain."""

import dataclasses
from collections.abc import Iterator
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..base.arrays import trailing
from ..base.checks import concrete, refuse
from ..base.printing import told
from ..base.programs import compiled
from ..base.types import Displacements, Number, Numbers, Scalar
from ..flow import Run, simulate
from ..lattice import Lattice, State
from ..laws import Law
from ..terms.reach import furthest

# The points on the range of strains among which the stiffest chord is searched for.
SAMPLES = 33
# The nodes of an integral over a range of strains, by the Gauss-Legendre rule.
NODES = 32
_PLACES, _WEIGHTS = np.polynomial.legendre.leggauss(NODES)
# The reach n = s t + AIRY (s t)^{1/3} of a linear front, Ai(z) with z = (n - s t)/(s t/8)^{1/3},
# which is below 1e-16 from z = 14 on.
AIRY = 7
# The extra sites between the waves and an end.
SITES = 4
# The reach n = VISCOUS (nu t)^{1/2} of a front that dashpots smooth. Beyond it exp(-n^2/(2 nu t))
# is as small as that.
VISCOUS = 8.6
# The steps of the bisection for the time at which the waves meet an end.
HALVINGS = 60


class Jolt(eqx.Module):
    """The source of a shock: law, least mass, and pairs of a strain and a velocity jump.

    The velocity is that of beads relative to the medium ahead, which has the strain; its sign is
    that of the compression. `spread`: the coefficient of dashpots between neighbours over the mass.
    """

    law: Law
    mass: Number
    into: tuple
    spread: Number
    __repr__ = told


class Riemann(eqx.Module):
    """The initial data of a shock: unpacks as (lattice, state) for `gx.simulate(*problem, t1)`.

    - `lattice`, `state`: the chain to run and its initial state, lanes last.
    - `kind`: "velocity", "strain" or "piston". `c`: the given c, `left - right`, or half the
      piston's speed (the c of the velocity shock of which it is one half).
    - `centre`: the place of the step on the scale of bonds, bond n lying between the sites n and
      n + 1: x = n - centre, and n/t of the theory is x/t.
    - `rest`: the strain of each bond at u = 0, (N - 1,), or 0.0.
    """

    lattice: Lattice
    state: State
    c: Number
    centre: Number
    rest: Number
    kind: str = eqx.field(static=True)
    _jolt: Jolt | None = None
    __repr__ = told

    def __iter__(self) -> Iterator[Any]:
        return iter((self.lattice, self.state))

    @property
    def law(self) -> Law | None:
        """The law between neighbours, from the rest of the given chain, or `None`."""
        return None if self._jolt is None else self._jolt.law

    def strain(self, u: Displacements) -> Numbers:
        """Return the total strain y_n (..., N - 1), then lanes, from displacements (..., N).

        Positive in compression, from the rest of the given chain. `rest` and not u holds the far
        states, so that large displacements cost no digits.
        """
        axis = jnp.ndim(u) - 1 - len(self.lattice.lanes)
        size = self.lattice.shape[0]
        if axis < 0 or u.shape[axis] != size:
            refuse(
                "u",
                f"displacements of {size} sites, then lanes {self.lattice.lanes}",
                f"shape {jnp.shape(u)}",
            )
        return self.rest - jnp.diff(u, axis=axis)

    def until(self) -> Number:
        """Return the time until the first waves meet an end of the chain, for each lane.

        It assumes that nothing is faster than sound at the ends and than a smooth jump (m s^2 =
        [F]/[y]) whose beads move at twice the speed behind the shock, as in the first solitary
        wave. The width of the linear front is added. The time is infinite where nothing moves
        (touching beads that part).
        **Raises** ValueError for a chain with other bonds than to the next site.
        """
        if self._jolt is None:
            refuse(
                "t1",
                "a time, since not all forces are those of bonds to the next site",
                "None",
                "How fast the others carry a signal is not known here.",
            )
        centre = self.centre + 0.5
        last = self.lattice.shape[0] - 1
        room = last + 0.0 * centre if self.kind == "piston" else jnp.minimum(centre, last - centre)
        return _until(self._jolt, room, len(self.lattice.lanes))

    def horizon(self) -> Scalar:
        """Return the shortest of `until()`.

        **Raises** ValueError where nothing moves or the step is too close to an end.
        """
        t1 = jnp.min(self.until())
        known = concrete(t1)
        if known is None:
            return t1
        if not 0 < known < np.inf:
            why = "nothing moves, now or ever" if known > 0 else "the step is too close to an end"
            refuse("t1", "a time", "None", f"None is found here: {why}.")
        return float(known)

    def run(self, t1: Scalar | None = None, **keywords: Any) -> Run:
        """Run `gx.simulate(*self, t1, **keywords)`.

        `None` is the shortest `until()` of the lanes. The run remembers its problem for
        `gx.shocks.measure`.
        """
        run = simulate(self.lattice, self.state, self.horizon() if t1 is None else t1, **keywords)
        return dataclasses.replace(run, started=self)


@compiled
def _until(jolt, room, lanes):
    fastest = jnp.zeros(())
    for strain, velocity in jolt.into:
        squared = (
            _stiffest(jolt.law, strain, jolt.mass * velocity**2, jnp.sign(velocity)) / jolt.mass
        )
        # Where bonds differ the stiffest counts.
        fastest = jnp.maximum(fastest, squared.max(0) if squared.ndim > lanes else squared)
    speed = jnp.sqrt(fastest)
    room = jnp.maximum(room - SITES, 0) + 0 * fastest
    latest = jnp.minimum(room / speed, (room / VISCOUS) ** 2 / jolt.spread)

    def halve(_, ends):
        low, high = ends
        t = (low + high) / 2
        near = speed * t + AIRY * jnp.cbrt(speed * t) + VISCOUS * jnp.sqrt(jolt.spread * t) < room
        return jnp.where(near, t, low), jnp.where(near, high, t)

    return jnp.where(
        jnp.isfinite(latest), jax.lax.fori_loop(0, HALVINGS, halve, (0 * latest, latest))[0], latest
    )


def _stiffest(law, strain, work, sign):
    force = law.force(strain)
    zero = 0 * (law.derivative(strain) + work)

    def reachable(x):
        spent = (law.force(strain + sign * x) - force) * sign * x
        return spent <= work

    far = furthest(reachable, zero, 1.0)
    x = trailing(jnp.linspace(0, 1, SAMPLES)[1:], 1 + far.ndim) * far
    chord = (law.force(strain + sign * x) - force) * sign / jnp.where(x > 0, x, 1)
    return jnp.maximum(
        law.derivative(strain), jnp.max(jnp.where(jnp.isfinite(chord) & (x > 0), chord, 0), 0)
    )


def simple_wave_velocity(law: Law, mass: Number, low: Number, high: Number) -> Number:
    """Return the velocity of a simple wave: the integral of sqrt(F'(y)/m) between two strains."""
    step = high - low
    places, weights = (trailing(x, 1 + jnp.ndim(step)) / 2 for x in (1 + _PLACES, _WEIGHTS))
    slopes = jnp.maximum(law.derivative(low + places * step), 0)
    return jnp.sum(weights * jnp.sqrt(slopes / mass), 0) * step
