"""A dimer chain without precompression: resonances and anti-resonances

Heavy and light beads alternate in a chain of 101 beads that ends at a wall. How much of a blow reaches the wall depends
on the mass ratio. At a resonance (dashed) the light beads rattle, the pulse decays, and a fifth of the force is left.
At an anti-resonance (dotted) the pulse loses nothing on its way after the first beads have formed it.

:systems: dimer
:part: Travelling waves
:number: force on the wall at the mass ratio 0.595, over that of equal beads
:expected: 0.2096
:within: 0.0001
:source: Jayaprakash, Starosvetsky, Vakakis, Phys. Rev. E 83, 036606 (2011): 0.59, below 30 %; the value by other code
"""

import matplotlib.pyplot as plt
import numpy as np

import granjax as gx

ratios = np.linspace(0.085, 1.0, 62)
sweep = gx.resonance.transmission(ratios, 101)
number = float(sweep.transmission[34])
ax = plt.subplots(figsize=(5.4, 3.2), layout="constrained")[1]
gx.plots.transmission(
    ratios, sweep.transmission, ax, resonances=[0.595], anti_resonances=[0.3428, 0.1548]
)
