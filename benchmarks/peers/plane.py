"""Numba loops for packings of the plane with beads at rest all around: one pass over bonds, one kicks and drifts.

A bond's force is evaluated once; both passes run along the last axis and compile to vector instructions.
"""

import math

import numba
import numpy as np


@numba.njit(inline="always")
def _press(ux, uy, fx, fy, di, dj, Rx, Ry, R, A, d0):
    """Forces of the bonds (i, j) - (i + di, j + dj), at their tails; arrays have a rim of beads at rest."""
    n, m = ux.shape
    first, last = (1, m) if dj < 0 else (0, m - dj)
    if dj < 0:
        first = -dj
    for i in range(n - di):
        for j in range(first, last):
            x = Rx + ux[i + di, j + dj] - ux[i, j]
            y = Ry + uy[i + di, j + dj] - uy[i, j]
            length = math.sqrt(x * x + y * y)
            s = max(d0 + R - length, 0.0)
            pull = -A * s * math.sqrt(s) / length
            fx[i, j] = pull * x
            fy[i, j] = pull * y


@numba.njit(fastmath=True)
def packing(u, v, steps, h, A, d0, offsets, vectors, a, b):
    """`steps` steps of length h on u, v (n, m, 2), in place, m = 1; `offsets` (bonds, 2), `vectors` (bonds, 2)."""
    n = u.shape[0]
    m = u.shape[1]
    kinds = len(offsets)
    ux = np.zeros((n + 2, m + 2))
    uy = np.zeros((n + 2, m + 2))
    vx = np.zeros((n + 2, m + 2))
    vy = np.zeros((n + 2, m + 2))
    ux[1:-1, 1:-1] = u[..., 0]
    uy[1:-1, 1:-1] = u[..., 1]
    vx[1:-1, 1:-1] = v[..., 0]
    vy[1:-1, 1:-1] = v[..., 1]
    fx = np.zeros((kinds, n + 2, m + 2))
    fy = np.zeros((kinds, n + 2, m + 2))
    stages = a.size
    for step in range(steps):
        for stage in range(stages + 1):
            if step == 0 or stage > 0:
                for k in range(kinds):
                    R = math.sqrt(vectors[k, 0] ** 2 + vectors[k, 1] ** 2)
                    _press(
                        ux,
                        uy,
                        fx[k],
                        fy[k],
                        offsets[k, 0],
                        offsets[k, 1],
                        vectors[k, 0],
                        vectors[k, 1],
                        R,
                        A,
                        d0,
                    )
            bh = b[stage] * h
            ah = a[stage] * h if stage < stages else 0.0
            for i in range(1, n + 1):
                for k in range(kinds):
                    p = offsets[k, 0]
                    q = offsets[k, 1]
                    for j in range(1, m + 1):
                        vx[i, j] += bh * (fx[k, i, j] - fx[k, i - p, j - q])
                        vy[i, j] += bh * (fy[k, i, j] - fy[k, i - p, j - q])
                for j in range(1, m + 1):
                    ux[i, j] += ah * vx[i, j]
                    uy[i, j] += ah * vy[i, j]
    u[..., 0], u[..., 1] = ux[1:-1, 1:-1], uy[1:-1, 1:-1]
    v[..., 0], v[..., 1] = vx[1:-1, 1:-1], vy[1:-1, 1:-1]
