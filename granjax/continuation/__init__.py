"""Branches of solutions of F(x, p) = 0 by pseudo-arclength continuation. It knows no physics."""

from .curve import Curve, Special
from .system import Bordered, tangent_at
from .trace import continuation

__all__ = ["Bordered", "Curve", "Special", "continuation", "tangent_at"]
