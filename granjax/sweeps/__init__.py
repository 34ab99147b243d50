"""Sweeps: a function of parameters over a grid or a list; kept, resumed, on many machines."""

from .points import Points, paired
from .sweep import sweep

__all__ = ["Points", "paired", "sweep"]
