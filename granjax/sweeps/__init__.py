"""Sweeps: a function of parameters over a grid, a list or a random design; in batches, kept, resumed, on many machines."""

from .chunk import Chunk

__all__ = ["Chunk"]
