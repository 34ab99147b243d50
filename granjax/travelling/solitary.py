"""`solitary_wave`: the solitary wave of a law or of a uniform chain."""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import scipy

from ..base.checks import described, refuse, traced
from ..base.types import Count, Number, Scalar
from ..lattice import Lattice
from ..laws import Law
from ..orbits.floquet import Floquet
from ..profiles import Profile, Shape, Solved, medium_of, one_given, tabled, wave_of
from ..profiles.medium import implicit
from ..results import array
from .cells import CellWave, Resonator, alone_with_resonators
from .stability import stability

# The number of places in the table.
TABLE = 257
# The reach of the table in decay lengths, where the tail is exponential.
REACH = 20.0


class Wave(Profile):
    r"""A solitary wave: contact n, between the beads n and n + 1, has the strain phi(n - c t).

    m c^2 phi = tent * F(phi), tent(x) = [1 - |x|]_+. Places xi = n - c t count contacts. The beads
    ahead are at rest; each has moved by `compression`, times the sign of c, after the wave has
    passed. Beads are fastest at xi = 1/2, midway between two contacts. `state` is meant for a long
    chain with free ends: the beads behind would load a wall.

    Differentiable (once in a sonic vacuum) in the parameters of the law, the mass and the given
    speed, amplitude or energy, by the implicit function theorem (`jax.grad`, `jax.jvp`,
    `jax.jacfwd`). `jax.jit` and `jax.vmap` around the search are refused.
    """

    amplitude: Number = array("The largest strain phi(0), negative for tension.", "m")
    energy: Number = array("int (phi F/2 + W), of which int phi F/2 is the kinetic energy.", "J")
    momentum: Number = array("m c int phi.", "N s")
    compression: Number = array("int phi.", "m")
    width: Number = array("The full width at half of the amplitude, in contacts.", "1")
    decay: Number = array(
        "kappa of the tail exp(-kappa |xi|); NaN for a tail that falls faster (no sound at rest).",
        "1",
    )
    exponent: Number = array(
        "ln phi(xi + 1) / ln phi(xi) of a tail that falls faster than an exponential; NaN where "
        "there is a `decay`.",
        "1",
    )

    def _said(self):
        tail = (
            f"exp(-{self.decay:.6g} |xi|)"
            if np.isfinite(self.decay)
            else f"double exponential, of exponent {self.exponent:.6g}"
        )
        share = self.error / abs(self.amplitude)
        return f"Found to {share:.1e} of its peak; its tail is {tail}."

    def floquet(
        self, sites: Count | None = None, ends: str | None = None, **keywords: Any
    ) -> Floquet:
        """Compute the stability over the time 1/c by `granjax.travelling.stability`."""
        return stability(self, sites, ends, **keywords)


def a_wave(argument: str, wave: Any) -> None:
    """Refuse an argument that is not a solitary wave."""
    if not isinstance(wave, Wave):
        refuse(argument, "a wave", described(wave), "gx.travelling.solitary_wave(law, ...).")


def full_width(shape: Shape) -> Number:
    """Return the full width at half of the largest strain, with its derivative."""
    known = jax.lax.stop_gradient(shape)
    level = float(known.at("strain", 0.0)) / 2
    end = float(known.end)
    half = scipy.optimize.brentq(
        lambda x: float(known.at("strain", x)) - level, 0.0, end, xtol=1e-15
    )
    # The slope takes ten times as long as the search, so it is computed only where needed.
    if not traced(shape):
        return jnp.asarray(2 * half)
    gap = lambda x: shape.at("strain", x) - shape.at("strain", 0.0) / 2
    return 2 * implicit(gap, half, 1 / jax.grad(partial(known.at, "strain"))(half))


def solitary_wave(
    law: Law | Lattice,
    *,
    speed: Scalar | None = None,
    amplitude: Scalar | None = None,
    energy: Scalar | None = None,
    mass: Scalar = 1.0,
    side: str | None = None,
    resonator: Resonator | None = None,
) -> Wave | CellWave:
    r"""Compute the solitary wave of a chain of equal masses with one law between neighbours.

    The wave is exact on the lattice: m c^2 phi(x) = int (1 - |z|)_+ F(phi(x - z)) dz. A first shape
    comes from iterating the Fourier form at a fixed peak, phi^ = sinc^2(k/2) F^/(m c^2), down to
    rounding. Newton's method then solves the tent integral in ln phi. The tail is therefore
    accurate to its last digit, however small, and the trivial solution is excluded.

    **Arguments:**

    - `law`: any law, from equilibrium (it includes a precompression), with `mass`; or a chain
      `Lattice` of equal masses and bonds to the next site, whose walls and boundary are ignored and
      whose units the result has.
    - exactly one of `speed` (contacts per time; negative to the left), `amplitude` (the largest
      strain, negative in tension) and `energy`.
    - `side`: `"compression"` or `"tension"`, where a law has waves on both; `None` is the first
      that has some. Hertz, p > 1, magnets: compression; 0 < p < 1: tension (rarefaction).
    - `resonator`: a `gx.Resonator` in every bead; the result is then a `CellWave`. Such a wave has
      no ripple only at single stiffnesses, `tail_free_stiffness`; at others the error names the
      nearest, and `cell_wave` gives the wave with its ripple.

    **Returns:** `Wave`. Hertz (A = m = c = 1): peak 1.48735937434940, energy 2.82348668842276,
    which scale as c^4 and c^10.

    **Raises** ValueError for a speed at or below that of sound or above what the law's energy
    allows, a law that has no solitary wave (it does not stiffen), a lattice that is not a uniform
    chain, a batch, and none or several of speed, amplitude and energy.
    Source: English, Pego, Proc. AMS 133, 1763 (2005); Friesecke, Wattis, Commun. Math. Phys. 161,
    391 (1994); Herrmann, Proc. R. Soc. Edinb. A 140, 753 (2010).

    **Example:**

    >>> wave = gx.travelling.solitary_wave(gx.Hertz(), speed=1.0)
    >>> round(float(wave.amplitude), 6)
    1.487359
    """
    given, _ = one_given(speed=speed, amplitude=amplitude, energy=energy)
    medium = medium_of(law, mass)
    if resonator is not None:
        if given != "speed":
            refuse(
                given,
                "a speed, for beads with a resonator",
                given,
                "Its stiffness goes with the speed.",
            )
        return alone_with_resonators(medium.law, medium.mass, speed, resonator)
    found = wave_of(medium, speed, amplitude, energy, side)
    return _recorded(medium, found)


def _recorded(medium, found: Solved) -> Wave:
    shape = found.shape
    numbers = {name: jnp.asarray(x) for name, x in found._asdict().items() if name != "shape"}
    end = float(jax.lax.stop_gradient(shape).end)
    decay = float(jax.lax.stop_gradient(numbers["decay"]))
    reach = min(end, REACH / decay) if np.isfinite(decay) else min(end, 8.0 * max(1.0, end / 12))
    return Wave(
        speed=shape.speed,
        amplitude=shape.at("strain", 0.0),
        width=full_width(shape),
        law=medium.law,
        mass=medium.mass,
        **numbers,
        **tabled(shape, np.linspace(-reach, reach, TABLE)),
        **medium.origin,
    )
