"""Damped, driven chains in the time domain: attractors, response curves, Lyapunov exponents."""

from .orbits import Bifurcation
from .orbits.attractors import Attractor, settle
from .orbits.driven_chain import driven_chain
from .orbits.lyapunov import Lyapunov, lyapunov
from .orbits.response import Jump, ResponseCurve, Way, response

__all__ = [
    "Attractor",
    "Bifurcation",
    "Jump",
    "Lyapunov",
    "ResponseCurve",
    "Way",
    "driven_chain",
    "lyapunov",
    "settle",
    "response",
]
