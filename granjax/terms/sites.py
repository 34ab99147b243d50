"""Forces on single sites: on-site laws and drives."""

from collections.abc import Callable
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..checks import refuse
from ..laws import Law
from ..strains import Sites
from ..types import Parameter, Site, Waveform
from ..units import PART, Signal
from .base import Excitation, Term, get, put
from .bonds import Bond
from .waveforms import Breaks, as_module, checked_breaks


class OnSite(Bond):
    """A force that ties each site to its rest position: F = -law.force(u).

    **Arguments:** `law`, elementwise in u (Linear, Sine, Polynomial, ...); `field`: name of the field, where a cell
    holds several. **Raises** ValueError where `law` is no law.

    **Example:**

    >>> spring = gx.Bond(gx.Shift(1, "periodic"), gx.Linear(0.1))
    >>> chain = gx.Lattice(1.0, (spring, gx.OnSite(gx.Sine())), sites=20)
    >>> omega = gx.linear.normal_modes(chain).omega
    >>> round(float(omega[0]), 4), round(float(omega[-1]), 4)
    (1.0, 1.1832)
    """

    _shown = {"law": "law", "field": "field"}
    per_site: ClassVar[bool] = True

    def __init__(self, law: Law, field: str | None = None):
        super().__init__(Sites(field), law)

    @property
    def field(self):
        """Name of the field, or `None`."""
        return self.strain_map.field

    def compressions(self, t, u):
        return tuple(c._replace(place="site") for c in super().compressions(t, u))


class Drive(Term):
    """A force on one site: F_site = f(t).

    **Arguments:** `waveform`: a function of time, `Harmonic(amplitude, omega)` or any callable Module; in the plane
    it returns a vector. `site`: index (a tuple on a grid), negative from the end. `field`: as in `OnSite`. `breaks`:
    times at which it jumps, as in `Modulated`; and the beginning and the end of a pulse that is not long against the
    time step, with some times between where its shape counts: steps end there, where otherwise a run may pass over
    it. A run looks at 8 to 2048 places in each step; where it finds such a pulse its `outcome` says so, and the errors
    of its records are infinite. It finds no shorter one, and looks at nothing under a transformation.
    **Raises** ValueError where `waveform` cannot be called.

    **Example:**

    >>> spring = gx.Bond(gx.Shift(1, "fixed"), gx.Linear())
    >>> chain = gx.Lattice(1.0, (spring, gx.Drive(gx.Harmonic(0.5, omega=2.0), site=0)), sites=20)
    >>> v, a = gx.vector_field(0.0, gx.states.rest(chain), chain)
    >>> float(a[0])
    0.5
    """

    dimensions = {"waveform": Signal((1, 0, 0)), "breaks": PART}
    waveform: Callable
    span: ClassVar[tuple[int, ...]] = ()
    breaks: Breaks | None
    site: tuple = eqx.field(static=True)
    field: str | None = eqx.field(static=True)

    def __init__(
        self,
        waveform: Waveform,
        site: Site = 0,
        field: str | None = None,
        breaks: Parameter | Breaks | None = None,
    ):
        self.waveform = as_module(waveform)
        self.site = tuple(site) if np.ndim(site) else (site,)
        self.field, self.breaks = field, checked_breaks(breaks)

    def force(self, t, u, v, mass):
        x = get(u, self.field)
        return put(jnp.zeros_like(x).at[self.site].set(self.waveform(t)), self.field)

    def check(self, name, lattice):
        sites = lattice.sites
        sites = sites.get(self.field, ()) if isinstance(sites, dict) else sites
        if len(self.site) != len(sites) or any(not -n <= i < n for i, n in zip(self.site, sites)):
            refuse(name, f"a site of a lattice of {sites}", f"site {self.site}")
        if lattice.dimension is not None and jax.eval_shape(self.waveform, jnp.zeros(())).shape != (
            lattice.dimension,
        ):
            refuse(
                name,
                f"a waveform that gives a vector of {lattice.dimension}",
                "one of another shape",
            )

    def excitation(self, lattice, ts):
        zero = jnp.zeros((), lattice.dtype)
        return Excitation(jnp.max(jnp.abs(jax.vmap(self.waveform)(ts))), zero, zero)
