"""Terms of the equation of motion: m a = sum over terms of force(t, u, v, m).

A term that a scene does not need is not in the tuple, and then costs nothing.
"""

from .base import Term
from .bonds import Bond, Modulated
from .dissipation import Damping, Dashpot, Drag, ViscousContact
from .sites import Drive, OnSite
from .walls import Wall
from .waveforms import Function, Harmonic

__all__ = [
    "Bond", "Damping", "Dashpot", "Drag", "Drive", "Function", "Harmonic", "Modulated", "OnSite", "Term",
    "ViscousContact", "Wall",
]
