r"""Linear stability: one step of a method on u'' = -omega^2 u, as a function of z = h omega.

The step is the matrix R(z) on (u, v/omega). Its spectral radius rho(z) is the factor of the
amplitude per step, and log(rho)/z is the growth per radian of phase. There are three kinds of
methods:

- symplectic ones *keep* amplitudes: det R = 1 and rho = 1, except in windows of z where trace R
  leaves [-2, 2]. All but Verlet have a first, narrow and weak window where the numerical phase of a
  step is pi (growth 1e-4 ... 1e-2 per radian);
- others *damp* from z = 0 on (RKN pairs, Bosh3, Dopri5, Tsit5), up to an end;
- others *amplify* from z = 0 on (Heun, Dopri8) and have no interval of stability in the strict
  sense.

`stability_limit` is for all of them the z up to which no mode grows by more than `GROWTH` per
radian. For a symplectic method it is the start of the first window.

Source: Hairer, Lubich, Wanner, Geometric Numerical Integration (2006); van der Houwen, Sommeijer,
SIAM J. Numer. Anal. 24, 595 (1987), for the Nystrom pairs.
"""

from functools import cache
from typing import NamedTuple

import diffrax
import numpy as np

from ..base.checks import refuse
from ..base.printing import told
from ..base.types import Number, Parameter, Scalar
from . import tables

# growth by e in 1e5 radians, 16 000 periods: less is invisible in typical runs with a fixed step
GROWTH = 1e-5
# growth by e in 100 radians: not an error that an accurate step keeps small, but a lost run
RUNAWAY = 1e-2
# apparent growth that rounding alone can cause
ROUNDING = 1e-11
# the spacing of the grid of h omega, before it is refined
SPACING = 1 / 256
# the h omega up to which a first window is searched for; the next one counts where there is none
FARTHEST = (4.0, 16.0, 64.0)


class Window(NamedTuple):
    """start < h omega < end, where the amplitude grows, and the largest `growth` per radian."""

    start: float
    end: float
    growth: float
    __repr__ = told


class Stability(NamedTuple):
    """The stability of one solver, as `stability` returns it.

    - `limit`: h omega up to which the growth is below `GROWTH` per radian; inf if there is no end.
    - `refused_from`: h omega from which on `simulate` refuses a fixed step.
    - `interval`: h omega up to which rho <= 1 within rounding; 0 for a method that amplifies from
      zero on.
    - `near_zero`: "keeps", "damps" or "amplifies".
    - `evaluations`: forces per step, NaN for an implicit method; `per_evaluation`:
      limit/evaluations.
    - `windows`: the windows of instability, in order, up to the h omega asked for.
    """

    solver: str
    limit: float
    refused_from: float
    interval: float
    near_zero: str
    evaluations: float
    per_evaluation: float
    windows: tuple
    __repr__ = told


def stability(solver: diffrax.AbstractSolver | type, until: Scalar = 16.0) -> Stability:
    """Return the stability of a solver (class or instance), with windows up to h omega = `until`.

    **Raises** ValueError for a solver whose step is not known here.
    """
    count = evaluations(solver)
    near = _near_zero(solver)
    limit = stability_limit(solver)
    interval = 0.0 if near == "amplifies" else _limit(_kind(solver), ROUNDING)
    name = _kind(solver).__name__
    return Stability(
        name,
        limit,
        refused_from(solver),
        interval,
        near,
        count,
        float(limit / count),
        windows(solver, until),
    )


def stability_limit(solver: diffrax.AbstractSolver | type) -> float | None:
    """Return the h omega up to which no mode grows by more than `GROWTH` per radian.

    It is inf without an end, `None` if unknown. `solver`: class or instance, granjax's, or
    diffrax's with a table of coefficients. The value is cached.
    """
    return _limit(_kind(solver), GROWTH)


def refused_from(solver: diffrax.AbstractSolver | type) -> float | None:
    """Return the h omega from which on `simulate` refuses a fixed step.

    It is inf without an end, `None` if unknown. For granjax's own methods it is `stability_limit`.
    Runge-Kutta methods, most of which amplify from zero on, may grow by `RUNAWAY` per radian:
    slower growth is an ordinary error, which a shorter step reduces.
    """
    kind = _kind(solver)
    return _limit(kind, GROWTH if hasattr(kind, "table") else RUNAWAY)


