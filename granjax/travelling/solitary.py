"""`solitary_wave`: the wave of a law, or of a uniform chain."""

import jax
import jax.numpy as jnp
import numpy as np

from ..checks import positive, refuse, show
from ..lattice import Lattice
from ..laws import Law
from ..profiles import Solved, medium_of, one_given, tabled, wave_of
from ..types import Scalar
from .cells import CellWave, Resonator, alone_with_resonators
from .wave import Wave, full_width

# places of the table, and decays or contacts that it reaches
TABLE, REACH = 257, 20.0


def solitary_wave(
    law: Law | Lattice,
    *,
    speed: Scalar | None = None,
    amplitude: Scalar | None = None,
    energy: Scalar | None = None,
    mass: Scalar = 1.0,
    side: str | None = None,
    resonator: Resonator | None = None,
    spacing: Scalar | None = None,
) -> Wave | CellWave:
    r"""The solitary wave of a chain of equal masses with one law between neighbours, exact on the lattice.

    m c^2 phi(x) = int (1 - |z|)_+ F(phi(x - z)) dz. A first shape comes from iterating the Fourier form at a
    fixed peak, phi^ = sinc^2(k/2) F^/(m c^2), whose floor is rounding; the wave itself from Newton's method on the tent
    integral in ln phi, so that its tail is right to its last digit, however small, and it is never the trivial one.

    **Arguments:**

    - `law`: any law, from equilibrium (a precompression is the law's own), and with it `mass`; or a chain `Lattice` of
      equal masses and bonds to the next site, whose walls and boundary do not count and whose units the result has.
    - exactly one of `speed` (contacts per time; below zero it runs to the left), `amplitude` (the largest strain, below
      zero in tension) and `energy`.
    - `spacing`: distance of neighbouring sites, such as the diameter of a bead [m]: `speed` is then in m/s. The `speed`
      of the result is in contacts per time all the same.
    - `side`: `"compression"` or `"tension"`, where a law has waves on both; `None` is the first that has some. Hertz,
      p > 1, magnets: compression; 0 < p < 1: tension (rarefaction).
    - `resonator`: a `gx.Resonator` in every bead. Such a wave is alone at single stiffnesses, `tail_free_stiffness`; at
      others the nearest is named, and `cell_wave` gives the wave with its ripple. With it the result is a `CellWave`.

    **Returns:** `Wave`. Hertz (A = m = c = 1): peak 1.48735937434940, energy 2.82348668842276; they scale as c^4, c^10.

    **Raises** ValueError for a speed at or below that of sound, one above what the law's energy holds, a law that has
    no solitary wave (it does not stiffen), a lattice that is no uniform chain, a batch, none or several of speed,
    amplitude and energy.
    Source: English, Pego, Proc. AMS 133, 1763 (2005); Friesecke, Wattis, Commun. Math. Phys. 161, 391 (1994);
    Herrmann, Proc. R. Soc. Edinb. A 140, 753 (2010).

    **Example:**

    >>> wave = gx.travelling.solitary_wave(gx.Hertz(), speed=1.0)
    >>> round(float(wave.amplitude), 6)
    1.487359
    """
    given, _ = one_given(speed=speed, amplitude=amplitude, energy=energy)
    if spacing is not None:
        if speed is None:
            refuse(
                "spacing", "None without a speed", show(spacing), "Only a speed is counted in it."
            )
        speed = speed / positive("spacing", spacing, "It is a length, such as a bead's diameter.")
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
    known = jax.lax.stop_gradient(shape)
    end = float(known.end)
    decay, exponent = (float(jax.lax.stop_gradient(x)) for x in (found.decay, found.exponent))
    reach = min(end, REACH / decay) if np.isfinite(decay) else min(end, 8.0 * max(1.0, end / 12))
    xi = np.linspace(-reach, reach, TABLE)
    amplitude = shape.at("strain", 0.0)
    return Wave(
        speed=shape.speed,
        amplitude=amplitude,
        energy=found.energy,
        momentum=found.momentum,
        compression=found.compression,
        width=full_width(shape, end),
        decay=jnp.asarray(found.decay),
        exponent=jnp.asarray(found.exponent),
        residual=jnp.asarray(found.residual),
        error=jnp.asarray(found.error),
        law=medium.law,
        mass=medium.mass,
        **tabled(shape, xi),
        **medium.origin,
    )
