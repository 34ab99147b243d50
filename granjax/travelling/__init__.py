"""Waves that travel along a lattice without changing their shape."""

from .solitary import solitary_wave
from .wave import Wave

__all__ = ["Wave", "solitary_wave"]
