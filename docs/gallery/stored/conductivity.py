"""Heat flux through beta-FPUT chains between two baths: `python conductivity.py` writes conductivity.csv, some 20 min.

Strongly nonlinear (k_B T = 10), so that short chains are long against the ways that energy goes freely. The gradient is
that of the middle half, as the temperature jumps at the ends.
"""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

import granjax as gx

HOT = 12.0
COLD = 8.0
RATE = 1.0
LANES = 16
STEP = 0.1
EVERY = 2.0
# times of a run; of what is left out at its start for a chain of N sites, a multiple of N^2; of a piece
END = 1e5
SETTLING = 0.01
PIECE = 1000.0
SITES = 64, 128, 256, 512, 1024


def chains(N):
    """Equal chains between walls, their end sites in baths with noise of their own."""
    rate = np.zeros(N)
    temperature = np.zeros(N)
    rate[[0, -1]] = RATE
    temperature[[0, -1]] = (HOT, COLD)
    bond = gx.Bond(gx.Shift(1, "fixed"), gx.Polynomial(1.0, 0.0, 1.0))

    def one(mass):
        return gx.Lattice(mass, (bond, gx.Langevin(rate, temperature, seed=N)), sites=N)

    return jax.vmap(one, out_axes=-1)(jnp.ones(LANES))


@jax.jit
def means(lattice, us, vs):
    """The current through a bond and the squares of the velocities, over the frames, for each lane."""
    current = lambda y: gx.measures.heat_current(lattice, gx.State(*y)).mean(0)
    return jax.lax.map(current, (us, vs)).mean(0), (vs**2).mean(0)


def conductivity(current, temperature):
    """The mean current over the slope of the mean temperature in the middle half."""
    N = len(temperature)
    middle = np.arange(N // 4, N - N // 4)
    return -current.mean() / np.polyfit(middle, temperature.mean(1)[middle], 1)[0]


def measured(N):
    """(conductivity, its standard error by leaving out one lane after the other)."""
    lattice = chains(N)
    frames = round(PIECE / EVERY) + 1
    state = gx.states.gibbs(lattice, (HOT + COLD) / 2, seed=N)
    settled = round(max(SETTLING * N**2, 5 * PIECE) / PIECE)
    found = []
    for i in range(settled + round(END / PIECE)):
        span = i * PIECE, (i + 1) * PIECE
        run = gx.simulate(lattice, state, span[1], t0=span[0], step=STEP, save_at=frames)
        state = run.final
        if i >= settled:
            found.append(means(lattice, run.us[1:], run.vs[1:]))
    current, temperature = (np.mean(x, 0) for x in zip(*found))
    without = [
        conductivity(np.delete(current, i), np.delete(temperature, i, 1)) for i in range(LANES)
    ]
    return conductivity(current, temperature), np.std(without) * (LANES - 1) ** 0.5


def main():
    lines = ["sites,conductivity,error"]
    for N in SITES:
        kappa, error = measured(N)
        lines.append(f"{N},{kappa:.5g},{error:.2g}")
        print(lines[-1], flush=True)
    Path(__file__).with_suffix(".csv").write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
