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

from .medium import fine_force
from .shape import Shape
from .tent import RULE

STENCIL = 7
# h times the fastest rate of the tails at first; what two resolutions may differ by, and where rounding may be met
FIRST, AGREE, FLOOR = 0.5, 1e-13, 1e-7
# powers of e that the tails fall by before they end, and contacts besides
DEEP, BEYOND = 38.0, 4.0
NEWTON, SETTLED, CONVERGED, LEAST_SHARE = 30, 1e-15, 1e-9, 1e-2
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
_T, _W = np.polynomial.legendre.leggauss(12)
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

    def state(z):
        f, slope = force(z)
        gap = ordered(kernels.gap(z, f, zeta), z[centre] - 0.5, centre)
        size = np.abs(gap).max()
        return z, slope, gap, size if np.isfinite(size) and np.isfinite(slope).all() else np.inf

    best = state(z)
    for _ in range(NEWTON):
        z, slope, gap, size = best
        if not np.isfinite(size) or size < SETTLED:
            break
        bands = jacobian(kernels, slope, zeta, centre)
        try:
            step = solve_banded((kernels.reach, kernels.reach + 1), bands, gap)
        except np.linalg.LinAlgError:
            break
        share = 1.0
        while (
            not (new := state(z - share * step))[-1] < size * (1 - share / 4)
            and share > LEAST_SHARE
        ):
            share /= 2
        if not new[-1] < size:
            break
        best = new
    return best[0], float(best[-1])


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
    return -solve_banded((kernels.reach, kernels.reach + 1), bands, gap)


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


class FrontShape(Shape):
    r"""Strain ahead + jump z(x), and what moves with it, the beads ahead at rest; g = F - F ahead, eta the dashpot.

    m s v(x) = int_{x-1}^x g - eta s (y(x) - y(x - 1)),  m s^2 u(x) = int min(1, y + 1 - x)_+ g dy + eta s int_{x-1}^x
    (y - ahead); u is counted from where a bead is ahead of the front.
    """

    law: Any
    mass: Any
    speed: Any
    dashpot: Any
    ahead: Any
    jump: Any
    rows: Any
    centre: Any
    apart: Any
    edges: Any

    @classmethod
    def of(
        cls,
        law: Any,
        mass: Any,
        speed: Any,
        dashpot: Any,
        ahead: Any,
        jump: Any,
        z: Any,
        centre: Any,
        apart: Any,
    ) -> "FrontShape":
        """From z at places; `law` is measured from the strain ahead."""
        rows = coefficients(jnp, z)
        cells = jnp.asarray(np.vander(_T / 2, 2 * STENCIL, increasing=True)) @ rows
        parts = apart * (jnp.asarray(_W / 2) @ fine_force(law, jump * cells))
        edges = jnp.append(jnp.cumsum(parts[::-1])[::-1], 0.0)
        return cls(law, mass, speed, dashpot, ahead, jump, rows, centre, apart, edges)

    def strain(self, xi):
        return self.ahead + self._over(jnp.asarray(xi, float))

    def velocity(self, xi):
        xi = jnp.asarray(xi, float)
        s, w = RULE
        push = self._force(xi[..., None] - s) @ jnp.asarray(w)
        drag = self.dashpot * self.speed * (self._over(xi) - self._over(xi - 1))
        return (push - drag) / (self.mass * self.speed)

    def displacement(self, xi):
        xi = jnp.asarray(xi, float)
        s, w = RULE
        near = xi[..., None] - s
        ramp = self._force(near) @ jnp.asarray(w * (1 - s)) + self._beyond(xi)
        drag = self.dashpot * self.speed * (self._over(near) @ jnp.asarray(w))
        return (ramp + drag) / (self.mass * self.speed**2)

    def _over(self, x):
        return self.jump * interpolated(jnp, self.rows, self.centre, self.apart, x)

    def _force(self, x):
        return fine_force(self.law, self._over(x))

    def _beyond(self, x):
        """The integral of g from x on."""
        at = x / self.apart + self.centre
        cell = jnp.clip(jnp.ceil(at), 0, len(self.edges) - 1)
        part = jnp.maximum(self.apart * (cell - at), 0.0)
        inner = jnp.minimum(part, self.apart)
        places = (x + part - inner)[..., None] + inner[..., None] * jnp.asarray((1 + _T) / 2)
        behind = (part - inner) * fine_force(self.law, self.jump)
        return (
            self.edges[cell.astype(int)]
            + inner * (self._force(places) @ jnp.asarray(_W / 2))
            + behind
        )
