"""Contacts that soften and harden in turn: a breather in the gap

The exponents 3/2 and 1/2 alternate along a chain of equal masses, so the stiffnesses alternate too and a gap opens. A
bright breather exists in the gap just below the upper band. Its tail decays at the rate of a linear wave at the same
frequency.

:systems: alternating softening and hardening
:part: Beyond the granular chain
:number: decay of the tail at omega = 1.7, 1/cell
:expected: 0.520599
:within: 0.5 %
:source: cosh^2(kappa/2) = omega^2 (2 K1 + 2 K2 - omega^2)/(4 K1 K2); Lee et al., Phys. Rev. E 107, 054208 (2023)
"""

import matplotlib.pyplot as plt
import numpy as np

import granjax as gx

chain = gx.scenes.alternating(61, boundary="free")
breather = gx.breathers.breather(chain, 1.7, "bright", steps=48)
y = np.asarray(gx.measures.strain(chain, breather.state))
tail = np.abs(y[38:52:2])
number = float(-np.polyfit(np.arange(len(tail)), np.log(tail), 1)[0])
ax = plt.subplots(figsize=(5.4, 3.2), layout="constrained")[1]
ax.plot(np.arange(0, 60, 2), y[::2], "o", label="exponent 3/2")
ax.plot(np.arange(1, 60, 2), y[1::2], "s", label="exponent 1/2")
ax.plot(y, color="0.7", lw=0.8, zorder=0)
ax.set(xlabel="contact n", ylabel="strain y (scaled)")
ax.legend()
