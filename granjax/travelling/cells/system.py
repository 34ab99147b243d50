"""The equations of a wave along a chain with a cell of P sites, in Fourier form on a periodic box.

Site n = j + l P has the mass m_j; bond n, between the sites n and n + 1, has the law F_j. In a wave of speed c
e_n(t) = phi_j(n - c t). With lengths in sites, masses over their mean M and forces over M c^2 [length]:

    k^2 phi_j^ = sum_l B_jl(k) F_l^,   B = D^+ diag(1/m) D,   (D F)_j = F_j - e^{-ik} F_{j-1}

A resonator (nu, kappa) on every site adds nu kappa/(kappa - nu k^2) to its mass. At k = 0 the mean forces of all bonds
are equal, and the mean strain is the mean force (over 1 + nu), which says that the far field is at rest.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

# unknowns of a box: Newton's matrix of twice as many takes seconds
MOST = 3600


class Chain(NamedTuple):
    """A cell in its own units: lengths in sites, masses of mean 1, forces over M c^2.

    `masses` (P,); `force`, `slope`: (P, X) to (P, X), elementwise along X; `K2` (P,); `resonator`: (nu, kappa) or
    `None`; `mirror`: s where m_j = m_{s-j} and F_j = F_{s-1-j}, `None` where the cell has no such centre.
    """

    masses: np.ndarray
    force: Callable
    slope: Callable
    K2: np.ndarray
    resonator: tuple[float, float] | None
    mirror: int | None


def heaviness(chain, k):
    """Masses at each wave number (P, K), with what the resonators add."""
    masses = chain.masses[:, None] + 0 * k
    if chain.resonator is None:
        return masses
    nu, kappa = chain.resonator
    return masses + nu * kappa / (kappa - nu * k**2)


def response(chain, k):
    """B(k), shape (P, P, K)."""
    light, P = 1 / heaviness(chain, k), len(chain.masses)
    B, turn = np.zeros((P, P, len(k)), complex), np.exp(1j * k)
    for j in range(P):
        after = (j + 1) % P
        B[j, j] += light[j] + light[after]
        B[j, j - 1] -= light[j] / turn
        B[j, after] -= light[after] * turn
    return B


class Box:
    """Places x = n - c t in [-half, half) of the bonds n, and the linear maps of the equations there.

    Unknowns are the strains (P, N), or those that its mirror leaves free.
    """

    def __init__(self, chain: Chain, half: float, points: int):
        self.chain, self.half, self.points = chain, half, points
        self.x = (np.arange(points) - points // 2) * (2 * half / points)
        self.k = 2 * np.pi * np.fft.fftfreq(points, 2 * half / points)
        P = len(chain.masses)
        self.shape = P, points
        self.place, self.first = self._unknowns()
        # the last of the strains that an unknown holds, where it is not the first
        self.last = np.zeros(len(self.first), int)
        self.last[self.place] = np.arange(P * points)
        self.twice = (self.last != self.first).astype(float)
        self.of_strain, self.of_force = self._maps()

    def _unknowns(self):
        """For each strain the unknown that holds it, and for each unknown the first of its strains."""
        P, N = self.shape
        if self.chain.mirror is None:
            return np.arange(P * N), np.arange(P * N)
        there = np.arange(P * N).reshape(P, N)
        mirrored = there[(self.chain.mirror - 1 - np.arange(P)) % P][:, -np.arange(N) % N]
        first, place = np.unique(np.minimum(there, mirrored), return_inverse=True)
        return place.ravel(), first

    def _maps(self):
        """Matrices of the strains' and the forces' parts of the residual, rows of the unknowns."""
        P, N = self.shape
        square = np.where(self.k == 0, 1, self.k**2)
        # the highest wave number of an even grid is its own negative
        B = response(self.chain, self.k) / square
        B[:, :, N // 2] = B[:, :, N // 2].real
        bond, at = np.divmod(self.first, N)
        total = heaviness(self.chain, np.zeros(1)).mean()
        force = np.empty((len(self.first), P, N))
        strain = np.zeros_like(force)
        lag = (at[:, None] - np.arange(N)) % N
        for i in range(P):
            rows = np.flatnonzero(bond == i)
            for j in range(P):
                B[i, j, 0] = (1 / total + 1) / P - (i == j)
                force[rows, j] = np.fft.ifft(B[i, j]).real[lag[rows]]
                strain[rows, j] = (1 / P - (i == j)) / N
            strain[rows, i, at[rows]] += 1
        flat = len(self.first), P * N
        return self.gathered(strain.reshape(flat)), force.reshape(flat)

    def gathered(self, rows):
        """Rows that act on the strains (..., P N) as rows that act on the unknowns."""
        return rows[..., self.first] + self.twice * rows[..., self.last]

    def unknowns(self, phi):
        """The unknowns of strains (P, N), which are made symmetric."""
        return np.bincount(self.place, phi.ravel()) / np.bincount(self.place)

    def strains(self, z):
        return z[self.place].reshape(self.shape)

    def residual(self, z):
        return self.of_strain @ z - self.of_force @ self.chain.force(self.strains(z)).ravel()

    def linearised(self, z):
        slope = self.chain.slope(self.strains(z)).ravel()
        return self.of_strain - self.gathered(self.of_force * slope)


def fourier(phi, half, x):
    """The trigonometric polynomials through (P, N) values on a box, at places x (X,): (P, X)."""
    N = phi.shape[1]
    n = np.arange(N // 2 + 1)
    hat = np.fft.rfft(phi, axis=1) / N
    hat[:, 1 : (N + 1) // 2] *= 2
    # the first value stands at -half
    wave = np.exp(1j * np.pi / half * np.outer(n, np.asarray(x) + half))
    return (hat @ wave).real


class Solved(NamedTuple):
    """What Newton's method left: strains (P, N), parameter, residual, whether it converged, the last Jacobian."""

    phi: np.ndarray
    parameter: float
    residual: float
    converged: bool
    jacobian: np.ndarray


