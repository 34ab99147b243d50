"""Periodic waves of the Toda chain, and the eigenvalues of its Lax matrix; public in `toda`."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..base.checks import one_of, parameter, per_lane, refuse, show
from ..base.printing import told
from ..base.types import Numbers, Parameter
from .chain_wave import ChainWave, _known, _numbers, _toda_constants
from .elliptic_functions import _K, _RF, _jacobi, _log_theta, _zeta


class PeriodicNumbers(NamedTuple):
    """The properties of the periodic wave of four numbers E1, E2, E3, E4.

    - `wavelength` [sites], `period` [s]: infinite for a soliton. `speed`: of the crests [sites/s].
    - `m1`: 1 - m of the elliptic functions: 0 for a soliton, 1 for a wave of zero amplitude.
    - `mean_strain` [m], `mean_velocity` [m/s].
    - `crest`, `trough` [m]: the largest and smallest strain (for b > 0).

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
    r"""Return the four-parameter periodic travelling wave of the Toda chain.

    In scaled quantities (a = b = m = 1)

        exp y_n = (E4 - E3 + E2 - E1)^2/4 + (E3 - E2)(E4 - E1) cn^2(z_n, m),
        z_n = 2 F (n - centre) - omega t,
        v_n = E1 + E2 + E3 + E4 - 2 mu_n,
        mu_n = (E2 - E1 B sn^2)/(1 - B sn^2) of (z_n - F, m),

    with m = (E3 - E2)(E4 - E1)/((E4 - E2)(E3 - E1)), omega = ((E4 - E2)(E3 - E1))^{1/2},
    B = (E3 - E2)/(E3 - E1), and F the incomplete integral of arcsin ((E4 - E2)/(E4 - E1))^{1/2}.

    **Arguments:**

    - `n`, `t`, `centre`: as `soliton`.
    - E1 < E2 <= E3 <= E4, E2 < E4: the ends of the bands of the Lax matrix, -1 and 1 for a chain at
      rest. E3 = E4 is a soliton on a chain of uniform strain and velocity, where means and
      displacement are differentiable only along E3 = E4; E2 = E3 is the uniform chain alone.
      A number added to all four adds twice itself to the velocity.

    **Returns:** `ChainWave`. The displacement contains -(mean strain) n + (mean velocity) t, with
    the means of `periodic_numbers`.

    **Raises** ValueError for numbers in another order.

    Source: Biondini, Chong, Kevrekidis (2024); here the sign of omega t is that of a wave to the
    right, and mu + b = (E1 + E2 + E3 + E4)/2.

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
    """Return the wavelength, period, speed and means of `periodic_wave`.

    **Arguments**, **Raises**: as `periodic_wave`. A wavelength L between 1 and 2 sites is that of a
    wave to the left, which looks longer when it is sampled at the sites: 1/(1 - 1/L).

    **Example:**

    >>> numbers = gx.theory.toda.periodic_numbers(-1.0, 0.0, 0.0, 1.0)  # a uniform chain
    >>> round(float(numbers.mean_strain), 6), round(float(numbers.speed), 6)
    (0.0, 0.63662)
    """
    a, b, m = _toda_constants(strength, rate, mass)
    return PeriodicNumbers(*_of_ends(_ends(E1, E2, E3, E4), a, b, m))


def _ends(*Es):
    arrays = _numbers(**{f"E{i}": E for i, E in enumerate(Es, 1)})
    values = _known(*arrays)
    if values:
        one, two, three, four = values
        if not np.all((one < two) & (two <= three) & (three <= four) & (two < four)):
            refuse(
                "E1, E2, E3, E4", "E1 < E2 <= E3 <= E4, and E2 < E4", ", ".join(map(show, values))
            )
    return tuple(arrays)


# m1, omega, F, and the coefficients of exp y = bottom + depth cn^2
def _shape(E1, E2, E3, E4):
    square = (E4 - E2) * (E3 - E1)
    m1 = (E2 - E1) * (E4 - E3) / square
    s = jnp.sqrt((E4 - E2) / (E4 - E1))
    c = jnp.sqrt((E2 - E1) / (E4 - E1))
    d = jnp.sqrt((E2 - E1) / (E3 - E1))
    return (
        m1,
        jnp.sqrt(square),
        s * _RF(c, d),
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
    E1, E2, E3, E4 = Es
    rate = jnp.sqrt(a * b / m)
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
    r"""Return the eigenvalues of the Lax matrix of N sites, in ascending order.

    In scaled quantities the matrix has v_n/2 on its diagonal and exp(y_n/2)/2 beside it.

    A Toda ring conserves all eigenvalues; so does a chain whose ends are far from any motion. A
    chain at rest fills [-1, 1]. Each soliton adds one outside: cosh k to the right, -cosh k to the
    left. Sums of powers of the eigenvalues are integrals of the motion; their histogram is the
    density of states.

    **Arguments:**

    - `strain` [m]: (N - 1,) for a `"free"` chain; (N,) for a `"periodic"` one, whose last bond
      joins the last site to the first.
    - `velocity` [m/s]: (N,). Lanes come after the sites.

    For a lattice: `measures.strain(lattice, y)`, `y.v`; frames of a run count as lanes, `run.vs.T`.

    **Returns:** (N, *lanes). Forces on free ends, such as a static load, are not in the matrix: the
    eigenvalues are conserved only while the ends rest.

    **Raises** ValueError for shapes that do not fit and for fewer than two sites (three on a ring).

    Source: H. Flaschka, Phys. Rev. B 9, 1924 (1974).

    **Example:**

    >>> wave = gx.theory.toda.soliton(jnp.arange(-20.0, 21.0), 0.0, 1.0)
    >>> values = gx.theory.toda.lax_eigenvalues(wave.strain[:-1], wave.velocity)
    >>> round(float(values[-1]), 6)  # cosh 1
    1.543081
    """
    ring = one_of("boundary", boundary, ("free", "periodic")) == "periodic"
    strain = parameter("strain", strain)
    velocity = parameter("velocity", velocity)
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
        per_lane(name, x, velocity.shape[1:])
    return _eigenvalues(strain, velocity, ring, a, b, m)


@partial(jax.jit, static_argnums=2)
def _eigenvalues(strain, velocity, ring, a, b, m):
    beside = jnp.exp(b * strain / 2) / 2
    on = b * velocity / (2 * jnp.sqrt(a * b / m))
    lanes = on.shape[1:]
    i = np.arange(len(on))
    matrix = jnp.zeros((len(on), len(on), *lanes), on.dtype).at[i, i].set(on)
    j = i if ring else i[:-1]
    k = (j + 1) % len(on)
    matrix = matrix.at[j, k].set(beside).at[k, j].set(beside)
    return jnp.moveaxis(jnp.linalg.eigvalsh(jnp.moveaxis(matrix, (0, 1), (-2, -1))), -1, 0)
