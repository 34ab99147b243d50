"""Phononic time crystal: waves that grow in a gap of wave numbers

All springs of a ring become 10 % stiffer and softer in turn, at the same time. Layers in space open gaps in frequency;
these layers in time open gaps in the wave number. Within such a gap waves grow by a fixed factor in each period.

:systems: phononic time crystal
:part: Beyond the granular chain
:number: lower edge of the first gap, q = 2 sin(k/2), for layers of pi/2
:expected: 0.9693839828
:within: 1e-10
:source: |2 cos a cos b - (w1/w2 + w2/w1) sin a sin b| = 2; Kim, Chong, Daraio et al., Phys. Rev. E 107, 034211 (2023)
"""

import matplotlib.pyplot as plt
import numpy as np

import granjax as gx

layers = gx.scenes.modulated(12, 0.1, 2.0, shape="square")
bands = gx.linear.floquet_bands(layers, np.linspace(0, np.pi, 181), np.pi)
low, high = 2 * np.sin(np.array(bands.gaps[0]) / 2)
number = float(low)
ax = plt.subplots(figsize=(5.4, 3.2), layout="constrained")[1]
gx.plots.floquet_bands(bands, ax)
