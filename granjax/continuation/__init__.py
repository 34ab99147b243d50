"""Branches of solutions of F(x, p) = 0 by pseudo-arclength continuation. It knows no physics."""

from .curve import Curve, Special
from .trace import continuation

__all__ = ["Curve", "Special", "continuation"]
