r"""The Toda chain in closed form: m u_n'' = a exp(b (u_{n-1} - u_n)) - a exp(b (u_n - u_{n+1})).

Here a = `strength`, b = `rate`, m = `mass`. The force of the strain y_n = u_n - u_{n+1} is
a (exp(b y) - 1), as in `laws.Toda`. The units of scaled quantities are (m/(a b))^{1/2} of time, 1/b
of strain and displacement, a/b of energy; the speed of sound is (a b/m)^{1/2} [sites/s]. Any law
F = K2 y + K3 y^2 + ... is close to the Toda chain with the constants of `matched`. a and b may both
be negative: then the waves are of rarefaction, as in a law with K3 < 0.

One soliton is exp(b y_n) - 1 = sinh^2 k sech^2(k (n - n0) -+ (a b/m)^{1/2} t sinh k). Its speed is
sinh k/k times that of sound, and its wave number k [1/site] sets all its other properties. All
functions are exact, broadcast, and are differentiable in both modes in all numbers.

    import numpy as np
    n, t = np.arange(120), np.linspace(40, 160, 121)
    wave = gx.theory.toda.two_solitons(n, t[:, None], k1=1.0, k2=0.5, centre1=-57.0, centre2=-44.0)
    gx.plots.space_time(wave.strain, ts=t, label="strain", site_label="contact")

The dispersive shock of two halves that meet with velocities 2c and -2c, for
0 < c (b m/a)^{1/2} < 1:

    import matplotlib.pyplot as plt
    import numpy as np
    edges = gx.theory.toda.velocity_shock(0.3)
    n, t = np.arange(300) + 0.5, 200.0
    shock = gx.theory.toda.shock_wave(n, t, 0.3)
    plt.plot(n, shock.strain)

Source: M. Toda, Theory of Nonlinear Lattices (Springer, 1989); R. Hirota, J. Phys. Soc. Jpn. 35,
286 (1973); H. Flaschka, Phys. Rev. B 9, 1924 (1974); G. Biondini, C. Chong, P. Kevrekidis, Physica
D 469, 134315 (2024).
"""

from functools import partial
from itertools import combinations
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..base.checks import positive, refuse, require, show
from ..base.derivatives import with_slope
from ..base.printing import told
from ..base.types import Numbers, Parameter
from .chain_wave import (
    ChainWave,
    _direction_of,
    _known,
    _numbers,
    _one_given,
    _sinh_less,
    _stiffnesses,
    _toda_constants,
)
from .self_similar import ShockEdges, ShockWave
from .toda_periodic import PeriodicNumbers, lax_eigenvalues, periodic_numbers, periodic_wave
from .toda_shock import Modulation, modulation, modulus, shock_wave, velocity_shock

__all__ = [
    "ChainWave",
    "Modulation",
    "PeriodicNumbers",
    "ShockEdges",
    "ShockWave",
    "TodaConstants",
    "amplitude",
    "energy",
    "lax_eigenvalues",
    "matched",
    "modulation",
    "modulus",
    "periodic_numbers",
    "periodic_wave",
    "phase_shifts",
    "shock_wave",
    "soliton",
    "speed",
    "two_solitons",
    "velocity_shock",
    "wavenumber",
]

# Newton steps that invert a monotonic function from a guess that is always close
NEWTON = 9


class TodaConstants(NamedTuple):
    """`strength` a [N] and `rate` b [1/m] of a Toda chain.

    **Example:**

    >>> constants = gx.theory.toda.matched(1.5, 0.375)
    >>> float(constants.strength), float(constants.rate)
    (3.0, 0.5)
    """

    strength: jax.Array
    rate: jax.Array
    __repr__ = told


