r"""Dispersive-shock fitting: the edges of a shock of any convex law, from the speed of sound on its two sides.

Two halves of a chain are thrown at each other, v_n = -2c sign(n); either is like a chain before a piston of speed 2c.
Two shocks run apart, and leave the strain that the simple wave gives. With V(y) = (F'(y)/m)^{1/2} the speed of sound at
strain y [sites/s], V_+ ahead of the shock and V_- behind it,

    int_ahead^mean V dy = 2c,    s_- = 2 V_+ - V_-,    s_+ = V_+ sinh(2q)/(2q),   cosh^2 q = V_-/V_+.

Exact of the Toda chain, and near elsewhere; `wave=True` asks a solitary wave for a second opinion of s_+, and
`shocks.whitham` solves the modulation equations themselves.

    law = gx.Hertz(precompression=1.0)
    edges = gx.theory.shock_edges(law, 0.2)
    fan = gx.theory.simple_wave.fan([0.9, 1.0, 1.1], law, -0.2)

Source: G. A. El, Chaos 15, 037103 (2005); G. A. El, M. A. Hoefer, Physica D 333, 11 (2016).
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import root_scalar

from ..checks import parameter, refuse, traced
from ..lattice import Lattice
from ..laws import Law, Strained
from ..profiles import medium_of, wave_of
from ..programs import compiled
from ..results import Result, array
from ..types import Number, Scalar
from .chain_wave import _sinh_less
from .simple_states import _path_to, _speed_of, _width_of

# bead velocity at the crest of the leading wave over c: of the Toda chain exactly
PEAK = 4.0
# of the logarithm of the speed of that wave above sound's
SETTLED = 1e-10
# V_-/V_+ from which on neighbours behind the shock swing against each other, and the fit has no trailing edge
BINARY = 2.0
STRONG = (
    "{}: the waves behind would be shorter than two sites, and there is no trailing edge of this kind. The leading "
    "speed is that of a solitary wave: exact of Toda's chain; of contacts without sound ahead 0.13 and 0.04 % below "
    "simulated ones for p = 3/2 and 2, 0.3 % above for p = 3. The mean is the simple wave's and too large: there by "
    "1.2, 3.3 and 15 %, of Toda's chain by 2 ln(1 + c) - ln 4c (scaled)."
)


class FittedEdges(Result):
    """Edges of a dispersive shock that runs to the right, by `shock_edges`.

    The speed of the solitary wave is exact of the Toda chain as s_+ is, and elsewhere nearer to what was simulated
    (leading crests until t = 1000, extrapolated by 1/t), so that the distance of the two speeds is about what the fit
    misses:

    | law, c | s_+ | wave | simulated | mean | simulated |
    |---|---|---|---|---|---|
    | Hertz, d0 = 1/2, sound 1, 0.5 | 1.18345 | 1.19286 | 1.1933 | 0.86215 | 0.86142 |
    | FPUT, K2 = 1, K3 = 1/2, 0.3 | 1.15449 | 1.15687 | 1.1570 | 0.53404 | 0.53385 |
    | magnets p = -3, A = d0 = 1, 0.3 | 2.59558 | 2.58736 | 2.5856 | 0.25728 | 0.25779 |
    | p = 1/2, A = d0 = 1, -0.1 | 0.74569 | 0.74590 | 0.7459 | -0.27232 | -0.27234 |

    **Example:**

    >>> edges = gx.theory.shock_edges(gx.Toda(), 0.5)
    >>> round(float(edges.mean), 5), float(edges.error) < 1e-6
    (0.81093, True)
    """

    trailing_speed: Number = array("The trailing speed s_-.", "1/s")
    leading_speed: Number = array("The leading speed s_+.", "1/s")
    mean: Number = array("The strain behind.", "m")
    sound: Number = array("The speed of sound V_+ ahead.", "1/s")
    trailing_excess: Number = array("s_-/V_+ - 1, negative, with its digits where c is small.", "1")
    leading_excess: Number = array("s_+/V_+ - 1, with its digits where c is small.", "1")
    error: Number = array(
        "The estimated relative distance of the excesses and of mean - ahead from what the "
        "formulas say.",
        "1",
    )
    wave_speed: Number | None = array(
        "The speed of the solitary wave whose beads reach the velocity 4c, `None` without "
        "`wave=True`.",
        "1/s",
    )
    amplitude: Number | None = array(
        "The strain of that wave above the strain ahead, `None` without `wave=True`.", "m"
    )
    # V_-/V_+ - 1; how far the beads of that wave are from 4c, relative, and why there is none
    _growth: float = eqx.field(static=True)
    _gap: float = eqx.field(static=True, default=np.nan)
    _lost: str = eqx.field(static=True, default="")

    @property
    def outcome(self) -> str:
        """How well the edges are known."""
        if traced((self.leading_speed, self.wave_speed, self.error)):
            return "Not known while traced."
        strong = not self._growth < BINARY - 1
        told = f"Found to {self.error:.0e} of what the formulas say, which are exact of Toda's chain alone."
        if strong:
            grown = (
                f"The speed of sound grows {self._growth + 1:.4g} times, which is twofold or more"
            )
            told = STRONG.format(grown if self.sound else "Ahead there is no sound")
        if self.wave_speed is None:
            return f"{told} wave=True tells how far to trust them elsewhere."
        if self._lost:
            return f"{told} No solitary wave was found: {self._lost}"
        told += f" The beads of that wave reach 4c to {self._gap:.0e}."
        if not strong:
            apart = self.wave_speed / self.leading_speed - 1
            told += f" Its speed differs by {apart:.1e}, about what the fit misses."
        return told


def shock_edges(
    law: Law | Lattice,
    c: Scalar,
    mass: Scalar = 1.0,
    *,
    ahead: Scalar = 0.0,
    wave: bool = False,
) -> FittedEdges:
    r"""Edges of the shock v_n = -2c sign(n) of a chain, by dispersive-shock fitting.

    **Arguments:**

    - `law`, `mass`: any law that bends one way between the two states; or a uniform chain `Lattice`, which has both,
      and the units of the result.
    - `c`: a quarter of the jump of the velocity [m/s]: above zero where the law stiffens in compression (Hertz, Toda,
      magnets), below zero where it stiffens in tension (p < 1, K3 < 0), whose shocks are of rarefaction.
    - `ahead`: strain of the chain before [m]. `wave`: whether to look for the solitary wave of the front too, which
      takes seconds.

    **Returns:** `FittedEdges`, differentiable in c, the mass, the strain ahead and the law's parameters (`jax.grad`,
    `jax.jvp`; `jax.jit` and `jax.vmap` are refused). Where V_- >= 2 V_+ there is no trailing edge: s_- is NaN, the
    leading speed is that of the solitary wave whose beads reach 4c, and `outcome` says how well that is known. Of Hertz
    without sound ahead (A = m = 1, c = 1/2) it is 1.04242, simulated 1.0437; the mean is 1.01647, simulated 1.00466.
    **Raises** ValueError for c = 0, a c that makes no shock but a rarefaction, a law that is linear, that has an
    inflection between the states, that ends before them or has no stiffness.
    Typical: Toda, c = 1/2: 1/2, 1.31519, mean 0.81093.

    **Example:**

    >>> edges = gx.theory.shock_edges(gx.Toda(), 0.5)
    >>> round(float(edges.trailing_speed), 5), round(float(edges.leading_speed), 5)
    (0.5, 1.31519)
    """
    medium = medium_of(law, mass)
    c, ahead = parameter("c", c), parameter("ahead", ahead)
    path = _path_to(medium.known, c, ahead, "shock")
    if not path.growth > 0:
        refuse("c", "a jump that changes the speed of sound by what numbers resolve", f"{path.c:g}")
    mean, sound, trailing, leading = _excesses(medium.law, medium.mass, c, ahead, *path.arrays)
    speeds, front, told = [sound * (1 + trailing), sound * (1 + leading)], (None, None), ()
    strong = not path.growth < BINARY - 1
    if strong or wave:
        fit = (
            max(0.8 * path.behind, 1.05 * path.sound)
            if strong
            else float(jax.lax.stop_gradient(speeds[1]))
        )
        *front, told = _front(medium, c, ahead, path, fit)
    if strong:
        trailing = jnp.full((), jnp.nan)
        leading = front[0] / sound - 1 if path.sound > 0 else jnp.full((), jnp.inf)
        speeds = [trailing, front[0]]
    return FittedEdges(
        *speeds,
        mean,
        sound,
        trailing,
        leading,
        jnp.asarray(path.error),
        *front,
        float(path.growth),
        *told,
        **medium.origin,
    )


@compiled
def _excesses(law, mass, c, ahead, width, nodes, weights, close):
    """mean, V_+, s_-/V_+ - 1 and s_+/V_+ - 1; the latter two without a meaning where V_+ = 0."""
    width = _width_of(law, mass, c, ahead, width, nodes, weights)
    low, high = law.derivative(ahead), law.derivative(ahead + width)
    at = ahead + width * nodes
    bend = jax.jvp(law.derivative, (at,), (jnp.ones_like(at),))[1]
    grown = jnp.where(close > 0, width * (weights @ bend), high - low) / jnp.where(
        low > 0, low, 1.0
    )
    log = jnp.log1p(grown) / 2
    # of the wave number 2q of the leading wave: cosh^2 q = V_-/V_+
    twice = 2 * jnp.arcsinh(jnp.sqrt(jnp.expm1(log)))
    return ahead + width, _speed_of(low / mass), -jnp.expm1(log), _sinh_less(twice) / twice


def _front(medium, c, ahead, path, guess):
    """Speed and amplitude of the solitary wave whose beads reach 4c, with derivatives; how far they are off, why."""
    own = medium
    if path.ahead != 0 or traced(ahead):
        own = medium._replace(law=Strained(medium.law, ahead))
    side = "compression" if path.c > 0 else "tension"

    def reached(x):
        velocity, amplitude = _wave(own.known, path.sound + np.exp(x), side)
        return np.log(abs(float(velocity)) / (PEAK * abs(path.c))), amplitude

    try:
        # the logarithms of the speed above sound's and of the velocity are nearly straight in each other
        start = np.log(guess - path.sound)
        x = root_scalar(lambda x: reached(x)[0], method="secant", x0=start, xtol=SETTLED).root
        gap, amplitude = reached(x)
    except ValueError as error:
        return *jnp.full(2, jnp.nan), (np.nan, str(error))
    speed = jnp.asarray(path.sound + np.exp(x))
    if traced((own.law, own.mass, c)):
        (_, amplitude), (steeper, taller) = jax.jvp(
            lambda s: _wave(own.known, s, side), (speed,), (jnp.ones(()),)
        )
        velocity, higher = _wave(own, speed, side)
        off = jnp.abs(velocity) - PEAK * jnp.abs(c)
        moved = -(off - jax.lax.stop_gradient(off)) / jnp.abs(steeper)
        speed, amplitude = speed + moved, higher + taller * moved
    return speed, amplitude, (float(abs(gap)),)


def _wave(medium, speed, side):
    """Bead velocity at the crest, and the largest strain, of the solitary wave of a speed."""
    shape = wave_of(medium, speed, side=side).shape
    return shape.at("velocity", 0.5), shape.at("strain", 0.0)
