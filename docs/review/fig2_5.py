"""Fig. 2.5: velocities of the light beads at the first resonance.

The simulation of fig. 2.4 is shown as long as its detail does not depend on rounding. No contact
force exceeds that of a contact that holds all the energy, (2/5) A delta^(5/2) = m v^2/2. The
expected value is from SciPy's DOP853, where relative tolerances of 1e-10 and 1e-12 agree to 1e-7.
"""

import matplotlib.pyplot as plt
import numpy as np
from fig2_4 import RATIO, STRIKER, draw, struck


def make():
    chain, run, _, newton = struck()
    draw(5, "Light")
    force = np.asarray(run.recorded["force"])
    peak = float(run.recorded["velocity"][41])
    return {
        "peak velocity of the light bead 41 / striker velocity": (peak / STRIKER, 0.445059, 1e-5),
        "mass ratio": (float(chain.mass[1] / chain.mass[0]), RATIO, 6e-7),
        "largest contact force / that of all the energy, 0 to 1": (
            force.max() / (1.25**0.6 * newton),
            0.5,
            0.5,
        ),
        "contacts up to 99 that never close": ((force[:100] <= 0).sum(), 0, 0),
    }


if __name__ == "__main__":
    print(*make().items(), sep="\n")
    plt.show()
