r"""Dispersive-shock fitting: the edges of a shock from the speed of sound on both sides.

The law may be any convex one. Two halves of a chain with v_n = -2c sign(n) collide; each behaves
like a chain before a piston of speed 2c. Two shocks move apart and leave the strain of the simple
wave. With the speed of sound V(y) = (F'(y)/m)^{1/2} at strain y [sites/s], V_+ ahead of the shock
and V_- behind it,

    int_ahead^mean V dy = 2c,    s_- = 2 V_+ - V_-,    s_+ = V_+ sinh(2q)/(2q),   cosh^2 q = V_-/V_+.

The edges are exact for the Toda chain, approximate for other laws. `wave=True` checks s_+ against a
solitary wave; `shocks.whitham` solves the modulation equations.

    law = gx.Hertz(precompression=1.0)
    edges = gx.theory.shock_edges(law, 0.2)
    fan = gx.theory.simple_wave.fan([0.9, 1.0, 1.1], law, -0.2)

Source: G. A. El, Chaos 15, 037103 (2005); G. A. El, M. A. Hoefer, Physica D 333, 11 (2016).
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy

from ..base.checks import refuse, traced
from ..base.derivatives import once, with_slope
from ..base.programs import compiled
from ..base.types import Number, Scalar
from ..lattice import Lattice
from ..laws import Law, Strained
from ..profiles import wave_of
from ..results import Result, array
from .chain_wave import _sinh_less
from .simple_wave import _path_to, _speed_of, _width_of

# bead velocity at the crest of the leading wave over c; exact for the Toda chain
PEAK = 4.0
# tolerance of ln(speed of that wave - speed of sound)
SETTLED = 1e-10
# From this V_-/V_+ on neighbours behind the shock oscillate against each other, and the fit has no
# trailing edge.
BINARY = 2.0
STRONG = (
    "{}: the waves behind would be shorter than two sites, and there is no trailing edge of this kind. The leading "
    "speed is that of a solitary wave: exact of Toda's chain; of contacts without sound ahead 0.13 and 0.04 % below "
    "simulated ones for p = 3/2 and 2, 0.3 % above for p = 3. The mean is the simple wave's and too large: there by "
    "1.2, 3.3 and 15 %, of Toda's chain by 2 ln(1 + c) - ln 4c (scaled)."
)


class FittedEdges(Result):
    """The edges of a dispersive shock to the right, as `shock_edges` returns them.

    For the Toda chain s_+ and the speed of the solitary wave are exact. For other laws the latter
    is closer to the simulated speed (leading crests until t = 1000, extrapolated by 1/t), so their
    difference estimates the error of the fit:

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
    mean: Number = array("The strain behind the shock.", "m")
    sound: Number = array("The speed of sound V_+ ahead.", "1/s")
    trailing_excess: Number = array("s_-/V_+ - 1, negative, accurate at small c.", "1")
    leading_excess: Number = array("s_+/V_+ - 1, accurate at small c.", "1")
    error: Number = array(
        "The estimated relative numerical error of the excesses and of mean - ahead, as solutions "
        "of the formulas.",
        "1",
    )
    wave_speed: Number | None = array(
        "The speed of the solitary wave whose beads reach the velocity 4c; `None` without "
        "`wave=True`.",
        "1/s",
    )
    amplitude: Number | None = array(
        "The strain of that wave above the strain ahead; `None` without `wave=True`.", "m"
    )
    # V_-/V_+ - 1; the relative distance of that wave's bead velocity from 4c; why there is no wave
    _growth: float = eqx.field(static=True)
    _gap: float = eqx.field(static=True, default=np.nan)
    _lost: str = eqx.field(static=True, default="")

    @property
    def outcome(self) -> str:
        """How accurately the edges are known."""
        if traced((self.leading_speed, self.wave_speed, self.error)):
            return "Not known while traced."
        strong = not self._growth < BINARY - 1
        told = f"Solved to {self.error:.0e}. The formulas are exact for Toda's chain alone."
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
    r"""Compute the edges of the shock v_n = -2c sign(n) by dispersive-shock fitting.

    **Arguments:**

    - `law`, `mass`: any law without an inflection between the two states; or a uniform chain
      `Lattice`, which has both, and the units of the result.
    - `c` [m/s]: a quarter of the jump of the velocity: positive where the law stiffens in
      compression (Hertz, Toda, magnets), negative where it stiffens in tension (p < 1, K3 < 0) and
      shocks are rarefactions.
    - `ahead`: strain before the shock [m].
    - `wave`: whether to compute the solitary wave of the front too, which takes seconds.

    **Returns:** `FittedEdges`, differentiable in c, mass, ahead and the law's parameters
    (`jax.grad`, `jax.jvp`; not under `jax.jit` or `jax.vmap`). For V_- >= 2 V_+ there is no
    trailing edge: s_- is NaN, the leading speed is that of the solitary wave whose beads reach 4c,
    and `outcome` gives its accuracy. For Hertz without sound ahead (A = m = 1, c = 1/2) the speed
    is 1.04242 (simulated 1.0437), the mean 1.01647 (simulated 1.00466).

    **Raises** ValueError for c = 0, a c that makes a rarefaction, and a law that is linear, has an
    inflection between the states, ends before them or has no stiffness.

    **Example:**

    >>> edges = gx.theory.shock_edges(gx.Toda(), 0.5)
    >>> round(float(edges.trailing_speed), 5), round(float(edges.leading_speed), 5)
    (0.5, 1.31519)
    """
    medium, given, path = _path_to(law, mass, c, ahead, "shock")
    if not path.growth > 0:
        refuse("c", "a jump that changes the speed of sound by more than rounding", f"{path.c:g}")
    mean, sound, trailing, leading = _excesses(*given, *path.arrays)
    speeds = [sound * (1 + trailing), sound * (1 + leading)]
    front = (None, None)
    told = ()
    strong = not path.growth < BINARY - 1
    if strong or wave:
        fit = (
            max(0.8 * path.behind, 1.05 * path.sound)
            if strong
            else float(jax.lax.stop_gradient(speeds[1]))
        )
        *front, told = _front(medium, *given[2:], path, fit)
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


