"""Fig. 1.5: space-time plot of the bead velocities of a granular chain.

The figure shows all beads of the simulation of fig. 1.4. The pulse travels at some 560 m/s, as in
the experiments, far below the speed of sound in steel. The expected speed is from converged
simulations of a long chain by two independent methods, A = m = v = 1.
"""

import matplotlib.pyplot as plt
from fig1_4 import PEAK, SPEED, STEEL, scale, struck

import granjax as gx


def make():
    run, _, speed = struck(*STEEL)
    metres = float(speed) * 2 * STEEL[1]
    ax = plt.figure(figsize=(5.4, 4.0), layout="constrained").subplots()
    limit = 1.05 * PEAK * STEEL[2]
    gx.plots.space_time(run, ax, site_label="bead", limit=limit)
    ax.text(0.97, 0.05, f"pulse {metres:.0f} m/s", transform=ax.transAxes, ha="right", color="0.2")
    ax.set_title("Velocity of every bead")
    return {
        "pulse speed [beads/s] / (A^2 v/m^2)^(1/5)": (float(speed) / scale(*STEEL), SPEED, 2e-5),
        "pulse speed [m/s]": (metres, 560.0, 60.0),
    }


if __name__ == "__main__":
    print(*make().items(), sep="\n")
    plt.show()
