"""Breathers: time-periodic, localised orbits of conservative lattices, their families and their stability."""

from . import seeds
from .bifurcations import Bifurcation, bifurcations
from .branch import Branch, Breather
from .envelope import bright_seed, dark_seed
from .family import family
from .resonances import bands_of, resonant_harmonic
from .single import breather

__all__ = [
    "Bifurcation", "Branch", "Breather", "bands_of", "bifurcations", "breather", "bright_seed", "dark_seed", "family",
    "resonant_harmonic", "seeds",
]
