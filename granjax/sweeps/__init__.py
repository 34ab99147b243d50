"""Sweeps of a function over a grid or a list of parameters, stored, resumed, in parallel."""

from .points import Points, paired
from .sweep import sweep

__all__ = ["Points", "paired", "sweep"]
