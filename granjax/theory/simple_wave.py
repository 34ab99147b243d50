r"""Simple waves of any law: the state behind a velocity step, and the rarefaction fan.

Long waves obey m y_tt = F(y)_nn. Along a wave that runs one way, v - int V dy is constant, where
V(y) = (F'(y)/m)^{1/2} is the speed of sound [sites/s]. Two halves of a chain with v_n = -2c sign(n)
therefore meet at the strain y_- with

    int_ahead^{y_-} V dy = 2c.

If V falls from the strain ahead to y_-, the wave is a fan, V(y(n/t)) = |n|/t for V_- < |n|/t < V_+.
If V rises, the wave is a dispersive shock (`shock_edges`). Its plateau is exactly y_- for the Toda
chain and nearly so for other laws: for precompressed Hertz (d0 = 1/2, sound 1) and c = 0.1, 0.3,
0.5, y_- is 9e-6, 2e-4, 7e-4 above the simulated plateau.

    import matplotlib.pyplot as plt
    import numpy as np
    n, t = np.arange(-100, 100), 80.0
    y = gx.theory.simple_wave.fan(n / t, gx.Toda(), -0.2)
    plt.plot(n, y)

Source: G. B. Whitham, Linear and Nonlinear Waves (Wiley, 1974).
"""

import jax
import jax.numpy as jnp
import numpy as np

from ..base.checks import known_value, parameter, refuse
from ..base.derivatives import with_slope
from ..base.programs import compiled
from ..base.types import Numbers, Parameter, Scalar
from ..lattice import Lattice
from ..laws import Law
from .simple_states import _path_to, _slopes_at, _width_of

# the steps of the bisection for the place of each speed in a fan
HALVINGS = 60


def mean(law: Law | Lattice, c: Scalar, mass: Scalar = 1.0, *, ahead: Scalar = 0.0) -> Numbers:
    """Return the strain behind the waves of v_n = -2c sign(n), with an error of about 1e-12.

    It solves int_ahead^mean (F'/m)^{1/2} dy = 2c.

    **Arguments:**

    - `law`, `mass`: any law and its mass, or a uniform chain `Lattice`, which has both.
    - `c` [m/s]: positive compresses, negative stretches.
    - `ahead`: strain before the step [m].

    **Returns:** a strain [m], differentiable in all numbers (`jax.grad`, `jax.jvp`; not under
    `jax.jit` or `jax.vmap`).

    **Raises** ValueError for c = 0, a negative or infinite stiffness ahead, open contacts ahead,
    and a law that ends before the state: contacts open, magnets meet.

    Typical: Hertz without precompression, A = m = 1, c = 1/2: 1.01646, 1.2 % above the simulated
    mean: the wave is not simple there.

    **Example:**

    >>> round(float(gx.theory.simple_wave.mean(gx.Toda(), 0.5)), 6)  # 2 ln 1.5
    0.81093
    """
    _, given, path = _path_to(law, mass, c, ahead)
    return _mean(*given, *path.arrays[:3])


@compiled
def _mean(law, mass, c, ahead, *path):
    return ahead + _width_of(law, mass, c, ahead, *path)


def fan(
    speed: Parameter,
    law: Law | Lattice,
    c: Scalar,
    mass: Scalar = 1.0,
    *,
    ahead: Scalar = 0.0,
) -> Numbers:
    """Return the strain at n = speed t in the two rarefactions of v_n = -2c sign(n).

    The strain is `ahead` for |speed| > V_+, solves V(y) = |speed| in the fan, and is `mean` for
    |speed| < V_-. This holds for long waves: at the edges a lattice rings over t^{1/3} sites.

    **Arguments:** as `mean`; `speed`: n/t [sites/s], any shape.

    **Returns:** strains of that shape [m], differentiable as `mean` is. At the two kinks the
    derivative is that of the fan.

    **Raises** ValueError as `mean`, where c makes a shock, and where the law has an inflection
    between the states.

    **Example:**

    >>> y = gx.theory.simple_wave.fan(np.array([0.5, 0.8, 1.5]), gx.Toda(), -0.5)
    >>> print(y.round(6))  # the middle, 2 ln 0.8 in the fan, rest ahead
    [-1.386294 -0.446287  0.      ]
    """
    speed = parameter("speed", speed)
    known = known_value(speed)
    if known is None:
        refuse(
            "speed",
            "speeds that are known",
            "ones that jax.jit or jax.vmap traces",
            "jax.grad may go through it.",
        )
    medium, given, path = _path_to(law, mass, c, ahead, "fan")
    share = _solved(medium.known, path, np.abs(known).ravel())
    inside = (np.abs(known) <= path.sound) & (np.abs(known) >= path.behind)
    behind = jnp.asarray(np.abs(known) < path.behind)
    return _fan(
        *given,
        speed,
        jnp.asarray(path.width * share.reshape(known.shape)),
        jnp.asarray(inside),
        behind,
        *path.arrays[:3],
    )


# the position of each speed along the path of strain, from 0 ahead to 1 behind, by bisection
def _solved(medium, path, speeds):
    low = np.zeros(len(speeds))
    high = np.ones(len(speeds))
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        slower = (
            _slopes_at(medium.law, path.ahead + path.width * middle)[0]
            < float(medium.mass) * speeds**2
        )
        low = np.where(slower, low, middle)
        high = np.where(slower, middle, high)
    return (low + high) / 2


@compiled
def _fan(law, mass, c, ahead, speed, further, inside, behind, *path):
    width = _width_of(law, mass, c, ahead, *path)
    # Newton's method restores the digits of a weak fan and gives the derivatives
    for _ in range(2):
        stiff, bend = with_slope(law.derivative, ahead + further)
        usable = inside & (bend != 0)
        further = further - jnp.where(
            usable, (stiff - mass * speed**2) / jnp.where(usable, bend, 1.0), 0.0
        )
    return ahead + jnp.where(inside, further, jnp.where(behind, width, 0.0))
