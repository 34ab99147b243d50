"""Fused numba loops of splitting methods: what a specialist would write by hand for chains between rigid walls.

One pass kicks and drifts, one evaluates every contact force once; numbers that are alike along the chain stay scalars.
Both passes compile to vector instructions. Kick, drift and force are granjax's own, in the same order; final states
differ by contracted multiplications (`fastmath`) alone.
"""

import math

import numba
import numpy as np

from granjax.solvers import tables

from .chain import SPLITTING

PARAMETER = "step"


@numba.njit(inline="always")
def _hertz(s, p):
    return s * math.sqrt(s)


@numba.njit(inline="always")
def _power(s, p):
    return s**p


def _make(power, walls=True):
    """The loop of a chain between rigid walls, or with free ends that are held by F0."""

    @numba.njit(inline="always")
    def ends(u, f, A, d0, F0, p):
        if walls:
            zero = u.dtype.type(0)
            f[0] = A * power(max(d0 - u[0], zero), p) - F0
            f[u.size] = A * power(max(d0 + u[u.size - 1], zero), p) - F0

    @numba.njit(fastmath=True)
    def loop(u, v, steps, h, A, d0, F0, p, inverse_mass, a, b):
        """`steps` steps of length h on u, v (N,), in place; `inverse_mass` a number."""
        N = u.size
        stages = a.size
        zero = u.dtype.type(0)
        f = np.zeros(N + 1, u.dtype)
        for i in range(1, N):
            f[i] = A * power(max(d0 + u[i - 1] - u[i], zero), p) - F0
        ends(u, f, A, d0, F0, p)
        for _ in range(steps):
            for j in range(stages):
                ah = a[j] * h
                bh = b[j] * h * inverse_mass
                for i in range(N):
                    w = v[i] + bh * (f[i] - f[i + 1])
                    v[i] = w
                    u[i] += ah * w
                for i in range(1, N):
                    f[i] = A * power(max(d0 + u[i - 1] - u[i], zero), p) - F0
                ends(u, f, A, d0, F0, p)
            bh = b[stages] * h * inverse_mass
            for i in range(N):
                v[i] += bh * (f[i] - f[i + 1])

    return loop


hertz = _make(_hertz)
power = _make(_power)
hertz_free = _make(_hertz, walls=False)


@numba.njit(fastmath=True)
def _hertz_masses(u, v, f, steps, h, A, d0, F0, inverse_mass, a, b):
    N = u.size
    stages = a.size
    f[0] = A * _hertz(max(d0 - u[0], 0.0), 1.5) - F0
    for i in range(1, N):
        f[i] = A * _hertz(max(d0 + u[i - 1] - u[i], 0.0), 1.5) - F0
    f[N] = A * _hertz(max(d0 + u[N - 1], 0.0), 1.5) - F0
    for _ in range(steps):
        for j in range(stages):
            ah = a[j] * h
            bh = b[j] * h
            for i in range(N):
                w = v[i] + bh * inverse_mass[i] * (f[i] - f[i + 1])
                v[i] = w
                u[i] += ah * w
            f[0] = A * _hertz(max(d0 - u[0], 0.0), 1.5) - F0
            for i in range(1, N):
                f[i] = A * _hertz(max(d0 + u[i - 1] - u[i], 0.0), 1.5) - F0
            f[N] = A * _hertz(max(d0 + u[N - 1], 0.0), 1.5) - F0
        bh = b[stages] * h
        for i in range(N):
            v[i] += bh * inverse_mass[i] * (f[i] - f[i + 1])


@numba.njit
def hertz_batch(us, vs, steps, h, A, d0, F0, inverse_masses, a, b):
    """One chain after the other: `us`, `vs`, `inverse_masses` (B, N), in place; A, d0, F0 numbers."""
    f = np.zeros(us.shape[1] + 1)
    for k in range(us.shape[0]):
        _hertz_masses(us[k], vs[k], f, steps, h, A, d0, F0, inverse_masses[k], a, b)


def calls(chain):
    """All splitting methods; a batch as one chain after the other."""
    run = _batch if chain.batch else _one
    return {f"numba {name}": run(chain, tables.splitting(name)) for name in SPLITTING}


def _one(chain, table):
    c = chain.single("the numba loop")

    def call(steps):
        u = c.u.copy()
        v = c.v.copy()
        hertz(
            u,
            v,
            steps,
            c.t1 / steps,
            c.stiffness,
            c.overlap,
            c.force,
            1.5,
            c.inverse_mass,
            table.a,
            table.b,
        )
        return u, v

    return call


def _batch(chain, table):
    us, vs, inverse = (np.ascontiguousarray(x.T) for x in (chain.u, chain.v, chain.inverse_mass))

    def call(steps):
        u = us.copy()
        v = vs.copy()
        h = chain.t1 / steps
        hertz_batch(
            u, v, steps, h, chain.stiffness, chain.overlap, chain.force, inverse, table.a, table.b
        )
        return u.T, v.T

    return call
