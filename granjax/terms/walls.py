"""Walls at the ends of a chain."""

from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp

from ..checks import one_of
from ..laws import Law, Yielding, checked_law
from .base import Term, get, put
from .waveforms import checked_waveform


class Wall(Term):
    """A wall at one end of a chain: rigid, elastic, driven or yielding.

    Left: e = w(t) - u_0; right: e = u_{N-1} - w(t); the end site feels the contact force law.force(e) away from the
    wall. Use it with a `Shift` whose boundary is `"free"` at that end.

    **Arguments:** `law`: the contact with the wall (a sphere on a plane of another material:
    `Hertz(materials.hertz_coefficient(...), F0)`). `side`: `"left"` or `"right"`. `motion`: the wall's displacement
    w(t), a function or Module, `None` for a wall at rest. `support`: stiffness of a linear spring behind the wall
    [N/m], for a wall that yields; `None` for none. `field`: as in `OnSite`.
    **Raises** ValueError for another side, a motion that cannot be called, support <= 0.
    """

    law: Law
    motion: Callable | None
    side: str = eqx.field(static=True)
    field: str | None = eqx.field(static=True)

    def __init__(self, law, side="right", motion=None, support=None, field=None):
        self.law = checked_law(law) if support is None else Yielding(checked_law(law), support)
        self.side = one_of("side", side, ("left", "right"))
        self.motion = None if motion is None else checked_waveform("motion", motion)
        self.field = field

    @property
    def conserves(self):
        return self.motion is None

    def compression(self, t, u):
        """Compression of the contact with the wall; one value (and lanes)."""
        x = get(u, self.field)
        wall = 0.0 if self.motion is None else self.motion(t)
        return wall - x[0] if self.side == "left" else x[-1] - wall

    def force(self, t, u, v, mass):
        return self._push(self.law.force(self.compression(t, u)), u)

    def preload_force(self, u):
        return self._push(self.law.preload, u)

    def _push(self, force, u):
        x = jnp.zeros_like(get(u, self.field))
        x = x.at[0].set(force) if self.side == "left" else x.at[-1].set(-force)
        return put(x, self.field)

    def energy(self, t, u):
        return self.law.energy(self.compression(t, u))[None]

    def site_energy(self, t, u):
        x = jnp.zeros_like(get(u, self.field))
        return put(x.at[0 if self.side == "left" else -1].set(self.energy(t, u)[0]), self.field)
