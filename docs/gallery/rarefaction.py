"""Hollow cylinders: a shock of rarefaction

Contacts that soften in compression reverse the usual behaviour: if two halves are pulled apart, a dispersive shock of
rarefaction runs out, led by a rarefaction pulse. The dashed lines are its edges by dispersive-shock fitting.

:systems: rarefaction waves in hollow elliptical cylinders
:part: Shocks
:number: mean strain behind the shock, c = -0.1, exponent 1/2
:expected: -0.27234
:within: 1e-4
:source: a simulation until t = 1000; Kim, Kim, Chong, Kevrekidis, Yang, Phys. Rev. Lett. 120, 194101 (2018)
"""

import matplotlib.pyplot as plt
import numpy as np

import granjax as gx

chain = gx.scenes.hollow_cylinders(300, 0.5, boundary="free")
run = gx.shocks.velocity_shock(chain, -0.1).run(170.0)
strain = gx.measures.strain(chain, run.final)
number = float(np.average(strain[120:180], weights=np.hanning(60)))
ax = plt.subplots(figsize=(5.4, 3.2), layout="constrained")[1]
gx.plots.shock(run, ax=ax)
edges = gx.theory.shock_edges(chain, -0.1)
for speed in (edges.trailing_speed, edges.leading_speed):
    ax.axvline(speed * 170, color="C1", ls="--")
