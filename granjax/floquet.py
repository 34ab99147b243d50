"""Floquet theory: the stability of periodic orbits, of lattices and of any other flow."""

from .orbits.floquet import Floquet, decide, floquet, multipliers, structure
from .orbits.spectrum import product_multipliers, reversible_multipliers, spectrum

__all__ = [
    "Floquet",
    "decide",
    "floquet",
    "multipliers",
    "product_multipliers",
    "reversible_multipliers",
    "spectrum",
    "structure",
]
