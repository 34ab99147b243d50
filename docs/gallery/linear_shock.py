"""Two halves of a linear chain collide

Without nonlinearity there is no shock, but the lattice still disperses the front. The front widens with the cube root
of time, and the strain oscillates about the plateau. Dots are the simulation, the line is a sum of Bessel functions.

:systems: linear shock
:part: Shocks
:number: strain of the first crest behind the front at t = 80, c = 1/2
:expected: 1.2465185610713
:within: 1e-9
:source: y_n = int_0^t (J_2n(2s) + J_2n+2(2s)) ds; Schroedinger, Ann. Phys. 44, 916 (1914)
"""

import matplotlib.pyplot as plt
import numpy as np

import granjax as gx

chain = gx.Lattice(1.0, gx.Bond(gx.Shift(1, "free"), gx.Linear(1.0)), sites=241)
run = gx.shocks.velocity_shock(chain, 0.5).run(80.0)
strain = gx.measures.strain(chain, run.final)
number = float(strain.max())
n = np.arange(240) - 120
ax = plt.subplots(figsize=(5.4, 3.2), layout="constrained")[1]
ax.plot(n, gx.theory.linear_shock.velocity_step(n, 80.0, 0.5), label="Bessel functions")
ax.plot(n, strain, "k.", ms=3, label="simulation")
ax.set(xlabel="contact from the step", ylabel="strain (scaled)", xlim=(0, 100))
ax.legend()
