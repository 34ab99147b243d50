"""Units: the sizes of scaled units, and SI units by name."""

from .names import SCALED, SI
from .sizes import PART, Dimensional, InUnits, Signal, Units

# J/K, exact since 2019
BOLTZMANN = 1.380649e-23

__all__ = ["BOLTZMANN", "PART", "SCALED", "SI", "Dimensional", "InUnits", "Signal", "Units"]
