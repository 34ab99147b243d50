"""Time-periodic orbits as roots: shooting residuals."""

from .closed import FullPeriod
from .reversible import HalfPeriod
from .steps import default_steps, flow_over, history
from .symmetry import shifts

__all__ = ["FullPeriod", "HalfPeriod", "default_steps", "flow_over", "history", "shifts"]
