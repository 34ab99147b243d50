r"""Compactons: solitary waves of continuum equations, exactly zero outside of an interval.

Two long-wave equations of a chain with the force F = A y^p, A = `stiffness`, m = `mass`, have them, for any p > 1; with
the speed c in sites a unit time and the strain Y of n - c t, compression positive,

    Y = (m c^2/A)^{1/(p - 1)} a cos^{2/(p - 1)}(b x),   |b x| < pi/2,   else 0,

with a = ((p + 1)/2)^{1/(p - 1)}, b = (6 (p - 1)^2/(p (p + 1)))^{1/2} from the displacements (Nesterenko), and
a = (2 p/(p + 1))^{1/(p - 1)}, b = 3^{1/2} (p - 1)/p from the strains (Ahnert and Pikovsky). The exact wave of the chain
is neither: its tails fall doubly exponentially. `long_wave` has the equations.

Source: V. F. Nesterenko, Dynamics of Heterogeneous Materials (Springer, 2001); K. Ahnert, A. Pikovsky, Phys. Rev. E 79,
026209 (2009); the prefactors a are 25/16 and 36/25 for p = 3/2. P. Rosenau, J. M. Hyman, Phys. Rev. Lett. 70, 564
(1993).
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..checks import parameter, positive, within
from ..printing import told
from ..types import Numbers, Parameter

__all__ = ["Compacton", "ahnert_pikovsky", "nesterenko", "rosenau_hyman"]

# of the tanh-sinh quadrature: nodes, and how far they reach; steps of Newton's method on what is nearly linear
_REACH = np.linspace(-3.1, 3.1, 50)
NODES = (1 + np.tanh(np.pi / 2 * np.sinh(_REACH))) / 2
WEIGHTS = (
    (_REACH[1] - _REACH[0])
    * np.pi
    / 4
    * np.cosh(_REACH)
    / np.cosh(np.pi / 2 * np.sinh(_REACH)) ** 2
)
NEWTON = 12


class Compacton(NamedTuple):
    """A compacton at places x = n - c t.

    - `strain`: Y(x), of bond n, which lies between the sites n and n + 1.
    - `velocity`: that of the continuum, c Y(x - 1/2), of site n, half a site behind the middle of its bond.
    - `half_width`: half the interval outside of which it is zero [sites].

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
    """The compacton of the long-wave equation of the displacements; Hertz: (25/16) c^4 cos^4((2/5)^{1/2} x).

    **Arguments:** `x` [sites]; `p` > 1; `speed`, `stiffness`, `mass` > 0. **Raises** ValueError for others.

    **Example:**

    >>> wave = gx.theory.compacton.nesterenko([0.0, 3.0])
    >>> print(wave.strain.round(6))  # 25/16 at its crest, nothing outside of it
    [1.5625 0.    ]
    """
    p = _exponent("p", p)
    return _chain(x, p, (p + 1) / 2, jnp.sqrt(6 / (p * (p + 1))) * (p - 1), speed, stiffness, mass)


def ahnert_pikovsky(
    x: Parameter,
    p: Parameter = 1.5,
    *,
    speed: Parameter = 1.0,
    stiffness: Parameter = 1.0,
    mass: Parameter = 1.0,
) -> Compacton:
    """The compacton of the long-wave equation of the strains; Hertz: (36/25) c^4 cos^4(x/3^{1/2}).

    **Arguments**, **Raises**: as `nesterenko`.

    **Example:**

    >>> wave = gx.theory.compacton.ahnert_pikovsky([0.0, 3.0])
    >>> print(wave.strain.round(6))  # 36/25 at its crest, nothing outside of it
    [1.44 0.  ]
    """
    p = _exponent("p", p)
    return _chain(x, p, 2 * p / (p + 1), jnp.sqrt(3.0) * (p - 1) / p, speed, stiffness, mass)


