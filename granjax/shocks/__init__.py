"""Dispersive shocks: the scenes that make them, and what is kept along them."""

from .balances import Balances, balances
from .history import SpaceTime, space_time
from .riemann import Riemann
from .scenes import impacts, piston, step, velocity_shock

__all__ = [
    "Balances", "Riemann", "SpaceTime", "balances", "impacts", "piston", "space_time", "step", "velocity_shock",
]
