"""Fronts of a chain with dashpots

Dashpots between the beads turn a dispersive shock into a front that keeps its shape. The strain behind the front
oscillates, unless the damping is above a critical value.

:systems: dissipative shock fronts
:part: Shocks
:number: critical dashpot of Hertz contacts, strain from 0 to 1
:expected: 0.39486881
:within: 1e-7
:source: roots x and x + ik of 4 sinh^2(x/2) (3/2 - eta x) = x^2; James, Nonlinearity 34, 1758 (2021)
"""

import matplotlib.pyplot as plt
import numpy as np

import granjax as gx

xi = np.linspace(-16, 5, 400)
ax = plt.subplots(figsize=(5.4, 3.2), layout="constrained")[1]
for dashpot in (0.05, 0.15, 0.6):
    front = gx.shocks.dissipative_front(gx.Hertz(), 1.0, dashpot=dashpot)
    ax.plot(xi, front.strain(xi), label=f"{dashpot}, {front.kind}")
number = float(front.critical)
ax.set(xlabel="place n - ct (contacts)", ylabel="strain (scaled)")
ax.legend(title="dashpot", loc="lower left")
