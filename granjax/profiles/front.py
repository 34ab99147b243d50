r"""A stationary front of a chain with dashpots: Newton's method on its advance-delay equation, in integrated form.

In units of the jump, z = 0 ahead (x -> infinity) and 1 behind, f(0) = 0, f(1) = 1, lengths in contacts:

    z = tent * f(z) - zeta tent * z',  zeta = eta/(m s).

On places h apart, 1/h whole, tent * is a sum over the places times a stencil that is exact for polynomials of degree
2 STENCIL + 1; where h >= 1 the stencil alone. The unknowns are one more than the independent equations, because z = 1
behind follows from the others: the front's place stands in for the first one.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from scipy.linalg import solve_banded

from ..programs import compiled
from .damped import damped
from .medium import fine_force
from .shape import ContactShape
from .tent import RULE

STENCIL = 7
# h times the fastest rate of the tails at first; what two resolutions may differ by, and where rounding may be met
FIRST, AGREE, FLOOR = 0.5, 1e-13, 1e-7
# powers of e that the tails fall by before they end, and contacts besides
DEEP, BEYOND = 38.0, 4.0
CONVERGED = 1e-9
# of the damping from one front to the next, and the least such change; most places
CHANGE, LEAST_CHANGE, PLACES, HALVINGS = 0.7, 0.98, 400_000, 7
# least distance of places, and the error that is put up with there
FINEST, KINKED = 2.0**-7, 1e-5


def _powers():
    """Coefficients of (t - 1/2)^k from values at t = 1 - STENCIL, ..., STENCIL: products of odd numbers, exact."""
    odd = 2.0 * np.arange(2 * STENCIL) + 1 - 2 * STENCIL
    lagrange = [
        np.poly(np.delete(odd, j))[::-1] / np.prod(odd[j] - np.delete(odd, j))
        for j in range(2 * STENCIL)
    ]
    return np.transpose(lagrange) * 2.0 ** np.arange(2 * STENCIL)[:, None]


_POWERS = _powers()
# places of the smallest table; others have 4^k times that
TABLE = 4096


class Front(NamedTuple):
    """A front in units of the jump: z at places (h apart, z[centre] = 1/2 at x = 0), what is left, and its error."""

    z: np.ndarray
    centre: int
    apart: float
    residual: float
    error: float

    @property
    def places(self) -> np.ndarray:
        """x of each z, increasing: behind the front first."""
        return self.apart * (np.arange(len(self.z)) - self.centre)

    def at(self, x: np.ndarray) -> np.ndarray:
        """z at any places, by the polynomials of its table."""
        return interpolated(np, coefficients(np, self.z), self.centre, self.apart, x)


class Kernels(NamedTuple):
    """The tent and its derivative as sums over places so far apart."""

    tent: np.ndarray
    slope: np.ndarray

    @classmethod
    def of(cls, apart: float) -> "Kernels":
        """For places 1/2^k apart, or one contact and more."""
        inside = round(1 / apart)
        tent, slope = _stencils(1.0 if inside > 1 else 1 / apart)
        if inside > 1:
            whole = np.convolve(np.ones(inside), np.ones(inside)) / inside**2
            tent, slope = np.convolve(whole, tent), np.convolve(whole, slope)
        return cls(tent, slope / apart)

    @property
    def reach(self) -> int:
        """Places to either side that are read."""
        return len(self.tent) // 2

    def gap(self, z: np.ndarray, f: np.ndarray, zeta: float) -> np.ndarray:
        """z - tent * f + zeta tent * z' at the places, of numbers that are 1 behind the first and 0 beyond the last."""
        ends = np.ones(self.reach), np.zeros(self.reach)
        f, wide = (np.concatenate([ends[0], x, ends[1]]) for x in (f, z))
        return (
            z - np.convolve(f, self.tent, "valid") + zeta * np.convolve(wide, self.slope, "valid")
        )

    def solve(self, bands: np.ndarray, right: np.ndarray) -> np.ndarray:
        """The solution of the equations of some Jacobian."""
        return solve_banded((self.reach, self.reach + 1), bands, right)


