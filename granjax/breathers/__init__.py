"""Breathers: time-periodic, localised orbits of conservative lattices, their families and their stability."""

from . import guesses
from .bifurcations import Bifurcation, bifurcations
from .branch import Branch, Breather
from .envelope import bright_guess, dark_guess
from .family import family
from .resonances import bands_of, resonant_harmonic
from .single import breather

__all__ = [
    "Bifurcation", "Branch", "Breather", "bands_of", "bifurcations", "breather", "bright_guess", "dark_guess", "family",
    "guesses", "resonant_harmonic",
]
