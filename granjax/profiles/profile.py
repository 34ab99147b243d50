"""`Profile`: a result that knows its wave at any place."""

from typing import Any

import equinox as eqx
import numpy as np

from ..lattice import State
from ..laws import Law
from ..results import Result, array
from ..types import Count, Number, Numbers, Parameter, Scalar


class Profile(Result):
    """A wave or a front that runs without changing its shape: functions of xi = n - c t."""

    speed: Number = array(
        "The speed c in contacts per time; negative where the wave runs to the left.", "1/s"
    )
    law: Law = array("The law of the contacts.")
    mass: Number = array("The mass of the beads.", "kg")
    residual: Number = array(
        "What the equation leaves, over the size of the wave: its largest strain, the amplitude of a periodic wave, "
        "the jump of a front.",
        "1",
    )
    error: Number = array("The estimated distance of the strain from the truth.", "m")
    xi: Numbers = array("The places of the table.", "1", "xi")
    strains: Numbers = array("The strains of the table; `strain(xi)` gives any place.", "m", "xi")
    velocities: Numbers = array("The velocities of the table.", "m/s", "xi")
    _shape: Any = eqx.field(kw_only=True, repr=False)

    def strain(self, xi: Parameter) -> Numbers:
        """Compression of the contacts at places xi = n - c t, of any shape [m]."""
        return self._shape.at("strain", xi)

    def velocity(self, xi: Parameter) -> Numbers:
        """Velocity of the beads at places xi, of any shape [m/s]."""
        return self._shape.at("velocity", xi)

    def displacement(self, xi: Parameter) -> Numbers:
        """Displacement of the beads at places xi, of any shape [m]; it falls by a strain from one bead to the next."""
        return self._shape.at("displacement", xi)

    def state(self, sites: Count, centre: Scalar | None = None) -> State:
        """Displacements and velocities (sites,) of a chain with the place xi = 0 at contact `centre`, a real number.

        `None` is the middle of the chain, (sites - 2)/2.
        """
        xi = places(sites, centre)
        return State(self.displacement(xi), self.velocity(xi))


def places(sites: Count, centre: Scalar | None = None) -> np.ndarray:
    """The places xi of the beads of a chain with xi = 0 at contact `centre`, `None` for its middle."""
    return np.arange(sites) - ((sites - 2) / 2 if centre is None else centre)


def tabled(shape: Any, xi: Numbers) -> dict[str, Any]:
    """The fields of a profile that follow from its shape: that itself and the table at places xi."""
    return dict(
        xi=xi, strains=shape.at("strain", xi), velocities=shape.at("velocity", xi), _shape=shape
    )
