"""Dispersive shocks: the scenes that make them, what is measured of them, and what is kept along them.

And the stationary fronts of chains with dashpots.
"""

from .balances import Balances, balances
from .front import DissipativeFront
from .fronts import dissipative_front
from .history import SpaceTime, space_time
from .measure import measure
from .riemann import Riemann
from .scenes import impacts, piston, step, velocity_shock
from .shock import Shock

__all__ = [
    "Balances",
    "DissipativeFront",
    "Riemann",
    "Shock",
    "SpaceTime",
    "balances",
    "dissipative_front",
    "impacts",
    "measure",
    "piston",
    "space_time",
    "step",
    "velocity_shock",
]
