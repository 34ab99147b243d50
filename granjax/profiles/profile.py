"""`Profile`: a result that gives its wave at any place."""

from typing import Any

import equinox as eqx
import numpy as np

from ..base.checks import traced
from ..base.types import Count, Number, Numbers, Parameter, Scalar
from ..lattice import State
from ..laws import Law
from ..results import Result, array


class Profile(Result):
    """A wave or a front that runs without changing its shape: functions of xi = n - c t."""

    speed: Number = array(
        "The speed c in contacts per time; negative where the wave runs to the left.", "1/s"
    )
    law: Law = array("The law of the contacts.")
    mass: Number = array("The mass of the beads.", "kg")
    residual: Number = array(
        "The residual of the equation, over the size of the wave: its largest strain, the "
        "amplitude of a periodic wave, the jump of a front.",
        "1",
    )
    error: Number = array("The estimated error of the strain.", "m")
    xi: Numbers = array("The places of the table.", "1", "xi")
    strains: Numbers = array("The strains of the table; `strain(xi)` gives any place.", "m", "xi")
    velocities: Numbers = array("The velocities of the table.", "m/s", "xi")
    _shape: Any = eqx.field(kw_only=True, repr=False)

    @property
    def outcome(self) -> str:
        """The accuracy of the wave or the front, and its kind."""
        return "Not known while traced." if traced(self) else self._said()

    def strain(self, xi: Parameter) -> Numbers:
        """Return the compression [m] of the contacts at places xi = n - c t of any shape."""
        return self._shape.at("strain", xi)

    def velocity(self, xi: Parameter) -> Numbers:
        """Return the velocity [m/s] of the beads at places xi of any shape."""
        return self._shape.at("velocity", xi)

    def displacement(self, xi: Parameter) -> Numbers:
        """Return the displacement [m] of the beads at places xi of any shape."""
        return self._shape.at("displacement", xi)

    def state(self, sites: Count, centre: Scalar | None = None) -> State:
        """Return displacements and velocities (sites,) with xi = 0 at contact `centre`.

        `centre`: a real number; `None` is the middle of the chain, (sites - 2)/2.
        """
        xi = places(sites, centre)
        return State(self.displacement(xi), self.velocity(xi))


def places(sites: Count, centre: Scalar | None = None) -> np.ndarray:
    """Return the places xi of a chain's beads, with xi = 0 at contact `centre`, or its middle."""
    return np.arange(sites) - ((sites - 2) / 2 if centre is None else centre)


def tabled(shape: Any, xi: Numbers) -> dict[str, Any]:
    """Return the fields of a profile that follow from its shape: the shape and the table."""
    return dict(
        xi=xi, strains=shape.at("strain", xi), velocities=shape.at("velocity", xi), _shape=shape
    )
