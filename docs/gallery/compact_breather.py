"""Breathers that live on two sites alone

A diamond chain has a cubic force at each site. The two middle sites of one square move against each other. All other
sites stay exactly at rest at every amplitude, and each of the two moves like a single oscillator (line). The
frequencies may lie inside the bands of the waves (grey). The Floquet multipliers tell which breathers are stable (dots)
and which are unstable (crosses).

:systems: compact nonlinear breathers
:part: Topology and flat bands
:number: largest difference of the displacements of 8 breathers from those of two sites alone (scaled)
:expected: 0
:within: 1e-8
:source: one site, u'' = -4.5 u - u^3: omega = pi (4.5 + a^2)^(1/2)/(2 K(m)), m = a^2/(9 + 2 a^2)
"""

import matplotlib.pyplot as plt
import numpy as np
from scipy.special import ellipk

import granjax as gx

chain = gx.scenes.diamond(6, ground=0.5, on_site=gx.Polynomial(0.0, 0.0, 1.0))
pair = gx.linear.flat_bands(chain).state(chain)
swing = np.array([0.3, 0.6, 1.0, 1.4, 1.8, 2.2, 2.6, 3.0])
alone = (
    np.pi / 2 * np.sqrt(4.5 + swing**2) / ellipk(swing**2 / (9 + 2 * swing**2))
)  # the frequency of one site alone
ax = plt.subplots(figsize=(5.4, 3.2), layout="constrained")[1]
ax.axhspan(*np.sqrt(4.5 + np.array([-1, 1]) * 8**0.5), color="0.9")
ax.plot(swing, alone, color="0.4", label="one site alone")
off = []
for a, omega in zip(swing, alone):
    guess = gx.State({name: 0.9 * a * u for name, u in pair.u.items()}, pair.v)
    orbit = gx.breathers.breather(chain, omega, guess, check=False)
    off.append(max(np.abs(orbit.state.u[name] - a * u).max() for name, u in pair.u.items()))
    ax.plot(
        a, omega, {"stable": "C2o", "unstable": "C3x", "undecided": "C1s"}[orbit.floquet().verdict]
    )
number = float(max(off))
ax.set(xlabel="amplitude (scaled)", ylabel="angular frequency (scaled)", ylim=(1.9, 3.4))
ax.legend()
