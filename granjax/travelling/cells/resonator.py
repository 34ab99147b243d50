"""A mass on a spring in every bead, and the stiffness at which a wave leaves none swinging."""

import equinox as eqx
import jax
import numpy as np

from ...base.checks import positive, whole
from ...base.printing import told
from ...base.types import Count, Number, Parameter, Scalar


class Resonator(eqx.Module):
    """A mass mu [kg] tied to its bead by a linear spring kappa [N/m]: mu w'' = kappa (u - w).

    **Raises** ValueError for a mass or a stiffness that is not positive.
    """

    mass: jax.Array
    stiffness: jax.Array
    __repr__ = told

    def __init__(self, mass: Parameter, stiffness: Parameter):
        self.mass = positive("mass", mass)
        self.stiffness = positive("stiffness", stiffness)

    def swing(self, mass: Number = 1.0) -> Number:
        """Return the frequency [rad/s] of a free bead of mass m swinging against its resonator."""
        return (self.stiffness * (1 / self.mass + 1 / mass)) ** 0.5

    def tail_free(self, speed: Scalar, mass: Scalar = 1.0) -> Number:
        """Return the nearest stiffness [N/m] at which a wave leaves no resonator swinging."""
        first = tail_free_stiffness(speed, self.mass, mass)
        n = max(int((self.stiffness / first) ** 0.5), 1)
        near = first * n**2, first * (n + 1) ** 2
        return min(near, key=lambda stiffness: abs(stiffness - self.stiffness))


def tail_free_stiffness(
    speed: Number, resonator_mass: Number, mass: Number = 1.0, count: Count = 1
) -> Number:
    r"""Return the stiffness of resonators that swing `count` times while a wave moves by one bead.

    kappa = (2 pi n c)^2 mu m/(mu + m) [N/m] at wave speed c. The effects of a bead's two contacts
    on its resonator then cancel for any law: phi = Lambda * F(phi), Lambda(x) = [(1 - |x|) m - mu
    sin(2 pi n |x|)/(2 pi n)]_{|x| < 1}/(m (m + mu) c^2).

    **Returns:** an array of the shape of the arguments. mu = 0.1, m = c = n = 1: 3.5889470549.
    **Raises** ValueError for a speed or a mass that is not positive, and a `count` below 1.
    """
    speed = positive("speed", speed)
    heavy = positive("mass", mass)
    inner = positive("resonator_mass", resonator_mass)
    count = whole("count", count, 1)
    return (2 * np.pi * count * speed) ** 2 * inner * heavy / (inner + heavy)
