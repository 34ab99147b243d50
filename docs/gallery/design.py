"""Design by gradients: masses that put a gap where it is wanted

Beads of two masses alternate. The derivatives of the band edges with respect to the masses are used to move the gap to
between 0.9 and 1.6 (shaded). The figure shows the dispersion before (dashed) and after.

:systems: gradients and design
:part: Data
:number: heavy mass that is found (scaled)
:expected: 3.7037037
:within: 1e-6
:source: 2 K2/omega^2 at the lower edge 0.9, K2 = 3/2
"""

import matplotlib.pyplot as plt
import numpy as np

import granjax as gx


def scene(p):
    return gx.scenes.pattern(8, (p["heavy"], p["light"]), precompression=1.0, boundary="periodic")


def misfit(p):
    bands = gx.linear.bands(scene(p), cell=2)
    return (bands.upper[0] - 0.9) ** 2 + (bands.lower[1] - 1.6) ** 2


start = {"heavy": 2.0, "light": 1.4}
found = gx.design(misfit, start, bounds={"heavy": (0, None), "light": (0, None)}, tolerance=1e-10)
number = float(found.parameters["heavy"])
k = np.linspace(-np.pi, np.pi, 101)
ax = plt.subplots(figsize=(5.4, 3.2), layout="constrained")[1]
ax.axhspan(0.9, 1.6, color="C1", alpha=0.25)
ax.plot(k, gx.linear.dispersion(scene(start), k, cell=2).omega, "--", color="0.5")
ax.plot(k, gx.linear.dispersion(scene(found.parameters), k, cell=2).omega, color="C0", lw=2)
ax.set(xlabel="phase k per cell (rad)", ylabel=r"$\omega$ (scaled)")
