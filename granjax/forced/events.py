"""Bifurcations between two points of a branch, from the moduli of its multipliers."""

from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq

from ..continuation import continuation
from ..lattice import State

FOLD, BRANCH_POINT, DOUBLING, TORUS = "fold", "branch point", "period doubling", "Neimark-Sacker"
# fractions of the way between two points: how near a bifurcation is found, and how far another one lies at least
LOCATED, APART = 1e-10, 1e-7


class Bifurcation(NamedTuple):
    """A change of stability on a branch of forced orbits.

    - `kind`: "fold" (a multiplier +1 and dp = 0: saddle-node), "branch point" (+1 elsewhere: another branch crosses,
      as where a symmetry breaks), "period doubling" (-1), "Neimark-Sacker" (a complex pair on the unit circle).
    - `p`: value of the parameter. `multiplier`: on the unit circle, of a pair the one above the real axis; as far as
      its modulus is from 1, so far was it located. `state`: of the orbit, at t0. `after`: index of the point before.
    """

    kind: str
    p: float
    multiplier: complex
    state: State
    after: int


class Between:
    """The branch between two of its points, z = (x, q), over a fraction s of the chord that joins them.

    `at_ends`: multipliers there. `look(z)`: multipliers of the orbit z. `settings`: tolerance and derivative, as
    continuation takes them.
    """

    def __init__(self, family, look, ends, at_ends, settings):
        self.family, self.look, self.ends, self.settings = family, look, ends, settings
        self.known = {0.0: (ends[0], at_ends[0]), 1.0: (ends[1], at_ends[1])}

    def at(self, s):
        """(z, multipliers) of the orbit in the plane across the chord at s."""
        if s not in self.known:
            low, chord = self.ends[0], self.ends[1] - self.ends[0]
            curve = continuation(self.family.residual, low[:-1], low[-1], direction=chord,
                                 arclength=s * np.linalg.norm(chord), points=1, **self.settings)
            z = np.append(curve.x[0], curve.p[0])
            self.known[s] = z, self.look(z)
        return self.known[s]

    def crossings(self):
        """Fractions at which a modulus passes 1, in order: as many as the number of unstable multipliers changes by."""
        counts = [np.count_nonzero(np.abs(self.at(s)[1]) > 1) for s in (0.0, 1.0)]
        found = []
        for k in range(min(counts), max(counts)):
            # the k-th modulus in order of size is continuous, whatever the multipliers do
            excess = lambda s: float(np.sort(np.abs(self.at(s)[1]))[::-1][k] - 1)
            try:
                s = brentq(excess, 0.0, 1.0, xtol=LOCATED, rtol=LOCATED)
            except RuntimeError:  # Newton failed on the way: as near as it came
                s = min(self.known, key=lambda s: abs(excess(s)))
            if not found or min(abs(s - other) for other in found) > APART:
                found.append(s)
        return sorted(found)


def kind_of(multiplier, near=1e-5):
    """The kind of a bifurcation with this multiplier on the unit circle; one at +1 is a branch point."""
    if abs(multiplier.imag) > near:
        return TORUS
    return BRANCH_POINT if multiplier.real > 0 else DOUBLING


def critical(multipliers):
    """The multiplier nearest to the unit circle, of a pair the one above the real axis."""
    rho = multipliers[np.argmin(np.abs(np.abs(multipliers) - 1))]
    return complex(rho.real, abs(rho.imag))
