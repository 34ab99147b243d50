"""Waves that travel along a lattice without changing their shape."""

from .cells import (
    CellWave,
    Nanoptera,
    Resonator,
    TailFree,
    cell_wave,
    nanoptera,
    tail_free,
    tail_free_curve,
    tail_free_stiffness,
)
from .collisions import Collision, collide
from .family import WaveFamily, family
from .modulation import Modulation, modulation
from .periodic import Averages, PeriodicWave, periodic_wave
from .reflection import Reflection, reflect
from .solitary import Wave, solitary_wave
from .stability import WaveStability, ring, stability, wave_orbit

__all__ = [
    "Averages",
    "CellWave",
    "Collision",
    "Modulation",
    "Nanoptera",
    "PeriodicWave",
    "Reflection",
    "Resonator",
    "TailFree",
    "Wave",
    "WaveFamily",
    "WaveStability",
    "cell_wave",
    "collide",
    "family",
    "modulation",
    "nanoptera",
    "periodic_wave",
    "reflect",
    "ring",
    "solitary_wave",
    "stability",
    "tail_free",
    "tail_free_curve",
    "tail_free_stiffness",
    "wave_orbit",
]
