"""Maps of tangents d(u, v)(T)/d(u, v)(0) of a Hertz chain, as others would make them: numba, numpy with scipy.

    orbit = Orbit.of(scene.lattice, scene.state, scene.t1)
    for name, (parameter, call) in calls(orbit).items():
        error = scene.error(call(value))

Every `call` takes a number of steps (parameter `"step"`) or a tolerance (`"tolerance"`) and returns the matrix
(2N, 2N), rows and columns (u, v). The first call compiles. `breather` finds an orbit by Newton's method. For Taylor
series see `taylor_tangents`.
"""

import math
from functools import partial
from typing import NamedTuple

import numba
import numpy as np
from scipy.integrate import solve_ivp

from granjax.solvers import tables

from .chain import Unfit, _one

METHODS = ("SRKN6b", "SRKN11b", "SRKN14a", "KahanLi8", "SofroniouSpaletta10")
# of tangents that pass through so many stages together: those of 80 beads then fit 32 kB, a small first cache
WIDTH = 24
STAGES = 16
# what solve_ivp takes
LEAST = 3e-14
MOST_ITERATIONS = 20


class Orbit(NamedTuple):
    """m_n u_n'' = F_n - F_{n+1}, F_n = A [d0 + u_{n-1} - u_n]_+^{3/2} - A d0^{3/2}, from (u, v) at time 0 to `period`.

    `mass`, `u`, `v`: (N,). `stiffness`, `overlap`: A and d0. `walls`: rigid walls at both ends, or the constant force
    A d0^{3/2}.
    """

    mass: np.ndarray
    stiffness: float
    overlap: float
    walls: bool
    u: np.ndarray
    v: np.ndarray
    period: float

    @classmethod
    def of(cls, lattice, state, period):
        """The numbers of a lattice whose only term is a Hertz bond, alike everywhere.

        **Raises** `Unfit` for other contacts or ends.
        """
        (bond,) = lattice.terms
        (ends,) = bond.strain_map.boundary
        if ends not in ("free", "fixed"):
            raise Unfit(f"{ends} ends")
        law = bond.law
        A = _one(law.stiffness)
        F0 = _one(0.0 if law.precompression is None else law.precompression)
        u, v = (np.array(x) for x in state)
        mass = np.broadcast_to(lattice.mass, u.shape).copy()
        return cls(mass, A, float(np.cbrt(F0 / A) ** 2), ends == "fixed", u, v, float(period))


def calls(orbit):
    """{name: (parameter, call)}: the numba loop with all splitting methods, and scipy."""
    found = {f"numba {name}": ("step", partial(splitting, orbit, name)) for name in METHODS}
    return {**found, "scipy DOP853": ("tolerance", partial(dop853, orbit))}


def splitting(orbit, name, steps):
    """The matrix by `steps` steps of the splitting method of that name: a fused, vectorised numba loop.

    First the state goes through some stages and leaves the stiffness of every contact at each of them; then `WIDTH`
    tangents at a time follow, which stay in the first cache. A stage is one pass over them that drifts a bead and kicks
    the one before.
    """
    drift, kick = stages(name, orbit.period / steps, steps)
    return _matrix(
        orbit.u, orbit.v, orbit.stiffness, orbit.overlap, orbit.walls, 1 / orbit.mass, drift, kick
    )


def stages(name, h, steps):
    """Drifts and kicks of so many steps h; the kick that ends a step and the one that opens the next are one."""
    table = tables.splitting(name)
    drift = np.concatenate([[0.0], np.tile(h * table.a, steps)])
    kick = np.concatenate([np.tile(h * table.b[:-1], steps), [h * table.b[-1]]])
    kick[len(table.a) : -1 : len(table.a)] += h * table.b[-1]
    return drift, kick


@numba.njit(fastmath=True)
def _contacts(u, A, d0, walls, f, k):
    """Forces f from equilibrium and stiffnesses k of the N+1 contacts; none at free ends."""
    N = u.size
    F0 = A * (d0 * math.sqrt(d0))
    for i in range(1, N):
        s = max(d0 + u[i - 1] - u[i], 0.0)
        root = math.sqrt(s)
        f[i], k[i] = A * (s * root) - F0, 1.5 * A * root
    if walls:
        s = max(d0 - u[0], 0.0)
        t = max(d0 + u[N - 1], 0.0)
        f[0] = A * (s * math.sqrt(s)) - F0
        k[0] = 1.5 * A * math.sqrt(s)
        f[N], k[N] = A * (t * math.sqrt(t)) - F0, 1.5 * A * math.sqrt(t)


