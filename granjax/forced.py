"""Periodic orbits of damped, driven lattices by Newton's method, stable or not, and their branches."""

from .orbits import Bifurcation, Branch, Orbit
from .orbits.branch import forced_branch
from .orbits.orbit import OrbitRun, forced_orbit

__all__ = ["Bifurcation", "Branch", "Orbit", "OrbitRun", "forced_branch", "forced_orbit"]
