r"""A stationary front of a chain with dashpots: Newton's method on its integrated equation.

In units of the jump, z = 0 ahead (x -> infinity) and 1 behind, f(0) = 0, f(1) = 1, lengths in
contacts, the advance-delay equation becomes

    z = tent * f(z) - zeta tent * z',  zeta = eta/(m s).

On places h apart, 1/h an integer, tent * is a sum over the places times a stencil that is exact for
polynomials of degree 2 STENCIL + 1; for h >= 1 it is the stencil alone. z = 1 behind follows from
the other equations, so one of them is redundant: the first is replaced by the front's place.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
import scipy

from ..base.programs import compiled
from .damped import damped
from .medium import fine_force
from .shape import ContactShape
from .tent import RULE

# The number of places on either side of the middle one in the stencil of the tent.
STENCIL = 7
# The first distance h of the places, times the fastest rate of the tails.
FIRST = 0.5
# The difference of two resolutions that agree.
AGREE = 1e-13
# The error below which rounding may be reached.
FLOOR = 1e-7
# The powers of e by which the tails fall before they are cut.
DEEP = 38.0
# The extra contacts beyond each tail, or the extra places where these are further apart.
BEYOND = 4.0
# The residual of Newton's method below which a front is found.
CONVERGED = 1e-9
# The first ratio of one damping to the one before it.
CHANGE = 0.7
# The largest value of this ratio: where smaller changes are needed, the search ends.
LEAST_CHANGE = 0.98
# The most places.
PLACES = 400_000
# The search for a first front ends where its places are closer than this power of 1/2 contacts.
HALVINGS = 7
# The least distance of the places of a finished front.
FINEST = 2.0**-7
# The error that is accepted there, where a contact opens and the error falls slowly.
KINKED = 1e-5


def _powers():
    # Return coefficients of (t - 1/2)^k from values at t = 1 - STENCIL, ..., STENCIL, exactly.
    odd = 2.0 * np.arange(2 * STENCIL) + 1 - 2 * STENCIL
    lagrange = [
        np.poly(np.delete(odd, j))[::-1] / np.prod(odd[j] - np.delete(odd, j))
        for j in range(2 * STENCIL)
    ]
    return np.transpose(lagrange) * 2.0 ** np.arange(2 * STENCIL)[:, None]


_POWERS = _powers()
# The length of the smallest table; others are longer by powers of 4.
TABLE = 4096


class Front(NamedTuple):
    """A front in units of the jump: z (z[centre] = 1/2 at x = 0), its residual and its error."""

    z: np.ndarray
    centre: int
    apart: float
    residual: float
    error: float

    @property
    def places(self) -> np.ndarray:
        """x of each z, increasing, from behind the front on."""
        return self.apart * (np.arange(len(self.z)) - self.centre)

    def at(self, x: np.ndarray) -> np.ndarray:
        """Return z at any places, by the polynomials of its table."""
        return interpolated(np, coefficients(np, self.z), self.centre, self.apart, x)


class Kernels(NamedTuple):
    """The tent and its derivative as sums over equidistant places."""

    tent: np.ndarray
    slope: np.ndarray

    @classmethod
    def of(cls, apart: float) -> "Kernels":
        """Build them for places 1/2^k apart, or a contact or more."""
        inside = round(1 / apart)
        tent, slope = _stencils(1.0 if inside > 1 else 1 / apart)
        if inside > 1:
            whole = np.convolve(np.ones(inside), np.ones(inside)) / inside**2
            tent = np.convolve(whole, tent)
            slope = np.convolve(whole, slope)
        return cls(tent, slope / apart)

    @property
    def reach(self) -> int:
        """The number of places read on either side."""
        return len(self.tent) // 2

    def gap(self, z: np.ndarray, f: np.ndarray, zeta: float) -> np.ndarray:
        """Return z - tent * f + zeta tent * z' at the places."""
        return z - self.along(f, self.tent) + zeta * self.along(z, self.slope)

    def along(self, x: np.ndarray, kernel: np.ndarray) -> np.ndarray:
        """Return a kernel's sum over x, 1 behind and 0 beyond."""
        wide = np.concatenate([np.ones(self.reach), x, np.zeros(self.reach)])
        return np.convolve(wide, kernel, "valid")

    def solve(self, bands: np.ndarray, right: np.ndarray) -> np.ndarray:
        """Solve the equations of a Jacobian."""
        return scipy.linalg.solve_banded((self.reach, self.reach + 1), bands, right)


