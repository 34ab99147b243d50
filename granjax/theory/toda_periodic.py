"""Periodic waves of the Toda chain, and the eigenvalues of its Lax matrix; `toda` is their face."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..checks import concrete, one_of, parameter, refuse, show
from ..printing import told
from ..types import Numbers, Parameter
from .chain_wave import ChainWave, _numbers, _toda_constants
from .elliptic_functions import _jacobi, _log_theta, _zeta
from .elliptic_integrals import _K, _RF


class PeriodicNumbers(NamedTuple):
    """What the four numbers of a periodic wave say of it.

    - `wavelength` [sites], `period` [s], both infinite of a soliton; `speed` of its crests [sites/s].
    - `m1`: 1 less the parameter of its elliptic functions: 0 of a soliton, 1 of a wave without amplitude.
    - `mean_strain` [m], `mean_velocity` [m/s]; `crest`, `trough`: largest and smallest strain (for b > 0).

    **Example:**

    >>> numbers = gx.theory.toda.periodic_numbers(-1.5, -0.5, 0.5, 1.5)
    >>> round(float(numbers.wavelength), 6), round(float(numbers.m1), 6)
    (2.0, 0.25)
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


def periodic_wave(
    n: Parameter,
    t: Parameter,
    E1: Parameter,
    E2: Parameter,
    E3: Parameter,
    E4: Parameter,
    *,
    centre: Parameter = 0.0,
    strength: Parameter = 1.0,
    rate: Parameter = 1.0,
    mass: Parameter = 1.0,
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

    **Example:**

    >>> wave = gx.theory.toda.periodic_wave(0.0, 0.0, -1.5, -0.5, 0.5, 1.5)  # at a crest
    >>> round(float(wave.strain), 6)  # 2 ln 2
    1.386294
    """
    Es = _ends(E1, E2, E3, E4)
    n, t, centre = _numbers(n=n, t=t, centre=centre)
    return ChainWave(*_periodic(n, t, centre, Es, *_toda_constants(strength, rate, mass)))


def periodic_numbers(
    E1: Parameter,
    E2: Parameter,
    E3: Parameter,
    E4: Parameter,
    *,
    strength: Parameter = 1.0,
    rate: Parameter = 1.0,
    mass: Parameter = 1.0,
) -> PeriodicNumbers:
    """Wavelength, period, speed and means of `periodic_wave`. **Arguments**, **Raises**: as there.

    A wavelength between 1 and 2 sites is that of a wave to the left, in which sites see a longer one, 1/(1 - 1/it).

    **Example:**

    >>> numbers = gx.theory.toda.periodic_numbers(-1.0, 0.0, 0.0, 1.0)  # a uniform chain
    >>> round(float(numbers.mean_strain), 6), round(float(numbers.speed), 6)
    (0.0, 0.63662)
    """
    a, b, m = _toda_constants(strength, rate, mass)
    return PeriodicNumbers(*_of_ends(_ends(E1, E2, E3, E4), a, b, m))


def _ends(*Es):
    arrays = _numbers(**{f"E{i}": E for i, E in enumerate(Es, 1)})
    values = [concrete(E) for E in arrays]
    if all(x is not None for x in values):
        one, two, three, four = values
        if not np.all((one < two) & (two <= three) & (three <= four) & (two < four)):
            refuse(
                "E1, E2, E3, E4", "E1 < E2 <= E3 <= E4, and E2 < E4", ", ".join(map(show, values))
            )
    return tuple(arrays)


def _shape(E1, E2, E3, E4):
    """m1, omega, F and the coefficients of exp y and of mu, of the ends of the bands."""
    square = (E4 - E2) * (E3 - E1)
    m1 = (E2 - E1) * (E4 - E3) / square
    s, c, d = (
        jnp.sqrt((E4 - E2) / (E4 - E1)),
        jnp.sqrt((E2 - E1) / (E4 - E1)),
        jnp.sqrt((E2 - E1) / (E3 - E1)),
    )
    return (
        m1,
        jnp.sqrt(square),
        s * _RF(c, d, 1.0),
        ((E4 - E3 + E2 - E1) / 2) ** 2,
        (E3 - E2) * (E4 - E1),
    )


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
    return (
        K / F,
        2 * K / (omega * rate),
        omega * rate / (2 * F),
        m1,
        _mean_strain(*Es) / b,
        _mean_velocity(*Es) * rate / b,
        jnp.log(bottom + depth) / b,
        jnp.log(bottom) / b,
    )


# --------------------------------------------------------------------------------------------------------- Lax's matrix


def lax_eigenvalues(
    strain: Parameter,
    velocity: Parameter,
    *,
    boundary: str = "free",
    strength: Parameter = 1.0,
    rate: Parameter = 1.0,
    mass: Parameter = 1.0,
) -> Numbers:
    r"""Eigenvalues of the Lax matrix of N sites, ascending: v_n/2 on its diagonal, exp(y_n/2)/2 beside it (scaled).

    A Toda ring keeps all of them, in time and whatever its solitons do; so does a chain whose ends are far from what
    moves. A chain at rest fills [-1, 1]; each soliton has one beyond, cosh k to the right and -cosh k to the left.

    **Arguments:** `strain` [m]: (N - 1,) of the bonds of a `"free"` chain, or (N,) of a `"periodic"` one, whose last
    bond leads from the last site to the first; `velocity` [m/s]: (N,); lanes after the sites. With a lattice:
    `measures.strain(lattice, y)`, `y.v`; frames of a run count as lanes, `run.vs.T`. Integrals of the motion are the
    sums of powers of the eigenvalues, and their histogram is the density of states. **Returns:** (N, *lanes). Forces at
    free ends, such as that of a static load, are no part of the matrix: it is kept as long as the ends stay at rest.
    **Raises** ValueError for shapes that do not fit, fewer than two sites (three on a ring).
    Source: H. Flaschka, Phys. Rev. B 9, 1924 (1974).

    **Example:**

    >>> wave = gx.theory.toda.soliton(jnp.arange(-20.0, 21.0), 0.0, 1.0)
    >>> values = gx.theory.toda.lax_eigenvalues(wave.strain[:-1], wave.velocity)
    >>> round(float(values[-1]), 6)  # cosh 1
    1.543081
    """
    ring = one_of("boundary", boundary, ("free", "periodic")) == "periodic"
    strain, velocity = parameter("strain", strain), parameter("velocity", velocity)
    least = 3 if ring else 2
    if velocity.ndim == 0 or len(velocity) < least:
        refuse("velocity", f"an array over {least} sites or more", f"shape {velocity.shape}")
    wanted = (len(velocity) - (not ring), *velocity.shape[1:])
    if strain.shape != wanted:
        refuse(
            "strain",
            f"shape {wanted}, for a velocity of shape {velocity.shape}",
            f"shape {strain.shape}",
        )
    a, b, m = _toda_constants(strength, rate, mass)
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
