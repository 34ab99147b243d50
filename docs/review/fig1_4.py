"""Fig. 1.4: velocities of adjacent beads of a granular chain.

This simulates the experiment: a striker hits a chain of equal spheres in contact without
precompression, with Hertz contacts and no friction, rotation or losses. The review gives no numbers
for it, so these are chosen here: 32 beads of chrome steel of 19.05 mm, including the striker (bead
0), at 0.4 m/s. In units of A = m = v = 1 the pulse is the same for every material. The expected
values are from converged simulations of a long chain by two independent methods.
"""

import functools

import matplotlib.pyplot as plt
import numpy as np

import granjax as gx

STEEL = ("chrome steel", 9.525e-3, 0.4)
# largest velocity over the striker's; speed in beads per second over (A^2 v/m^2)^(1/5)
PEAK = 0.68163155
SPEED = 0.84050877
BEADS = 32


def velocity(t, y, lattice):
    return y.v


@functools.cache
def struck(material, radius, striker):
    """Return a run, its pulse's velocity over the striker's, and the pulse's speed [beads/s]."""
    rate = scale(material, radius, striker)
    chain = gx.scenes.beads(material, radius, cells=BEADS, boundary="free")
    start = gx.states.impact(chain, striker)
    end = (BEADS - 2) / (SPEED * rate)
    run = gx.simulate(chain, start, end, save_at=601, record={"peak": gx.Peak(velocity)})
    speed = gx.measures.front_speed(run.ts, run.vs, np.arange(10, BEADS - 6)).speed
    return run, run.recorded["peak"][2 * BEADS // 3] / striker, speed


def scale(material, radius, striker):
    """Return (A^2 v/m^2)^(1/5) [1/s], to which the speed of the pulse is proportional."""
    A = gx.materials.hertz_coefficient(material, radius)
    m = gx.materials.bead_mass(material, radius)
    return float((A * A * striker / (m * m)) ** 0.2)


def make():
    run, peak, speed = struck(*STEEL)
    overlaid, stacked = plt.figure(figsize=(8.8, 3.6), layout="constrained").subplots(1, 2)
    options = {"site_label": "bead"}
    data = run.in_units("us")
    gx.plots.traces(data, "v", np.arange(14, 19), overlaid, offset=0, **options)
    overlaid.set(title="Five adjacent beads", xlim=(1e6 * 12 / speed, 1e6 * 24 / speed))
    gx.plots.traces(data, "v", np.arange(2, 30, 4), stacked, **options)
    stacked.set_title("Every fourth bead")
    rows = {
        "peak bead velocity / striker velocity": (float(peak), PEAK, 2e-5),
        "velocity of the striker at the start [m/s]": (float(run.vs[0, 0]), 0.4, 0.0),
    }
    for other in (("PTFE", 2.38e-3, 1.5), ("aluminium", 12.7e-3, 0.05)):
        _, peak, speed = struck(*other)
        scaled = float(speed) / scale(*other)
        rows[f"the same of {other[0]}"] = (float(peak), PEAK, 2e-5)
        rows[f"pulse speed / (A^2 v/m^2)^(1/5) of {other[0]}"] = (scaled, SPEED, 2e-5)
    return rows


if __name__ == "__main__":
    print(*make().items(), sep="\n")
    plt.show()