@cache
def _limit(kind, growth):
    if not _known(kind):
        return None
    for until in FARTHEST:
        found = windows(kind, until, growth)
        if found:
            return found[0].start
    return np.inf


def one_step(solver: diffrax.AbstractSolver | type, z: Parameter) -> np.ndarray:
    r"""Return R(z), shape (..., 2, 2) for z = h omega of shape (...), the step of (u, v/omega).

    `LeapfrogMidpoint` and `ReversibleHeun` have a second state: for them R is the complex matrix on
    both, for y' = i omega y.

    **Raises** ValueError for a solver without a table of coefficients.
    """
    kind = _kind(solver)
    z = np.asarray(z, float)
    if not _known(kind):
        refuse("solver", "granjax's, or one of diffrax's with a tableau", kind.__name__)
    if kind in _WITHOUT_TABLE:
        return _WITHOUT_TABLE[kind](z)
    if hasattr(kind, "table"):
        table = kind.table()
        return _composed(table, z) if isinstance(table, tables.Splitting) else _nystrom(table, z)
    return _runge_kutta(kind.tableau, z)


def amplification(solver: diffrax.AbstractSolver | type, z: Parameter) -> Number:
    """Return rho(z), the factor of the fastest-growing amplitude per step at h omega = z."""
    return np.exp(_log_radius(one_step(solver, z)))


def growth(solver: diffrax.AbstractSolver | type, z: Parameter) -> Number:
    """Return log(rho)/z, the growth per radian of phase."""
    z = np.asarray(z, float)
    return _log_radius(one_step(solver, z)) / z


def windows(solver: diffrax.AbstractSolver | type, until: Scalar, growth: Scalar = GROWTH) -> tuple:
    """Return every `Window` that begins below h omega = `until`.

    In a window a mode grows by more than `growth` per radian. Narrow windows are found too.
    """
    z = places(solver, until)
    rate = _log_radius(one_step(solver, z)) / z
    # where growth begins and ends in turn; the last window may go on beyond `until`
    crossed = np.flatnonzero(np.diff(np.concatenate([[False], rate > growth, [False]])))
    k = crossed[crossed < len(z)]
    edges = [*_bisect(solver, np.append(0.0, z)[k], z[k], growth).tolist(), float(until)]
    return tuple(
        Window(start, end, float(rate[i:j].max()))
        for start, end, i, j in zip(edges[::2], edges[1::2], crossed[::2], crossed[1::2])
    )


def evaluations(solver: diffrax.AbstractSolver | type) -> float:
    """Return the force evaluations per step, without reused ones; NaN for an implicit method."""
    kind = _kind(solver)
    if hasattr(kind, "evaluations"):
        return int(kind.evaluations())
    tableau = getattr(kind, "tableau", None)
    if tableau is None:
        return np.nan if kind is diffrax.ImplicitEuler else 1
    return np.nan if tableau.implicit else tableau.num_stages - int(tableau.fsal)


def _kind(solver):
    return solver if isinstance(solver, type) else type(solver)


def _known(kind):
    tableau = isinstance(getattr(kind, "tableau", None), diffrax.ButcherTableau)
    return tableau or kind in _WITHOUT_TABLE or hasattr(kind, "table")


# one step, by its kind ---------------------------------------------------------------------------------------------


def _matrix(a, b, c, d):
    return np.moveaxis(np.array(np.broadcast_arrays(a, b, c, d)), 0, -1).reshape(
        np.shape(a) + (2, 2)
    )


def _composed(table, z):
    one = np.ones_like(z)
    zero = np.zeros_like(z)
    R = _matrix(one, zero, zero, one)
    for i, b in enumerate(table.b):
        R = _matrix(one, zero, -b * z, one) @ R
        if i < len(table.a):
            R = _matrix(one, table.a[i] * z, zero, one) @ R
    return R


# the positions U of the stages solve (1 + z^2 A) U = u + z c w, w = v/omega
def _nystrom(table, z):
    z = z[..., None, None]
    one = np.ones_like(table.c)
    left = np.eye(len(one)) + z**2 * table.A
    U = np.linalg.solve(left, np.stack([one + 0 * z[..., 0], table.c * z[..., 0]], -1))
    rest = np.concatenate(
        [-(z**2) * (table.b @ U)[..., None, :], -z * (table.bp @ U)[..., None, :]], -2
    )
    z = z[..., 0, 0]
    return _matrix(np.ones_like(z), z, np.zeros_like(z), np.ones_like(z)) + rest


