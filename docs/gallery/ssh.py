"""Su-Schrieffer-Heeger chain: two states in the gap

The springs within pairs of masses are k1, those between pairs k2. If k1 < k2, the Zak phase of the band below the gap
is pi, and a chain between walls has one state at each end, in the middle of the gap. At k1 = k2 the gap closes; beyond
it the phase is zero and the states are gone.

:systems: Su-Schrieffer-Heeger chain
:part: Topology and flat bands
:number: square of the lower gap frequency of 10 cells between walls, k1 = 1, k2 = 2 (k/m)
:expected: 2.99853515
:within: 5e-9
:source: closed form of the open chain; Su, Schrieffer, Heeger, Phys. Rev. Lett. 42, 1698 (1979)
"""

import jax
import matplotlib.pyplot as plt
import numpy as np

import granjax as gx

inner = np.linspace(0.5, 3.5, 61)
squared = jax.vmap(lambda k1: gx.linear.normal_modes(gx.scenes.ssh(10, k1, 2.0)).omega_squared)(
    inner
)
number = float(gx.linear.normal_modes(gx.scenes.ssh(10, 1.0, 2.0)).omega_squared[9])
ax = plt.subplots(figsize=(5.4, 3.2), layout="constrained")[1]
ax.plot(inner, squared, color="0.6", lw=0.8)
ax.plot(inner[inner < 2], squared[inner < 2, 9:11], color="C3", lw=2)
for k1, place in ((1.0, 0.7), (3.0, 2.3)):
    zak = gx.topology.zak(gx.scenes.ssh(8, k1, 2.0, boundary="periodic")).below[0]
    ax.text(place, 11.4, f"Zak phase {abs(zak):.4f}")
ax.axvline(2.0, color="k", ls=":", lw=1)
ax.set(
    xlabel="spring within cells $k_1$ ($k_2$ = 2)", ylabel=r"$\omega^2$ (scaled)", ylim=(0, 12.5)
)
