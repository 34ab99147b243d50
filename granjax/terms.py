"""Terms of the equation of motion: m a = sum over terms of force(t, u, v, m).

A term that a scene does not need is not in the tuple, and then costs nothing.
"""

import abc
from collections.abc import Callable
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp

from .checks import non_negative, one_of, parameter, refuse
from .laws import Law, Scaled, Yielding, checked_law
from .strains import StrainMap


class Term(eqx.Module):
    """One contribution to the force on the sites.

    `force(t, u, v, mass)` has the structure of `u`, or is a dict of those fields that the term acts on.
    `energy(t, u)` is an array over the term's bonds or sites, `site_energy(t, u)` the same shared out to sites; both
    are `None` for a term that stores none. `conserves`: it keeps the energy. `reads_velocity`: its force depends on
    `v`. To add a term write `force`, set the flags, and add one line to the tests' list of cases; its stiffness is not
    known to `simulate`, which then asks for a step.
    """

    conserves: ClassVar[bool] = True
    reads_velocity: ClassVar[bool] = False

    @abc.abstractmethod
    def force(self, t, u, v, mass):
        """Force on the sites at time t."""

    def energy(self, t, u):
        """Potential energy, one value per bond or site, from equilibrium."""
        return None

    def preload_force(self, u):
        """Force of the preloads on the sites at rest, or `None`; `u` gives the shapes."""
        return None

    def site_energy(self, t, u):
        """Potential energy with each bond's shared between its ends; half of a wall's bond stays with the wall."""
        return None


class Bond(Term):
    """Bonds of one kind: a strain map and a law. Force on the sites: -(de/du)^T law.force(e).

    **Arguments:** `strain_map`, such as `Shift(1, "fixed")`; `law`, such as `Hertz()`.
    **Raises** ValueError where these are no strain map or no law.
    """

    strain_map: StrainMap
    law: Law

    def __init__(self, strain_map, law):
        if not isinstance(strain_map, StrainMap):
            refuse("strain_map", "a strain map, such as Shift(1, 'fixed')", repr(strain_map))
        self.strain_map, self.law = strain_map, checked_law(law)

    def force(self, t, u, v, mass):
        return self.strain_map.push(u, self.law)

    def energy(self, t, u):
        return self.strain_map.energy(u, self.law)

    def preload_force(self, u):
        e, transpose = jax.vjp(self.strain_map.strain, jax.tree.map(jnp.zeros_like, u))
        return jax.tree.map(jnp.negative, transpose(jnp.broadcast_to(self.law.preload, e.shape).astype(e.dtype))[0])

    def site_energy(self, t, u):
        return self.strain_map.split(self.energy(t, u), u)


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
        return _put(-self.law.force(_get(u, self.field)), self.field)

    def energy(self, t, u):
        return self.law.energy(_get(u, self.field))

    def site_energy(self, t, u):
        return _put(self.energy(t, u), self.field)


class Damping(Term):
    """Linear damping of each site: acceleration -gamma v, force -gamma m v; gamma = 1/tau.

    **Arguments:** `rate`: gamma >= 0 [1/s], scalar or one per site; `field`: as in `OnSite`, `None` for all.
    Splitting solvers take it exactly, in the drift. Typical: tau = 0.2 ... 5 ms for steel beads, gamma = 0.01 ... 0.1
    in scaled units. **Raises** ValueError for gamma < 0.
    """

    conserves: ClassVar[bool] = False
    reads_velocity: ClassVar[bool] = True
    rate: jax.Array
    field: str | None = eqx.field(static=True)

    def __init__(self, rate, field=None):
        self.rate, self.field = non_negative("rate", rate, "A negative rate would feed the lattice."), field

    def force(self, t, u, v, mass):
        if self.field is None:
            return jax.tree.map(lambda v, m: -self.rate * m * v, v, mass)
        return {self.field: -self.rate * mass[self.field] * v[self.field]}


class Dashpot(Term):
    """Dashpots between sites: force -(de/du)^T c de/dt, on the velocity difference of the ends.

    **Arguments:** `strain_map`: which sites are joined; `coefficient`: c >= 0 [N s/m], scalar or one per bond.
    Its force reads the velocities of neighbours, so splitting solvers refuse it: use diffrax's Tsit5 or Dopri8.
    **Raises** ValueError for c < 0.
    """

    conserves: ClassVar[bool] = False
    reads_velocity: ClassVar[bool] = True
    strain_map: StrainMap
    coefficient: jax.Array

    def __init__(self, strain_map, coefficient):
        if not isinstance(strain_map, StrainMap):
            refuse("strain_map", "a strain map, such as Shift(1, 'fixed')", repr(strain_map))
        self.strain_map = strain_map
        self.coefficient = non_negative("coefficient", coefficient)

    def force(self, t, u, v, mass):
        rate, pull = jax.linearize(self.strain_map.strain, u)[1], jax.vjp(self.strain_map.strain, u)[1]
        return jax.tree.map(jnp.negative, pull(self.coefficient * rate(v))[0])


