"""Nanoptera over a cell's parameter and the speed, and curves of waves without a ripple."""

from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Float

from ...base.checks import parameter, refuse, show
from ...base.types import Parameter, Scalar
from ...lattice import Lattice
from ...results import Result, array, hidden, note
from .public import CellWave, cell_wave, tail_free

# The part of the interval in which the next parameter is searched for.
NARROW = 0.5


class Nanoptera(Result):
    """Waves with a ripple over two parameters: the result of `gx.travelling.nanoptera`."""

    parameter: Float[np.ndarray, " parameter"] = array("The parameter of the cell.")
    speed: Float[np.ndarray, " speed"] = array("The speeds in sites per time.", "1/s")
    ripple: Float[np.ndarray, "parameter speed"] = array(
        "The smallest ripple, NaN where no wave was found.", "m"
    )
    amplitude: Float[np.ndarray, "parameter speed"] = array("The largest absolute strain.", "m")
    radiation: Float[np.ndarray, "parameter speed"] = array(
        "The power lost by a wave that is launched without its ripple.", "W"
    )
    error: Float[np.ndarray, "parameter speed"] = array("The error of the strains.", "m")
    lost: tuple[str, ...] = note("The reasons why waves were not found, one sentence each.")

    @property
    def outcome(self) -> str:
        """The number of waves found."""
        return f"{np.isfinite(self.amplitude).sum()} waves of {self.amplitude.size}."


class TailFree(Result):
    """Waves without a ripple along a curve: the result of `gx.travelling.tail_free_curve`."""

    speed: Float[np.ndarray, " point"] = array("The speeds in sites per time.", "1/s")
    parameter: Float[np.ndarray, " point"] = array("The parameter of the cell.")
    amplitude: Float[np.ndarray, " point"] = array("The largest absolute strain.", "m")
    energy: Float[np.ndarray, " point"] = array("The energies.", "J")
    error: Float[np.ndarray, " point"] = array("The error of the strains.", "m")
    waves: tuple[CellWave, ...] = hidden("The waves.")
    lost: str = note("Why the curve ended before the last speed; empty where it did not.")

    @property
    def outcome(self) -> str:
        """How far the curve goes."""
        end = f" It ended there: {self.lost}" if self.lost else ""
        return f"{len(self.speed)} waves, up to the speed {self.speed[-1]:.6g}.{end}"


def nanoptera(cell: Callable[[Any], Any], parameters: Parameter, speeds: Parameter) -> Nanoptera:
    """Compute the ripple of the waves of a cell over its parameter and the speed.

    **Arguments:** `cell`: parameter -> (law, masses), or a chain `Lattice`, as for `tail_free`.
    `parameters` (P,); `speeds` (S,), c in sites per time. Each wave is that of `cell_wave` and
    takes seconds.
    **Returns:** `Nanoptera`. **Raises** ValueError for other shapes.

    **Example:**

    >>> toda = lambda ratio: (gx.Toda(), [1.0, ratio])
    >>> found = gx.travelling.nanoptera(toda, [0.9, 0.95], [1.1])
    >>> bool(found.ripple[0, 0] > found.ripple[1, 0])
    True
    """
    parameters = np.asarray(parameter("parameters", parameters))
    speeds = np.asarray(parameter("speeds", speeds))
    if parameters.ndim != 1 or speeds.ndim != 1:
        refuse(
            "parameters", "rows of parameters and of speeds", f"{parameters.shape}, {speeds.shape}"
        )
    names = ("ripple", "amplitude", "radiation", "error")
    lost = []
    origin = {}
    table = np.full((len(names), len(parameters), len(speeds)), np.nan)
    for i, p in enumerate(parameters):
        made = cell(p)
        given = (made,) if isinstance(made, Lattice) else made
        for j, c in enumerate(speeds):
            try:
                wave = cell_wave(*given, speed=c)
            except (RuntimeError, ValueError) as error:
                lost.append(f"{p:.6g}, {c:.6g}: {error}")
                continue
            origin = {"_mark": wave._mark, "_space": wave._space}
            table[:, i, j] = [getattr(wave, name) for name in names]
    return Nanoptera(parameters, speeds, *table, tuple(lost), **origin)


def tail_free_curve(
    cell: Callable[[Any], Any], low: Scalar, high: Scalar, speeds: Parameter
) -> TailFree:
    """Follow a wave that travels without loss over the speed, together with its parameter.

    The first wave is that of `tail_free` between `low` and `high`. Each next one is searched for
    around the extrapolated parameter, in half of that interval.

    **Arguments:** `cell`, `low`, `high`: as in `tail_free`. `speeds` (S,): c in sites per time, in
    the order to follow.
    **Returns:** `TailFree`, as far as the curve was followed. **Raises** as `tail_free` for the
    first speed.
    """
    width = float(high) - float(low)
    waves = []
    lost = ""
    speeds = np.atleast_1d(np.asarray(parameter("speeds", speeds)))
    if speeds.ndim != 1 or not speeds.size or not np.diff(speeds).all():
        refuse("speeds", "a row of numbers, each other than the one before", show(speeds))
    for c in speeds:
        if waves:
            (c0, p0), *rest = [(wave.speed, wave.parameter) for wave in waves[:-3:-1]]
            slope = (p0 - rest[0][1]) / (c0 - rest[0][0]) if rest else 0.0
            middle = p0 + slope * (c - c0)
            reach = NARROW * width / (2 if rest else 1)
            low = middle - reach
            high = middle + reach
        try:
            waves.append(tail_free(cell, low, high, speed=c))
        except (RuntimeError, ValueError) as error:
            if not waves:
                raise
            lost = str(error)
            break
    column = lambda name: np.array([getattr(wave, name) for wave in waves])
    numbers = map(column, ("speed", "parameter", "amplitude", "energy", "error"))
    mark = {"_mark": waves[0]._mark, "_space": waves[0]._space}
    return TailFree(*numbers, tuple(waves), lost, **mark)
