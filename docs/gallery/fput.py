"""Fermi, Pasta, Ulam and Tsingou: the energy comes back

All energy starts in the longest mode of 31 masses between springs with a quadratic force term (alpha = 1/4). It spreads
over a few modes and returns to the first mode at t = 9376, after 146 of its periods.

:systems: FPUT chain
:part: Lattices
:number: share of the energy in mode 1 at the recurrence, t = 9376.5
:expected: 0.9813
:within: 0.0002
:source: Fermi, Pasta, Ulam, Los Alamos report LA-1940 (1955); the value by two integrators of order 8 and more
"""

import matplotlib.pyplot as plt
import numpy as np

import granjax as gx

chain = gx.scenes.fput(31, alpha=0.25)
modes = gx.linear.normal_modes(chain)
run = gx.simulate(chain, gx.states.sine_mode(chain, 1), 9376.5, step=0.5, save_at=200)
energy = [
    gx.measures.modal_energy(chain, gx.State(u, v), modes.modes, modes.omega)
    for u, v in zip(run.us, run.vs)
]
share = np.asarray(energy)[:, :4] / 0.0770443732448498
number = share[-1, 0]
ax = plt.subplots(figsize=(5.4, 3.2), layout="constrained")[1]
ax.plot(run.ts, share, label=[f"mode {i + 1}" for i in range(4)])
ax.set(xlabel="time (scaled)", ylabel="energy / total", title=f"mode 1 again: {number:.4f}")
ax.legend(loc="upper left", bbox_to_anchor=(1, 1))
