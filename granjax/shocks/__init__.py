"""Dispersive shocks, their initial data and measurement; stationary fronts of damped chains."""

from .fronts import DissipativeFront, dissipative_front
from .history import SpaceTime, space_time
from .measure import measure
from .riemann import Riemann
from .scenes import piston, step, velocity_shock
from .shock import Shock
from .whitham import WhithamShock, whitham

__all__ = [
    "DissipativeFront",
    "Riemann",
    "Shock",
    "SpaceTime",
    "WhithamShock",
    "dissipative_front",
    "measure",
    "piston",
    "space_time",
    "step",
    "velocity_shock",
    "whitham",
]
