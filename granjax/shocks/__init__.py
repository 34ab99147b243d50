"""Dispersive shocks: the scenes that make them, what is measured of them, and what is kept along them."""

from .balances import Balances, balances
from .history import SpaceTime, space_time
from .measure import Shock, measure
from .riemann import Riemann
from .scenes import impacts, piston, step, velocity_shock

__all__ = [
    "Balances", "Riemann", "Shock", "SpaceTime", "balances", "impacts", "measure", "piston", "space_time", "step",
    "velocity_shock",
]