def _stencils(width):
    """Weights of z(x + j h), |j| <= STENCIL, for a tent that is `width` h wide to either side, and for its slope."""
    j, i = np.arange(STENCIL + 1.0), np.arange(STENCIL + 1)
    moments = 2 / ((2 * i + 1) * (2 * i + 2)) * float(width) ** (2 * i)
    even = np.vander(j**2, increasing=True).T * np.where(j > 0, 2.0, 1.0)
    odd = 2 * j[1:] * np.vander(j[1:] ** 2, increasing=True).T
    tent = np.linalg.solve(even, moments)
    slope = np.linalg.solve(odd, (2 * i + 1)[:-1] * moments[:-1])
    return np.append(tent[:0:-1], tent), np.concatenate([slope[::-1], [0.0], -slope])


def ordered(gap: np.ndarray, middle: Any, centre: int) -> np.ndarray:
    """The equations in the order of their rows: the first one's row is given up for the one of the middle."""
    return np.concatenate([gap[1 : centre + 1], [middle], gap[centre + 1 :]])


def jacobian(kernels: Kernels, slope: np.ndarray, zeta: float, centre: int) -> np.ndarray:
    """Of the ordered equations in z, as the bands of `solve_banded((reach, reach + 1), ...)`."""
    reach, count = kernels.reach, len(slope)
    bands, columns = np.zeros((2 * reach + 2, count)), np.arange(count)
    for k in range(-reach, reach + 1):
        entries = zeta * kernels.slope[reach + k] - kernels.tent[reach + k] * slope + (k == 0)
        rows = columns + k
        up, down = (rows >= 1) & (rows <= centre), (rows > centre) & (rows < count)
        bands[reach + k, up] = entries[up]
        bands[reach + 1 + k, down] = entries[down]
    bands[reach + 1, centre] = 1.0
    return bands


def newton(
    force: Callable, zeta: float, apart: float, z: np.ndarray, centre: int
) -> tuple[np.ndarray, float]:
    """z and the residual that is left; `force(z)` gives f and its slope."""
    kernels = Kernels.of(apart)

    def equations(z):
        f, slope = force(z)
        gap = ordered(kernels.gap(z, f, zeta), z[centre] - 0.5, centre)
        return gap, jacobian(kernels, slope, zeta, centre)

    found = damped(equations, kernels.solve, z)
    return found.x, found.residual


class Trial(NamedTuple):
    """What a front of some damping is looked for with: its tails' rates, and the places that they need."""

    zeta: float
    behind: complex
    ahead: float

    def spacing(self) -> float:
        """A first distance of places, a power of two."""
        fastest = max(abs(self.behind), self.ahead)
        return float(2.0 ** max(-2.0, np.floor(np.log2(FIRST / fastest))))

    def first(self, x: np.ndarray) -> np.ndarray:
        """A front that falls as its tails do."""
        rate = np.where(x < 0, self.behind.real, self.ahead)
        return 1 / (1 + np.exp(np.minimum(rate * x, 700.0)))

    def layout(self, apart: float) -> tuple[int, int]:
        """How many places so far apart there are, and which one is the centre."""
        centre, after = (
            int(np.ceil((DEEP / rate + BEYOND * max(1.0, apart)) / apart))
            for rate in (self.behind.real, self.ahead)
        )
        return centre + after + 1, centre


def followed(force: Callable, trial: Callable, zeta: float, start: float) -> tuple[Callable, float]:
    """A coarse front of one damping, from that of a larger damping down; and the residual.

    `trial(zeta)` gives a `Trial`.
    """
    now, change = max(zeta, start), CHANGE
    apart = trial(zeta).spacing()
    shape, last = trial(now).first, None
    if 4 * trial(zeta).layout(apart)[0] > PLACES:
        return shape, np.inf
    while True:
        count, centre = trial(now).layout(apart)
        if count > PLACES:
            return shape, np.inf
        x = apart * (np.arange(count) - centre)
        z, residual = newton(force, now, apart, shape(x), centre)
        if residual < CONVERGED:
            shape, last = Front(z, centre, apart, residual, np.inf).at, now
            if now == zeta:
                return shape, residual
        elif last is None:
            if apart < 2.0**-HALVINGS:
                return shape, residual
            apart /= 2
            continue
        else:
            change = np.sqrt(change)
            if change > LEAST_CHANGE:
                return shape, residual
        now = max(zeta, (last or now) * change)


