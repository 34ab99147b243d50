"""Modulational instability: a uniform wave breaks into breathers

In a chain whose contacts soften, neighbours oscillate against each other with the same amplitude. This uniform wave is
unstable: a slow modulation grows at the rate of the nonlinear Schroedinger equation until the energy is concentrated in
one place, and later returns.

:systems: modulational instability
:part: Breathers
:number: growth rate of the modulation of 120 sites, per unit of time
:expected: 4.8534e-4
:within: 3 %
:source: nu2 Q^2 (2 nu3 a^2 - nu2 Q^2) = rate^2, nu2 = sqrt2/8, nu3 = sqrt2/16; Benjamin, Feir, J. Fluid Mech. 27 (1967)
"""

import matplotlib.pyplot as plt
import numpy as np

import granjax as gx

sites = 120
a = 0.0741
chain = gx.scenes.foam(sites, 0.5, boundary="periodic")
n = np.arange(sites)
wave = a * (-1.0) ** n * (1 + 0.002 * -np.cos(2 * np.pi * n / sites))
run = gx.simulate(chain, gx.State(wave, 0 * wave), 24000.0, save_at=961)
side = np.abs(np.fft.fft((-1.0) ** n * (run.us + 1j * run.vs / 2**0.5), axis=1))[:, 1]
early = (run.ts > 5000) & (run.ts < 9000)
number = float(np.polyfit(run.ts[early], np.log(side[early]), 1)[0])
energy = gx.measures.along(gx.measures.site_energy, chain, run)
ax = plt.subplots(figsize=(5.4, 3.2), layout="constrained")[1]
gx.plots.space_time(energy, ax, ts=run.ts, label="energy (scaled)")
ax.set_ylabel("time (scaled)")
