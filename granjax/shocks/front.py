"""`DissipativeFront`: a stationary front as a result."""

import numpy as np

from ..checks import traced
from ..lattice import State
from ..profiles import Profile, places
from ..results import array
from ..types import Count, Number, Scalar


class DissipativeFront(Profile):
    r"""A front that runs without changing its shape: strain y(n - s t) of contact n, from `behind` to `ahead`.

    m s^2 (y - ahead) = tent * (F(y) - F(ahead) - eta s y'), tent(x) = [1 - |x|]_+; the beads ahead are at rest, and
    `displacement` counts from where they were then, -ahead n. At xi = 0 the strain is half way between both states, for
    the first time as the front comes. m s^2 = [F]/[y], whatever the dashpot. Behind, the slowest part is
    exp(lambda xi) cos(k xi), xi < 0; ahead it is exp(-mu xi).

    Differentiable once in the parameters of the law, the mass, the strains (or the piston) and the dashpot, by the
    implicit function theorem (`jax.grad`, `jax.jvp`, `jax.jacfwd`); `jax.jit` and `jax.vmap` around it are refused.
    """

    behind: Number = array("The strain behind.", "m")
    ahead: Number = array("The strain ahead.", "m")
    piston: Number = array("The velocity of the beads behind, s [y].", "m/s")
    dashpot: Number = array("The dashpot eta.", "N s/m")
    critical: Number = array(
        "The dashpot above which the strain behind comes to rest without oscillating.", "N s/m"
    )
    kind: str = array('"oscillatory" or "monotone".', static=True)
    decay_behind: Number = array("lambda.", "1")
    wavenumber_behind: Number = array("k.", "1")
    decay_ahead: Number = array("mu.", "1")
    overshoot: Number = array("How far the strain goes beyond `behind`.", "m")
    power: Number = array("The power that the dashpots take.", "W")

    @property
    def outcome(self) -> str:
        """How well it is known, and how its strain comes to rest behind."""
        if traced((self.error, self.behind, self.ahead, self.dashpot, self.critical)):
            return "Not known while traced."
        # a power of ten: the digits are those of rounding
        power = np.ceil(np.log10(self.error / abs(self.behind - self.ahead)))
        part = self.dashpot / self.critical
        return (
            f"Found to {10.0 ** max(power, -13.0):.0e} of its jump; {self.kind}, with {part:.4g} of the critical "
            "dashpot."
        )

    def state(self, sites: Count, centre: Scalar | None = None) -> State:
        """Displacements and velocities (sites,) of a chain with the front at contact `centre`, a real number.

        `None` is the middle, (sites - 2)/2. What holds the far states at the ends is the chain's: forces F(behind) on
        the first bead and -F(ahead) on the last one of free ends, say, or ends too far away to be felt.
        """
        u, v = super().state(sites, centre)
        return State(u - self.ahead * places(sites, centre), v)
