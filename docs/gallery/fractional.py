"""Fractional chains: every site feels every other at once

In a chain of Fermi, Pasta, Ulam and Tsingou the second difference is replaced by its power s, whose weights decay as
m^(-1-2s). A blow at one end spreads in a cone. In addition a small part appears at once at all sites ahead of the cone,
an algebraic precursor.

:systems: fractional chains
:part: Beyond the granular chain
:number: log-log slope of the precursor at t = 2, s = 1/2, 20 to 100 sites ahead
:expected: -2.0
:within: 1 %
:source: kernel 1/(pi (m^2 - 1/4)); Ciaurri et al., Adv. Math. 330, 688 (2018); Macias-Diaz, Bountis (2021)
"""

import matplotlib.pyplot as plt
import numpy as np

import granjax as gx

n = np.arange(1, 121)
ax = plt.subplots(figsize=(5.4, 3.2), layout="constrained")[1]
for s in (1.0, 0.75, 0.5):
    chain = gx.scenes.fractional_fput(121, s, alpha=0.25, beta=0.25, boundary="free")
    run = gx.simulate(chain, gx.states.impact(chain, velocity=0.5), 2.0)
    u = np.abs(np.asarray(run.final.u))[1:]
    ax.loglog(n[u > 1e-12], u[u > 1e-12], ".-", label=f"s = {s}")
number = float(np.polyfit(np.log(n[19:100]), np.log(u[19:100]), 1)[0])
ax.set(xlabel="sites from the blow", ylabel="displacement u at t = 2 (scaled)")
ax.legend()
