"""Waves that travel along a lattice without changing their shape."""

from .cells import CellWave, Resonator, cell_wave, tail_free, tail_free_stiffness
from .closed_forms import ClosedForms, closed_forms
from .solitary import solitary_wave
from .stability import ring, stability, wave_orbit
from .wave import Wave

__all__ = [
    "CellWave", "ClosedForms", "Resonator", "Wave", "cell_wave", "closed_forms", "ring", "solitary_wave", "stability",
    "tail_free", "tail_free_stiffness", "wave_orbit",
]