def matched(K2: Parameter, K3: Parameter) -> TodaConstants:
    """Return the Toda chain of the same K2 and K3: b = 2 K3/K2, a = K2^2/(2 K3).

    **Arguments:** for any law, the values of `granjax.laws.taylor(law)`. **Raises** ValueError for
    K2 <= 0 and for K3 = 0, which no Toda chain has.

    **Example:**

    >>> a, b = gx.theory.toda.matched(1.5, 0.375)  # Hertz with d0 = A = 1
    >>> float(a), float(b)
    (3.0, 0.5)
    """
    K2, K3, _ = _stiffnesses(K2, K3, 1.0, "Every Toda chain is stiffer one way than the other.")
    return TodaConstants(K2**2 / (2 * K3), 2 * K3 / K2)


# ------------------------------------------------------------------------------------------------------------ solitons


def speed(
    k: Parameter, *, strength: Parameter = 1.0, rate: Parameter = 1.0, mass: Parameter = 1.0
) -> Numbers:
    """Return the speed of a soliton [sites/s], sinh k/k times that of sound, (a b/m)^{1/2}.

    **Arguments:** `k` > 0 [1/site].

    **Example:**

    >>> round(float(gx.theory.toda.speed(1.0)), 6)  # sinh 1
    1.175201
    """
    k = _wave_number("k", k)
    a, b, m = _toda_constants(strength, rate, mass)
    return jnp.sqrt(a * b / m) * (1 + _sinh_less(k) / k)


def amplitude(k: Parameter, *, rate: Parameter = 1.0) -> Numbers:
    """Return the largest strain of a soliton, 2 ln(cosh k)/b.

    **Arguments:** `k` > 0 [1/site]; `rate`: b, not zero.

    **Example:**

    >>> round(float(gx.theory.toda.amplitude(1.0)), 6)  # 2 ln(cosh 1)
    0.867562
    """
    k, b = _numbers(k=_wave_number("k", k), rate=rate)
    _toda_constants(b, b, 1.0)
    return jnp.log1p(jnp.sinh(k) ** 2) / b


def energy(k: Parameter, *, strength: Parameter = 1.0, rate: Parameter = 1.0) -> Numbers:
    """Return the energy of a soliton, (sinh 2k - 2k) a/b.

    **Arguments:** `k` > 0 [1/site].

    **Example:**

    >>> round(float(gx.theory.toda.energy(1.0)), 6)  # sinh 2 - 2
    1.62686
    """
    k = _wave_number("k", k)
    a, b, _ = _toda_constants(strength, rate, 1.0)
    return a / b * _sinh_less(2 * k)


def wavenumber(
    *,
    speed: Parameter | None = None,
    amplitude: Parameter | None = None,
    energy: Parameter | None = None,
    strength: Parameter = 1.0,
    rate: Parameter = 1.0,
    mass: Parameter = 1.0,
) -> Numbers:
    """Return the wave number k of the soliton of a given speed, amplitude or energy.

    **Arguments:** one of `speed` [sites/s], `amplitude` [m], of the sign of b, or `energy` [J].

    **Raises** ValueError for none or several of them, a speed not above that of sound, an amplitude
    of the wrong sign.

    **Example:**

    >>> round(float(gx.theory.toda.wavenumber(speed=1.1752012)), 6)  # sinh k/k = sinh 1
    1.0
    """
    a, b, m = _toda_constants(strength, rate, mass)
    sound = jnp.sqrt(a * b / m)
    given = {"speed": speed, "amplitude": amplitude, "energy": energy}
    name, value = _one_given(given, sound, b, "the rate", "strength, rate and mass")
    return _wavenumber(name, value * {"speed": 1 / sound, "amplitude": b, "energy": b / a}[name])


@partial(jax.jit, static_argnums=0)
def _wavenumber(name, value):
    if name == "amplitude":
        return value / 2 + jnp.log1p(jnp.sqrt(-jnp.expm1(-value)))
    target = jnp.log(value)
    if name == "speed":
        return _solved(_log_speed, target, target + jnp.sqrt(6 * target))
    small = value < 1
    guess = jnp.where(
        small,
        jnp.cbrt(6 * jnp.where(small, value, 1.0)),
        jnp.arcsinh(value + 2 * jnp.arcsinh(value)),
    )
    return _solved(lambda x: jnp.log(_sinh_less(x)), target, guess) / 2


