"""Damped, driven chains in the time domain: attractors, response curves, Lyapunov exponents."""

from .orbits import Bifurcation
from .orbits.attractors import (
    Attractor,
    Jump,
    Lyapunov,
    ResponseCurve,
    Way,
    driven_chain,
    lyapunov,
    response,
    settle,
)

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
