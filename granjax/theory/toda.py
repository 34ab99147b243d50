r"""The Toda chain in closed form: m u_n'' = a exp(b (u_{n-1} - u_n)) - a exp(b (u_n - u_{n+1})).

With a = `strength`, b = `rate`, m = `mass`; force a (exp(b y) - 1) of the strain y_n = u_n - u_{n+1}, as `laws.Toda`.
Time is counted in (m/(a b))^{1/2}, strain and displacement in 1/b, energy in a/b; sound runs at (a b/m)^{1/2} sites a
unit time. Any law F = K2 y + K3 y^2 + ... is near a Toda chain, with the constants that `matched` gives. Both a and b
may be negative: then the waves are of rarefaction, as in a law with K3 < 0.

One soliton: exp(b y_n) - 1 = sinh^2 k sech^2(k (n - n0) -+ (a b/m)^{1/2} t sinh k); it moves sinh k/k times as fast as
sound, and its wave number k [1/site] sets all else. Several of them, and periodic waves, as R. Hirota and H. Flaschka
found them: every function below is exact, in arrays that broadcast, differentiable in both modes in all its numbers.

Source: M. Toda, Theory of Nonlinear Lattices (Springer, 1989); R. Hirota, J. Phys. Soc. Jpn. 35, 286 (1973);
H. Flaschka, Phys. Rev. B 9, 1924 (1974); G. Biondini, C. Chong, P. Kevrekidis, Physica D 469, 134315 (2024).
"""

from functools import partial
from itertools import combinations
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..checks import broadcast, concrete, one_of, parameter, positive, refuse, show
from ..entry import checked
from ..printing import told
from ..types import Numbers, Parameter
from .chain_wave import ChainWave, _direction_of, _numbers, _one_given, _sinh_less, _stiffnesses
from .elliptic import _K, _RF, _jacobi, _log_theta, _zeta

__all__ = [
    "ChainWave", "PeriodicNumbers", "TodaConstants", "amplitude", "energy", "lax_eigenvalues", "matched",
    "periodic_numbers", "periodic_wave", "phase_shifts", "soliton", "speed", "two_solitons", "wavenumber",
]

# of the inversion of a monotonic function from a guess that is never far
NEWTON = 9


class TodaConstants(NamedTuple):
    """`strength` a [N] and `rate` b [1/m] of a Toda chain."""

    strength: jax.Array
    rate: jax.Array
    __repr__ = told


@checked
def matched(K2: Parameter, K3: Parameter) -> TodaConstants:
    """The Toda chain of the same K2 and K3: b = 2 K3/K2, a = K2^2/(2 K3).

    **Arguments:** of any law, `granjax.laws.taylor(law)`. **Raises** ValueError for K2 <= 0 and for K3 = 0, which no
    Toda chain has. Typical: Hertz with d0 = A = 1, K2 = 3/2, K3 = 3/8: a = 3, b = 1/2.
    """
    K2, K3, _ = _stiffnesses(K2, K3, 1.0, "Every Toda chain is stiffer one way than the other.")
    return TodaConstants(K2**2 / (2 * K3), 2 * K3 / K2)


# ------------------------------------------------------------------------------------------------------------ solitons


@checked
def speed(k: Parameter, *, strength: Parameter = 1.0, rate: Parameter = 1.0, mass: Parameter = 1.0) -> Numbers:
    """Speed of a soliton, sinh k/k times that of sound (a b/m)^{1/2} [sites/s]. **Arguments:** `k` > 0 [1/site]."""
    k, (a, b, m) = positive("k", k), _constants(strength, rate, mass)
    return jnp.sqrt(a * b / m) * (1 + _sinh_less(k) / k)


@checked
def amplitude(k: Parameter, *, rate: Parameter = 1.0) -> Numbers:
    """Largest strain of a soliton, 2 ln(cosh k)/b. **Arguments:** `k` > 0 [1/site]; `rate`: b, not zero."""
    k, b = _numbers(k=positive("k", k), rate=rate)
    _constants(b, b, 1.0)
    return jnp.log1p(jnp.sinh(k) ** 2) / b


@checked
def energy(k: Parameter, *, strength: Parameter = 1.0, rate: Parameter = 1.0) -> Numbers:
    """Energy of a soliton, (sinh 2k - 2k) a/b. **Arguments:** `k` > 0 [1/site]."""
    k, (a, b, _) = positive("k", k), _constants(strength, rate, 1.0)
    return a / b * _sinh_less(2 * k)


