"""Waves that travel along a lattice without changing their shape."""

from .cells import CellWave, Resonator, cell_wave, tail_free, tail_free_stiffness
from .closed_forms import ClosedForms, closed_forms
from .solitary import solitary_wave
from .wave import Wave

__all__ = ["CellWave", "ClosedForms", "Resonator", "Wave", "cell_wave", "closed_forms", "solitary_wave", "tail_free",
           "tail_free_stiffness"]
