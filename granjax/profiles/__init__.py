"""Shapes of travelling waves from a law and a mass, for `gx.travelling` and `gx.states`."""

from .medium import Medium, medium_of
from .profile import Profile, places, tabled
from .shape import Shape, TentShape
from .solving import Solved, assembled, one_given, searched, wave_of