@checked
def wavenumber(
    *, speed: Parameter | None = None, amplitude: Parameter | None = None, energy: Parameter | None = None,
    strength: Parameter = 1.0, rate: Parameter = 1.0, mass: Parameter = 1.0,
) -> Numbers:
    """Wave number k of the soliton of a given speed, amplitude or energy: the inverse of those functions.

    **Arguments:** one of `speed` [sites/s], `amplitude` [m], of the sign of b, `energy` [J].
    **Raises** ValueError for none or several, a speed not above that of sound, an amplitude of the wrong sign.
    """
    a, b, m = _constants(strength, rate, mass)
    sound = jnp.sqrt(a * b / m)
    given = {"speed": speed, "amplitude": amplitude, "energy": energy}
    if amplitude is not None:
        amplitude = given["amplitude"] = parameter("amplitude", amplitude)
        values = concrete(amplitude), concrete(b)
        if all(x is not None for x in values) and np.any(values[0] * values[1] <= 0):
            refuse("amplitude", "strains of the sign of the rate", show(values[0]),
                   "Waves of compression have K3 > 0, waves of rarefaction K3 < 0.")
    name, value = _one_given(given, {"speed": sound, "amplitude": -np.inf, "energy": 0.0},
                              "strength, rate and mass")
    return _wavenumber(name, value * {"speed": 1 / sound, "amplitude": b, "energy": b / a}[name])


@partial(jax.jit, static_argnums=0)
def _wavenumber(name, value):
    if name == "amplitude":
        more = jnp.expm1(value / 2)
        return jnp.log1p(more + jnp.sqrt(more * (more + 2)))
    target = jnp.log(value)
    if name == "speed":
        return _solved(lambda k: jnp.log1p(_sinh_less(k) / k), target, target + jnp.sqrt(6 * target))
    small = value < 1
    guess = jnp.where(small, jnp.cbrt(6 * jnp.where(small, value, 1.0)), jnp.arcsinh(value + 2 * jnp.arcsinh(value)))
    return _solved(lambda x: jnp.log(_sinh_less(x)), target, guess) / 2


def _solved(function, target, x):
    def nearer(_, x):
        value, slope = jax.jvp(function, (x,), (jnp.ones_like(x),))
        return x - (value - target) / slope

    return jax.lax.fori_loop(0, NEWTON, nearer, x)


@checked
def soliton(
    n: Parameter, t: Parameter, k: Parameter, *, centre: Parameter = 0.0, direction: str = "right",
    strength: Parameter = 1.0, rate: Parameter = 1.0, mass: Parameter = 1.0,
) -> ChainWave:
    """One soliton, exp(b y) - 1 = sinh^2 k sech^2(k (n - centre) -+ (a b/m)^{1/2} t sinh k).

    **Arguments:**

    - `n`, `t`: sites and times, arrays that broadcast, `n[:, None]` and `t` for all of both.
    - `k` > 0: wave number [1/site]; see `wavenumber`.
    - `centre`: bond of the crest at t = 0, where bond n lies between the sites n and n + 1; need not be whole.
    - `direction`: "right" or "left".

    **Returns:** `ChainWave` of strain, velocity and displacement, which is zero far to the right, and 2k/b far to the
    left: the sum of all strains. **Raises** ValueError for k <= 0, and constants that no Toda chain has.
    """
    sign, k = _direction_of(direction), positive("k", k)
    n, t, k, centre = _numbers(n=n, t=t, k=k, centre=centre)
    return ChainWave(*_solitons(n, t, (k,), (sign,), (centre,), (), *_constants(strength, rate, mass)))


@checked
def two_solitons(
    n: Parameter, t: Parameter, k1: Parameter, k2: Parameter, *, centre1: Parameter, centre2: Parameter,
    head_on: bool = False, strength: Parameter = 1.0, rate: Parameter = 1.0, mass: Parameter = 1.0,
) -> ChainWave:
    """Two solitons that pass through each other.

    The first runs to the right, the second as well, or to the left where `head_on`. **Arguments:** as `soliton`;
    `centre1`, `centre2`: where the crests would be at t = 0 had they never met: before they meet they are at
    centre + speed t, afterwards by `phase_shifts` further. **Raises** ValueError as `soliton`, and where k1 = k2 of two
    that run the same way, which never meet.
    """
    k1, k2 = _pair(k1, k2, head_on)
    n, t, k1, k2, centre1, centre2 = _numbers(n=n, t=t, k1=k1, k2=k2, centre1=centre1, centre2=centre2)
    meeting = _log_meeting(k1, k2, head_on)
    # before they meet, the one behind feels the other as passed
    behind = (True, False) if head_on else (k1 > k2, k1 < k2)
    starts = tuple(c - jnp.where(first, meeting / (2 * k), 0.0) for c, first, k in
                   ((centre1, behind[0], k1), (centre2, behind[1], k2)))
    signs = 1.0, -1.0 if head_on else 1.0
    return ChainWave(*_solitons(n, t, (k1, k2), signs, starts, (meeting,), *_constants(strength, rate, mass)))


