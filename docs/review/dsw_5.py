"""DSW.5: edges of the granular velocity shock, KdV and Toda.

The figure shows the strain of the shock of DSW.3 up to t = 300, and the edges of KdV (solid) and
Toda (dashed). The expected value is from an independent integration by SciPy's DOP853 at 1e-12.
"""

import matplotlib.pyplot as plt
import numpy as np
from dsw_1 import crests
from dsw_3 import KDV, TODA, pushed

import granjax as gx

LAST = 300.0


def make():
    seen = gx.shocks.space_time(pushed(), LAST, 160, np.arange(int(1.25 * LAST)), step=0.4)
    ax = plt.figure(figsize=(6.4, 4.4), layout="constrained").subplots()
    gx.plots.space_time(
        seen.strain,
        ax,
        ts=seen.ts,
        sites=seen.places,
        label="strain (scaled)",
        site_label="bond from the step $n$",
    )
    for name, edges, dash in (("KdV", KDV, "-"), ("Toda", TODA, "--")):
        for speed, label in ((edges.trailing_speed, name), (edges.leading_speed, None)):
            ax.plot(speed * seen.ts, seen.ts, dash, color="white", lw=1.2, label=label)
    ax.set(xlim=(seen.places[0], seen.places[-1]), ylabel="time (scaled)")
    ax.legend(loc="lower right", frameon=False, labelcolor="white")
    top = crests(np.asarray(seen.places), np.asarray(seen.strain[-1]))[0]
    return {"place of the leading crest over time": (top[-1] / LAST, 1.037302677, 1e-6)}


if __name__ == "__main__":
    print(*make().items(), sep="\n")
    plt.show()
