"""Identification of a lattice from data.

`law` finds the force law of contacts, of a formula or of free shape, and `compare` says which of several models the
traces speak for; both by `granjax.fit`, as `wall_modulus` does for the wall at the end of a chain. Without a fit of
trajectories, `regression` finds which terms act, and how strongly, from motion seen at every site; `library` offers
it granjax's own terms as candidates. `planar_ode` fits y'' = f(y) to a travelling wave or the interior of a shock.
"""

from .compare import Comparison, compare
from .families import Series
from .law import ForceLaw, law
from .planar import Equilibrium, PlanarODE, planar_ode
from .planar_orbits import PlanarOrbit
from .regression import Coefficient, Regression, library, regression
from .wall import WallModulus, wall_modulus

__all__ = [
    "Coefficient",
    "Comparison",
    "Equilibrium",
    "ForceLaw",
    "PlanarODE",
    "PlanarOrbit",
    "Regression",
    "Series",
    "WallModulus",
    "compare",
    "law",
    "library",
    "planar_ode",
    "regression",
    "wall_modulus",
]
