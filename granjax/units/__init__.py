"""Units: sizes of those of a scene, and those of SI by their names."""

from .names import SCALED, SI
from .sizes import PART, Dimensional, InUnits, Signal, Units

__all__ = ["PART", "SCALED", "SI", "Dimensional", "InUnits", "Signal", "Units"]
