"""Where a family of breathers changes: its stability, its energy's extrema."""

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np

from ..checks import one_of, refuse, tolerance
from ..continuation import continuation
from ..lattice import State
from ..tuning import one_thread
from ..types import Scalar
from .branch import Bifurcation, Branch
from .confirm import BRANCH, LEFT_ON_BRANCH, RESOLVED
from .families import energy_slope
from .half_period import Spectrum, spectra_of

KINDS = ("real pair at +1", "period doubling", "Krein collision", "extremum of energy")
HALVINGS = 40
# distance from +1 within which half-traces are taken together, and what their error is at least
NEAR, LEAST_ERROR = 1e-4, 1e-12


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
    for i in range(len(branch) - 1):
        ends = [_at(branch, i, 0.0), _at(branch, i, None)]
        for kind in kinds:
            counts = [point.count(kind) for point in ends]
            if counts[0] == counts[1]:
                continue
            point = _locate(branch, i, kind, ends, accuracy)
            state = branch._family.shooting.state(jnp.asarray(point.z[:-1]))
            found.append(
                Bifurcation(
                    kind,
                    float(branch._family.value(point.z[-1])),
                    i,
                    State(*state),
                    None,
                    *counts,
                    _mark=branch._mark,
                    _space=branch._space,
                )
            )
    return found


class _Point:
    """A solution on a branch and the branch's tangent there, with what is counted at it."""

    def __init__(self, branch, z, tangent):
        self.branch, self.z, self.tangent = branch, z, tangent
        self._spectrum = None

    @property
    def spectrum(self) -> Spectrum:
        if self._spectrum is None:
            self._spectrum = next(spectra_of(self.branch._family, self.z[None, :-1], self.z[-1:]))
        return self._spectrum

    def count(self, kind: str) -> int:
        """How many of a kind; the energy's slope along the branch, 0 or 1."""
        if kind == "extremum of energy":
            return int(
                energy_slope(self.branch._family, jnp.asarray(self.z), jnp.asarray(self.tangent))
                > 0
            )
        traces, symmetries = self.spectrum.half_traces, self.spectrum.expected // 2
        # mu that nearly meet split like a square root of the error, their sum does not: near 1 the sum decides
        error = max(self.spectrum.step_error, LEAST_ERROR)
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


def _at(branch, i, s):
    """The solution at the length s along the i-th tangent; `None` is the next breather itself."""
    family, curve = branch._family, branch._curve
    if s is None or s == 0:
        j = i if s == 0 else i + 1
        return _Point(branch, np.append(curve.x[j], curve.p[j]), curve.tangents[j])
    eps = float(jnp.finfo(family.shooting.scale.dtype).eps)
    near = continuation(
        family.residual,
        curve.x[i],
        curve.p[i],
        direction=curve.tangents[i],
        arclength=s,
        points=1,
        tolerance=max(LEFT_ON_BRANCH * BRANCH, RESOLVED * eps),
        linearise=family.linearise,
    )
    return _Point(branch, np.append(near.x[0], near.p[0]), near.tangents[0])


def _locate(branch, i, kind, ends, accuracy):
    along = branch._curve.tangents[i]
    low, high = 0.0, float((ends[1].z - ends[0].z) @ along)
    behind = ends[1].count(kind)
    point = ends[0]
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        point = _at(branch, i, middle)
        if point.count(kind) == behind:
            high = middle
        else:
            low = middle
        if abs((high - low) * along[-1]) < accuracy * point.z[-1] / 4:
            break
    return point
