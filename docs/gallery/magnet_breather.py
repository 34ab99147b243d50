"""Breathers of magnets: an algebraic tail about a light one

In a chain of magnets that all repel each other a light magnet oscillates above the band. Its breathers start from a
localised mode. The tail of the mode decays as the stiffness between two magnets, r^(-5), and not exponentially as it
would with nearest neighbours alone.

:systems: breathers of magnets
:part: Beyond the granular chain
:number: log-log slope of the mode's tail, 15 to 50 magnets from the light one
:expected: -5.0
:within: 2 %
:source: stiffness 4 A r^(-5) of F = A r^(-4); Moleron et al., New J. Phys. 21, 063032 (2019)
"""

import matplotlib.pyplot as plt
import numpy as np

import granjax as gx

sites = 161
centre = 80
n = np.arange(1, 76)
mass = np.where(np.arange(sites) == centre, 0.4, 1.0)
ax = plt.subplots(figsize=(5.4, 3.2), layout="constrained")[1]
for reach, name in ((1, "next neighbours alone"), (None, "all magnets")):
    modes = gx.linear.normal_modes(gx.scenes.magnets(sites, -4.0, mass=mass, reach=reach))
    u = np.abs(np.asarray(modes.modes[:, -1] / modes.modes[centre, -1]))[centre + n]
    ax.loglog(n[u > 1e-13], u[u > 1e-13], ".-", label=name)
number = float(np.polyfit(np.log(n[14:50]), np.log(u[14:50]), 1)[0])
ax.loglog(n, 2 * u[14] * (n / 15.0) ** -5, "k:", label="$r^{-5}$")
ax.set(
    xlabel="distance from the light magnet", ylabel="displacement over its largest", ylim=(1e-12, 1)
)
ax.legend()
