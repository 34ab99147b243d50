"""Runs of lattices whose forces read the past."""

from .caputo import CaputoRun, caputo
from .dispatch import with_memory
from .internal import recalled
from .run import RunWithMemory

__all__ = ["CaputoRun", "RunWithMemory", "caputo", "with_memory"]
