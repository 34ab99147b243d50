"""Dispersive shocks: the scenes that make them, and what is kept along them."""

from .riemann import Riemann
from .scenes import piston, step, velocity_shock

__all__ = ["Riemann", "piston", "step", "velocity_shock"]
