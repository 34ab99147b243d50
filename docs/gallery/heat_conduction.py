"""Heat conduction: the conductivity of a chain grows with its length

A chain that conserves momentum does not obey Fourier's law: its conductivity grows as a power of its length. FPUT-beta
chains are placed between two heat baths. Their flux divided by the gradient in their middle half is stored
(`stored/conductivity.py`, some 20 minutes).

:systems: FPUT chain
:part: Thermal chains and chaos
:number: exponent of the conductivity, 64 to 1024 sites, k_B T = 10
:expected: 0.37
:within: 0.06
:source: 0.37 +- 0.03, K. Aoki, D. Kusnezov, Phys. Rev. Lett. 86, 4029 (2001)
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

table = np.loadtxt(Path(__file__).parent / "stored" / "conductivity.csv", delimiter=",", skiprows=1)
sites, kappa, error = table.T
(number, start), covariance = np.polyfit(
    np.log(sites), np.log(kappa), 1, w=kappa / error, cov="unscaled"
)
ax = plt.subplots(figsize=(5.4, 3.2), layout="constrained")[1]
ax.errorbar(sites, kappa, 2 * error, fmt="o", ms=4, label="two standard errors")
label = f"$N^{{{number:.3f} \\pm {covariance[0, 0] ** 0.5:.3f}}}$"
ax.loglog(sites, np.exp(start) * sites**number, label=label)
ax.set(xlabel="sites N", ylabel="conductivity (scaled)")
ax.legend()
