"""A dispersive shock of Toda's chain

Two halves of a chain collide. Between the plateau behind and the chain at rest ahead an oscillation becomes longer and
longer. It is a linear wave at its trailing edge and a soliton at its leading edge. Whitham's theory gives the plateau,
the edges and the amplitude in closed form.

:systems: Toda dispersive shock
:part: Shocks
:number: mean strain of the plateau at c = 0.5, t = 120
:expected: 0.81093022
:within: 1e-4
:source: 2 ln(1 + c); Venakides, Deift, Oba, Comm. Pure Appl. Math. 44, 1171 (1991)
"""

import matplotlib.pyplot as plt
import numpy as np

import granjax as gx

chain = gx.scenes.toda(340)
run = gx.shocks.velocity_shock(chain, 0.5).run(120.0)
strain = gx.measures.strain(chain, run.final)
number = float(np.average(strain[140:200], weights=np.hanning(60)))
ax = plt.subplots(figsize=(5.4, 3.2), layout="constrained")[1]
gx.plots.shock(run, gx.theory.toda.velocity_shock(0.5), ax)
