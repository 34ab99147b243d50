"""Time-periodic orbits as roots: shooting residuals, symmetries, the steps of a period."""

from .problems import Mirror, Shooting, Sign, Symmetry, Translation, checked_symmetry, free_moves
from .steps import default_steps, flow_over, history
from .symmetry import shifts

__all__ = [
    "Mirror", "Shooting", "Sign", "Symmetry", "Translation", "checked_symmetry", "default_steps", "flow_over",
    "free_moves", "history", "shifts",
]
