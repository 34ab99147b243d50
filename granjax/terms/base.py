"""What every term is, and how it finds its field."""

import abc
from typing import ClassVar

import equinox as eqx


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


def get(u, field):
    """A field of the displacements, or all where they have none."""
    return u if field is None else u[field]


def put(x, field):
    """A force on a field, or on all sites."""
    return x if field is None else {field: x}
