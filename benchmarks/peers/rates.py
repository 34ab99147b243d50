"""dy/dt of y = (u, v), compiled by numba with the chain's numbers as constants: for integrators that ask for one."""

import math

import numba
import numpy as np


def compiled_rates(chain, peer):
    """`rates(y, out)`, which writes dy/dt of one chain of equal beads."""
    c = chain.single(peer)
    A = c.stiffness
    d0 = c.overlap
    F0 = c.force
    w = c.inverse_mass
    N = c.u.size

    @numba.njit(fastmath=True, inline="always")
    def force(s):
        s = max(s, 0.0)
        return A * (s * math.sqrt(s)) - F0

    @numba.njit(fastmath=True)
    def rates(y, out):
        f = np.empty(N + 1)
        f[0] = force(d0 - y[0])
        for i in range(1, N):
            f[i] = force(d0 + y[i - 1] - y[i])
        f[N] = force(d0 + y[N - 1])
        for i in range(N):
            out[i] = y[N + i]
        for i in range(N):
            out[N + i] = w * (f[i] - f[i + 1])

    return rates


@numba.njit
def hertz_rates(y, A, inverse_mass):
    """dy/dt of y = (u, v) (2 N,) without precompression, for scipy's integrators."""
    N = y.size // 2
    rates = np.empty_like(y)
    f = np.empty(N + 1)
    f[0] = max(-y[0], 0.0)
    for i in range(1, N):
        f[i] = max(y[i - 1] - y[i], 0.0)
    f[N] = max(y[N - 1], 0.0)
    for i in range(N + 1):
        f[i] = A * (f[i] * math.sqrt(f[i]))
    for i in range(N):
        rates[i] = y[N + i]
        rates[N + i] = inverse_mass * (f[i] - f[i + 1])
    return rates
