"""Waves that travel along a lattice without changing their shape."""

from .cells import CellWave, Resonator, cell_wave, tail_free, tail_free_stiffness
from .closed_forms import ClosedForms, closed_forms
from .family import WaveFamily, family
from .long_wave import LongWave, SpectralStrain, long_wave
from .periodic import PeriodicWave, periodic_wave
from .solitary import solitary_wave
from .stability import ring, stability, wave_orbit
from .wave import Wave

__all__ = [
    "CellWave", "ClosedForms", "LongWave", "PeriodicWave", "Resonator", "SpectralStrain", "Wave", "WaveFamily",
    "cell_wave", "closed_forms", "family", "long_wave", "periodic_wave", "ring", "solitary_wave", "stability",
    "tail_free", "tail_free_stiffness", "wave_orbit",
]
