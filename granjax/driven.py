"""Damped, driven chains in the time domain: attractors, response curves, Lyapunov exponents."""

from .orbits import Bifurcation
from .orbits.attractors import Attractor, settle
from .orbits.driven_chain import driven_chain
from .orbits.lyapunov import Lyapunov, lyapunov
from .orbits.sweep import Jump, Sweep, Way, sweep

__all__ = [
    "Attractor",
    "Bifurcation",
    "Jump",
    "Lyapunov",
    "Sweep",
    "Way",
    "driven_chain",
    "lyapunov",
    "settle",
    "sweep",
]