@checked
def phase_shifts(k1: Parameter, k2: Parameter, *, head_on: bool = False) -> tuple[Numbers, Numbers]:
    r"""By how many sites two solitons are further along n after they have met than they would be alone.

    One that overtakes the other: (1/k_i) ln[sinh((k1 + k2)/2)/sinh(|k1 - k2|/2)], forward for the faster, backward
    for the slower. `head_on`, the first to the right and the second to the left: (1/k_i) ln[cosh((k1 + k2)/2)/
    cosh((k1 - k2)/2)], both forward along their own ways, so that the second's is negative.

    **Returns:** the two shifts. **Raises** ValueError for k <= 0 and for k1 = k2 of two that run the same way.
    Typical: k = 1 and 0.5 +1.18027, -2.36054; head-on +0.22734, -0.45467.
    """
    k1, k2 = _pair(k1, k2, head_on)
    shift = -_log_meeting(k1, k2, head_on) / 2
    forward = 1.0 if head_on else jnp.sign(k1 - k2)
    return forward * shift / k1, -forward * shift / k2


def _constants(strength, rate, mass):
    a, b, m = _numbers(strength=strength, rate=rate, mass=mass)
    positive("mass", m)
    signs = concrete(a), concrete(b)
    if all(x is not None for x in signs) and not np.all(signs[0] * signs[1] > 0):
        refuse("strength, rate", "two numbers of one sign, not zero", f"{show(signs[0])} and {show(signs[1])}")
    return a, b, m


def _pair(k1, k2, head_on):
    k1, k2 = positive("k1", k1), positive("k2", k2)
    broadcast(k1=k1, k2=k2)
    values = concrete(k1), concrete(k2)
    if not head_on and all(x is not None for x in values) and np.any(values[0] == values[1]):
        refuse("k1, k2", "two that differ", show(values[0]), "Two solitons of one speed never meet.")
    return k1, k2


def _log_meeting(k1, k2, head_on):
    """ln of the factor of a pair: [sinh((k1 - k2)/2)/sinh((k1 + k2)/2)]^2, with cosh for two that run head-on."""
    less, more, sign = jnp.exp(-jnp.abs(k1 - k2)), jnp.exp(-(k1 + k2)), 1 if head_on else -1
    # the larger of k1, k2 enters both: its exponential is left out
    return 2 * (jnp.log1p(sign * less) - jnp.log1p(sign * more)) - 2 * jnp.minimum(k1, k2)


@partial(jax.jit, static_argnums=(3,))
def _solitons(n, t, ks, signs, centres, meetings, a, b, m):
    r"""u = ln f_{n-1} - ln f_n, f = sum over sets S of solitons of A_S exp(-2 sum_S theta_i); all terms positive."""
    rate = jnp.sqrt(a * b / m)
    phases = [2 * (s * rate * t * jnp.sinh(k) - k * (n - c)) for k, s, c in zip(ks, signs, centres)]
    sets = [(), *[(i,) for i in range(len(ks))], *([tuple(range(len(ks)))] if len(ks) > 1 else [])]
    log = lambda S: sum((phases[i] for i in S), sum(meetings) if len(S) > 1 else 0.0)
    total = lambda S, x: sum((x[i] for i in S), 0.0)
    logs = jnp.stack(jnp.broadcast_arrays(*map(log, sets)))
    # weights of the sets at site n; one site earlier each weighs exp(2 k_S) as much
    p = jax.nn.softmax(logs, 0)
    k, omega = [total(S, ks) for S in sets], [total(S, [s * jnp.sinh(k) for k, s in zip(ks, signs)]) for S in sets]
    strain = jnp.log1p(sum(4 * p[i] * p[j] * jnp.sinh(k[i] - k[j]) ** 2 for i, j in combinations(range(len(sets)), 2)))
    more = sum(p[i] * jnp.expm1(2 * k[i]) for i in range(1, len(sets)))
    velocity = sum(2 * omega[i] * p[i] * (jnp.expm1(2 * k[i]) - more) / (1 + more) for i in range(1, len(sets)))
    return strain / b, velocity * rate / b, jnp.log1p(more) / b


# ------------------------------------------------------------------------------------------------------- periodic waves


