r"""The dispersive shock of a Toda chain after a velocity shock, by Whitham's modulation equations; see `toda`.

All inside in scaled numbers, strength = rate = mass = 1, with m1 = 1 - m, which keeps its digits at the leading edge.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..checks import concrete, parameter, refuse, show
from ..printing import told
from ..types import Numbers, Parameter
from .chain_wave import _toda_constants
from .elliptic_functions import _jacobi
from .elliptic_integrals import _K, _RF
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

# of 1 - m, as the least m of a shock is written
ROUNDING = 1e-6
SCALED = "c rate/(strength rate/mass)^(1/2)"


class Modulation(NamedTuple):
    """The periodic wave of a dispersive shock of the Toda chain where its parameter is m.

    - `speed`: n/t of that place [sites/s]. `E1`, `E2`, `E3`, `E4`: its numbers for `periodic_wave` (scaled).
    - `mean`, `crest`, `trough`: of its strain [m]; `amplitude`: crest less trough. `wavelength` [sites].
    - `phase` [rad]: that of `shock_wave`, 3 pi/2 at the leading edge; behind it diverges, like ln^2 m.

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
    r"""The dispersive shock that v_n = -2c sign(n) sends to the right through a Toda chain at rest in strain.

        s_- = 1 - c,   s_+ = (c (1 + c))^{1/2}/arsinh c^{1/2},   mean 2 ln(1 + c),   amplitude 2 ln(1 + 2c)

    in scaled numbers, for c < 1. From c = 1 on there is no plateau: behind s_-, the speed of `modulation` at m = 1 -
    1/c^2, neighbours swing against each other forever between the crest and the trough that it has there; `mean` is
    theirs.

    **Arguments:** `c` [m/s]: half the velocity of either side, of the sign of `rate`; scaled c rate/(strength
    rate/mass)^{1/2}. `strength`, `rate`, `mass`: as everywhere here. **Returns:** `ShockEdges`. **Raises** ValueError
    for c of the other sign, which pulls the chain apart and has a rarefaction.
    Typical: c = 0.1 0.9, 1.06581768, 0.19062036, 0.36464311.

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
    r"""The periodic wave inside the dispersive shock of `velocity_shock`, and the speed n/t at which it stands.

        E1 = -(1 + c),  E2 = 1 - c,  E3 = (1 + c)(1 - c m1)/(1 + c m1),  E4 = 1 + c,   m1 = 1 - m,
        s(m) = c (1 + c)/(1 + c m1) [(1 + c m1) E - (1 + c) m1 K]/[(1 + c) K - (1 + c m1) Pi(c m/(1 + c), m)]

    From m = 0 at the trailing edge, where it has no amplitude, to m = 1 at the leading edge, a soliton; right to
    rounding at both. Where c > 1 (scaled) it begins at m = 1 - 1/c^2, with a wave of two sites. **Arguments:** `m` in
    [0, 1], `c` and all else as `velocity_shock`. **Returns:** `Modulation`. **Raises** ValueError for others.
    The slope of speed and mean in m is infinite at m = 1.
    Typical: c = 0.5, m = 0.2, 0.5, 0.8, 0.95: speed 0.607509, 0.803701, 1.063430, 1.237004.
    Source: Biondini, Chong, Kevrekidis (2024).

    **Example:**

    >>> round(float(gx.theory.toda.modulation(0.5, 0.5).speed), 6)
    0.803701
    """
    c, rate, b = _scaled(c, strength, rate, mass)
    m = _modulus_of(m)
    values = concrete(m), concrete(c)
    if all(x is not None for x in values) and np.any(
        1 - values[0] > (1 + ROUNDING) * np.asarray(_last(values[1]))
    ):
        refuse(
            "m",
            f"numbers from 1 - 1/C^2 on, where C = {SCALED} > 1",
            show(values[0]),
            "There the shock begins, with a wave of two sites.",
        )
    # m alone sets m1: what rounding puts below the least m has no slope
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
    """The parameter m of the periodic wave at speed = n/t, the inverse of `modulation(m, c).speed`.

    **Arguments:** `speed` [sites/s], any; all else as `velocity_shock`. **Returns:** m between the edges, 0 behind
    them, or 1 - 1/c^2 where c > 1 (scaled), and 1 ahead; derivatives of any order between.
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
    r"""The dispersive shock of `velocity_shock` as a wave: plateau or middle, modulated periodic wave, strain 0 ahead.

        exp y = (E4 - E3 + E2 - E1)^2/4 + (E3 - E2)(E4 - E1) cn^2(z, m),   z = 2 F n - omega t + phase K(m)/pi

    of `periodic_wave`, whose numbers are those of `modulation` where the speed is n/t. **Arguments:**

    - `n`, `t` > 0: places and times, arrays that broadcast. n is measured from the place of the shock: where site 0
      has velocity 0, the bond between n and n + 1 is at n + 1/2. The wave to the left is the mirror image: give |n|.
    - `phase` [rad], 2 pi a wave: `None`, that of the shock, which is known (`modulation(m, c).phase`); or a number or
      an array over n that varies slowly, of a wave that came about in another way.
    - `c` and all else as `velocity_shock`.

    **Returns:** `ShockWave`. The phase is pi less the integral of ln chi over the band from E3 to E4, over that of 1
    over the gap from E2 to E3, both with the weight |(x - E1)(x - E2)(x - E3)(x - E4)|^{-1/2}, where chi(x)^2 =
    (x^2 - E2^2)(E4^2 - x^2)/(c x)^2 is what the left half does to the right one. Nothing is fitted; the error inside
    falls like 1/t, at the edges more slowly; where c > 1 (scaled) the wave of two sites is right at once, but around
    n = 0, where a motion of few sites stands. **Raises** ValueError for t <= 0 and as `velocity_shock`.
    Typical: c = 1/2, t = 200: wrong by 0.006 in the middle. Source of the form of the phase: J. Michor, Phys. Lett. A
    380, 1110 (2016); chi is the scattering of these two halves.

    **Example:**

    >>> wave = gx.theory.toda.shock_wave(50.0, 200.0, 0.5)
    >>> round(float(wave.strain), 6)  # the plateau, 2 ln 1.5
    0.81093
    """
    c, rate, b = _scaled(c, strength, rate, mass)
    n, t, phase = _places(n, t, phase)
    return ShockWave(*_shock_wave(n, rate * t, phase, c, b))


