"""Runs of lattices whose forces read the past."""

from .dispatch import with_memory
from .run import RunWithMemory

__all__ = ["RunWithMemory", "with_memory"]
