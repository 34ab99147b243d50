"""Breather.2: dark breather of a driven, damped steel chain, from rest and by Newton's method.

This simulates the experiment: 21 beads of steel (E = 200 GPa, nu = 0.3, 28.2 g, radius 9.53 mm, 10
N, damping time 5 ms) lie between walls that push towards the chain at the same time. Chosen here:
0.2 um at 7290 Hz; the cut-off of the infinite chain is 7369 Hz. Left: the velocities after settling
from rest, their extrema, and those of the periodic orbit from Newton's method. Right: the change of
the state from one period to the next. Where this change first falls to 1e-8, all velocities are
disturbed once at random, by up to 1e-6 of the largest. The settled motion must therefore also be
stable against motions without the mirror symmetry of the start, which decay more slowly. The
expected value is from harmonic balance in NumPy (benchmarks/references/harmonic_balance.py), where
12 and 20 harmonics agree to 1e-10; SciPy's DOP853 closes the orbit to 1e-13. The chain is that of
Chong et al., Phys. Rev. E 89, 032924 (2014).
"""

import math

import matplotlib.pyplot as plt
import numpy as np

import granjax as gx

MASS = 28.2e-3
RADIUS = 9.53e-3
AMPLITUDE = 0.2e-6
FREQUENCY = 7290.0


def make():
    steel = gx.materials.Material("steel", 200e9, 0.3, MASS / (4 / 3 * math.pi * RADIUS**3))
    stiffness = gx.materials.hertz_coefficient(steel, RADIUS)
    chain = gx.scenes.monomer(21, MASS, stiffness, precompression=10.0).counted_in("SI")
    omega = 2 * math.pi * FREQUENCY
    driven = gx.driven.driven_chain(chain, AMPLITUDE, omega, damping=1 / 5e-3, phase=(0, math.pi))
    found = gx.driven.settle(driven, gx.states.rest(chain), 1 / FREQUENCY, periods=8000, steps=48)
    orbit = gx.forced.forced_orbit(driven, 1 / FREQUENCY).run(len(found.ts))
    v = 1e3 * np.asarray(found.vs)
    exact = 1e3 * np.asarray(orbit.vs)

    canvas = plt.figure(figsize=(9.2, 3.8), layout="constrained")
    left, right = canvas.subplots(1, 2, width_ratios=(1.5, 1))
    bead = np.arange(1, 22)
    left.plot(bead, v[::2].T, "C2-", lw=0.7, alpha=0.6, label=["velocity in time"] + [None] * 23)
    ends = np.stack([v.max(0), v.min(0)], 1)
    left.plot(bead, ends, "C0o", ms=7, mfc="none", label=["maxima, minima", None])
    ends = np.stack([exact.max(0), exact.min(0)], 1)
    left.plot(bead, ends, "C1.", ms=5, label=["Newton's orbit", None])
    highest = float(gx.linear.normal_modes(chain).omega[-1]) / (2 * math.pi)
    cutoff = float(gx.linear.bands(chain).upper[0]) / (2 * math.pi)
    at = f"driven at {FREQUENCY:.0f} Hz; highest mode {highest:.0f} Hz, cut-off {cutoff:.0f} Hz"
    left.set(xlabel="bead", ylabel="velocity (mm/s)", title=at)
    left.set(xticks=bead[::5], ylim=(None, 1.35 * v.max()))
    left.legend(loc="upper center", ncols=3, columnspacing=1.0, handletextpad=0.3)
    right.semilogy(np.arange(1, 1 + len(found.changes)), found.changes)
    right.set(xlabel="period since rest", ylabel="change per period (relative)")
    missed = abs(v - exact).max() / abs(exact).max()
    return {
        "root mean square of all velocities [mm/s]": ((v**2).mean() ** 0.5, 6.69536459, 1e-6),
        "periods after which the chain repeats": (found.multiple, 1, 0),
        "velocities less the orbit's over the largest": (missed, 0, 1e-6),
    }


if __name__ == "__main__":
    print(*make().items(), sep="\n")
    plt.show()
