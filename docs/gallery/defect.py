"""A light bead holds a mode above the band

One bead of mass 0.6 in a chain of equal beads has a localised mode. Its frequency lies above the band of the waves,
which is shaded, and its amplitude falls by the same factor from bead to bead.

:systems: defect modes
:part: Breathers
:number: omega^2 of the mode over stiffness by mass
:expected: 4.761904762
:within: 1e-8
:source: 4/(0.6 (2 - 0.6)); Theocharis et al., Phys. Rev. E 80, 066601 (2009)
"""

import matplotlib.pyplot as plt
import numpy as np

import granjax as gx

chain = gx.scenes.defects(61, {30: 0.6}, precompression=1.0)
modes = gx.linear.normal_modes(chain)
number = float(modes.omega[-1] ** 2 / 1.5)
fig, (ax, right) = plt.subplots(1, 2, figsize=(5.4, 3.2), layout="constrained", width_ratios=(3, 2))
ax.plot(np.arange(61) - 30, modes.modes[:, -1], "o-", ms=4, lw=0.8)
ax.set(
    xlabel="bead from the defect",
    ylabel="mode",
    xlim=(-12, 12),
    title=f"$\\omega^2 = {number:.6f}\\,K/m$",
)
right.plot(modes.omega, ".")
right.plot(60, modes.omega[-1], "o", color="C1")
right.axhspan(0, 6**0.5, color="0.9", zorder=0)
right.set(xlabel="mode", ylabel=r"angular frequency $\omega$ (scaled)", ylim=(0, 2.9))
