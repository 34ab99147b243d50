"""Walls at the ends of a chain."""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..checks import one_of, refuse
from ..laws import Law, Scaled, Yielding
from ..types import Displacements, Number, Numbers, Parameter, Waveform
from ..units import PART, Signal
from .base import Compression, Excitation, Term, get, put
from .bonds import spring
from .tracing import Dependence
from .waveforms import Breaks, as_module, checked_breaks, held, jumps_of


class Wall(Term):
    """A wall at one end of a chain: rigid, elastic, driven or yielding.

    Left: e = w(t) - u_0; right: e = u_{N-1} - w(t); the end site feels the contact force law.force(e) away from the
    wall. Use it with a `Shift` whose boundary is `"free"` at that end.

    **Arguments:** `law`: the contact with the wall (a sphere on a plane of another material:
    `Hertz(materials.hertz_coefficient(...), F0)`). `side`: `"left"` or `"right"`. `motion`: the wall's displacement
    w(t), a function or Module, `None` for a wall at rest. `support`: stiffness of a linear spring behind the wall
    [N/m], for a wall that yields; `None` for none. `field`: as in `OnSite`. `breaks`: times at which the motion or its
    speed jumps, as in `Modulated`.
    **Raises** ValueError for another side, a motion that cannot be called, support <= 0.

    **Example:**

    >>> wall = gx.Wall(gx.Hertz(), "right")
    >>> chain = gx.Lattice(1.0, (gx.Bond(gx.Shift(1, "free"), gx.Hertz()), wall), sites=3)
    >>> v, a = gx.vector_field(0.0, gx.State(jnp.array([0.0, 0.0, 4.0]), jnp.zeros(3)), chain)
    >>> float(a[-1])
    -8.0
    """

    dimensions = {"law": PART, "motion": Signal((0, 1, 0)), "breaks": PART}
    law: Law
    motion: Callable | None
    breaks: Breaks | None
    side: str = eqx.field(static=True)
    field: str | None = eqx.field(static=True)

    def __init__(
        self,
        law: Law,
        side: str = "right",
        motion: Waveform | None = None,
        support: Parameter | None = None,
        field: str | None = None,
        breaks: Parameter | Breaks | None = None,
    ):
        self.law = law if support is None else Yielding(law, support)
        self.side = one_of("side", side, ("left", "right"))
        self.motion = None if motion is None else as_module(motion)
        self.field, self.breaks = field, checked_breaks(breaks)

    def jumps(self):
        own = None if self.motion is None else jumps_of(self.motion, self.breaks)
        return () if own is None else (own,)

    def between(self, low, high):
        return held(self, "motion", low, high) if self.jumps() else self

    def check(self, name, lattice):
        if lattice.axes != 1 or lattice.dimension is not None:
            refuse(
                name,
                "a chain with scalar displacements",
                f"a lattice of shape {lattice.shape}",
                "Hold ends by bonds.",
            )

    def dependence(self, lattice):
        return Dependence(time=self.motion is not None, displacement=True, energy=True)

    def compression(self, t: Number, u: Displacements) -> Numbers:
        """Compression of the contact with the wall; one value (and lanes)."""
        x = get(u, self.field)
        wall = 0.0 if self.motion is None else self.motion(t)
        return wall - x[0] if self.side == "left" else x[-1] - wall

    def force(self, t, u, v, mass):
        return self._push(self.law.force(self.compression(t, u)), u)

    def preload_force(self, u):
        return self._push(self.law.preload, u)

    def _push(self, force, u):
        return self._put(force if self.side == "left" else -force, u)

    def energy(self, t, u):
        return self.law.energy(self.compression(t, u))[None]

    def site_energy(self, lattice, t, u):
        return self._put(self.energy(t, u)[0], u)

    def _put(self, value, u):
        x = jnp.zeros_like(get(u, self.field))
        return put(
            x.at[0 if self.side == "left" else -1].set(jnp.asarray(value).astype(x.dtype)),
            self.field,
        )

    def compressions(self, t, u):
        return (Compression(self.law, jnp.asarray(self.compression(t, u))[None], "wall"),)

    def undriven(self):
        return self._still(self.law)

    def _still(self, law):
        return eqx.tree_at(
            lambda x: (x.law, x.motion, x.breaks),
            self,
            (law, None, None),
            is_leaf=lambda x: x is None,
        )

    def scaled(self, factor):
        return eqx.tree_at(lambda term: term.law, self, Scaled(self.law, factor))

    def linearised(self, lattice, t, u, v):
        return self._still(spring(self.law, self.compression(t, u)))

    def resists(self, lattice, moves):
        end = 0 if self.side == "left" else -1
        return np.stack([np.ravel(get(move, self.field)[end]) for move in moves], -1)

    def walls(self):
        return (self.side,)

    def span(self):
        return ()

    def stiffness_bound(self, lattice, reach, factor=1.0):
        k = factor * reach.stiffest(self.law, 0)
        k = k[0] if jnp.ndim(k) > len(lattice.lanes) else k
        return lambda w: self._put(k * get(w, self.field)[0 if self.side == "left" else -1], w)

    def excitation(self, lattice, ts):
        zero = jnp.zeros((), lattice.dtype)
        if self.motion is None:
            return Excitation(zero, zero, zero)
        w, speed = jax.vmap(lambda t: jax.jvp(self.motion, (t,), (jnp.ones_like(t),)))(ts)
        return Excitation(zero, jnp.max(jnp.abs(w)), jnp.max(jnp.abs(speed)))

    def energy_times(self, lattice, ts):
        return ts[:1]
