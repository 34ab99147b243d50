"""Damped, driven chains in the time domain: attractors, response curves, Lyapunov exponents."""

from .chain import driven_chain
from .lyapunov import Lyapunov, lyapunov
from .settle import Attractor, settle
from .sweep import Bifurcation, Jump, Sweep, Way, sweep

__all__ = [
    "Attractor", "Bifurcation", "Jump", "Lyapunov", "Sweep", "Way", "driven_chain", "lyapunov", "settle", "sweep",
]
