"""Work and precision: the error of many methods against the time they take, on any scene.

`work_precision` does it for a lattice and solvers; `measure` for any `Ladder`, which is a name, a list of steps or
tolerances and a function that computes the final state with one of them.
"""

from .advice import Advice
from .errors import distance
from .ladder import Ladder
from .machine import machine
from .measuring import measure
from .reference import Reference
from .scene import work_precision
from .table import WorkPrecision

__all__ = ["Advice", "Ladder", "Reference", "WorkPrecision", "distance", "machine", "measure", "work_precision"]
