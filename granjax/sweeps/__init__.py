"""Sweeps: a function of parameters over a grid, a list or a random design; kept, resumed, on many machines."""

from .points import Points, paired, random
from .sweep import sweep

__all__ = ["Points", "paired", "random", "sweep"]
