"""Where a family of breathers changes: its stability, its energy's extrema."""

from collections.abc import Sequence
from functools import cached_property

import jax.numpy as jnp
import numpy as np

from ..checks import one_of, refuse, tolerance
from ..continuation.system import Point
from ..tuning import one_thread
from ..types import Scalar
from .branch import Bifurcation, Branch, bifurcation_at
from .examined import examined
from .families import energy_slope
from .problems import Family
from .spectrum import reversible_multipliers

KINDS = ("real pair at +1", "period doubling", "Krein collision", "extremum of energy")
# distance from +1 within which half-traces are taken together
NEAR = 1e-4
# the least error of a half-trace
LEAST_ERROR = 1e-12


@one_thread
def bifurcations(
    branch: Branch, kinds: Sequence[str] = KINDS, *, accuracy: Scalar = 1e-9
) -> list[Bifurcation]:
    r"""Bifurcations along a family, each located between two neighbouring breathers.

    With mu = (rho + 1/rho)/2: a pair leaves the circle at +1 where mu crosses 1, at -1 (period doubling) where it
    crosses -1; two pairs of unlike Krein signature leave it together where two mu meet and become complex. Where mu is
    1 within its error it counts as the symmetries', which stand there anyway.

    **Arguments:** `branch`: of `gx.breathers.family`. `kinds`: which, of "real pair at +1", "period doubling", "Krein
    collision", "extremum of energy". `accuracy`: relative, of the frequency.

    **Returns:** a list of `Bifurcation` in the order of the branch. A pair that comes and goes between two breathers
    is not seen: give the family a shorter `longest_arclength`.

    **Example:**

    >>> chain = gx.scenes.klein_gordon(5, 0.02)
    >>> branch = gx.breathers.family(chain, points=3, arclength=0.3, steps=64)
    >>> branch.verdict.tolist(), gx.breathers.bifurcations(branch)
    (['stable', 'stable', 'stable'], [])
    """
    if not branch._family.shooting.reversible:
        refuse(
            "branch",
            "a family of breathers",
            "a branch of forced orbits",
            "Its own are branch.bifurcations.",
        )
    for kind in kinds:
        one_of("kinds", kind, KINDS)
    accuracy, found = float(tolerance("accuracy", accuracy, 1, 1e-9)), []
    family, curve = branch._family, branch._curve
    for i in range(len(branch) - 1):
        way, points = family.between(curve, i), {}
        ends = tuple(way.known.values())

        def count(point, kind):
            key = point.z.tobytes()
            points.setdefault(key, _Counted(family, point))
            return points[key].count(kind)

        for kind in kinds:
            before, behind = (count(point, kind) for point in ends)
            if before == behind:
                continue
            share = accuracy * curve.p[i] / 4 / way.length
            point = way.zero(lambda point: 1.0 if count(point, kind) == behind else -1.0, share)
            found.append(bifurcation_at(family, kind, point.z, i, None, before, behind))
    return found


class _Counted:
    """A breather of a branch, with what is counted at it."""

    def __init__(self, family: Family, point: Point):
        self.family, self.z, self.tangent = family, point.z, point.tangent

    @cached_property
    def spectrum(self) -> tuple:
        """The half-traces, and the error of a step."""
        found = examined(self.family, self.z)
        return reversible_multipliers(*np.asarray(found.maps))[0], found.step_error

    def count(self, kind: str) -> int:
        """How many of a kind; the energy's slope along the branch, 0 or 1."""
        if kind == "extremum of energy":
            slope = energy_slope(self.family, jnp.asarray(self.z), jnp.asarray(self.tangent))
            return int(slope > 0)
        traces, step_error = self.spectrum
        symmetries = 1 + self.family.shooting.moves.shape[1]
        # mu that nearly meet split like a square root of the error, their sum does not: near 1 the sum decides
        error = max(step_error, LEAST_ERROR)
        near = np.abs(traces - 1) < max(NEAR, 10 * np.sqrt(error))
        apart = traces[~near]
        real = np.abs(apart.imag) <= np.sqrt(error)
        if kind == "Krein collision":
            return int(np.sum(~real)) // 2
        if kind == "period doubling":
            return int(np.sum(apart[real].real < -1))
        beyond = int(np.sum(apart[real].real > 1))
        if np.sum(near) == symmetries + 1:
            return beyond + int(np.sum(traces[near] - 1).real > 0)
        return beyond + int(np.sum(np.sort(traces[near].real)[symmetries:] > 1 + np.sqrt(error)))
