"""Where a branch changes: its stability, its direction, the energy's extrema; located between two of its points."""

from collections.abc import Callable, Sequence
from functools import cached_property

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..checks import one_of, refuse, tolerance
from ..continuation import Curve
from ..continuation.system import Point
from ..tuning import one_thread
from ..types import Scalar
from .branch import BRANCH_POINT, DOUBLING, FOLD, TORUS, Bifurcation, Branch, bifurcation_at
from .examined import examined
from .problems import Family
from .spectrum import reversible_multipliers

KINDS = ("real pair at +1", "period doubling", "Krein collision", "extremum of energy")
# distance from +1 within which half-traces are taken together
NEAR = 1e-4
# the least error of a half-trace
LEAST_ERROR = 1e-12
# of the way between two points, how near a bifurcation is found, and how far another one lies at least
LOCATED = 1e-10
APART = 1e-7


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
        way, points, events = family.between(curve, i), {}, []
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
            events.append((kind, point.z, before, behind))
        events.sort(key=lambda event: (event[1] - way.begin) @ way.direction)
        found += [bifurcation_at(family, kind, z, i, None, *counts) for kind, z, *counts in events]
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
            slope = _energy_slope(self.family, jnp.asarray(self.z), jnp.asarray(self.tangent))
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


@eqx.filter_jit
def _energy_slope(problem, z, tangent):
    """dE/ds along a tangent (x, q) of a branch."""

    def total(z):
        state = problem.shooting.state(z[:-1])
        return problem.scene(z[-1])[0].energy(0.0, state.u, state.v)

    return jax.jvp(total, (z,), (tangent,))[1]


def along_forced(
    family: Family, curve: Curve, multipliers: Sequence[np.ndarray], response: Callable
) -> tuple[Bifurcation, ...]:
    """Those of a branch of forced orbits, in its order; folds are known already.

    Where the number of multipliers outside the unit circle changes, by Brent's method on the modulus that passes 1.
    """
    found, zs = [], np.column_stack([curve.x, curve.p])
    for i, (begin, end) in enumerate(zip(zs[:-1], zs[1:])):
        known = {begin.tobytes(): multipliers[i], end.tobytes(): multipliers[i + 1]}

        def look(z):
            if z.tobytes() not in known:
                maps = examined(family, z, response).maps
                known[z.tobytes()] = np.linalg.eigvals(np.asarray(maps[0]))
            return known[z.tobytes()]

        events = [(FOLD, np.append(s.x, s.p)) for s in curve.special if s.after == i]
        folds, chord = len(events), end - begin
        for z in _crossings(family.between(curve, i, chord / np.linalg.norm(chord)), look):
            kind = kind_of(critical(look(z)))
            if kind == BRANCH_POINT and folds:  # it passes 1 at a fold too
                folds -= 1
            else:
                events.append((kind, z))
        events.sort(key=lambda event: (event[1] - begin) @ chord)
        found += [bifurcation_at(family, kind, z, i, critical(look(z))) for kind, z in events]
    return tuple(found)


def _crossings(way, look):
    """Where moduli pass 1 between two points, in order: as many as the number of unstable multipliers changes by."""
    moduli = lambda point: np.sort(np.abs(look(point.z)))[::-1]
    counts = sorted(np.count_nonzero(moduli(point) > 1) for point in way.known.values())
    found = []
    for k in range(*counts):
        # the k-th modulus in order of size is continuous, whatever the multipliers do
        z = way.zero(lambda point: float(moduli(point)[k] - 1), LOCATED).z
        if all(np.linalg.norm(z - other) > APART * way.length for other in found):
            found.append(z)
    return sorted(found, key=lambda z: (z - way.begin) @ way.direction)


def kind_of(multiplier: complex, near: float = 1e-5) -> str:
    """The kind of a bifurcation with this multiplier on the unit circle; one at +1 is a branch point."""
    if abs(multiplier.imag) > near:
        return TORUS
    return BRANCH_POINT if multiplier.real > 0 else DOUBLING


def critical(multipliers: np.ndarray) -> complex:
    """The multiplier nearest to the unit circle, of a pair the one above the real axis."""
    rho = multipliers[np.argmin(np.abs(np.abs(multipliers) - 1))]
    return complex(rho.real, abs(rho.imag))
