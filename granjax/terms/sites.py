"""Terms that act on single sites: on-site laws, drives, walls at the ends of a chain."""

from collections.abc import Callable
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..base.checks import is_site, one_of, refuse
from ..base.types import Parameter, Site, Waveform
from ..base.units import PART, Signal
from ..laws import Law, Yielding
from ..strains import End, Sites
from .base import Excitation, Term, get, put, within
from .bonds import Bond, spring
from .waveforms import Breaks, as_module, checked_breaks


class OnSite(Bond):
    """A force that ties each site to its rest position: F = -law.force(u).

    **Arguments:** `law`, elementwise in u (Linear, Sine, Polynomial, ...); `field`: its name, if a
    cell has several. **Raises** ValueError where `law` is no law.

    **Example:**

    >>> spring = gx.Bond(gx.Shift(1, "periodic"), gx.Linear(0.1))
    >>> chain = gx.Lattice(1.0, (spring, gx.OnSite(gx.Sine())), sites=20)
    >>> omega = gx.linear.normal_modes(chain).omega
    >>> round(float(omega[0]), 4), round(float(omega[-1]), 4)
    (1.0, 1.1832)
    """

    dimensions = Bond.dimensions
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

    **Arguments:** `waveform`: a function of time, `Harmonic(amplitude, omega)` or any callable
    Module; in the plane it returns a vector. `site`: index (a tuple on a grid), negative from the
    end. `field`: as in `OnSite`. `breaks`: times at which f jumps, as in `Modulated`; also the
    start and end of a short pulse and some times in between, or a run may step over it. **Raises**
    ValueError where `waveform` cannot be called.

    A run samples 8 to 2048 points of each step for missed pulses, except under a transformation;
    shorter pulses are not found. With a missed pulse its `outcome` says so, and the errors of its
    records are infinite.

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
        if not callable(waveform):
            refuse(
                "waveform", "a function of the time, such as gx.Harmonic(0.5, 2.0)", repr(waveform)
            )
        self.waveform = as_module(waveform)
        self.site = tuple(site) if np.ndim(site) else (site,)
        self.field = field
        self.breaks = checked_breaks(breaks)

    def force(self, t, u, v, mass):
        x = get(u, self.field)
        return put(jnp.zeros_like(x).at[self.site].set(self.waveform(t)), self.field)

    def check(self, name, lattice):
        sites = lattice.sites
        sites = sites.get(self.field, ()) if isinstance(sites, dict) else sites
        if not is_site(self.site, sites):
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
        return Excitation(jnp.max(jnp.abs(jax.vmap(self.waveform)(ts))))


class Wall(Bond):
    """A wall at one end of a chain: rigid, elastic, driven or yielding.

    Left: e = w(t) - u_0; right: e = u_{N-1} - w(t). The contact force law.force(e) pushes the end
    site away from the wall. Use it with a `Shift` whose boundary is `"free"` at that end.

    **Arguments:** `law`: the contact with the wall (a sphere on a plane of another material:
    `Hertz(materials.hertz_coefficient(...), F0)`). `side`: `"left"` or `"right"`. `motion`: the
    wall's displacement w(t), a function or Module, or `None`. `support`: stiffness of a linear
    spring behind the wall [N/m], or `None`. `field`: as in `OnSite`. `breaks`: times at which the
    motion or its speed jumps, as in `Modulated`.
    **Raises** ValueError for another side, a motion that cannot be called, support <= 0.

    **Example:**

    >>> wall = gx.Wall(gx.Hertz(), "right")
    >>> chain = gx.Lattice(1.0, (gx.Bond(gx.Shift(1, "free"), gx.Hertz()), wall), sites=3)
    >>> v, a = gx.vector_field(0.0, gx.State(jnp.array([0.0, 0.0, 4.0]), jnp.zeros(3)), chain)
    >>> float(a[-1])
    -8.0
    """

    dimensions = {"strain_map": PART, "law": PART, "motion": Signal((0, 1, 0)), "breaks": PART}
    _shown = {name: name for name in ("law", "motion", "breaks", "side", "field")}
    motion: Callable | None
    breaks: Breaks | None

    def __init__(
        self,
        law: Law,
        side: str = "right",
        motion: Waveform | None = None,
        support: Parameter | None = None,
        field: str | None = None,
        breaks: Parameter | Breaks | None = None,
    ):
        end = End(one_of("side", side, ("left", "right")), field)
        super().__init__(end, law if support is None else Yielding(law, support))
        self.motion = None if motion is None else as_module(motion)
        self.breaks = checked_breaks(breaks)

    @property
    def side(self):
        """The end of the chain, "left" or "right"."""
        return self.strain_map.side

    @property
    def field(self):
        """Name of the field, or `None`."""
        return self.strain_map.field

    def check(self, name, lattice):
        if lattice.axes != 1 or lattice.dimension is not None:
            refuse(
                name,
                "a chain with scalar displacements",
                f"a lattice of shape {lattice.shape}",
                "Hold ends by bonds.",
            )

    def compression(self, t, u):
        e = self.strain_map.strain(u)
        if self.motion is None:
            return e
        return self.motion(t) + e if self.side == "left" else e - self.motion(t)

    def force(self, t, u, v, mass):
        force = self.law.force(self.compression(t, u))
        dtype = jax.tree.leaves(u)[0].dtype
        return jax.tree.map(jnp.negative, self.strain_map.pull(u, force.astype(dtype)))

    def energy(self, t, u):
        return self.law.energy(self.compression(t, u))

    def compressions(self, t, u):
        return tuple(c._replace(place="wall") for c in super().compressions(t, u))

    def linearised(self, lattice, t, u, v):
        springs = spring(self.law, self.compression(t, u))
        return eqx.tree_at(lambda x: x.law, still(self), springs)

    def excitation(self, lattice, ts):
        if self.motion is None:
            return Excitation()
        w, speed = jax.vmap(lambda t: jax.jvp(self.motion, (t,), (jnp.ones_like(t),)))(ts)
        return Excitation(displacement=jnp.max(jnp.abs(w)), speed=jnp.max(jnp.abs(speed)))


def still(term: Term) -> Term:
    """Return the term, a moving wall at rest."""
    if not isinstance(within(term), Wall) or within(term).motion is None:
        return term
    moving = lambda x: (within(x).motion, within(x).breaks)
    return eqx.tree_at(moving, term, (None, None), is_leaf=lambda x: x is None)


def with_still_walls(lattice: Any) -> Any:
    """Return the lattice with all moving walls at rest."""
    return eqx.tree_at(lambda x: x.terms, lattice, tuple(map(still, lattice.terms)))