# the stability function P at i z, for y = u - i v/omega
def _runge_kutta(tableau, z):
    count = tableau.num_stages
    A = np.zeros((count, count))
    for i, row in enumerate(tableau.a_lower):
        A[i + 1, : i + 1] = row
    if tableau.a_diagonal is not None:
        A += np.diag(tableau.a_diagonal)
    iz = 1j * z[..., None]
    stages = np.linalg.solve(np.eye(count) - iz[..., None] * A, np.ones(z.shape + (count, 1)))[
        ..., 0
    ]
    return _rotation(1 + (iz * stages) @ np.asarray(tableau.b_sol))


# the matrix on (u, v/omega) of a complex factor of u - i v/omega
def _rotation(factor):
    return _matrix(factor.real, factor.imag, -factor.imag, factor.real)


def _leapfrog(z):
    return _matrix(2j * z, 1 + 0j * z, 1 + 0j * z, 0j * z)


# On (y, y^): y^ <- 2 y - y^ + i z y^, then y <- y + i z (y^ before + y^ after)/2
def _reversible_heun(z):
    return _matrix(1 + 1j * z, -(z**2) / 2 + 0j, 2 + 0j * z, 1j * z - 1)


_WITHOUT_TABLE = {
    diffrax.Euler: lambda z: _rotation(1 + 1j * z),
    diffrax.ImplicitEuler: lambda z: _rotation(1 / (1 - 1j * z)),
    diffrax.LeapfrogMidpoint: _leapfrog,
    diffrax.ReversibleHeun: _reversible_heun,
}


# its eigenvalues ---------------------------------------------------------------------------------------------------


# ((R11 - R22)/2)^2 + R12 R21, positive where the eigenvalues are real; this form does not cancel
# where they meet
def _discriminant(R):
    return ((R[..., 0, 0] - R[..., 1, 1]) / 2) ** 2 + R[..., 0, 1] * R[..., 1, 0]


def _determinant(R):
    return R[..., 0, 0] * R[..., 1, 1] - R[..., 0, 1] * R[..., 1, 0]


# log(rho), exact to rounding for real matrices: rho^2 = det R for a complex pair of eigenvalues
def _log_radius(R):
    if np.iscomplexobj(R):
        return np.log(np.abs(np.linalg.eigvals(R)).max(-1))
    D = _discriminant(R)
    mean = np.abs(R[..., 0, 0] + R[..., 1, 1]) / 2
    inside = np.where(D > 0, 1.0, _determinant(R))
    return np.where(
        D > 0, np.log(mean + np.sqrt(np.maximum(D, 0))), np.log(np.maximum(inside, 1e-300)) / 2
    )


def places(solver: diffrax.AbstractSolver | type, until: Scalar) -> np.ndarray:
    """Return a grid of h omega, refined around every local maximum of the discriminant."""
    z = SPACING * np.arange(1, int(np.ceil(until / SPACING)) + 1)
    R = one_step(solver, z)
    if np.iscomplexobj(R):
        return z
    D = _discriminant(R)
    found = [z]
    for k in np.flatnonzero((D[1:-1] >= D[:-2]) & (D[1:-1] > D[2:])) + 1:
        middle = z[k]
        half = SPACING
        for _ in range(5):
            fine = middle + half * np.linspace(-1, 1, 33)
            middle = fine[np.argmax(_discriminant(one_step(solver, fine)))]
            half = half / 16
            found.append(fine)
    return np.unique(np.concatenate(found))


def _bisect(solver, low, high, rate):
    rises = _log_radius(one_step(solver, high)) > rate * high
    for _ in range(60):
        middle = (low + high) / 2
        beyond = (_log_radius(one_step(solver, middle)) > rate * middle) == rises
        low, high = np.where(beyond, low, middle), np.where(beyond, middle, high)
    return np.where(rises, low, high)


def _near_zero(solver):
    z = places(solver, 4.0)
    change = np.log(np.abs(_determinant(one_step(solver, z))))
    seen = np.flatnonzero(np.abs(change) > 1e-12)
    if not seen.size:
        return "keeps"
    return "amplifies" if change[seen[0]] > 0 else "damps"
