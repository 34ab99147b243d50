"""A breather of a k-gap: localised in time, spread over space

In a ring whose stiffness is modulated in time, a wave in the k-gap grows until the nonlinearity drives it out of
resonance; then it decays again at the rate at which it grew. A breather in space decays to both sides; this breather
decays in time, before and after.

:systems: breathers of k-gaps
:part: Beyond the granular chain
:number: growth of the energy in the first period
:expected: 1.2212754
:within: 0.5 %
:source: 1.1051133 squared, the multiplier of layers in time at q = 1; Chong et al., Phys. Rev. Res. 6, 023045 (2024)
"""

import matplotlib.pyplot as plt
import numpy as np

import granjax as gx

ring = gx.scenes.modulated(6, 0.1, 2.0, shape="square", law=gx.Polynomial(1.0, 0.0, 1.0))
breather = gx.breathers.k_gap_breather(ring, np.pi, np.pi / 3, progress=False)
number = float(breather.energy[1] / breather.energy[0])
ax = plt.subplots(figsize=(5.4, 3.2), layout="constrained")[1]
since = np.asarray(breather.ts - breather.ts[0])
ax.semilogy(breather.ts, breather.energy, "o-", ms=3, label="once a period")
grown = breather.energy[0] * np.exp(2 * float(breather.growth) * since)
ax.semilogy(breather.ts, grown, "--", label="linear waves")
ax.set(xlabel="time (scaled)", ylabel="energy (scaled)", ylim=(None, 5 * breather.energy.max()))
ax.legend(frameon=False)