def _stencils(width):
    # Return weights of z(x + j h), |j| <= STENCIL, for a tent `width` h wide and its slope.
    j = np.arange(STENCIL + 1.0)
    i = np.arange(STENCIL + 1)
    moments = 2 / ((2 * i + 1) * (2 * i + 2)) * width ** (2 * i)
    even = np.vander(j**2, increasing=True).T * np.where(j > 0, 2.0, 1.0)
    odd = 2 * j[1:] * np.vander(j[1:] ** 2, increasing=True).T
    tent = np.linalg.solve(even, moments)
    slope = np.linalg.solve(odd, (2 * i + 1)[:-1] * moments[:-1])
    return np.append(tent[:0:-1], tent), np.concatenate([slope[::-1], [0.0], -slope])


def ordered(gap: np.ndarray, middle: Any, centre: int) -> np.ndarray:
    """Order the equations: the row of the first one is replaced by that of the middle."""
    return np.concatenate([gap[1 : centre + 1], [middle], gap[centre + 1 :]])


def jacobian(kernels: Kernels, slope: np.ndarray, zeta: float, centre: int) -> np.ndarray:
    """Return the ordered equations' Jacobian in z, as bands of `solve_banded`."""
    reach = kernels.reach
    count = len(slope)
    bands = np.zeros((2 * reach + 2, count))
    columns = np.arange(count)
    for k in range(-reach, reach + 1):
        entries = zeta * kernels.slope[reach + k] - kernels.tent[reach + k] * slope + (k == 0)
        rows = columns + k
        up = (rows >= 1) & (rows <= centre)
        down = (rows > centre) & (rows < count)
        bands[reach + k, up] = entries[up]
        bands[reach + 1 + k, down] = entries[down]
    bands[reach + 1, centre] = 1.0
    return bands


class Trial(NamedTuple):
    """A damping, and the rates of its front's tails, which determine the places."""

    zeta: float
    behind: complex
    ahead: float

    def spacing(self) -> float:
        """Return a first distance of places, a power of two."""
        fastest = max(abs(self.behind), self.ahead)
        return float(2.0 ** max(-2.0, np.floor(np.log2(FIRST / fastest))))

    def first(self, x: np.ndarray) -> np.ndarray:
        """Return a guess that falls as the tails do."""
        rate = np.where(x < 0, self.behind.real, self.ahead)
        return scipy.special.expit(-rate * x)

    def layout(self, apart: float) -> tuple[int, int]:
        """Return the number of places and the centre's index."""
        centre, after = (
            int(np.ceil((DEEP / rate + BEYOND * max(1.0, apart)) / apart))
            for rate in (self.behind.real, self.ahead)
        )
        return centre + after + 1, centre

    def solved(self, force: Callable, apart: float, shape: Callable) -> Front | None:
        """Return the front near a guess; `None` beyond `PLACES`."""
        count, centre = self.layout(apart)
        if count > PLACES:
            return None
        kernels = Kernels.of(apart)

        def equations(z):
            f, slope = force(z)
            gap = ordered(kernels.gap(z, f, self.zeta), z[centre] - 0.5, centre)
            return gap, jacobian(kernels, slope, self.zeta, centre)

        found = damped(equations, kernels.solve, shape(apart * (np.arange(count) - centre)))
        return Front(found.x, centre, apart, found.residual, np.inf)


def followed(force: Callable, trial: Callable, zeta: float, start: float) -> tuple[Callable, float]:
    """Follow a coarse front from a larger damping to `zeta`; return it and the residual.

    `trial(zeta)`: a `Trial`; `force(z)`: f and its slope.
    """
    now = max(zeta, start)
    change = CHANGE
    apart = trial(zeta).spacing()
    shape = trial(now).first
    last = None
    if 4 * trial(zeta).layout(apart)[0] > PLACES:
        return shape, np.inf
    while True:
        front = trial(now).solved(force, apart, shape)
        if front is None:
            return shape, np.inf
        if front.residual < CONVERGED:
            shape = front.at
            last = now
            if now == zeta:
                return shape, front.residual
        elif last is None:
            if apart < 2.0**-HALVINGS:
                return shape, front.residual
            apart /= 2
            continue
        else:
            change = np.sqrt(change)
            if change > LEAST_CHANGE:
                return shape, front.residual
        now = max(zeta, (last or now) * change)


