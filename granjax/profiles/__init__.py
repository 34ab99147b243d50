"""Shapes of travelling waves, from a law and a mass alone: what `gx.travelling` and `gx.states` stand on."""

from .medium import Medium, medium_of
from .shape import Shape
from .solving import Solved, wave_of

__all__ = ["Medium", "Shape", "Solved", "medium_of", "wave_of"]
