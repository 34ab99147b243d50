"""Time-periodic orbits as roots: shooting residuals."""

from .closed import FullPeriod
from .reversible import HalfPeriod
from .symmetry import shifts

__all__ = ["FullPeriod", "HalfPeriod", "shifts"]