def rosenau_hyman(
    x: Parameter, m: Parameter = 2.0, n: Parameter = 2.0, *, speed: Parameter = 1.0
) -> Numbers:
    r"""The compacton of K(m, n), u_t + (u^m)_x + (u^n)_xxx = 0, at x - c t; m, n > 1.

    Its top is a = (c (m + n)/(n + 1))^{1/(m - 1)}. K(n, n): a cos^{2/(n - 1)}((n - 1) x/(2 n)), K(2, 2) has
    (4 c/3) cos^2(x/4); K(2, 3) is a parabola; in general u = a cos^{2/(m - 1)} phi with x = (n (n + 1)/(2 c))^{1/2}
    a^{(n - 1)/2} (2/(m - 1)) int_0^phi cos^g, g = (n - m)/(m - 1), which is inverted to 1e-13.

    **Arguments:** `x`; `m`, `n` > 1, need not be whole; `speed` c > 0. **Returns:** u, zero outside of an interval.
    **Raises** ValueError for others.

    **Example:**

    >>> print(gx.theory.compacton.rosenau_hyman([0.0, 7.0]).round(6))  # K(2, 2): (4/3) cos^2(x/4)
    [1.333333 0.      ]
    """
    m, n, speed = _exponent("m", m), _exponent("n", n), positive("speed", speed)
    return _of_powers(parameter("x", x), m, n, speed)


@jax.jit
def _of_powers(x, m, n, c):
    x, m, n, c = jnp.broadcast_arrays(x, m, n, c)
    top, g = (c * (m + n) / (n + 1)) ** (1 / (m - 1)), (n - 1) / (m - 1)
    length = jnp.sqrt(n * (n + 1) / (2 * c)) * top ** ((n - 1) / 2) * 2 / (m - 1)
    # from the edge, where int_0^psi sin^{g - 1} = (psi^g/g) (mean of a smooth function)
    whole = jnp.exp(jax.scipy.special.betaln(g / 2, 0.5)) / 2
    left = whole - jnp.abs(x) / length
    inside = left > 0
    target = (jnp.where(inside, left, 1e-3) * g) ** (1 / g)

    def nearer(_, psi):
        reached = psi * _mean(psi, g) ** (1 / g)
        return jnp.clip(
            psi - (reached - target) * (reached / jnp.sin(psi)) ** (g - 1), 0.1 * psi, jnp.pi / 2
        )

    psi = jax.lax.fori_loop(0, NEWTON, nearer, jnp.minimum(target, jnp.pi / 2))
    return jnp.where(inside, top * jnp.sin(psi) ** (2 / (m - 1)), 0.0)


def _mean(psi, g):
    """g int_0^1 q^{g - 1} (sin(psi q)/(psi q))^{g - 1} dq, over y = q^g."""
    y, weights = NODES.reshape(-1, *[1] * psi.ndim), WEIGHTS.reshape(-1, *[1] * psi.ndim)
    return jnp.sum(weights * _sinc(psi * y ** (1 / g)) ** (g - 1), 0)


def _sinc(z):
    """sin z/z, whose derivatives are numbers at any small z."""
    near, square = z < 0.5, z * z
    series = 1.0
    for k in range(7, 0, -1):
        series = 1 - square / (2 * k * (2 * k + 1)) * series
    safe = jnp.where(near, 1.0, z)
    return jnp.where(near, series, jnp.sin(safe) / safe)


def _exponent(name, p):
    return within(
        name,
        p,
        1,
        np.inf,
        open_low=True,
        remedy="A force that is linear or softer has no compacton.",
    )


def _chain(x, p, top, b, speed, stiffness, mass):
    speed, ratio = (
        positive("speed", speed),
        positive("mass", mass) / positive("stiffness", stiffness),
    )
    return Compacton(*_cosines(parameter("x", x), p, top, b, speed, ratio))


@jax.jit
def _cosines(x, p, top, b, c, ratio):
    height = (top * ratio * c**2) ** (1 / (p - 1))

    def profile(x):
        inside = jnp.abs(b * x) < jnp.pi / 2
        return jnp.where(
            inside, height * jnp.cos(jnp.where(inside, b * x, 0.0)) ** (2 / (p - 1)), 0.0
        )

    return profile(x), c * profile(x - 0.5), jnp.pi / (2 * b)
