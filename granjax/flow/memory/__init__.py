"""Runs of lattices whose forces read the past."""

from .caputo import CaputoRun, caputo
from .dispatch import refuse_with_memory, with_memory
from .internal import recalled
from .run import RunWithMemory

__all__ = ["CaputoRun", "RunWithMemory", "caputo", "refuse_with_memory", "with_memory"]
