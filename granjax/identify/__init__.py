"""Identification of a lattice from data.

`law` finds the force law of contacts, of a formula or of free shape, by `granjax.fit`. Without a fit of trajectories,
`regression` finds which terms act, and how strongly, from motion seen at every site; `library` offers it granjax's own
terms as candidates.
"""

from .families import Series
from .law import ForceLaw, law
from .regression import Coefficient, Regression, library, regression

__all__ = [
    "Coefficient",
    "ForceLaw",
    "Regression",
    "Series",
    "law",
    "library",
    "regression",
]
