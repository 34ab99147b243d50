"""`DissipativeFront`: a stationary front as a result."""

from typing import ClassVar

import equinox as eqx
import numpy as np

from ..lattice import State
from ..laws import Law
from ..profiles.front import FrontShape
from ..results import Held, Result
from ..types import Count, Number, Numbers, Parameter, Scalar


class DissipativeFront(Result):
    r"""A front that runs without changing its shape: strain y(n - s t) of contact n, from `behind` to `ahead`.

    m s^2 (y - ahead) = tent * (F(y) - F(ahead) - eta s y'), tent(x) = [1 - |x|]_+; the beads ahead are at rest. At xi =
    0 the strain is half way between both states, for the first time as the front comes.

    **Fields:**

    - `speed`: s, contacts per time [1/s]; m s^2 = [F]/[y], whatever the dashpot. `behind`, `ahead`: strains [m];
      `piston`: velocity of the beads behind, s [y] [m/s].
    - `dashpot`: eta; `critical`: the one above which the strain behind comes to rest without oscillating [N s/m].
      `kind`: "oscillatory" or "monotone", by that.
    - `decay_behind`, `wavenumber_behind`: lambda and k of the slowest part behind, exp(lambda xi) cos(k xi), xi < 0;
      `decay_ahead`: of exp(-mu xi) ahead [1].
    - `overshoot`: how far the strain goes beyond `behind` [m]. `power`: what the dashpots take [W].
    - `residual`: what the equation leaves, over the jump; `error`: estimated distance of the strain from the truth, by
      two resolutions [m].
    - `xi`, `strains`, `velocities`: a table, for pictures and files; `strain(xi)` gives any place.
    - `law`, `mass`: of the chain.

    Differentiable once in the parameters of the law, the mass, the strains (or the piston) and the dashpot, by the
    implicit function theorem (`jax.grad`, `jax.jvp`, `jax.jacfwd`); `jax.jit` and `jax.vmap` around it are refused.

    **Example:**

    >>> front = gx.shocks.dissipative_front(gx.Hertz(), 1.0, dashpot=0.3)
    >>> round(float(front.critical), 6), front.kind
    (0.394869, 'oscillatory')
    """

    held: ClassVar[dict[str, Held]] = {
        "speed": Held("", "1/s"),
        "behind": Held("", "m"),
        "ahead": Held("", "m"),
        "piston": Held("", "m/s"),
        "dashpot": Held("", "N s/m"),
        "critical": Held("", "N s/m"),
        "decay_behind": Held("", "1"),
        "wavenumber_behind": Held("", "1"),
        "decay_ahead": Held("", "1"),
        "overshoot": Held("", "m"),
        "power": Held("", "W"),
        "residual": Held("", "1"),
        "error": Held("", "m"),
        "mass": Held("", "kg"),
        "xi": Held("xi", "1"),
        "strains": Held("xi", "m"),
        "velocities": Held("xi", "m/s"),
    }
    speed: Number
    behind: Number
    ahead: Number
    piston: Number
    dashpot: Number
    critical: Number
    kind: str = eqx.field(static=True)
    decay_behind: Number
    wavenumber_behind: Number
    decay_ahead: Number
    overshoot: Number
    power: Number
    residual: Number
    error: Number
    law: Law
    mass: Number
    xi: Numbers
    strains: Numbers
    velocities: Numbers
    outcome: str
    _shape: FrontShape = eqx.field(kw_only=True, repr=False)

    def strain(self, xi: Parameter) -> Numbers:
        """Compression of the contacts at places xi = n - s t, of any shape [m]."""
        return self._shape.at("strain", xi)

    def velocity(self, xi: Parameter) -> Numbers:
        """Velocity of the beads at places xi [m/s]: zero ahead, `piston` behind."""
        return self._shape.at("velocity", xi)

    def displacement(self, xi: Parameter) -> Numbers:
        """Displacement of the beads at places xi from where they were ahead of the front [m].

        It falls by y - ahead from one bead to the next; bead n ahead is at -ahead n.
        """
        return self._shape.at("displacement", xi)

    def state(self, sites: Count, centre: Scalar | None = None) -> State:
        """Displacements and velocities (sites,) of a chain with the front at contact `centre`, a real number.

        `None` is the middle, (sites - 2)/2. What holds the far states at the ends is the chain's: forces F(behind) on
        the first bead and -F(ahead) on the last one of free ends, say, or ends too far away to be felt.
        """
        middle = (sites - 2) / 2 if centre is None else centre
        xi = np.arange(sites) - middle
        return State(self.displacement(xi) - self.ahead * xi, self.velocity(xi))
