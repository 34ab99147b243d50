"""Waves along a chain with a cell of P sites, by Newton's method on the Fourier form in a box.

Site n = j + l P has the mass m_j; bond n, between the sites n and n + 1, has the law F_j. In a wave
of speed c, e_n(t) = phi_j(n - c t). With lengths in sites, masses over their mean M and forces over
M c^2 [length]:

    k^2 phi_j^ = sum_l B_jl(k) F_l^,   B = D^+ diag(1/m) D,   (D F)_j = F_j - e^{-ik} F_{j-1}

A resonator (nu, kappa) on every site adds nu kappa/(kappa - nu k^2) to its mass. At k = 0 the mean
forces of all bonds are equal. The mean strain equals the mean force (over 1 + nu), so that the far
field is at rest; for a wave that repeats with the box it is zero instead.
"""

import copy
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ..laws import Law
from .medium import values

# The most unknowns of a box: Newton's matrix of twice as many takes seconds.
MOST = 3600


class Chain(NamedTuple):
    """A cell and a speed: the law of each bond, masses (P,) over their mean M, and M c^2.

    `given` (P,): the masses in their own unit. `stiffness` (P,): of the bonds at rest. `resonator`:
    its mass over M and its stiffness, or `None`. `mirror`: s with m_j = m_{s-j} and F_j =
    F_{s-1-j}, or `None`.
    """

    laws: tuple[Law, ...]
    masses: np.ndarray
    given: np.ndarray
    unit: float
    stiffness: np.ndarray
    resonator: tuple[float, float] | None
    mirror: int | None

    @property
    def K2(self) -> np.ndarray:
        """The stiffness of the bonds at rest (P,) over M c^2."""
        return self.stiffness / self.unit

    @property
    def total(self) -> float:
        """The mean mass over M of a site with its resonator."""
        return self.masses.mean() + (self.resonator[0] if self.resonator else 0.0)

    def faster(self, factor: float) -> "Chain":
        """Return the chain for a wave that is faster by a factor."""
        return self._replace(unit=self.unit * factor**2)

    def bonds(self, e: np.ndarray) -> np.ndarray:
        """Return forces, slopes and energies at compressions (P, X), over M c^2: (3, P, X)."""
        found = [values(law, row) for law, row in zip(self.laws, e)]
        return np.swapaxes(found, 0, 1) / self.unit

    def inertia(self, k: np.ndarray) -> np.ndarray:
        """Return the masses at each wave number (P, K), with the effect of the resonators."""
        masses = self.masses[:, None] + 0 * k
        if self.resonator is None:
            return masses
        nu = self.resonator[0]
        kappa = self.resonator[1] / self.unit
        return masses + nu * kappa / (kappa - nu * k**2)

    def response(self, k: np.ndarray) -> np.ndarray:
        """Return B(k), shape (P, P, K)."""
        light = 1 / self.inertia(k)
        P = len(self.masses)
        B = np.zeros((P, P, len(k)), complex)
        turn = np.exp(1j * k)
        for j in range(P):
            after = (j + 1) % P
            B[j, j] += light[j] + light[after]
            B[j, j - 1] -= light[j] / turn
            B[j, after] -= light[after] * turn
        return B

    def symbol(self, half: float, points: int, at_rest: bool = True) -> np.ndarray:
        """Return the map from forces to strains on a box, (P, P, points); at k = 0 of means."""
        k = 2 * np.pi * np.fft.fftfreq(points, 2 * half / points)
        B = self.response(k) / np.where(k == 0, 1, k**2)
        # The highest wave number of an even grid is its own negative, so B is real there.
        B[:, :, points // 2] = B[:, :, points // 2].real
        P = len(self.masses)
        B[:, :, 0] = (at_rest / self.total + 1) / P - np.eye(P)
        return B


class Box:
    """Places x = n - c t in [-half, half) of the bonds n, and linear maps of the equations.

    Unknowns are the strains (P, N), or those that the mirror symmetry leaves free. `at_rest`: the
    far field is at rest, otherwise the mean strain is zero.
    """

    def __init__(self, chain: Chain, half: float, points: int, at_rest: bool = True):
        self.chain = chain
        self.half = half
        self.points = points
        self.at_rest = at_rest
        self.x = (np.arange(points) - points // 2) * (2 * half / points)
        self.k = 2 * np.pi * np.fft.fftfreq(points, 2 * half / points)
        P = len(chain.masses)
        self.shape = P, points
        self.place, self.first = self._unknowns()
        # The last strain of each unknown, which may be its first.
        self.last = np.zeros(len(self.first), int)
        self.last[self.place] = np.arange(P * points)
        self.twice = (self.last != self.first).astype(float)
        self.of_strain, self.of_force = self._maps()

    def _unknowns(self):
        P, N = self.shape
        there = np.arange(P * N).reshape(P, N)
        if self.chain.mirror is not None:
            mirrored = there[(self.chain.mirror - 1 - np.arange(P)) % P][:, -np.arange(N) % N]
            there = np.minimum(there, mirrored)
        first, place = np.unique(there, return_inverse=True)
        return place.ravel(), first

    def _maps(self):
        P, N = self.shape
        B = self.chain.symbol(self.half, N, self.at_rest)
        # The forces do not determine the differences of the mean strains.
        means = 1 / P - np.eye(P)
        bond, at = np.divmod(self.first, N)
        lag = (at[:, None] - np.arange(N)) % N
        turned = np.fft.ifft(B).real
        force = np.concatenate([turned[bond[:, None], j, lag] for j in range(P)], 1)
        strain = np.eye(P * N)[self.first] + np.repeat(means[bond] / N, N, 1)
        return self.gathered(strain), force

    def gathered(self, rows):
        """Convert rows that act on the strains (..., P N) to rows that act on the unknowns."""
        return rows[..., self.first] + self.twice * rows[..., self.last]

    def unknowns(self, phi):
        """Return the unknowns of strains (P, N), which are symmetrized."""
        return np.bincount(self.place, phi.ravel()) / np.bincount(self.place)

    def strains(self, z):
        return z[self.place].reshape(self.shape)

    def equations(self, z):
        """Return the residual and its Jacobian."""
        force, slope, _ = self.chain.bonds(self.strains(z))
        gap = self.of_strain @ z - self.of_force @ force.ravel()
        return gap, self.of_strain - self.gathered(self.of_force * slope.ravel())

    def velocities(self, phi: np.ndarray) -> np.ndarray:
        """Return the velocities (P, N) of the sites at x, in c times the unit of strains.

        m_j v_j' = F_j(phi_j(x)) - F_{j-1}(phi_{j-1}(x - 1)), with the far field, or the mean, at
        rest.
        """
        force = np.fft.fft(self.chain.bonds(phi)[0], axis=1)
        k = np.where(self.k == 0, 1, self.k)
        inertia = 1j * k * self.chain.inertia(self.k)
        hat = (force - np.roll(force, 1, axis=0) * np.exp(-1j * k)) / inertia
        hat[:, 0] = phi.mean() * self.points
        hat[:, self.points // 2] = 0
        return np.fft.ifft(hat, axis=1).real

    def of_level(self, unit: float) -> "Box":
        """Return the same box for another M c^2, of a chain without resonators."""
        other = copy.copy(self)
        other.chain = self.chain._replace(unit=unit)
        return other


def fourier(phi, half, x):
    """Return the trigonometric interpolants of (P, N) values on a box at places x (X,): (P, X)."""
    N = phi.shape[1]
    n = np.arange(N // 2 + 1)
    hat = np.fft.rfft(phi, axis=1) / N
    hat[:, 1 : (N + 1) // 2] *= 2
    # The first value is at x = -half.
    wave = np.exp(1j * np.pi / half * np.outer(n, np.asarray(x) + half))
    return (hat @ wave).real


class Solved(NamedTuple):
    """The result of Newton's method: box, strains (P, N), parameter, residual, last Jacobian."""

    box: Box
    phi: np.ndarray
    parameter: float
    residual: float
    converged: bool
    jacobian: np.ndarray

    @property
    def top(self) -> float:
        """The largest absolute strain."""
        return np.abs(self.phi).max()


def newton(box: Box, phi: np.ndarray, tolerance: float = 1e-12, most: int = 14) -> Solved:
    """Find the strains on a box from a guess.

    Without a mirror the wave keeps the place of the guess: a force on it, zero at the end, balances
    the equations.
    """
    start = box.unknowns(phi)
    if box.chain.mirror is not None:
        return _descended(box, lambda z, _: box.equations(z), start, np.nan, tolerance, most)
    across = np.fft.ifft(1j * box.k * np.fft.fft(phi, axis=1), axis=1).real.ravel()
    across = across / np.linalg.norm(across)

    def held(z, push):
        gap, matrix = box.equations(z)
        gap = np.append(gap + push * across, across @ (z - start))
        return gap, _bordered(matrix, across, across)

    return _descended(box, held, start, 0.0, tolerance, most)


def newton_with(
    box_of: Callable,
    row: Callable,
    phi: np.ndarray,
    parameter: float,
    reach: float,
    target: float = 0.0,
    tolerance: float = 1e-14,
    most: int = 14,
) -> Solved:
    """Find strains and a parameter p of a symmetric chain, with row(box) @ strains = target.

    **Arguments:** `box_of`: p to `Box`; `row`: box to (P N,); `reach`: the largest change of p in a
    step.
    """

    def laid(z, p):
        box = box_of(p)
        # A finite difference in p is accurate enough for the step.
        shift = 1e-6 * max(abs(p), reach)
        at = box.gathered(row(box))
        gap, matrix = box.equations(z)
        along = (box_of(p + shift).equations(z)[0] - gap) / shift
        return np.append(gap, at @ z - target), _bordered(matrix, along, at)

    box = box_of(parameter)
    return _descended(box, laid, box.unknowns(phi), parameter, tolerance, most, reach)


def _bordered(matrix, column, row):
    return np.block([[matrix, column[:, None]], [row, 0.0]])


def _descended(box, equations, z, p, tolerance, most, reach=np.inf):
    best = np.inf
    for _ in range(most):
        # A step too far may come to strains at which forces overflow.
        with np.errstate(over="ignore", invalid="ignore"):
            gap, J = equations(z, p)
        size = np.abs(gap).max() / np.abs(z).max()
        if not size <= 1e3:
            break
        before = best
        best = size
        # Stop at the tolerance or at rounding.
        if best < tolerance or best < 1e-12 and best > before / 2:
            break
        try:
            step = np.linalg.solve(J, gap)
        except np.linalg.LinAlgError:
            break
        more = step[len(z) :].sum()
        part = min(1.0, reach / max(abs(more), 1e-300))
        z = z - part * step[: len(z)]
        p = p - part * more
    return Solved(box, box.strains(z), p, best, best < 1e-12, J)
