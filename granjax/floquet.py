"""Floquet theory: the stability of periodic orbits, of lattices and of any other flow."""

from .orbits.floquet import Floquet, floquet, multipliers
from .orbits.spectrum import spectrum

__all__ = [
    "Floquet",
    "floquet",
    "multipliers",
    "spectrum",
]
