"""Repelling magnets: solitary waves that never let go

Magnets repel each other with F = A d^(-3). They act without contact, so the interaction never opens. Their solitary
waves are narrow pulses, and the faster a wave, the narrower and higher it is.

:systems: repelling magnets
:part: Beyond the granular chain
:number: peak strain of the wave at 1.05 times the speed of sound, over the spacing
:expected: 0.069221794600
:within: 1e-10
:source: the tent equation by an independent solver; Moleron, Leonard, Daraio, J. Appl. Phys. 115, 184901 (2014)
"""

import matplotlib.pyplot as plt
import numpy as np

import granjax as gx

law = gx.PowerLaw(1.0, -3.0, precompression=1.0)
ax = plt.subplots(figsize=(5.4, 3.2), layout="constrained")[1]
x = np.linspace(-8, 8, 401)
for ratio in (1.5, 1.2, 1.05):
    wave = gx.travelling.solitary_wave(law, speed=ratio * np.sqrt(3))
    ax.plot(x, wave.strain(x), label=f"{ratio} $c_0$")
number = float(wave.amplitude)
ax.set(xlabel="place n - c t (magnets)", ylabel="strain y over the spacing")
ax.legend(title="speed")