class PeriodicNumbers(NamedTuple):
    """What the four numbers of a periodic wave say of it.

    - `wavelength` [sites], `period` [s], both infinite of a soliton; `speed` of its crests [sites/s].
    - `m1`: 1 less the parameter of its elliptic functions: 0 of a soliton, 1 of a wave without amplitude.
    - `mean_strain` [m], `mean_velocity` [m/s]; `crest`, `trough`: largest and smallest strain (for b > 0).
    """

    wavelength: jax.Array
    period: jax.Array
    speed: jax.Array
    m1: jax.Array
    mean_strain: jax.Array
    mean_velocity: jax.Array
    crest: jax.Array
    trough: jax.Array
    __repr__ = told


@checked
def periodic_wave(
    n: Parameter, t: Parameter, E1: Parameter, E2: Parameter, E3: Parameter, E4: Parameter, *,
    centre: Parameter = 0.0, strength: Parameter = 1.0, rate: Parameter = 1.0, mass: Parameter = 1.0,
) -> ChainWave:
    r"""The four-parameter family of periodic travelling waves, in scaled numbers (a = b = m = 1).

        exp y_n = (E4 - E3 + E2 - E1)^2/4 + (E3 - E2)(E4 - E1) cn^2(z_n, m),   z_n = 2 F (n - centre) - omega t,
        v_n = E1 + E2 + E3 + E4 - 2 mu_n,   mu_n = (E2 - E1 B sn^2)/(1 - B sn^2) of (z_n - F, m),

    m = (E3 - E2)(E4 - E1)/((E4 - E2)(E3 - E1)), omega = ((E4 - E2)(E3 - E1))^{1/2}, B = (E3 - E2)/(E3 - E1), and F the
    incomplete integral of arcsin ((E4 - E2)/(E4 - E1))^{1/2}. It is equal to the usual formula for y by mu and the root
    of (mu - E1)(mu - E2)(mu - E3)(mu - E4), and needs no sign.

    **Arguments:** `n`, `t`, `centre`: as `soliton`; E1 < E2 <= E3 <= E4, E2 < E4: the ends of the bands of the Lax
    matrix, which of a chain at rest are -1 and 1. E3 = E4 is a soliton on a chain of uniform strain and velocity, E2 =
    E3 such a chain alone. A number added to all four adds twice of it to the velocity. **Returns:** `ChainWave`; the
    displacement has -(mean strain) n + (mean velocity) t in it, which `periodic_numbers` gives.
    **Raises** ValueError for numbers in another order. Source: Biondini, Chong, Kevrekidis (2024), with the sign of
    omega t of a wave that runs to the right, and mu + b = (E1 + E2 + E3 + E4)/2.
    """
    Es = _ends(E1, E2, E3, E4)
    n, t, centre, _ = _numbers(n=n, t=t, centre=centre, E1=sum(Es))
    return ChainWave(*_periodic(n, t, centre, Es, *_constants(strength, rate, mass)))


@checked
def periodic_numbers(
    E1: Parameter, E2: Parameter, E3: Parameter, E4: Parameter, *,
    strength: Parameter = 1.0, rate: Parameter = 1.0, mass: Parameter = 1.0,
) -> PeriodicNumbers:
    """Wavelength, period, speed and means of `periodic_wave`. **Arguments**, **Raises**: as there.

    A wavelength between 1 and 2 sites is that of a wave to the left, in which sites see a longer one, 1/(1 - 1/it).
    """
    a, b, m = _constants(strength, rate, mass)
    return PeriodicNumbers(*_of_ends(_ends(E1, E2, E3, E4), a, b, m))


def _ends(*Es):
    arrays = _numbers(**{f"E{i}": E for i, E in enumerate(Es, 1)})
    values = [concrete(E) for E in arrays]
    if all(x is not None for x in values):
        one, two, three, four = values
        if not np.all((one < two) & (two <= three) & (three <= four) & (two < four)):
            refuse("E1, E2, E3, E4", "E1 < E2 <= E3 <= E4, and E2 < E4", ", ".join(map(show, values)))
    return tuple(arrays)


def _shape(E1, E2, E3, E4):
    """m1, omega, F and the coefficients of exp y and of mu, of the ends of the bands."""
    square = (E4 - E2) * (E3 - E1)
    m1 = (E2 - E1) * (E4 - E3) / square
    s, c, d = jnp.sqrt((E4 - E2) / (E4 - E1)), jnp.sqrt((E2 - E1) / (E4 - E1)), jnp.sqrt((E2 - E1) / (E3 - E1))
    return m1, jnp.sqrt(square), s * _RF(c, d, 1.0), ((E4 - E3 + E2 - E1) / 2) ** 2, (E3 - E2) * (E4 - E1)