class Function(eqx.Module):
    """A plain Python function of time, held as static: two equal functions compile once, another compiles anew.

    It must not close over values that are swept or differentiated; write those as a Module, like `Harmonic`.
    """

    function: Callable = eqx.field(static=True)

    def __call__(self, t):
        return self.function(t)


class Harmonic(eqx.Module):
    """a cos(omega t + phase): a waveform for `Drive`, `Wall` and `Modulated`, with parameters that can be swept.

    **Arguments:** `amplitude`; `omega`: angular frequency [rad/s]; `phase` [rad]; `mean`: added constant (1 for a
    modulation of stiffness).
    """

    amplitude: jax.Array
    omega: jax.Array
    phase: jax.Array
    mean: jax.Array

    def __init__(self, amplitude, omega, phase=0.0, mean=0.0):
        self.amplitude, self.omega = parameter("amplitude", amplitude), parameter("omega", omega)
        self.phase, self.mean = parameter("phase", phase), parameter("mean", mean)

    def __call__(self, t):
        return self.mean + self.amplitude * jnp.cos(self.omega * t + self.phase)


class Drive(Term):
    """A force on one site: F_site = f(t).

    **Arguments:** `waveform`: a function of time, `Harmonic(amplitude, omega)` or any callable Module; in the plane
    it returns a vector. `site`: index (a tuple on a grid), negative from the end. `field`: as in `OnSite`.
    **Raises** ValueError where `waveform` cannot be called.
    """

    conserves: ClassVar[bool] = False
    waveform: Callable
    site: tuple[int, ...] = eqx.field(static=True)
    field: str | None = eqx.field(static=True)

    def __init__(self, waveform, site=0, field=None):
        self.waveform = _waveform("waveform", waveform)
        self.site = tuple(site) if isinstance(site, (tuple, list)) else (site,)
        self.field = field

    def force(self, t, u, v, mass):
        x = _get(u, self.field)
        return _put(jnp.zeros_like(x).at[self.site].set(self.waveform(t)), self.field)


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
        self.motion = None if motion is None else _waveform("motion", motion)
        self.field = field

    @property
    def conserves(self):
        return self.motion is None

    def compression(self, t, u):
        """Compression of the contact with the wall; one value (and lanes)."""
        x = _get(u, self.field)
        wall = 0.0 if self.motion is None else self.motion(t)
        return wall - x[0] if self.side == "left" else x[-1] - wall

    def force(self, t, u, v, mass):
        return self._push(self.law.force(self.compression(t, u)), u)

    def preload_force(self, u):
        return self._push(self.law.preload, u)

    def _push(self, force, u):
        x = jnp.zeros_like(_get(u, self.field))
        x = x.at[0].set(force) if self.side == "left" else x.at[-1].set(-force)
        return _put(x, self.field)

    def energy(self, t, u):
        return self.law.energy(self.compression(t, u))[None]

    def site_energy(self, t, u):
        x = jnp.zeros_like(_get(u, self.field))
        return _put(x.at[0 if self.side == "left" else -1].set(self.energy(t, u)[0]), self.field)


class Modulated(Term):
    """A bond or on-site term whose stiffness changes in time: F -> g(t) F.

    The factor multiplies the force measured from equilibrium, so that u = 0 stays an equilibrium.

    **Arguments:** `term`: a `Bond` or `OnSite`; `modulation`: g(t), a function or Module such as
    `Harmonic(0.1, omega, mean=1.0)`; it may return an array over the bonds (a travelling modulation).
    **Raises** ValueError for another term, or a modulation that cannot be called.
    """

    conserves: ClassVar[bool] = False
    term: Bond | OnSite
    modulation: Callable

    def __init__(self, term, modulation):
        if not isinstance(term, (Bond, OnSite)):
            refuse("term", "a Bond or an OnSite", repr(term))
        self.term, self.modulation = term, _waveform("modulation", modulation)

    def at(self, t):
        """The term with the stiffness it has at time t."""
        return eqx.tree_at(lambda term: term.law, self.term, Scaled(self.term.law, self.modulation(t)))

    def force(self, t, u, v, mass):
        return self.at(t).force(t, u, v, mass)

    def energy(self, t, u):
        return self.at(t).energy(t, u)

    def preload_force(self, u):
        return self.term.preload_force(u)

    def site_energy(self, t, u):
        return self.at(t).site_energy(t, u)


def _waveform(name, f):
    if not callable(f):
        refuse(name, "a function of time", repr(f), "Give f(t), or Harmonic(amplitude, omega).")
    return f if isinstance(f, eqx.Module) else Function(f)


def _get(u, field):
    return u if field is None else u[field]


def _put(x, field):
    return x if field is None else {field: x}
