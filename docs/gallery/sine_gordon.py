"""Sine-Gordon chain: a kink, and the barrier that pins it

One half of a chain of coupled pendula has made one more turn than the other half. The kink between them is at rest on a
bond. It is also at rest on a site, at an energy that is higher by the Peierls-Nabarro barrier; this barrier falls
exponentially with the width of the kink. The energy of the kink approaches that of the continuum, 8 sqrt(C), from
below.

:systems: sine-Gordon chain
:part: Beyond the granular chain
:number: energy of the kink over sqrt(C) at C = 25
:expected: 7.9955556
:within: 3e-5
:source: 8 - 1/(9C), the continuum with its first correction; Braun, Kivshar, The Frenkel-Kontorova Model (2004)
"""

import matplotlib.pyplot as plt
import numpy as np

import granjax as gx

number = float(gx.kinks.kink(gx.scenes.sine_gordon(160, 25.0), 2 * np.pi).energy / 5)
couplings = np.linspace(0.1, 2.0, 8)
barriers = [
    gx.kinks.peierls_nabarro(gx.scenes.sine_gordon(60, c), 2 * np.pi).barrier for c in couplings
]
figure, (left, right) = plt.subplots(1, 2, figsize=(5.4, 3.2), layout="constrained")
for centre, name in ((29.5, "on a bond"), (29.0, "on a site")):
    kink = gx.kinks.kink(gx.scenes.sine_gordon(60, 0.5), 2 * np.pi, centre=centre)
    left.plot(np.arange(60) - centre, kink.state.u, "o-", label=name)
left.set(xlabel="site from the centre", ylabel="displacement (rad)", xlim=(-6, 6))
left.legend(loc="lower right", fontsize=8, handlelength=1)
right.semilogy(couplings, barriers, "o-")
right.set(xlabel="coupling C", ylabel="barrier (scaled)")
ax = figure
