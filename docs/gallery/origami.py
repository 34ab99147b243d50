"""Origami: a blow that compresses sends a pulse of extension ahead

Folded cells soften under compression, so extension travels faster than compression. After a blow on the end of such a
chain the recoil overtakes the compression: the leading pulse is a solitary wave of extension (line).

:systems: origami
:part: Beyond the granular chain
:number: speed of the leading pulse over that of the solitary wave of its depth
:expected: 1.0
:within: 0.005
:source: the wave solved for as such; Yasuda, Chong, Charalampidis, Kevrekidis, Yang, Phys. Rev. E 93, 043004 (2016)
"""

import matplotlib.pyplot as plt
import numpy as np

import granjax as gx

chain = gx.scenes.origami(260, 0.5, boundary="free")
run = gx.simulate(
    chain,
    gx.states.impact(chain, velocity=5.0),
    300.0,
    step=0.1,
    save_at=np.linspace(240.0, 300.0, 601),
)
y = -np.diff(np.asarray(run.us), axis=1)
lead = 180 + int(np.argmin(y[-1, 180:]))
passed = [run.ts[np.argmin(y[:, n])] for n in (lead - 30, lead - 4)]
wave = gx.travelling.solitary_wave(chain, amplitude=float(y[:, lead - 15].min()))
number = float(26 / (passed[1] - passed[0]) / wave.speed)
ax = plt.subplots(figsize=(5.4, 3.2), layout="constrained")[1]
ax.plot(y[-1], ".-", lw=0.6, ms=4)
x = np.linspace(-6, 6, 200)
ax.plot(lead + x, wave.strain(x), "C3")
ax.set(xlabel="contact n", ylabel="strain y (scaled)", xlim=(150, 260), ylim=(-1.1, 0.8))
