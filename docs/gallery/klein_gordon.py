"""Klein-Gordon chain: a breather from the limit of no coupling

Each site has its own hardening on-site force u + u^3. In the limit of no coupling one site oscillates at omega = 1.4,
above the band. The breather is continued to the coupling C = 0.1: its neighbours then oscillate too, each exponentially
less than the one before.

:systems: Klein-Gordon chain (phi^4)
:part: Beyond the granular chain
:number: decay of the tail at C = 0.1, 1/site
:expected: 2.010367
:within: 2e-4
:source: omega^2 = 1 + 2C + 2C cosh(kappa) of a wave that alternates; Marin, Aubry, Nonlinearity 9, 1501 (1996)
"""

import matplotlib.pyplot as plt
import numpy as np

import granjax as gx

branch = gx.breathers.anticontinuous(
    lambda c: gx.scenes.klein_gordon(13, c), 0.1, 1.4, stability=False
)
u = np.abs(branch.u[-1])
number = float(np.log(u[9] / u[10]))
ax = plt.subplots(figsize=(5.4, 3.2), layout="constrained")[1]
for i in (len(branch) // 3, 2 * len(branch) // 3, len(branch) - 1):
    ax.semilogy(np.arange(-6, 7), np.abs(branch.u[i]), "o-", label=f"C = {branch.p[i]:.3f}")
ax.set(xlabel="site", ylabel="largest displacement |u| (scaled)", ylim=(1e-8, 3))
ax.legend()
