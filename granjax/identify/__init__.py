"""Identification of a lattice from data.

`law` finds the force law of contacts, of a formula or of free shape, by `granjax.fit`. Without a fit of trajectories,
`regression` finds which terms act, and how strongly, from motion seen at every site; `library` offers it granjax's own
terms as candidates. `planar_ode` fits y'' = f(y) to a travelling wave or the interior of a shock.
"""

from .families import Series
from .law import ForceLaw, law
from .planar import Equilibrium, PlanarODE, planar_ode
from .planar_orbits import PlanarOrbit
from .regression import Coefficient, Regression, library, regression

__all__ = [
    "Coefficient",
    "Equilibrium",
    "ForceLaw",
    "PlanarODE",
    "PlanarOrbit",
    "Regression",
    "Series",
    "law",
    "library",
    "planar_ode",
    "regression",
]
