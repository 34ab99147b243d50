"""Periodic orbits of damped, driven lattices by Newton's method, stable or not, and their branches."""

from .branch import ForcedBranch, forced_branch
from .events import Bifurcation
from .orbit import Orbit, OrbitRun, forced_orbit, orbit

__all__ = ["Bifurcation", "ForcedBranch", "Orbit", "OrbitRun", "forced_branch", "forced_orbit", "orbit"]
