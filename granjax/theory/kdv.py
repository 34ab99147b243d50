r"""The Korteweg-de Vries equation of long, weak waves that run one way along a chain.

Sites have mass m, and the force is K2 y + K3 y^2 + ... of the strain y_n = u_n - u_{n+1},
compression positive; `granjax.laws.taylor(law)` gives K2, K3 of any law. With the speed of sound
sigma = (K2/m)^{1/2} [sites/s],

    y_n(t) = (eps^2 K2/(24 K3)) Y(X, T),   X = eps (n - sigma t),   T = sigma eps^3 t/24,   Y_T + Y_XXX + Y Y_X = 0,

with a relative error of the order of speed/sigma - 1 = eps^2 V/24. The functions take a speed or an
amplitude in place of eps. Waves are of compression for K3 > 0, of rarefaction for K3 < 0.

**Velocity and displacement** are those of a lattice in which the KdV strain travels:
u_n - u_{n+1} = y_n and v_n - v_{n+1} = dy_n/dt, by the series of (d/2)/sinh(d/2) up to d^6. The
error is of the eighth order in the inverse width.

    import matplotlib.pyplot as plt
    import numpy as np
    K2, K3, K4 = gx.laws.taylor(gx.Hertz(precompression=1.0))
    wave = gx.theory.kdv.soliton(np.arange(100), 0.0, K2, K3, speed=1.02 * K2**0.5, centre=50.0)
    plt.plot(np.arange(100), wave.strain)

The dispersive shock of a law beside that of the Toda chain, which is not limited to long waves:

    import matplotlib.pyplot as plt
    import numpy as np
    K2, K3, K4 = gx.laws.taylor(gx.Hertz(precompression=1.0))
    strength, rate = gx.theory.toda.matched(K2, K3)
    n, t, c = np.arange(200, 270) + 0.5, 200.0, 0.2
    kdv = gx.theory.kdv.shock_wave(n, t, c, K2, K3)
    toda = gx.theory.toda.shock_wave(n, t, c, strength=strength, rate=rate)
    strains = np.stack([kdv.strain, toda.strain], -1)
    plt.plot(n, strains, label=["KdV", "Toda"])

Source: D. J. Korteweg, G. de Vries, Phil. Mag. 39, 422 (1895); N. J. Zabusky, M. D. Kruskal, Phys.
Rev. Lett. 15, 240 (1965); for chains G. Friesecke, R. L. Pego, Nonlinearity 12, 1601 (1999).
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..base.checks import parameter, refuse, require, show
from ..base.printing import told
from ..base.types import Numbers, Parameter
from .chain_wave import ChainWave, _direction_of, _known, _numbers, _one_given, _sech, _stiffnesses
from .elliptic_functions import _K, _jacobi, _share, _zeta
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

__all__ = [
    "ChainWave",
    "Modulation",
    "Scales",
    "ShockEdges",
    "ShockWave",
    "amplitude",
    "cnoidal",
    "modulation",
    "modulus",
    "scales",
    "shock_wave",
    "soliton",
    "speed",
    "velocity_shock",
]

STRAIGHT = "Without K3 a chain has no KdV equation; of K4 alone it has the modified one."
# coefficients of (d/2)/sinh(d/2) = 1 - d^2/24 + ...
HALF_STEP = (1.0, -1 / 24, 7 / 5760, -31 / 967680)


class Scales(NamedTuple):
    """The scales of KdV: `sound` sigma [sites/s]; `strain` K2/K3 [m], the unit of strain.

    **Example:**

    >>> sigma, strain = gx.theory.kdv.scales(1.0, 0.5)
    >>> float(sigma), float(strain)
    (1.0, 2.0)
    """

    sound: jax.Array
    strain: jax.Array
    __repr__ = told


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


def scales(K2: Parameter, K3: Parameter, mass: Parameter = 1.0) -> Scales:
    """Return the scales that map a chain to KdV.

    With y = (K2/K3) s the equation is s_t + sigma (s_n + s_nnn/24 + s s_n) = 0; Y = 24 s/eps^2 of X
    and T has coefficients 1.

    **Arguments:** `K2` > 0 [N/m], `K3` not zero [N/m^2], from `granjax.laws.taylor(law)`;
    `mass` > 0 of a site. **Raises** ValueError for others.

    **Example:**

    >>> scales = gx.theory.kdv.scales(1.5, 0.375)  # Hertz with d0 = A = m = 1
    >>> round(float(scales.sound), 5), float(scales.strain)
    (1.22474, 4.0)
    """
    K2, K3, mass = _stiffnesses(K2, K3, mass, STRAIGHT)
    return Scales(jnp.sqrt(K2 / mass), K2 / K3)


def speed(amplitude: Parameter, K2: Parameter, K3: Parameter, mass: Parameter = 1.0) -> Numbers:
    """Return the speed of the soliton of an amplitude, sigma (1 + K3 amplitude/(3 K2)) [sites/s].

    **Raises** ValueError for an amplitude without the sign of K3, and as `scales`.

    **Example:**

    >>> round(float(gx.theory.kdv.speed(0.06, 1.0, 0.5)), 6)
    1.01
    """
    sound, unit = scales(K2, K3, mass)
    return sound * (1 + _over_sound(sound, unit, amplitude=amplitude))


def amplitude(speed: Parameter, K2: Parameter, K3: Parameter, mass: Parameter = 1.0) -> Numbers:
    """Return the amplitude of the soliton of a speed, 3 (K2/K3) (speed/sigma - 1) [m].

    **Raises** ValueError for a speed not above that of sound, and as `scales`.

    **Example:**

    >>> round(float(gx.theory.kdv.amplitude(1.01, 1.0, 0.5)), 6)  # 3 (K2/K3) 0.01
    0.06
    """
    sound, unit = scales(K2, K3, mass)
    return 3 * unit * _over_sound(sound, unit, speed=speed)


def soliton(
    n: Parameter,
    t: Parameter,
    K2: Parameter,
    K3: Parameter,
    *,
    speed: Parameter | None = None,
    amplitude: Parameter | None = None,
    mass: Parameter = 1.0,
    centre: Parameter = 0.0,
    direction: str = "right",
) -> ChainWave:
    r"""Return the soliton of a speed or an amplitude.

        y = 3 (K2/K3) d sech^2((6 d)^{1/2} (n - centre -+ c t)),   c = sigma (1 + d)

    **Arguments:**

    - `n`, `t`: sites and times, as in `toda.soliton`; `K2`, `K3`, `mass`: as in `scales`.
    - `speed` c > sigma [sites/s], or `amplitude` [m], of the sign of K3.
    - `centre`: bond of the crest at t = 0; bond n lies between the sites n and n + 1.
    - `direction`: "right" or "left".

    **Returns:** `ChainWave` of strain, velocity, displacement (zero far to the right). In the chain
    the strain has an error of some d of its peak, by K2 K4/K3^2 (2.5 d for Hertz).

    **Raises** ValueError for a wave that is not faster than sound.

    **Example:**

    >>> wave = gx.theory.kdv.soliton(105.0, 100.0, 1.0, 0.5, speed=1.05)
    >>> round(float(wave.strain), 6)  # its crest, 105 sites on after t = 100
    0.3
    """
    sign = _direction_of(direction)
    sound, unit = scales(K2, K3, mass)
    excess = _over_sound(sound, unit, speed=speed, amplitude=amplitude)
    n, t, centre = _numbers(n=n, t=t, centre=centre)
    return ChainWave(*_soliton(n, t, centre, excess, unit, sound, sign))


def cnoidal(
    n: Parameter,
    t: Parameter,
    r1: Parameter,
    r2: Parameter,
    r3: Parameter,
    K2: Parameter,
    K3: Parameter,
    *,
    mass: Parameter = 1.0,
    centre: Parameter = 0.0,
    direction: str = "right",
) -> ChainWave:
    r"""Return the periodic wave of three Riemann invariants of KdV.

        y = (K2/K3) [r1 + r2 - r3 + 2 (r3 - r1) dn^2(2 (r3 - r1)^{1/2} (n - centre -+ c t), m)]

    with m = (r2 - r1)/(r3 - r1), c = sigma (1 + (r1 + r2 + r3)/3). Its wavelength is
    K(m)/(r3 - r1)^{1/2} sites. r1, r2, r3 are the invariants divided by 24/eps^2: r2 = r3 is a
    soliton on a strain of (K2/K3) r1, r1 = r2 a uniform strain.

    **Arguments:** r1 <= r2 <= r3, r1 < r3, small compared with 1; all others as `soliton`.

    **Returns:** `ChainWave`. The mean velocity is zero; for r2 = r3 the velocity is zero far from
    the crest, and velocity and displacement are differentiable only along r2 = r3. The displacement
    contains -(mean strain) n.

    **Raises** ValueError for numbers in another order.

    **Example:**

    >>> wave = gx.theory.kdv.cnoidal(0.0, 0.0, 0.0, 0.05, 0.1, 1.0, 0.5)  # at a crest
    >>> round(float(wave.strain), 6)
    0.3
    """
    sign = _direction_of(direction)
    sound, unit = scales(K2, K3, mass)
    n, t, centre, r1, r2, r3 = _numbers(n=n, t=t, centre=centre, r1=r1, r2=r2, r3=r3)
    values = _known(r1, r2, r3)
    if values:
        one, two, three = values
        if not np.all((one <= two) & (two <= three) & (one < three)):
            refuse("r1, r2, r3", "r1 <= r2 <= r3, and r1 < r3", ", ".join(map(show, values)))
    return ChainWave(*_cnoidal(n, t, centre, r1, r2, r3, unit, sound, sign))


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


def _over_sound(sound, unit, **given):
    name, value = _one_given(given, sound, unit, "K3", "K2 and mass")
    return value / sound - 1 if name == "speed" else value / (3 * unit)


@jax.jit
def _soliton(n, t, centre, excess, unit, sound, sign):
    kappa = jnp.sqrt(6 * excess)
    c = sign * sound * (1 + excess)
    x = n - centre - c * t
    top = 3 * excess
    profile = lambda x: _powers(kappa, x, top)
    strain = profile(x)[0]
    derivatives = _derivatives(*profile(x - 0.5), excess)
    # the sigmoid is proportional to 1 - tanh, which is zero far to the right
    integral = -top / kappa * 2 * jax.nn.sigmoid(-2 * kappa * (x - 0.5))
    velocity, displacement = _of_sites(derivatives, integral)
    return unit * strain, unit * c * velocity, unit * displacement


def _powers(kappa, x, top):
    T = jnp.tanh(kappa * x)
    S = _sech(kappa * x) ** 2
    return top * S, -2 * kappa * top * S * T, 2 * kappa**2 * top * S * (2 * T * T - S)


@jax.jit
def _cnoidal(n, t, centre, r1, r2, r3, unit, sound, sign):
    span = r3 - r1
    kappa = 2 * jnp.sqrt(span)
    excess = (r1 + r2 + r3) / 3
    m1 = (r3 - r2) / span
    c = sign * sound * (1 + excess)
    x = n - centre - c * t
    base = r1 + r2 - r3
    top = 2 * span
    x, m1 = jnp.broadcast_arrays(x, m1)
    mean = base + top * _share(m1)

    def profile(x):
        s, c, d = _jacobi(kappa * x, m1)
        m, s, c, d = 1 - m1, s * s, s * c * d, d * d
        turn = m * s * d + m * m * s * (1 - s) - (d - m1) * d
        return base + top * d, -2 * kappa * top * m * c, 2 * kappa**2 * top * turn

    s, *derivatives = _derivatives(*profile(x - 0.5), excess)
    integral = top / kappa * _zeta(kappa * (x - 0.5), m1)
    velocity, displacement = _of_sites((s - mean, *derivatives), integral)
    return unit * profile(x)[0], unit * c * velocity, unit * (displacement - mean * n)


# s and its first six derivatives, by s''' = 24 (excess - s) s'
def _derivatives(s, first, second, excess):
    g = 24 * (excess - s)
    third = g * first
    fourth = g * second - 24 * first**2
    fifth = g * third - 72 * first * second
    sixth = g * fourth - 96 * first * third - 72 * second**2
    return s, first, second, third, fourth, fifth, sixth


# velocity over the speed, and displacement, half a site ahead: their differences over sites give s
def _of_sites(s, integral):
    return sum(a * x for a, x in zip(HALF_STEP, s[::2])), -sum(
        a * x for a, x in zip(HALF_STEP, (integral, *s[1::2]))
    )


# C, the speed of sound and the unit of strain; further functions of the shock have these units, and
# m1 = 1 - m, which is accurate near the leading edge
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
