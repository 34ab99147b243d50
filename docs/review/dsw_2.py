"""DSW.2: two zooms into the dispersive shock.

The figure shows the shock of DSW.1 near its trailing and its leading edge: bonds (dots) and splines
through them. The expected value is from an independent integration by SciPy's DOP853 at 1e-12.
"""

import matplotlib.pyplot as plt
import numpy as np
from dsw_1 import TIME, crests, stepped
from scipy.interpolate import CubicSpline

# positions from the trailing (0) to the leading edge (1), and bonds on either side
ZOOMS = {"trailing": 0.17, "leading": 0.85}
ASIDE = 14


def make():
    places, strain, edges = stepped()
    axes = plt.figure(figsize=(8.4, 3.4), layout="constrained").subplots(1, 2)
    for ax, (name, x) in zip(axes, ZOOMS.items()):
        middle = TIME * (edges.trailing_speed + x * (edges.leading_speed - edges.trailing_speed))
        window = middle - ASIDE, middle + ASIDE
        near = (places > window[0]) & (places < window[1])
        fine = np.linspace(*places[near][[0, -1]], 16 * (near.sum() - 1) + 1)
        ax.plot(places[near], strain[near], "o", ms=3.5)
        ax.plot(fine, CubicSpline(places, strain)(fine), lw=1.2)
        ax.set(xlabel="bond from the step $n$", ylabel="strain (scaled)")
        ax.set_title(f"Near the {name} edge")
    top = crests(places, strain)[0]
    length = np.diff(top[(top > window[0]) & (top < window[1])]).mean()
    return {"distance of crests near the leading edge [bonds]": (length, 4.592161032, 1e-6)}


if __name__ == "__main__":
    print(*make().items(), sep="\n")
    plt.show()
