"""Integration of a lattice in time."""

from .caputo import CaputoRun, caputo
from .derivative import Derivative, derivative
from .memory import RunWithMemory
from .record import Arrival, Integral, Lowest, Peak, PeakTime, Record
from .reversible import Reversible, return_error
from .run import Run
from .simulate import simulate
from .stepping import Flow
from .steps import frequency_bound, linear_frequency

__all__ = [
    "Arrival",
    "CaputoRun",
    "Derivative",
    "Flow",
    "Integral",
    "Lowest",
    "Peak",
    "PeakTime",
    "Record",
    "Reversible",
    "Run",
    "RunWithMemory",
    "caputo",
    "derivative",
    "frequency_bound",
    "linear_frequency",
    "return_error",
    "simulate",
]
