"""Equipartition: the energy of the alpha chain does not come back for ever

At a small energy the first mode of the FPUT chain recovers its energy again and again. At a larger energy these
recurrences are lost: the energy spreads over all modes, and the entropy of their shares approaches that of thermal
equilibrium. This entropy is less than ln N, by 0.39 for 15 modes, because the energies fluctuate.

:systems: FPUT chain
:part: Thermal chains and chaos
:number: effective share of the modes, exp(mean entropy)/15, t > 1e6
:expected: 0.6772
:within: 0.03
:source: exp(H_15 - 1)/15, H_n the harmonic numbers, of energies with an exponential distribution
"""

import matplotlib.pyplot as plt
import numpy as np

import granjax as gx

chain = gx.scenes.fput(15, alpha=0.25)
modes = gx.linear.normal_modes(chain)
ax = plt.subplots(figsize=(5.4, 3.2), layout="constrained")[1]
for amplitude in (1.0, 4.0):
    start = gx.states.sine_mode(chain, 1, amplitude)
    run = gx.simulate(chain, start, 2e6, step=0.4, save_at=4001)
    shares = lambda lattice, y, t: gx.measures.modal_energy(lattice, y, modes.modes, modes.omega)
    energies = gx.measures.along(shares, chain, run)
    entropy = np.asarray(gx.measures.spectral_entropy(np.asarray(energies).T))
    ax.semilogx(run.ts[1:], np.exp(entropy[1:]) / 15, label=f"amplitude {amplitude:.0f}", lw=0.8)
number = np.exp(entropy[2000:].mean()) / 15
ax.axhline(
    np.exp(np.sum(1 / np.arange(2.0, 16.0))) / 15, color="k", ls="--", label="thermal equilibrium"
)
ax.set(xlabel="time (scaled)", ylabel="effective share of the modes")
ax.legend(loc="lower right")
