"""Forces between sites: bonds, and bonds whose stiffness changes in time."""

from collections.abc import Callable
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp

from ..checks import refuse
from ..laws import Law, Scaled, checked_law
from ..strains import StrainMap
from .base import Term
from .sites import OnSite
from .waveforms import checked_waveform


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
        self.term, self.modulation = term, checked_waveform("modulation", modulation)

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
