"""Self-trapping: beyond a threshold the energy of one site stays there

Two coupled sites of the discrete nonlinear Schroedinger equation, or two coupled circuits with nonlinear capacitors,
exchange the energy that one of them had at first. Above chi = 4V this exchange stops. Fractional coupling of more sites
lowers the threshold.

:systems: fractional DNLS and electrical lattices
:part: Beyond the granular chain
:number: threshold of two sites, chi/V
:expected: 4.0
:within: 1e-5
:source: Kenkre, Campbell, Phys. Rev. B 34, 4959 (1986); Molina, Phys. Lett. A 384, 126180 (2020) on fractional chains
"""

import matplotlib.pyplot as plt
import numpy as np

from granjax.first_order import DNLS, evolve, self_trapping

number = float(
    self_trapping(lambda chi: DNLS(2, 1.0, chi, boundary="fixed"), 3.0, 5.0, 20.0).nonlinearity
)
ax = plt.subplots(figsize=(5.4, 3.2), layout="constrained")[1]
for chi in (3.9, 4.1):
    run = evolve(DNLS(2, 1.0, chi, boundary="fixed"), np.array([1.0, 0.0]), 12.0, save_at=201)
    ax.plot(run.ts, run.densities[:, 0], label=rf"$\chi$ = {chi} V")
ax.set(xlabel="time (1/V)", ylabel=r"share of the first site, $|\psi_1|^2$", ylim=(-0.05, 1.3))
ax.legend(loc="upper center", ncols=2)
