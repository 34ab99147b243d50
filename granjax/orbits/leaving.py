"""What leaves a branch at a bifurcation: normal forms, doubled orbits, the first step."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy
from jax.flatten_util import ravel_pytree

from ..base.checks import refuse
from ..base.programs import compiled
from ..continuation.arclength import NotFound, directions, linearised
from ..flow import Flow
from ..results import Result, array
from .orbit import AT_REST
from .problems import Family, over_omega, period_at

# The relative rounding of third derivatives.
ROUNDING = 1e-9
# The factor on the change of a coefficient with the steps that gives its error.
SAFETY = 2
# Newton's method may leave the orbit this far (relative to its size) from a symmetric branch point,
# which makes a quadratic coefficient that is not there.
PLACED = 1e-3
# Imaginary parts of a multiplier below this are rounding.
REAL = 1e-6
# Singular values below this share of the largest count as zero.
SINGULAR = 1e-4


class NormalForm(Result):
    """The normal form of a bifurcation: what `branch.normal_form(i)` returns."""

    kind: str = array(
        'The bifurcation; a branch point is "pitchfork" or "transcritical".', static=True
    )
    coefficient: float = array(
        "The coefficient c of the return map along the critical direction: x + c x^2 "
        "(transcritical), x + c x^3 (pitchfork), -x + c x^3 (period doubling), exp(i theta) x "
        "(1 + c |x|^2) (Neimark-Sacker, the real part of c). x is in units of the orbit's size "
        "there (at rest: of the amplitude at which forces become nonlinear)."
    )
    error: float = array("The error of the coefficient, from twice the steps.")
    criticality: str = array(
        '"supercritical": what leaves is stable where the branch is not; "subcritical"; '
        '"undecided" within the error; "" for a transcritical point.',
        static=True,
    )

    @property
    def outcome(self) -> str:
        """The verdict, in one sentence."""
        word = f"{self.criticality} " if self.criticality else ""
        said = f"{word}{self.kind}"
        return f"{said[0].upper()}{said[1:]}: c = {self.coefficient:.6g} +- {self.error:.1g}."


def normal_form(family: Family, z: np.ndarray, kind: str, multiplier: complex) -> NormalForm:
    """Compute the coefficient that decides in which direction orbits leave a bifurcation.

    z = (x, q) is a point of a family of forced orbits.
    Source: Kuznetsov, Elements of Applied Bifurcation Theory, chapters 5 and 8.
    """
    steps = family.shooting.whole.steps
    found = [_coefficients(family, z, multiplier, by * steps) for by in (1, 2)]
    size = np.linalg.norm(z[: family.shooting.scale.size])
    size = size if size > AT_REST else 1.0
    (square, cubic), (square2, cubic2) = ((a * size, b * size**2) for a, b in found)
    about = lambda a, b, size: SAFETY * abs(a - b) + ROUNDING * size
    error = about(cubic, cubic2, abs(cubic))
    sign = -1 if kind == "period doubling" else 1
    if kind == "branch point":
        if abs(square) > PLACED * abs(cubic):
            error = about(square, square2, abs(square) + PLACED * abs(cubic))
            return NormalForm("transcritical", float(square), float(error), "")
        kind = "pitchfork"
        error = error + abs(square)
    word = "supercritical" if sign * cubic < 0 else "subcritical"
    return NormalForm(kind, float(cubic), float(error), word if abs(cubic) > error else "undecided")


def _coefficients(family, z, multiplier, steps):
    # The quadratic and the cubic coefficient at the critical multiplier, by `steps` per period.
    along = lambda *directions: np.asarray(_derivative(family, z, jnp.asarray(steps), directions))
    A = along()
    one = np.eye(len(A))
    rho, p, q = _eigenvectors(A, multiplier)
    p = p / np.vdot(p, q).conj()
    if abs(rho.imag) < REAL:
        p = p.real
        q = q.real
        square = along(q, q)
        # Bordered, because I - A is singular where the multiplier is 1.
        h = _bordered(one - A, q, p, square) if rho.real > 0 else np.linalg.solve(one - A, square)
        return p @ square / 2, p @ (along(q, q, q) + 3 * along(q, h)) / 6

    def B(a, b):
        (ar, ai), (br, bi) = ((x.real, x.imag) for x in (a, b))
        return along(ar, br) - along(ai, bi) + 1j * (along(ar, bi) + along(ai, br))

    r = q.real
    s = q.imag
    cubic = along(r, r, r) + along(r, s, s) + 1j * (along(r, r, s) + along(s, s, s))
    turn = rho / abs(rho)
    mean = np.linalg.solve(one - A, B(q, q.conj()))
    twice = np.linalg.solve(turn**2 * one - A, B(q, q))
    d = np.vdot(p, cubic + 2 * B(q, mean) + B(q.conj(), twice)) / 2
    return 0.0, (d / turn).real


def _eigenvectors(A, multiplier):
    # The eigenvalue of A nearest to a multiplier, and its unit left and right eigenvectors.
    values, left, right = scipy.linalg.eig(A, left=True)
    i = np.argmin(np.abs(values - multiplier))
    p = left[:, i]
    q = right[:, i]
    if abs(values[i].imag) < REAL:
        q, p = (x * np.exp(-1j * np.angle(x[np.argmax(np.abs(x))])) for x in (q, p))
    return values[i], p, q


def _bordered(matrix, right, left, b):
    # h with matrix h = b up to a multiple of the left null vector, and right . h = 0.
    whole = np.block([[matrix, left[:, None]], [right[None], np.zeros((1, 1))]])
    return np.linalg.solve(whole, np.append(np.real(b), 0.0))[:-1]


@compiled
def _derivative(family, z, steps, along):
    # The matrix of the map over a period in units of the branch, or its derivative along each of
    # some directions.
    shooting = family.shooting
    lattice, period = family.scene(z[-1])
    unravel = ravel_pytree(shooting.like)[1]
    scale = shooting.scale
    x = z[: scale.size]
    flow = Flow(steps, shooting.flow.solver)

    def mapped(x):
        y = unravel(x * scale)
        return ravel_pytree(flow(y, shooting.t0, shooting.t0 + period, lattice))[0] / scale

    if not along:
        return jax.jacfwd(mapped)(x)
    for direction in along:
        mapped = _slope(mapped, direction)
    return mapped(x)


def _slope(f, direction):
    return lambda x: jax.jvp(f, (x,), (jnp.asarray(direction, x.dtype),))[1]


def _twice(period, p):
    return 2 * period_at(period, p)


def _doubled(family):
    # The same orbits with twice the period. For a family over the frequency the parameter is
    # halved.
    if family.period is over_omega:
        changed = {"start": family.start / 2, "span": family.span / 2}
    else:
        changed = {"period": eqx.Partial(_twice, family.period)}
    return dataclasses.replace(family, shooting=family.shooting.finer(2), **changed)


def ways(family: Family, z: np.ndarray, kind: str, tangent: np.ndarray) -> tuple:
    """Return (family, x, q, direction) of what leaves the point z = (x, q) of a branch."""
    if kind == "branch point":
        try:
            point = family.system().correct(z, tangent, tangent)
        except NotFound as reason:
            raise RuntimeError(f"The branch point was not found again: {reason}.") from None
        both = directions(family.system(), kind, point, tangent)
        return family, point.x, point.p, both[1]
    longer = _doubled(family)
    q = jnp.asarray(z[-1])
    state = family.shooting.state(z[:-1])
    scene = family.scene(q)
    tried = [state]
    # A breather is at rest twice in a period, and the doubled one at one of the two.
    if family.shooting.reversible:
        tried.append(family.shooting.flow(state, 0.0, scene[1] / 2, scene[0]))
    for start in tried:
        x = longer.shooting.guess(start, longer.scene(q))
        _, values, right = np.linalg.svd(linearised(longer, x, q)[1])
        if values[-1] <= SINGULAR * values[0] or len(tried) == 1:
            return longer, np.asarray(x), float(q), np.append(right[-1], 0.0)
    refuse("i", "a doubling whose orbit rests at 0 or T/2", "one whose branch was not found")
