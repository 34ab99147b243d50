"""Floquet theory: the stability of periodic orbits, of lattices and of any other flow."""

from .compute import floquet, multipliers
from .leading import leading
from .record import Floquet, decide
from .spectrum import product_multipliers, reversible_multipliers, spectrum
from .structure import structure

__all__ = [
    "Floquet", "decide", "floquet", "leading", "multipliers", "product_multipliers", "reversible_multipliers",
    "spectrum", "structure",
]
