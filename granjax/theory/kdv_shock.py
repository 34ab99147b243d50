r"""The dispersive shock of KdV on a chain, by A. V. Gurevich and L. P. Pitaevskii; public in `kdv`.

The private functions have K2/K3 as unit of strain and the speed of sound as unit of speed;
m1 = 1 - m is accurate near the leading edge.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from ..base.checks import parameter, require
from ..base.printing import told
from ..base.types import Numbers, Parameter
from .chain_wave import _stiffnesses
from .elliptic_functions import _K, _jacobi, _share
from .self_similar import (
    ShockEdges,
    ShockWave,
    _complement,
    _excess,
    _modulus_of,
    _phase,
    _places,
    _steep,
    _turn,
)

STRAIGHT = "Without K3 a chain has no KdV equation; of K4 alone it has the modified one."


class Modulation(NamedTuple):
    """The periodic wave in a dispersive shock of KdV, at the place of parameter m.

    - `speed`: n/t of that place [sites/s]. `r1`, `r2`, `r3`: the arguments of `cnoidal`.
    - `mean`, `crest`, `trough`: of the strain [m]; `amplitude`: crest minus trough [m].
    - `wavelength` [sites].
    - `phase` [rad]: the phase in `shock_wave`: 3 pi/2 at the leading edge; it diverges like ln^2 m
      at the trailing edge.

    **Example:**

    >>> wave = gx.theory.kdv.modulation(1.0, 0.05, 1.0, 0.5)  # the leading edge
    >>> round(float(wave.speed), 6), round(float(wave.amplitude), 6)
    (1.033333, 0.2)
    """

    speed: jax.Array
    r1: jax.Array
    r2: jax.Array
    r3: jax.Array
    mean: jax.Array
    amplitude: jax.Array
    wavelength: jax.Array
    crest: jax.Array
    trough: jax.Array
    phase: jax.Array
    __repr__ = told


def velocity_shock(c: Parameter, K2: Parameter, K3: Parameter, mass: Parameter = 1.0) -> ShockEdges:
    r"""Return the edges of the dispersive shock to the right that v_n = -2c sign(n) makes, by KdV.

    The chain has no strain before the step.

        s_-/sigma = 1 - C,   s_+/sigma = 1 + 2C/3,   mean C K2/K3,   amplitude 2 C K2/K3,   C = 2c K3/(K2 sigma)

    With sigma = K2 = 1, K3 = 1/2, these differ from `toda.velocity_shock`, whose next terms are
    -4c^2/45 in s_+, -c^2 in the mean and -4c^2 in the amplitude: KdV is 1.4, 23 and 44 % too large
    at c = 1/2. A strain step from y to 0 corresponds to c = sigma y/2.

    **Arguments:** `c` [m/s]: half the velocity of either side, of the sign of K3 (a law that
    softens has shocks of rarefaction); `K2` > 0, `K3` not zero, `mass`: as in `scales`.

    **Returns:** `ShockEdges`.

    **Raises** ValueError unless 0 < C < 1: c of the other sign makes no shock, and from C = 1 on,
    far outside KdV's range, an edge would run backwards. Typical: C = 0.1.

    **Example:**

    >>> edges = gx.theory.kdv.velocity_shock(0.05, 1.0, 0.5)
    >>> round(float(edges.trailing_speed), 6), round(float(edges.leading_speed), 6)
    (0.95, 1.033333)
    """
    C, sound, unit = _scaled(c, K2, K3, mass)
    return ShockEdges(sound * (1 - C), sound * (1 + 2 * C / 3), unit * C, 2 * unit * C)


def modulation(
    m: Parameter, c: Parameter, K2: Parameter, K3: Parameter, mass: Parameter = 1.0
) -> Modulation:
    r"""Return the periodic wave of parameter m in the shock, and the speed n/t of its place.

        r1 = 0,  r2 = C m,  r3 = C,   (n/t)/sigma = 1 + C S(m),   S = (1 + m)/3 - (2/3) m (1 - m) K/(E - (1 - m) K)

    m rises from 0 at the trailing edge, S = -1, to 1 at the leading edge, S = 2/3; the result is
    accurate to rounding at both. The slopes of speed and mean in m are infinite at m = 1.

    **Arguments:** `m` in [0, 1]; all others as `velocity_shock`.

    **Returns:** `Modulation`. **Raises** ValueError for other arguments.

    Typical: S(1/2) = -0.22947987. Source: A. V. Gurevich, L. P. Pitaevskii, Sov. Phys. JETP 38, 291
    (1974).

    **Example:**

    >>> wave = gx.theory.kdv.modulation(0.5, 0.05, 1.0, 0.5)
    >>> round(float(wave.speed), 6), round(float(wave.crest - wave.trough), 6)
    (0.988526, 0.1)
    """
    C, sound, unit = _scaled(c, K2, K3, mass)
    return Modulation(*_modulation(1 - _modulus_of(m), C, sound, unit))


def modulus(
    speed: Parameter, c: Parameter, K2: Parameter, K3: Parameter, mass: Parameter = 1.0
) -> Numbers:
    """Return the parameter m of the periodic wave at speed = n/t, the inverse of `modulation`.

    **Arguments:** `speed` [sites/s], any; all others as `velocity_shock`.

    **Returns:** m in (0, 1) between the edges, with derivatives of any order; 0 behind and 1 ahead
    of them. **Raises** ValueError as `velocity_shock`.

    **Example:**

    >>> round(float(gx.theory.kdv.modulus(0.98852601, 0.05, 1.0, 0.5)), 4)
    0.5
    """
    C, sound, _ = _scaled(c, K2, K3, mass)
    return _modulus(parameter("speed", speed) / sound, C)


def shock_wave(
    n: Parameter,
    t: Parameter,
    c: Parameter,
    K2: Parameter,
    K3: Parameter,
    *,
    mass: Parameter = 1.0,
    phase: Parameter | None = None,
) -> ShockWave:
    r"""Return the dispersive shock of `velocity_shock` at places n and times t.

    It consists of the plateau, the modulated periodic wave, and strain 0 ahead:

        y = (K2/K3) C (2 dn^2(z, m) - 1 + m),   z = 2 C^{1/2} (n - sigma (1 + C (1 + m)/3) t) + phase K(m)/pi

    as in `cnoidal`, with the numbers of `modulation` at speed n/t.

    **Arguments:** `n`, `t` > 0, `phase`: as in `toda.shock_wave`, whose phase tends to that of KdV
    for weak shocks; all others as `velocity_shock`.

    **Returns:** `ShockWave`. **Raises** ValueError for t <= 0 and as `velocity_shock`.

    **Example:**

    >>> wave = gx.theory.kdv.shock_wave(50.0, 100.0, 0.05, 1.0, 0.5)
    >>> round(float(wave.strain), 6)  # the plateau
    0.1
    """
    C, sound, unit = _scaled(c, K2, K3, mass)
    n, t, phase = _places(n, t, phase)
    return ShockWave(*_shock_wave(n, sound * t, phase, C, unit))


# C, the speed of sound and the unit of strain
def _scaled(c, K2, K3, mass):
    K2, K3, mass = _stiffnesses(K2, K3, mass, STRAIGHT)
    sound = jnp.sqrt(K2 / mass)
    C = 2 * parameter("c", c) * K3 / (K2 * sound)
    require(
        "c",
        C,
        lambda C: (C > 0) & (C < 1),
        "C = 2 c K3/(K2 (K2/mass)^(1/2)) in (0, 1)",
        "With the other sign there is a rarefaction, or where K3 < 0 a compression that spreads; a shock as "
        "strong as C = 1 is no long, weak wave.",
    )
    return C, sound, K2 / K3


# mean, crest and trough in units of C
def _strains(m1):
    return 2 * _share(m1) - m1, 2 - m1, m1


@jax.jit
def _modulation(m1, C, sound, unit):
    m1, C = jnp.broadcast_arrays(m1, C)
    mean, crest, trough = _strains(m1)
    mean, crest, trough = (unit * C * x for x in (mean + _steep(m1), crest, trough))
    speed = sound * (1 + C * _excess(m1, 0 * m1))
    wave = mean, 2 * unit * C * (1 - m1), _K(m1) / jnp.sqrt(C), crest, trough, _phase(m1, 0 * m1)
    return jnp.broadcast_arrays(speed, 0 * C, C * (1 - m1), C, *wave)


@jax.jit
def _modulus(s, C):
    x = (s - 1) / C
    return 1 - _complement(x, 0 * x)


@jax.jit
def _shock_wave(n, t, phase, C, unit):
    x = n - t
    m1 = _complement(x / (C * t), 0 * (x * C))
    z = 2 * jnp.sqrt(C) * (x - C * (2 - m1) / 3 * t) + _turn(phase, m1, 0 * m1)
    strain = m1 + 2 * (1 - m1) * _jacobi(z, m1)[1] ** 2
    mean, crest, trough = (unit * C * x for x in _strains(m1))
    return jnp.broadcast_arrays(unit * C * strain, 1 - m1, mean, crest, trough)
