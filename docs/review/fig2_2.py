"""Fig. 2.2: transmitted force of a dimer chain over the mass ratio.

A striker like the heavy beads hits a 1:1 dimer chain of 101 beads without precompression. The
figure shows the largest force on the rigid wall at its far end, over that of the monomer. Between
the mass ratios 0.55 and 0.594 a second pulse causes this maximum. Dotted: the asymptotic
anti-resonances of the literature. The review says that less than 30 % is transmitted at 0.59. The
expected values are from SciPy's DOP853 at a relative tolerance of 1e-10; the ratio 0.595 and its
0.2096 are the minimum of the literature.
"""

import matplotlib.pyplot as plt
import numpy as np

import granjax as gx

BEADS = 101
LOWEST = 0.05
KNOWN = {0.59: 0.2683193, 0.5944: 0.2086785, 0.595: 0.2096113}


def make():
    sweep = gx.resonance.transmission(np.linspace(LOWEST, 1.0, 381), BEADS)
    found = gx.resonance.refine(sweep, accuracy=2e-5)
    # add the extrema to the points of the curve, so that its cusps are sharp
    ratio = np.concatenate(
        [sweep.mass_ratio, found.resonances, found.anti_resonances, found.local_extrema]
    )
    force = np.concatenate(
        [sweep.transmission, found.resonance_transmission]
        + [found.anti_resonance_transmission, found.local_transmission]
    )
    lowest = found.resonance_transmission.argmin()
    x = float(found.resonances[lowest])
    y = float(found.resonance_transmission[lowest])

    ax = plt.figure(figsize=(6.4, 3.8), layout="constrained").subplots()
    zeros = [zero for zero in gx.resonance.ANTI_RESONANCES if zero >= LOWEST]
    label = f"wall after {BEADS} beads"
    y_label = "peak wall force / monomer's"
    gx.plots.transmission(ratio, force, ax, anti_resonances=zeros, label=label, y_label=y_label)
    ax.plot([x], [y], "o", color=gx.plots.COLOURS[1], ms=5, mec="white", mew=0.5, zorder=3)
    ax.annotate(f"{y:.3f} at {x:.3f}", (x, y), (6, -12), textcoords="offset points", size="small")

    few = gx.resonance.transmission(list(KNOWN), BEADS).transmission
    return {
        "smallest transmission": (y, 0.20868, 1e-4),
        "the literature's": (y, 0.2096, 1e-3),
        "its mass ratio": (x, 0.595, 5e-3),
    } | {f"transmission at {x}": (float(T), KNOWN[x], 2e-5) for x, T in zip(KNOWN, few)}


if __name__ == "__main__":
    print(*make().items(), sep="\n")
    plt.show()
