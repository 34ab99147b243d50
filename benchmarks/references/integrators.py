"""Two unrelated integrators in extended precision, pure NumPy, with nothing of the library in them.

`extrapolation`: Gragg's midpoint rule, extrapolated (Bulirsch and Stoer), order 16. `collocation`: Gauss points, 16 of
them, order 32, solved by iteration. Both adapt their step, refuse one that is too long and go down to 1e-11 where a
contact opens or closes. Numbers are 80-bit (`numpy.longdouble`, rounding 1e-19), so that rounding stays below 1e-15 in
chains that amplify it ten thousand times.

The equation is a = f(t, u, v); `u` and `v` are arrays (sites, lanes). Every lane keeps its own step, unless `together`,
where lanes are parts of one state. `f` may be called with more leading axes, and with `t` of shape (..., 1, lanes).

Sources: Hairer, Norsett, Wanner, Solving Ordinary Differential Equations I, II.9; Hairer, Lubich, Wanner, Geometric
Numerical Integration, II.1 and VIII.6.
"""

from functools import cache

import numpy as np

from granjax.base.checks import refuse

EXTENDED = np.longdouble
FEWEST_DIGITS = 18
SUBSTEPS = tuple(range(2, 18, 2))
STAGES = 16
MOST_SWEEPS = 40
RESOLVED = 100
# what an estimate that is far above the error of a smooth solution counts
DIAGONAL = 1e-2
LAST_COEFFICIENT = 1e-3
SAFETY = 0.8
SHRINK_MOST = 0.1
SHRINK_AGAIN = 0.25
GROW_MOST = 4.0
SHORTEST = 1e-15
ORDINARY = 0.1


def extrapolation(f, t0, t1, u, v, tolerance, step=0.05, together=False):
    """(u, v) at t1 by extrapolated midpoint steps.

    **Arguments:** `f(t, u, v)`; `t0` < `t1`; `u`, `v`: (sites, lanes); `tolerance`: absolute, of a step of 0.1 or
    longer, and less in proportion for a shorter one; `step`: the first to try.
    **Raises** RuntimeError where the tolerance asks for steps below what the numbers resolve.
    """

    def attempt(f, t, h, u, v):
        rows = before = []
        for k, n in enumerate(SUBSTEPS):
            row = [_midpoint(f, t, h, u, v, n)]
            for j in range(k):
                ratio = EXTENDED(SUBSTEPS[k]) / SUBSTEPS[k - 1 - j]
                row.append(row[j] + (row[j] - rows[j]) / (ratio * ratio - 1))
            before = rows
            rows = row
        # two estimates: where a contact opens, one of them is small by chance now and then
        errors = np.abs(rows[-1] - rows[-2]), DIAGONAL * np.abs(rows[-1] - before[-1])
        return rows[-1], np.maximum(*errors).max((0, 1))

    return _march(attempt, f, t0, t1, u, v, tolerance, step, together, 2 * len(SUBSTEPS) - 1)


def _midpoint(f, t, h, u, v, n):
    """Change of (u, v) over h by n midpoint steps, the first of them Euler's, the last smoothed.

    The smoothing looks at the force at the end; without it nothing sees a contact that closes in the last substep.
    """
    s = h / n
    du = s * v
    dv = s * f(t, u, v)
    du_before = EXTENDED(0)
    dv_before = EXTENDED(0)
    for m in range(1, n):
        rate_u = v + dv
        rate_v = f(t + m * s, u + du, v + dv)
        du, du_before = du_before + 2 * s * rate_u, du
        dv, dv_before = dv_before + 2 * s * rate_v, dv
    end_u = s * (v + dv)
    end_v = s * f(t + h, u + du, v + dv)
    return np.stack([du + du_before + end_u, dv + dv_before + end_v]) / 2


def collocation(f, t0, t1, u, v, tolerance, step=0.05, together=False):
    """(u, v) at t1 by the Gauss method with 16 points; arguments as in `extrapolation`."""
    c, A, b, last, close = gauss(STAGES)

    def attempt(f, t, h, u, v):
        times = t + c[:, None, None] * h
        force = np.broadcast_to(f(t, u, v), (STAGES,) + u.shape)
        before = np.inf
        for _ in range(MOST_SWEEPS):
            speeds = v + h * np.tensordot(A, force, 1)
            new = f(times, u + h * np.tensordot(A, speeds, 1), speeds)
            change = h * np.abs(new - force).max((0, 1))
            force = new
            # rounding or, at too long a step, divergence ends the sweeps of a lane
            low = np.where(change < RESOLVED * tolerance, before, 4 * before)
            if np.all((change < tolerance / 10) | ~(change < low)):
                break
            before = change
        speeds = v + h * np.tensordot(A, force, 1)
        ends = h * np.stack([np.tensordot(b, speeds, 1), np.tensordot(b, force, 1)])
        # a contact that closes behind the last point is seen at the end alone
        missed = (1 - c[-1]) * np.abs(
            f(t + h, u + ends[0], v + ends[1]) - np.tensordot(close, force, 1)
        ).max(0)
        error = h * np.maximum(
            LAST_COEFFICIENT * np.abs(np.tensordot(last, force, 1)).max((0, 1)), missed
        )
        # what has not settled has no solution at this step
        return ends, np.where(change < RESOLVED * tolerance, error, np.inf)

    return _march(attempt, f, t0, t1, u, v, tolerance, step, together, STAGES)