@numba.njit(fastmath=True)
def follow(rows, K, inverse_mass, drift, kick):
    """Some tangents through some stages; `rows`: (U_n, V_n) bead by bead, a row of zeros at each end.

    The numbers of three beads are looked at through one slice, at distances known to the compiler: without them it
    has to ask at every bead whether they overlap, or does not vectorise at all.
    """
    row = 2 * WIDTH
    for j in range(kick.size):
        ah = drift[j]
        bh = kick[j]
        k = K[j]
        x = rows[row : 2 * row]
        for c in range(WIDTH):
            x[c] += ah * x[c + WIDTH]
        for i in range(inverse_mass.size):
            left = bh * inverse_mass[i] * k[i]
            right = bh * inverse_mass[i] * k[i + 1]
            both = left + right
            x = rows[i * row : (i + 3) * row]
            for c in range(WIDTH):
                after = x[c + 2 * row] + ah * x[c + 2 * row + WIDTH]
                x[c + 2 * row] = after
                x[c + row + WIDTH] += left * x[c] - both * x[c + row] + right * after


@numba.njit(fastmath=True)
def _matrix(u, v, A, d0, walls, inverse_mass, drift, kick):
    N = u.size
    blocks = -(-2 * N // WIDTH)
    u = u.copy()
    v = v.copy()
    f = np.zeros(N + 1)
    K = np.zeros((STAGES, N + 1))
    rows = np.zeros((blocks, N + 2, 2, WIDTH))
    for n in range(N):
        rows[n // WIDTH, n + 1, 0, n % WIDTH] = 1.0
        rows[(N + n) // WIDTH, n + 1, 1, (N + n) % WIDTH] = 1.0
    for start in range(0, kick.size, STAGES):
        a = drift[start : start + STAGES]
        b = kick[start : start + STAGES]
        for j in range(b.size):
            for i in range(N):
                u[i] += a[j] * v[i]
            _contacts(u, A, d0, walls, f, K[j])
            for i in range(N):
                v[i] += b[j] * inverse_mass[i] * (f[i] - f[i + 1])
        for block in range(blocks):
            follow(rows[block].reshape(-1), K, inverse_mass, a, b)
    matrix = np.empty((2 * N, 2 * N))
    for block in range(blocks):
        first = block * WIDTH
        for n in range(N):
            for c in range(min(WIDTH, 2 * N - first)):
                matrix[n, first + c] = rows[block, n + 1, 0, c]
                matrix[N + n, first + c] = rows[block, n + 1, 1, c]
    return matrix


def dop853(orbit, tolerance):
    """The matrix by scipy's DOP853 on the variational equation in numpy; both tolerances alike."""
    N = orbit.u.size
    _, _, U, V = _flow(orbit, np.eye(N, 2 * N), np.eye(N, 2 * N, N), orbit.period, tolerance)
    return np.concatenate([U, V])


def _flow(orbit, U, V, t1, tolerance):
    """(u, v, U, V) at t1, the tangents U, V (N, M) as further lanes beside the state."""
    mass, A, d0, walls, u, v, _ = orbit
    start = np.stack([np.column_stack([u, U]), np.column_stack([v, V])])
    inverse = 1 / mass[:, None]
    F0 = A * (d0 * np.sqrt(d0))

    def rates(t, y):
        u, v = y.reshape(start.shape)
        e = np.zeros((len(u) + 1, u.shape[1]))
        np.subtract(u[:-1], u[1:], out=e[1:-1])
        if walls:
            e[0], e[-1] = -u[0], u[-1]
        s = np.maximum(d0 + e[:, 0], 0)
        root = np.sqrt(s)
        e[:, 1:] *= (1.5 * A * root)[:, None]
        e[:, 0] = A * (s * root) - F0
        return np.stack([v, inverse * (e[:-1] - e[1:])]).ravel()

    run = solve_ivp(
        rates,
        (0.0, t1),
        start.ravel(),
        method="DOP853",
        rtol=max(tolerance, LEAST),
        atol=tolerance,
        t_eval=[t1],
    )
    if not run.success:
        raise RuntimeError(run.message)
    u, v = run.y.reshape(start.shape)
    return u[:, 0], v[:, 0], u[:, 1:], v[:, 1:]


class Found(NamedTuple):
    """`orbit`: the closed one; `residual`: max|v(T/2)|; `iterations`: solutions of the linear system."""

    orbit: Orbit
    residual: float
    iterations: int


def breather(orbit, tolerance, closed=1e-10):
    """The time-reversible orbit of this period near `orbit`: Newton's method on v(T/2) = 0 for u, with v(0) = 0.

    scipy's DOP853 at `tolerance` carries the N tangents of u; the Jacobian is dv(T/2)/du(0). With free ends the last
    bead stays where it is, as a shift of the chain changes nothing, and its equation follows from the momentum.

    **Returns** `Found`, with max|v(T/2)| < `closed`. **Raises** RuntimeError after 20 iterations without.
    """
    N = orbit.u.size
    free = N if orbit.walls else N - 1
    U = np.eye(N, free)
    V = np.zeros((N, free))
    orbit = orbit._replace(u=orbit.u.copy(), v=np.zeros(N))
    for iteration in range(MOST_ITERATIONS + 1):
        _, v, _, slope = _flow(orbit, U, V, orbit.period / 2, tolerance)
        residual = float(np.abs(v).max())
        if residual < closed:
            return Found(orbit, residual, iteration)
        orbit.u[:free] -= np.linalg.solve(slope[:free], v[:free])
    raise RuntimeError(f"Newton's method has not converged: max|v(T/2)| = {residual:.1e}")
