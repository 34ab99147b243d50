"""Sweeps: a function of parameters over a grid, a list or a random design; kept, resumed, on many machines."""

from .chunk import Chunk
from .points import Points, paired, random
from .result import Scene, Sweep
from .sweep import read, sweep
from .table import table

__all__ = ["Chunk", "Points", "Scene", "Sweep", "paired", "random", "read", "sweep", "table"]