# mean, V_+, s_-/V_+ - 1 and s_+/V_+ - 1; the last two mean nothing for V_+ = 0
@compiled
def _excesses(law, mass, c, ahead, width, nodes, weights, close):
    width = _width_of(law, mass, c, ahead, width, nodes, weights)
    low = law.derivative(ahead)
    high = law.derivative(ahead + width)
    at = ahead + width * nodes
    bend = with_slope(law.derivative, at)[1]
    grown = jnp.where(close > 0, width * (weights @ bend), high - low) / jnp.where(
        low > 0, low, 1.0
    )
    log = jnp.log1p(grown) / 2
    # 2q, the wave number of the leading wave, with cosh^2 q = V_-/V_+
    twice = 2 * jnp.arcsinh(jnp.sqrt(jnp.expm1(log)))
    return ahead + width, _speed_of(low / mass), -jnp.expm1(log), _sinh_less(twice) / twice


# speed and amplitude of the solitary wave whose beads reach 4c; its gap to 4c, or why there is none
def _front(medium, c, ahead, path, guess):
    own = medium
    if path.ahead != 0 or traced(ahead):
        own = medium._replace(law=Strained(medium.law, ahead))
    side = "compression" if path.c > 0 else "tension"

    def reached(x):
        velocity, amplitude = _wave(own.known, path.sound + np.exp(x), side)
        return np.log(abs(float(velocity)) / (PEAK * abs(path.c))), amplitude

    try:
        # ln(velocity) is nearly linear in ln(speed - speed of sound)
        start = np.log(guess - path.sound)
        x = scipy.optimize.root_scalar(
            lambda x: reached(x)[0], method="secant", x0=start, xtol=SETTLED
        ).root
        gap, amplitude = reached(x)
    except ValueError as error:
        return *jnp.full(2, jnp.nan), (np.nan, str(error))
    speed = jnp.asarray(path.sound + np.exp(x))
    if traced((own.law, own.mass, c)):
        law, mass, c = once((own.law, own.mass, c), _refuse_second)
        own = own._replace(law=law, mass=mass)
        wave = lambda s: _wave(own.known, s, side)
        (_, amplitude), (steeper, taller) = with_slope(wave, speed)
        velocity, higher = _wave(own, speed, side)
        off = jnp.abs(velocity) - PEAK * jnp.abs(c)
        moved = -(off - jax.lax.stop_gradient(off)) / jnp.abs(steeper)
        speed = speed + moved
        amplitude = higher + taller * moved
    return speed, amplitude, (float(abs(gap)),)


def _refuse_second():
    refuse("c", "one derivative of the wave whose beads reach 4c", "a second one")


def _wave(medium, speed, side):
    shape = wave_of(medium, speed, side=side).shape
    return shape.at("velocity", 0.5), shape.at("strain", 0.0)
