r"""Compactons: solitary waves of continuum equations that are exactly zero outside an interval.

Two long-wave equations of a chain with the force F = A y^p, A = `stiffness`, m = `mass`, have
compactons for every p > 1. With the speed c in sites per unit time and the strain Y of n - c t,
compression positive,

    Y = (m c^2/A)^{1/(p - 1)} a cos^{2/(p - 1)}(b x),   |b x| < pi/2,   else 0,

where a = ((p + 1)/2)^{1/(p - 1)}, b = (6 (p - 1)^2/(p (p + 1)))^{1/2} for the displacements
(Nesterenko), and a = (2 p/(p + 1))^{1/(p - 1)}, b = 3^{1/2} (p - 1)/p for the strains (Ahnert and
Pikovsky). The solitary wave of the chain differs from both: its tails fall doubly exponentially.
The equations are in `long_wave`.

Source: V. F. Nesterenko, Dynamics of Heterogeneous Materials (Springer, 2001); K. Ahnert, A.
Pikovsky, Phys. Rev. E 79, 026209 (2009); the prefactors a are 25/16 and 36/25 for p = 3/2.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..base.checks import parameter, positive, within
from ..base.printing import told
from ..base.types import Parameter


class Compacton(NamedTuple):
    """A compacton at places x = n - c t.

    - `strain`: Y(x) of bond n, between the sites n and n + 1.
    - `velocity`: c Y(x - 1/2), that of the continuum at site n, half a site behind the bond's
      middle.
    - `half_width`: half the interval outside which the compacton is zero [sites].

    **Example:**

    >>> wave = gx.theory.compacton.nesterenko(0.0, speed=2.0)
    >>> round(float(wave.strain), 6), round(float(wave.half_width), 4)
    (25.0, 2.4836)
    """

    strain: jax.Array
    velocity: jax.Array
    half_width: jax.Array
    __repr__ = told


def nesterenko(
    x: Parameter,
    p: Parameter = 1.5,
    *,
    speed: Parameter = 1.0,
    stiffness: Parameter = 1.0,
    mass: Parameter = 1.0,
) -> Compacton:
    """Return the compacton of the long-wave equation of the displacements.

    For Hertz it is (25/16) c^4 cos^4((2/5)^{1/2} x).

    **Arguments:** `x` [sites]; `p` > 1; `speed`, `stiffness`, `mass` > 0. **Raises** ValueError for
    others.

    **Example:**

    >>> wave = gx.theory.compacton.nesterenko([0.0, 3.0])
    >>> print(wave.strain.round(6))  # 25/16 at its crest, nothing outside of it
    [1.5625 0.    ]
    """
    top = lambda p: (p + 1) / 2
    rate = lambda p: jnp.sqrt(6 / (p * (p + 1))) * (p - 1)
    return _wave(jnp.cos, np.pi / 2, x, p, speed, stiffness, mass, top, rate)


def ahnert_pikovsky(
    x: Parameter,
    p: Parameter = 1.5,
    *,
    speed: Parameter = 1.0,
    stiffness: Parameter = 1.0,
    mass: Parameter = 1.0,
) -> Compacton:
    """Return the compacton of the long-wave equation of the strains.

    For Hertz it is (36/25) c^4 cos^4(x/3^{1/2}). **Arguments**, **Raises**: as `nesterenko`.

    **Example:**

    >>> wave = gx.theory.compacton.ahnert_pikovsky([0.0, 3.0])
    >>> print(wave.strain.round(6))  # 36/25 at its crest, nothing outside of it
    [1.44 0.  ]
    """
    top = lambda p: 2 * p / (p + 1)
    rate = lambda p: jnp.sqrt(3.0) * (p - 1) / p
    return _wave(jnp.cos, np.pi / 2, x, p, speed, stiffness, mass, top, rate)


# the wave (top m c^2/A)^{1/(p - 1)} shape(rate x)^{2/(p - 1)} for |rate x| < reach, else 0, with top
# and rate as functions of p
def _wave(shape, reach, x, p, speed, stiffness, mass, top, rate):
    remedy = "A force that is linear or softer has no compacton."
    p = within("p", p, 1, np.inf, open_low=True, remedy=remedy)
    speed = positive("speed", speed)
    ratio = positive("mass", mass) / positive("stiffness", stiffness)
    return Compacton(*_shaped(shape, reach, parameter("x", x), p, speed, ratio, top(p), rate(p)))


@partial(jax.jit, static_argnums=(0, 1))
def _shaped(shape, reach, x, p, c, ratio, top, b):
    height = (top * ratio * c**2) ** (1 / (p - 1))

    def profile(x):
        inside = jnp.abs(b * x) < reach
        return jnp.where(
            inside, height * shape(jnp.where(inside, b * x, 0.0)) ** (2 / (p - 1)), 0.0
        )

    # the derivatives of an infinite quotient would be NaN
    half_width = reach / b if reach < np.inf else jnp.full_like(x * b, reach)
    return profile(x), c * profile(x - 0.5), half_width
