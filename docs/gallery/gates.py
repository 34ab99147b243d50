"""A switch and a logic gate made of beads

Sines in the gap of a chain under load do not pass. Two of them together do: the contacts make their difference in
frequency, which lies in the band. So a threshold on what comes out reads "both": AND.

:systems: switch and logic gates
:part: Devices
:number: root mean square velocity of the last bead with both signals, mm/s, 20 to 30 ms after they begin
:expected: 0.085625
:within: 0.5 %
:source: SciPy's DOP853 with forces of its own; Li, Anzel, Yang, Kevrekidis, Daraio, Nature Commun. 5, 5311 (2014)
"""
import matplotlib.pyplot as plt
import numpy as np

import granjax as gx

chain = gx.scenes.beads("steel 316", np.full(10, 9.53e-3), 8.0)
edge = float(gx.linear.normal_modes(chain).omega[-1])
table = gx.studies.truth_table(chain, [0.1e-6, 0.1e-6], [1.5 * edge, 1.1 * edge], damping=1 / 1.75e-3, settling=20e-3,
                               watch=10e-3)
number = float(table.output[3]) * 1e3
ax = plt.subplots(figsize=(5.4, 3.2), layout="constrained")[1]
gx.plots.truth_table(table, ax)
