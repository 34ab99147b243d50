"""Woodpile: crossed rods whose bending modes open gaps

Rods in a stack touch at points and bend. Two bending modes of every rod act as resonators of the chain. No wave passes
near the frequency of either mode (shaded).

:systems: woodpile chain
:part: Travelling waves
:number: upper edge of the first gap, rad per unit of time
:expected: 1.650782476
:within: 1e-8
:source: omega^2 = (13 - 57^(1/2))/2; Kim, Li, Chong, Theocharis, Yang, Kevrekidis, Phys. Rev. Lett. 114, 118002 (2015)
"""

import matplotlib.pyplot as plt
import numpy as np

import granjax as gx

chain = gx.scenes.woodpile(12, masses=(0.5, 0.25), stiffnesses=(1.0, 2.0), precompression=1.0)
bands = gx.linear.bands(chain)
number = float(bands.gaps[0][1])
ax = plt.subplots(figsize=(5.4, 3.2), layout="constrained")[1]
gx.plots.dispersion(gx.linear.dispersion(chain, np.linspace(-np.pi, np.pi, 121)), ax)
ax.set_title(f"the first gap ends at {number:.5f}")