def finished(force: Callable, found: Trial, shape: Callable) -> Front | None:
    """The front by finer and finer places until two resolutions agree; `None` where they are too many."""
    apart, before, front = found.spacing(), np.inf, None
    while True:
        count, centre = found.layout(apart)
        # where a contact opens within the front it is not smooth, and its error falls slowly
        if count > PLACES or apart < FINEST:
            return front if front is not None and front.error < KINKED else None
        x = apart * (np.arange(count) - centre)
        z, residual = newton(force, found.zeta, apart, shape(x), centre)
        # this one's error is known to be below the change from the coarser one
        error = np.inf if front is None else float(np.abs(front.at(x) - z).max())
        settled = error <= AGREE or error < FLOOR and error > before / 4
        if settled and error > before:
            return front
        front = Front(z, centre, apart, residual, error)
        if settled:
            return front
        before, shape, apart = error, front.at, apart / 2


def moved(
    front: Front, slope: np.ndarray, zeta: float, force: np.ndarray, more: np.ndarray
) -> np.ndarray:
    """How z changes (I, P) where f at fixed z changes by `force` (I, P) and zeta by `more` (P,); `slope` is f'(z)."""
    kernels = Kernels.of(front.apart)
    bands = jacobian(kernels, slope, zeta, front.centre)
    wide = np.concatenate([np.ones(kernels.reach), front.z, np.zeros(kernels.reach)])
    drag = np.convolve(wide, kernels.slope, "valid")
    pushed = np.stack([np.convolve(x, kernels.tent, "same") for x in force.T], -1)
    gap = ordered(drag[:, None] * more - pushed, np.zeros(len(more)), front.centre)
    return -kernels.solve(bands, gap)


def padded(front: Front) -> np.ndarray:
    """Its table with zeros ahead, of one of few lengths."""
    size = TABLE
    while size < len(front.z):
        size *= 4
    return np.pad(front.z, (0, size - len(front.z)))


def coefficients(xp: Any, z: Any) -> Any:
    """Powers of t - 1/2 within every cell of a table, (2 STENCIL, places), by its nearest values; 1 behind, 0 beyond.

    `xp`: NumPy or JAX.
    """
    wide, count = xp.concatenate([xp.ones(STENCIL - 1), z, xp.zeros(STENCIL)]), len(z)
    return xp.asarray(_POWERS) @ xp.stack([wide[j : j + count] for j in range(2 * STENCIL)])


def interpolated(xp: Any, rows: Any, centre: Any, apart: Any, x: Any) -> Any:
    """z at places, from the coefficients of its cells."""
    at = xp.clip(x / apart + centre, 0.0, rows.shape[1] - 1.0)
    cell = at.astype(int)
    t, total = at - cell - 0.5, 0.0
    for row in rows[::-1]:
        total = total * t + row[cell]
    return total


class FrontShape(ContactShape):
    r"""Strain ahead + jump z(x), and what moves with it, the beads ahead at rest; eta the dashpot, y the strain.

    The dashpot lessens m s v(x) by eta s (y(x) - y(x - 1)) and adds eta s int_{x-1}^x (y - ahead) to m s^2 u(x). u is
    counted from where a bead is ahead of the front. `law` is measured from the strain ahead.
    """

    law: Any
    mass: Any
    speed: Any
    rows: Any
    centre: Any
    length: Any
    dashpot: Any
    ahead: Any
    jump: Any
    edges: Any = None

    @property
    def first(self):
        return -self.centre * self.length

    def over(self, x):
        return self.jump * interpolated(jnp, self.rows, self.centre, self.length, x)

    def strain(self, xi):
        return self.ahead + super().strain(xi)

    def velocity(self, xi):
        drag = self.dashpot * (self.over(xi) - self.over(xi - 1)) / self.mass
        return super().velocity(xi) - drag

    def displacement(self, xi):
        near = self.over(jnp.asarray(xi)[..., None] - RULE[0]) @ jnp.asarray(RULE[1])
        return super().displacement(xi) + self.dashpot * near / (self.mass * self.speed)

    def beyond(self, x):
        behind = jnp.maximum(self.first - x, 0.0) * fine_force(self.law, self.jump)
        return super().beyond(x) + behind


@compiled
def shape_of(z: Any, centre: Any, apart: Any, numbers: dict) -> FrontShape:
    """The shape from z at places."""
    rows = coefficients(jnp, z)
    return FrontShape(rows=rows, centre=centre, length=apart, **numbers).with_edges(0.0)
