"""Newton's method, states of rest, and pseudo-arclength continuation of F(x, p) = 0."""

from .arclength import Curve, Point, Problem, Special, System, another, continuation

__all__ = ["Curve", "Point", "Problem", "Special", "System", "another", "continuation"]
