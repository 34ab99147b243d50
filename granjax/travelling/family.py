"""`family`: solitary waves over their speed, amplitude or energy, and extrema of the energy."""

import jax
import numpy as np

from ..base.checks import refuse
from ..base.types import Numbers, Parameter, Scalar
from ..lattice import Lattice
from ..laws import Law
from ..profiles import assembled, medium_of, one_given, searched
from ..results import Result, array
from .solitary import full_width


class WaveFamily(Result):
    r"""Solitary waves of one law, in the order in which they were asked for.

    Where `energy_slope` passes zero, at the speeds `turns`, waves gain or lose stability: one pair
    of multipliers of `Wave.floquet` is at +1 there. Waves whose energy falls with speed are
    unstable.
    """

    speed: Numbers = array("The speed of each wave in contacts per time.", "1/s", "wave")
    amplitude: Numbers = array("The largest strain.", "m", "wave")
    energy: Numbers = array("The energy.", "J", "wave")
    momentum: Numbers = array("The momentum.", "N s", "wave")
    compression: Numbers = array("int phi.", "m", "wave")
    width: Numbers = array("The full width at half of the amplitude, in contacts.", "1", "wave")
    energy_slope: Numbers = array("dE/dc, by the implicit function theorem.", "J s", "wave")
    error: Numbers = array("The estimated error of the strain.", "m", "wave")
    turns: Numbers = array("The speeds at which the slope passes zero.", "1/s", "turn")
    law: Law = array("The law of the contacts.")

    @property
    def outcome(self) -> str:
        """The number of waves, and the speeds at which dE/dc passes zero."""
        turns = ", ".join(f"{x:.4g}" for x in self.turns)
        turned = f"dE/dc passes zero near c = {turns}" if turns else "their energy has no turn"
        return f"{len(self.speed)} waves; {turned}."


def family(
    law: Law | Lattice,
    *,
    speed: Parameter | None = None,
    amplitude: Parameter | None = None,
    energy: Parameter | None = None,
    mass: Scalar = 1.0,
    side: str | None = None,
) -> WaveFamily:
    """Compute several solitary waves of a law, or of a uniform chain.

    **Arguments:** as of `solitary_wave`, with one of `speed`, `amplitude`, `energy` an array (P,).
    **Returns:** `WaveFamily`. **Raises** ValueError as `solitary_wave` does, at the first wave that
    does not exist, and for traced numbers: only `solitary_wave` has derivatives.

    **Example:**

    >>> found = gx.travelling.family(gx.Hertz(), speed=[1.0, 2.0])
    >>> round(float(found.energy[1] / found.energy[0]), 4)
    1024.0
    >>> low, high = (gx.travelling.solitary_wave(gx.Hertz(), speed=c) for c in (1.0, 2.0))
    >>> round(float(high.energy / low.energy), 4)  # 2^10
    1024.0
    """
    name, numbers = one_given(speed=speed, amplitude=amplitude, energy=energy)
    medium = medium_of(law, mass)
    rows = []

    numbers = np.atleast_1d(np.asarray(numbers, float))
    if numbers.ndim != 1 or not numbers.size:
        refuse(name, "one number or a row of them", f"shape {numbers.shape}")
    for x in numbers:
        # JAX calls compiled functions slowly while it differentiates, so the search comes before.
        known = searched(medium, side, **{name: x})

        def solved(x):
            wave = assembled(medium, *known, {name: x})
            return (wave.shape.speed, wave.energy), wave

        (c, E), (dc, dE), wave = jax.jvp(solved, (x,), (1.0,), has_aux=True)
        shape = wave.shape
        integrals = wave.momentum, wave.compression
        width = full_width(shape)
        rows.append((c, shape.strain(0.0), E, *integrals, width, dE / dc, wave.error))
    columns = np.array(rows, float).T
    left = columns[0] < 0
    turns = np.concatenate([_zeros(*columns[[0, 6]][:, way]) for way in (left, ~left)])
    return WaveFamily(*columns, turns, medium.law, **medium.origin)


def _zeros(c, slope):
    order = np.argsort(c)
    c = c[order]
    slope = slope[order]
    i = np.flatnonzero(slope[:-1] * slope[1:] < 0)
    return c[i] - slope[i] * (c[i + 1] - c[i]) / (slope[i + 1] - slope[i])