@cache
def gauss(s):
    """Nodes c and weights (A, b) of the Gauss method on [0, 1], and weights for more: of the two highest Legendre
    coefficients of a force, and of the force at 1.

    With P_n Legendre's polynomials in x = 2 c - 1 and weights b: A_ij = sum over n < s of
    (2n + 1) b_j P_n(x_j) times the integral of P_n from 0 to c_i, which is (P_{n+1} - P_{n-1})/(2 (2n + 1)).
    """
    x = np.polynomial.legendre.leggauss(s)[0].astype(EXTENDED)
    for _ in range(4):
        P = _legendre(x, s + 1)
        slope = s * (x * P[s] - P[s - 1]) / (x * x - 1)
        x = x - P[s] / slope
    P = _legendre(x, s + 1)
    slope = s * (x * P[s] - P[s - 1]) / (x * x - 1)
    b = 1 / ((1 - x * x) * slope * slope)
    degree = np.arange(s)
    fit = (2 * degree + 1)[:, None] * b * P[:s]
    integral = np.concatenate(
        [[(x + 1) / 2], (P[2 : s + 1] - P[: s - 1]) / (2 * (2 * degree[1:] + 1))[:, None]]
    )
    return (x + 1) / 2, integral.T @ fit, b, fit[-2:], fit.sum(0)


def _legendre(x, highest):
    P = [np.ones_like(x), x]
    for n in range(1, highest):
        P.append(((2 * n + 1) * x * P[n] - n * P[n - 1]) / (n + 1))
    return np.array(P)


def _march(attempt, f, t0, t1, u, v, tolerance, step, together, order):
    """Steps of every lane at its own pace, until all have arrived."""
    if np.finfo(EXTENDED).precision < FEWEST_DIGITS:
        got = f"{np.finfo(EXTENDED).precision} digits"
        refuse(
            "numpy.longdouble",
            f"{FEWEST_DIGITS} digits",
            got,
            "Make references on an x86-64 Linux machine.",
        )
    y = np.stack([np.asarray(u, EXTENDED), np.asarray(v, EXTENDED)])
    lanes = 1 if together else y.shape[-1]
    t = np.full(lanes, t0, EXTENDED)
    h = np.full(lanes, step, EXTENDED)
    refused = np.zeros(lanes, bool)
    end = y.copy()
    left = np.arange(lanes)
    while left.size:
        h = np.minimum(h, t1 - t)
        with np.errstate(over="ignore", invalid="ignore"):
            change, error = attempt(_of_lanes(f, None if together else left), t, h, *y)
        error = error.max(keepdims=True) if together else error
        # a share of the error for every time: rounding falls with the step too, and events have the shortest
        allowed = tolerance * np.minimum(1, h / ORDINARY)
        good = error <= allowed
        with np.errstate(divide="ignore", invalid="ignore"):
            factor = np.nan_to_num(
                SAFETY * (allowed / error) ** (EXTENDED(1) / order), posinf=GROW_MOST
            )
        arrived = good & (h >= t1 - t)
        y = np.where(good, y + change, y)
        t = np.where(arrived, t1, np.where(good, t + h, t))
        # at an opening contact the error falls with h^(5/2) alone, whatever the order: a second refusal shrinks more
        slower = np.where(
            refused, np.minimum(factor, SHRINK_AGAIN), np.clip(factor, SHRINK_MOST, SAFETY)
        )
        # and no growth right behind it
        faster = np.clip(factor, SHRINK_MOST, np.where(refused, 1, GROW_MOST))
        h = h * np.where(good, faster, slower)
        refused = ~good
        if np.any(h < SHORTEST * np.maximum(np.abs(t), 1) * (~arrived)):
            raise RuntimeError(
                f"the steps of lane {left[np.argmin(h)]} fell to {h.min():.1e} at t = {t.min():.6g}"
            )
        if together:
            end = y
            left = left[~arrived]
        elif arrived.any():
            end[..., left[arrived]] = y[..., arrived]
            on = ~arrived
            y = y[..., on]
            t = t[on]
            h = h[on]
            refused = refused[on]
            left = left[on]
    return end[0], end[1]


def _of_lanes(f, lanes):
    """The equation of those lanes that are still under way, where it has parameters by lane."""
    return f if lanes is None or not hasattr(f, "of_lanes") else f.of_lanes(lanes)
