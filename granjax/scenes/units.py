"""Units in which a chain in SI has numbers of order one, and the way back."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from ..checks import concrete, positive, refuse
from ..lattice import Lattice, State
from ..laws import Hertz, Linear, Polynomial, PowerLaw, Scaled, Sine, Sum, Toda, Yielding
from ..laws.base import parts_of
from ..strains import Pairs, Shift, Stretch
from ..terms import Bond, Damping, Dashpot, Drag, OnSite, ViscousContact, Wall


class Units(eqx.Module):
    """Sizes of the units in SI: a scaled number times its unit is the SI number, `run.ts * units.time` in seconds.

    **Arguments:** `mass` [kg], `length` [m], `time` [s], above zero. The others follow from them: `velocity`,
    `acceleration`, `force`, `energy`, `omega`. **Raises** ValueError for a unit that is not above zero.
    """

    mass: jax.Array
    length: jax.Array
    time: jax.Array

    def __init__(self, mass=1.0, length=1.0, time=1.0):
        self.mass, self.length, self.time = positive("mass", mass), positive("length", length), positive("time", time)

    @property
    def velocity(self):
        """Unit of velocity [m/s]."""
        return self.length / self.time

    @property
    def acceleration(self):
        """Unit of acceleration [m/s^2]."""
        return self.length / self.time / self.time

    @property
    def force(self):
        """Unit of force [N]."""
        return self.mass * self.acceleration

    @property
    def energy(self):
        """Unit of energy [J]."""
        return self.force * self.length

    @property
    def omega(self):
        """Unit of angular frequency, and of a damping rate [1/s]."""
        return 1 / self.time

    def state_to_si(self, state):
        """A scaled `State` in metres and metres per second."""
        return self._convert(state, self.length, self.velocity)

    def state_from_si(self, state):
        """A `State` in metres and metres per second in these units."""
        return self._convert(state, 1 / self.length, 1 / self.velocity)

    def _convert(self, state, length, velocity):
        u, v = state
        return State(jax.tree.map(lambda x: x * length, u), jax.tree.map(lambda x: x * velocity, v))


class ScaledLattice(NamedTuple):
    """A lattice in scaled numbers, and the units that lead back to SI."""

    lattice: Lattice
    units: Units


# powers of force, length and time in each parameter; `_PART` is a law or strain map with parameters of its own
_PART = None
_DIMENSIONS = {
    Hertz: {"stiffness": (1, -1.5, 0), "precompression": (1, 0, 0)},
    PowerLaw: {"stiffness": lambda law: (1, -law.exponent, 0), "precompression": (1, 0, 0)},
    Linear: {"stiffness": (1, -1, 0)},
    Polynomial: {"K2": (1, -1, 0), "K3": (1, -2, 0), "K4": (1, -3, 0)},
    Toda: {"strength": (1, 0, 0), "rate": (0, -1, 0)},
    Sine: {"stiffness": (1, -1, 0), "wavenumber": (0, -1, 0)},
    Yielding: {"law": _PART, "support": (1, -1, 0)},
    Scaled: {"law": _PART},
    Sum: {"parts": _PART},
    Shift: {},
    Pairs: {},
    Stretch: {"vector": (0, 1, 0)},
    Bond: {"strain_map": _PART, "law": _PART},
    OnSite: {"law": _PART},
    Wall: {"law": _PART},
    Damping: {"rate": (0, 0, -1)},
    Dashpot: {"strain_map": _PART, "coefficient": (1, -1, 1)},
    ViscousContact: {
        "strain_map": _PART, "coefficient": lambda term: (1, -1 - term.exponent, 1), "overlap": (0, 1, 0),
    },
    Drag: {"coefficient": (1, -2, 2)},
}


def _rescale(part, units):
    """A term, law or strain map with its parameters divided by their units."""
    if isinstance(part, tuple):
        return tuple(_rescale(p, units) for p in part)
    if type(part) not in _DIMENSIONS or getattr(part, "motion", None) is not None:
        refuse("lattice", "terms whose parameters have known dimensions", f"a {type(part).__name__}",
               "Scale that one by hand with units.force, units.length, units.time and add it afterwards.")
    for name, powers in _DIMENSIONS[type(part)].items():
        value = getattr(part, name)
        if value is None:
            continue
        if powers is _PART:
            scaled_value = _rescale(value, units)
        else:
            force, length, time = powers(part) if callable(powers) else powers
            scaled_value = value / (units.force**force * units.length**length * units.time**time)
        part = eqx.tree_at(lambda p: getattr(p, name), part, scaled_value)
    return part


def scaled(lattice, velocity=None, *, units=None):
    r"""A lattice in SI with numbers of order one, and the units that lead back.

    Mass unit: the mean mass. Length unit: the overlap at rest d0 = (F0/A)^{1/p} of the mean contact, or where
    `velocity` v is given the overlap that an impact reaches, (m v^2/A)^{1/(p+1)}, so that v becomes 1. Time unit: such
    that A becomes 1; with F0 then F0 = d0 = 1. Lanes share one set of units.

    Float64 does not need this: Hertz in SI (A = 1e10, u = 1e-6, t = 1e-4) loses no digit. It is for absolute
    tolerances and thresholds, for optimisers whose steps expect parameters of one size, for comparison with papers,
    and for float32, where overlaps of 1e-6 leave little room for the tails of a wave.

    **Arguments:** `lattice`, as from `beads`; `velocity` [m/s] > 0, the impact's, needed where there is no
    precompression; `units`: a `Units` of your own, instead.

    **Returns:** `ScaledLattice(lattice, units)`: `chain, units = scaled(beads("steel 316", 9.53e-3, cells=60), 0.5)`;
    back by `units.state_to_si(state)`, `run.ts * units.time`, `forces * units.force`.
    **Raises** ValueError where there is no contact law or no length to scale with, or a term of unknown dimensions.
    """
    if not isinstance(lattice, Lattice):
        refuse("lattice", "a Lattice", repr(lattice))
    if units is None:
        units = _natural_units(lattice, velocity)
    elif not isinstance(units, Units) or velocity is not None:
        refuse("units", "Units(mass, length, time) without a velocity, or a velocity alone", repr(units))
    mass = jax.tree.map(lambda m: m / units.mass, lattice.mass)
    terms = _rescale(lattice.terms, units)
    return ScaledLattice(eqx.tree_at(lambda c: (c.mass, c.terms), lattice, (mass, terms)), units)


def _natural_units(lattice, velocity):
    laws = [part for term in lattice.terms if isinstance(term, (Bond, Wall)) for part in parts_of(term.law)]
    contacts = [law for law in laws if isinstance(law, (Hertz, PowerLaw))]
    if not contacts:
        refuse("lattice", "a Hertz or PowerLaw contact to scale with", "none", "Give units=Units(mass, length, time).")
    law = contacts[0]
    A, p = jnp.mean(law.stiffness), jnp.mean(law.exponent)
    masses = jax.tree.leaves(lattice.mass)
    m = sum(jnp.mean(x) for x in masses) / len(masses)
    if velocity is not None:
        v = positive("velocity", velocity, "It is the speed of the impact in m/s.")
        length = (m * v * v / A) ** (1 / (p + 1))
    else:
        F0 = jnp.mean(jnp.asarray(law.preload))
        value = concrete(F0)
        if value is not None and not value > 0:
            refuse("velocity", "the impact's speed in m/s", "None", "Without precompression the chain has no length.")
        length = (F0 / A) ** (1 / p)
    return Units(m, length, jnp.sqrt(m * length / (A * length**p)))
