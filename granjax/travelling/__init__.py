"""Waves that travel along a lattice without changing their shape."""

from .cells import CellWave, Resonator, cell_wave, tail_free, tail_free_stiffness
from .solitary import solitary_wave
from .wave import Wave

__all__ = ["CellWave", "Resonator", "Wave", "cell_wave", "solitary_wave", "tail_free", "tail_free_stiffness"]
