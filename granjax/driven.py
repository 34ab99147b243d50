"""Damped, driven chains in the time domain: attractors, response curves."""

from .orbits import Bifurcation
from .orbits.attractors import Attractor, Jump, ResponseCurve, Way, driven_chain, response, settle

__all__ = [
    "Attractor",
    "Bifurcation",
    "Jump",
    "ResponseCurve",
    "Way",
    "driven_chain",
    "settle",
    "response",
]
