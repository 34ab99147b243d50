"""numba loops of granjax's Nystrom pairs with step control: the same methods, written out for one chain.

The sums over stages are generated from the table, so that its zeros cost nothing and its numbers are constants; the
force that ends a step opens the next. Step control is the plain one: each error by its own scale, h times
0.9 error^(-1/order), between 0.2 and 5, and no growth right after a refusal.
"""

import math

import numba
import numpy as np

from granjax.solvers import tables

PARAMETER = "tolerance"
METHODS = ("RKN86", "RKN1210")
FIRST_STEP = 0.01


@numba.njit(inline="always")
def _alike(w, i):
    return w


@numba.njit(inline="always")
def _own(w, i):
    return w[i]


def _accelerations(inverse_mass):
    @numba.njit(fastmath=True)
    def accelerations(u, k, f, A, d0, F0, w):
        N = u.size
        s = max(d0 - u[0], 0.0)
        f[0] = A * (s * math.sqrt(s)) - F0
        for i in range(1, N):
            s = max(d0 + u[i - 1] - u[i], 0.0)
            f[i] = A * (s * math.sqrt(s)) - F0
        s = max(d0 + u[N - 1], 0.0)
        f[N] = A * (s * math.sqrt(s)) - F0
        for i in range(N):
            k[i] = inverse_mass(w, i) * (f[i] - f[i + 1])

    return accelerations


def _sum(weights):
    return " + ".join(f"{float(x)!r} * k[{j}, i]" for j, x in enumerate(weights) if x) or "0.0"


def _written(table, accelerations):
    """`attempt`, one step into `place` and `speed` with its errors, and the row of k with the force at its end."""
    last = np.abs(table.A[-1] - table.b).max() < 1e-14
    count = len(table.c)
    lines = ["def attempt(u, v, k, f, place, speed, h, A, d0, F0, w):", "    N, hh = u.size, h * h"]
    for j in range(1, count):
        lines += ["    for i in range(N):"]
        lines += [
            f"        place[i] = u[i] + {float(table.c[j])!r} * h * v[i] + hh * ({_sum(table.A[j])})"
        ]
        lines += [f"    accelerations(place, k[{j}], f, A, d0, F0, w)"]
    if not last:
        lines += [
            "    for i in range(N):",
            f"        place[i] = u[i] + h * v[i] + hh * ({_sum(table.b)})",
        ]
        lines += [f"    accelerations(place, k[{count}], f, A, d0, F0, w)"]
    lines += ["    wrong, worse = 0.0, 0.0", "    for i in range(N):"]
    lines += [f"        speed[i] = v[i] + h * ({_sum(table.bp)})"]
    lines += [f"        wrong = max(wrong, abs({_sum(table.be)}))"]
    lines += [f"        worse = max(worse, abs({_sum(table.bpe)}))"]
    lines += ["    return hh * wrong, h * worse"]
    space = {"accelerations": accelerations}
    exec("\n".join(lines), space)
    return numba.njit(fastmath=True)(space["attempt"]), count - last


def _loop(table, inverse_mass):
    accelerations = _accelerations(inverse_mass)
    attempt, final = _written(table, accelerations)
    power = -1.0 / (table.embedded_order + 1)

    @numba.njit
    def loop(u, v, t1, h, tolerance, scale_u, scale_v, A, d0, F0, w):
        """u, v (N,) in place from 0 to t1; returns the steps tried."""
        N = u.size
        t = 0.0
        tried = 0
        refused = False
        k = np.zeros((final + 1, N))
        f = np.zeros(N + 1)
        place = np.zeros(N)
        speed = np.zeros(N)
        accelerations(u, k[0], f, A, d0, F0, w)
        while t < t1:
            end = h >= t1 - t
            h = min(h, t1 - t)
            wrong, worse = attempt(u, v, k, f, place, speed, h, A, d0, F0, w)
            tried += 1
            error = max(wrong / scale_u, worse / scale_v) / tolerance
            factor = min(5.0, max(0.2, 0.9 * error**power)) if error > 0.0 else 5.0
            if error <= 1.0:
                t = t1 if end else t + h
                u[:] = place
                v[:] = speed
                k[0] = k[final]
                h *= min(factor, 1.0) if refused else factor
                refused = False
            else:
                h *= factor
                refused = True
        return tried

    return loop


def calls(chain):
    """RKN86 and RKN1210; chains of a batch one after the other, each with steps of its own."""
    scale = max(np.abs(chain.v).max(), np.abs(chain.u).max())
    numbers = scale, scale, chain.stiffness, chain.overlap, chain.force
    if chain.batch:
        return {
            f"numba {name}": _batch(chain, _loop(tables.nystrom(name), _own), numbers)
            for name in METHODS
        }
    c = chain.single("the numba loop")

    def of(loop):
        def call(tolerance):
            u = c.u.copy()
            v = c.v.copy()
            loop(u, v, c.t1, FIRST_STEP, tolerance, *numbers, c.inverse_mass)
            return u, v

        return call

    return {f"numba {name}": of(_loop(tables.nystrom(name), _alike)) for name in METHODS}


def _batch(chain, loop, numbers):
    t1 = chain.t1
    us, vs, inverse = (np.ascontiguousarray(x.T) for x in (chain.u, chain.v, chain.inverse_mass))

    @numba.njit
    def each(us, vs, inverse, tolerance, numbers):
        for lane in range(us.shape[0]):
            loop(us[lane], vs[lane], t1, FIRST_STEP, tolerance, *numbers, inverse[lane])

    def call(tolerance):
        u = us.copy()
        v = vs.copy()
        each(u, v, inverse, tolerance, numbers)
        return u.T, v.T

    return call
