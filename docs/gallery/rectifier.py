"""A rectifier: what passes from left and from right is not the same

Six steel beads under load, the second of them smaller, driven from either wall in the gap just below its mode. A weak
drive passes alike both ways, as reciprocity says. What differs grows as the square of the amplitude: rectification.

:systems: rectifier
:part: Devices
:number: log-log slope of the difference over the drive's amplitude, 0.1 to 1 nm
:expected: 2.0
:within: 2 %
:source: third order of the forces; Rayleigh, The Theory of Sound, 107; Boechler et al., Nature Mater. 10, 665 (2011)
"""
import matplotlib.pyplot as plt
import numpy as np

import granjax as gx

chain = gx.scenes.beads("steel 316", 1e-3 * np.array([9.53, 7.0, 9.53, 9.53, 9.53, 9.53]), 8.0)
omega = 0.98 * float(gx.linear.normal_modes(chain).omega[-1])
amplitudes = np.array([1e-10, 1e-9, 4e-9])
ways = gx.studies.two_way(chain, amplitudes, omega, damping=1 / 1.75e-3, steps=96)
number = float(np.log10(abs(ways.asymmetry[1] / ways.asymmetry[0])))
ax = plt.subplots(figsize=(5.4, 3.2), layout="constrained")[1]
ax.loglog(1e9 * amplitudes, np.abs(ways.asymmetry), "o", label="left against right")
ax.loglog(1e9 * amplitudes, abs(ways.asymmetry[1]) * (amplitudes / 1e-9) ** 2, "k:", label="$a^2$")
ax.set(xlabel="amplitude of the drive (nm)", ylabel="relative difference of what passes")
ax.legend()
