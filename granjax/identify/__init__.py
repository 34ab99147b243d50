"""Identification of a lattice from data, without a fit of trajectories.

`dmd` finds frequencies and decay rates from snapshots of any sensors, without a model. `regression` finds which terms
act, and how strongly, from motion seen at every site; `library` offers it granjax's own terms as candidates.
`physics_informed` finds parameters from a few sensors by a network that obeys the equation of motion. Where the form
of a contact is not known, `granjax.laws.Spline` and `granjax.laws.Network` are laws whose shape is free.
"""

from .dmd import DynamicModes, dmd, hard_threshold, snapshots
from .pinn import Motion, PhysicsInformed, physics_informed
from .regression import Coefficient, Regression, library, regression

__all__ = [
    "Coefficient", "DynamicModes", "Motion", "PhysicsInformed", "Regression", "dmd",
    "hard_threshold", "library", "physics_informed", "regression", "snapshots",
]
