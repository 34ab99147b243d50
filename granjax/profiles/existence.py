"""The range of a law's solitary waves: supersonic, where it stiffens, up to a limit."""

from typing import NamedTuple

import numpy as np
import scipy

from ..base.checks import one_of, refuse
from ..laws import Law
from .highest import highest, tops
from .medium import values

# The binary orders of magnitude of strain that are searched in both directions.
ORDERS = 200
# The number of strains in each order of magnitude.
EACH = 4
STRAINS = 2.0 ** (np.arange(-ORDERS * EACH, ORDERS * EACH + 1) / EACH)
# The relative rounding error of 2 W/e^2.
ROUNDING = 1e-10
# The most maxima that are refined: rounding makes many where a law is linear.
MOST = 4
SIDES = {"compression": 1, "tension": -1}


class Bounds(NamedTuple):
    """The range of waves on one side: strains, 2 W/e^2 there, and the stiffness at rest."""

    side: int
    strains: np.ndarray
    secant: np.ndarray
    linear: float

    @property
    def exist(self) -> bool:
        """Whether the law stiffens on this side and its stiffness at rest is finite."""
        least = max(self.linear, self.secant.min())
        return bool(np.isfinite(self.linear) and np.any(self.secant > least * (1 + ROUNDING)))


def bounds(law: Law, side: int) -> Bounds:
    """Return the bounds that the energy W of a law sets to waves on one side.

    A wave of speed c has K2 < m c^2 < max of 2 W(e)/e^2, by its kinetic energy (Friesecke and
    Wattis).
    """
    strains = side * STRAINS
    strains, secant = _with_tops(law, strains, twice_energy(law, strains))
    linear = float(values(law, np.zeros(1))[1][0])
    # A law that is infinitely stiff at rest may return any number there.
    middle = np.interp(1.0, side * strains, secant)
    if np.isfinite(secant[0]) and secant[0] > 2 * max(linear, 0.0) and secant[0] > middle * 1e3:
        linear = np.inf
    return Bounds(side, strains, secant, linear)


def _with_tops(law, strains, secant):
    inner = np.where(np.isfinite(secant), secant, -np.inf)
    places = tops(inner)
    places = places[np.isfinite(secant[places + 1])]
    for i in places[np.argsort(-inner[places])][:MOST]:
        place, value = highest(lambda e: twice_energy(law, e), strains[i - 1], strains[i + 1])
        strains = np.append(strains, place)
        secant = np.append(secant, value)
    order = np.argsort(np.abs(strains), kind="stable")
    return strains[order], secant[order]


def twice_energy(law: Law, e: np.ndarray) -> np.ndarray:
    """Return 2 W(e)/e^2; infinite beyond the end of the law."""
    with np.errstate(all="ignore"):
        secant = 2 * values(law, e)[2] / e / e
    return np.where(np.logical_and.accumulate(np.isfinite(secant)), secant, np.inf)


def reached(law: Law, found: Bounds, level: float) -> float | None:
    """Return the least strain at which 2 W/e^2 reaches a level, or `None`."""
    i = int(np.argmax(found.secant >= level))
    if i == 0:
        return None
    over = lambda e: twice_energy(law, np.array([e]))[0] - level
    return scipy.optimize.bisect(over, *found.strains[i - 1 : i + 1], xtol=1e-300, rtol=1e-15)


def side_of(law: Law, side: str | None, amplitude: float | None) -> Bounds:
    """Return the bounds of the given side, that of the amplitude, or the first with waves."""
    asked = list(SIDES) if side is None else [one_of("side", side, SIDES)]
    if amplitude is not None:
        own = "compression" if amplitude > 0 else "tension"
        if own not in asked:
            refuse("amplitude", f"a strain in {side}", f"{amplitude:g}", "Compression is positive.")
        asked = [own]
    found = [bounds(law, SIDES[one]) for one in asked]
    there = [one for one in found if one.exist]
    if not there:
        why = f"does not stiffen in {' or in '.join(asked)}"
        if not np.isfinite(found[0].linear):
            why = "is infinitely stiff at rest, so that no wave is faster than sound"
        refuse(
            "law",
            "one that has solitary waves",
            f"one that {why}",
            "They need a force that grows faster than the strain: Hertz, FPUT with K3 != 0 or K4 > 0, Toda, p < 1 "
            "in tension.",
        )
    return there[0]