def _scaled(c, strength, rate, mass):
    """c, the unit of speed and that of 1/strain."""
    a, b, m = _toda_constants(strength, rate, mass)
    rate = jnp.sqrt(a * b / m)
    c = parameter("c", c) * b / rate
    value = concrete(c)
    if value is not None and not np.all((value > 0) & np.isfinite(value)):
        refuse(
            "c",
            f"{SCALED} above zero, and finite",
            show(value),
            "Otherwise the chain is pulled apart, and has a rarefaction.",
        )
    return c, rate, b


def _numbers_of(m1, c):
    """omega and F of the periodic wave, and exp y - 1 of its trough, and how much more its crest has."""
    share = 1 + c * m1
    omega = 2 * jnp.sqrt(c * (1 + c) / share)
    F = jnp.sqrt(c / (1 + c)) * _RF(1 / jnp.sqrt(1 + c), jnp.sqrt(share / (1 + c)), 1.0)
    root = c * (1 + c) * m1 / share
    return omega, F, root * (2 + root), 4 * c * (1 + c) * (1 - m1) / share


def _strains(m1, low, depth):
    """Mean, crest and trough; the mean as an integral, of which no digits cancel where c is small."""
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
    mean, amplitude = mean + _steep(m1), jnp.log1p(depth / (1 + low))
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
