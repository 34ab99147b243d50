"""The result of closed forms on the sites of a chain, and checks of their arguments."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..base.checks import one_of, parameter, positive, refuse, require, show, traced
from ..base.printing import told


class ChainWave(NamedTuple):
    """A wave at sites n and times t, of their broadcast shape.

    - `strain` [m]: y_n = u_n - u_{n+1} of the bond between n and n + 1, compression positive.
    - `velocity` [m/s]: v_n = du_n/dt of site n.
    - `displacement` [m]: u_n, up to a constant.

    **Example:**

    >>> wave = gx.theory.kdv.soliton(jnp.arange(-50.0, 51.0), 0.0, 1.0, 0.5, speed=1.05)
    >>> round(float(wave.strain.max()), 6), abs(float(wave.displacement[-1])) < 1e-12
    (0.3, True)
    """

    strain: jax.Array
    velocity: jax.Array
    displacement: jax.Array
    __repr__ = told


def _numbers(**given):
    return [parameter(name, x) for name, x in given.items()]


# the values of numbers, or `None` where one of them is traced
def _known(*given):
    return None if traced(given) else [np.asarray(x) for x in given]


# `sign`: the sign of the strains, which the quantity `named` sets; `sound`: the speed of sound,
# which the quantities `sound_named` set
def _one_given(given, sound, sign, named, sound_named):
    names = [name for name, x in given.items() if x is not None]
    if len(names) != 1:
        got = ", ".join(names) or "none"
        refuse(", ".join(given), "one of these", got, "Each says how large the wave is.")
    (name,) = names
    array = parameter(name, given[name])
    if traced((array, sound, sign)):
        return name, array
    value = np.asarray(array)
    passes, expected, remedy = {
        "speed": (
            value > sound,
            f"numbers above {show(sound)}, the speed of sound",
            f"A solitary wave is faster than sound, whose speed {sound_named} set.",
        ),
        "amplitude": (
            value * sign > 0,
            f"strains of the sign of {named}",
            "Waves of compression have K3 > 0, waves of rarefaction K3 < 0.",
        ),
        "energy": (value > 0, "numbers above 0", ""),
    }[name]
    if not np.all(passes):
        refuse(name, expected, show(value), remedy)
    return name, array


def _direction_of(direction):
    return 1.0 if one_of("direction", direction, ("right", "left")) == "right" else -1.0


def _stiffnesses(K2, K3, mass, remedy):
    K2 = positive("K2", K2, "A chain without linear stiffness has no sound.")
    K3 = parameter("K3", K3)
    mass = positive("mass", mass)
    return K2, require("K3", K3, lambda K3: K3 != 0, "numbers other than zero", remedy), mass


# 1/cosh x without overflow and without a kink
def _sech(x):
    return 2 * jnp.exp(-(jax.nn.softplus(2 * x) + jax.nn.softplus(-2 * x)) / 2)


# sinh x - x without cancellation at small x
def _sinh_less(x):
    square = x * x
    series = 1.0
    for k in range(8, 0, -1):
        series = 1 + square / ((2 * k + 2) * (2 * k + 3)) * series
    near = jnp.abs(x) < 1
    return jnp.where(near, x * square / 6 * series, jnp.sinh(jnp.where(near, 1.0, x)) - x)


def _toda_constants(strength, rate, mass):
    a, b, m = _numbers(strength=strength, rate=rate, mass=mass)
    positive("mass", m)
    signs = _known(a, b)
    if signs and not np.all(signs[0] * signs[1] > 0):
        got = " and ".join(map(show, signs))
        refuse("strength, rate", "two numbers of one sign, not zero", got)
    return a, b, m
