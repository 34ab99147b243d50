"""Dispersive shocks: the scenes that make them, and what is kept along them."""

from .balances import Balances, balances
from .riemann import Riemann
from .scenes import impacts, piston, step, velocity_shock

__all__ = ["Balances", "Riemann", "balances", "impacts", "piston", "step", "velocity_shock"]