def newton(box: Box, phi, tolerance=1e-12, max_steps=14) -> Solved:
    """Strains on a box from a guess; where the cell has no mirror, the place of the wave stays that of the guess.

    The force of a place that is held takes up what the equations leave over; it ends at zero.
    """
    z, free = box.unknowns(phi), box.chain.mirror is None
    across = np.fft.ifft(1j * box.k * np.fft.fft(phi, axis=1), axis=1).real.ravel()
    across, start, held, best = across / np.linalg.norm(across), z, 0.0, np.inf
    for _ in range(max_steps):
        residual, J = box.residual(z), box.linearised(z)
        if free:
            residual = np.append(residual + held * across, across @ (z - start))
            J = np.block([[J, across[:, None]], [across[None, :], np.zeros((1, 1))]])
        size, scale = np.abs(residual).max(), np.abs(z).max()
        if not np.isfinite(size) or size > 1e3 * scale:
            break
        best = size / scale
        if best < tolerance:
            break
        step = _solve(J, residual)
        if step is None:
            break
        z, held = z - step[: len(z)], held - (step[-1] if free else 0.0)
    return Solved(box.strains(z), np.nan, best, best < tolerance, J)


def _solve(J, residual):
    try:
        return np.linalg.solve(J, residual)
    except np.linalg.LinAlgError:
        return None


def newton_with(
    box_of: Callable, row: Callable, phi, parameter, reach, tolerance=1e-12, max_steps=14
) -> Solved:
    """Strains and a parameter p of a symmetric chain, on which one more equation row(box) @ strains = 0 is laid.

    **Arguments:** `box_of`: p to `Box`; `row`: box to (P N,); `reach`: the most that p changes in a step.
    """
    p, z, best, J = parameter, None, np.inf, None
    for _ in range(max_steps):
        box = box_of(p)
        z = box.unknowns(phi) if z is None else z
        # the change of the residual with p needs no more digits than make the step good
        shift = 1e-6 * max(abs(p), reach)
        at = box.gathered(row(box))
        residual = np.append(box.residual(z), at @ z)
        along = (box_of(p + shift).residual(z) - residual[:-1]) / shift
        J = np.block([[box.linearised(z), along[:, None]], [at[None, :], np.zeros((1, 1))]])
        size, scale = np.abs(residual).max(), np.abs(z).max()
        if not np.isfinite(size) or size > 1e3 * scale:
            break
        best = size / scale
        if best < tolerance:
            break
        step = _solve(J, residual)
        if step is None:
            break
        part = min(1.0, reach / max(abs(step[-1]), 1e-300))
        z, p = z - part * step[:-1], p - part * step[-1]
    return Solved(box.strains(z), p, best, best < tolerance, J)
