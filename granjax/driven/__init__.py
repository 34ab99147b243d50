"""Damped, driven chains in the time domain: attractors, response curves, Lyapunov exponents, experiments from rest."""

from .bright import BrightBreather, bright_by_instability
from .chain import driven_chain
from .dark import DarkBreather, dark_by_interference, steel_chain
from .lyapunov import Lyapunov, lyapunov
from .rectify import Rectifier, rectifier
from .settle import Attractor, settle
from .sweep import Bifurcation, Jump, Sweep, Way, sweep

__all__ = [
    "Attractor", "Bifurcation", "BrightBreather", "DarkBreather", "Jump", "Lyapunov", "Rectifier", "Sweep", "Way",
    "bright_by_instability", "dark_by_interference", "driven_chain", "lyapunov", "rectifier", "settle", "steel_chain",
    "sweep",
]
