"""Initial states: each function returns a `State(u, v)` in the shape of the lattice, with lanes.

Displacements are measured from static equilibrium: a precompressed chain at rest has u = 0.
"""

from .bloch import bloch_packet
from .gibbs import gibbs
from .modes import normal_mode, sine_mode
from .simple import impact, random, rest, strain_step, thermal, velocity_step
from .solitons import kdv_soliton, toda_soliton
from .stored import stored
from .waves import solitary_wave, wave_packet
