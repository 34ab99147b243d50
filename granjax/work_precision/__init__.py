"""Work and precision: the error of many methods against the time they take, on any scene.

`work_precision` does it for a lattice and solvers; `measure` for any `Ladder`, which is a name, a list of steps or
tolerances and a function that computes the final state with one of them.
"""

from .advice import Advice
from .ladder import Ladder, distance
from .measuring import machine, measure
from .scene import Reference, work_precision
from .table import WorkPrecision

__all__ = [
    "Advice",
    "Ladder",
    "Reference",
    "WorkPrecision",
    "distance",
    "machine",
    "measure",
    "work_precision",
]
