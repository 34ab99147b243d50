"""The driven, damped steel chain of figure breather.2 by harmonic balance: `python -m references.harmonic_balance`.

Nothing of the library is in it. Unknown: the Fourier coefficients of every bead; residual: that of the equation of
motion, projected onto the harmonics; Newton's method, continued in the amplitude of the walls from the chain at rest.
"""

import math

import numpy as np

SITES = 21
MASS = 28.2e-3
RADIUS = 9.53e-3
YOUNG = 200e9
POISSON = 0.3
FORCE = 10.0
DAMPING_TIME = 5e-3
AMPLITUDE = 0.2e-6
FREQUENCY = 7290.0
SAMPLES = 8  # a harmonic
AMPLITUDES = (0.02, 0.05, *np.arange(1, 11) / 10)


def root_mean_square(harmonics):
    """Of the velocities of all beads over a period [m/s]."""
    stiffness = YOUNG * math.sqrt(2 * RADIUS) / (3 * (1 - POISSON**2))
    overlap = (FORCE / stiffness) ** (2 / 3)
    omega = 2 * math.pi * FREQUENCY
    # lengths in overlaps, times in 1/omega
    k = stiffness * math.sqrt(overlap) / (MASS * omega**2)
    gamma = 1 / (DAMPING_TIME * omega)
    count = 2 * harmonics + 1
    orders = np.arange(1, harmonics + 1)
    angle = 2 * math.pi * np.arange(SAMPLES * harmonics) / (SAMPLES * harmonics)
    basis = np.column_stack(
        [np.ones_like(angle), np.cos(np.outer(angle, orders)), np.sin(np.outer(angle, orders))]
    )
    project = np.linalg.pinv(basis)
    rate = np.zeros((count, count))
    rate[1 : harmonics + 1, harmonics + 1 :] = np.diag(orders)
    rate[harmonics + 1 :, 1 : harmonics + 1] = -np.diag(orders)
    linear = rate @ rate + gamma * rate

    def residual(c, a):
        wall = a * np.cos(angle)[:, None]
        u = np.concatenate([wall, basis @ c, -wall], axis=1)
        closed = 1 + u[:, :-1] - u[:, 1:]
        force = k * closed**1.5
        return (
            linear @ c - project @ (force[:, :-1] - force[:, 1:]),
            1.5 * k * np.sqrt(closed),
            closed.min(),
        )

    def jacobian(slope):
        J = np.zeros((count, SITES, count, SITES))
        for n in range(SITES):
            J[:, n, :, n] = linear + project @ ((slope[:, n] + slope[:, n + 1])[:, None] * basis)
            for other, bond in ((n - 1, n), (n + 1, n + 1)):
                if 0 <= other < SITES:
                    J[:, n, :, other] = -project @ (slope[:, bond][:, None] * basis)
        return J.reshape(count * SITES, count * SITES)

    c = np.zeros((count, SITES))
    for share in AMPLITUDES:
        for _ in range(20):
            left, slope, least = residual(c, share * AMPLITUDE / overlap)
            if least <= 0:
                raise RuntimeError("A contact opens.")
            if np.abs(left).max() < 1e-13:
                break
            c = c - np.linalg.solve(jacobian(slope), left.ravel()).reshape(c.shape)
        else:
            raise RuntimeError("Newton's method did not converge.")
    return overlap * omega * float(np.sqrt(np.mean((basis @ rate @ c) ** 2)))


if __name__ == "__main__":
    for harmonics in (12, 20):
        print(f"{harmonics} harmonics: {1e3 * root_mean_square(harmonics):.10f} mm/s")
