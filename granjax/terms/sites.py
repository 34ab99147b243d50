"""Forces on single sites: on-site laws and drives."""

from collections.abc import Callable
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp

from ..laws import Law, checked_law
from .base import Term, get, put
from .waveforms import checked_waveform


class OnSite(Term):
    """A force that ties each site to its rest position: F = -law.force(u).

    **Arguments:** `law`, elementwise in u (Linear, Sine, Polynomial, ...); `field`: name of the field, where a cell
    holds several. **Raises** ValueError where `law` is no law.
    """

    law: Law
    field: str | None = eqx.field(static=True)

    def __init__(self, law, field=None):
        self.law, self.field = checked_law(law), field

    def force(self, t, u, v, mass):
        return put(-self.law.force(get(u, self.field)), self.field)

    def energy(self, t, u):
        return self.law.energy(get(u, self.field))

    def site_energy(self, t, u):
        return put(self.energy(t, u), self.field)


class Drive(Term):
    """A force on one site: F_site = f(t).

    **Arguments:** `waveform`: a function of time, `Harmonic(amplitude, omega)` or any callable Module; in the plane
    it returns a vector. `site`: index (a tuple on a grid), negative from the end. `field`: as in `OnSite`.
    **Raises** ValueError where `waveform` cannot be called.
    """

    conserves: ClassVar[bool] = False
    waveform: Callable
    site: tuple = eqx.field(static=True)
    field: str | None = eqx.field(static=True)

    def __init__(self, waveform, site=0, field=None):
        self.waveform = checked_waveform("waveform", waveform)
        self.site = tuple(site) if isinstance(site, (tuple, list)) else (site,)
        self.field = field

    def force(self, t, u, v, mass):
        x = get(u, self.field)
        return put(jnp.zeros_like(x).at[self.site].set(self.waveform(t)), self.field)
