"""Waves of chains whose cell holds several sites or a resonator."""

from .families import Nanoptera, TailFree, nanoptera, tail_free_curve
from .public import CellWave, alone_with_resonators, cell_wave, tail_free
from .resonator import Resonator, tail_free_stiffness