def finished(force: Callable, found: Trial, shape: Callable) -> Front | None:
    """Refine a front until two resolutions agree; `None` where this takes too many places."""
    apart = found.spacing()
    before = np.inf
    front = None
    while True:
        # Where a contact opens within the front, it is not smooth, and its error falls slowly.
        finer = None if apart < FINEST else found.solved(force, apart, shape)
        if finer is None:
            return front if front is not None and front.error < KINKED else None
        # The change from the coarser front bounds the error.
        error = np.inf if front is None else float(np.abs(front.at(finer.places) - finer.z).max())
        settled = error <= AGREE or error < FLOOR and error > before / 4
        if settled and error > before:
            return front
        front = finer._replace(error=error)
        if settled:
            return front
        before = error
        shape = front.at
        apart = apart / 2


def moved(
    front: Front, slope: np.ndarray, zeta: float, force: np.ndarray, more: np.ndarray
) -> np.ndarray:
    """Return the change of z (I, P) with f and zeta.

    `force` (I, P): the changes of f at fixed z; `more` (P,): those of zeta; `slope`: f'(z).
    """
    kernels = Kernels.of(front.apart)
    bands = jacobian(kernels, slope, zeta, front.centre)
    drag = kernels.along(front.z, kernels.slope)
    pushed = np.stack([np.convolve(x, kernels.tent, "same") for x in force.T], -1)
    gap = ordered(drag[:, None] * more - pushed, np.zeros(len(more)), front.centre)
    return -kernels.solve(bands, gap)


def padded(front: Front) -> np.ndarray:
    """Return the table padded with zeros ahead to one of few lengths."""
    size = TABLE
    while size < len(front.z):
        size *= 4
    return np.pad(front.z, (0, size - len(front.z)))


def coefficients(xp: Any, z: Any) -> Any:
    """Return coefficients in powers of t - 1/2 of every cell of a table, (2 STENCIL, places).

    The table continues as 1 behind and as 0 beyond. `xp`: NumPy or JAX.
    """
    wide = xp.concatenate([xp.ones(STENCIL - 1), z, xp.zeros(STENCIL)])
    count = len(z)
    return xp.asarray(_POWERS) @ xp.stack([wide[j : j + count] for j in range(2 * STENCIL)])


def interpolated(xp: Any, rows: Any, centre: Any, apart: Any, x: Any) -> Any:
    """Return z at places, from the coefficients of its cells."""
    at = xp.clip(x / apart + centre, 0.0, rows.shape[1] - 1.0)
    cell = at.astype(int)
    t = at - cell - 0.5
    total = 0.0
    for row in rows[::-1]:
        total = total * t + row[cell]
    return total


class FrontShape(ContactShape):
    r"""The shape with strain ahead + jump z(x), with the beads ahead at rest.

    With eta the dashpot and y the strain, the dashpot subtracts eta s (y(x) - y(x - 1)) from m s
    v(x) and adds eta s int_{x-1}^x (y - ahead) to m s^2 u(x). u counts from a bead's place ahead of
    the front. `law` is measured from the strain ahead.
    """

    centre: Any
    dashpot: Any
    ahead: Any
    jump: Any

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
        near = self.over(xi[..., None] - RULE[0]) @ jnp.asarray(RULE[1])
        return super().displacement(xi) + self.dashpot * near / (self.mass * self.speed)

    def beyond(self, x):
        behind = jnp.maximum(self.first - x, 0.0) * fine_force(self.law, self.jump)
        return super().beyond(x) + behind


@compiled
def shape_of(z: Any, numbers: dict) -> FrontShape:
    """Build the shape from z at places."""
    return FrontShape(rows=coefficients(jnp, z), **numbers).with_edges(0.0)
