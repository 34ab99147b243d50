"""Flow: integrating a lattice in time."""

from .record import Arrival, Integral, Lowest, Peak, Record
from .run import Run
from .simulate import simulate
from .stepping import Flow
from .stiffness import frequency_bound, linear_frequency

__all__ = [
    "Arrival", "Flow", "Integral", "Lowest", "Peak", "Record", "Run", "frequency_bound", "linear_frequency", "simulate",
]