# ln(sinh k/k) without cancellation at small k and without overflow at large k
def _log_speed(k):
    near = k < 1
    far = jnp.where(near, 1.0, k)
    large = far + jnp.log(-jnp.expm1(-2 * far) / (2 * far))
    small = jnp.where(near, k, 1.0)
    return jnp.where(near, jnp.log1p(_sinh_less(small) / small), large)


def _solved(function, target, x):
    def nearer(_, x):
        value, slope = with_slope(function, x)
        return x - (value - target) / slope

    return jax.lax.fori_loop(0, NEWTON, nearer, x)


def soliton(
    n: Parameter,
    t: Parameter,
    k: Parameter,
    *,
    centre: Parameter = 0.0,
    direction: str = "right",
    strength: Parameter = 1.0,
    rate: Parameter = 1.0,
    mass: Parameter = 1.0,
) -> ChainWave:
    """Return one soliton.

        exp(b y) - 1 = sinh^2 k sech^2(k (n - centre) -+ (a b/m)^{1/2} t sinh k)

    **Arguments:**

    - `n`, `t`: sites and times, arrays that broadcast; `n[:, None]` and `t` for all pairs.
    - `k` > 0: wave number [1/site]; see `wavenumber`.
    - `centre`: bond of the crest at t = 0, any real number; bond n lies between sites n and n + 1.
    - `direction`: "right" or "left".

    **Returns:** `ChainWave`. The displacement is zero far to the right and 2k/b, the sum of all
    strains, far to the left.

    **Raises** ValueError for k <= 0 and for constants that no Toda chain has.

    **Example:**

    >>> wave = gx.theory.toda.soliton(0.0, 0.0, 1.0)
    >>> round(float(wave.strain), 6)  # its crest, 2 ln(cosh 1)
    0.867562
    """
    sign = _direction_of(direction)
    k = _wave_number("k", k)
    n, t, centre = _numbers(n=n, t=t, centre=centre)
    return ChainWave(
        *_solitons(n, t, (k,), (sign,), (centre,), 0.0, *_toda_constants(strength, rate, mass))
    )


def two_solitons(
    n: Parameter,
    t: Parameter,
    k1: Parameter,
    k2: Parameter,
    *,
    centre1: Parameter,
    centre2: Parameter,
    head_on: bool = False,
    strength: Parameter = 1.0,
    rate: Parameter = 1.0,
    mass: Parameter = 1.0,
) -> ChainWave:
    """Return two solitons that pass through each other.

    The first moves to the right. The second does too, or to the left for `head_on`.

    **Arguments:** as `soliton`. `centre1`, `centre2`: the crests are at centre + speed t before
    they meet, and further by `phase_shifts` afterwards.

    **Raises** ValueError as `soliton`, and for k1 = k2 in the same direction: they never meet.

    **Example:**

    >>> wave = gx.theory.toda.two_solitons(-50.0, 0.0, 1.0, 0.5, centre1=-50.0, centre2=50.0)
    >>> round(float(wave.strain), 6)  # the first, long before they meet: 2 ln(cosh 1)
    0.867562
    """
    k1, k2 = _pair(k1, k2, head_on)
    n, t, centre1, centre2 = _numbers(n=n, t=t, centre1=centre1, centre2=centre2)
    meeting = _log_meeting(k1, k2, head_on)
    # In the sum f the soliton behind carries its shift before they meet: its start makes up for it.
    behind = (True, False) if head_on else (k1 > k2, k1 < k2)
    starts = tuple(
        c - jnp.where(first, meeting / (2 * k), 0.0)
        for c, first, k in ((centre1, behind[0], k1), (centre2, behind[1], k2))
    )
    signs = 1.0, -1.0 if head_on else 1.0
    return ChainWave(
        *_solitons(n, t, (k1, k2), signs, starts, meeting, *_toda_constants(strength, rate, mass))
    )


