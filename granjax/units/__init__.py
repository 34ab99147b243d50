"""Units: sizes of those of a scene, and those of SI by their names."""

from .names import SCALED, SI
from .sizes import PART, Dimensional, InUnits, Signal, Units

# J/K, exact since 2019
BOLTZMANN = 1.380649e-23

__all__ = ["BOLTZMANN", "PART", "SCALED", "SI", "Dimensional", "InUnits", "Signal", "Units"]