def _mean_velocity(E1, E2, E3, E4):
    m1, omega, F, *_ = _shape(E1, E2, E3, E4)
    return E1 + E3 + E4 - E2 - 2 * omega * _zeta(F, m1)


def _mean_strain(*Es):
    m1, _, F, bottom, depth = _shape(*Es)
    return jnp.log(bottom + depth) - 2 * _log_theta(2 * F, m1)


@jax.jit
def _periodic(n, t, centre, Es, a, b, m):
    (E1, E2, E3, E4), rate = Es, jnp.sqrt(a * b / m)
    m1, omega, F, bottom, depth = _shape(*Es)
    z, m1 = jnp.broadcast_arrays(2 * F * (n - centre) - omega * rate * t, m1)
    strain = jnp.log(bottom + depth * _jacobi(z, m1)[1] ** 2)
    s, c, _ = _jacobi(z - F, m1)
    velocity = E2 + E3 + E4 - E1 - 2 * (E2 - E1) / (c * c + (E2 - E1) / (E3 - E1) * s * s)
    drift = _mean_velocity(*Es) * rate * t - _mean_strain(*Es) * n
    displacement = _log_theta(z - 2 * F, m1) - _log_theta(z, m1) + drift
    return strain / b, velocity * rate / b, displacement / b


@jax.jit
def _of_ends(Es, a, b, m):
    rate = jnp.sqrt(a * b / m)
    m1, omega, F, bottom, depth = _shape(*Es)
    K = _K(m1)
    return (K / F, 2 * K / (omega * rate), omega * rate / (2 * F), m1, _mean_strain(*Es) / b,
            _mean_velocity(*Es) * rate / b, jnp.log(bottom + depth) / b, jnp.log(bottom) / b)


# --------------------------------------------------------------------------------------------------------- Lax's matrix


@checked
def lax_eigenvalues(
    strain: Parameter, velocity: Parameter, *, boundary: str = "free",
    strength: Parameter = 1.0, rate: Parameter = 1.0, mass: Parameter = 1.0,
) -> Numbers:
    r"""Eigenvalues of the Lax matrix of N sites, ascending: v_n/2 on its diagonal, exp(y_n/2)/2 beside it (scaled).

    A Toda ring keeps all of them, in time and whatever its solitons do; so does a chain whose ends are far from what
    moves. A chain at rest fills [-1, 1]; each soliton has one beyond, cosh k to the right and -cosh k to the left.

    **Arguments:** `strain` [m]: (N - 1,) of the bonds of a `"free"` chain, or (N,) of a `"periodic"` one, whose last
    bond leads from the last site to the first; `velocity` [m/s]: (N,); lanes after the sites. With a lattice:
    `measures.strain(lattice, y)`, `y.v`. **Returns:** (N, *lanes). Forces at free ends, such as that of a static
    load, are no part of the matrix: it is kept as long as the ends stay at rest.
    **Raises** ValueError for shapes that do not fit, fewer than two sites (three on a ring).
    Source: H. Flaschka, Phys. Rev. B 9, 1924 (1974).
    """
    ring = one_of("boundary", boundary, ("free", "periodic")) == "periodic"
    strain, velocity = parameter("strain", strain), parameter("velocity", velocity)
    least = 3 if ring else 2
    if velocity.ndim == 0 or len(velocity) < least:
        refuse("velocity", f"an array over {least} sites or more", f"shape {velocity.shape}")
    wanted = (len(velocity) - (not ring), *velocity.shape[1:])
    if strain.shape != wanted:
        refuse("strain", f"shape {wanted}, for a velocity of shape {velocity.shape}", f"shape {strain.shape}")
    a, b, m = _constants(strength, rate, mass)
    for name, x in (("strength", a), ("rate", b), ("mass", m)):
        if x.shape not in ((), velocity.shape[1:]):
            refuse(name, "one number, or one per lane", f"shape {x.shape}")
    return _eigenvalues(strain, velocity, ring, a, b, m)


@partial(jax.jit, static_argnums=2)
def _eigenvalues(strain, velocity, ring, a, b, m):
    beside, on = jnp.exp(b * strain / 2) / 2, b * velocity / (2 * jnp.sqrt(a * b / m))
    lanes, i = on.shape[1:], np.arange(len(on))
    matrix = jnp.zeros((len(on), len(on), *lanes), on.dtype).at[i, i].set(on)
    j = i if ring else i[:-1]
    k = (j + 1) % len(on)
    matrix = matrix.at[j, k].set(beside).at[k, j].set(beside)
    return jnp.moveaxis(jnp.linalg.eigvalsh(jnp.moveaxis(matrix, (0, 1), (-2, -1))), -1, 0)
