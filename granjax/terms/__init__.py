"""Terms of the equation of motion: m a = sum over terms of force(t, u, v, m)."""

from .base import Compression, Excitation, Remembering, Term
from .bonds import Bond, Grip, Modulated
from .dissipation import (
    BrilliantovContact,
    CaputoDamping,
    Damping,
    Dashpot,
    Drag,
    Langevin,
    PlasticContact,
    ViscousContact,
)
from .long_range import LongRange
from .reach import Dependence, Reach
from .sites import Drive, OnSite, Wall
from .waveforms import Breaks, Function, Harmonic, Square
