"""A nanopteron: a solitary wave on a ripple that never ends

In a precompressed dimer an optical wave has the same phase speed as any supersonic pulse. The pulse therefore travels
on a ripple that extends to infinity on both sides. The wave number of the ripple is the one at which the phase speed of
the optical branch equals the speed of the pulse.

:systems: nanoptera in dimers
:part: Travelling waves
:number: wave number of the ripple, measured in the tail, in rad per site
:expected: 1.5746031
:within: 0.001
:source: c k = omega(k) of the optical branch, to the square of the ripple; Vainchtein et al., Phys. Rev. E 93, 042210
"""

import matplotlib.pyplot as plt

import granjax as gx

law = gx.Hertz(precompression=1.0)
masses = [1.0, 0.5]
sound = (1.5 / 0.75) ** 0.5
wave = gx.travelling.cell_wave(law, masses, speed=1.1 * sound)
number = float(wave.wavenumber)
ax = plt.subplots(figsize=(5.4, 3.2), layout="constrained")[1]
gx.plots.wave(wave, ax)
