"""The common parts of the dispersive shocks of KdV and Toda: results, and m at a given speed."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..base.checks import parameter, positive, within
from ..base.derivatives import with_slope
from ..base.printing import told
from .elliptic_functions import _K, _sloped

# Newton steps for ln(1 - m), from a guess that is always close
NEWTON = 5
# the step of the trapezoidal rules
STEP = 0.2
# the end of their nodes, beyond which every integrand is negligible
LAST = 40.0
# sinh^2 at the nodes of the first rule, whose first weight is half
SQUARES = np.sinh(np.arange(0, LAST, STEP)) ** 2
# the ln tan of the angles of the second rule, which are equidistant in it
_W = np.arange(-56, LAST, STEP)
# sin^2, ln cos^2 and weights of these angles
ANGLES = 1 / (1 + np.exp(-2 * _W)), -np.logaddexp(0, 2 * _W), STEP / (2 * np.cosh(_W))
# in place of the infinite K(1); sech of it underflows to zero
FAR = 1e3


class ShockEdges(NamedTuple):
    """The edges of a dispersive shock, and its size there.

    - `trailing_speed`, `leading_speed`: n/t of the harmonic edge behind and of the solitary edge
      ahead [sites/s].
    - `mean`: mean strain of the plateau behind [m].
    - `amplitude`: strain of the crest at the leading edge [m].

    **Example:**

    >>> edges = gx.theory.kdv.velocity_shock(0.05, 1.0, 0.5)
    >>> round(float(edges.mean), 6), round(float(edges.amplitude), 6)
    (0.1, 0.2)
    """

    trailing_speed: jax.Array
    leading_speed: jax.Array
    mean: jax.Array
    amplitude: jax.Array
    __repr__ = told


class ShockWave(NamedTuple):
    """A dispersive shock at places n and times t, of their broadcast shape.

    - `strain` [m]: the modulated periodic wave, the plateau behind it, and the flank of the last
      crest ahead of it.
    - `m`: parameter of the periodic wave; 1 ahead, and 0 on the plateau, if there is one.
    - `mean`, `crest`, `trough` [m]: mean, largest and smallest strain of the periodic wave there.

    **Example:**

    >>> wave = gx.theory.kdv.shock_wave(50.0, 100.0, 0.05, 1.0, 0.5)  # behind the trailing edge
    >>> round(float(wave.mean), 6), float(wave.m)
    (0.1, 0.0)
    """

    strain: jax.Array
    m: jax.Array
    mean: jax.Array
    crest: jax.Array
    trough: jax.Array
    __repr__ = told


def _places(n, t, phase):
    t = positive("t", t, "Before that nothing has moved: a shock is spread over n/t.")
    return parameter("n", n), t, None if phase is None else parameter("phase", phase)


def _modulus_of(m):
    return within("m", m, 0, 1, remedy="It is 0 at the trailing edge and 1 at the leading edge.")


# The shift of the argument of Jacobi's functions by a phase. Ahead of all crests, where m1 = 0, FAR
# leaves only the flank of the last one.
def _turn(phase, m1, c):
    phase = _phase(m1, c) if phase is None else phase
    phase = phase - 2 * jnp.pi * jnp.round(phase / (2 * jnp.pi))
    return (
        jnp.where(m1 != 0, phase * _K(jnp.where(m1 != 0, m1, 1.0)), FAR * jnp.abs(phase)) / jnp.pi
    )


# (s(m) - 1)/c of the Toda chain, or for c = 0 S(m) of KdV, without cancellation at small c. With
# S = sinh^2 x and rho = (1 + c m1)/(1 + c) it is the ratio of the integrals over all x of
# [m/((1 + c)(1 + rho S)) - m1 S]/((1 + S)(1 + m1 S)^{1/2}) and rho/((1 + rho S)(1 + m1 S)^{1/2}).
# The error of the trapezoidal rule is exp(-pi^2/step).
def _excess(m1, c):
    share = 1 + c * m1

    def parts(S):
        root = jnp.sqrt(1 + m1 * S)
        below = 1 + c + share * S
        return jnp.stack([((1 - m1) / below - m1 * S) / ((1 + S) * root), share / (below * root)])

    over, under = _integral(parts, m1.dtype)
    return over / under - _steep(m1)


# The integral of a function of sinh^2 x over x > 0. Its poles must be no closer to the real axis
# than pi/2.
def _integral(function, dtype):
    # larger squares would overflow in float32
    squares = jnp.asarray(SQUARES[SQUARES < float(jnp.finfo(dtype).max) ** 0.4], dtype)
    first = STEP / 2 * function(squares[0])
    return jax.lax.fori_loop(
        1, len(squares), lambda i, total: total + STEP * function(squares[i]), first
    )


# Phase pi - D of the wave after a velocity step of the Toda chain, or for c = 0 of KdV, with
#   D = int_E3^E4 ln chi |P|^{-1/2} / int_E2^E3 |P|^{-1/2},   P = (x - E1)(x - E2)(x - E3)(x - E4),
#   chi(x)^2 = (x^2 - (1 - c)^2)((1 + c)^2 - x^2)/(c x)^2,
# where chi is the density of the solitons that the left half sends into the right one. Trapezoidal
# rule in ln tan of the angle whose sin^2 is (x - E3)/(E4 - E3).
def _phase(m1, c):
    inside = (m1 != 0) & (m1 != 1)
    ends = jnp.where(m1 == 0, 3 * jnp.pi / 2, jnp.pi)
    m1 = jnp.where(inside, m1, 0.5)
    share = 1 + c * m1
    span = (1 + c) * m1
    reached = ANGLES[-1] > float(jnp.finfo(m1.dtype).eps) ** 2
    low, logs, weights = (jnp.asarray(x[reached], m1.dtype) for x in ANGLES)

    def add(i, total):
        # share times (x - E2)/2c, (x - E1)/2(1 + c), (x + E2)/2, (E4 - x)/2c, x/(1 + c)
        a = 1 - m1 + span * low[i]
        b = 1 + c * m1 * low[i]
        d = jnp.maximum(1 - c * c * m1, 0.0) + c * span * low[i]
        square = 16 * a * b * d * m1 / (share * (1 - c * m1 + 2 * c * m1 * low[i])) ** 2
        return total + weights[i] * (jnp.log(square) + logs[i]) / (2 * jnp.sqrt(a * b))

    total = jax.lax.fori_loop(0, len(low), add, 0 * span)
    return jnp.where(inside, jnp.pi - total * jnp.sqrt(share) / _K(m1), ends)


@jax.custom_jvp
def _steep(m1):
    return jnp.zeros_like(m1)


# adds the infinite slope at m1 = 0 of functions that behave like m1 ln(1/m1)
_sloped(_steep, lambda m1: jnp.where(m1 != 0, 0.0, jnp.inf))


# m1 at the trailing edge; for c > 1 the wave there has a length of two sites and the numbers
# -+(1 + c), -+(1 - c)
def _last(c):
    return 1 / jnp.maximum(c, 1.0) ** 2


# m1 where (s(m) - 1)/c is x, or that of the nearer edge where x is outside the shock. Newton's
# method for ln of the distance of x from the leading edge, which is nearly linear in ln m1.
@jax.custom_jvp
def _complement(x, c):
    x, c = jnp.broadcast_arrays(x, c)
    last = _last(c)
    low = _excess(last, c)
    high = _excess(jnp.zeros_like(c), c)
    tiny = jnp.finfo(x.dtype).eps / 4
    inside = (x > low) & (x < high)
    gap = jnp.where(inside, (high - x) / (high - low), 0.5)

    def nearer(_, y):
        value, slope = with_slope(lambda y: (high - _excess(jnp.exp(-y), c)) / (high - low), y)
        value = jnp.maximum(value, tiny)
        return jnp.clip(
            y - value * jnp.log(value / gap) / jnp.minimum(slope, -tiny),
            first,
            9 + first - jnp.log(tiny),
        )

    first = -jnp.log(last)
    y = jax.lax.fori_loop(0, NEWTON, nearer, first - 1.2 * jnp.log(gap))
    return jnp.where(inside, jnp.exp(-y), jnp.where(x < high, last, 0.0))


@_complement.defjvp
def _(primals, tangents):
    x, c = primals
    dx, dc = tangents
    m1 = _complement(x, c)
    last, change = jax.jvp(_last, (c,), (dc,))
    inside = (m1 > 0) & (m1 < last)
    behind = m1 == last
    safe, c, dc = jnp.broadcast_arrays(jnp.where(inside, m1, 0.5), c, dc)
    _, slope = with_slope(lambda m1: _excess(m1, c), safe)
    _, along = jax.jvp(lambda c: _excess(safe, c), (c,), (dc,))
    return m1, jnp.where(inside, (dx - along) / slope, jnp.where(behind, change, 0.0))
