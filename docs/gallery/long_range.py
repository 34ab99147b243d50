"""Long-range interactions: a breather with an algebraic tail

A light mass oscillates above the band in a chain with springs to all neighbours, whose stiffness decays as 1/m^3. The
breather decays like the springs, and not exponentially as with nearest-neighbour springs alone.

:systems: long-range interactions
:part: Beyond the granular chain
:number: log-log slope of the tail, 12 to 27 sites from the centre
:expected: -3.0
:within: 3 %
:source: |u| ~ n^(-s) for springs m^(-s); Flach, Phys. Rev. E 58, R4116 (1998)
"""

import matplotlib.pyplot as plt
import numpy as np

import granjax as gx

sites = 61
centre = 30
n = np.arange(1, 31)
mass = np.where(np.arange(sites) == centre, 0.4, 1.0)
ax = plt.subplots(figsize=(5.4, 3.2), layout="constrained")[1]
for reach, name in ((1, "next neighbours"), (None, "all neighbours")):
    chain = gx.scenes.long_range(sites, 3.0, mass=mass, beta=1.0, reach=reach)
    modes = gx.linear.normal_modes(chain)
    start = gx.State(0.3 * modes.modes[:, -1] / modes.modes[centre, -1], chain.zeros())
    breather = gx.breathers.breather(chain, 1.02 * float(modes.omega[-1]), start, steps=32)
    u = np.abs(np.asarray(breather.state.u))[centre + n]
    ax.loglog(n[u > 1e-13], u[u > 1e-13], ".-", label=name)
number = float(np.polyfit(np.log(n[11:27]), np.log(u[11:27]), 1)[0])
ax.loglog(n, 2 * u[20] * (n / 21.0) ** -3, "k:", label="$n^{-3}$")
ax.set(
    xlabel="distance from the light mass (sites)",
    ylabel="displacement |u| (scaled)",
    ylim=(1e-10, 1),
)
ax.legend()
