r"""The dispersive shock of a Toda chain after a velocity step, by Whitham's modulation equations.

Public in `toda`. The private functions use scaled quantities (strength = rate = mass = 1) and
m1 = 1 - m, which is accurate near the leading edge.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..base.checks import parameter, refuse, require, show
from ..base.printing import told
from ..base.types import Numbers, Parameter
from .chain_wave import _known, _toda_constants
from .elliptic_functions import _K, _RF, _jacobi
from .self_similar import (
    ShockEdges,
    ShockWave,
    _complement,
    _excess,
    _integral,
    _last,
    _modulus_of,
    _phase,
    _places,
    _steep,
    _turn,
)

# relative tolerance of 1 - m where an m is compared with the smallest m of a shock
ROUNDING = 1e-6
SCALED = "c rate/(strength rate/mass)^(1/2)"


class Modulation(NamedTuple):
    """The periodic wave in a dispersive shock of the Toda chain, at the place of parameter m.

    - `speed`: n/t of that place [sites/s].
    - `E1`, `E2`, `E3`, `E4`: the arguments of `periodic_wave` (scaled).
    - `mean`, `crest`, `trough`: of the strain [m]; `amplitude`: crest minus trough [m].
    - `wavelength` [sites].
    - `phase` [rad]: the phase in `shock_wave`: 3 pi/2 at the leading edge; it diverges like ln^2 m
      at the trailing edge.

    **Example:**

    >>> wave = gx.theory.toda.modulation(1.0, 0.5)  # the leading edge, a soliton
    >>> round(float(wave.crest), 6), round(float(wave.trough), 6)
    (1.386294, 0.0)
    """

    speed: jax.Array
    E1: jax.Array
    E2: jax.Array
    E3: jax.Array
    E4: jax.Array
    mean: jax.Array
    amplitude: jax.Array
    wavelength: jax.Array
    crest: jax.Array
    trough: jax.Array
    phase: jax.Array
    __repr__ = told


def velocity_shock(
    c: Parameter, *, strength: Parameter = 1.0, rate: Parameter = 1.0, mass: Parameter = 1.0
) -> ShockEdges:
    r"""Return the edges of the dispersive shock to the right that v_n = -2c sign(n) makes.

    The Toda chain has no strain before the step. In scaled quantities, for c < 1,

        s_- = 1 - c,   s_+ = (c (1 + c))^{1/2}/arsinh c^{1/2},
        mean 2 ln(1 + c),   amplitude 2 ln(1 + 2c).

    For c >= 1 there is no plateau: s_- is the speed of `modulation` at m = 1 - 1/c^2, and behind it
    neighbours oscillate against each other forever, between the crest and the trough at that m;
    `mean` is their mean strain.

    **Arguments:** `c` [m/s]: half the velocity of either side, of the sign of `rate`; its scaled
    value is c rate/(strength rate/mass)^{1/2}. `strength`, `rate`, `mass`: as everywhere in `toda`.

    **Returns:** `ShockEdges`.

    **Raises** ValueError for c of the other sign, which pulls the chain apart and makes a
    rarefaction.

    **Example:**

    >>> edges = gx.theory.toda.velocity_shock(0.1)
    >>> round(float(edges.leading_speed), 6), round(float(edges.mean), 6)
    (1.065818, 0.19062)
    """
    c, rate, b = _scaled(c, strength, rate, mass)
    return ShockEdges(*_edges(c, rate, b))


def modulation(
    m: Parameter,
    c: Parameter,
    *,
    strength: Parameter = 1.0,
    rate: Parameter = 1.0,
    mass: Parameter = 1.0,
) -> Modulation:
    r"""Return the periodic wave of parameter m in the shock, and the speed n/t of its place.

        E1 = -(1 + c),  E2 = 1 - c,  E3 = (1 + c)(1 - c m1)/(1 + c m1),  E4 = 1 + c,   m1 = 1 - m,
        s(m) = c (1 + c)/(1 + c m1)
               [(1 + c m1) E - (1 + c) m1 K]/[(1 + c) K - (1 + c m1) Pi(c m/(1 + c), m)]

    m rises from 0 at the trailing edge (no amplitude) to 1 at the leading edge (a soliton); the
    result is accurate to rounding at both. For c > 1 (scaled) it begins at m = 1 - 1/c^2, with a
    wave of two sites. The slopes of speed and mean in m are infinite at m = 1.

    **Arguments:** `m` in [0, 1]; all others as `velocity_shock`.

    **Returns:** `Modulation`. **Raises** ValueError for other arguments.

    Source: Biondini, Chong, Kevrekidis (2024).

    **Example:**

    >>> round(float(gx.theory.toda.modulation(0.5, 0.5).speed), 6)
    0.803701
    """
    c, rate, b = _scaled(c, strength, rate, mass)
    m = _modulus_of(m)
    values = _known(m, c)
    if values and np.any(1 - values[0] > (1 + ROUNDING) * np.asarray(_last(values[1]))):
        refuse(
            "m",
            f"numbers from 1 - 1/C^2 on, where C = {SCALED} > 1",
            show(values[0]),
            "There the shock begins, with a wave of two sites.",
        )
    # an m that rounding put below the smallest m is clipped, and the clip carries no derivative
    m1 = 1 - m
    return Modulation(
        *_modulation(m1 + jax.lax.stop_gradient(jnp.minimum(m1, _last(c)) - m1), c, rate, b)
    )


def modulus(
    speed: Parameter,
    c: Parameter,
    *,
    strength: Parameter = 1.0,
    rate: Parameter = 1.0,
    mass: Parameter = 1.0,
) -> Numbers:
    """Return the parameter m of the periodic wave at speed = n/t, the inverse of `modulation`.

    **Arguments:** `speed` [sites/s], any; all others as `velocity_shock`.

    **Returns:** m: behind the trailing edge 0, or 1 - 1/c^2 for c > 1 (scaled); ahead of the
    leading edge 1; between the edges with derivatives of any order.

    **Raises** ValueError as `velocity_shock`.

    **Example:**

    >>> round(float(gx.theory.toda.modulus(0.80370112, 0.5)), 4)
    0.5
    """
    c, rate, _ = _scaled(c, strength, rate, mass)
    return _modulus(parameter("speed", speed) / rate, c)


def shock_wave(
    n: Parameter,
    t: Parameter,
    c: Parameter,
    *,
    phase: Parameter | None = None,
    strength: Parameter = 1.0,
    rate: Parameter = 1.0,
    mass: Parameter = 1.0,
) -> ShockWave:
    r"""Return the dispersive shock of `velocity_shock` at places n and times t.

    It consists of the plateau (or the middle), the modulated periodic wave, and strain 0 ahead:

        exp y = (E4 - E3 + E2 - E1)^2/4 + (E3 - E2)(E4 - E1) cn^2(z, m),
        z = 2 F n - omega t + phase K(m)/pi

    as in `periodic_wave`, with the numbers of `modulation` at speed n/t.

    **Arguments:**

    - `n`, `t` > 0: places and times, arrays that broadcast. n is measured from the place of the
      shock: where site 0 has velocity 0, the bond between n and n + 1 is at n + 1/2. The wave to
      the left is the mirror image: pass |n|.
    - `phase` [rad], 2 pi per wave: `None` for the phase of this shock (`modulation(m, c).phase`);
      or a number or an array over n that varies slowly, for a wave of another origin.
    - `c` and all others as `velocity_shock`.

    **Returns:** `ShockWave`. Nothing is fitted. The error falls like 1/t inside, more slowly at the
    edges. For c > 1 (scaled) the wave of two sites is accurate at once, except in a few sites
    around n = 0, where a motion remains.

    The phase is pi - int_E3^E4 ln chi w dx/int_E2^E3 w dx, with the weight
    w = |(x - E1)(x - E2)(x - E3)(x - E4)|^{-1/2} and the scattering of the left half into the right
    one, chi(x)^2 = (x^2 - E2^2)(E4^2 - x^2)/(c x)^2.

    **Raises** ValueError for t <= 0 and as `velocity_shock`.

    Typical: c = 1/2, t = 200: error 0.006 in the middle. Source of the form of the phase: J.
    Michor, Phys. Lett. A 380, 1110 (2016).

    **Example:**

    >>> wave = gx.theory.toda.shock_wave(50.0, 200.0, 0.5)
    >>> round(float(wave.strain), 6)  # the plateau, 2 ln 1.5
    0.81093
    """
    c, rate, b = _scaled(c, strength, rate, mass)
    n, t, phase = _places(n, t, phase)
    return ShockWave(*_shock_wave(n, rate * t, phase, c, b))


# scaled c, the unit of speed, and 1/(unit of strain)
def _scaled(c, strength, rate, mass):
    a, b, m = _toda_constants(strength, rate, mass)
    rate = jnp.sqrt(a * b / m)
    c = parameter("c", c) * b / rate
    require(
        "c",
        c,
        lambda c: (c > 0) & np.isfinite(c),
        f"{SCALED} above zero, and finite",
        "Otherwise the chain is pulled apart, and has a rarefaction.",
    )
    return c, rate, b


# omega, F, exp y - 1 at the trough, and the rise of exp y from trough to crest
def _numbers_of(m1, c):
    share = 1 + c * m1
    omega = 2 * jnp.sqrt(c * (1 + c) / share)
    F = jnp.sqrt(c / (1 + c)) * _RF(1 / jnp.sqrt(1 + c), jnp.sqrt(share / (1 + c)))
    root = c * (1 + c) * m1 / share
    return omega, F, root * (2 + root), 4 * c * (1 + c) * (1 - m1) / share


# mean, crest and trough; the integral for the mean does not cancel at small c
def _strains(m1, low, depth):
    inside = jnp.where(m1 != 0, m1, 1.0)
    mean = _integral(
        lambda S: jnp.log1p(low + depth / (1 + S)) / jnp.sqrt(1 + inside * S), m1.dtype
    ) / _K(inside)
    return jnp.where(m1 != 0, mean, 0.0), jnp.log1p(low + depth), jnp.log1p(low)


@jax.jit
def _edges(c, rate, b):
    m1 = jnp.where(c < 1, 0.5, _last(c))
    back = jnp.where(c < 1, 1 - c, 1 + c * _excess(m1, c))
    *_, low, depth = _numbers_of(m1, c)
    mean = jnp.where(c < 1, 2 * jnp.log1p(c), _strains(m1, low, depth)[0])
    front = jnp.sqrt(c * (1 + c)) / jnp.arcsinh(jnp.sqrt(c))
    return rate * back, rate * front, mean / b, 2 * jnp.log1p(2 * c) / b


@jax.jit
def _modulation(m1, c, rate, b):
    m1, c = jnp.broadcast_arrays(m1, c)
    _, F, low, depth = _numbers_of(m1, c)
    mean, crest, trough = _strains(m1, low, depth)
    Es = -(1 + c), 1 - c, (1 + c) * (1 - c * m1) / (1 + c * m1), 1 + c
    mean = mean + _steep(m1)
    amplitude = jnp.log1p(depth / (1 + low))
    wave = mean / b, amplitude / b, _K(m1) / F, crest / b, trough / b, _phase(m1, c)
    return jnp.broadcast_arrays(rate * (1 + c * _excess(m1, c)), *Es, *wave)


@jax.jit
def _modulus(s, c):
    return 1 - _complement((s - 1) / c, c)


@jax.jit
def _shock_wave(n, t, phase, c, b):
    m1 = _complement((n - t) / (c * t), c)
    omega, F, low, depth = _numbers_of(m1, c)
    mean, crest, trough = _strains(m1, low, depth)
    z = 2 * F * n - omega * t + _turn(phase, m1, c)
    strain = jnp.log1p(low + depth * _jacobi(z, m1)[1] ** 2)
    return jnp.broadcast_arrays(strain / b, 1 - m1, mean / b, crest / b, trough / b)