def phase_shifts(k1: Parameter, k2: Parameter, *, head_on: bool = False) -> tuple[Numbers, Numbers]:
    r"""Return the displacements along n [sites] that two solitons gain when they meet.

    Overtaking: (1/k_i) ln[sinh((k1 + k2)/2)/sinh(|k1 - k2|/2)], forward for the faster soliton and
    backward for the slower one. `head_on` (the first to the right, the second to the left):
    (1/k_i) ln[cosh((k1 + k2)/2)/cosh((k1 - k2)/2)], each forward along its own direction, so the
    second is negative.

    **Returns:** the two shifts. **Raises** ValueError for k <= 0, and for k1 = k2 in the same
    direction.

    Typical: k = 1 and 0.5, head-on: +0.22734, -0.45467.

    **Example:**

    >>> first, second = gx.theory.toda.phase_shifts(1.0, 0.5)
    >>> round(float(first), 5), round(float(second), 5)
    (1.18027, -2.36054)
    """
    k1, k2 = _pair(k1, k2, head_on)
    shift = -_log_meeting(k1, k2, head_on) / 2
    forward = 1.0 if head_on else jnp.sign(k1 - k2)
    return forward * shift / k1, -forward * shift / k2


def _wave_number(name, k):
    k = positive(name, k)
    most = 0.49 * np.log(float(jnp.finfo(k.dtype).max))
    remedy = "For larger k, exp(2k) overflows."
    return require(name, k, lambda k: k <= most, f"numbers below {most:.0f}", remedy)


def _pair(k1, k2, head_on):
    k1 = _wave_number("k1", k1)
    k2 = _wave_number("k2", k2)
    values = _known(k1, k2)
    if not head_on and values and np.any(values[0] == values[1]):
        refuse(
            "k1, k2", "two that differ", show(values[0]), "Two solitons of one speed never meet."
        )
    return k1, k2


# ln of [sinh((k1 - k2)/2)/sinh((k1 + k2)/2)]^2, with cosh in place of sinh for a head-on pair
def _log_meeting(k1, k2, head_on):
    less = jnp.exp(-jnp.abs(k1 - k2))
    more = jnp.exp(-(k1 + k2))
    sign = 1 if head_on else -1
    # the exponential of the larger of k1 and k2 is in both factors and cancels
    return 2 * (jnp.log1p(sign * less) - jnp.log1p(sign * more)) - 2 * jnp.minimum(k1, k2)


# u = ln f_{n-1} - ln f_n, where f = sum over sets S of solitons of A_S exp(-2 sum_S theta_i); all
# terms are positive
@partial(jax.jit, static_argnums=(3,))
def _solitons(n, t, ks, signs, centres, meeting, a, b, m):
    rate = jnp.sqrt(a * b / m)
    # of each set ln A_S - 2 sum_S theta_i, and the sums of k and of its frequencies
    sets = [(0.0, 0.0, 0.0)]
    for k, s, c in zip(ks, signs, centres):
        sets.append((2 * (s * rate * t * jnp.sinh(k) - k * (n - c)), k, s * jnp.sinh(k)))
    if len(ks) > 1:
        sets.append(tuple(map(sum, zip((meeting, 0.0, 0.0), *sets[1:]))))
    logs, k, omega = zip(*sets)
    # weights of the sets at site n; at site n - 1 each is exp(2 k_S) times larger
    p = jax.nn.softmax(jnp.stack(jnp.broadcast_arrays(*logs)), 0)
    strain = jnp.log1p(
        sum(
            4 * p[i] * p[j] * jnp.sinh(k[i] - k[j]) ** 2
            for i, j in combinations(range(len(sets)), 2)
        )
    )
    more = sum(p[i] * jnp.expm1(2 * k[i]) for i in range(1, len(sets)))
    velocity = sum(
        2 * omega[i] * p[i] * (jnp.expm1(2 * k[i]) - more) / (1 + more) for i in range(1, len(sets))
    )
    return strain / b, velocity * rate / b, jnp.log1p(more) / b
